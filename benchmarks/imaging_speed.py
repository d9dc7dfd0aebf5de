"""Time and memory of the merge: six frames of 24 megapixels against OpenCV, and from disk against LibRaw.

Times are CPU times of one thread, as ratios of runs that follow each other: a busy machine changes both. Both
write into arrays that they had before. OpenCV gets linear frames without a pedestal, ours carry theirs and
return variance and flags. Memory is VmHWM of a process of its own, with 6, 12 and 24 files.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import capture.merge as merge_module
from benchmarks.imaging_scenes import BLACK, CLIP, SENSOR, TIMES, expose, ramp
from benchmarks.rows import row
from capture.merge import Merged, merge
from simulator.dng import DngMeta, write_dng

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

SHAPE = (4000, 6000)
ROUNDS = 5
SCALE = 65535.0 / (CLIP - BLACK)
"""From our counts above black to the full range of sixteen bits."""

CHILD = """
import sys
from capture.merge import merge
from capture.sensor import SensorModel
merge(sys.argv[2:], None, sensor=SensorModel(0.4, 3.0, 16383) if sys.argv[1] == "full" else None)
print(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1])
"""


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - nothing to draw
    """Measure; see the module."""
    frames = expose(ramp(SHAPE), SHAPE, seed=0)
    with tempfile.TemporaryDirectory() as folder:
        return [*_against_opencv(frames), *_from_disk(frames, Path(folder))]


def _cpu_s(call: Callable[[], object]) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start


def _pairs(reference: Callable[[], object], ours: Callable[[], object]) -> tuple[float, float]:
    """Median ratio of the reference's time to ours, and our median seconds."""
    reference(), ours()  # the first run of each pays for memory
    pairs = [(_cpu_s(reference), _cpu_s(ours)) for _ in range(ROUNDS)]
    return float(np.median([a / b for a, b in pairs])), float(np.median([b for _, b in pairs]))


class _Ours:
    """A merge that is run again and again into the same arrays."""

    def __init__(self, frames: Any, times: NDArray[np.float64] | None, **options: Any) -> None:
        self._frames, self._times, self._options = frames, times, options
        self._last: Merged | None = None

    def __call__(self) -> None:
        self._last = merge(self._frames, self._times, out=self._last, **self._options)


def _against_opencv(frames: list[NDArray[np.uint16]]) -> list[dict[str, Any]]:
    import cv2

    above = (np.maximum(frame, BLACK) - np.float32(BLACK) for frame in frames)
    plain = [np.rint(frame * np.float32(SCALE)).astype(np.uint16) for frame in above]
    response = (np.maximum(np.arange(65536, dtype=np.float32), 0.5) / SCALE).reshape(-1, 1, 1)
    times = TIMES.astype(np.float32)
    result = np.empty(SHAPE, np.float32)
    debevec = cv2.createMergeDebevec()
    threads, cores = merge_module.THREADS, cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        merge_module.THREADS = 1
        ratios = [
            _pairs(lambda: debevec.process(plain, times, response, result), ours)
            for ours in (
                _Ours(frames, TIMES, dark=float(BLACK)),
                _Ours(frames, TIMES, dark=float(BLACK), sensor=SENSOR),
            )
        ]
    finally:
        merge_module.THREADS = threads
        cv2.setNumThreads(cores)
    (poisson, poisson_s), (full, full_s) = ratios
    what = "merge of 24 MP x 6, one thread"
    return [
        row(f"{what}: Poisson with variance and flags, speed over Debevec", poisson, "x", 6.0, at_least=True),
        row(f"{what}: full likelihood, speed over Debevec", full, "x", 2.0, at_least=True),
        row(f"{what}: Poisson", poisson_s, "s"),
        row(f"{what}: full likelihood", full_s, "s"),
    ]


def _from_disk(frames: list[NDArray[np.uint16]], folder: Path) -> list[dict[str, Any]]:
    rows = []
    for name, lossless, options in (
        ("Poisson, uncompressed", False, {}),
        ("full, lossless", True, {"sensor": SENSOR}),
    ):
        files = []
        for index, (counts, seconds) in enumerate(zip(frames, TIMES, strict=True)):
            files.append(folder / f"{lossless:d}_{index}.dng")
            meta = DngMeta(Fraction(str(seconds)), (BLACK,) * 4, CLIP)
            write_dng(files[-1], counts, meta, lossless=lossless)
        ratio, ours_s = _pairs(lambda: _decode(files), _Ours(files, None, **options))  # noqa: B023
        rows.append(
            row(f"24 MP x 6 from disk, {name}: time over LibRaw's decoding alone", 1 / ratio, "", 1.0)
        )
        rows.append(row(f"24 MP x 6 from disk, {name}", ours_s, "s"))
        rows += [_memory(files, number, name) for number in (6, 12, 24)]
        for file in files:
            file.unlink()
    return rows


def _decode(files: list[Path]) -> None:
    import rawpy

    for file in files:
        with rawpy.imread(str(file)) as raw:
            raw.raw_image_visible.copy()


def _memory(files: list[Path], number: int, name: str) -> dict[str, Any]:
    """Most memory of a process that merges so many files; more than there are have several names."""
    named = [*files]
    links = [files[0].with_name(f"link{index}.dng") for index in range(number - len(files))]
    for index, link in enumerate(links):
        os.link(files[index % len(files)], link)
        named.append(link)
    arguments = ["full" if "full" in name else "poisson", *map(str, named)]
    done = subprocess.run(
        [sys.executable, "-c", CHILD, *arguments], capture_output=True, text=True, check=True
    )
    for link in links:
        link.unlink()
    return row(f"memory of {number} files of 24 MP, {name}", int(done.stdout) / 1e6, "GB", 1.0)
