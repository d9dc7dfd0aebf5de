"""Tables of grained surfaces: what renderers read of scans under lights at several azimuths."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.formats.rgl_anisotropic import closed, resample_anisotropic, scans_of
from analysis.formats.rgl_table import Table
from analysis.formats.tensor import read_tensors
from analysis.models import MODELS
from analysis.samples import make_samples, write
from rig.angles import spherical_to_direction, turned
from rig.errors import Refused

BRUSHED = MODELS["ggx-anisotropic"](kd=0.1, ks=0.6, alpha_x=0.25, alpha_y=0.5, f0=0.3)


def _cap(count, random, largest_deg):
    """Draw directions that are even over a cap."""
    theta = np.arccos(random.uniform(np.cos(np.radians(largest_deg)), 1.0, count))
    return spherical_to_direction(theta, random.uniform(-np.pi, np.pi, count))


def _scanned(azimuths_deg, views, theta_deg=(0.0, 25.0, 50.0, 70.0)):
    """Return directions of scans: lights at few angles, views anywhere."""
    random = np.random.default_rng(3)
    lights = [(t, a) for a in azimuths_deg for t in theta_deg]
    wi = np.repeat([spherical_to_direction(*np.radians(light)) for light in lights], views, axis=0)
    return wi, _cap(len(wi), random, 82.0)


@pytest.mark.render
@pytest.mark.parametrize(
    "theta_deg", [(42.0, 48.0), pytest.param((0.0, 15.0, 30.0, 45.0, 60.0, 70.0), marks=pytest.mark.slow)]
)
def test_mitsuba_reads_a_grained_surface_from_its_scans(tmp_path, theta_deg):
    """Catches half vectors that count from the light, half turns read as whole ones, and lost grain."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    path = tmp_path / "brushed.bsdf"
    # Scans that do not begin at the seam, and lights on the other side of the sample.
    azimuths_deg = np.arange(7.0, 187.0, 15.0) + np.tile([0.0, 180.0, 0.0], 4)
    wi, wo = _scanned(azimuths_deg, 100, theta_deg)
    samples = make_samples(wi, wo, BRUSHED.evaluate(wi, wo)[:, :1], wavelength_nm=[550.0])
    loss = write(samples.drop_vars("wavelength_nm"), path)
    assert loss.median_relative < 0.005
    random = np.random.default_rng(4)
    polar, turn = random.uniform(*np.radians(theta_deg)[[0, -1]], 400), random.uniform(-np.pi, np.pi, 400)
    light, view = spherical_to_direction(polar, turn), _cap(400, random, 66.0)
    bsdf, context = mi.load_dict({"type": "measured", "filename": str(path)}), mi.BSDFContext()
    found = []
    for one, other in zip(light, view, strict=True):
        interaction = mi.SurfaceInteraction3f()
        interaction.wi = mi.Vector3f(*one.tolist())
        found.append(bsdf.eval(context, interaction, mi.Vector3f(*other.tolist()))[0])
    ours = Table(read_tensors(path), "ours").evaluate(light, view)[:, 0]
    np.testing.assert_allclose(found, ours, rtol=1e-4, atol=1e-5 * ours.max())
    true = BRUSHED.evaluate(light, view)[:, 0] * view[:, 2]
    off_peak = true < 0.5 * true.max()
    error = np.abs(found - true)[off_peak] / true[off_peak]
    assert np.median(error) < 0.01
    without_grain = BRUSHED.evaluate(turned(light, 1.0), turned(view, 1.0))[:, 0] * view[:, 2]
    assert np.median(np.abs(without_grain - true)[off_peak] / true[off_peak]) > 0.05


def test_a_whole_turn_is_kept():
    """Catches a surface that leans to one side, made the same from both."""
    wi, wo = _scanned(np.arange(0.0, 360.0, 36.0), 100, theta_deg=(36.87,))
    shingles = make_samples(wi, wo, BRUSHED.evaluate(wi, wo)[:, :1] * (2.0 + wi[:, :1]))
    table = Table(resample_anisotropic(shingles)[0], "table")
    light, view = (
        np.array([[0.6, 0.0, 0.8], [-0.6, 0.0, 0.8]]),
        np.array([[-0.5, 0.1, 0.86], [0.5, -0.1, 0.86]]),
    )
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    one, other = table.evaluate(light, view)[:, 0]
    assert one / other == pytest.approx(2.6 / 1.4, rel=0.05)


@pytest.mark.parametrize(
    ("azimuths_deg", "ends_deg", "count"),
    [
        (np.arange(0.0, 180.0, 30.0), (-180.0, 0.0), 7),
        (np.arange(10.0, 190.0, 30.0), (-200.0, 10.0), 8),
        (np.arange(0.0, 360.0, 30.0), (-180.0, 180.0), 13),
        (np.arange(5.0, 365.0, 36.0), (-211.0, 185.0), 12),
    ],
)
def test_scans_enclose_what_they_cover(azimuths_deg, ends_deg, count):
    """Catches lights between the last scan and the first that get the value of one of them."""
    wi, _ = _scanned(azimuths_deg, 40)
    scans = scans_of(wi)
    assert len(scans) == len(azimuths_deg)
    assert all(len(scan.rows) == 40 * 3 + 40 * len(azimuths_deg) for scan in scans)
    azimuths, order = closed([scan.phi_i for scan in scans])
    assert len(azimuths) == count
    np.testing.assert_allclose(np.degrees(azimuths[[0, -1]]), ends_deg, atol=1e-6)
    period = 180.0 if ends_deg[1] < 90.0 else 360.0
    known = np.degrees([scans[number].phi_i for number in order])
    np.testing.assert_allclose(np.mod(np.degrees(azimuths) - known + 1.0, period), 1.0, atol=1e-6)


def test_what_is_no_scan_is_refused():
    """Catches a grain that is guessed where no light was."""
    wi, _ = _scanned([0.0, 30.0, 60.0, 90.0], 70)
    with pytest.raises(Refused, match="leave out more than 40 deg"):
        scans_of(wi)
    with pytest.raises(Refused, match="they are no scans"):
        scans_of(_cap(2000, np.random.default_rng(1), 60.0))
    wi, _ = _scanned(np.arange(0.0, 180.0, 30.0), 40, theta_deg=(30.0,))
    with pytest.raises(Refused, match=r"only 40 of them have the light at -180\.0 deg"):
        scans_of(wi)
