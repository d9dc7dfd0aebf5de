"""The merge of whole mosaics: bands of rows, cut into blocks, shared by threads."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from capture.block import BlockMerger, Outputs
from capture.clip import Ramp
from capture.flags import Flag
from capture.frames import over
from capture.mosaic import FileMosaic

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from capture.block import Rules
    from capture.mosaic import Mosaic

_BLOCK_COLS = 512


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
    band_rows : callable
        Rows to read at once, for a least number of them.
    """

    counts: tuple[Mosaic, ...]
    level_dn: tuple[NDArray[Any], ...]
    rate_dn_per_s: NDArray[Any]
    hot: NDArray[np.bool_] | None
    clip_dn: NDArray[np.float64]
    black_dn: NDArray[np.float64]
    band_rows: Callable[[int], int]


def merge_bands(source: Source, rules: Rules, out: Outputs, *, block_samples: int, threads: int) -> None:
    """Merge all blocks, on threads where there is more than one band of them.

    Parameters
    ----------
    source : Source
    rules : Rules
    out : Outputs
        Arrays for the whole mosaic.
    block_samples : int
        Samples of all frames together in one block.
    threads : int
        The most to use.
    """
    rows, cols = out.flags.shape
    dtype = out.radiance.dtype
    wide = min(cols, _BLOCK_COLS)
    block = (min(rows, max(2, block_samples // len(source.counts) // wide // 2 * 2)), wide)
    ramp = Ramp(source.clip_dn, source.black_dn, block, dtype)
    deep = source.band_rows(block[0])
    bands = [slice(start, min(start + deep, rows)) for start in range(0, rows, deep)]
    workers = min(len(bands), os.cpu_count() or 1, threads)

    def work(part: list[slice]) -> None:
        merger = BlockMerger(rules, ramp, block, dtype)
        readers = [_Reader(frame, deep) for frame in source.counts]
        for band in part:
            frames = [reader.rows(band) for reader in readers]
            _merge_band(merger, block, (source, band, frames), _cut(out, band))

    if workers == 1:
        work(bands)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, [bands[worker::workers] for worker in range(workers)]))


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
    if source.hot is not None:
        out.flags[:] |= source.hot[band].view(np.uint8) * np.uint8(Flag.HOT)


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
