"""RGL tensor files: unchanged tensors, values at the nodes, re-sampling, damage in one line."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from analysis.formats.rgl_layout import is_unchanged, kept_table
from analysis.formats.rgl_resample import resample
from analysis.formats.rgl_table import Table
from analysis.formats.tensor import read_tensors, write_tensors
from analysis.models import MODELS
from analysis.samples import make_samples, read, select, write
from rig.angles import direction_to_spherical, spherical_to_direction
from rig.errors import BadInput


@pytest.fixture
def tensors():
    """Return a small table with a warp, a profile and negative values."""
    rng = np.random.default_rng(7)

    def positive(*shape):
        return rng.uniform(0.5, 2.0, shape).astype(np.float32)

    return {
        "description": np.frombuffer(b"paint", np.uint8),
        "phi_i": np.zeros(1, np.float32),
        "theta_i": np.linspace(0.0, 1.5, 4, dtype=np.float32),
        "sigma": positive(2, 9),
        "ndf": positive(2, 9),
        "vndf": positive(1, 4, 9, 9),
        "luminance": positive(1, 4, 5, 5),
        "rgb": rng.uniform(-0.2, 1.0, (1, 4, 3, 5, 5)).astype(np.float32),
        "jacobian": np.ones(1, np.uint8),
    }


def directions(count, seed, largest_deg):
    """Draw directions that are even over a cap."""
    rng = np.random.default_rng(seed)
    theta = np.arccos(rng.uniform(np.cos(np.radians(largest_deg)), 1.0, count))
    return spherical_to_direction(theta, rng.uniform(-np.pi, np.pi, count))


def test_tensors_come_back_unchanged(tensors, tmp_path):
    """Catches a writer that changes an array, its type, its shape or the fields' order."""
    path = tmp_path / "table.bsdf"
    write_tensors(path, tensors)
    again = read_tensors(path)
    assert list(again) == list(tensors)
    for name, array in tensors.items():
        assert again[name].dtype == array.dtype
        np.testing.assert_array_equal(again[name], array)


def test_big_endian_arrays_are_written_little_endian(tmp_path):
    """Catches bytes written in the order of the machine that the array came from."""
    path = tmp_path / "table.bsdf"
    write_tensors(path, {"a": np.array([1.0, 2.0], ">f4")})
    np.testing.assert_array_equal(read_tensors(path)["a"], [1.0, 2.0])
    with pytest.raises(BadInput, match="complex64"):
        write_tensors(path, {"a": np.zeros(2, np.complex64)})


def test_samples_are_the_tables_values_at_its_nodes(tensors, tmp_path):
    """Catches a warp that is not the inverse of the evaluation, lost negatives, and a cosine left in."""
    tensors["jacobian"][:] = 0
    path = tmp_path / "file.dat"
    write_tensors(path, tensors)
    samples = read(path)
    times_cosine = samples["f_r"].to_numpy() * samples["wo"].to_numpy()[:, 2:]
    at_normal = samples["wi"].to_numpy()[:, 2] > 1.0 - 1e-7
    nodes = tensors["rgb"][0, 0].reshape(3, -1).T.astype(float)
    # Each value read at normal incidence is one of the table's, but for the pole, which is between two.
    away = np.abs(times_cosine[at_normal][:, None] - nodes[None]).max(-1).min(-1)
    assert np.sort(away)[-2] < 1e-6
    assert (samples["f_r"] < 0.0).any()
    assert samples["channel"].to_numpy().tolist() == ["R", "G", "B"]
    as_brdf = read(path, no_cosine=True)
    np.testing.assert_allclose(as_brdf["f_r"], times_cosine, rtol=1e-12)


@pytest.mark.parametrize("through_nc", [False, True])
def test_samples_of_a_table_are_written_as_that_table(tensors, tmp_path, through_nc):
    """Catches nodes interpolated anew although nobody changed them: warps and nodes below the horizon."""
    tensors["vendor"] = np.arange(5, dtype=np.uint16)
    path, again = tmp_path / "file.dat", tmp_path / "again.bsdf"
    write_tensors(path, tensors)
    samples = read(path)
    if through_nc:
        write(samples, tmp_path / "samples.nc")
        samples = read(tmp_path / "samples.nc")
    loss = write(samples, again)
    assert loss.worst_relative == 0.0
    assert not loss.dropped
    assert again.read_bytes() == path.read_bytes()


def test_wavelengths_of_a_table_may_be_left_out(tensors, tmp_path):
    """Catches the other channels' values under the names of those that were chosen."""
    spectra = np.random.default_rng(1).uniform(0.1, 1.0, (1, 4, 5, 5, 5)).astype(np.float32)
    del tensors["rgb"]
    tensors |= {"spectra": spectra, "wavelengths": np.linspace(400, 800, 5, dtype=np.float32)}
    path, again = tmp_path / "file.dat", tmp_path / "again.bsdf"
    write_tensors(path, tensors)
    write(select(read(path), wavelength_nm=[700.0, 500.0]), again)
    np.testing.assert_array_equal(read_tensors(again)["spectra"], spectra[:, :, [3, 1]])


@pytest.mark.parametrize("change", ["value", "direction", "fewer", "flag"])
def test_changed_samples_are_not_the_old_table(tensors, tmp_path, change):
    """Catches a kept file that is written although a person corrected, turned or rejected samples."""
    path = tmp_path / "file.dat"
    write_tensors(path, tensors)
    samples = read(path)
    assert is_unchanged(samples, kept_table(samples))
    if change == "value":
        samples["f_r"][3, 1] *= 1.0 + 1e-6
    elif change == "direction":
        samples["wi"][:] = samples["wi"].to_numpy() * [-1.0, -1.0, 1.0]
    elif change == "fewer":
        samples = samples.isel(sample=slice(1, None))
    else:
        samples["flags"][5, 0] = 1
    kept = kept_table(samples)
    assert (kept is None) if change == "direction" else not is_unchanged(samples, kept)


@pytest.mark.parametrize("change", ["value", "fewer", "flag", "nan"])
def test_an_edited_table_changes_near_the_edit_only(tensors, tmp_path, change):
    """Catches nodes that are lost, moved or interpolated anew because one of them was edited."""
    path, again = tmp_path / "file.dat", tmp_path / "again.bsdf"
    write_tensors(path, tensors)
    samples = read(path)
    theta_i = direction_to_spherical(samples["wi"].to_numpy())[0]
    edited = int(np.flatnonzero(np.isclose(theta_i, 0.5))[3])
    new = 3.0 * samples["f_r"].to_numpy()[edited, 1]
    if change == "value":
        samples["f_r"][edited, 1] = new
    elif change == "fewer":
        samples = samples.drop_isel(sample=edited)
    elif change == "flag":
        samples["flags"][edited, 1] = 4
    else:
        samples["f_r"][edited, 1] = np.nan
    loss = write(samples, again)
    assert loss.filled == 0
    before, after = (read_tensors(each) for each in (path, again))
    moved = np.argwhere(before["rgb"] != after["rgb"])
    assert len(moved) > 0
    assert set(moved[:, 1]) == {1}  # one polar angle of the light
    assert set(moved[:, 2]) == ({0, 1, 2} if change == "fewer" else {1})
    assert np.ptp(moved[:, 4]) <= 2
    assert all(np.array_equal(before[name], after[name]) for name in before if name != "rgb")
    kept = read(again)["f_r"].to_numpy()
    if change == "value":
        np.testing.assert_allclose(kept[edited, 1], new, rtol=1e-5)
        assert loss.worst_relative < 1e-5
    else:
        around = before["rgb"][0, 1, 1]
        assert around.min() <= after["rgb"][0, 1, 1][tuple(moved[0][3:])] <= around.max()


def test_a_table_that_is_scaled_is_scaled_everywhere(tensors, tmp_path):
    """Catches nodes below the horizon that stay behind, so that values near it come out wrong."""
    tensors["rgb"][:] = 0.4
    path, again = tmp_path / "file.dat", tmp_path / "again.bsdf"
    write_tensors(path, tensors)
    samples = read(path)
    samples["f_r"] *= 2.0
    write(samples, again)
    np.testing.assert_allclose(read_tensors(again)["rgb"], 0.8, rtol=1e-5)


def test_a_wide_gap_in_a_table_is_told(tensors, tmp_path):
    """Catches values invented where a person rejected most of the samples."""
    path, again = tmp_path / "file.dat", tmp_path / "again.bsdf"
    write_tensors(path, {**tensors, "rgb": np.ones((1, 4, 3, 33, 33), np.float32)})
    samples = read(path)
    flat = samples["wi"].to_numpy()[:, 2] < np.cos(0.9)
    samples["flags"][np.flatnonzero(flat)] = 1
    loss = write(samples, again)
    assert 0.9 * flat.sum() < loss.filled <= flat.sum()
    samples["flags"][:] = 0
    samples["flags"][np.flatnonzero(samples["wo"].to_numpy()[:, 2] > np.cos(0.4))] = 1
    assert 0 < write(samples, again).filled < int((samples["flags"] != 0).any("channel").sum())
    np.testing.assert_allclose(read_tensors(again)["rgb"], 1.0, rtol=1e-5)


def test_an_isotropic_table_does_not_know_the_lights_azimuth(tensors):
    """Catches half vectors whose azimuth is taken in the sample's frame."""
    for name in ("sigma", "ndf"):  # these stay in the sample's frame
        tensors[name][:] = tensors[name][0]
    table = Table(tensors, "table")
    wi, wo = directions(200, 1, 80), directions(200, 2, 80)
    (theta_i, phi_i), (theta_o, phi_o) = direction_to_spherical(wi), direction_to_spherical(wo)
    turned = table.evaluate(
        spherical_to_direction(theta_i, phi_i + 1.0), spherical_to_direction(theta_o, phi_o + 1.0)
    )
    np.testing.assert_allclose(table.evaluate(wi, wo), turned, rtol=1e-5)


@pytest.mark.parametrize("layers", [True, False])
def test_resampled_closed_form(tmp_path, layers):
    """Catches an interpolation that smears, mirrors or scales: 1 % off the peak between the samples."""
    model = MODELS["cook-torrance"](kd=0.3, ks=0.2, m=0.3, ior=1.5)
    if layers:
        theta = np.radians(np.arange(30.0, 46.0, 5.0))
        wi = np.repeat(spherical_to_direction(theta, 0.0 * theta), 800, axis=0)
    else:
        wi = directions(6000, 3, 20)
    wo = directions(len(wi), 4, 85)
    path = tmp_path / "fit.bsdf"
    loss = write(make_samples(wi, wo, model.evaluate(wi, wo)), path)
    assert str(loss).startswith("off the peak 0.")
    assert loss.median_relative < 0.005
    assert 0.0 < loss.u_between_relative < 0.05
    assert loss.cells > 0
    table = Table(read_tensors(path), str(path))
    theta = np.arccos(np.random.default_rng(5).uniform(*np.cos(np.radians([44.0, 31.0])), 4000))
    wi = spherical_to_direction(theta, 1.0) if layers else directions(4000, 5, 20)
    wo = directions(4000, 6, 70)
    true = model.evaluate(wi, wo)
    error = np.abs(table.evaluate(wi, wo) / wo[:, 2:] - true) / true
    assert np.median(error) < 0.002
    assert np.percentile(error, 95.0) < 0.01


def test_wavelengths_and_their_values_survive(tmp_path):
    """Catches channels in the wrong order and wavelengths lost."""
    wi = np.repeat(spherical_to_direction(np.radians([30.0, 32.0]), 0.0), 400, axis=0)
    wo = directions(800, 4, 80)
    f_r = np.broadcast_to([0.1, 0.2, -0.05, 0.4], (800, 4))
    path = tmp_path / "spectra.bsdf"
    write(make_samples(wi, wo, f_r, wavelength_nm=[400.0, 500.0, 600.0, 700.0]), path)
    samples = read(path)
    np.testing.assert_array_equal(samples["wavelength_nm"], [400.0, 500.0, 600.0, 700.0])
    # Values below a cosine of 0.2 suffer from the nodes below the horizon.
    well = samples["wo"].to_numpy()[:, 2] > 0.2
    np.testing.assert_allclose(samples["f_r"].to_numpy()[well], np.tile(f_r[0], (well.sum(), 1)), rtol=0.01)


@pytest.mark.parametrize(
    ("f_r", "wo", "words"),
    [
        (np.ones((40, 2)), directions(40, 2, 80), "2 channels without wavelengths"),
        (np.ones((40, 3)), spherical_to_direction(np.linspace(0.1, 1.0, 40), 0.0), "one plane"),
        (np.full((40, 3), np.nan), directions(40, 2, 80), "only 0 samples"),
    ],
)
def test_samples_that_make_no_table(tmp_path, f_r, wo, words):
    """Catches a table invented where the samples say nothing."""
    wi = np.repeat(spherical_to_direction(0.3, 0.0)[None], 40, axis=0)
    with pytest.raises(BadInput, match=words):
        write(make_samples(wi, wo, f_r), tmp_path / "out.bsdf")
    assert not list(tmp_path.iterdir())


def _shape_at(content, name):
    return content.index(name) + len(name) + 11


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda c: c[:40], "the file ends here"),
        (lambda c: c[:-30], "do not lie inside"),
        (lambda c: c[:14] + struct.pack(">I", 9) + c[18:], "announces"),
        (lambda c: c[:12] + b"\2\0" + c[14:], "version 2.0"),
        (lambda c: c[:18] + b"\xff\xff" + c[20:], "name of 65535"),
        (
            lambda c: c[: _shape_at(c, b"rgb")] + b"\xff" * 40 + c[_shape_at(c, b"rgb") + 40 :],
            r"rgb.*do not lie inside",
        ),
        (lambda c: c.replace(b"vndf", b"vndg"), "no field vndf"),
        (lambda c: c.replace(b"theta_i", b"phi_i\x01\x01"), "no readable name"),
    ],
)
def test_damaged_files(tensors, tmp_path, damage, words):
    """Catches a traceback, or memory taken for a size that nobody checked."""
    path = tmp_path / "file.dat"
    write_tensors(path, tensors)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(BadInput, match=words) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_random_damage_is_one_line_or_a_read(tensors, tmp_path):
    """Catches any other exception than BadInput."""
    path = tmp_path / "file.dat"
    write_tensors(path, tensors)
    whole = bytearray(path.read_bytes())
    rng = np.random.default_rng(0)
    for _ in range(300):
        content = whole.copy()
        for place in rng.integers(12, 500, 3):
            content[place] = rng.integers(256)
        path.write_bytes(content[: rng.integers(13, len(content)) if rng.random() < 0.3 else None])
        try:
            read(path)
        except BadInput as error:
            assert "\n" not in str(error)  # noqa: PT017 - the error is one of two right answers


@pytest.mark.parametrize(
    ("name", "value"), [("rgb", np.nan), ("vndf", -1.0), ("sigma", 0.0), ("theta_i", 9.0)]
)
def test_values_that_are_no_table(tensors, tmp_path, name, value):
    """Catches values that would turn into NaN or worse later, without a word."""
    tensors[name][..., -1] = value
    path = tmp_path / "file.dat"
    write_tensors(path, tensors)
    with pytest.raises(BadInput, match=name):
        read(path)


@pytest.mark.slow
@pytest.mark.realdata
def test_real_files_from_scattered_samples(shared_data):
    """Catches an interpolation that only closed forms survive: 1 % off the peak, 2 % where it glitters."""
    bound = {"cm_military_green_rgb": 0.008, "vch_golden_yellow_rgb": 0.002, "irid_flake_paint1_rgb": 0.02}
    wi, wo = directions(50_000, 11, 86), directions(50_000, 12, 88)
    asked = directions(20_000, 7, 66), directions(20_000, 6, 66)
    for path in sorted((shared_data / "rgl").glob("*.bsdf")):
        table = Table(read_tensors(path), str(path))
        samples = make_samples(wi, wo, table.evaluate(wi, wo) / wo[:, 2:], channels=["R", "G", "B"])
        tensors, loss = resample(samples)
        written = Table(tensors, "written")
        true = table.evaluate(*asked)
        off_peak = true < 0.5 * true.max(axis=0)
        error = np.abs(written.evaluate(*asked) - true)[off_peak] / np.abs(true[off_peak])
        assert np.median(error) < bound[path.stem], path.stem
        # The median error of a normal distribution is 0.67 standard deviations; grazing ones are larger.
        assert 0.2 * loss.u_between_relative < np.median(error) < loss.u_between_relative, path.stem


@pytest.mark.realdata
def test_real_files(shared_data):
    """Catches a reader that knows only what its own writer makes."""
    for path in sorted((shared_data / "rgl").glob("*.bsdf")):
        samples = read(path)
        assert samples.sizes["channel"] == 3
        assert samples.sizes["sample"] > 5000
        assert np.isfinite(samples["f_r"]).all()
        assert 0.0 < float(samples["f_r"].median()) < 10.0
