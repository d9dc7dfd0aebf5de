"""The merge of whole mosaics: bands of rows, cut into blocks, shared by threads.

Large mosaics of integer counts go through compiled code (`capture.compiled`), all others through numpy
(`capture.block`), with the same results: the first merge of a process would wait for the compiled code longer
than small ones take.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from capture.block import BlockMerger, Outputs
from capture.clip import Ramp, RampLevels
from capture.flags import Flag
from capture.frames import over
from capture.mosaic import FileMosaic, SpilledMosaic

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.block import Rules
    from capture.mosaic import Mosaic

_BLOCK_COLS = 512
_MOST_BAND_BYTES = 384 * 2**20
"""Most memory for the counts of all threads' bands; files whose segments need more are unpacked first."""


@dataclass(frozen=True, eq=False)
class Source:
    """What is merged, by ascending exposure.

    Attributes
    ----------
    counts : tuple of Mosaic, each (H, W)
        The frames.
    level_dn : tuple of ndarray, each (H, W), (2, 2) or (1, 1)
        Their dark levels.
    rate_dn_per_s : ndarray, shape (H, W) or (1, 1)
        Dark signal per second.
    hot : ndarray of bool, shape (H, W), or None
        Hot pixels.
    clip_dn, black_dn : ndarray, shape (2, 2)
        Clip and black level at each position of the cell.
    """

    counts: tuple[Mosaic, ...]
    level_dn: tuple[NDArray[Any], ...]
    rate_dn_per_s: NDArray[Any]
    hot: NDArray[np.bool_] | None
    clip_dn: NDArray[np.float64]
    black_dn: NDArray[np.float64]

    def band_rows(self, least: int) -> int:
        """Rows to read at once, even and at least so many: whole segments of files that are compressed."""
        deep = max((getattr(frame, "band_rows", 1) for frame in self.counts), default=1)
        pair = math.lcm(deep, 2)
        return max(1, -(-least // pair)) * pair

    def unpacked(self) -> Source:
        """Return the same with compressed files decoded once, frame by frame, and put aside on disk."""
        counts = (
            SpilledMosaic(frame[:]) if getattr(frame, "band_rows", 1) > 1 else frame for frame in self.counts
        )
        return replace(self, counts=tuple(counts))


def merge_bands(source: Source, rules: Rules, out: Outputs, *, block_samples: int, threads: int) -> None:
    """Merge all blocks, on threads where there is more than one band of them.

    Parameters
    ----------
    source : Source
    rules : Rules
    out : Outputs
        Arrays for the whole mosaic.
    block_samples : int
        Samples of all frames together in one block; large frames of integers are cut otherwise.
    threads : int
        The most to use.
    """
    rows = out.flags.shape[0]
    kind = _RowWorker if _is_compilable(source, out) else _BlockWorker
    deep = source.band_rows(kind.least_rows(source, out, block_samples))
    if _band_bytes(source, deep) > _MOST_BAND_BYTES:
        source = source.unpacked()
        deep = source.band_rows(kind.least_rows(source, out, block_samples))
    bands = [slice(start, min(start + deep, rows)) for start in range(0, rows, deep)]
    room = max(1, _MOST_BAND_BYTES // _band_bytes(source, deep))
    workers = min(len(bands), os.cpu_count() or 1, threads, room)
    each = [kind(source, rules, out, block_samples, deep) for _ in range(workers)]

    def work(worker: int) -> None:
        for band in bands[worker::workers]:
            each[worker].merge(band)

    if workers == 1:
        work(0)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, range(workers)))


def _band_bytes(source: Source, rows: int) -> int:
    """Size of the counts of a band that come from files."""
    files = [frame for frame in source.counts if not isinstance(frame, np.ndarray)]
    return 1 + sum(rows * frame.shape[1] * frame.dtype.itemsize for frame in files)


def _is_compilable(source: Source, out: Outputs) -> bool:
    """Whether the merge is of counts in single precision, which is that of large frames."""
    counts = (np.uint8, np.uint16)
    return out.radiance.dtype == np.float32 and all(frame.dtype in counts for frame in source.counts)


class _BlockWorker:
    """Merges bands with numpy, for one thread: small frames, and counts that are no short integers."""

    def __init__(self, source: Source, rules: Rules, out: Outputs, block_samples: int, deep: int) -> None:
        cols, dtype = min(out.flags.shape[1], _BLOCK_COLS), out.radiance.dtype
        self._source, self._out = source, out
        self._block = (self.least_rows(source, out, block_samples), cols)
        ramp = Ramp(source.clip_dn, source.black_dn, self._block, dtype)
        self._merger = BlockMerger(rules, ramp, self._block, dtype)
        self._readers = [_Reader(frame, deep) for frame in source.counts]

    @staticmethod
    def least_rows(source: Source, out: Outputs, block_samples: int) -> int:
        """Rows of a block."""
        height, width = out.flags.shape
        rows, cols = int(height), min(int(width), _BLOCK_COLS)
        return min(rows, max(2, block_samples // len(source.counts) // cols // 2 * 2))

    def merge(self, band: slice) -> None:
        """Merge a band of rows, which begins at an even row."""
        frames = [reader.rows(band) for reader in self._readers]
        _merge_band(self._merger, self._block, (self._source, band, frames), _cut(self._out, band))


class _RowWorker:
    """Merges bands by compiled code, for one thread."""

    def __init__(self, source: Source, rules: Rules, out: Outputs, block_samples: int, deep: int) -> None:  # noqa: ARG002 - as the other worker
        from capture.compiled import TILE_COLS, RowMerger

        self._source, self._out = source, out
        self._merger = RowMerger(rules, RampLevels.of(source.clip_dn, source.black_dn))
        self._counts = np.empty((len(source.counts), deep, out.flags.shape[1]), np.uint16)
        self._tile = (2, TILE_COLS)

    @staticmethod
    def least_rows(source: Source, out: Outputs, block_samples: int) -> int:
        """Rows whose counts fit the cache as a block's buffers do."""
        samples = len(source.counts) * int(out.flags.shape[1])
        return max(2, 4 * block_samples // samples // 2 * 2)

    def merge(self, band: slice) -> None:
        """Merge a band of rows, which begins at an even row."""
        source, rows = self._source, band.stop - band.start
        counts = self._counts[:, :rows] if rows < self._counts.shape[1] else self._counts
        for frame, place in zip(source.counts, counts, strict=True):
            _read(frame, band, place)
        levels = [self._level(level, band) for level in source.level_dn]
        out = _cut(self._out, band)
        rate = self._level(source.rate_dn_per_s, band)
        self._merger.merge(np.ascontiguousarray(counts), np.stack(levels), rate, out)
        _mark_hot(source, band, out)

    def _level(self, level: NDArray[Any], band: slice) -> NDArray[np.float32]:
        """Level of the rows of a band, or, where all cells have the same, of one tile."""
        if level.shape == (1, 1):
            return np.full(self._tile, level.item(), np.float32)
        values = over(level, self._tile) if level.shape == (2, 2) else level[band]
        return np.ascontiguousarray(values, np.float32)


def _mark_hot(source: Source, band: slice, out: Outputs) -> None:
    if source.hot is not None:
        out.flags[:] |= source.hot[band].view(np.uint8) * np.uint8(Flag.HOT)


def _read(frame: Mosaic, band: slice, place: NDArray[Any]) -> None:
    """Put the rows of a frame in their place, without a copy where its file holds them as they are."""
    if isinstance(frame, FileMosaic) and frame.dtype == place.dtype:
        frame.read(band.start, place)
    else:
        place[:] = frame[band]


class _Reader:
    """Rows of one frame; those of a file go into the same buffer again and again."""

    def __init__(self, frame: Mosaic, most_rows: int) -> None:
        self._frame = frame
        self._buffer = (
            np.empty((most_rows, frame.shape[1]), frame.dtype) if isinstance(frame, FileMosaic) else None
        )

    def rows(self, band: slice) -> NDArray[Any]:
        if isinstance(self._frame, FileMosaic) and self._buffer is not None:
            return self._frame.read(band.start, self._buffer[: band.stop - band.start])
        return self._frame[band]


def _merge_band(
    merger: BlockMerger,
    block: tuple[int, int],
    what: tuple[Source, slice, list[NDArray[Any]]],
    out: Outputs,
) -> None:
    """Merge the blocks of a band of rows, which begins at an even row."""
    source, band, frames = what
    dtype = out.radiance.dtype
    levels = [_Level.of(level, band, block, dtype) for level in source.level_dn]
    rate = _Level.of(source.rate_dn_per_s, band, block, dtype)
    height, width = out.flags.shape
    for top in range(0, height, block[0]):
        for left in range(0, width, block[1]):
            place = (slice(top, min(top + block[0], height)), slice(left, min(left + block[1], width)))
            merger.merge(
                [frame[place] for frame in frames],
                [level.part(place) for level in levels],
                rate.part(place),
                _cut(out, place),
            )
    _mark_hot(source, band, out)


def _cut(out: Outputs, place: slice | tuple[slice, slice]) -> Outputs:
    parts: list[Any] = [None if values is None else values[place] for values in out]
    return Outputs(*parts)


class _Level(NamedTuple):
    """A level over a band of rows: its values, or those of a block where all blocks have the same."""

    values: NDArray[Any]
    repeats: bool

    @classmethod
    def of(cls, level: NDArray[Any], band: slice, block: tuple[int, int], dtype: np.dtype[Any]) -> _Level:
        """Cut a band from a level of shape (H, W), or spread one of (2, 2) over a block."""
        repeats = level.shape in {(1, 1), (2, 2)}
        values = over(level, block) if repeats else level[band]
        return cls(values.astype(dtype, copy=False), repeats)

    def part(self, place: tuple[slice, slice]) -> NDArray[Any]:
        """Values at the pixels of a block, shape (1, 1) where they are all the same."""
        if not self.repeats:
            return self.values[place]
        rows, cols = (slice(0, where.stop - where.start) for where in place)
        return self.values if self.values.size == 1 else self.values[rows, cols]
