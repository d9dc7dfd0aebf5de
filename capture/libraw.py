"""RAW files of any camera through LibRaw: counts of the visible area, and what LibRaw knows of them."""

from __future__ import annotations

import io
import math
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from capture.mosaic import SEND_AGAIN
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

CHANNELS_RGB = ("R", "G", "B")
CHANNELS_MONO = ("mono",)

_FEWEST_COVERED = 100
_NOT_RAW = "give a RAW file (DNG, NEF, CR2, ARW, ...) or an 8- or 16-bit TIFF mosaic"


class Decoded(NamedTuple):
    """One decoded file; attributes as in `capture.raw.RawFrame`."""

    counts: NDArray[np.uint16]
    cfa: NDArray[np.int64]
    channels: tuple[str, ...]
    black_dn: NDArray[np.float64]
    white_dn: float
    white_balance: tuple[float, ...] | None
    linearised: bool
    optical_black_dn: NDArray[np.float64] | None
    shutter_s: float | None
    iso: float | None
    f_number: float | None


def decode(path: Path) -> Decoded:
    """Decode one file.

    Raises
    ------
    BadInput
        The file is truncated, corrupt, not RAW, or of a mosaic other than 2 x 2 RGB or mono.
    """
    import rawpy

    try:
        with _open(path) as raw:
            cfa, channels, colours = _cfa(raw, path)
            black = np.asarray(raw.black_level_per_channel, dtype=np.float64)
            white, other = float(raw.white_level), raw.other
            return Decoded(
                counts=raw.raw_image_visible.copy(),  # the view dies with the file
                cfa=cfa,
                channels=channels,
                # LibRaw indexes black by colour (R, G, B, second G), not by position.
                black_dn=black[colours] if len(channels) > 1 else np.full((2, 2), black[0]),
                white_dn=white,
                white_balance=_balance(raw),
                linearised=not _is_identity(raw.tone_curve, white),
                optical_black_dn=_optical_black(raw),
                shutter_s=_simplest_seconds(other.shutter_speed),
                iso=float(other.iso_speed) or None,
                f_number=float(other.aperture) or None,
            )
    except rawpy.LibRawFileUnsupportedError:
        raise BadInput("not a RAW file that can be read", where=str(path), todo=_NOT_RAW) from None
    except rawpy.LibRawError as error:
        reason = error.args[0] if error.args else "unreadable"
        text = reason.decode(errors="replace") if isinstance(reason, bytes) else str(reason)
        raise BadInput(f"truncated or corrupt ({text})", where=str(path), todo=SEND_AGAIN) from None


def _open(path: Path) -> Any:
    import rawpy

    try:
        return rawpy.imread(str(path))
    except UnicodeEncodeError:  # LibRaw takes only names that are text
        return rawpy.imread(io.BytesIO(path.read_bytes()))


def _cfa(raw: Any, path: Path) -> tuple[NDArray[np.int64], tuple[str, ...], NDArray[np.int64]]:
    """Channel per position of the visible area's first cell, channel names, and LibRaw's colour indices."""
    import rawpy

    if raw.raw_type != rawpy.RawType.Flat:
        raise BadInput(
            "it holds interpolated colours, not a mosaic",
            where=str(path),
            todo="let the camera write plain RAW",
        )
    pattern = raw.raw_pattern  # relative to the visible area, also where the margins are odd
    if pattern is None or raw.num_colors == 1 or pattern.shape == (1, 1):
        flat = np.zeros((2, 2), dtype=np.int64)
        return flat, CHANNELS_MONO, flat
    if pattern.shape != (2, 2):
        rows, cols = pattern.shape
        raise BadInput(
            f"its colour filter repeats every {rows} x {cols} pixels (X-Trans?), only 2 x 2 is supported",
            where=str(path),
            todo="use a camera with a Bayer or a monochrome sensor",
        )
    letters = raw.color_desc.decode(errors="replace")
    names = [letters[index] for index in pattern.ravel()]
    if not set(names) <= set(CHANNELS_RGB):
        raise BadInput(
            f"its colour filters are {''.join(names)}, only red, green and blue are supported",
            where=str(path),
            todo="use a camera with a Bayer or a monochrome sensor",
        )
    cfa = np.array([CHANNELS_RGB.index(name) for name in names], dtype=np.int64).reshape(2, 2)
    return cfa, CHANNELS_RGB, pattern.astype(np.int64)


def _simplest_seconds(stored: float) -> float | None:
    """Return the simplest fraction that float32 cannot tell from LibRaw's time: 0.00800000038 is 1/125."""
    if not (math.isfinite(stored) and stored > 0.0):
        return None
    exact = Fraction(stored)
    limit = 1
    while limit < 10**9:
        candidate = exact.limit_denominator(limit)
        if candidate > 0 and np.float32(float(candidate)) == np.float32(stored):
            return float(candidate)
        limit *= 2
    return float(stored)


def _is_identity(curve: Any, white: float) -> bool:
    """Whether a camera's curve leaves all counts up to the clip level as they are."""
    if curve is None or len(curve) == 0:
        return True
    curve = np.asarray(curve)[: int(white) + 1]
    return not curve.any() or bool(np.array_equal(curve, np.arange(len(curve))))


def _balance(raw: Any) -> tuple[float, ...] | None:
    gains = [float(gain) for gain in raw.camera_whitebalance[:3]]
    if not all(math.isfinite(gain) and gain > 0.0 for gain in gains):
        return None
    return tuple(gain / gains[1] for gain in gains)


def _optical_black(raw: Any) -> NDArray[np.float64] | None:
    """Mean of the margins at each position of the visible area's cell, without their outliers.

    Margins may hold strips that are not covered, or that nobody reads out: what lies outside five robust
    standard deviations of the median is left out.
    """
    sizes, whole = raw.sizes, raw.raw_image
    top, left = sizes.top_margin, sizes.left_margin
    if top + left == 0 and whole.shape == (sizes.height, sizes.width):
        return None
    covered = np.ones(whole.shape, dtype=bool)
    covered[top : top + sizes.height, left : left + sizes.width] = False
    levels = np.empty((2, 2))
    for row in (0, 1):
        for col in (0, 1):
            place = (slice((top + row) % 2, None, 2), slice((left + col) % 2, None, 2))
            values = whole[place][covered[place]].astype(np.float64)
            if values.size < _FEWEST_COVERED:
                return None
            far = np.abs(values - np.median(values))
            levels[row, col] = values[far <= 5.0 * max(1.4826 * float(np.median(far)), 1.0)].mean()
    return levels
