"""Photon transfer: a biased gain, a read noise with the rounding in it, the scene taken for noise."""

from __future__ import annotations

import numpy as np
import pytest

from capture.ptc import TransferPoints, fit_transfer, light_scale, pair_points, quantisation_step
from rig.errors import BadInput
from simulator.sensor import RGGB, Sensor

CFA = np.array(RGGB)
BLACK = np.tile(np.array(Sensor(2, 2, "x").black_dn, dtype=float).reshape(2, 2), (120, 160))
FULL = 15000.0


def points_of(sensor: Sensor, pairs_each: int, *, drift: float = 0.0, seed: int = 3) -> TransferPoints:
    """Pairs of an uneven scene at 20 levels and without light; the second frame is brighter by `drift`."""
    rng = np.random.default_rng(seed)
    cols = np.linspace(0.5, 1.0, sensor.width_px)[np.newaxis, :, np.newaxis]
    scene = np.ones((sensor.height_px, 1, 1)) * cols * np.array([0.6, 1.0, 0.4])
    unit = sensor.full_well_e / (sensor.electrons_per_radiance_s * 0.1)
    parts = []
    for level in np.linspace(0.0, 1.0, 21):
        for _ in range(pairs_each):
            first, second = (
                sensor.expose(scene * unit * level * factor, 0.1, rng) for factor in (1.0, 1.0 + drift)
            )
            parts.append(pair_points(first, second, BLACK, CFA, range_dn=FULL))
    return TransferPoints.joined(parts)


@pytest.fixture(scope="module")
def sensor() -> Sensor:
    """Return a sensor without hot pixels, with unequal responses."""
    return Sensor(320, 240, "PTC", hot_fraction=0.0, prnu=0.01, dark_current_e_per_s=0.0)


def test_gain_and_read_noise_of_the_twin(sensor: Sensor) -> None:
    """Gain within 0.3 %, read noise within 2 %, both as sure as stated."""
    line = fit_transfer(points_of(sensor, 2))

    assert line.gain_dn_per_e == pytest.approx(0.5, rel=3e-3)
    assert line.read_noise_dn == pytest.approx(1.5, rel=2e-2)
    assert line.u_gain_dn_per_e < 1.2e-3 * 0.5
    assert abs(line.gain_dn_per_e - 0.5) < 4.0 * line.u_gain_dn_per_e
    assert abs(line.read_noise_dn - 1.5) < 4.0 * line.u_read_noise_dn
    assert line.reduced_chi_square == pytest.approx(1.0, abs=0.08)


def test_stated_uncertainties_match_the_scatter() -> None:
    """Uncertainties that are made up: over 60 seeds the pulls have unit scatter and no offset."""
    small = Sensor(96, 64, "PTC", hot_fraction=0.0, dark_current_e_per_s=0.0)
    black = np.tile(np.array(small.black_dn, dtype=float).reshape(2, 2), (32, 48))
    rng = np.random.default_rng(1)
    pulls = []
    for _ in range(60):
        parts = []
        for level in (0.0, 0.1, 0.3, 0.5, 0.65):
            scene = np.full((64, 96, 3), level / 0.7 * 0.99 / np.pi)
            first, second = (small.expose(scene, 0.1, rng) for _ in (0, 1))
            parts.append(pair_points(first, second, black, CFA, range_dn=FULL))
        line = fit_transfer(TransferPoints.joined(parts))
        pulls.append(
            (
                (line.gain_dn_per_e - 0.5) / line.u_gain_dn_per_e,
                (line.read_noise_dn - 1.5) / line.u_read_noise_dn,
            )
        )

    assert np.abs(np.mean(pulls, axis=0)).max() < 0.45
    assert np.std(pulls, axis=0) == pytest.approx([1.0, 1.0], abs=0.3)


def test_light_that_differs_within_a_pair_is_no_noise(sensor: Sensor) -> None:
    """2 % more light in the second frame would raise the variance at 10,000 DN by (200 DN)^2 / 2."""
    line = fit_transfer(points_of(sensor, 1, drift=0.02))

    assert line.gain_dn_per_e == pytest.approx(0.5, rel=5e-3)
    assert line.read_noise_dn == pytest.approx(1.5, rel=3e-2)


def test_scale_of_frames_without_light_is_one() -> None:
    """A ratio of two noises would be anything."""
    rng = np.random.default_rng(0)
    dark = rng.standard_normal((2, 50, 50))

    assert light_scale(dark[0], dark[1], np.ones((50, 50), dtype=bool)) == 1.0


def test_frames_of_other_shapes_are_refused() -> None:
    """A crop would be broadcast, or end in a traceback."""
    with pytest.raises(BadInput, match="pair of frames"):
        pair_points(np.zeros((4, 4)), np.zeros((1, 4)), 0.0, CFA, range_dn=100.0)


def test_frames_without_a_slope_are_refused(sensor: Sensor) -> None:
    """Darks alone have no gain; noise-free frames have none either."""
    flat = TransferPoints(
        np.full(9, 5.0), np.full(9, 25.0), np.ones(9), np.full(9, 100), np.zeros(9, dtype=int)
    )
    falling = TransferPoints(
        np.arange(9.0), np.arange(9.0) ** 2, 9.0 - np.arange(9.0), np.full(9, 100), np.zeros(9, dtype=int)
    )

    with pytest.raises(BadInput, match="9 usable points"):
        fit_transfer(flat)
    with pytest.raises(BadInput, match="does not grow"):
        fit_transfer(falling)


def test_stretched_codes_are_recognised() -> None:
    """Twelve bits stretched to fourteen have a step of 4, whose rounding is 16 times the variance."""
    assert quantisation_step(np.arange(100, dtype=np.uint16)) == 1.0
    assert quantisation_step(np.arange(100, dtype=np.uint16) * 4 + 512) == 4.0
    assert quantisation_step(np.full(7, 3)) == 1.0


@pytest.mark.parametrize("read_noise_dn", [0.25, 0.4])
def test_noise_below_a_code_is_known_no_better_than_rounding_allows(read_noise_dn: float) -> None:
    """Rounding adds anything from nothing to 1/4 DN^2 to so little noise, and the stated u would not know."""
    rng = np.random.default_rng(6)
    pulls = []
    for place in np.linspace(0.0, 0.9, 10):
        noise = rng.standard_normal((2, 240, 320)) * read_noise_dn
        dark = np.rint(500.0 + place + noise)
        light = np.rint(500.0 + place + 3000.0 + rng.standard_normal((2, 240, 320)) * np.sqrt(1500.0))
        parts = [pair_points(pair[0], pair[1], 500.0 + place, CFA, range_dn=FULL) for pair in (dark, light)]
        line = fit_transfer(TransferPoints.joined(parts))
        pulls.append((line.read_noise_dn - read_noise_dn) / line.u_read_noise_dn)

    assert np.sqrt(np.mean(np.square(pulls))) < 2.0
    assert np.abs(pulls).max() < 4.0
