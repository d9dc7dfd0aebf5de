"""A sensor from its own frames: wrong gain, missed hot pixels, a clip level off, spoiled frames used."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
import pytest

from capture.characterise import SensorCharacter, characterise
from capture.sensor import SensorModel, load_sensor, save_sensor
from capture.sensor_doubts import doubts_in_use, doubts_of, require_camera
from capture.sensor_frames import raw_files, sort_frames
from rig.errors import BadInput, Refused
from simulator.dng import DngMeta, exact_seconds, write_dng
from simulator.sensor import Sensor

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

WIDTH, HEIGHT = 448, 320
FULL_S = 0.1 / 0.7
FLATS_S = (*(FULL_S * part for part in (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)), 4 * FULL_S)
DARKS_S = (0.001, 1.0, 10.0)


@dataclass(frozen=True)
class Studio:
    """A twin's sensor that writes darks and flats of a white plate into a folder."""

    sensor: Sensor
    folder: Path

    def shoot(self, name: str, exposure_s: float, light: float, rng: np.random.Generator) -> Path:
        """Write one frame that states its exposure, and whose name alone says what it is."""
        scene = None if light == 0.0 else light * plate()
        counts = self.sensor.expose(scene, exposure_s, rng)
        meta = DngMeta(
            shutter_s=exact_seconds(exposure_s),
            black_dn=self.sensor.black_dn,
            white_dn=int(self.sensor.clip_dn),
            serial=self.sensor.serial,
        )
        path = self.folder / f"{name}.dng"
        write_dng(path, counts, meta)
        return path

    def shoot_all(self) -> None:
        """Shoot eight darks of each exposure, four flats."""
        rng = np.random.default_rng(11)
        for level, exposure_s in enumerate(DARKS_S):
            for number in range(8):
                self.shoot(f"dark-{level}-{number}", exposure_s, 0.0, rng)
        for level, exposure_s in enumerate(FLATS_S):
            for number in range(4):
                self.shoot(f"flat-{level:02}-{number}", exposure_s, 1.0, rng)


def plate() -> NDArray[np.float64]:
    """Return a white disc on black, shaded, in three colours."""
    rows, cols = np.mgrid[-1.0 : 1.0 : HEIGHT * 1j, -1.0 : 1.0 : WIDTH * 1j]
    disc = (1.0 - 0.15 * rows**2 + 0.05 * cols) * (np.hypot(rows, cols) < 1.1)
    return np.asarray(0.95 / np.pi * disc[..., np.newaxis] * np.array([0.9, 1.0, 0.7]))


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Studio:
    """Return a studio with all its frames shot."""
    made = Studio(
        Sensor(WIDTH, HEIGHT, "CAM-1", seed=4, hot_fraction=0.002), tmp_path_factory.mktemp("frames")
    )
    made.shoot_all()
    return made


@pytest.fixture(scope="module")
def character(studio: Studio) -> SensorCharacter:
    """Return what the frames say of the sensor."""
    return characterise(sort_frames(raw_files(studio.folder), studio.folder))


@pytest.fixture
def spoiled(studio: Studio, tmp_path: Path) -> Studio:
    """Return a copy of the frames to spoil."""
    shutil.copytree(studio.folder, tmp_path / "frames")
    return replace(studio, folder=tmp_path / "frames")


def test_gain_read_noise_and_dark_current(character: SensorCharacter) -> None:
    """Gain within 0.3 %, read noise and dark current within 2 %, the latter by its noise within 10 %."""
    line = character.transfer

    assert line.gain_dn_per_e == pytest.approx(0.5, rel=3e-3)
    assert line.read_noise_dn == pytest.approx(1.5, rel=2e-2)
    assert [each.gain_dn_per_e for each in character.transfer_of] == pytest.approx([0.5] * 3, rel=1e-2)
    assert character.dark_current_dn_per_s == pytest.approx(0.25, rel=2e-2)
    assert character.dark_current_by_variance_e_per_s == pytest.approx(0.5, rel=0.1)
    assert doubts_of(character) == []


def test_hot_pixels_are_the_hot_ones(studio: Studio, character: SensorCharacter) -> None:
    """Precision and recall of at least 0.99."""
    hot = studio.sensor.dark_rate_e_per_s > studio.sensor.dark_current_e_per_s
    both = np.count_nonzero(hot & character.dark.hot)

    assert both >= 0.99 * np.count_nonzero(character.dark.hot)
    assert both >= 0.99 * np.count_nonzero(hot) > 100


def test_clip_of_each_channel(studio: Studio, character: SensorCharacter) -> None:
    """Clip level exact to 1 DN: the full well of the channel's position less six read noises."""
    sensor = studio.sensor
    red, green, other_green, blue = sensor.black_dn
    full_dn = sensor.gain_dn_per_e * (sensor.full_well_e - 6.0 * sensor.read_noise_e)
    truth = np.array([red, min(green, other_green), blue]) + full_dn

    assert np.abs(np.array(character.clip_dn) - truth).max() <= 1.0
    assert min(character.clip_dn) == pytest.approx(sensor.clip_dn, abs=1.0)
    assert character.saturation_e == pytest.approx(sensor.full_well_e, rel=3e-3)


def test_linearity_inequality_and_threshold(studio: Studio, character: SensorCharacter) -> None:
    """A linear sensor that is called bent, noise that passes for PRNU."""
    assert max(each.error for each in character.linearity) < 1e-3
    assert character.prnu == pytest.approx(studio.sensor.prnu, rel=0.05)
    assert character.dsnu_dn < 0.15
    read_e = np.sqrt(1.5**2 + 1 / 12) / 0.5
    assert character.threshold_e == pytest.approx(np.sqrt(read_e**2 + 0.25) + 0.5, rel=0.02)


def test_calibration_file_keeps_what_was_found(character: SensorCharacter, tmp_path: Path) -> None:
    """A value that the file loses, or an uncertainty that nobody can read back."""
    model = character.model(date="2026-01-02T03:04:05+00:00", lamp_temperature_deg_c=24.5)
    save_sensor(model, tmp_path / "sensor.toml")

    assert load_sensor(tmp_path / "sensor.toml") == model
    assert model.camera_serial == "CAM-1"
    assert model.iso == 100
    assert model.u_gain_dn_per_e is not None
    assert len(model.clip_dn) == 3  # type: ignore[arg-type]


@pytest.mark.parametrize("light", [1e-4, 1e-2])
def test_dark_frame_with_light_is_named(spoiled: Studio, light: float) -> None:
    """A door ajar during one long dark: 1e-4 of the flats' light, 7 DN, or much."""
    spoiled.shoot("dark-2-3", DARKS_S[2], light, np.random.default_rng(0))

    with pytest.raises(BadInput, match="light in it") as caught:
        characterise(sort_frames(raw_files(spoiled.folder), spoiled.folder))
    assert "dark-2-3" in str(caught.value)


def test_light_in_all_darks_is_named(spoiled: Studio) -> None:
    """Light in every dark of one exposure, where no dark of that exposure is there to compare."""
    rng = np.random.default_rng(0)
    for number in range(8):
        spoiled.shoot(f"dark-2-{number}", DARKS_S[2], 1e-4, rng)

    with pytest.raises(BadInput, match="light in it"):
        characterise(sort_frames(raw_files(spoiled.folder), spoiled.folder))


def test_frame_of_another_camera_or_iso_is_named(spoiled: Studio) -> None:
    """Two cameras averaged into one, or two gains."""
    meta = DngMeta(exact_seconds(0.1), spoiled.sensor.black_dn, 15499, serial="CAM-1", iso=400)
    counts = np.full((HEIGHT, WIDTH), 700, dtype=np.uint16)
    write_dng(spoiled.folder / "flat-05-1.dng", counts, meta)
    with pytest.raises(BadInput, match=r"another ISO.*400.*not 100") as caught:
        sort_frames(raw_files(spoiled.folder), spoiled.folder)
    assert "flat-05-1" in str(caught.value)

    write_dng(spoiled.folder / "flat-05-1.dng", counts, replace(meta, iso=100, serial="CAM-2"))
    with pytest.raises(BadInput, match=r"another camera.*CAM-2"):
        sort_frames(raw_files(spoiled.folder), spoiled.folder)


def test_missing_kinds_of_frames_are_named(spoiled: Studio, tmp_path: Path) -> None:
    """Darks taken for flats, an empty folder, a typing error: a traceback, or numbers of nothing."""
    darks = [path for path in raw_files(spoiled.folder) if path.name.startswith("dark")]
    flats = [path for path in raw_files(spoiled.folder) if path.name.startswith("flat")]
    with pytest.raises(BadInput, match="no flat frames"):
        sort_frames(darks)
    with pytest.raises(BadInput, match="no dark frames"):
        sort_frames(flats)
    with pytest.raises(BadInput, match="no dark frames"):
        sort_frames([])
    with pytest.raises(BadInput, match="no such folder"):
        raw_files(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadInput, match="no RAW files"):
        raw_files(tmp_path / "empty")
    with pytest.raises(BadInput, match="equally bright"):
        characterise(sort_frames([*darks, *flats[:2]]))


def test_unsaturated_frames_leave_the_clip_level_in_doubt(studio: Studio) -> None:
    """The files' white level would pass for a measured one."""
    files = [path for path in raw_files(studio.folder) if not path.name.startswith("flat-10")]

    found = characterise(sort_frames(files))

    assert found.saturation is None
    assert found.clip_dn == (studio.sensor.clip_dn,) * 3
    assert any("clip level" in doubt for doubt in doubts_of(found))


def test_age_temperature_and_camera_are_checked_in_use() -> None:
    """A calibration of years ago, of another season or of another camera is used without a word."""
    made = SensorModel(
        0.5, 1.5, 15000.0, camera_serial="A", iso=100, date="2026-01-01T00:00:00+00:00",
        lamp_temperature_deg_c=20.0,
    )  # fmt: skip
    soon, late = datetime(2026, 6, 1, tzinfo=UTC), datetime(2027, 6, 1, tzinfo=UTC)

    assert doubts_in_use(made, now=soon, lamp_temperature_deg_c=22.0) == []
    assert "516 days old" in doubts_in_use(made, now=late)[0]
    assert "+15 K" in doubts_in_use(made, now=soon, lamp_temperature_deg_c=35.0)[0]
    assert "future" in doubts_in_use(made, now=datetime(2025, 6, 1, tzinfo=UTC))[0]
    assert doubts_in_use(replace(made, date="last summer"), now=late) == []
    require_camera(made, "A", None, "sensor.toml")
    require_camera(replace(made, camera_serial=None), "B", 100.0, "sensor.toml")
    with pytest.raises(Refused, match="camera A, in use is B"):
        require_camera(made, "B", 100.0, "sensor.toml")
    with pytest.raises(Refused, match="ISO 100, in use is 400"):
        require_camera(made, "A", 400.0, "sensor.toml")


def test_a_bend_is_found_and_a_straight_response_stays_straight(
    character: SensorCharacter, tmp_path: Path
) -> None:
    """Would catch a bend of the wrong sign or size, and one that is read into noise."""
    straight = character.bend
    assert straight is not None
    assert (
        np.abs(straight.of(np.array([0.2, 0.5, 0.9]) * straight.range_dn) - 1.0).max()
        < 4.0 * straight.error
        < 0.004
    )

    bent = Studio(Sensor(WIDTH, HEIGHT, "CAM-1", seed=4, bend=0.03), tmp_path)
    bent.shoot_all()
    found = characterise(sort_frames(raw_files(bent.folder), bent.folder))
    truth, model = bent.sensor.calibration().response, found.model().response
    assert truth is not None
    assert model == found.bend
    assert model is not None
    signal = np.array([0.1, 0.3, 0.6, 0.85]) * truth.range_dn
    np.testing.assert_allclose(model.of(signal), truth.of(signal), atol=4.0 * model.error)
    assert model.error < 0.001
    save_sensor(found.model(), tmp_path / "sensor.toml")
    assert load_sensor(tmp_path / "sensor.toml").response == model
