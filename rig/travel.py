"""Going to a pose: round what is in the way, from the side that a joint comes from, and no other way.

Every leg is proved clear before its first byte is on the wire; `rig.lag` then watches that the arms keep to
it.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

from rig.errors import Refused

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rig.arms import Arms, HeldPose
    from rig.clearance import Clearance
    from rig.description import Rig
    from rig.detour import Detours

MOST_LEGS = 50
"""A detour has a handful of legs; one that is longer goes in circles."""


class Travel:
    """Moves of a machine's arms past its solids.

    Parameters
    ----------
    rig : Rig
    arms : Arms
    """

    def __init__(self, rig: Rig, arms: Arms) -> None:
        self._rig, self._arms = rig, arms

    def move(self, angles_rad: Sequence[float], station: str | None = None) -> HeldPose:
        """Go to a pose; see `rig.arms.Arms.move`.

        Raises
        ------
        Refused
            Also if there is no way round what is in the way.
        """
        goal = self._arms.goal(angles_rad, station)
        lead = self._arms.lead_in(goal, station)
        if lead is None:
            return self._to(goal, station)
        stood = self._to(lead, station, leading=True).angles_rad
        if self._rig.solids and len(self._detours.way(stood, goal)) > 1:
            raise Refused(
                "solids are in the way of the one-sided approach to this pose",
                where="move",
                todo="choose another pose, or another approach in the rig file; 'gonio rig show' draws it",
            )
        return self._leg(goal, station)

    def _to(self, goal: Sequence[float], station: str | None, *, leading: bool = False) -> HeldPose:
        """Go to a pose leg by leg."""
        if not self._rig.solids:
            return self._leg(goal, station, leading=leading)
        way = self._detours.way(self._arms.measure().angles_rad, goal)
        for _ in range(MOST_LEGS):
            if len(way) == 1:
                return self._leg(goal, station, leading=leading)
            stood = self._leg(way[0], leading=True).angles_rad
            way = self._detours.onward(stood, way[1:])
        raise Refused("the way round does not end", where="move", todo="park the arms, then move again")

    def _leg(self, goal: Sequence[float], station: str | None = None, *, leading: bool = False) -> HeldPose:
        """Make one move that has been checked, and stop if a joint leaves it."""
        return self._arms.move(goal, station, leading=leading, slack_rad=self._slack_rad)

    @cached_property
    def _slack_rad(self) -> float:
        """How far a joint may be off its way; without solids as far as it likes, unless the file says."""
        return self._clearance.slack_rad if self._rig.solids or self._rig.clearance.lag_deg else math.inf

    @cached_property
    def _clearance(self) -> Clearance:
        """The solids; made at the first move, so that opening stays quick."""
        from rig.clearance import Clearance

        return Clearance(self._rig)

    @cached_property
    def _detours(self) -> Detours:
        from rig.detour import Detours

        return Detours(self._clearance)
