"""Merges of one stack side by side: ours, OpenCV's Debevec and Robertson, colour-hdri where it is installed.

A simulated scene of six decades with known truth, and a Flea3 bracket, where each frame judges the merge of
the others by its samples of 60 to 240 DN. The peers get what suits them best: linear counts without a
pedestal that reach the end of their range, and the true response; Robertson's reads eight bits only. Times
are CPU times of one thread for a megapixel and frame; ours works in double precision at this size.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

import capture.merge as merge_module
from benchmarks.imaging_flea3 import DATA, SCENES
from benchmarks.imaging_scenes import BLACK, CLIP, SENSOR, TIMES, expose, ramp
from benchmarks.rows import row
from capture.agreement import RANGE
from capture.dark import DarkModel
from capture.merge import merge
from capture.raw import read_raw

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

SHAPE = (1000, 1500)
ROUNDS = 3


@dataclass(frozen=True)
class Stack:
    """Frames with a pedestal, and without it from 0 to 1 for those who cannot take one."""

    frames: list[NDArray[np.uint16]]
    above: list[NDArray[np.float32]]
    times: NDArray[np.float64]
    span_dn: float


@dataclass(frozen=True)
class Result:
    """One merge: radiance in DN/s and CPU seconds for a megapixel of one frame."""

    name: str
    radiance: NDArray[Any]
    seconds: float


def simulated() -> tuple[Stack, NDArray[np.float32]]:
    """Make the scene; return its truth too."""
    truth = ramp(SHAPE, low=1.0)
    frames = expose(truth, SHAPE, seed=0)
    span = float(CLIP - BLACK)
    above = [np.clip((frame - np.float32(BLACK)) / np.float32(span), 0.0, 1.0) for frame in frames]
    return Stack(frames, above, TIMES, span), truth


def flea3() -> tuple[Stack, DarkModel]:
    """Read the disks at 450 nm, with the darks of the day."""
    frames = [read_raw(path) for path in sorted((DATA / "disks").glob("*_450nm_*"))]
    darks = sorted((DATA / "dark").glob(f"{SCENES['disks']}_*"))
    names = [float(path.name.split("_")[2].removesuffix("ms")) / 1000.0 for path in darks]
    dark = DarkModel.from_frames([read_raw(path) for path in darks], names)
    times = np.array([frame.exposure_s or 0.0 for frame in frames])
    above = []
    for frame, seconds in zip(frames, times, strict=True):
        index = dark.index_of(float(seconds))
        level = dark.mean_dn[0 if index is None else index]
        above.append(np.clip((frame.counts - level) / np.float32(255.0), 0.0, 1.0).astype(np.float32))
    return Stack([frame.counts for frame in frames], above, times, 255.0), dark


def contenders(stack: Stack, rounds: int = ROUNDS, **ours: Any) -> list[Result]:
    """Merge a stack with everything there is."""
    import cv2

    threads, cores = merge_module.THREADS, cv2.getNumThreads()
    cv2.setNumThreads(1)
    merge_module.THREADS = 1
    full = {**ours, "sensor": SENSOR} if stack.span_dn > 255.0 else ours
    calls: dict[str, Callable[[], NDArray[Any]]] = {
        "OpenCV Debevec": _debevec(stack),
        "OpenCV Robertson": _robertson(stack),
        "gonio, Poisson": lambda: merge(stack.frames, stack.times, **ours).radiance,
    }
    if full is not ours:
        calls["gonio, full likelihood"] = lambda: merge(stack.frames, stack.times, **full).radiance
    colour = _colour_hdri(stack)
    if colour is not None:
        calls["colour-hdri"] = colour
    try:
        return [_timed(name, call, stack, rounds) for name, call in calls.items()]
    finally:
        merge_module.THREADS = threads
        cv2.setNumThreads(cores)


def _timed(name: str, call: Callable[[], NDArray[Any]], stack: Stack, rounds: int) -> Result:
    best, radiance = np.inf, np.empty(0)
    for _ in range(rounds):
        start = time.process_time()
        radiance = call()
        best = min(best, time.process_time() - start)
    return Result(name, np.asarray(radiance, np.float64), best / (radiance.size * len(stack.frames) / 1e6))


def _debevec(stack: Stack) -> Callable[[], NDArray[Any]]:
    import cv2

    plain = [np.rint(frame * 65535.0).astype(np.uint16) for frame in stack.above]
    scale = np.float32(stack.span_dn / 65535.0)
    response = (np.maximum(np.arange(65536, dtype=np.float32), 0.5) * scale).reshape(-1, 1, 1)
    times = stack.times.astype(np.float32)
    return lambda: cv2.createMergeDebevec().process(plain, times, response)


def _robertson(stack: Stack) -> Callable[[], NDArray[Any]]:
    """One of its three channels, which it wants; a third of the time is counted."""
    import cv2

    plain = [np.repeat(np.rint(frame * 255.0).astype(np.uint8)[..., None], 3, 2) for frame in stack.above]
    scale = np.float32(stack.span_dn / 255.0)
    response = np.repeat(np.arange(256, dtype=np.float32).reshape(-1, 1, 1) * scale, 3, 2)
    times = stack.times.astype(np.float32)
    return lambda: cv2.createMergeRobertson().process(plain, times, response)[..., 0]


def _colour_hdri(stack: Stack) -> Callable[[], NDArray[Any]] | None:
    try:
        import colour_hdri
    except ImportError:
        return None
    scale = stack.span_dn / float(np.squeeze(colour_hdri.average_luminance(1.0, 1.0, 100.0)))

    def call() -> NDArray[Any]:
        images = colour_hdri.ImageStack()  # the merge empties it
        for frame, seconds in zip(stack.above, stack.times, strict=True):
            settings = colour_hdri.Metadata(np.array([1.0]), np.array([seconds]), np.array([100.0]))
            images.append(colour_hdri.Image(data=frame[..., np.newaxis], metadata=settings))
        return np.asarray(colour_hdri.image_stack_to_HDRI(images)[..., 0] * scale)

    return call


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Merge both stacks; see the module."""
    stack, truth = simulated()
    results = contenders(stack, dark=float(BLACK))
    rows = []
    for each in results:
        ours = each.name.startswith("gonio")
        rows += [
            row(
                f"simulated, {each.name}: worst bias of a half decade",
                _worst(each, truth),
                "%",
                0.3 if ours else None,
            ),
            row(f"simulated, {each.name}: median error", _median_error(each, truth), "%"),
            row(f"simulated, {each.name}: time for a megapixel and frame", 1e3 * each.seconds, "ms"),
        ]
    if DATA.is_dir():
        real, dark = flea3()
        rows += [
            row(f"Flea3 disks 450 nm, {name}: frame against the merge of the others", value, "%")
            for name, value in _left_out(real, dark).items()
        ]
    if plots is not None:
        _plot(plots / "peers.png", results, truth)
    return rows


def _bins(truth: NDArray[np.float32]) -> list[tuple[float, NDArray[np.bool_]]]:
    """Half decades of light below the shortest frame's clip level."""
    place = np.floor(2.0 * np.log10(truth))
    inside = truth < 0.9 * (CLIP - BLACK) / TIMES.min()
    return [(float(10.0 ** (value / 2 + 0.25)), inside & (place == value)) for value in np.unique(place)]


def _biases(result: Result, truth: NDArray[np.float32]) -> tuple[list[float], list[float]]:
    light, bias = [], []
    for middle, chosen in _bins(truth):
        if np.count_nonzero(chosen) > 5000:
            light.append(middle)
            bias.append(float((result.radiance[chosen] / truth[chosen]).mean() - 1.0))
    return light, bias


def _worst(result: Result, truth: NDArray[np.float32]) -> float:
    return 100.0 * max(abs(bias) for bias in _biases(result, truth)[1])


def _median_error(result: Result, truth: NDArray[np.float32]) -> float:
    inside = truth < 0.9 * (CLIP - BLACK) / TIMES.min()
    return 100.0 * float(np.median(np.abs(result.radiance[inside] / truth[inside] - 1.0)))


def _left_out(stack: Stack, dark: DarkModel) -> dict[str, float]:
    """Median of |sample / merge of the other frames - 1|, in percent."""
    deviations: dict[str, list[NDArray[Any]]] = {}
    for out in range(1, len(stack.frames)):
        kept = [index for index in range(len(stack.frames)) if index != out]
        others = Stack(
            [stack.frames[index] for index in kept],
            [stack.above[index] for index in kept],
            stack.times[kept],
            stack.span_dn,
        )
        frame = stack.frames[out]
        chosen = (frame >= RANGE[0] * 255.0) & (frame <= RANGE[1] * 255.0)
        for each in contenders(others, rounds=1, dark=dark):
            predicted = each.radiance[chosen] * stack.times[out]
            ratio = stack.above[out][chosen] * stack.span_dn / np.maximum(predicted, 1e-9)
            deviations.setdefault(each.name, []).append(np.abs(ratio - 1.0))
    return {name: 100.0 * float(np.median(np.concatenate(parts))) for name, parts in deviations.items()}


def _plot(path: Path, results: list[Result], truth: NDArray[np.float32]) -> None:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(9, 3.8), layout="constrained")
        left, right = figure.subplots(1, 2)
        for each in results:
            light, bias = _biases(each, truth)
            (line,) = left.loglog(light, 100.0 * np.abs(bias), ".-", label=each.name)
            right.loglog(
                1e3 * each.seconds, _worst(each, truth), "o", color=line.get_color(), label=each.name
            )
        left.set_xlabel("light / (DN/s)")
        left.set_ylabel("|bias| of a half decade / %")
        left.legend(fontsize=7)
        right.set_xlabel("CPU time for a megapixel and frame / ms")
        right.set_ylabel("worst bias of a half decade / %")
        for axes in (left, right):
            axes.grid(visible=True, which="major", alpha=0.3)
        figure.savefig(path, dpi=120)
