"""Pixels' inequality and saturation: noise over time, shading or edges that pass for it, a clip level off."""

from __future__ import annotations

import numpy as np
import pytest

from capture.saturation import measure_saturation
from capture.uniformity import dark_unevenness_dn, relative_unevenness
from simulator.sensor import RGGB, Sensor

SHAPE = (192, 256)
NOMINAL = 0.99 / np.pi


def test_unequal_responses_without_noise_shading_or_edges() -> None:
    """Shot noise of a frame is twice the PRNU, the shading 50 times, and the plate has an edge."""
    sensor = Sensor(SHAPE[1], SHAPE[0], "PRNU", prnu=0.004, hot_fraction=0.0)
    rng = np.random.default_rng(5)
    rows, cols = np.mgrid[-1 : 1 : SHAPE[0] * 1j, -1 : 1 : SHAPE[1] * 1j]
    shading = (1.0 - 0.2 * rows**2 - 0.1 * cols) * (np.hypot(rows, cols) < 1.0)
    scene = NOMINAL * 0.7 * shading[..., np.newaxis] * np.array([0.9, 1.0, 0.8])
    black = np.tile(np.reshape(sensor.black_dn, (2, 2)), (SHAPE[0] // 2, SHAPE[1] // 2))
    pair = [sensor.expose(scene, 0.1, rng) - black.astype(float) for _ in (0, 1)]

    found = relative_unevenness(*pair, np.ones(SHAPE, dtype=bool))

    inner = sensor.response[shading > 0.0].std()
    assert found == pytest.approx(inner, rel=0.06)


def test_unequal_darks_without_noise_and_hot_pixels() -> None:
    """Read noise of a mean of two frames is as large as the inequality, and hot pixels 1,000 times."""
    rng = np.random.default_rng(8)
    level = 500.0 + 0.7 * rng.standard_normal(SHAPE)
    hot = rng.random(SHAPE) < 0.003
    level[hot] += 700.0
    first, second = (level + rng.standard_normal(SHAPE) for _ in (0, 1))

    assert dark_unevenness_dn(first, second, ~hot) == pytest.approx(0.7, rel=0.04)
    assert dark_unevenness_dn(first - level, second - level, ~hot) < 0.15


def test_frames_smaller_than_a_tile_have_no_answer() -> None:
    """A crash, or a zero, where nothing can be said."""
    assert np.isnan(relative_unevenness(np.ones((8, 8)), np.ones((8, 8)), np.ones((8, 8), dtype=bool)))


@pytest.mark.parametrize(("well_e", "converter"), [(30000.0, False), (40000.0, True)])
def test_saturation_of_each_position(well_e: float, converter: bool) -> None:
    """Clip level to 1 DN, where the well is full first and where the converter ends first."""
    sensor = Sensor(SHAPE[1], SHAPE[0], "SAT", full_well_e=well_e)
    rng = np.random.default_rng(2)
    scene = np.full((*SHAPE, 3), NOMINAL)
    black = np.tile(np.reshape(sensor.black_dn, (2, 2)), (SHAPE[0] // 2, SHAPE[1] // 2))
    short, over = sensor.expose(scene, 0.05, rng), sensor.expose(scene, 0.4, rng)

    found = measure_saturation(over, (short - black.astype(float)) / 0.05, black, 0.4)

    full = np.reshape(sensor.black_dn, (2, 2)) + sensor.gain_dn_per_e * well_e
    noise = sensor.gain_dn_per_e * sensor.read_noise_e
    truth = np.full((2, 2), 16383.0) if converter else full
    assert np.abs(found.level_dn - truth).max() < (1e-9 if converter else 0.1)
    assert np.abs(found.clip_dn - (truth if converter else full - 6 * noise)).max() <= 1.0
    clips = found.clip_of_channels(RGGB, 3)
    assert clips[1] == found.clip_dn[np.array(RGGB) == 1].min()


def test_ordinary_frames_show_no_saturation() -> None:
    """The brightest pixels of a frame that does not clip would pass for a clip level."""
    rng = np.random.default_rng(3)
    frame = 1000.0 + rng.standard_normal(SHAPE)

    found = measure_saturation(frame, np.full(SHAPE, 1000.0), 0.0, 1.0)

    assert np.isnan(found.level_dn).all()
    assert not found.pixels.any()
