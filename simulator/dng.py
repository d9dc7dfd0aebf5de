"""CFA DNG files: sixteen-bit mosaics that LibRaw reads back bit for bit.

Tags after TIFF 6.0, TIFF/EP (ISO 12234-2), EXIF 2.32 and DNG 1.4. The file is one directory, one strip of
pixels or tiles of lossless JPEG (ITU-T T.81, process 14), and an EXIF directory, the only place where LibRaw
looks for the ISO. It holds no date: the same exposure taken twice is the same file.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rig.errors import BadInput

if TYPE_CHECKING:
    import os
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

BYTE, ASCII, SHORT, LONG, RATIONAL, SRATIONAL = 1, 2, 3, 4, 5, 10

_LETTERS = {BYTE: "B", SHORT: "H", LONG: "I", RATIONAL: "II", SRATIONAL: "ii"}
_LARGEST_LONG = 2**32 - 1
_EXIF_IFD = 34665
_STRIP_OFFSETS, _STRIP_SIZES, _ROWS_PER_STRIP = 273, 279, 278
_TILE_WIDTH, _TILE_LENGTH, _TILE_OFFSETS, _TILE_SIZES = 322, 323, 324, 325
_COMPRESSION, _UNCOMPRESSED, _JPEG = 259, 1, 7
_TILE_PX = 512
_IDENTITY_MATRIX = tuple(Fraction(int(row == col)) for row in range(3) for col in range(3))
_D65 = 21
_SMALLEST_PX = 22
"""LibRaw refuses files with a side below this."""


@dataclass(frozen=True)
class DngMeta:
    """What a DNG says about its picture.

    Parameters
    ----------
    shutter_s : Fraction
        How long the shutter was open; see `exact_seconds`.
    black_dn : tuple of int
        Black level at the four positions of the cell, row by row.
    white_dn : int
        Level from which a count may be clipped.
    cfa : tuple of int
        Colour at the four positions of the cell: 0 red, 1 green, 2 blue.
    serial : str
        The camera's serial number.
    make, model : str
        The camera.
    iso : int
        ISO sensitivity.
    f_number : Fraction
        Focal length over aperture.
    focal_length_mm : Fraction
        Focal length.
    unique_id : bytes
        Sixteen bytes that identify the exposure.
    description : mapping
        What `ImageDescription` holds, as JSON.
    """

    shutter_s: Fraction
    black_dn: tuple[int, int, int, int]
    white_dn: int
    cfa: tuple[int, int, int, int] = (0, 1, 1, 2)
    serial: str = ""
    make: str = "gonio"
    model: str = "twin"
    iso: int = 100
    f_number: Fraction = Fraction(0)
    focal_length_mm: Fraction = Fraction(0)
    unique_id: bytes = bytes(16)
    description: Mapping[str, object] = field(default_factory=dict)


class _Entry(NamedTuple):
    tag: int
    kind: int
    number: int
    data: bytes


def exact_seconds(seconds: float) -> Fraction:
    """Return the time that the shortest decimal of a float names, as a ratio that fits a TIFF rational.

    0.02 gives 1/50 and not the binary number next to it.

    Parameters
    ----------
    seconds : float
        Zero or more, at most 4e9.

    Returns
    -------
    Fraction
        Numerator and denominator below 2**32.
    """
    exact = Fraction(repr(float(seconds)))
    return exact.limit_denominator(int(_LARGEST_LONG / max(1.0, float(exact))))


def _entry(tag: int, kind: int, values: Iterable[int | Fraction] | str | bytes) -> _Entry:
    if isinstance(values, str):
        data = values.encode("ascii", "backslashreplace") + b"\0"
        return _Entry(tag, kind, len(data), data)
    if isinstance(values, bytes):
        return _Entry(tag, kind, len(values), values)
    items = list(values)
    numbers: list[int] = []
    for item in items:
        if kind in {RATIONAL, SRATIONAL}:
            numbers += [item.numerator, item.denominator]
        else:
            numbers.append(int(item))
    return _Entry(tag, kind, len(items), struct.pack("<" + _LETTERS[kind] * len(items), *numbers))


def _directory(entries: list[_Entry], offset: int) -> bytes:
    """Lay out a directory that starts at an offset: entries by tag, long values behind them."""
    values_at = offset + 2 + 12 * len(entries) + 4
    table, values = [struct.pack("<H", len(entries))], b""
    for entry in sorted(entries):
        if len(entry.data) <= 4:
            inline = entry.data.ljust(4, b"\0")
        else:
            inline = struct.pack("<I", values_at + len(values))
            values += entry.data + b"\0" * (len(entry.data) % 2)
        table.append(struct.pack("<HHI", entry.tag, entry.kind, entry.number) + inline)
    return b"".join([*table, struct.pack("<I", 0), values])


def _picture_entries(height_px: int, width_px: int, meta: DngMeta) -> list[_Entry]:
    return [
        _entry(254, LONG, [0]),  # NewSubfileType: the full picture
        _entry(256, LONG, [width_px]),
        _entry(257, LONG, [height_px]),
        _entry(258, SHORT, [16]),  # BitsPerSample
        _entry(262, SHORT, [32803]),  # PhotometricInterpretation: colour filter array
        _entry(270, ASCII, json.dumps(dict(meta.description), separators=(",", ":"))),
        _entry(271, ASCII, meta.make),
        _entry(272, ASCII, meta.model),
        _entry(274, SHORT, [1]),  # Orientation: upright
        _entry(277, SHORT, [1]),  # SamplesPerPixel
        _entry(284, SHORT, [1]),  # PlanarConfiguration
        _entry(33421, SHORT, [2, 2]),  # CFARepeatPatternDim
        _entry(33422, BYTE, meta.cfa),  # CFAPattern
        _entry(33434, RATIONAL, [meta.shutter_s]),  # ExposureTime
        _entry(33437, RATIONAL, [meta.f_number]),  # FNumber
        _entry(50706, BYTE, [1, 4, 0, 0]),  # DNGVersion
        _entry(50707, BYTE, [1, 1, 0, 0]),  # DNGBackwardVersion
        _entry(50708, ASCII, f"{meta.make} {meta.model}"),  # UniqueCameraModel
        _entry(50713, SHORT, [2, 2]),  # BlackLevelRepeatDim: without it LibRaw reads black as 0
        _entry(50714, LONG, meta.black_dn),  # BlackLevel
        _entry(50717, LONG, [meta.white_dn]),  # WhiteLevel
        _entry(50721, SRATIONAL, _IDENTITY_MATRIX),  # ColorMatrix1
        _entry(50728, RATIONAL, [Fraction(1)] * 3),  # AsShotNeutral
        _entry(50735, ASCII, meta.serial),  # CameraSerialNumber
        _entry(50778, SHORT, [_D65]),  # CalibrationIlluminant1
        _entry(50781, BYTE, meta.unique_id),  # RawDataUniqueID
    ]


def _exif_entries(meta: DngMeta) -> list[_Entry]:
    return [
        _entry(33434, RATIONAL, [meta.shutter_s]),  # ExposureTime
        _entry(33437, RATIONAL, [meta.f_number]),  # FNumber
        _entry(34855, SHORT, [meta.iso]),  # ISOSpeedRatings
        _entry(37386, RATIONAL, [meta.focal_length_mm]),  # FocalLength
    ]


class _Pixels(NamedTuple):
    """The picture's bytes, the entries that describe them, and the entry of where they are."""

    segments: list[bytes]
    entries: list[_Entry]
    offsets_tag: int


def _plain(counts: NDArray[np.uint16]) -> _Pixels:
    """One strip of counts as they are."""
    data = counts.astype("<u2").tobytes()
    entries = [
        _entry(_COMPRESSION, SHORT, [_UNCOMPRESSED]),
        _entry(_ROWS_PER_STRIP, LONG, [counts.shape[0]]),
        _entry(_STRIP_SIZES, LONG, [len(data)]),
    ]
    return _Pixels([data], entries, _STRIP_OFFSETS)


def _compressed(counts: NDArray[np.uint16]) -> _Pixels:
    """Tiles of lossless JPEG; those at the edge repeat the last row and column."""
    try:
        import imagecodecs
    except ImportError:
        raise BadInput(
            "lossless JPEG needs imagecodecs", where="DNG", todo="install gonio[ljpeg], or write it plain"
        ) from None

    # LibRaw wraps the rows of a tile that is wider than the picture.
    deep, wide = _TILE_PX, min(_TILE_PX, counts.shape[1])
    whole = np.pad(counts, [(0, -counts.shape[0] % deep), (0, -counts.shape[1] % wide)], mode="edge")
    segments = [
        bytes(imagecodecs.ljpeg_encode(whole[row : row + deep, col : col + wide], bitspersample=16))
        for row in range(0, whole.shape[0], deep)
        for col in range(0, whole.shape[1], wide)
    ]
    entries = [
        _entry(_COMPRESSION, SHORT, [_JPEG]),
        _entry(_TILE_WIDTH, LONG, [wide]),
        _entry(_TILE_LENGTH, LONG, [deep]),
        _entry(_TILE_SIZES, LONG, [len(segment) for segment in segments]),
    ]
    return _Pixels(segments, entries, _TILE_OFFSETS)


def encode_dng(counts: NDArray[np.uint16], meta: DngMeta, *, lossless: bool = False) -> bytes:
    """Lay out a mosaic as a DNG file.

    Parameters
    ----------
    counts : ndarray of uint16, shape (H, W)
        The mosaic, black included; at least 22 pixels on each side, below which LibRaw refuses a file.
    meta : DngMeta
        What the file says about it.
    lossless : bool
        Compress with lossless JPEG: about half the size, for twenty times the work.

    Returns
    -------
    bytes
        The whole file.

    Raises
    ------
    BadInput
        The array is not a mosaic of sixteen-bit counts, or too small, or there is no compressor.
    """
    counts = np.asarray(counts)
    if counts.dtype != np.uint16 or counts.ndim != 2 or min(counts.shape) < _SMALLEST_PX:
        needed = f"2-D uint16 and at least {_SMALLEST_PX} pixels a side"
        raise BadInput(f"a mosaic is {needed}, not {counts.dtype} {counts.shape}", where="DNG")
    pixels = _compressed(counts) if lossless else _plain(counts)
    header = 8
    exif = _directory(_exif_entries(meta), header)
    picture_at = header + len(exif)
    entries = [
        *_picture_entries(counts.shape[0], counts.shape[1], meta),
        *pixels.entries,
        _entry(_EXIF_IFD, LONG, [header]),
        _entry(pixels.offsets_tag, LONG, [0] * len(pixels.segments)),
    ]
    # The length of a directory does not depend on its values: a first layout tells where the pixels begin.
    offsets = [picture_at + len(_directory(entries, picture_at))]
    for segment in pixels.segments[:-1]:
        offsets.append(offsets[-1] + len(segment))
    entries[-1] = _entry(pixels.offsets_tag, LONG, offsets)
    picture = _directory(entries, picture_at)
    return b"".join([struct.pack("<2sHI", b"II", 42, picture_at), exif, picture, *pixels.segments])


def write_dng(
    path: str | os.PathLike[str], counts: NDArray[np.uint16], meta: DngMeta, *, lossless: bool = False
) -> None:
    """Write a mosaic as a DNG file that every user may read and delete; arguments as in `encode_dng`.

    The file appears under its name complete: it is written under a hidden name first.

    Raises
    ------
    BadInput
        As in `encode_dng`.
    OSError
        The file cannot be written.
    """
    path = Path(path)
    data = encode_dng(counts, meta, lossless=lossless)
    hidden = path.with_name(f".{path.name}.part")
    try:
        hidden.write_bytes(data)
        hidden.chmod(0o666)
        hidden.replace(path)
    except OSError:
        hidden.unlink(missing_ok=True)
        raise
