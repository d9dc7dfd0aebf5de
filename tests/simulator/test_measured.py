"""Measured BSDF files, with Mitsuba's `measured` as the oracle of reader and writer."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.formats import rgl
from analysis.formats.rgl_table import Table
from analysis.formats.tensor import read_tensors, write_tensors
from analysis.models import MODELS
from analysis.samples import make_samples, read, write
from rig.angles import spherical_to_direction
from simulator.light.reflectance import mitsuba_reflectance
from simulator.materials import parse_material
from simulator.variant import LLVM, SCALAR, choose_variant, load_mitsuba

pytestmark = pytest.mark.render


def directions(count, seed, largest_deg):
    """Draw directions that are even over a cap."""
    rng = np.random.default_rng(seed)
    theta = np.arccos(rng.uniform(np.cos(np.radians(largest_deg)), 1.0, count))
    return spherical_to_direction(theta, rng.uniform(-np.pi, np.pi, count))


WI, WO = directions(2000, 1, 85), directions(2000, 2, 85)
# Mitsuba leaves its symmetry of isotropic files unset: it does not matter for lights of this quadrant.
WI_ISOTROPIC = np.abs(WI) * [-1.0, -1.0, 1.0]


@pytest.fixture(params=[SCALAR, LLVM])
def oracle(request):
    """Return a function (path, wi) -> f_r by Mitsuba; its first direction is the table's light."""
    if request.param == LLVM and choose_variant().variant != LLVM:
        pytest.skip("no LLVM here")
    mi = load_mitsuba(request.param)
    return lambda path, wi: mitsuba_reflectance(mi, parse_material(f"bsdf:{path}"))(WO, wi)


@pytest.mark.realdata
def test_real_files_read_and_written_back(shared_data, tmp_path, oracle):
    """Catches tensors changed on the way, and a reader that warps otherwise than renderers do."""
    paths = sorted((shared_data / "rgl").glob("*.bsdf"))
    assert paths
    for path in paths:
        tensors = read_tensors(path)
        write_tensors(tmp_path / "again.bsdf", tensors)
        expected = oracle(path, WI_ISOTROPIC)
        np.testing.assert_allclose(oracle(tmp_path / "again.bsdf", WI_ISOTROPIC), expected, rtol=1e-5)
        ours = Table(tensors, str(path)).evaluate(WI_ISOTROPIC, WO) / WO[:, 2:]
        # Single precision limits the oracle where positive and negative values cancel.
        np.testing.assert_allclose(ours, expected, rtol=1e-4, atol=1e-5 * np.median(expected))


@pytest.mark.realdata
def test_converted_files(shared_data, tmp_path, oracle):
    """Catches samples of a table, stored and loaded on the way, that become another table for renderers."""
    for path in sorted((shared_data / "rgl").glob("*.bsdf")):
        write(read(path), tmp_path / "samples.nc")
        write(read(tmp_path / "samples.nc"), tmp_path / "again.bsdf")
        expected = oracle(path, WI_ISOTROPIC)
        np.testing.assert_allclose(oracle(tmp_path / "again.bsdf", WI_ISOTROPIC), expected, rtol=1e-5)


@pytest.mark.parametrize("jacobian", [0, 1])
@pytest.mark.parametrize("azimuths", [[0.0], [-np.pi, -2.0, -1.0, 0.0], [-np.pi, -1.0, 0.5, 2.0, np.pi]])
def test_synthetic_tables(tmp_path, oracle, azimuths, jacobian):
    """Catches azimuths, symmetry and the flag jacobian handled otherwise than the oracle does."""
    rng = np.random.default_rng(3)
    count = len(azimuths)

    def positive(*shape):
        return rng.uniform(0.5, 2.0, shape).astype(np.float32)

    tensors = {
        "description": np.frombuffer(b"paint", np.uint8),
        "phi_i": np.array(azimuths, np.float32),
        "theta_i": np.array([0.0, 0.3, 1.0, 1.5], np.float32),
        "sigma": positive(3, 9),
        "ndf": positive(3, 9),
        "vndf": positive(count, 4, 9, 9),
        "luminance": positive(count, 4, 5, 5),
        "rgb": positive(count, 4, 3, 5, 5),
        "jacobian": np.full(1, jacobian, np.uint8),
    }
    path = tmp_path / "table.bsdf"
    write_tensors(path, tensors)
    wi = WI_ISOTROPIC if count == 1 else WI
    ours = Table(tensors, "table").evaluate(wi, WO) / WO[:, 2:]
    np.testing.assert_allclose(ours, oracle(path, wi), rtol=2e-4)


def test_resampled_samples(tmp_path, oracle):
    """Catches a written table that renderers read otherwise than the loss promises: 1 % off the peak."""
    model = MODELS["cook-torrance"](kd=0.3, ks=0.2, m=0.3, ior=1.5)
    theta = np.radians(np.arange(0.0, 86.0, 5.0))
    wi = np.repeat(spherical_to_direction(theta, 0.0 * theta), 500, axis=0)
    wo = directions(len(wi), 4, 88)
    path = tmp_path / "paint.bsdf"
    rgl.write(make_samples(wi, wo, np.repeat(model.evaluate(wi, wo), 3, axis=1)), path)
    true = model.evaluate(WI_ISOTROPIC, WO)
    error = (np.abs(oracle(path, WI_ISOTROPIC) - true) / true)[(WI[:, 2] > 0.4) & (WO[:, 2] > 0.4)]
    assert np.median(error) < 0.003
    assert np.percentile(error, 95.0) < 0.01
