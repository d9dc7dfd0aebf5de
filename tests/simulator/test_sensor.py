"""The sensor's statistics are those of its own calibration."""

from __future__ import annotations

import numpy as np
import pytest

from simulator.sensor import NOMINAL_EXPOSURE_S, NOMINAL_RADIANCE, RGGB, Sensor, derived_seed

SENSOR = Sensor(128, 96, serial="A1", seed=3)
WHITE = np.full((96, 128, 3), NOMINAL_RADIANCE)


def rng(*fields: object) -> np.random.Generator:
    """Noise of a test's own."""
    return np.random.default_rng(derived_seed("test", *fields))


def black(sensor: Sensor) -> np.ndarray:
    """Black level of each pixel."""
    return np.tile(np.reshape(sensor.black_dn, (2, 2)), (48, 64)).astype(float)


@pytest.mark.parametrize("bits", [14, 12])
def test_white_fills_the_stated_part_of_the_well(bits: int) -> None:
    """Would catch a wrong responsivity, or a gain that does not follow the converter's depth."""
    sensor = Sensor(128, 96, serial="A1", bits=bits)
    light = sensor.expose(WHITE, NOMINAL_EXPOSURE_S, rng(bits)) - black(sensor)
    assert np.median(light) == pytest.approx(0.7 * sensor.full_well_e * sensor.gain_dn_per_e, rel=1e-3)
    assert light.max() < 2**bits


def test_noise_follows_the_calibration_it_writes() -> None:
    """Would catch a calibration file that disagrees with the frames, in gain or in read noise."""
    model = SENSOR.calibration()
    for exposure_s in (1e-5, 1e-3, 0.05):
        pair = [SENSOR.expose(WHITE, exposure_s, rng(exposure_s, shot)).astype(float) for shot in range(2)]
        variance = np.var(pair[0] - pair[1]) / 2.0
        signal = np.mean(pair[0] - black(SENSOR))
        expected = model.gain_dn_per_e * signal + model.floor_variance_dn2
        # Twelve thousand samples know a variance to 1.3 %.
        assert variance == pytest.approx(expected, rel=0.05)


def test_every_channel_goes_through_its_own_filter() -> None:
    """Would catch a mosaic that is shifted by a row, or red and blue exchanged."""
    radiance = np.broadcast_to([1.0, 2.0, 3.0], (96, 128, 3))
    picked = SENSOR.mosaic(radiance)
    for row in range(2):
        for col in range(2):
            assert np.all(picked[row::2, col::2] == RGGB[row][col] + 1.0)
    odd = Sensor(101, 33, serial="odd")
    assert odd.expose(np.ones((33, 101, 3)), 1e-3, rng()).shape == (33, 101)


def test_dark_frames_collect_dark_current_for_as_long_as_the_shutter_is_open() -> None:
    """Would catch dark current that ignores the shutter, hot pixels without heat."""
    hot = SENSOR.dark_rate_e_per_s > 100.0
    assert 0.0002 < hot.mean() < 0.003
    frame = SENSOR.expose(None, 1e-3, rng(1), shutter_open_s=20.0) - black(SENSOR)
    assert np.mean(frame[~hot]) == pytest.approx(0.5 * 20.0 * SENSOR.gain_dn_per_e, abs=0.1)
    assert np.all(frame[hot] > 0.9 * 200.0 * 20.0 * SENSOR.gain_dn_per_e)
    short = SENSOR.expose(None, 1e-3, rng(2)) - black(SENSOR)
    assert np.mean(short) == pytest.approx(0.0, abs=0.1)


def test_too_much_light_reaches_the_clip_level_in_every_pixel() -> None:
    """Would catch a stated clip level that clipped counts can stay below."""
    frame = SENSOR.expose(WHITE * 1e12, 600.0, rng(3))
    assert frame.min() >= SENSOR.clip_dn
    assert frame.max() <= SENSOR.largest_dn
    assert SENSOR.clip_dn < 16383


def test_a_camera_is_the_same_camera_each_time_it_is_switched_on() -> None:
    """Would catch a fixed pattern that changes between frames or is shared by different cameras."""
    again, other = Sensor(128, 96, serial="A1", seed=3), Sensor(128, 96, serial="A2", seed=3)
    assert np.array_equal(SENSOR.response, again.response)
    assert np.array_equal(SENSOR.dark_rate_e_per_s, again.dark_rate_e_per_s)
    assert not np.array_equal(SENSOR.response, other.response)
    assert np.std(SENSOR.response) == pytest.approx(0.005, rel=0.05)


def test_seeds_depend_on_every_field() -> None:
    """Would catch requests that share their noise because fields run together."""
    seeds = [derived_seed(*f) for f in (("a", 1), ("a1",), ("a", "1"), ("a", 1.0), ("a", (1,)), ("a", None))]
    assert len(set(seeds)) == len(seeds)
    assert derived_seed("a", 1) == derived_seed("a", 1)
