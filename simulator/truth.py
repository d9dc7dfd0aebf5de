"""Where the arms really stand: what the encoders report and the part below one tick that they cannot see."""

from __future__ import annotations

import hashlib
import math
from typing import TYPE_CHECKING

from rig.ticks import ticks_to_rad

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rig.description import Rig

STATION_TOLERANCE_DEG = 1.0
"""A station further off the centre than this is not in front of the camera."""


def residual_ticks(seed: int, servo_id: int, tick: int) -> float:
    """Offset of a held shaft from its encoder's tick, uniform in [-0.5, 0.5).

    It is a hash: the same servo at the same tick always stands at the same angle, so that a pose that is
    approached again gives the same picture.
    """
    digest = hashlib.blake2b(f"{seed}/{servo_id}/{tick}".encode(), digest_size=6).digest()
    return int.from_bytes(digest, "big") / 2.0**48 - 0.5


def true_angles_rad(
    rig: Rig, seed: int, ticks: Mapping[str, int], behind: Mapping[str, float] | None = None
) -> tuple[float, ...]:
    """Return the true angles of the arm joints, in the order of `rig.arm_joints`.

    Parameters
    ----------
    rig : Rig
    seed : int
        The twin's seed.
    ticks : mapping of str to int
        Encoder tick of every joint, by name.
    behind : mapping of str to float, optional
        How far backlash lets each arm hang from its encoder, in ticks; not at all by default.
    """
    hangs = behind or {}
    return tuple(
        ticks_to_rad(
            joint,
            ticks[joint.name]
            + residual_ticks(seed, joint.id, ticks[joint.name])
            + hangs.get(joint.name, 0.0),
        )
        for joint in rig.arm_joints
    )


def station_at(rig: Rig, ticks: Mapping[str, int]) -> str | None:
    """Return the station that the wheel holds at the centre; None between stations or without a wheel."""
    wheel = rig.station_joint
    if wheel is None:
        return None
    angle_deg = math.degrees(ticks_to_rad(wheel, ticks[wheel.name]))
    off_deg = {
        name: abs(math.remainder(angle_deg - station.angle_deg, 360.0))
        for name, station in rig.stations.items()
    }
    nearest = min(off_deg, key=off_deg.__getitem__)
    return nearest if off_deg[nearest] <= STATION_TOLERANCE_DEG else None
