"""Measured files as materials: their float64 form against Mitsuba's `measured`, and against MERL's reader."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from analysis.formats import merl
from analysis.formats.tensor import write_tensors
from rig.angles import spherical_to_direction
from rig.errors import BadInput
from simulator.light.reflectance import material_reflectance, mitsuba_reflectance
from simulator.materials import parse_material
from simulator.tables import TableMaterial
from simulator.variant import LLVM, SCALAR, choose_variant, load_mitsuba

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def directions(count: int, seed: int, largest_deg: float = 80.0) -> NDArray[np.float64]:
    """Draw directions that are even over a cap."""
    rng = np.random.default_rng(seed)
    theta = np.arccos(rng.uniform(np.cos(np.radians(largest_deg)), 1.0, count))
    return spherical_to_direction(theta, rng.uniform(-np.pi, np.pi, count))


WI, WO = directions(800, 1), directions(800, 2)


def tensor_file(path: Path, azimuths: int) -> Path:
    """Write a table of random numbers; with one azimuth it is isotropic."""
    rng = np.random.default_rng(azimuths)
    theta = np.linspace(0.0, np.radians(85.0), 5, dtype=np.float32)
    phi = np.linspace(-np.pi, np.pi, azimuths, dtype=np.float32) if azimuths > 1 else np.zeros(1, np.float32)
    incident = (azimuths, len(theta))
    # Of an isotropic file no azimuth counts; Mitsuba turns light and camera together by a half, or not.
    sigma = rng.uniform(0.5, 1.0, (9 if azimuths > 1 else 1, 8)).repeat(1 if azimuths > 1 else 9, axis=0)
    write_tensors(
        path,
        {
            "description": np.frombuffer(b"random", dtype=np.uint8),
            "theta_i": theta,
            "phi_i": phi,
            "ndf": rng.uniform(0.5, 2.0, (9, 8)).astype(np.float32),
            "sigma": sigma.astype(np.float32),
            "vndf": rng.uniform(0.5, 2.0, (*incident, 9, 8)).astype(np.float32),
            "luminance": rng.uniform(0.5, 2.0, (*incident, 7, 7)).astype(np.float32),
            "rgb": rng.uniform(0.1, 1.0, (*incident, 3, 7, 7)).astype(np.float32),
            "jacobian": np.ones(1, np.uint8),
        },
    )
    return path


@pytest.fixture(params=[SCALAR, LLVM])
def mi(request: pytest.FixtureRequest) -> Any:
    """Mitsuba in each variant."""
    if request.param == LLVM and choose_variant().variant != LLVM:
        pytest.skip("no LLVM here")
    return load_mitsuba(request.param)


@pytest.mark.render
@pytest.mark.parametrize("azimuths", [1, 9])
def test_the_closed_form_is_mitsubas(tmp_path: Path, mi: Any, azimuths: int) -> None:
    """Would catch directions exchanged, a cosine too many, or azimuths that count the wrong way."""
    material = parse_material(f"bsdf:{tensor_file(tmp_path / 'random.bsdf', azimuths)}")
    assert isinstance(material, TableMaterial)
    assert material.isotropic == (azimuths == 1)
    found = material_reflectance(mi, material)(WI, WO)
    expected = mitsuba_reflectance(mi, material)(WI, WO)
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-4 * expected.mean())
    assert np.median(np.abs(found / expected - 1.0)) < 2e-6


@pytest.mark.realdata
@pytest.mark.render
def test_real_files_too(shared_data: Path, mi: Any) -> None:
    """Would catch what only real tables hold: negative values, and symmetries."""
    for path in sorted((shared_data / "rgl").glob("*.bsdf")):
        material = parse_material(f"bsdf:{path}")
        found = material_reflectance(mi, material)(WI, WO)
        expected = mitsuba_reflectance(mi, material)(WI, WO)
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4 * np.median(expected))


def test_merls_files_give_the_value_of_the_bin(tmp_path: Path) -> None:
    """Would catch a scale left out, and bins without a value that are negative light."""
    planes = np.random.default_rng(0).uniform(0.0, 1500.0, (3, 90, 90, 180))
    planes[:, :, 80:] = -1.0
    merl.write_table(tmp_path / "random.binary", planes)
    material = parse_material(f"merl:{tmp_path}/random.binary")
    assert isinstance(material, TableMaterial)
    assert material.has_closed_form
    assert not material.rendered
    found = material.reflectance()(WI, WO)
    np.testing.assert_array_equal(found, np.maximum(merl.evaluate(planes, WI, WO), 0.0))
    assert (material.reflectance()(WI * [1, 1, -1], WO) == 0.0).all()
    with pytest.raises(BadInput, match="Mitsuba does not read such a file"):
        material.plugin()


def test_wrong_files_are_refused_in_one_line(tmp_path: Path) -> None:
    """Would catch a traceback, or a file of another kind taken for a table."""
    (tmp_path / "text.bsdf").write_text("not a table")
    with pytest.raises(BadInput, match="is not a measured BSDF"):
        parse_material(f"bsdf:{tmp_path}/text.bsdf")
    with pytest.raises(BadInput, match="No such file"):
        parse_material("merl:nowhere.binary")
    with pytest.raises(BadInput, match="can have a pattern"):
        parse_material(f"bsdf:{tensor_file(tmp_path / 'r.bsdf', 1)}@checker:side_mm=3,kd=1")
