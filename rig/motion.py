"""How the joints turn during a move: together on a straight line, or each with its own profile.

All servos start at once, and each is as fast as its own profile allows, so short ways end early: the arms
leave the straight line between two poses by as much as their ways differ. Either way no joint turns back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rig.handshake import ServoSpec

if TYPE_CHECKING:
    import numpy.typing as npt

    from rig.angles import FloatArray
    from rig.convex import IntArray
    from rig.description import Rig


@dataclass(frozen=True, eq=False)
class ServoProfile:
    """What the servos are told, in radians of the joints.

    Attributes
    ----------
    speed_rad_s, acceleration_rad_s2 : ndarray, shape (J,)
    """

    speed_rad_s: FloatArray
    acceleration_rad_s2: FloatArray

    @classmethod
    def of(cls, rig: Rig) -> ServoProfile:
        """Profiles as they are written to the servos of the arms, in whole counts."""
        specs = [ServoSpec.of(joint) for joint in rig.arm_joints]
        tick_rad = np.radians([spec.tick_deg for spec in specs])
        return cls(
            np.array([spec.speed_ticks_s for spec in specs]) * tick_rad,
            np.array([spec.acceleration_ticks_s2 for spec in specs]) * tick_rad,
        )


def travel_s(start: npt.ArrayLike, end: npt.ArrayLike, profile: ServoProfile) -> FloatArray:
    """Time of moves, from standing to standing.

    Over a distance d at top speed v and acceleration a it is d/v + v/a, or 2 sqrt(d/a) where the way is too
    short to reach v.

    Parameters
    ----------
    start, end : array_like, shape (..., J)
        Joint angles, radians.
    profile : ServoProfile

    Returns
    -------
    ndarray, shape (...)
        Seconds, of the slowest joint.
    """
    way = np.abs(np.asarray(end, dtype=np.float64) - np.asarray(start, dtype=np.float64))
    speed, acceleration = profile.speed_rad_s, profile.acceleration_rad_s2
    short = way < speed**2 / acceleration
    times = np.where(short, 2.0 * np.sqrt(way / acceleration), way / speed + speed / acceleration)
    return np.asarray(np.max(times, axis=-1))


class Moves:
    """M moves from pose to pose, all joints at once.

    Parameters
    ----------
    start, end : ndarray, shape (M, J)
        Radians.
    profile : ServoProfile, optional
        Each joint's own; by default all joints turn in proportion, along straight lines.
    """

    def __init__(self, start: FloatArray, end: FloatArray, profile: ServoProfile | None = None) -> None:
        self.start, self.end, self._profile = start, end, profile
        if profile is None:
            return
        way = np.abs(end - start)
        acceleration = profile.acceleration_rad_s2
        self._peak = np.minimum(profile.speed_rad_s, np.sqrt(way * acceleration))
        with np.errstate(invalid="ignore"):
            cruise = np.where(way > 0.0, way / self._peak, 0.0)
        self._ramp_s = self._peak / acceleration
        self._ends_s = cruise + self._ramp_s
        self.duration_s = self._ends_s.max(axis=1)

    def at(self, move: IntArray, share: FloatArray) -> FloatArray:
        """Poses of some moves.

        Parameters
        ----------
        move : ndarray of int, shape (K,)
        share : ndarray, shape (K,)
            Share of the move's time that has passed, 0 to 1.

        Returns
        -------
        ndarray, shape (K, J)
            Exactly the ends at 0 and 1; no joint ever turns back in between.
        """
        start, end = self.start[move], self.end[move]
        if self._profile is None:
            return np.asarray((1.0 - share)[:, None] * start + share[:, None] * end)
        way, ramp, ends = np.abs(end - start), self._ramp_s[move], self._ends_s[move]
        peak, acceleration = self._peak[move], self._profile.acceleration_rad_s2
        time_s = np.minimum((share * self.duration_s[move])[:, None], ends)
        left_s = ends - time_s
        # Speeding up, cruising, braking; whichever is least (first two) or most (last two) holds.
        begun = np.where(time_s < ramp, acceleration * time_s**2 / 2.0, peak * (time_s - ramp / 2.0))
        done = np.where(left_s < ramp, way - acceleration * left_s**2 / 2.0, begun)
        done = np.clip(done, 0.0, way)
        return np.asarray(np.where(done >= way, end, start + np.copysign(done, end - start)))
