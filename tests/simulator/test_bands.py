"""Materials that depend on wavelength, as the channels of a camera see them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from analysis.models import MODELS
from analysis.spectra import read_spectrum
from rig.angles import spherical_to_direction
from rig.description import Rig, default_rig
from rig.errors import BadInput
from simulator.bands import BandedMaterial, SpectralMaterial, instrument_of, seen_through
from simulator.materials import ClosedFormMaterial, closed_form_material, parse_material

if TYPE_CHECKING:
    from pathlib import Path

NODES = np.arange(400.0, 701.0, 10.0)


def write(path: Path, *columns: np.ndarray) -> Path:
    """Write a table over wavelength."""
    rows = np.column_stack([NODES, *columns])
    path.write_text("nm,value\n" + "\n".join(",".join(map(repr, row.tolist())) for row in rows))
    return path


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    """Return a machine with a warm lamp and a camera of three broad channels."""
    lamp = write(tmp_path / "lamp.csv", 0.2 + (NODES - 400.0) / 300.0)
    channels = [np.exp(-(((NODES - centre) / 40.0) ** 2)) for centre in (610.0, 540.0, 460.0)]
    camera = write(tmp_path / "camera.csv", *channels)
    plain = default_rig()
    return plain.model_copy(
        update={
            "lamp": plain.lamp.model_copy(update={"spectrum": str(lamp)}),
            "camera": plain.camera.model_copy(update={"sensitivity": str(camera)}),
        }
    )


def dense(rig: Rig, line: str, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """f_r by channel, at every nanometre."""
    material, instrument = parse_material(line), instrument_of(rig)
    assert isinstance(material, SpectralMaterial)
    assert instrument is not None
    total = np.zeros((len(wi), 3))
    for node, weight in zip(instrument.wavelength_nm, instrument.weight, strict=True):
        total += weight * MODELS[material.model](**material.at(float(node))).evaluate(wi, wo)
    return total


def directions() -> tuple[np.ndarray, np.ndarray]:
    """Draw pairs of directions."""
    rng = np.random.default_rng(0)
    theta = np.arccos(rng.uniform(0.1, 1.0, (2, 200)))
    wi, wo = spherical_to_direction(theta, rng.uniform(-np.pi, np.pi, (2, 200)))
    return wi, wo


def test_without_wavelengths_nothing_changes(rig: Rig) -> None:
    """Would catch a grey or coloured material that a spectrum of the lamp changes."""
    material = parse_material("lambert:kd=0.2/0.4/0.6")
    assert seen_through(rig, material, 1e-3) is material
    assert seen_through(default_rig(), material, 1e-3) is material


def test_a_scale_is_one_band_with_the_weighted_mean(rig: Rig, tmp_path: Path) -> None:
    """Would catch bands where none are needed, and weights that are not lamp times camera."""
    paint = write(tmp_path / "paint.csv", 0.1 + 0.8 * (NODES > 550.0))
    line = f"cook-torrance:kd={paint},ks=0.3,m=0.2,ior=1.5"
    seen = seen_through(rig, parse_material(line), 1e-3)
    assert isinstance(seen, ClosedFormMaterial)
    red, green, blue = seen.truth["kd"]
    assert red > green > blue
    wi, wo = directions()
    np.testing.assert_allclose(seen.reflectance()(wi, wo), dense(rig, line, wi, wo), rtol=1e-12)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
def test_bands_keep_within_the_tolerance(rig: Rig, tmp_path: Path, tolerance: float) -> None:
    """Would catch too few bands, a wrong error, or more bands than the tolerance needs."""
    eta = write(tmp_path / "eta.csv", 0.4 + 1.2 * np.exp(-(((NODES - 480.0) / 60.0) ** 2)))
    k = write(tmp_path / "k.csv", 2.0 + (NODES - 400.0) / 100.0)
    line = f"ggx-conductor:kd=0.0,ks=1.0,alpha=0.2,eta={eta},k={k}"
    seen = seen_through(rig, parse_material(line), tolerance)
    assert isinstance(seen, BandedMaterial)
    wi, wo = directions()
    exact = dense(rig, line, wi, wo)
    off = np.sqrt(np.mean((seen.reflectance()(wi, wo) - exact) ** 2)) / exact.mean()
    assert off <= seen.error <= tolerance
    assert seen.bands <= {1e-2: 16, 1e-3: 40, 1e-4: 100}[tolerance]


def test_a_tilted_spectral_sample_keeps_its_mounting(rig: Rig, tmp_path: Path) -> None:
    """Would catch a form that is lost when bands are made."""
    paint = write(tmp_path / "paint.csv", 0.5 + 0.0 * NODES)
    seen = seen_through(rig, parse_material(f"lambert:kd={paint}@sphere:radius_mm=9"), 1e-3)
    assert seen.mounting.radius_mm == 9.0
    np.testing.assert_allclose(seen.truth["kd"], 0.5, rtol=1e-12)


def test_colour_sciences_own_data(tmp_path: Path) -> None:
    """Would catch names that do not reach the library."""
    lamp = read_spectrum("colour:A")
    assert lamp.values.shape[1] == 1
    assert lamp.at(np.array([560.0]))[0, 0] == pytest.approx(100.0)
    assert read_spectrum("colour:Nikon 5100 (NPL)").values.shape[1] == 3


@pytest.mark.realdata
def test_rawtoaces_cameras(shared_data: Path) -> None:
    """Would catch columns in another order, or nodes that are text."""
    path = shared_data / "camera-sensitivities" / "nikon_d700_380_780_5.json"
    camera = read_spectrum(str(path))
    stored = json.loads(path.read_text())["spectral_data"]["data"]["main"]
    np.testing.assert_array_equal(camera.at(np.array([550.0]))[0], stored["550"])
    peaks = camera.wavelength_nm[np.argmax(camera.values, axis=0)]
    assert peaks[0] > peaks[1] > peaks[2]


def test_what_cannot_be_seen_is_refused_in_one_line(rig: Rig, tmp_path: Path) -> None:
    """Would catch a spectrum that is silently extended, or an instrument that is made up."""
    paint = write(tmp_path / "paint.csv", 0.5 + 0.0 * NODES)
    with pytest.raises(BadInput, match="lamp and camera have no spectrum"):
        seen_through(default_rig(), parse_material(f"lambert:kd={paint}"), 1e-3)
    (tmp_path / "short.csv").write_text("500,0.5\n600,0.5\n")
    with pytest.raises(BadInput, match="from 500 to 600 nm"):
        seen_through(rig, parse_material(f"lambert:kd={tmp_path}/short.csv"), 1e-3)
    (tmp_path / "um.csv").write_text("0.4,0.5\n0.7,0.5\n")
    for name, what in {"um.csv": "not in nm", "none.csv": "No such file"}.items():
        with pytest.raises(BadInput, match=what):
            parse_material(f"lambert:kd={tmp_path}/{name}")
    (tmp_path / "words.csv").write_text("nm,value\nred,0.5\n")
    with pytest.raises(BadInput, match="no table of wavelengths"):
        parse_material(f"lambert:kd={tmp_path}/words.csv")
    with pytest.raises(BadInput, match="colour-science has no"):
        parse_material("lambert:kd=colour:nothing")
    with pytest.raises(BadInput, match="below 0"):
        parse_material(f"lambert:kd={write(tmp_path / 'less.csv', NODES * 0.0 - 1.0)}")
    with pytest.raises(BadInput):
        closed_form_material("lambert", {"kd": -1.0})
