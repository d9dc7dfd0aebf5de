"""Which poses of a set a machine can take, with which joint angles, and why not the others.

A pose may be met in several ways: the arms on this side or on that. The one with the least travel is taken
that keeps the solids apart, leaves the sample in light and in sight, and the lamp out of the picture.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from capture.records import PoseFlag
from rig.angles import direction_to_spherical
from rig.approach import leads_rad
from rig.clearance import Clearance
from rig.errors import Refused
from rig.shadows import Shadows

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

    from rig.angles import FloatArray
    from rig.description import Rig
    from rig.kinematics import Kinematics
    from rig.swept import Sweep

_AT_HORIZON = 1e-9

_FREE = 1e-9
"""Joints that turn together without moving lamp or camera by more than this, per radian, are free."""

_FREE_TURNS_RAD = np.radians(np.delete(np.arange(-180.0, 181.0, 30.0), 6))
"""How far free joints are turned to get past a solid."""


class Reason(StrEnum):
    """Why a machine cannot take a pose, or what spoils it."""

    BELOW_HORIZON = "light or camera at or below the sample's horizon"
    SEPARATION = "light and camera too close together"
    REACH = "outside the joints' limits"
    CLEARANCE = "solids too near to each other"
    CUT_OFF = "no way there past the solids"
    SHADED = "a solid shades the sample"
    HIDDEN = "a solid hides the sample from the camera"
    LAMP_IN_VIEW = "the lamp shines into the camera's frame"


SPOILED: Mapping[Reason, PoseFlag] = {
    Reason.SHADED: PoseFlag.SHADED,
    Reason.HIDDEN: PoseFlag.HIDDEN,
    Reason.LAMP_IN_VIEW: PoseFlag.LAMP_IN_VIEW,
}
"""Marks of poses that the machine can take, but whose pictures are not of the sample in the lamp's light."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """A pose that a machine cannot take, or that is spoiled.

    Attributes
    ----------
    index : int
        Its place in the set.
    reason : Reason
    detail : str
        One line with pose, joint or solid, angle and limit.
    """

    index: int
    reason: Reason
    detail: str


@dataclass(frozen=True, eq=False)
class Feasible:
    """A set of poses sorted by what a machine can take.

    Attributes
    ----------
    wi, wo : ndarray, shape (N, 3)
        The whole set.
    taken : ndarray of int, shape (M,)
        The poses that it can take.
    angles_rad : ndarray, shape (M, J)
        Joint angles of those.
    refusals : tuple of Refusal
        The N - M others.
    marks : tuple of Refusal
        Those among the poses taken that are spoiled.
    """

    wi: FloatArray
    wo: FloatArray
    taken: npt.NDArray[np.int64]
    angles_rad: FloatArray
    refusals: tuple[Refusal, ...]
    marks: tuple[Refusal, ...] = ()

    @property
    def counts(self) -> dict[str, int]:
        """How many poses are refused, by reason."""
        return dict(Counter(refusal.reason.value for refusal in self.refusals))

    @property
    def flags(self) -> dict[int, PoseFlag]:
        """Marks of the poses that are taken though they are spoiled, by their place in the set."""
        return {mark.index: SPOILED[mark.reason] for mark in self.marks}

    @property
    def marked(self) -> dict[str, int]:
        """How many poses are taken though they are spoiled, by reason."""
        return dict(Counter(mark.reason.value for mark in self.marks))

    def without(self, refusals: list[Refusal]) -> Feasible:
        """Return the same with some of the poses taken refused after all."""
        gone = {refusal.index for refusal in refusals}
        kept = np.array([index not in gone for index in self.taken], dtype=bool)
        return Feasible(
            self.wi,
            self.wo,
            self.taken[kept],
            self.angles_rad[kept],
            tuple(sorted([*self.refusals, *refusals], key=lambda refusal: refusal.index)),
            tuple(mark for mark in self.marks if mark.index not in gone),
        )


class Obstacles:
    """What stands in the way of poses on one machine.

    Parameters
    ----------
    rig : Rig

    Attributes
    ----------
    clearance : Clearance
    shadows : Shadows
    """

    def __init__(self, rig: Rig) -> None:
        self.clearance = Clearance(rig)
        self.shadows = Shadows(rig)

    def at(self, angles_rad: FloatArray) -> list[tuple[Reason, str] | None]:
        """Tell what stands in the way of K poses.

        Parameters
        ----------
        angles_rad : ndarray, shape (K, J)

        Returns
        -------
        list of ((Reason, str) or None)
            Why each is refused or spoiled, in a word and in a line; None where it is neither.
        """
        found: list[tuple[Reason, str] | None] = [None] * len(angles_rad)
        near, sight = self._near(angles_rad), self.shadows.at(angles_rad)
        for pose in np.flatnonzero(~(near.clear & sight.clear)):
            if not near.clear[pose]:
                found[pose] = Reason.CLEARANCE, self.clearance.describe(near, int(pose))
            elif sight.shaded_by[pose] >= 0:
                name = self.shadows.names[sight.shaded_by[pose]]
                found[pose] = Reason.SHADED, f"{name} would shade the sample"
            elif sight.hidden_by[pose] >= 0:
                name = self.shadows.names[sight.hidden_by[pose]]
                found[pose] = Reason.HIDDEN, f"{name} would hide the sample from the camera"
            else:
                found[pose] = Reason.LAMP_IN_VIEW, "the lamp would shine into the camera's frame"
        return found

    def _near(self, angles_rad: FloatArray) -> Sweep:
        """Check poses and, where joints come from one side only, the last push to each."""
        found = self.clearance.poses(angles_rad)
        for leads in leads_rad(self.clearance.rig, angles_rad):
            left = np.flatnonzero(found.clear)
            push = self.clearance.moves(leads[left], angles_rad[left])
            found.clear[left], found.pair[left] = push.clear, push.pair
            found.angles_rad[left] = push.angles_rad
        return found


def feasible(
    kinematics: Kinematics,
    wi: FloatArray,
    wo: FloatArray,
    obstacles: Obstacles | None = None,
    *,
    mark: bool = False,
) -> Feasible:
    """Find joint angles for every pose, and why not where there are none.

    Parameters
    ----------
    kinematics : Kinematics
        Of the machine.
    wi, wo : ndarray, shape (N, 3)
    obstacles : Obstacles, optional
        Of the same machine, where they are at hand.
    mark : bool
        Take poses that are spoiled, and mark them.

    Returns
    -------
    Feasible
    """
    taken: list[int] = []
    angles: list[FloatArray] = []
    refusals: list[Refusal] = []
    near = None
    for index, (light, camera) in enumerate(zip(wi, wo, strict=True)):
        if min(light[2], camera[2]) < _AT_HORIZON:
            refusals.append(Refusal(index, Reason.BELOW_HORIZON, _named(light, camera)))
            continue
        try:
            near = kinematics.solve(light, camera, near)
        except Refused as error:
            refusals.append(
                Refusal(index, _reason(kinematics, light, camera), f"{error.where}: {error.what}")
            )
        else:
            taken.append(index)
            angles.append(near)
    found = Feasible(
        wi,
        wo,
        np.array(taken, dtype=np.int64),
        np.array(angles).reshape(-1, len(kinematics.joints)),
        tuple(refusals),
    )
    return _past_obstacles(kinematics, found, obstacles or Obstacles(kinematics.rig), mark=mark)


def _past_obstacles(kinematics: Kinematics, found: Feasible, obstacles: Obstacles, *, mark: bool) -> Feasible:
    """Look for other joint angles where something stands in the way; refuse or mark what is left."""
    angles = found.angles_rad.copy()
    refusals: list[Refusal] = []
    marks: list[Refusal] = []
    for row, obstacle in enumerate(obstacles.at(angles)):
        if obstacle is None:
            continue
        index = int(found.taken[row])
        wi, wo = found.wi[index], found.wo[index]
        others = _other_ways(kinematics, wi, wo, angles[row])
        ways = [(angles[row], obstacle), *zip(others, obstacles.at(others), strict=True)]
        # The first way that nothing spoils; else the first that solids leave open.
        angles[row], reason = min(
            ways, key=lambda way: 0 if way[1] is None else 1 if way[1][0] in SPOILED else 2
        )
        if reason is not None:
            refusal = Refusal(index, reason[0], f"{_named(wi, wo)}: {reason[1]}")
            (marks if mark and reason[0] in SPOILED else refusals).append(refusal)
    moved = Feasible(found.wi, found.wo, found.taken, angles, found.refusals, tuple(marks))
    return moved.without(refusals)


def _other_ways(kinematics: Kinematics, wi: FloatArray, wo: FloatArray, angles: FloatArray) -> FloatArray:
    """Find other joint angles (K, J) of a pose: from other sides, and with free joints turned."""
    ways = kinematics.solutions(wi, wo, angles)[1:]
    slopes = np.concatenate(kinematics.derivatives(angles), axis=-1)  # (J, 6)
    turns, sizes, _ = np.linalg.svd(slopes)
    free = turns[:, np.concatenate([sizes, np.zeros(len(angles) - len(sizes))]) < _FREE]
    for turn in free.T:
        steps = _FREE_TURNS_RAD[:, None] * (turn / np.abs(turn).max())
        for near in np.clip(angles + steps, *kinematics.limits_rad.T):
            ways += kinematics.solutions(wi, wo, near)
    return np.array(ways).reshape(-1, len(angles))


def _reason(kinematics: Kinematics, wi: FloatArray, wo: FloatArray) -> Reason:
    apart = 2.0 * math.atan2(float(np.linalg.norm(wi - wo)), float(np.linalg.norm(wi + wo)))
    least = math.radians(kinematics.rig.clearance.min_separation_deg)
    return Reason.SEPARATION if apart < least else Reason.REACH


def _named(wi: FloatArray, wo: FloatArray) -> str:
    theta, phi = direction_to_spherical(np.stack([wi, wo]))
    angles = np.degrees([theta[0], phi[0], theta[1], phi[1]])
    names = ("theta_i", "phi_i", "theta_o", "phi_o")
    return "pose " + " ".join(f"{n} {a:.2f}" for n, a in zip(names, angles, strict=True)) + " deg"
