"""Mosaics that stay on disk and are read by rows, so that a merge needs no more memory for more frames."""

from __future__ import annotations

import struct
import tempfile
import threading
import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

SEND_AGAIN = "copy it from the camera again, or leave it out"
"""What to do about a damaged file."""

_LOSSLESS_HUFFMAN = 0xC3  # the marker SOF3


class Mosaic(Protocol):
    """Counts of shape (H, W) that can be cut by rows: an array, or a file."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Height and width in pixels."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the counts."""
        ...

    def __getitem__(self, rows: slice, /) -> NDArray[Any]:
        """Return these rows."""
        ...


@dataclass(frozen=True, eq=False)
class FileMosaic:
    """A mosaic as it lies in a TIFF or DNG file: strips or tiles, plain or lossless JPEG.

    Attributes
    ----------
    path : Path
        The file.
    shape : tuple of int
        Height and width in pixels.
    stored : numpy dtype
        Of the counts in the file, with its byte order.
    offsets, sizes : tuple of int
        Where each segment begins and how many bytes it has; by rows of segments, then by columns.
    segment_shape : tuple of int
        Rows and columns of a whole segment; the last strip has only the rows that are left, tiles are whole.
    tiled : bool
        Tiles, not strips.
    compressed : bool
        Lossless JPEG (ITU-T T.81, process 14), not plain counts.
    """

    path: Path
    shape: tuple[int, int]
    stored: np.dtype[Any]
    offsets: tuple[int, ...]
    sizes: tuple[int, ...]
    segment_shape: tuple[int, int]
    tiled: bool
    compressed: bool

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the counts that `__getitem__` returns."""
        return np.dtype(np.uint16) if self.compressed else self.stored.newbyteorder("=")

    @property
    def band_rows(self) -> int:
        """Rows that are best read at once: none is decoded twice."""
        return self.segment_shape[0] if self.compressed else 1

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        """Read rows; a step other than 1 is not supported.

        Raises
        ------
        BadInput
            The file is gone, shorter than it was, or damaged.
        """
        start, stop, step = rows.indices(self.shape[0])
        if step != 1:
            raise ValueError("rows are read one after the other")
        return self.read(start, np.empty((max(0, stop - start), self.shape[1]), self.dtype))

    def read(self, start: int, counts: NDArray[Any]) -> NDArray[Any]:
        """Read the rows from `start` on into an array, as many as it has, and return it; errors as above."""
        height, width = self.shape
        stop = start + len(counts)
        deep, wide = self.segment_shape
        across = -(-width // wide)
        try:
            with self.path.open("rb", buffering=0) as file:
                for down in range(start // deep, -(-stop // deep) if stop > start else 0):
                    top = down * deep
                    first, last = max(start, top), min(stop, top + deep, height)
                    for col in range(across):
                        left, right = col * wide, min((col + 1) * wide, width)
                        place = counts[first - start : last - start, left:right]
                        self._fill(place, file, down * across + col, first - top)
        except OSError as error:
            raise BadInput(error.strerror or "unreadable", where=str(self.path), todo=SEND_AGAIN) from None
        return counts

    def _fill(self, place: NDArray[Any], file: Any, segment: int, skipped: int) -> None:
        """Put a segment's rows, from the one after `skipped`, in their place."""
        rows, cols = place.shape
        if self.compressed:
            place[:] = self._decoded(file, segment)[skipped : skipped + rows, :cols]
            return
        wide = self.segment_shape[1]
        pitch = wide * self.stored.itemsize
        file.seek(self.offsets[segment] + skipped * pitch)
        direct = place.flags.c_contiguous and cols == wide and self.stored.isnative
        part = place if direct else np.empty((rows, wide), self.stored)
        view = memoryview(part.reshape(-1).view(np.uint8))  # type: ignore[arg-type]  # numpy's arrays are buffers
        done = 0
        while done < len(view) and (got := file.readinto(view[done:])):
            done += got
        if done < len(view):
            raise BadInput("truncated: its pixels end early", where=str(self.path), todo=SEND_AGAIN)
        if not direct:
            place[:] = part[:, :cols]

    def _decoded(self, file: Any, segment: int) -> NDArray[np.uint16]:
        """Decode one segment of lossless JPEG; two components side by side are two columns (DNG 1.7)."""
        import imagecodecs

        deep, wide = self.segment_shape
        height = deep if self.tiled else min(deep, self.shape[0] - deep * segment)
        file.seek(self.offsets[segment])
        data = file.read(self.sizes[segment])
        announced = _announced(data)
        if announced is None or announced[0] != height or announced[1] * announced[2] != wide:
            what = f"truncated or corrupt: a segment of {announced} where ({height}, {wide}) is announced"
            raise BadInput(what, where=str(self.path), todo=SEND_AGAIN)
        try:
            # The decoder reports damage as one of several types, all of them RuntimeError or ValueError.
            counts = np.asarray(imagecodecs.jpeg_decode(data))
        except (RuntimeError, ValueError) as error:
            reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
            raise BadInput(
                f"truncated or corrupt ({reason})", where=str(self.path), todo=SEND_AGAIN
            ) from None
        return counts.reshape(height, wide)


def _announced(jpeg: bytes) -> tuple[int, int, int] | None:
    """Rows, columns and components in the header of a lossless JPEG; None where it is none of 9 to 16 bits.

    ITU-T T.81, B.1.1.3 and B.2.2. Damaged headers name giants: no memory is taken before they are read.
    """
    place = 2
    while jpeg[:2] == b"\xff\xd8" and place + 9 < len(jpeg) and jpeg[place] == 0xFF:
        if jpeg[place + 1] == _LOSSLESS_HUFFMAN:
            bits, rows, cols, parts = struct.unpack_from(">BHHB", jpeg, place + 4)
            return (rows, cols, parts) if 8 < bits <= 16 else None
        place += 2 + int(struct.unpack_from(">H", jpeg, place + 2)[0])
    return None


class SpilledMosaic:
    """A mosaic that only a decoder of whole frames can read, put into a file without a name.

    Parameters
    ----------
    counts : ndarray, shape (H, W)
        The decoded counts; not kept in memory.

    Raises
    ------
    BadInput
        There is no room for the file.
    """

    def __init__(self, counts: NDArray[Any]) -> None:
        self._shape, self._dtype = counts.shape, counts.dtype
        self._lock = threading.Lock()
        try:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the mosaic
            weakref.finalize(self, self._file.close)
            np.ascontiguousarray(counts).tofile(self._file)
            self._file.flush()
        except OSError as error:
            what = f"decoded frames cannot be put aside ({error.strerror})"
            raise BadInput(
                what, where=tempfile.gettempdir(), todo="make room, or set TMPDIR to another disk"
            ) from None

    @property
    def shape(self) -> tuple[int, ...]:
        """Height and width in pixels."""
        return self._shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the counts."""
        return self._dtype

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        """Read rows."""
        height, width = self._shape
        start, stop, _ = rows.indices(height)
        number = max(0, stop - start)
        with self._lock:
            self._file.seek(start * width * self._dtype.itemsize)
            counts = np.fromfile(self._file, self._dtype, number * width)
        return counts.reshape(number, width)
