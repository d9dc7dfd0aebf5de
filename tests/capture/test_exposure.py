"""The choice of exposures, against a sensor whose light is known."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture.bracketing import Camera, Objective, Scene
from capture.exposure import ENOUGH, Chooser, Noise, Observation, Shutter, Target
from capture.records import PoseFlag
from capture.statistics import ChannelStatistics, FrameStatistics

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

RANGE_DN = 15000.0
NOISE = Noise(gain_dn_per_e=0.5, floor_dn2=2.3)
SHUTTER = Shutter(1e-4, 60.0, 3)
TARGET = Target(snr=30.0, first_s=0.02, max_frames=4)
CHOOSER = Chooser(SHUTTER, TARGET, NOISE)
CAMERA = Camera(SHUTTER, NOISE, RANGE_DN)


def scene(
    bright_dn_s: float, dim_dn_s: float, bright_fraction: float = 0.05
) -> Callable[[float], Observation]:
    """Return a sensor before a scene of two brightnesses, in DN per second."""

    def expose(exposure_s: float) -> Observation:
        bright, dim = (min(rate * exposure_s, RANGE_DN) for rate in (bright_dn_s, dim_dn_s))
        clipped = bright_fraction * (bright >= RANGE_DN) + (1.0 - bright_fraction) * (dim >= RANGE_DN)
        channel = ChannelStatistics(dim, dim, bright, RANGE_DN, clipped)
        return Observation(exposure_s, FrameStatistics((channel,), 10_000))

    return expose


def shoot(
    sensor: Callable[[float], Observation], previous: Sequence[Observation] = (), chooser: Chooser = CHOOSER
) -> list[Observation]:
    """Return the frames that a pose gets."""
    history: list[Observation] = []
    while (exposure_s := chooser.next_exposure(history, previous)) is not None:
        history.append(sensor(exposure_s))
        assert len(history) <= chooser.target.max_frames
    return history


def test_shutter_times_are_third_stops() -> None:
    """Would catch times that drift off the ladder, or leave the camera's limits."""
    times = SHUTTER.times_s
    assert times[0] == 1e-4
    assert times[-1] <= 60.0 < times[-1] * 2 ** (1 / 3)
    for shorter, longer in itertools.pairwise(times):
        assert longer / shorter == pytest.approx(2 ** (1 / 3), rel=2e-3)
    assert SHUTTER.at_most(times[7]) == times[7]
    assert SHUTTER.at_most(times[7] * 1.1) == times[7]
    assert SHUTTER.at_most(1e-9) == times[0]
    assert SHUTTER.below(times[7]) == times[6]


def test_one_frame_when_the_prediction_is_right() -> None:
    """Would catch a second frame for nothing: it doubles the night."""
    sensor = scene(40_000.0, 30_000.0)
    previous = shoot(sensor)
    frames = shoot(sensor, previous)
    assert len(frames) == 1
    assert ENOUGH <= frames[0].statistics.brightness < 1.0
    assert CHOOSER.flags(frames) == 0


def test_a_neighbour_two_thirds_of_a_stop_away_still_needs_one_frame() -> None:
    """Would catch a prediction that aims at the very edge of the range."""
    previous = shoot(scene(40_000.0, 30_000.0))
    for factor in (0.65, 1.5):
        assert len(shoot(scene(factor * 40_000.0, factor * 30_000.0), previous)) == 1


@settings(max_examples=300, deadline=None)
@given(st.floats(1.0, 1e8), st.floats(0.01, 1.0), st.floats(0.01, 1.0), st.floats(1e-3, 1e3))
def test_no_scene_ends_with_only_clipped_frames(
    bright: float, dim_ratio: float, fraction: float, neighbour: float
) -> None:
    """Would catch a pose that is done with nothing but clipped pixels in its bright part, unflagged."""
    previous = shoot(scene(bright * neighbour, bright * neighbour, fraction))
    frames = shoot(scene(bright, bright * dim_ratio, fraction), previous)
    times = [frame.exposure_s for frame in frames]
    assert frames
    assert len(set(times)) == len(times)
    assert set(times) <= set(SHUTTER.times_s)
    flags = CHOOSER.flags(frames)
    assert bool(flags & PoseFlag.OVER_RANGE) == all(frame.clipped for frame in frames)
    if 20.0 < bright < 5e7 and 1e-2 < neighbour < 1e2:
        assert not flags & PoseFlag.OVER_RANGE


@settings(max_examples=200, deadline=None)
@given(st.floats(300.0, 1e7), st.floats(0.02, 1.0))
def test_the_dim_part_reaches_its_snr(bright: float, dim_ratio: float) -> None:
    """Would catch a dim part that stays noisy where a longer frame was possible."""
    dim = bright * dim_ratio
    frames = shoot(scene(bright, dim, 0.02), shoot(scene(bright, dim, 0.02)))
    reached = CAMERA.snr(dim, [frame.exposure_s for frame in frames])
    assert reached >= 0.8 * TARGET.snr or CHOOSER.flags(frames) & PoseFlag.NOISY
    if dim * 2.0 > NOISE.signal_dn(TARGET.snr) and dim_ratio > 0.05:
        assert not CHOOSER.flags(frames) & PoseFlag.NOISY


def test_a_wide_range_takes_a_short_and_a_long_frame() -> None:
    """Would catch a bracket that covers only one end of the range."""
    bright, dim = 1e6, 2e3
    frames = shoot(scene(bright, dim), shoot(scene(bright, dim)))
    assert 2 <= len(frames) <= 3
    assert any(not frame.clipped and frame.statistics.brightness >= 0.1 for frame in frames)
    assert CAMERA.snr(dim, [frame.exposure_s for frame in frames]) >= TARGET.snr


@pytest.mark.parametrize("objective", list(Objective))
def test_five_decades_are_seen_without_a_gap(objective: Objective) -> None:
    """Would catch a short and a long frame with a range between that neither sees well."""
    chooser = Chooser(SHUTTER, Target(30.0, 0.02, 8, objective), NOISE)
    bright, dim = 3e6, 30.0
    frames = shoot(scene(bright, dim), shoot(scene(bright, dim), chooser=chooser), chooser)

    assert len(frames) <= 5
    assert CAMERA.worst_snr(Scene(dim, bright, 30.0), [frame.exposure_s for frame in frames]) >= 29.9
    assert chooser.flags(frames) == 0


def test_flags_at_the_ends_of_the_shutter() -> None:
    """Would catch a flag that is missing where the camera's limits end the search."""
    assert CHOOSER.flags(shoot(scene(1e10, 1e10))) == PoseFlag.OVER_RANGE
    dark = shoot(scene(1.0, 0.5))
    assert CHOOSER.flags(dark) & PoseFlag.UNDER_RANGE
    assert CHOOSER.flags(dark) & PoseFlag.NOISY
    assert max(frame.exposure_s for frame in dark) == SHUTTER.times_s[-1]


def test_few_frames_end_with_a_flag_not_in_a_loop() -> None:
    """Would catch `max_frames` ignored, and a pose that ends all clipped without saying so."""
    chooser = Chooser(SHUTTER, Target(30.0, 10.0, 2), NOISE)
    frames = shoot(scene(1e8, 1e8, 1.0), chooser=chooser)
    assert len(frames) == 2
    assert chooser.flags(frames) == PoseFlag.OVER_RANGE


def test_hot_pixels_do_not_shorten_exposures() -> None:
    """Would catch a whole pose underexposed for a handful of hot pixels."""
    channel = ChannelStatistics(5000.0, 6000.0, 9000.0, RANGE_DN, 0.001)
    frame = Observation(0.1, FrameStatistics((channel,), 10_000))
    assert CHOOSER.next_exposure([frame]) is None
    assert CHOOSER.flags([frame]) == 0


def test_the_worst_channel_decides() -> None:
    """Would catch a clipped red behind a well exposed green, and a noisy blue behind both."""
    good = ChannelStatistics(6000.0, 7000.0, 9000.0, RANGE_DN, 0.0)
    clipped = ChannelStatistics(9000.0, 14000.0, 15000.0, RANGE_DN, 0.2)
    noisy = ChannelStatistics(20.0, 30.0, 60.0, RANGE_DN, 0.0)
    shorter = CHOOSER.next_exposure([Observation(0.1, FrameStatistics((good, clipped, good), 1))])
    longer = CHOOSER.next_exposure([Observation(0.1, FrameStatistics((good, good, noisy), 1))])
    assert shorter is not None
    assert longer is not None
    assert shorter < 0.1 < longer


def test_a_black_frame_asks_for_a_bounded_step() -> None:
    """Would catch a division by the nothing that a black frame shows."""
    black = ChannelStatistics(-1.0, 0.0, 0.0, RANGE_DN, 0.0)
    following = CHOOSER.next_exposure([Observation(0.02, FrameStatistics((black,), 1))])
    assert following is not None
    assert 0.02 < following <= 64 * 0.02


def test_signal_and_snr_are_inverse() -> None:
    """Would catch a wrong root: the signal told must have the ratio asked for."""
    for snr in (0.5, 3.0, 30.0, 200.0):
        assert NOISE.snr(NOISE.signal_dn(snr)) == pytest.approx(snr, rel=1e-12)
    assert NOISE.snr(-5.0) == 0.0
    assert math.isfinite(Noise().snr(1.0))
