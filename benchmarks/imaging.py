"""Merge against OpenCV's Debevec merge in the same process: speed as a ratio, error against known truth.

OpenCV gets what it needs to be exact: linear frames without a black pedestal, scaled so that they clip
where its weights end, and the true linear response. Ours carry the pedestal. Both have the same noise and
clipping. Ratios of times in one process survive a busy machine; absolute times do not.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.merge import Flag, merge
from capture.sensor import SensorModel

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

GAIN, READ_DN, CLIP, BLACK = 0.4, 3.0, 16383, 512
SENSOR = SensorModel(GAIN, READ_DN, CLIP)
TIMES = np.array([0.001, 0.004, 0.016, 0.064, 0.256, 1.024])
SCALE = 65535.0 / (CLIP - BLACK)
"""From our counts above black to the full range of sixteen bits."""

LARGE, SMALL = (4000, 6000), (1000, 1500)
ROUNDS = 3


@dataclass(frozen=True)
class Measured:
    """One merge: its seconds and its radiance in DN/s."""

    name: str
    seconds: float
    radiance: NDArray[Any]


def scene(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Smooth radiance over 4.5 decades, in DN/s: dark to just below the shortest frame's clip level."""
    rows = np.linspace(0.0, 1.0, shape[0], dtype=np.float32)[:, np.newaxis]
    cols = np.linspace(0.0, 1.0, shape[1], dtype=np.float32)[np.newaxis]
    return np.asarray(10.0 ** (2.5 + 4.5 * (0.8 * cols + 0.2 * rows)), dtype=np.float32)


def expose(radiance: NDArray[np.float32], seed: int = 0) -> list[NDArray[np.uint16]]:
    """Frames with shot and read noise on a pedestal; Gaussian shot noise is exact enough and quick."""
    rng = np.random.default_rng(seed)
    frames = []
    for exposure_s in TIMES.astype(np.float32):
        signal = radiance * exposure_s
        noise = rng.standard_normal(radiance.shape, dtype=np.float32) * np.sqrt(GAIN * signal + READ_DN**2)
        frames.append(np.clip(np.rint(signal + noise + BLACK), 0, CLIP).astype(np.uint16))
    return frames


def debevec(frames: list[NDArray[np.uint16]]) -> NDArray[np.float32]:
    """OpenCV's merge with the true response, one channel; radiance in DN/s."""
    import cv2

    response = (np.maximum(np.arange(65536, dtype=np.float32), 0.5) / SCALE).reshape(-1, 1, 1)
    merged = cv2.createMergeDebevec().process(frames, TIMES.astype(np.float32), response)
    return np.asarray(merged, dtype=np.float32)


def best_of(name: str, call: Callable[[], NDArray[Any]], rounds: int = ROUNDS) -> Measured:
    """Shortest of some runs, and the result."""
    seconds, radiance = np.inf, np.empty(0)
    for _ in range(rounds):
        start = time.perf_counter()
        radiance = call()
        seconds = min(seconds, time.perf_counter() - start)
    return Measured(name, seconds, radiance)


def contenders(radiance: NDArray[np.float32], rounds: int = ROUNDS) -> list[Measured]:
    """All merges of one scene, timed in turn."""
    frames = expose(radiance)
    above = [np.maximum(frame, BLACK) - np.float32(BLACK) for frame in frames]
    plain = [np.rint(frame * np.float32(SCALE)).astype(np.uint16) for frame in above]
    return [
        best_of("OpenCV Debevec", lambda: debevec(plain), rounds),
        best_of("gonio, Poisson", lambda: merge(frames, TIMES, dark=float(BLACK)).radiance, rounds),
        best_of("gonio, maximum likelihood", lambda: _full(frames), rounds),
    ]


def _full(frames: list[NDArray[np.uint16]]) -> NDArray[np.floating]:
    return merge(frames, TIMES, dark=float(BLACK), sensor=SENSOR).radiance


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Measure and compare; see the module."""
    large = {item.name: item for item in contenders(scene(LARGE))}
    truth = scene(SMALL)
    small = contenders(truth, rounds=1)
    reference = large["OpenCV Debevec"].seconds
    poisson, full = large["gonio, Poisson"].seconds, large["gonio, maximum likelihood"].seconds
    error = {item.name: _worst_decade_bias(item.radiance, truth) for item in small}
    large_stack = "merge of 24 MP x 6"
    rows = [
        _row(f"{large_stack}: Poisson with variance, speed over Debevec", reference / poisson, "x", 6.0),
        _row(f"{large_stack}: full likelihood, speed over Debevec", reference / full, "x", 2.0),
        _row(f"{large_stack}: full likelihood", full, "s", None),
        _row("worst bias of a decade: Debevec", 100 * error["OpenCV Debevec"], "%", None),
        _row("worst bias of a decade: Poisson", 100 * error["gonio, Poisson"], "%", 0.3, over=False),
        _row("worst bias of a decade: full", 100 * error["gonio, maximum likelihood"], "%", 0.1, over=False),
        *_honesty(truth),
    ]
    if plots is not None:
        _plot(
            plots / "imaging.png", [(item.name, large[item.name].seconds, error[item.name]) for item in small]
        )
    return rows


def _row(name: str, value: float, unit: str, target: float | None, *, over: bool = True) -> dict[str, Any]:
    ok = target is None or (value >= target if over else value <= target)
    return {"name": name, "value": float(value), "unit": unit, "target": target, "ok": bool(ok)}


def _worst_decade_bias(radiance: NDArray[Any], truth: NDArray[np.float32]) -> float:
    decade = np.floor(np.log10(truth)).astype(int)
    inside = truth < 0.9 * (CLIP - BLACK) / TIMES.min()
    ratios = [
        radiance[chosen].mean(dtype=np.float64) / truth[chosen].mean(dtype=np.float64) - 1.0
        for value in np.unique(decade)
        if np.count_nonzero(chosen := (decade == value) & inside) > 1000
    ]
    return float(np.abs(ratios).max())


def _honesty(truth: NDArray[np.float32]) -> list[dict[str, Any]]:
    radiance, variance, flags = merge(expose(truth, seed=1), TIMES, dark=float(BLACK), sensor=SENSOR)
    good = (flags & np.uint8(Flag.OVER_RANGE | Flag.NEAR_CLIPPED_USED)) == 0
    pull = ((radiance - truth) / np.sqrt(variance))[good]
    return [
        _row(
            "stated over true standard deviation, minus one",
            abs(1 / pull.std() - 1) * 100,
            "%",
            3.0,
            over=False,
        ),
        _row("pixels beyond two standard deviations", 100 * np.mean(np.abs(pull) > 2), "%", 5.0, over=False),
    ]


def _plot(path: Path, points: list[tuple[str, float, float]]) -> None:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 10}):
        figure = Figure(figsize=(6, 4), layout="constrained")
        axes = figure.add_subplot()
        for name, seconds, error in points:
            axes.loglog(seconds, 100 * error, "o", markersize=9)
            axes.annotate(name, (seconds, 100 * error), textcoords="offset points", xytext=(8, 6))
        axes.margins(0.4)
        axes.set_xlabel("seconds, 24 MP x 6 frames")
        axes.set_ylabel("worst bias of a decade / %")
        axes.grid(visible=True, which="both", alpha=0.3)
        figure.savefig(path, dpi=120)
