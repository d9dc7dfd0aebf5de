"""Exposure ratios from the frames, against times that are wrong by up to 3 %, on simulated frames.

A scene of smooth light over three decades with unequal gains by colour; Poisson's noise, read noise, rounding
and clipping. The merge takes fitted times where the frames refute the stated ones, and leaves right ones
alone; the reduced chi-square of the merge tells whether that was an improvement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.imaging_scenes import BLACK, CLIP, GAIN, READ_DN, SENSOR
from benchmarks.rows import row
from capture.clip import clip_levels
from capture.dark import black_cell, subtrahend
from capture.frames import as_stack, tile
from capture.merge import merge
from capture.ratios import fit_exposures, measure_ratios

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

SHAPE = (600, 800)
STATED_S = np.array([0.004, 0.016, 0.064, 0.256])
SESSIONS = 12
COLOURS = np.array([[0.55, 1.0], [1.0, 0.65]])


@dataclass(frozen=True)
class Session:
    """One bracket: true errors of the times, and what was found."""

    errors: NDArray[np.float64]
    found: NDArray[np.float64]
    u: NDArray[np.float64]
    used: bool
    chi_square: tuple[float, float]


def session(seed: int, largest_error: float) -> Session:
    """Shoot and measure one bracket."""
    rng = np.random.default_rng(seed)
    rows, cols = (np.linspace(0.0, 1.0, size) for size in SHAPE)
    light = 10.0 ** (3.6 + 2.4 * (0.7 * cols[np.newaxis] + 0.3 * rows[:, np.newaxis])) * tile(COLOURS, SHAPE)
    light *= 1.0 + 0.01 * rng.standard_normal(SHAPE)
    errors = 1.0 + largest_error * rng.uniform(-1.0, 1.0, STATED_S.size)
    frames = []
    for seconds in STATED_S * errors:
        counts = rng.poisson(light * seconds / GAIN) * GAIN + rng.normal(BLACK, READ_DN, SHAPE)
        frames.append(np.clip(np.rint(counts), 0, CLIP).astype(np.uint16))
    stack = as_stack(frames, STATED_S)
    dark = subtrahend(float(BLACK), stack)
    ratios = measure_ratios(stack, dark, clip_levels(stack, black_cell(dark), SENSOR))
    fit = fit_exposures(stack.exposure_s, ratios)
    disagreement = []
    for times in (stack.exposure_s, fit.exposure_s):
        merged = merge(frames, times, dark=float(BLACK), sensor=SENSOR, chi_square=True)
        if merged.chi_square is None or merged.samples is None:
            raise RuntimeError("the map of chi-square was asked for")
        several = merged.samples > 1
        disagreement.append(float((merged.chi_square[several] / (merged.samples[several] - 1.0)).mean()))
    return Session(
        errors=errors[1:] / errors[:-1],
        found=np.array([ratio.value / ratio.nominal for ratio in ratios]),
        u=np.array([ratio.u / ratio.nominal for ratio in ratios]),
        used=fit.significant,
        chi_square=(disagreement[0], disagreement[1]),
    )


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - nothing to draw
    """Measure brackets with wrong and with right times."""
    wrong = [session(seed, 0.03) for seed in range(SESSIONS)]
    right = [session(seed, 0.0) for seed in range(SESSIONS, 2 * SESSIONS)]
    errors = np.concatenate([each.found / each.errors - 1.0 for each in wrong])
    pulls = errors * np.concatenate([each.errors / each.u for each in wrong])
    worst_left = max(each.chi_square[1] for each in wrong)
    return [
        row("times wrong by up to 3 %: worst error of a ratio", 100.0 * np.abs(errors).max(), "%", 0.05),
        row("rms of the errors over their stated uncertainty", float(np.sqrt(np.mean(pulls**2))), "", 1.5),
        row("wrong times refuted", np.mean([each.used for each in wrong]), "", 1.0, at_least=True),
        row("right times refuted", np.mean([each.used for each in right]), "", 0.0),
        row("reduced chi-square with stated times, median", np.median([e.chi_square[0] for e in wrong])),
        row("reduced chi-square with fitted times, worst", worst_left, "", 1.05),
    ]
