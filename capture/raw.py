"""RAW files to CFA counts: any camera through LibRaw, plain TIFF mosaics and our own DNG through a short cut.

A RAW file stays what the sensor delivered: a linear mosaic of counts. Nothing here subtracts black, balances,
interpolates or clips. The short cut reads uncompressed CFA files (TIFF or DNG) directly, 40 times faster than
LibRaw, with exact rational exposure times, and equals LibRaw bit for bit; all others go through LibRaw.
"""

from __future__ import annotations

import io
import json
import math
import os
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capture import tiff_tags
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

PathLike = str | os.PathLike[str]

CHANNELS_RGB = ("R", "G", "B")
CHANNELS_MONO = ("mono",)

_NOT_RAW = "give a RAW file (DNG, NEF, CR2, ARW, ...) or an 8- or 16-bit TIFF mosaic"


@dataclass(frozen=True)
class FrameInfo:
    """What a RAW file says about itself, for the check that it is the frame that was ordered.

    Attributes
    ----------
    camera_serial : str or None
        Serial number of the camera body; None where the file does not carry one.
    camera_model : str or None
        Make and model.
    exposure_s : float or None
        How long light was collected: the lamp's time where our own file states it, else the shutter's.
    shutter_s : float or None
        How long the shutter was open.
    iso : float or None
        ISO sensitivity.
    shot_id : str or None
        The shot's identity, only in files that carry one (our own DNG).
    lit : bool or None
        Whether the lamp was on; None where the file does not say.
    width_px, height_px : int
        Size of the mosaic.
    """

    camera_serial: str | None
    camera_model: str | None
    exposure_s: float | None
    shutter_s: float | None
    iso: float | None
    shot_id: str | None
    lit: bool | None
    width_px: int
    height_px: int


@dataclass(frozen=True, eq=False)
class RawFrame:
    """One RAW frame: the counts of the visible sensor area and what is needed to read them.

    Attributes
    ----------
    counts : ndarray of uint16, shape (H, W)
        The mosaic as stored, black included, in DN.
    cfa : ndarray of int, shape (2, 2)
        Channel index at each position of the 2 x 2 cell at the top left; both greens share one index.
    channels : tuple of str
        ``("R", "G", "B")``, or ``("mono",)`` for a sensor (or a TIFF) without colour information.
    black_dn : ndarray of float, shape (2, 2)
        Black level at each position of the cell, in DN.
    white_dn : float
        Nominal clip level in DN, black included, as the file claims; often wrong, so measure it.
    exposure_s : float or None
        How long light was collected: the lamp's time where our own file states it, else the shutter's.
    shutter_s : float or None
        How long the shutter was open.
    camera_serial, camera_model : str or None
        Serial number, make and model of the camera body, where the file carries them.
    iso : float or None
        ISO sensitivity.
    shot_id : str or None
        The shot's identity, only in files that carry one (our own DNG).
    lit : bool or None
        Whether the lamp was on; None where the file does not say.
    path : Path
        The file.
    """

    counts: NDArray[np.uint16]
    cfa: NDArray[np.int64]
    channels: tuple[str, ...]
    black_dn: NDArray[np.float64]
    white_dn: float
    exposure_s: float | None
    shutter_s: float | None
    camera_serial: str | None
    camera_model: str | None
    iso: float | None
    shot_id: str | None
    lit: bool | None
    path: Path

    @property
    def info(self) -> FrameInfo:
        """What the file says about itself."""
        height_px, width_px = self.counts.shape
        return FrameInfo(
            camera_serial=self.camera_serial,
            camera_model=self.camera_model,
            exposure_s=self.exposure_s,
            shutter_s=self.shutter_s,
            iso=self.iso,
            shot_id=self.shot_id,
            lit=self.lit,
            width_px=width_px,
            height_px=height_px,
        )


def read_raw(path: PathLike) -> RawFrame:
    """Read one RAW file into CFA counts.

    Parameters
    ----------
    path : path
        A camera's RAW file, a DNG, or a single-channel 8- or 16-bit TIFF that holds a mosaic.

    Returns
    -------
    RawFrame

    Raises
    ------
    BadInput
        The file is missing, empty, truncated, corrupt, not RAW, or of a mosaic other than 2 x 2 RGB or mono.
    """
    path = Path(path)
    tags: Mapping[int, Any] = {}
    if _is_tiff(path):
        counts, tags = tiff_tags.read_mosaic(path)
        if counts is not None:
            return _frame_from_tags(path, counts, tags)
    return _frame_from_libraw(path, tags)


def inspect_frame(path: PathLike) -> FrameInfo:
    """Decode a RAW file and return what it says about itself.

    The whole file is decoded, so that an answer also means that the frame arrived complete.

    Parameters
    ----------
    path : path
        As for `read_raw`.

    Returns
    -------
    FrameInfo

    Raises
    ------
    BadInput
        As for `read_raw`.
    """
    return read_raw(path).info


def _is_tiff(path: Path) -> bool:
    """Whether the first bytes are TIFF's (or BigTIFF's); refuses what is no file, or an empty one."""
    try:
        with path.open("rb") as file:
            head = file.read(4)
    except FileNotFoundError:
        raise BadInput("no such file", where=str(path), todo="check the path") from None
    except OSError as error:
        raise BadInput(
            error.strerror or "unreadable", where=str(path), todo="check the path and its permissions"
        ) from None
    if not head:
        raise BadInput("the file is empty", where=str(path), todo=tiff_tags.SEND_AGAIN)
    return head in {b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"}


def _frame_from_tags(path: Path, counts: NDArray[Any], tags: Mapping[int, Any]) -> RawFrame:
    cfa, channels = tiff_tags.cfa(tags, path)
    white = tiff_tags.first_number(tags.get(tiff_tags.WHITE_LEVEL))
    if white is None:
        white = float(np.iinfo(counts.dtype).max)
    return RawFrame(
        counts=counts.astype(np.uint16, copy=False),
        cfa=cfa,
        channels=channels,
        black_dn=tiff_tags.black_level(tags, path),
        white_dn=white,
        path=path,
        **_identity(path, tags),
    )


def _identity(
    path: Path, tags: Mapping[int, Any], *, shutter_s: float | None = None, iso: float | None = None
) -> dict[str, Any]:
    """Camera, exposure and identity from TIFF tags and our own description; else what LibRaw knows."""
    ours = _description(tags, path)
    shutter = tiff_tags.seconds(tags.get(tiff_tags.EXPOSURE_TIME)) or shutter_s
    exposure, lit, shot = (ours.get(key) for key in ("exposure_s", "lit", "shot_id"))
    serial = ours.get("camera_serial") or tags.get(tiff_tags.CAMERA_SERIAL) or tags.get(tiff_tags.BODY_SERIAL)
    return {
        "exposure_s": shutter if exposure is None else _stated_seconds(exposure, path),
        "shutter_s": shutter,
        "camera_serial": str(serial).strip() if serial else None,
        "camera_model": tiff_tags.camera_model(tags),
        "iso": tiff_tags.first_number(tags.get(tiff_tags.ISO)) or iso,
        "shot_id": None if shot is None else str(shot),
        "lit": None if lit is None else bool(lit),
    }


def _description(tags: Mapping[int, Any], path: Path) -> dict[str, Any]:
    """Return the JSON object that our own DNG carries as ImageDescription; empty for any other file."""
    text = tags.get(tiff_tags.IMAGE_DESCRIPTION)
    if not isinstance(text, str) or '"gonio"' not in text:
        return {}
    try:
        value = json.loads(text)
    except ValueError:
        raise BadInput(
            "its ImageDescription is damaged", where=str(path), todo=tiff_tags.SEND_AGAIN
        ) from None
    return value if isinstance(value, dict) and "gonio" in value else {}


def _stated_seconds(value: object, path: Path) -> float:
    try:
        seconds = float(Fraction(str(value)))
    except (ValueError, ZeroDivisionError, OverflowError):
        seconds = math.nan
    if not (math.isfinite(seconds) and seconds >= 0.0):
        raise BadInput(f"its exposure_s is {value!r}", where=str(path), todo="it must be a time in seconds")
    return seconds


def _frame_from_libraw(path: Path, tags: Mapping[int, Any]) -> RawFrame:
    import rawpy

    try:
        with _open_with_libraw(path) as raw:
            cfa, channels, colours = _libraw_cfa(raw, path)
            counts = raw.raw_image_visible.copy()  # the view dies with the file
            black = np.asarray(raw.black_level_per_channel, dtype=np.float64)
            other = raw.other
            white = float(raw.white_level)
    except rawpy.LibRawFileUnsupportedError:
        raise BadInput("not a RAW file that can be read", where=str(path), todo=_NOT_RAW) from None
    except rawpy.LibRawError as error:
        reason = error.args[0] if error.args else "unreadable"
        text = reason.decode(errors="replace") if isinstance(reason, bytes) else str(reason)
        raise BadInput(f"truncated or corrupt ({text})", where=str(path), todo=tiff_tags.SEND_AGAIN) from None
    return RawFrame(
        counts=counts,
        cfa=cfa,
        channels=channels,
        # LibRaw indexes black by colour (R, G, B, second G), not by position.
        black_dn=black[colours] if len(channels) > 1 else np.full((2, 2), black[0]),
        white_dn=white,
        path=path,
        **_identity(
            path,
            tags,
            shutter_s=_simplest_seconds(other.shutter_speed),
            iso=float(other.iso_speed) or None,
        ),
    )


def _open_with_libraw(path: Path) -> Any:
    import rawpy

    try:
        return rawpy.imread(str(path))
    except UnicodeEncodeError:  # LibRaw takes only names that are text
        return rawpy.imread(io.BytesIO(path.read_bytes()))


def _libraw_cfa(raw: Any, path: Path) -> tuple[NDArray[np.int64], tuple[str, ...], NDArray[np.int64]]:
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
