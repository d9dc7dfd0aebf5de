"""Merge against known truth: bias, variance, flags, and what it must not depend on."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import capture.merge as merge_module
from capture.clip import clip_levels
from capture.dark import DarkModel, subtrahend
from capture.frames import any_in_cell, as_stack
from capture.merge import Flag, merge
from capture.ratios import fit_exposures, measure_ratios
from capture.sensor import SensorModel
from rig.errors import BadInput
from simulator.dng import DngMeta, write_dng

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

GAIN, READ_DN, CLIP, BLACK = 0.4, 3.0, 16383, 512
SENSOR = SensorModel(GAIN, READ_DN, CLIP)
TIMES = np.array([0.01, 0.05, 0.25, 1.0])
SHAPE = (300, 300)


def expose(
    radiance: NDArray[np.float64] | float, times: NDArray[np.float64] = TIMES, *, seed: int = 0
) -> NDArray[np.uint16]:
    """Expose a scene (DN/s) with Poisson and read noise; returns (N, H, W)."""
    rng = np.random.default_rng(seed)
    scene = np.broadcast_to(radiance, SHAPE)
    frames = []
    for exposure_s in times:
        counts = rng.poisson(scene * exposure_s / GAIN) * GAIN + rng.normal(0, READ_DN, SHAPE) + BLACK
        frames.append(np.clip(np.rint(counts), 0, CLIP))
    return np.stack(frames).astype(np.uint16)


def flagged(flags: NDArray[np.uint8], flag: Flag) -> int:
    """Count pixels with a flag."""
    return int(np.count_nonzero(flags & np.uint8(flag)))


# 60 DN/s is SNR 11; 15 000, 15 500 and 16 000 put the longest frame inside and beyond the soft ramp.
@pytest.mark.parametrize("level", [5.0, 20.0, 60.0, 200.0, 5e3, 1.5e4, 1.55e4, 1.6e4, 3e5, 1.4e6])
def test_unbiased_with_honest_variance(level: float) -> None:
    """Would catch biased weights, a hard clip limit, or a variance that is not of the weights applied."""
    radiance, variance, flags = merge(expose(level), TIMES, dark=float(BLACK), sensor=SENSOR)
    spread = radiance.std()
    bias = radiance.mean() / level - 1.0
    tolerance = 1e-3 if level / spread > 10 else 0.02
    assert abs(bias) < tolerance + 3 * spread / level / np.sqrt(radiance.size)
    assert np.sqrt(variance.mean()) / spread == pytest.approx(1.0, abs=0.03)
    assert flagged(flags, Flag.INCONSISTENT) <= 5
    assert flagged(flags, Flag.OVER_RANGE) == 0


@pytest.mark.parametrize("level", [20.0, 200.0])
def test_reaches_the_cramer_rao_bound_where_poisson_does_not(level: float) -> None:
    """Would catch iterations that do not run: the read noise would cost up to 60 % at low signal."""
    frames = expose(level)
    full = merge(frames, TIMES, dark=float(BLACK), sensor=SENSOR).radiance.std()
    poisson = merge(frames, TIMES, dark=float(BLACK)).radiance.std()
    v = GAIN * level * TIMES + READ_DN**2 + 1 / 12
    bound = 1.0 / np.sqrt((TIMES**2 / v).sum())
    assert full == pytest.approx(bound, rel=0.02)
    assert poisson > full * (1.04 if level < 100 else 1.02)


def test_poisson_measures_its_noise_and_says_so() -> None:
    """Would catch a variance in the wrong unit where no sensor model is given, and silence about it."""
    rng = np.random.default_rng(1)
    scene = 10 ** rng.uniform(2, 4.1, SHAPE)
    merged = merge(expose(scene), TIMES, dark=float(BLACK))
    assert merged.report.estimator == "poisson"
    assert "Poisson" in merged.report.note
    assert merged.report.noise.gain_dn_per_e == pytest.approx(GAIN, rel=0.05)
    pull = (merged.radiance - scene) / np.sqrt(merged.variance)
    assert pull.std() == pytest.approx(1.0, abs=0.05)


def test_negatives_stay() -> None:
    """Would catch clipping at zero, which biases the darkest decade by 12 %."""
    radiance = merge(expose(0.0), TIMES, dark=float(BLACK), sensor=SENSOR).radiance
    assert (radiance < 0).mean() == pytest.approx(0.5, abs=0.02)
    assert abs(radiance.mean()) < 4 * radiance.std() / np.sqrt(radiance.size)


def test_over_range_keeps_the_shortest_frame_as_lower_bound() -> None:
    """Would catch clipped pixels passing as measured ones."""
    frames = np.full((2, 4, 4), 100, np.uint16)
    frames[:, 1, 1] = CLIP
    radiance, _, flags = merge(frames, [0.1, 0.4], dark=0.0, sensor=SENSOR)
    assert flags[1, 1] & Flag.OVER_RANGE
    assert radiance[1, 1] == pytest.approx(CLIP / 0.1)
    assert flagged(flags, Flag.OVER_RANGE) == 1


def test_neighbours_of_clipped_samples_are_left_out() -> None:
    """Would catch blooming: the cell's other pixels read low beside a clipped one."""
    frames = np.stack([np.full((6, 6), 2000.0), np.full((6, 6), 8000.0)])
    frames[1, 2, 2] = CLIP
    frames[0, 2, 2] = 5000.0
    frames[1, 2, 3] = frames[1, 3, 2] = frames[1, 3, 3] = 7000.0  # 12 % low
    radiance, _, flags = merge(frames, [0.1, 0.4], dark=0.0, sensor=SENSOR)
    cell = np.zeros((6, 6), bool)
    cell[2:4, 2:4] = True
    assert radiance == pytest.approx(np.where(np.arange(36).reshape(6, 6) == 14, 5e4, 2e4), rel=1e-6)
    beside = (flags & Flag.NEIGHBOUR_CLIPPED) != 0
    assert np.array_equal(beside, cell & ~(np.arange(36).reshape(6, 6) == 14))
    assert flagged(flags, Flag.NEAR_CLIPPED_USED) == 0


def test_neighbours_of_clipped_samples_are_used_where_nothing_else_tells() -> None:
    """Would catch a dim channel thrown away for its few counts in the only frames without clipping."""
    frames = np.stack([np.full((2, 2), 2.0), np.full((2, 2), 2000.0)])
    frames[:, 0, 0] = [8000.0, CLIP]
    radiance, _, flags = merge(frames, [0.001, 1.0], dark=0.0, sensor=SENSOR)
    assert radiance[1, 1] == pytest.approx(2000.0, rel=1e-3)
    assert flags[1, 1] & Flag.NEAR_CLIPPED_USED
    assert flags[1, 1] & Flag.NEIGHBOUR_CLIPPED
    assert not flags[1, 1] & Flag.OVER_RANGE


def test_moved_pixel_is_inconsistent_and_noise_is_not() -> None:
    """Would catch a chi-square without power, or with a limit that noise reaches."""
    frames = expose(3000.0)
    frames[2, 7, 9] += 300
    _, _, flags = merge(frames, TIMES, dark=float(BLACK), sensor=SENSOR)
    assert flags[7, 9] & Flag.INCONSISTENT
    assert flagged(flags, Flag.INCONSISTENT) <= 3


def test_dim_pixels_are_under_range() -> None:
    """Would catch values below their noise passing unmarked."""
    _, _, flags = merge(expose(0.05), TIMES, dark=float(BLACK), sensor=SENSOR)
    assert flagged(flags, Flag.UNDER_RANGE) / flags.size == pytest.approx(0.84, abs=0.02)


def test_dark_model_is_subtracted_with_its_variance_and_hot_pixels_flagged() -> None:
    """Would catch the darks' own noise missing from the variance (it is half of it here)."""
    rng = np.random.default_rng(5)
    darks = [np.rint(rng.normal(BLACK, READ_DN, SHAPE)).astype(np.uint16) for _ in range(8)]
    for frame in darks:
        frame[4, 4] += 900
    times = [seconds for seconds in TIMES for _ in range(2)]
    model = DarkModel.from_frames(darks, times)
    for dark in (model, DarkModel.from_frames(darks[2:], [0.2] * 3 + [2.0] * 3)):
        radiance, variance, flags = merge(expose(50.0), TIMES, dark=dark, sensor=SENSOR)
        assert flagged(flags, Flag.HOT) == 1
        assert flags[4, 4] & Flag.HOT
        ordinary = flags == 0
        assert np.sqrt(variance[ordinary].mean()) / radiance[ordinary].std() == pytest.approx(1.0, abs=0.03)


def test_clip_level_is_measured_per_position() -> None:
    """Would catch a nominal white level believed though one channel clips below it."""
    rng = np.random.default_rng(2)
    scene = 10 ** rng.uniform(2.5, 5.5, SHAPE)
    frames = expose(scene)
    frames[:, 0::2, 0::2] = np.minimum(frames[:, 0::2, 0::2], 15783)
    stack = as_stack(frames, TIMES)
    levels = clip_levels(stack, np.full((2, 2), float(BLACK)))
    assert levels.tolist() == [[15783, CLIP], [CLIP, CLIP]]
    merged = merge(frames, TIMES, dark=float(BLACK))
    good = (merged.flags & np.uint8(Flag.OVER_RANGE)) == 0
    pull = ((merged.radiance - scene) / np.sqrt(merged.variance))[good]
    assert abs(np.median(pull)) < 0.02
    assert np.abs(pull).max() < 8


@pytest.mark.parametrize("level", [30.0, 1000.0, 4000.0])
def test_uniform_scene_is_not_taken_for_clipped(level: float) -> None:
    """Would catch a flat, noise-free scene mistaken for a spike at the clip level."""
    frames = np.stack([np.full((40, 40), level * t) for t in (1, 1.02, 2, 4)]).astype(np.uint16)
    _, _, flags = merge(frames, [1.0, 1.05, 2.0, 4.1])
    assert flagged(flags, Flag.OVER_RANGE) == 0
    assert flagged(flags, Flag.NEIGHBOUR_CLIPPED) == 0


@settings(max_examples=25, deadline=None)
@given(
    rows=st.integers(1, 9),
    cols=st.integers(1, 9),
    order=st.permutations([0, 1, 2]),
    block=st.sampled_from([2, 16, 1 << 15]),
    seed=st.integers(0, 99),
)
def test_order_blocks_and_containers_do_not_matter(
    *, rows: int, cols: int, order: list[int], block: int, seed: int
) -> None:
    """Would catch a result that depends on frame order, block size, container or odd shapes."""
    rng = np.random.default_rng(seed)
    frames = rng.integers(0, 17000, (3, rows, cols)).astype(np.uint16)
    times = np.array([0.1, 0.2, 0.4])
    expected = merge(frames, times, dark=10.0, sensor=SENSOR)
    old = merge_module._BLOCK_SAMPLES
    try:
        merge_module._BLOCK_SAMPLES = block
        found = merge(
            [frames[i] for i in order], times[order], dark=np.full((rows, cols), 10.0), sensor=SENSOR
        )
    finally:
        merge_module._BLOCK_SAMPLES = old
    assert np.allclose(found.radiance, expected.radiance, rtol=1e-12, atol=1e-9)
    assert np.allclose(found.variance, expected.variance, rtol=1e-12)
    assert np.array_equal(found.flags, expected.flags)
    assert np.isfinite(found.radiance).all()
    assert (found.variance > 0).all()


def test_large_frames_in_float32_equal_float64(monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch a loss of digits in the working precision of large frames."""
    frames = expose(10 ** np.random.default_rng(3).uniform(1, 6, SHAPE))
    wide = merge(frames, TIMES, dark=float(BLACK), sensor=SENSOR)
    monkeypatch.setattr(merge_module, "WIDE_PIXELS", 0)
    narrow = merge(frames, TIMES, dark=float(BLACK), sensor=SENSOR)
    assert wide.radiance.dtype == np.float64
    assert narrow.radiance.dtype == np.float32
    assert np.all(np.abs(narrow.radiance - wide.radiance) < 0.01 * np.sqrt(wide.variance))
    assert np.allclose(narrow.variance, wide.variance, rtol=1e-3)


def test_large_files_are_merged_by_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch a seam between bands, or a streamed file merged otherwise than the same one in memory."""
    frames = expose(10 ** np.random.default_rng(3).uniform(1, 6, SHAPE))
    files = []
    for number, (counts, seconds) in enumerate(zip(frames, TIMES, strict=True)):
        meta = DngMeta(Fraction(str(seconds)), (512, 510, 514, 512), CLIP)
        files.append(tmp_path / f"{number}.dng")
        write_dng(files[-1], counts, meta, lossless=bool(number % 2))
    expected = merge(files, None, sensor=SENSOR)
    monkeypatch.setattr("capture.frames.STREAMED_PIXELS", 0)
    monkeypatch.setattr("capture.raw._MOST_BAND_ROWS", 64)
    found = merge(files, None, sensor=SENSOR)
    for one, other in zip(found, expected, strict=True):
        assert np.array_equal(one, other)


def test_chi_square_map_and_reused_arrays() -> None:
    """Would catch a map that is not of the frames' scatter, or arrays that keep flags of an earlier merge."""
    radiance = np.full(SHAPE, 5e3)
    found = merge(expose(radiance), TIMES, dark=float(BLACK), sensor=SENSOR, chi_square=True)
    assert found.chi_square is not None
    assert found.samples is not None
    assert np.all(found.samples == 4)
    assert found.chi_square.mean() == pytest.approx(3.0, abs=0.03)
    assert found.chi_square.var() == pytest.approx(6.0, abs=0.2)
    poisson = merge(expose(radiance), TIMES, dark=float(BLACK), chi_square=True)
    assert poisson.chi_square is not None
    assert poisson.chi_square.mean() == pytest.approx(3.0, abs=0.1)
    clipped = merge(expose(1e7), TIMES, dark=float(BLACK), sensor=SENSOR)
    again = merge(expose(radiance), TIMES, dark=float(BLACK), sensor=SENSOR, out=clipped)
    assert again.radiance is clipped.radiance
    assert np.array_equal(again.radiance, found.radiance)
    assert np.array_equal(again.flags, found.flags)
    assert again.chi_square is None


@pytest.mark.parametrize("dark", [float(BLACK), "model", "maps"])
@pytest.mark.parametrize("sensor", [SENSOR, None])
def test_merge_is_the_formula(dark: Any, sensor: SensorModel | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch any short cut of the blocks that changes the estimate, its variance or chi-square."""
    monkeypatch.setattr(merge_module, "_BLOCK_SAMPLES", 4 * 512 * 40)
    frames = expose(10 ** np.random.default_rng(3).uniform(1, 4.1, SHAPE))
    if dark == "maps":
        dark = [np.full(SHAPE, float(BLACK)) for _ in TIMES]
    elif dark == "model":
        darks = np.stack([expose(0.0, TIMES, seed=seed) for seed in (5, 6)]).reshape(-1, *SHAPE)
        dark = DarkModel.from_frames(darks, np.tile(TIMES * 1.3, 2))
    found = merge(frames, TIMES, dark=dark, sensor=sensor, chi_square=True)
    stack = as_stack(frames, TIMES)
    levels = subtrahend(dark, stack, sensor)
    noise, t = found.report.noise, TIMES[:, np.newaxis, np.newaxis]
    x = np.stack(
        [counts - level.astype(float) for counts, level in zip(frames, levels.level_dn, strict=True)]
    )
    floor = noise.floor_dn2 + np.array(levels.variance_dn2)[:, np.newaxis, np.newaxis]
    radiance, factor = x.sum(axis=0) / t.sum(), np.ones_like(x)
    variance = noise.gain_dn_per_e * (np.maximum(radiance, 0) + levels.rate_dn_per_s) * t + floor
    for _ in range(2 if sensor else 0):
        variance = noise.gain_dn_per_e * (np.maximum(radiance, 0) + levels.rate_dn_per_s) * t + floor
        factor = t / variance
        radiance = (factor * x).sum(axis=0) / (factor * t).sum(axis=0)
    total, (bias, both, rate) = (factor * t).sum(axis=0), levels.common_dn2
    lever = factor.sum(axis=0) / total
    expected = (factor**2 * variance).sum(axis=0) / total**2 + (bias * lever + 2 * both) * lever + rate
    chi_square = ((x - radiance * t) ** 2 / variance).sum(axis=0)
    assert np.allclose(found.radiance, radiance, rtol=1e-10, atol=1e-10)
    assert np.allclose(found.variance, expected, rtol=1e-9)
    assert found.chi_square is not None
    assert np.allclose(found.chi_square, chi_square, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("frames", "times", "named"),
    [
        (np.zeros((2, 4, 4)), [1.0], "1 exposure times for 2"),
        (np.zeros((2, 4, 4)), [1.0, 0.0], "above 0"),
        (np.zeros((2, 4, 4)), [1.0, -1.0], "above 0"),
        (np.zeros((2, 4, 4)), [1.0, np.nan], "above 0"),
        (np.zeros((2, 4, 4)), None, "no exposure time"),
        (np.zeros((2, 4, 4)), ["a", "b"], "not numbers"),
        (np.zeros((2, 4, 4, 3)), [1.0, 2.0], "4 dimensions"),
        (np.zeros((0, 4, 4)), [], "no frames"),
        ([np.zeros((4, 4)), np.zeros((4, 5))], [1.0, 2.0], "shape"),
        ([np.zeros((4, 4)), np.full((4, 4), np.nan)], [1.0, 2.0], "NaN"),
        ([np.zeros((4, 4)), np.full((4, 4), np.inf)], [1.0, 2.0], "infinite"),
        (np.zeros((2, 4, 4), complex), [1.0, 2.0], "complex"),
        (np.zeros((2, 0, 4)), [1.0, 2.0], "2-D"),
    ],
)
def test_bad_frames_are_named(frames: Any, times: Any, named: str) -> None:
    """Would catch a traceback, or broadcasting that merges something else than was meant."""
    with pytest.raises(BadInput, match=named):
        merge(frames, times)


def test_a_frame_given_twice_is_refused() -> None:
    """Would catch one frame counted as two, which halves its variance."""
    frame = np.zeros((4, 4))
    with pytest.raises(BadInput, match="twice"):
        merge([frame, frame], [1.0, 2.0])


def test_equal_exposures_are_averaged() -> None:
    """Would catch repeats refused or one of them dropped."""
    frames = expose(1000.0, np.ones(8))
    radiance, variance, _ = merge(frames, np.ones(8), dark=float(BLACK), sensor=SENSOR)
    assert radiance == pytest.approx((frames - float(BLACK)).mean(axis=0))
    assert np.sqrt(variance.mean()) / radiance.std() == pytest.approx(1.0, abs=0.03)


def test_result_unpacks_to_three_and_carries_a_report() -> None:
    """Would catch a fourth element, which breaks every caller."""
    merged = merge(expose(100.0), TIMES, sensor=SENSOR)
    radiance, variance, flags = merged
    assert radiance.shape == variance.shape == flags.shape == SHAPE
    assert merged.report.exposure_s == tuple(TIMES)


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (3, 5), (4, 7), (5, 4)])
def test_any_in_cell(shape: tuple[int, int]) -> None:
    """Would catch cells cut wrongly at odd borders."""
    mask = np.random.default_rng(0).random(shape) < 0.2
    expected = np.zeros(shape, bool)
    for row, col in np.argwhere(mask):
        expected[row // 2 * 2 : row // 2 * 2 + 2, col // 2 * 2 : col // 2 * 2 + 2] = True
    assert np.array_equal(any_in_cell(mask), expected)


def test_exposure_ratios_are_found_within_their_uncertainty() -> None:
    """Would catch a ratio biased by which samples are chosen, or an uncertainty of the wrong size."""
    true = TIMES * np.array([1.02, 0.985, 1.01, 0.99])
    pulls, errors = [], []
    for seed in range(6):
        scene = 10 ** np.random.default_rng(seed).uniform(2.5, 5.0, SHAPE)
        stack = as_stack(expose(scene, true, seed=seed), TIMES)
        dark = subtrahend(float(BLACK), stack)
        for ratio in measure_ratios(stack, dark, np.full((2, 2), float(CLIP))):
            value = true[ratio.longer] / true[ratio.shorter]
            errors.append(ratio.value / value - 1)
            pulls.append((ratio.value - value) / ratio.u)
            assert ratio.clean
    assert np.abs(errors).max() < 2e-3
    assert np.abs(np.mean(errors)) < 3e-4
    assert 0.3 < np.sqrt(np.mean(np.square(pulls))) < 1.5


def test_times_are_fitted_only_where_the_frames_refute_them() -> None:
    """Would catch noise put into times that were right, or wrong times left in."""
    scene = 10 ** np.random.default_rng(8).uniform(2.5, 5.0, SHAPE)
    for error, refuted in ((np.ones(4), False), (np.array([1.02, 1.0, 0.98, 1.01]), True)):
        stack = as_stack(expose(scene, TIMES * error, seed=4), TIMES)
        dark = subtrahend(float(BLACK), stack)
        fit = fit_exposures(stack.exposure_s, measure_ratios(stack, dark, np.full((2, 2), float(CLIP))))
        assert fit.significant == refuted
        true = TIMES * error / np.exp(np.log(error).mean())
        assert np.array(fit.exposure_s) == pytest.approx(true, rel=2e-3)
