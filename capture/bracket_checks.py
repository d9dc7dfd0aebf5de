"""What can be wrong with a bracket as a whole: foreign darks, light in darks, nothing but clipped pixels."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from capture.flags import Flag
from capture.frames import thin, thinning
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from capture.dark import DarkModel
    from capture.frames import Stack
    from capture.merge import Merged
    from capture.raw import RawHead
    from capture.sensor import SensorModel

_PIECE = 16
_FEWEST_PIECES = 32
_SAMPLE_PIXELS = 2_000_000

ALIKE = 0.8
"""Correlation of a dark frame's pattern with the scene's, from which on it is the scene that it shows."""

PATTERN_DN = 0.5
"""Standard deviation of a dark frame's pattern below which it matters to nobody."""

BRIGHT_DARK = 0.2
"""Part of the range above the stated black level that no dark frame reaches without light."""


_STATED = {"camera_serial": "camera serial", "camera_model": "camera model", "iso": "ISO"}


def refuse_foreign_frame(first: RawHead, frame: RawHead) -> None:
    """Refuse a frame that another camera or another setting made than the first one of its session.

    Raises
    ------
    BadInput
        It names the frame and what differs.
    """
    _refuse_other(first, frame, "shoot it again with the camera and the setting of the others")


def refuse_foreign_calibration(sensor: SensorModel, frame: RawHead) -> None:
    """Refuse a frame of another camera or ISO than the sensor's calibration; the unstated cannot contradict.

    Raises
    ------
    BadInput
        It names the frame and what differs.
    """
    for name in ("camera_serial", "iso"):
        calibrated, used = getattr(sensor, name), getattr(frame, name)
        if calibrated and used and calibrated != used:
            what = f"its {_STATED[name]} is {used}, the sensor was calibrated at {calibrated}"
            if name == "camera_serial":
                what = f"it is of camera {used}, the sensor's calibration of {calibrated}"
            raise BadInput(
                what, where=str(frame.path), todo="merge it with the calibration of this camera and setting"
            )


def refuse_foreign_darks(frames: Sequence[RawHead], darks: Sequence[RawHead]) -> None:
    """Refuse darks that another camera or another setting made, as far as files state it.

    Raises
    ------
    BadInput
        It names the dark frame and what differs.
    """
    for dark in darks:
        _refuse_other(frames[0], dark, "give darks of the same camera at the same setting")
        if dark.lit:
            raise BadInput("the lamp was on, it says", where=str(dark.path), todo="leave it out of the darks")


def _refuse_other(ours: RawHead, theirs: RawHead, todo: str) -> None:
    for name, what in _STATED.items():
        one, other = getattr(ours, name), getattr(theirs, name)
        if one is not None and other is not None and one != other:
            differs = f"its {what} is {other}, that of {ours.path.name} is {one}"
            raise BadInput(differs, where=str(theirs.path), todo=todo)


def refuse_light_in_darks(dark: DarkModel, stack: Stack, darks: Sequence[RawHead]) -> None:
    """Refuse darks that show the scene, or are far too bright to be dark.

    A sensor's own dark pattern knows nothing of the scene: medians over small pieces of a dark frame that
    follow those of a lit frame are light. Fixed pattern within pieces averages out.

    Parameters
    ----------
    dark : DarkModel
        Fitted to the darks.
    stack : Stack
        The lit frames.
    darks : sequence of RawHead
        The dark files, to name one.

    Raises
    ------
    BadInput
        It names a dark frame of the exposure that holds light.
    """
    step = thinning(stack.shape, _SAMPLE_PIXELS)
    black = 0.0 if stack.black_dn is None else float(np.mean(stack.black_dn))
    scenes = [_pieces(thin(frame, step).astype(np.float64)) for frame in stack.counts]
    for seconds, mean in zip(dark.exposure_s, dark.mean_dn, strict=True):
        level = thin(np.where(dark.hot, np.median(mean), mean), step)
        todo = f"shoot the darks of {seconds:g} s again with the lens covered, or leave them out"
        where = _name_of(darks, seconds)
        if math.isfinite(stack.white_dn) and np.median(level) - black > BRIGHT_DARK * (
            stack.white_dn - black
        ):
            what = f"a dark frame reads {np.median(level):.0f} DN: light fell on it"
            raise BadInput(what, where=where, todo=todo)
        pattern = _pieces(level)
        if pattern.size < _FEWEST_PIECES or pattern.std() < PATTERN_DN:
            continue
        alike = max(_correlation(pattern, scene) for scene in scenes)
        if alike > ALIKE:
            what = f"a dark frame shows the scene (correlation {alike:.2f}): light fell on it"
            raise BadInput(what, where=where, todo=todo)


def is_all_clipped(merged: Merged) -> bool:
    """Whether all frames are clipped everywhere: the merge holds nothing but a lower bound."""
    return bool(np.all(merged.flags & np.uint8(Flag.OVER_RANGE)))


def refuse_all_clipped(merged: Merged, stack: Stack) -> None:
    """Refuse a bracket whose frames are clipped everywhere: it holds nothing but a lower bound.

    Raises
    ------
    BadInput
        It names the shortest frame.
    """
    if is_all_clipped(merged):
        shortest = stack.shortest[0]
        what = (
            f"every pixel is clipped in every frame, in the shortest ({stack.exposure_s[shortest]:g} s) too"
        )
        raise BadInput(what, where=stack.names[shortest], todo="add shorter exposures")


def _pieces(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Medians over small squares, those of the four positions of the cell added: colours do not show."""
    rows, cols = (size // _PIECE for size in values.shape)
    cut = values[: rows * _PIECE, : cols * _PIECE]
    parts = cut.reshape(rows, _PIECE // 2, 2, cols, _PIECE // 2, 2).transpose(0, 3, 2, 5, 1, 4)
    return np.asarray(np.median(parts.reshape(rows * cols, 4, -1), axis=2).sum(axis=1))


def _correlation(one: NDArray[np.floating], other: NDArray[np.floating]) -> float:
    if one.size != other.size or other.std() == 0.0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


def _name_of(darks: Sequence[RawHead], seconds: float) -> str:
    named = [dark for dark in darks if dark.exposure_s is not None and math.isclose(dark.exposure_s, seconds)]
    return str((named or list(darks))[0].path)
