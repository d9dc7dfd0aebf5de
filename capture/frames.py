"""The frames of one pose as one checked stack, whatever they came as: arrays, RAW frames or files."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.raw import PathLike, RawFrame, RawHead, StreamedFrame, open_raw
from rig.errors import BadInput

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.mosaic import Mosaic

FrameLike = RawFrame | StreamedFrame | PathLike | np.ndarray
"""One frame: read already or opened, a file, or a 2-D array of counts."""

Frames = Sequence[FrameLike] | np.ndarray
"""Several frames: a sequence of `FrameLike`, or an array of shape (N, H, W) or (H, W)."""


@dataclass(frozen=True, eq=False)
class Stack:
    """Frames of one scene by one camera, same shape, finite, each with an exposure time above 0.

    Attributes
    ----------
    counts : tuple of Mosaic, each of shape (H, W)
        As delivered, black included, in DN; large files stay on disk and are cut by rows.
    exposure_s : tuple of float
        Exposure times, same order.
    cfa : ndarray of int, shape (2, 2), or None
        Channel index per position of the 2 x 2 cell; None for plain arrays.
    channels : tuple of str
        Names of the channels; empty for plain arrays.
    black_dn : ndarray of float, shape (2, 2), or None
        Black level per position; None for plain arrays.
    white_dn : float
        Nominal clip level, black included; infinite for floating-point arrays.
    quantisation_step_dn : float
        1 for integer counts, 0 for floating-point ones.
    names : tuple of str
        What to call each frame in a message.
    """

    counts: tuple[Mosaic, ...]
    exposure_s: tuple[float, ...]
    cfa: NDArray[np.int64] | None
    channels: tuple[str, ...]
    black_dn: NDArray[np.float64] | None
    white_dn: float
    quantisation_step_dn: float
    names: tuple[str, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self.counts[0].shape
        return height, width

    @property
    def shortest(self) -> tuple[int, ...]:
        """Indices of the frames of the shortest exposure."""
        limit = min(self.exposure_s) * (1.0 + 1e-9)
        return tuple(index for index, seconds in enumerate(self.exposure_s) if seconds <= limit)

    def thinned(self, step: int) -> Stack:
        """Return the same stack with one in `step` of its pieces, in memory; see `thin`."""
        return replace(self, counts=tuple(thin(frame, step) for frame in self.counts))

    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Return all counts, in memory."""
        return tuple(frame[:] for frame in self.counts)


STREAMED_PIXELS = 4_000_000
"""Files with more pixels are read by rows while they are merged."""

BAND_ROWS, BAND_COLS = 16, 128
"""Size of the pieces by which a large mosaic is sampled."""


def thinning(shape: tuple[int, int], pixels: int) -> int:
    """Step for `thin` that leaves about `pixels` pixels of a mosaic."""
    return max(1, round(shape[0] * shape[1] / pixels))


def thin(frame: Mosaic, step: int) -> NDArray[Any]:
    """Keep one in `step` of the pieces of a mosaic, so that 2 x 2 cells stay whole.

    A (1, 1) array, which stands for a constant mosaic, stays as it is.
    """
    rows, cols = frame.shape
    down, across = rows // BAND_ROWS, cols // BAND_COLS
    if step == 1 or down < 2:
        return frame[:]
    wide = 1 if across < 2 else min(across, max(1, round(math.sqrt(step * across / down))))
    deep = min(down, max(1, round(step / wide)))
    bands = [frame[top * BAND_ROWS : (top + 1) * BAND_ROWS] for top in range(deep // 2, down, deep)]
    if wide > 1:
        bands = [
            band[:, : across * BAND_COLS].reshape(BAND_ROWS, across, BAND_COLS)[:, wide // 2 :: wide]
            for band in bands
        ]
    return np.concatenate([band.reshape(BAND_ROWS, -1) for band in bands])


def as_stack(frames: Frames, exposure_s: float | Sequence[float] | np.ndarray | None = None) -> Stack:
    """Check frames and put them into one stack.

    Parameters
    ----------
    frames : sequence of 2-D arrays, RawFrames or paths; or ndarray of shape (N, H, W) or (H, W)
        The frames, in any order of exposure.
    exposure_s : float or sequence of float, optional
        Exposure times in seconds, same order; None where the frames carry them.

    Returns
    -------
    Stack

    Raises
    ------
    BadInput
        No frames; shapes, cameras, CFAs, ISO settings or apertures that differ; NaN or infinite counts; a
        frame given twice; exposure times that are missing, not above 0, or of another number than the frames.
    """
    items = [_settled(frame) for frame in _listed(frames)]
    names = tuple(
        str(item.path) if isinstance(item, RawHead) else f"frame {n}" for n, item in enumerate(items)
    )
    raws = [item for item in items if isinstance(item, RawFrame | StreamedFrame)]
    if raws and len(raws) != len(items):
        raise BadInput("RAW frames and plain arrays are mixed", todo="give one kind")
    _refuse_twins(items, names)
    counts = tuple(
        item.counts if isinstance(item, RawFrame | StreamedFrame) else np.asarray(item) for item in items
    )
    _check_counts(counts, names)
    times = _times(exposure_s, raws, len(items), names)
    integer = all(np.issubdtype(frame.dtype, np.integer) for frame in counts)
    if not raws:
        white = float(max(np.iinfo(frame.dtype).max for frame in counts)) if integer else math.inf
        return Stack(counts, times, None, (), None, white, float(integer), names)
    _check_same_camera(raws)
    first = raws[0]
    return Stack(counts, times, first.cfa, first.channels, first.black_dn, first.white_dn, 1.0, names)


def _settled(frame: FrameLike) -> RawHead | NDArray[Any]:
    """Open a file; read it if it is small, leave the counts of a large one on disk."""
    if isinstance(frame, str | os.PathLike):
        frame = open_raw(frame)
    if not isinstance(frame, StreamedFrame) or math.prod(frame.counts.shape) > STREAMED_PIXELS:
        return frame
    head = {item.name: getattr(frame, item.name) for item in fields(RawHead)}
    return RawFrame(counts=frame.counts[:].astype(np.uint16, copy=False), **head)


def _listed(frames: Frames) -> list[FrameLike]:
    if isinstance(frames, str | os.PathLike | RawFrame):
        frames = [frames]
    if isinstance(frames, np.ndarray):
        if frames.ndim == 2:
            frames = frames[np.newaxis]
        if frames.ndim != 3:
            what = f"the frames are an array of {frames.ndim} dimensions"
            raise BadInput(what, todo="give (N, H, W): mosaics are merged before colours are interpolated")
    items = list(frames)
    if not items:
        raise BadInput("no frames", todo="give at least one")
    return items


def _refuse_twins(items: list[Any], names: tuple[str, ...]) -> None:
    for index, item in enumerate(items):
        for other in range(index):
            same_array = isinstance(item, np.ndarray) and item is items[other]
            same_file = isinstance(item, RawHead) and item.path.resolve() == items[other].path.resolve()
            same_shot = (
                isinstance(item, RawHead)
                and item.shot_id is not None
                and item.shot_id == items[other].shot_id
            )
            if same_array or same_file or same_shot:
                what = "the same frame is given twice" + (f" (shot {item.shot_id})" if same_shot else "")
                raise BadInput(what, where=names[index], todo="a frame counts once: leave one out")


def _check_counts(counts: tuple[Mosaic, ...], names: tuple[str, ...]) -> None:
    for frame, name in zip(counts, names, strict=True):
        if len(frame.shape) != 2 or 0 in frame.shape:
            raise BadInput(f"its shape is {frame.shape}", where=name, todo="a frame is a 2-D mosaic")
        if frame.shape != counts[0].shape:
            what = f"its shape is {frame.shape}, that of {names[0]} is {counts[0].shape}"
            raise BadInput(what, where=name, todo="merge frames of one camera and one crop")
        if not (np.issubdtype(frame.dtype, np.integer) or np.issubdtype(frame.dtype, np.floating)):
            raise BadInput(f"its counts are of type {frame.dtype}", where=name, todo="give real numbers")
        if np.issubdtype(frame.dtype, np.floating) and not np.isfinite(frame[:]).all():
            bad = int(np.count_nonzero(~np.isfinite(frame[:])))
            raise BadInput(f"{bad} counts are NaN or infinite", where=name, todo="give the counts as stored")


def _times(
    exposure_s: float | Sequence[float] | np.ndarray | None,
    raws: Sequence[RawHead],
    number: int,
    names: tuple[str, ...],
) -> tuple[float, ...]:
    if exposure_s is None:
        stated: list[float | None] = [raw.exposure_s for raw in raws] or [None] * number
    else:
        try:
            stated = [float(seconds) for seconds in np.atleast_1d(np.asarray(exposure_s, dtype=np.float64))]
        except (TypeError, ValueError):
            raise BadInput("the exposure times are not numbers", todo="give seconds, one per frame") from None
    if len(stated) != number:
        raise BadInput(
            f"{len(stated)} exposure times for {number} frames", todo="give one per frame, in order"
        )
    for seconds, name in zip(stated, names, strict=True):
        if seconds is None:
            raise BadInput("it carries no exposure time", where=name, todo="give the exposure times")
        if not (math.isfinite(seconds) and seconds > 0.0):
            raise BadInput(f"its exposure time is {seconds} s", where=name, todo="give seconds, above 0")
    return tuple(seconds for seconds in stated if seconds is not None)


def _check_same_camera(raws: Sequence[RawHead]) -> None:
    first = raws[0]
    for raw in raws[1:]:
        differs = {
            "camera serial": raw.camera_serial != first.camera_serial,
            "camera model": raw.camera_model != first.camera_model,
            "colour filter layout": raw.channels != first.channels or not np.array_equal(raw.cfa, first.cfa),
            "black level": not np.array_equal(raw.black_dn, first.black_dn),
            "ISO": raw.iso != first.iso,
            "aperture": raw.f_number != first.f_number,
        }
        what = next((name for name, different in differs.items() if different), None)
        if what:
            where = f"{first.path.name} and {raw.path.name}"
            raise BadInput(f"{what} differs", where=where, todo="merge frames of one camera at one setting")


def tile(cell: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Repeat a 2 x 2 cell over a mosaic of the given shape; odd sizes cut the last cell."""
    rows, cols = shape
    return np.tile(cell, ((rows + 1) // 2, (cols + 1) // 2))[:rows, :cols]


def over(level: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Repeat a level that is stated for a 2 x 2 cell over a mosaic; leave a constant or a whole one.

    Parameters
    ----------
    level : ndarray, shape (H, W), (2, 2) or (1, 1)
    shape : tuple of int
        Height and width of the mosaic.
    """
    return tile(level, (shape[0], shape[1])) if level.shape == (2, 2) != shape else level


def any_in_cell(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """For each pixel, whether any pixel of its 2 x 2 cell is set; odd sizes have smaller last cells.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)

    Returns
    -------
    ndarray of bool, shape (H, W)
    """
    rows, cols = mask.shape
    if rows % 2 or cols % 2:
        padded = np.zeros((rows + rows % 2, cols + cols % 2), dtype=bool)
        padded[:rows, :cols] = mask
        return any_in_cell(padded)[:rows, :cols]
    # Two neighbouring bytes are one number of sixteen bits: the same few operations for all of a row.
    cells = (mask[0::2] | mask[1::2]).view(np.uint16)
    cells |= (cells << np.uint16(8)) | (cells >> np.uint16(8))
    out = np.empty_like(mask, order="C")
    out[0::2] = out[1::2] = cells.view(bool)
    return out
