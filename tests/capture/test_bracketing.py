"""Brackets: a frame too many, a second too much, a radiance between two frames that neither sees well."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from capture.bracketing import Camera, Objective, Scene, plan_bracket
from capture.exposure import Noise, Shutter
from capture.merge import merge
from capture.sensor import SensorModel

SENSOR = SensorModel(0.4, 3.0, 16383.0)
BLACK = 512.0
CAMERA = Camera(Shutter(1e-4, 60.0, 3), Noise.of(SENSOR), 16383.0 - BLACK)
FIVE_DECADES = Scene(30.0, 3e6, 30.0)


def ladder(camera: Camera, scene: Scene, factor: float) -> int:
    """Count the frames of a fixed ladder that begins at the longest exposure that clips nothing."""
    exposures: list[float] = []
    time = camera.limit_dn / scene.high_dn_per_s
    while camera.brightest_gap(scene, exposures) is not None:
        exposures.append(time)
        time *= factor
    return len(exposures)


def test_five_decades_in_five_frames() -> None:
    """At most 5 frames for SNR 30 over 5 decades, where ladders of 2x and 4x need 13 and 7."""
    plan = plan_bracket(FIVE_DECADES, CAMERA)

    assert plan.complete
    assert plan.worst_snr >= 30.0
    assert len(plan.exposures_s) <= 5
    assert set(plan.exposures_s) <= set(CAMERA.shutter.times_s)
    assert ladder(CAMERA, FIVE_DECADES, 2.0) >= 12
    assert ladder(CAMERA, FIVE_DECADES, 4.0) >= 7


@pytest.mark.parametrize("objective", list(Objective))
@pytest.mark.parametrize("seed", range(6))
def test_no_set_of_exposures_is_better(objective: Objective, seed: int) -> None:
    """Every set of up to four exposures from a short list is tried: none does with less."""
    rng = np.random.default_rng(seed)
    noise = Noise(float(rng.uniform(0.1, 2.0)), float(rng.uniform(1.0, 60.0)))
    camera = Camera(Shutter(1e-3, 2.0, 1), noise, float(rng.uniform(3e3, 3e4)), float(rng.uniform(0.0, 0.3)))
    low = float(10.0 ** rng.uniform(2.5, 4.0))
    scene = Scene(low, low * float(10.0 ** rng.uniform(0.0, 2.7)), float(rng.uniform(10.0, 80.0)))

    plan = plan_bracket(scene, camera, objective, max_frames=4)

    sets = itertools.chain.from_iterable(
        itertools.combinations_with_replacement(camera.shutter.times_s, number) for number in (1, 2, 3, 4)
    )
    fine = [times for times in sets if camera.brightest_gap(scene, times) is None]
    assert plan.complete == bool(fine)
    if fine and objective is Objective.FRAMES:
        assert len(plan.exposures_s) == min(map(len, fine))
    elif fine:
        assert plan.seconds == pytest.approx(min(map(camera.seconds, fine)), rel=1e-6)


def test_less_time_is_never_more() -> None:
    """The two objectives confused."""
    fewest, quickest = (plan_bracket(FIVE_DECADES, CAMERA, objective) for objective in Objective)

    assert quickest.complete
    assert quickest.seconds <= fewest.seconds
    assert len(fewest.exposures_s) <= len(quickest.exposures_s)


@pytest.mark.parametrize("objective", list(Objective))
def test_frames_taken_already_count(objective: Objective) -> None:
    """A bracket that is begun anew instead of completed; a gap between two frames that stays."""
    whole = plan_bracket(FIVE_DECADES, CAMERA, objective)
    shortest, *_, longest = whole.exposures_s

    rest = plan_bracket(FIVE_DECADES, CAMERA, objective, taken_s=(shortest, longest))

    assert rest.complete
    assert len(rest.exposures_s) <= len(whole.exposures_s) - 2
    assert plan_bracket(FIVE_DECADES, CAMERA, objective, taken_s=whole.exposures_s).exposures_s == ()


@pytest.mark.parametrize("objective", list(Objective))
def test_what_cannot_be_had_is_said(objective: Objective) -> None:
    """A plan that promises what shutter or number of frames do not allow."""
    dark = plan_bracket(Scene(0.01, 100.0, 30.0), CAMERA, objective, max_frames=3)
    bright = plan_bracket(Scene(1e4, 1e9, 30.0), CAMERA, objective)
    few = plan_bracket(FIVE_DECADES, CAMERA, objective, max_frames=2)

    assert not dark.complete
    assert not bright.complete
    assert not few.complete
    assert len(few.exposures_s) == 2
    assert few.worst_snr < 30.0


def test_merge_reaches_what_is_promised() -> None:
    """A formula that the merge does not keep: the scatter of merged radiances over the whole range."""
    plan = plan_bracket(FIVE_DECADES, CAMERA)
    radiance = np.repeat(np.geomspace(30.0, 3e6, 120)[:, np.newaxis], 2000, axis=1)
    rng = np.random.default_rng(1)
    frames = []
    for time in plan.exposures_s:
        signal = rng.poisson(np.minimum(radiance * time, 2e5) / 0.4) * 0.4 + 3.0 * rng.standard_normal(
            radiance.shape
        )
        frames.append(np.clip(np.rint(signal + BLACK), 0, 16383).astype(np.uint16))

    merged = merge(frames, plan.exposures_s, dark=BLACK, sensor=SENSOR).radiance

    snr = merged.mean(axis=1) / merged.std(axis=1)
    assert snr.min() > 0.95 * 30.0
