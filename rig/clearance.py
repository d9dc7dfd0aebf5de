"""Whether a machine's solids keep their distance, at poses and along whole moves."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rig.clearance_pairs import SolidPairs
from rig.motion import Moves, ServoProfile
from rig.swept import near_poses, sweep

if TYPE_CHECKING:
    import numpy.typing as npt

    from rig.angles import FloatArray
    from rig.description import Rig
    from rig.swept import Sweep

_BEYOND_LIMITS_RAD = math.radians(1.0)
"""An arm may stand this far beyond a limit: its tolerance, and what it gives way."""


@dataclass(frozen=True, eq=False)
class Nearness:
    """The two solids that are nearest to each other at a pose.

    Attributes
    ----------
    solids : tuple of str
        Their names.
    distance_mm : float
        0 where they touch or overlap.
    points_mm : ndarray, shape (2, 3)
        A nearest point of each, in the frame of the base.
    """

    solids: tuple[str, str]
    distance_mm: float
    points_mm: FloatArray


class Clearance:
    """The solids of a machine and the margin that they keep.

    Parameters
    ----------
    rig : Rig

    Attributes
    ----------
    pairs : SolidPairs
        Those that can come near.
    profile : ServoProfile
        How the servos turn.
    """

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.profile = ServoProfile.of(rig)
        self._all = SolidPairs(rig)
        within = self._all.without(self._all.out_of_reach())
        self.pairs = within.without(_never_near(within))

    def poses(self, angles_rad: FloatArray) -> Sweep:
        """Check poses, shape (M, J); see `rig.swept.near_poses`."""
        return near_poses(self.pairs, np.asarray(angles_rad, dtype=np.float64))

    def moves(self, start: FloatArray, end: FloatArray) -> Sweep:
        """Check moves as the servos carry them out, shapes (M, J); see `rig.swept.sweep`."""
        return sweep(self.pairs, Moves(start, end, self.profile))

    def straight_moves(self, start: FloatArray, end: FloatArray) -> Sweep:
        """Check moves on straight lines between poses, shapes (M, J)."""
        return sweep(self.pairs, Moves(start, end))

    @property
    def slack_rad(self) -> float:
        """How far one joint may be off its way: what the rig file says, or until a margin is used up."""
        if self.rig.clearance.lag_deg:
            return math.radians(self.rig.clearance.lag_deg)
        levers = self.pairs.levers_mm.max(axis=1, initial=0.0)
        return float(np.min(self.pairs.margins_mm / levers, initial=np.inf))

    def leaving(self, angles_rad: npt.ArrayLike) -> Clearance:
        """Return the clearance for moves from a pose (J,) where the arms stand too near to each other.

        An arm within its tolerance of its goal, or one turned by hand, may stand nearer than the margin: on
        its way out no two solids come nearer than they are there.
        """
        leaving = copy.copy(self)
        leaving.pairs = self.pairs.leaving(np.asarray(angles_rad, dtype=np.float64))
        return leaving

    def nearest(self, angles_rad: npt.ArrayLike) -> Nearness | None:
        """Find the two solids that are nearest at a pose; None if there are no two that move past each other.

        Pairs that no pose brings near, such as two sides of a bearing, count only where there are no others.

        Parameters
        ----------
        angles_rad : array_like, shape (J,)
        """
        pairs = self.pairs if len(self.pairs.pairs) else self._all
        count = len(pairs.pairs)
        if not count:
            return None
        poses = pairs.poses(np.asarray(angles_rad, dtype=np.float64)[None])
        answer = pairs.bounds(poses, np.zeros(count, dtype=np.int64), np.arange(count))
        pair = int(np.argmin(answer.upper_mm))
        points = pairs.on_surfaces(pair, answer.points_mm[pair])
        return Nearness(pairs.solids_of(pair), max(float(answer.upper_mm[pair]), 0.0), points)

    def describe(self, found: Sweep, number: int) -> str:
        """Say which solids come too near, and at which angles.

        Parameters
        ----------
        found : Sweep
        number : int
            A pose or move that is not clear.
        """
        pair = int(found.pair[number])
        first, second = self.pairs.solids_of(pair)
        at = ", ".join(
            f"{joint.name} {math.degrees(angle):.1f}"
            for joint, angle in zip(self.rig.arm_joints, found.angles_rad[number], strict=True)
        )
        return f"{first} and {second} would be nearer than {self.pairs.margins_mm[pair]:.3g} mm at {at} deg"


def _never_near(pairs: SolidPairs) -> npt.NDArray[np.int64]:
    """Find pairs that one joint alone moves past each other, and that its whole range leaves clear."""
    alone = np.flatnonzero(np.sum(pairs.levers_mm > 0.0, axis=1) == 1)
    low, high = pairs.kinematics.limits_rad.T
    never = []
    for pair in alone:
        joint = int(np.argmax(pairs.levers_mm[pair]))
        ends = np.zeros((2, len(low)))
        ends[:, joint] = low[joint] - _BEYOND_LIMITS_RAD, high[joint] + _BEYOND_LIMITS_RAD
        others = np.delete(np.arange(len(pairs.pairs)), pair)
        if sweep(pairs.without(others), Moves(ends[:1], ends[1:])).clear[0]:
            never.append(pair)
    return np.array(never, dtype=np.int64)
