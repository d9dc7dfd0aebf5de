"""RAW files to CFA counts: any camera through LibRaw, plain TIFF mosaics and our own DNG through a short cut.

A RAW file stays what the sensor delivered: a linear mosaic of counts. Nothing here subtracts black, balances,
interpolates or clips. The short cut reads CFA files (TIFF or DNG; plain, or lossless JPEG where imagecodecs
is installed) directly, several times faster than LibRaw, with exact rational exposure times, and equals
LibRaw bit for bit; all others go through LibRaw.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capture import libraw, tiff_tags
from capture.mosaic import SEND_AGAIN, SpilledMosaic
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from capture.mosaic import Mosaic

_MOST_BAND_ROWS = 1024

PathLike = str | os.PathLike[str]


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


@dataclass(frozen=True, eq=False, kw_only=True)
class RawHead:
    """What is needed to read the counts of a RAW frame.

    Attributes
    ----------
    cfa : ndarray of int, shape (2, 2)
        Channel index at each position of the 2 x 2 cell at the top left; both greens share one index.
    channels : tuple of str
        ``("R", "G", "B")``, or ``("mono",)`` for a sensor (or a TIFF) without colour information.
    black_dn : ndarray of float, shape (2, 2)
        Black level at each position of the cell, in DN, as the file states it.
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
    f_number : float or None
        Focal length over aperture.
    white_balance : tuple of float or None
        Gains of red, green and blue that the camera chose, green 1; nothing here applies them.
    linearised : bool
        Whether the counts came through a table or curve of the file: steps between codes then differ.
    optical_black_dn : ndarray of float, shape (2, 2), or None
        Mean of the covered pixels beside the picture at each position of the cell; None where there are none.
    """

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
    f_number: float | None = None
    white_balance: tuple[float, ...] | None = None
    linearised: bool = False
    optical_black_dn: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class StreamedFrame(RawHead):
    """One RAW frame whose counts stay on disk, to be read by rows.

    Attributes
    ----------
    counts : Mosaic, shape (H, W)
        As those of `RawFrame`.
    """

    counts: Mosaic


@dataclass(frozen=True, eq=False, kw_only=True)
class RawFrame(RawHead):
    """One RAW frame: the counts of the visible sensor area and what is needed to read them.

    Attributes
    ----------
    counts : ndarray of uint16, shape (H, W)
        The mosaic as stored, black included, in DN.
    """

    counts: NDArray[np.uint16]

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
    mosaic, tags = _opened(path)
    if mosaic is None:
        return _frame_from_libraw(path, tags)
    head = _head_from_tags(path, mosaic.dtype, tags)
    return RawFrame(counts=mosaic[:].astype(np.uint16, copy=False), **head)


def open_raw(path: PathLike) -> StreamedFrame:
    """Open one RAW file whose counts are read by rows, later; arguments and errors as of `read_raw`.

    A file that can only be decoded as a whole is decoded once, now, and its counts put aside on disk.
    """
    path = Path(path)
    mosaic, tags = _opened(path)
    if mosaic is not None:
        if getattr(mosaic, "band_rows", 1) > _MOST_BAND_ROWS:
            mosaic = SpilledMosaic(mosaic[:])
        return StreamedFrame(counts=mosaic, **_head_from_tags(path, mosaic.dtype, tags))
    frame = _frame_from_libraw(path, tags)
    head = {item.name: getattr(frame, item.name) for item in fields(RawHead)}
    return StreamedFrame(counts=SpilledMosaic(frame.counts), **head)


def _opened(path: Path) -> tuple[Mosaic | None, Mapping[int, Any]]:
    return tiff_tags.open_mosaic(path) if _is_tiff(path) else (None, {})


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
        raise BadInput("the file is empty", where=str(path), todo=SEND_AGAIN)
    return head in {b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"}


def _head_from_tags(path: Path, dtype: np.dtype[Any], tags: Mapping[int, Any]) -> dict[str, Any]:
    cfa, channels = tiff_tags.cfa(tags, path)
    white = tiff_tags.first_number(tags.get(tiff_tags.WHITE_LEVEL))
    if white is None:
        white = 2.0 ** (tiff_tags.first_number(tags.get(tiff_tags.BITS)) or 8 * dtype.itemsize) - 1.0
    return {
        "cfa": cfa,
        "channels": channels,
        "black_dn": tiff_tags.black_level(tags, path),
        "white_dn": white,
        "path": path,
        "white_balance": tiff_tags.white_balance(tags),
        **_identity(path, tags),
    }


def _identity(
    path: Path,
    tags: Mapping[int, Any],
    *,
    shutter_s: float | None = None,
    iso: float | None = None,
    f_number: float | None = None,
) -> dict[str, Any]:
    """Camera, exposure and identity from TIFF tags and our own description; else what LibRaw knows."""
    ours = _description(tags, path)
    shutter = tiff_tags.positive(tags.get(tiff_tags.EXPOSURE_TIME)) or shutter_s
    exposure, lit, shot = (ours.get(key) for key in ("exposure_s", "lit", "shot_id"))
    serial = ours.get("camera_serial") or tags.get(tiff_tags.CAMERA_SERIAL) or tags.get(tiff_tags.BODY_SERIAL)
    return {
        "exposure_s": shutter if exposure is None else _stated_seconds(exposure, path),
        "shutter_s": shutter,
        "camera_serial": str(serial).strip() if serial else None,
        "camera_model": tiff_tags.camera_model(tags),
        "iso": tiff_tags.first_number(tags.get(tiff_tags.ISO)) or iso,
        "f_number": tiff_tags.positive(tags.get(tiff_tags.F_NUMBER)) or f_number,
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
        raise BadInput("its ImageDescription is damaged", where=str(path), todo=SEND_AGAIN) from None
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
    found = libraw.decode(path)
    return RawFrame(
        counts=found.counts,
        cfa=found.cfa,
        channels=found.channels,
        black_dn=found.black_dn,
        white_dn=found.white_dn,
        path=path,
        white_balance=tiff_tags.white_balance(tags) or found.white_balance,
        linearised=found.linearised or tiff_tags.LINEARISATION in tags,
        optical_black_dn=found.optical_black_dn,
        **_identity(path, tags, shutter_s=found.shutter_s, iso=found.iso, f_number=found.f_number),
    )
