"""The Dataset of samples: what it holds, what it refuses, and how it is narrowed."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.samples import UNITS, make_samples, read, select, write
from rig.errors import BadInput


def directions(count=6):
    """Return unit vectors above the horizon."""
    random = np.random.default_rng(1)
    v = random.standard_normal((count, 3))
    v[:, 2] = np.abs(v[:, 2])
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_units_and_conventions_are_stated():
    """Catches a number without a unit, or samples that do not say whether a cosine is inside."""
    samples = make_samples(directions(), directions(), np.ones((6, 3)), u_noise=0.1, u_reference=0.02)
    for name, variable in samples.data_vars.items():
        assert variable.attrs["units"] == UNITS[name]
    assert samples.attrs["cosine"] == "not included"
    assert "sample frame" in samples.attrs["conventions"]
    assert np.isnan(samples.attrs["receiver_solid_angle_sr"])


def test_total_uncertainty_is_the_quadrature_of_the_columns():
    """Catches a column that is forgotten in, or counted twice into, u_f_r."""
    samples = make_samples(
        directions(), directions(), np.ones((6, 2)), u_noise=0.1, u_white=0.2, u_binning=0.2, u_reference=0.4
    )
    np.testing.assert_allclose(samples["u_f_r"], 0.5, rtol=1e-14)
    given = make_samples(directions(), directions(), np.ones((6, 2)), u_noise=0.1, u_f_r=0.7)
    np.testing.assert_array_equal(given["u_f_r"], 0.7)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"wi": 2.0 * directions()}, "length 2"),
        ({"wo": directions(5)}, "wo"),
        ({"f_r": np.ones((6, 2, 2))}, "f_r"),
        ({"channels": ["R"]}, "channels"),
        ({"wavelength_nm": [500.0]}, "wavelength_nm"),
        ({"u_noise": -0.1}, "negative"),
        ({"u_nose": 0.1}, "u_nose"),
        ({"pose": np.zeros((6, 2))}, "pose"),
        ({"d_wi": np.zeros((6, 3))}, "d_wi"),
    ],
)
def test_what_does_not_fit_is_refused(arguments, complaint):
    """Catches arrays that would be broadcast into nonsense, and directions that are not directions."""
    correct = {"wi": directions(), "wo": directions(), "f_r": np.ones((6, 2))}
    with pytest.raises(BadInput, match=complaint):
        make_samples(**(correct | arguments))


def test_selection_of_wavelengths_and_angles():
    """Catches a neighbour taken for the channel that was asked for, and an angle limit on one side only."""
    theta = np.radians([0.0, 30.0, 60.0, 85.0])
    w = np.stack([np.sin(theta), 0.0 * theta, np.cos(theta)], axis=1)
    samples = make_samples(w, w[::-1], np.arange(12.0).reshape(4, 3), wavelength_nm=[400.0, 500.0, 600.0])
    assert select(samples, wavelength_nm=[600.0])["f_r"].to_numpy().ravel().tolist() == [2.0, 5.0, 8.0, 11.0]
    assert select(samples, max_theta_deg=60.0)["f_r"].to_numpy()[:, 0].tolist() == [3.0, 6.0]
    with pytest.raises(BadInput, match="choose from 400, 500, 600"):
        select(samples, wavelength_nm=[555.0])
    with pytest.raises(BadInput, match="holds no nan nm"):
        select(samples, wavelength_nm=[float("nan")])
    with pytest.raises(BadInput, match="both angles"):
        select(samples, max_theta_deg=10.0)
    with pytest.raises(BadInput, match="its channels are 0"):
        select(make_samples(w, w, np.ones(4)), wavelength_nm=[500.0])


def test_everything_survives_netcdf(tmp_path):
    """Catches a column, an attribute, a flag or a digit lost between reduction and fit."""
    random = np.random.default_rng(2)
    samples = make_samples(
        directions(),
        directions(),
        random.standard_normal((6, 3)),
        channels=["R", "G", "B"],
        wavelength_nm=[610.0, 540.0, 465.0],
        source_solid_angle_sr=1e-4,
        receiver_solid_angle_sr=2e-4,
        source="a test",
        flags=random.integers(0, 4, (6, 3)),
        u_noise=random.random((6, 3)),
        u_white=random.random((6, 3)),
        white_group=[0, 0, 1, 1, 2, 2],
        u_reference=0.01,
        u_binning=0.02,
        pose=np.arange(6),
        d_wi=random.standard_normal((6, 4, 3)),
        d_wo=random.standard_normal((6, 4, 3)),
        u_joint_rad=random.random(4),
    )
    samples["f_r"][2, 1] = np.nan
    samples = samples.assign_coords(joint=["a", "b", "c", "d"]).assign_attrs(rig_hash="abc")
    samples["extra"] = ("sample", np.arange(6.0))
    (tmp_path / "session").mkdir()
    path = tmp_path / "session" / "samples.nc"
    write(samples, path)
    assert read(path).identical(samples)
    assert read(tmp_path / "session").identical(samples)
