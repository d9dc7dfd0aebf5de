"""Whether servos that move together are still on the way that was checked for them.

The way is a curve through all joints at once: where each is at one time. Solids were proved to keep apart on
that curve and nowhere else, so it is the curve that counts, not the clock. A joint's position tells at which
times of the profile it belongs there; as long as there is a time that suits all joints, the arms are on their
way, however fast or late the clock thinks they are. Looks that come late and servos that all follow their
profiles with the same delay raise no alarm; one joint that hangs back, or runs ahead, does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rig.handshake import ServoSpec
    from rig.trapezoid import Trapezoid

_READING_TICKS = 1
"""A position is a whole number of ticks, and so was the one at the start."""


@dataclass(frozen=True, slots=True)
class Lag:
    """A joint that is not where it was when the way was checked.

    Attributes
    ----------
    servo_id : int
    ticks : float
        How far it is behind where the joint that is ahead says that it should be; beyond its start or its
        goal, how far.
    ahead : int or None
        The joint that is ahead of it; perhaps that one runs too fast.
    """

    servo_id: int
    ticks: float
    ahead: int | None = None


class CheckedWay:
    """One move of several servos, which start at once, each with its own profile.

    Parameters
    ----------
    specs : mapping of int to ServoSpec
    start, goals : mapping of int to int
        Servo id -> ticks.
    slack : mapping of int to float
        Servo id -> ticks that it may be off the way; servos left out are not looked at.
    """

    def __init__(
        self,
        specs: Mapping[int, ServoSpec],
        start: Mapping[int, int],
        goals: Mapping[int, int],
        slack: Mapping[int, float],
    ) -> None:
        self._joints = {
            servo_id: _Joint.of(specs[servo_id], start[servo_id], goals[servo_id], ticks)
            for servo_id, ticks in slack.items()
            if servo_id in goals and math.isfinite(ticks)
        }

    def lag(self, positions: Mapping[int, int]) -> Lag | None:
        """Find the joint that is farthest off the way; None while all are on it.

        Parameters
        ----------
        positions : mapping of int to int
            Servo id -> ticks, all read at one time; servos may be missing.
        """
        seen = {i: (joint, positions[i]) for i, joint in self._joints.items() if i in positions}
        beyond = {i: joint.beyond(position) for i, (joint, position) in seen.items()}
        farthest = max(beyond, key=lambda i: beyond[i], default=None)
        if farthest is None:
            return None
        if beyond[farthest] > 0.0:
            return Lag(farthest, beyond[farthest] + seen[farthest][0].slack)
        earliest = {i: joint.earliest_s(position) for i, (joint, position) in seen.items()}
        latest = {i: joint.latest_s(position) for i, (joint, position) in seen.items()}
        ahead, behind = max(earliest, key=lambda i: earliest[i]), min(latest, key=lambda i: latest[i])
        if earliest[ahead] <= latest[behind]:
            return None
        joint, position = seen[behind]
        others, place = seen[ahead]
        due = joint.profile.travelled(others.profile.reached_s(others.travelled(place)))
        return Lag(behind, due - joint.travelled(position), ahead)


@dataclass(frozen=True, slots=True)
class _Joint:
    """One joint's part of a way, in ticks from its start towards its goal."""

    start: int
    sign: int
    profile: Trapezoid
    slack: float

    @classmethod
    def of(cls, spec: ServoSpec, start: int, goal: int, slack: float) -> _Joint:
        sign = 1 if goal >= start else -1
        return cls(start, sign, spec.profile_over(goal - start), max(slack, spec.tolerance) + _READING_TICKS)

    def travelled(self, position: int) -> int:
        return self.sign * (position - self.start)

    def beyond(self, position: int) -> float:
        """How much farther than its slack it is outside its own way."""
        travelled = self.travelled(position)
        return max(-travelled, travelled - self.profile.way) - self.slack

    def earliest_s(self, position: int) -> float:
        """When it may first be so far."""
        return self.profile.reached_s(self.travelled(position) - self.slack)

    def latest_s(self, position: int) -> float:
        """When it may last be no farther: for ever, near its goal."""
        most = self.travelled(position) + self.slack
        return math.inf if most >= self.profile.way else self.profile.reached_s(most)
