"""CFA mosaics in TIFF and DNG, plain or lossless JPEG: the pixels and the tags that say how to read them.

Tag numbers and their meaning: TIFF 6.0, TIFF/EP (ISO 12234-2) and the DNG specification 1.7.
"""

from __future__ import annotations

import importlib.util
import logging
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.mosaic import SEND_AGAIN, FileMosaic
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from capture.mosaic import Mosaic

BITS = 258
IMAGE_DESCRIPTION = 270
MAKE = 271
MODEL = 272
SUB_IFDS = 330
CFA_REPEAT = 33421
CFA_PATTERN = 33422
EXPOSURE_TIME = 33434
F_NUMBER = 33437
EXIF = 34665
ISO = 34855
BODY_SERIAL = 42033
DNG_VERSION = 50706
UNIQUE_MODEL = 50708
LINEARISATION = 50712
BLACK_REPEAT = 50713
BLACK_LEVEL = 50714
WHITE_LEVEL = 50717
AS_SHOT_NEUTRAL = 50728
CAMERA_SERIAL = 50735

_GRAYSCALE, _CFA = 1, 32803
_UNCOMPRESSED, _JPEG = 1, 7
_RATIONAL, _SIGNED_RATIONAL = 5, 10

NEEDS_LIBRAW = frozenset(
    {
        50711,  # CFALayout: staggered rows or columns
        LINEARISATION,  # the stored counts are not linear
        50715,  # BlackLevelDeltaH
        50716,  # BlackLevelDeltaV
        50829,  # ActiveArea: margins
        50830,  # MaskedAreas
    }
)
"""Tags whose presence makes a mosaic more than its stored pixels."""

MAX_PIXELS = 400_000_000
"""More than any sensor has: a larger size is a damaged header, not a picture to find memory for."""

_EXIF_NAMES = {
    "ExposureTime": EXPOSURE_TIME,
    "FNumber": F_NUMBER,
    "ISOSpeedRatings": ISO,
    "BodySerialNumber": BODY_SERIAL,
}
_EXIF_RATIOS = frozenset({"ExposureTime", "FNumber"})

# tifffile reports damaged files on its logger and goes on; our own errors say it once, in one line.
logging.getLogger("tifffile").addHandler(logging.NullHandler())


def open_mosaic(path: Path) -> tuple[Mosaic | None, dict[int, Any]]:
    """Open a file in TIFF's container.

    Parameters
    ----------
    path : Path
        A file that starts with TIFF's magic number.

    Returns
    -------
    mosaic : FileMosaic, ndarray or None
        Counts of uint8 or uint16, shape (H, W), read by rows where the file allows it; None where the file is
        a camera's RAW that needs LibRaw.
    tags : dict
        Value by tag number, of the first directory and its EXIF directory; rationals as numbers.

    Raises
    ------
    BadInput
        The file is truncated or corrupt.
    """
    import tifffile

    tags: dict[int, Any] = {}
    mosaic_here = False
    try:
        with tifffile.TiffFile(path) as tiff:
            page: Any = tiff.pages.first
            tags = _tags(page)
            mosaic_here = _is_plain_mosaic(page, tags)
            if not mosaic_here:
                return None, tags
            _check_extent(page, path)
            if page.photometric == _CFA:
                return _file_mosaic(page, path), tags
            return np.ascontiguousarray(page.asarray()), tags
    except BadInput:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged file makes tifffile raise any of a dozen types
        if not mosaic_here:
            return None, tags  # a maker's private dialect of TIFF: LibRaw has the last word
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        todo = "install gonio[ljpeg]" if "imagecodecs" in reason else SEND_AGAIN
        raise BadInput(f"truncated or corrupt ({reason})", where=str(path), todo=todo) from None


def _tags(page: Any) -> dict[int, Any]:
    tags: dict[int, Any] = {}
    for tag in page.tags.values():
        # Pixel offsets of a large file are long lists that nobody asks for.
        if tag.count > 4096 and tag.code != IMAGE_DESCRIPTION:
            continue
        value = tag.value
        if tag.dtype in {_RATIONAL, _SIGNED_RATIONAL}:
            value = _ratios(value)
        tags[tag.code] = value
    exif = tags.get(EXIF)
    if isinstance(exif, dict):
        for name, code in _EXIF_NAMES.items():
            if name in exif and code not in tags:
                value = exif[name]
                tags[code] = _ratios(value) if name in _EXIF_RATIOS else value
    return tags


def _ratios(value: tuple[int, ...]) -> tuple[float, ...]:
    pairs = zip(value[::2], value[1::2], strict=False)
    return tuple(numerator / denominator if denominator else math.nan for numerator, denominator in pairs)


def _is_plain_mosaic(page: Any, tags: Mapping[int, Any]) -> bool:
    """Whether the stored pixels are the mosaic itself, so that no RAW decoder is needed."""
    if page.samplesperpixel != 1 or len(page.shape) != 2:
        return False
    lossless = page.compression == _JPEG and 8 < page.bitspersample <= 16  # lossy JPEG has eight bits
    depth_fits = page.dtype in {np.dtype(np.uint8), np.dtype(np.uint16)} and page.bitspersample in {8, 16}
    if not (depth_fits or lossless):
        return False
    if page.photometric == _CFA:
        repeats = tuple(np.atleast_1d(tags.get(CFA_REPEAT, (2, 2))))
        plain = page.compression == _UNCOMPRESSED and (page.bitspersample == 16 or DNG_VERSION not in tags)
        readable = plain or (lossless and page.jpegtables is None and _has_imagecodecs())
        return readable and repeats == (2, 2) and page.fillorder == 1 and not (NEEDS_LIBRAW & tags.keys())
    camera_file = {SUB_IFDS, EXIF, DNG_VERSION} & tags.keys()
    return page.photometric == _GRAYSCALE and not camera_file


def _has_imagecodecs() -> bool:
    return importlib.util.find_spec("imagecodecs") is not None


def _file_mosaic(page: Any, path: Path) -> FileMosaic:
    """Describe where the counts of a checked page lie."""
    height, width = int(page.imagelength), int(page.imagewidth)
    deep, wide = (page.tilelength, page.tilewidth) if page.is_tiled else (page.rowsperstrip, width)
    deep = int(min(deep, height)) if not page.is_tiled else int(deep)
    segments = -(-height // deep) * -(-width // int(wide))
    rows = [deep if page.is_tiled else min(deep, height - top) for top in range(0, height, deep)]
    least = 0 if page.compression == _JPEG else int(wide) * page.dtype.itemsize
    across = -(-width // int(wide))
    short = any(size < rows[index // across] * least for index, size in enumerate(page.databytecounts))
    if len(page.dataoffsets) != segments or short:
        what = f"truncated or corrupt: {len(page.dataoffsets)} segments, {segments} whole ones announced"
        raise BadInput(what, where=str(path), todo=SEND_AGAIN)
    return FileMosaic(
        path=path,
        shape=(height, width),
        stored=np.dtype(page.dtype).newbyteorder(page.parent.byteorder),
        offsets=tuple(int(offset) for offset in page.dataoffsets),
        sizes=tuple(int(size) for size in page.databytecounts),
        segment_shape=(deep, int(wide)),
        tiled=bool(page.is_tiled),
        compressed=page.compression == _JPEG,
    )


def _check_extent(page: Any, path: Path) -> None:
    """Refuse a header whose size cannot be true, before memory is taken for it."""
    pixels = int(page.imagewidth) * int(page.imagelength)
    stored = sum(page.databytecounts)
    expected = pixels * page.dtype.itemsize
    end = max(
        (start + size for start, size in zip(page.dataoffsets, page.databytecounts, strict=True)), default=0
    )
    short = end > path.stat().st_size or (page.compression == _UNCOMPRESSED and stored < expected)
    if pixels == 0 or short or pixels > MAX_PIXELS:
        size = f"{page.imagewidth} x {page.imagelength} pixels announced, {path.stat().st_size} bytes there"
        raise BadInput(f"truncated or corrupt: {size}", where=str(path), todo=SEND_AGAIN)


def first_number(value: Any) -> float | None:
    """Return the first number of a tag's value, or None where there is none."""
    if isinstance(value, tuple | list):
        value = value[0] if value else None
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def positive(value: Any) -> float | None:
    """Return an exposure time or f-number from its tag; None where it is absent, zero or damaged."""
    number = first_number(value)
    return number if number is not None and number > 0.0 else None


def white_balance(tags: Mapping[int, Any]) -> tuple[float, ...] | None:
    """Gains of red, green and blue, green 1, from a DNG's neutral colour; None where it states none."""
    neutral = tags.get(AS_SHOT_NEUTRAL)
    if not isinstance(neutral, tuple) or len(neutral) != 3:
        return None
    if not all(isinstance(value, float) and math.isfinite(value) and value > 0.0 for value in neutral):
        return None
    return tuple(neutral[1] / value for value in neutral)


def camera_model(tags: Mapping[int, Any]) -> str | None:
    """Make and model, without saying the make twice."""
    make = str(tags.get(MAKE) or "").strip()
    model = str(tags.get(MODEL) or tags.get(UNIQUE_MODEL) or "").strip()
    text = model if model.startswith(make) else f"{make} {model}".strip()
    return text or None


def cfa(tags: Mapping[int, Any], path: Path) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Channel index per position of the 2 x 2 cell, and the channels' names.

    Raises
    ------
    BadInput
        The pattern is damaged, or holds other colours than red, green and blue.
    """
    pattern = tags.get(CFA_PATTERN)
    if pattern is None:
        return np.zeros((2, 2), dtype=np.int64), ("mono",)
    codes = [int(code) for code in _numbers(pattern, "colour filter pattern", path)]
    if len(codes) != 4 or not set(codes) <= {0, 1, 2}:
        raise BadInput(
            f"its colour filter pattern is {codes}, only 2 x 2 cells of red, green and blue are supported",
            where=str(path),
            todo="use a camera with a Bayer or a monochrome sensor",
        )
    return np.array(codes, dtype=np.int64).reshape(2, 2), ("R", "G", "B")


def black_level(tags: Mapping[int, Any], path: Path) -> NDArray[np.float64]:
    """Black level per position of the 2 x 2 cell, in DN, shape (2, 2); 0 where the file states none.

    Raises
    ------
    BadInput
        The black levels are damaged, or do not fit a 2 x 2 cell.
    """
    stated = tags.get(BLACK_LEVEL)
    if stated is None:
        return np.zeros((2, 2))
    values = _numbers(stated, "black level", path)
    # Four values without a repeat dimension mean the four positions of the cell (LibRaw reads 0 there).
    default = (2, 2) if values.size == 4 else (1, values.size)
    cell = _numbers(tags.get(BLACK_REPEAT, default), "black level's cell", path)
    rows, cols = (int(n) for n in cell) if cell.size == 2 else (0, 0)
    if rows not in {1, 2} or cols not in {1, 2} or rows * cols != values.size:
        raise BadInput(
            f"its black levels ({values.size} for a cell of {rows} x {cols}) do not fit a 2 x 2 mosaic",
            where=str(path),
            todo="give the black level per CFA position",
        )
    return np.tile(values.reshape(rows, cols), (2 // rows, 2 // cols))


def _numbers(value: Any, name: str, path: Path) -> NDArray[np.float64]:
    """Read a tag's value as finite numbers; a damaged tag may hold a text, or nothing."""
    try:
        plain = tuple(value) if isinstance(value, bytes) else value
        numbers = np.atleast_1d(np.asarray(plain, dtype=np.float64))
    except (TypeError, ValueError):
        numbers = np.array([np.nan])
    if not np.isfinite(numbers).all():
        raise BadInput(f"its {name} is damaged", where=str(path), todo=SEND_AGAIN)
    return numbers
