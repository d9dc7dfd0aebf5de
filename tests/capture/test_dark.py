"""Dark model: bias, rate and hot pixels from known darks, and what a merge subtracts."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from capture.dark import DarkModel, subtrahend
from capture.frames import as_stack
from capture.merge import merge
from capture.sensor import SensorModel
from rig.errors import BadInput

if TYPE_CHECKING:
    from numpy.typing import NDArray

BLACK = np.tile(np.array([[512.0, 516.0], [508.0, 520.0]]), (40, 50))
SIGMA_DN = 2.0


def dark_frames(
    times: tuple[float, ...], number: int, rate: NDArray[np.float64] | float, seed: int = 0
) -> tuple[list[NDArray[np.uint16]], list[float]]:
    """Draw dark frames of a known bias and rate."""
    rng = np.random.default_rng(seed)
    frames, seconds = [], []
    for exposure_s in times:
        for _ in range(number):
            level = BLACK + rate * exposure_s
            frames.append(np.rint(level + rng.normal(0, SIGMA_DN, BLACK.shape)).astype(np.uint16))
            seconds.append(exposure_s)
    return frames, seconds


def test_bias_and_rate_are_found_with_the_stated_variance() -> None:
    """Would catch a wrong least-squares weight, or a covariance that is not the estimate's own."""
    rate = np.full(BLACK.shape, 3.0)
    dark = DarkModel.from_frames(*dark_frames((0.1, 1.0, 4.0), 8, rate))
    noise = SIGMA_DN**2 + 1 / 12
    assert dark.noise_variance_dn2 == pytest.approx(noise, rel=0.03)
    for found, true, variance in (
        (dark.bias_dn, BLACK, dark.covariance[0, 0]),
        (dark.rate_dn_per_s, rate, dark.covariance[1, 1]),
    ):
        error = found - true
        assert abs(error.mean()) < 4 * np.sqrt(noise * variance / error.size)
        assert error.var() == pytest.approx(noise * variance, rel=0.1)


def test_hot_pixels_by_rate_and_by_noise_and_no_others() -> None:
    """Would catch a hot pixel missed, the four black levels taken for outliers, or noise called hot."""
    rate = np.full(BLACK.shape, 0.5)
    hot = [(3, 4), (10, 11), (79, 99), (0, 0)]
    for place in hot:
        rate[place] = 60.0
    frames, seconds = dark_frames((0.1, 0.5, 2.0), 6, rate)
    flicker = (20, 20)
    for index, frame in enumerate(frames):
        frame[flicker] = 520 + 25 * (-1) ** index
    found = DarkModel.from_frames(frames, seconds).hot
    assert {tuple(int(i) for i in place) for place in np.argwhere(found)} == {*hot, flicker}


def test_matched_darks_are_used_as_they_are() -> None:
    """Would catch darks that are not linear in time being forced onto a line though they were shot."""
    frames, seconds = dark_frames((0.1, 0.5, 2.0), 2, 0.0)
    for frame, exposure_s in zip(frames, seconds, strict=True):
        frame[5, 5] = 600 + 300 * np.sqrt(exposure_s)
    dark = DarkModel.from_frames(frames, seconds)
    stack = as_stack(np.full((2, *BLACK.shape), 900, np.uint16), [2.0, 0.5])
    levels = subtrahend(dark, stack)
    assert levels.matched
    assert levels.level_dn[0][5, 5] == pytest.approx(int(600 + 300 * np.sqrt(2.0)))
    assert levels.level_dn[1][5, 5] == pytest.approx(int(600 + 300 * np.sqrt(0.5)))
    assert levels.variance_dn2 == pytest.approx([dark.noise_variance_dn2 / 2] * 2)


def test_other_exposures_are_interpolated_with_a_shared_uncertainty() -> None:
    """Would catch the darks' error counted as independent between frames that share it."""
    dark = DarkModel.from_frames(*dark_frames((0.1, 2.0), 4, 2.0))
    levels = subtrahend(dark, as_stack(np.full((2, *BLACK.shape), 900, np.uint16), [0.3, 1.0]))
    assert not levels.matched
    assert np.mean(levels.level_dn[1] - BLACK) == pytest.approx(2.0, abs=0.05)
    assert levels.variance_dn2 == (0.0, 0.0)
    assert levels.common_dn2[0] == pytest.approx(dark.noise_variance_dn2 * dark.covariance[0, 0])


@pytest.mark.parametrize(
    ("dark", "expected"),
    [(500.0, 500.0), (np.full((80, 100), 510.0), 510.0), ([500.0, 520.0], 520.0)],
)
def test_given_levels(dark: object, expected: float) -> None:
    """Would catch one level per frame taken for a mosaic, or the other way round."""
    stack = as_stack(np.full((2, 80, 100), 900, np.uint16), [0.1, 0.2])
    assert np.all(subtrahend(dark, stack).level_dn[1] == expected)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "dark",
    [
        np.zeros((3, 80, 100)),
        np.zeros((80, 99)),
        np.zeros(3),
        np.full((80, 100), np.nan),
        [np.zeros((80, 100)), np.zeros((80, 99))],
        "x",
    ],
)
def test_darks_that_do_not_fit_are_refused(dark: object) -> None:
    """Would catch broadcasting that subtracts something else than was meant, or a traceback."""
    stack = as_stack(np.full((2, 80, 100), 900, np.uint16), [0.1, 0.2])
    with pytest.raises(BadInput):
        subtrahend(dark, stack)  # type: ignore[arg-type]


def test_darks_of_one_exposure_serve_as_bias_only_below_it() -> None:
    """Would catch darks of a long exposure subtracted from short frames without a word."""
    stack = as_stack(np.full((2, *BLACK.shape), 900, np.uint16), [0.1, 0.2])
    bias = DarkModel.from_frames(*dark_frames((0.0,), 4, 0.0))
    assert np.mean(subtrahend(bias, stack).level_dn[0] - BLACK) == pytest.approx(0.0, abs=0.1)
    long = DarkModel.from_frames(*dark_frames((5.0,), 4, 0.0))
    with pytest.raises(BadInput, match="5 s"):
        subtrahend(long, stack)


def test_dark_frames_are_checked() -> None:
    """Would catch darks of another crop, without times, or none at all ending in a traceback."""
    frames, seconds = dark_frames((0.1,), 2, 0.0)
    for bad_frames, bad_seconds in (
        ([], None),
        (frames, None),
        (frames, [0.1]),
        (frames, [0.1, -1.0]),
        ([frames[0], frames[1][:-1]], seconds),
        ([frames[0] * np.nan, frames[1]], seconds),
    ):
        with pytest.raises(BadInput):
            DarkModel.from_frames(bad_frames, bad_seconds)


def test_coarse_counts_make_no_pixel_hot() -> None:
    """Means of eight frames lie on a grid of 1/8 DN, and so does their median distance: a third too short."""
    rng = np.random.default_rng(4)
    frames = [np.rint(128.0 + 0.71 * rng.standard_normal((400, 600))) for _ in range(8)]

    assert not DarkModel.from_frames(frames, [10.0] * 8).hot.any()


@pytest.mark.parametrize(("noise_dn", "quiet"), [(0.05, True), (0.8, False)])
def test_cut_counts_are_not_half_a_step_low(noise_dn: float, quiet: bool) -> None:
    """Would catch cut counts taken for rounded ones, or the half step added where darks are as low."""
    rng, shape, level, black, times = np.random.default_rng(4), (200, 200), 3.3, 8.1, [1.0, 4.0]
    signal = [rng.poisson(level * t / 0.05, shape) * 0.05 for t in times]
    noise = [rng.normal(0.0, noise_dn, shape) for _ in range(8)]
    frames = [np.floor(s + n + black).astype(np.uint16) for s, n in zip(signal, noise[:2], strict=True)]
    darks = [np.floor(n + black).astype(np.uint16) for n in noise[2:]]
    dark = DarkModel.from_frames(darks, [1.0, 1.0, 1.0, 4.0, 4.0, 4.0])
    cut = SensorModel(0.05, noise_dn, 255, truncated=True)
    rounded = replace(cut, truncated=False)
    found, plain = (float(merge(frames, times, dark=dark, sensor=s).radiance.mean()) for s in (cut, rounded))
    # Quiet darks tell their level to a step only: here it is 0.1 DN above the code.
    assert found == pytest.approx(level, abs=0.06)
    assert (found - plain > 0.15) == quiet
    stated = float(merge(frames, times, dark=black, sensor=cut).radiance.mean())
    assert stated == pytest.approx(level, abs=0.03)
