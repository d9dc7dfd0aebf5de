"""Error of the merge against light, beside the least that the same samples allow.

At each level many pixels see the same light. The bound is the variance of the best linear estimate from the
samples that the merge admits, with the weights that the ramp towards the clip level gives them (Cramer-Rao
for Gaussian noise of known variance); what the ramp costs is told against the bound of all samples that are
not clipped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.imaging_scenes import BLACK, CLIP, GAIN, READ_DN, SENSOR, TIMES, expose, ramp
from benchmarks.rows import row
from capture.clip import CLIPPED, RAMP_END, RAMP_START, Ramp
from capture.frames import any_in_cell
from capture.merge import Flag, merge

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

BRACKET_S = np.array([0.01, 0.05, 0.25, 1.0])
SHAPE = (800, 800)
FLOOR_DN2 = READ_DN**2 + 1.0 / 12.0
SPAN = CLIP - BLACK


@dataclass(frozen=True)
class Level:
    """One level of light: what the merge made of it.

    `bias` and `scatter` are relative; `efficiency` is that of the weights applied, `of_all` that against all
    samples that are not clipped; `stated` is the stated over the true standard deviation; `near` tells
    whether a frame of the bracket is on its ramp here.
    """

    radiance: float
    snr: float
    bias: float
    u_bias: float
    scatter: float
    efficiency: float
    of_all: float
    stated: float
    near: bool


def levels() -> NDArray[np.float64]:
    """Levels from a signal-to-noise ratio of 2 to the shortest frame's clip level, closer on the ramps."""
    even = np.geomspace(1.0, 0.88 * SPAN / BRACKET_S[0], 200)
    even = even[[bound(level, BRACKET_S) ** -0.5 * level >= 2.0 for level in even]][::10]
    parts = np.array([RAMP_START, 0.92, 0.935, 0.95, RAMP_END, CLIPPED])
    return np.sort(np.concatenate([even, *(parts * SPAN / seconds for seconds in BRACKET_S[1:])]))


def bound(radiance: float, times: NDArray[np.float64]) -> float:
    """Least variance from samples of these times."""
    return float(1.0 / np.sum(times**2 / (GAIN * radiance * times + FLOOR_DN2)))


def measure(radiance: float, seed: int, *, full: bool) -> Level:
    """Merge many pixels of one level."""
    frames = expose(radiance, SHAPE, seed=seed, times=BRACKET_S, exact=True)
    merged = merge(frames, BRACKET_S, dark=float(BLACK), sensor=SENSOR if full else None)
    admitted = (merged.flags & np.uint8(Flag.OVER_RANGE | Flag.NEAR_CLIPPED_USED)) == 0
    estimate = merged.radiance[admitted]
    variance = float(estimate.var())
    unclipped = BRACKET_S[BRACKET_S * radiance < SPAN]
    on_ramp = any(0.85 * SPAN < radiance * seconds < 1.03 * SPAN for seconds in BRACKET_S)
    return Level(
        radiance=radiance,
        snr=radiance / variance**0.5,
        bias=float(estimate.mean() / radiance - 1.0),
        u_bias=float(variance**0.5 / radiance / estimate.size**0.5),
        scatter=variance**0.5 / radiance,
        efficiency=float(_of_weights(frames, radiance)[admitted].mean()) / variance,
        of_all=bound(radiance, unclipped) / variance,
        stated=float(np.sqrt(merged.variance[admitted].mean()) / variance**0.5),
        near=on_ramp,
    )


def _of_weights(frames: list[NDArray[np.uint16]], radiance: float) -> NDArray[np.float64]:
    """Variance of the best estimate with the weights that the ramp gives these samples."""
    weights = Ramp(np.full((2, 2), float(CLIP)), np.full((2, 2), float(BLACK)), SHAPE, np.dtype(np.float64))
    top, bottom = np.zeros(SHAPE), np.full(SHAPE, 1e-300)
    for counts, seconds in zip(frames, BRACKET_S, strict=True):
        values = counts.astype(np.float64)
        weight = weights.weights(values) * ~any_in_cell(weights.clipped(values))
        information = seconds**2 / (GAIN * radiance * seconds + FLOOR_DN2)
        top += weight**2 * information
        bottom += weight * information
    return np.asarray(top / bottom**2)


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Measure all levels with both estimators; see the module."""
    full = [measure(float(level), seed, full=True) for seed, level in enumerate(levels())]
    poisson = [measure(float(level), seed, full=False) for seed, level in enumerate(levels())]
    bright = [level for level in full if level.snr > 10.0]
    away = [level for level in bright if not level.near]
    ratios = [level.stated for level in full]
    own = stated_by_poisson()
    rows = [
        row(
            "full likelihood: least efficiency",
            min(each.efficiency for each in full),
            "",
            0.97,
            at_least=True,
        ),
        row("full likelihood: largest bias above SNR 10", _worst_bias(bright), "%", 0.08),
        row("full likelihood: largest bias away from the ramps", _worst_bias(away), "%", 0.03),
        row("its Monte Carlo uncertainty, largest", 100.0 * max(each.u_bias for each in away), "%"),
        row("stated over true sigma, least", min(ratios), "", 0.97, at_least=True),
        row("stated over true sigma, largest", max(ratios), "", 1.03),
        row("least efficiency against all unclipped samples (the ramp's cost)", min(e.of_all for e in full)),
        row("Poisson: least efficiency", min(each.efficiency for each in poisson)),
        row("Poisson: largest bias above SNR 10", _worst_bias([e for e in poisson if e.snr > 10.0]), "%"),
        row(
            "Poisson, gain from the frames: stated over true sigma, least", min(own), "", 0.97, at_least=True
        ),
        row("Poisson, gain from the frames: stated over true sigma, largest", max(own), "", 1.03),
    ]
    if plots is not None:
        _plot(plots / "merge.png", full, poisson)
    return rows


def stated_by_poisson() -> list[float]:
    """Stated over true sigma for each half decade of a scene, where only the frames tell the gain."""
    truth = ramp(SHAPE)
    radiance, variance, flags = merge(expose(truth, SHAPE, seed=1, exact=True), TIMES, dark=float(BLACK))
    good = (flags & np.uint8(Flag.OVER_RANGE | Flag.NEAR_CLIPPED_USED)) == 0
    pull = (radiance - truth) / np.sqrt(variance)
    half_decade = np.floor(2.0 * np.log10(truth))
    bins = [good & (half_decade == value) for value in np.unique(half_decade)]
    return [float(1.0 / pull[chosen].std()) for chosen in bins if np.count_nonzero(chosen) > 5000]


def _worst_bias(some: list[Level]) -> float:
    return 100.0 * max(abs(level.bias) for level in some)


def _plot(path: Path, full: list[Level], poisson: list[Level]) -> None:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(7, 7.5), layout="constrained")
        axes = figure.subplots(3, 1, sharex=True)
        for found, name, colour in ((full, "full likelihood", "C0"), (poisson, "Poisson", "C1")):
            light = [level.radiance for level in found]
            axes[0].semilogx(light, [level.efficiency for level in found], ".-", color=colour, label=name)
            axes[0].semilogx(light, [level.of_all for level in found], ":", color=colour)
            axes[1].errorbar(
                light,
                [100.0 * level.bias for level in found],
                [200.0 * level.u_bias for level in found],
                fmt=".-",
                color=colour,
            )
        # One level of light does not tell the gain: without a sensor model sigma is shown by scenes only.
        axes[2].semilogx([e.radiance for e in full], [e.stated for e in full], ".-", color="C0")
        axes[0].set_ylim(0.0, 1.15)
        axes[0].set_ylabel("efficiency (dotted: of all\nunclipped samples)")
        axes[0].legend()
        axes[1].set_ylabel("bias / %")
        axes[1].set_ylim(-0.3, 0.3)
        axes[2].set_ylabel("stated over true sigma")
        axes[2].set_xlabel("light / (DN/s)")
        for each in axes:
            each.grid(visible=True, which="major", alpha=0.3)
        figure.savefig(path, dpi=120)
