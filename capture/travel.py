"""The moves from pose to pose past a machine's solids: their ways, their time, and poses that are cut off."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.feasible import Feasible, Reason, Refusal
from rig.detour import LEG_S, Detours
from rig.motion import travel_s

if TYPE_CHECKING:
    from rig.angles import FloatArray
    from rig.clearance import Clearance
    from rig.motion import ServoProfile

    Order = np.ndarray[Any, np.dtype[np.int64]]
    Leg = tuple[int, int]

_START = -1
"""Stands for where the arms are at first, in legs between rows of poses."""


@dataclass(frozen=True, slots=True)
class Travel:
    """What the moves of a capture cost: to the first pose, through all of them, and all the way back.

    Attributes
    ----------
    first_s, there_s, back_s : float
        Seconds, with the stops of detours.
    first_round, there_round, back_round : int
        How many of the moves go round solids.
    """

    first_s: float
    there_s: float
    back_s: float
    first_round: int
    there_round: int
    back_round: int

    def seconds(self, passes: int) -> float:
        """Time of all moves, there and back in turn."""
        return self.first_s + (passes + 1) // 2 * self.there_s + passes // 2 * self.back_s

    def detours(self, passes: int) -> int:
        """Count the moves that go round solids."""
        return self.first_round + (passes + 1) // 2 * self.there_round + passes // 2 * self.back_round


def travel_past(
    clearance: Clearance, found: Feasible, order: Order, start: FloatArray
) -> tuple[Feasible, Order, Travel]:
    """Find the way of every move, and leave out the poses to which there is none.

    Parameters
    ----------
    clearance : Clearance
    found : Feasible
        Every pose taken is clear of solids.
    order : ndarray of int, shape (M,)
        Rows of `found.angles_rad` in the order in which they are visited.
    start : ndarray, shape (J,)
        Where the arms stand before.

    Returns
    -------
    found : Feasible
        Without the poses that are cut off.
    order : ndarray of int
        Of the rows that are left.
    travel : Travel
    """
    ways = _Ways(clearance, found.angles_rad, start)
    route = [int(row) for row in order]
    cut_off: dict[int, str] = {}
    while True:
        legs = list(itertools.pairwise([_START, *route]))
        ways.find(legs)
        ways.find([(end, begin) for begin, end in legs[1:]])
        closed = [leg for leg in legs if not ways.open(leg)]
        if not closed:
            break
        # Whether a pose is cut off is seen from one that is not: the pose after it is looked at again.
        ends = {end for _, end in closed}
        for begin, end in closed:
            if begin not in ends:
                cut_off[end] = ways.why_not((begin, end))
        route = [row for row in route if row not in cut_off]
    refusals = [
        Refusal(int(found.taken[row]), Reason.CUT_OFF, f"pose {int(found.taken[row])}: {why}")
        for row, why in cut_off.items()
    ]
    kept = np.cumsum([row not in cut_off for row in range(len(found.taken))]) - 1
    left = np.array([kept[row] for row in route], dtype=np.int64)
    return found.without(refusals), left, ways.travel(legs, clearance.profile)


class _Ways:
    """Ways between rows of poses, each looked for once."""

    def __init__(self, clearance: Clearance, angles: FloatArray, start: FloatArray) -> None:
        self._angles, self._start = angles, start
        self._detours = Detours(clearance)
        # Arms that are parked too near to each other may still leave.
        parked = clearance.poses(start[None]).clear[0]
        self._leaving = self._detours if parked else Detours(clearance.leaving(start))
        self._found: dict[Leg, FloatArray | None] = {}

    def find(self, legs: list[Leg]) -> None:
        """Look for ways that are not known yet."""
        for first, detours in ((True, self._leaving), (False, self._detours)):
            new = [leg for leg in legs if leg not in self._found and (leg[0] == _START) is first]
            if new:
                begins, ends = (
                    np.stack([self._pose(row) for row in rows]) for rows in zip(*new, strict=True)
                )
                self._found |= dict(zip(new, detours.ways(begins, ends), strict=True))

    def open(self, leg: Leg) -> bool:
        """Whether a leg can be gone, there and back; from the start only there."""
        back = leg[::-1]
        return self._found[leg] is not None and (leg[0] == _START or self._found[back] is not None)

    def why_not(self, leg: Leg) -> str:
        """Say what is in the way of a leg."""
        leg = leg if self._found[leg] is None else leg[::-1]
        return self._detours.why_not(self._pose(leg[0]), self._pose(leg[1]))

    def travel(self, legs: list[Leg], profile: ServoProfile) -> Travel:
        """Add up the ways there and back."""
        first, there = legs[:1], legs[1:]
        costs = [self._cost(some, profile) for some in (first, there, [leg[::-1] for leg in there])]
        seconds, detours = zip(*costs, strict=True)
        return Travel(*seconds, *detours)

    def _cost(self, legs: list[Leg], profile: ServoProfile) -> tuple[float, int]:
        """Seconds of legs, and how many of them go round."""
        ways = [way for leg in legs if (way := self._found[leg]) is not None]
        if not ways:
            return 0.0, 0
        begins = [np.vstack([self._pose(leg[0]), way[:-1]]) for leg, way in zip(legs, ways, strict=True)]
        seconds = travel_s(np.concatenate(begins), np.concatenate(ways), profile)
        stops = sum(len(way) - 1 for way in ways)
        return float(np.sum(seconds)) + LEG_S * stops, sum(len(way) > 1 for way in ways)

    def _pose(self, row: int) -> FloatArray:
        return self._start if row == _START else self._angles[row]
