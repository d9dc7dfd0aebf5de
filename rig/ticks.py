"""Servo ticks and joint angles.

A tick is the encoder's unit: 4096 to a turn of the servo's shaft. ``zero_ticks`` is where the joint's angle
is zero, and a joint behind a gear turns ``1 / gear_ratio`` as far as its servo.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, overload

import numpy as np
import numpy.typing as npt

from rig.errors import BadInput

if TYPE_CHECKING:
    from rig.description import Joint

TICKS_PER_TURN = 4096
"""Positions of an X-series servo in one turn of its shaft (ROBOTIS e-manual, XH430-W350, "Resolution")."""


def tick_rad(joint: Joint) -> float:
    """Angle of the joint that one tick of its servo stands for, in radians."""
    return 2.0 * math.pi / (TICKS_PER_TURN * joint.gear_ratio)


@overload
def ticks_to_rad(joint: Joint, ticks: float) -> float: ...
@overload
def ticks_to_rad(joint: Joint, ticks: npt.NDArray[np.generic]) -> npt.NDArray[np.float64]: ...
def ticks_to_rad(joint: Joint, ticks: float | npt.NDArray[np.generic]) -> float | npt.NDArray[np.float64]:
    """Joint angle at a servo position.

    Parameters
    ----------
    joint : Joint
    ticks : number or ndarray
        Servo position in ticks; fractions are allowed, because an encoder's tick covers a range of angles.

    Returns
    -------
    float or ndarray
        Radians, the same shape.
    """
    if isinstance(ticks, np.ndarray):
        return np.asarray((ticks.astype(np.float64) - joint.zero_ticks) * tick_rad(joint))
    return (float(ticks) - joint.zero_ticks) * tick_rad(joint)


@overload
def rad_to_ticks(joint: Joint, angle_rad: float) -> int: ...
@overload
def rad_to_ticks(joint: Joint, angle_rad: npt.NDArray[np.generic]) -> npt.NDArray[np.int64]: ...
def rad_to_ticks(joint: Joint, angle_rad: float | npt.NDArray[np.generic]) -> int | npt.NDArray[np.int64]:
    """Servo position nearest to a joint angle.

    Parameters
    ----------
    joint : Joint
    angle_rad : number or ndarray
        Joint angle in radians.

    Returns
    -------
    int or ndarray of int64
        Ticks, the same shape; not limited to the servo's range.

    Raises
    ------
    BadInput
        An angle is NaN or infinite: no position stands for it.
    """
    angles = np.asarray(angle_rad, dtype=np.float64)
    if not np.all(np.isfinite(angles)):
        raise BadInput(
            "an angle is not a number", where=f"joint {joint.name}", todo="give a finite angle in degrees"
        )
    ticks = np.rint(angles / tick_rad(joint) + joint.zero_ticks).astype(np.int64)
    return ticks if isinstance(angle_rad, np.ndarray) else int(ticks)
