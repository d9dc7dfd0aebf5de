"""A servo's shaft: where it is at any time, what holds it up, and how loosely the arm hangs on it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from simulator.motion import Limits, Motion, ProfileKind, move_to


@dataclass(frozen=True, slots=True)
class Flaws:
    """How far a servo is from its ideal.

    Attributes
    ----------
    backlash_ticks : float
        Play between shaft and arm: the arm stays behind by half of it, on the side that it came from, and the
        encoder does not see it.
    steady_error_ticks : float
        How far from its goal friction leaves the shaft at the factory's proportional gain; the encoder sees
        it, a higher gain makes it smaller and an integral gain removes it.
    """

    backlash_ticks: float = 0.0
    steady_error_ticks: float = 0.0


def nearest(ticks: float) -> int:
    """Whole tick nearest to a place."""
    return math.floor(ticks + 0.5)


class Shaft:
    """One shaft.

    Parameters
    ----------
    ticks : float
        Where it stands, turns included.
    speed : float
        How many times faster than the clock it moves.
    now : float
        Seconds of the clock.
    """

    def __init__(self, ticks: float, *, speed: float, now: float) -> None:
        self._speed = speed
        self._motion, self._begin = Motion(ticks), now
        self._hindrance = (1.0, now)
        self._came_from = 0.0

    @property
    def kind(self) -> ProfileKind:
        """Shape of the last profile."""
        return self._motion.kind

    @property
    def end(self) -> float:
        """When the motion ends, or ended; infinite for one that does not."""
        return self._begin + self._motion.duration_s / self._speed

    def at(self, now: float) -> tuple[float, float]:
        """Position in ticks, and velocity in ticks per second of a servo that is not hurried."""
        return self._motion.at((now - self._begin) * self._speed)

    def running(self, now: float) -> bool:
        """Tell whether a profile is under way."""
        return (now - self._begin) * self._speed < self._motion.duration_s

    def behind_ticks(self, backlash_ticks: float) -> float:
        """How far the arm hangs from where the shaft is; 0 before the first motion."""
        return 0.5 * backlash_ticks * self._came_from

    def halt(self, now: float) -> None:
        """Stand still at once, on a whole tick: what is reported is where the shaft is."""
        self._motion, self._begin = Motion(float(nearest(self.at(now)[0]))), now

    def start(self, motion: Motion, now: float) -> None:
        """Begin a motion."""
        ahead = motion.target if motion.target is not None else motion.at(1.0)[0]
        if ahead != motion.position:
            self._came_from = math.copysign(1.0, motion.position - ahead)
        self._motion, self._begin = motion, now

    def go(self, target: float, limits: Limits, kind: ProfileKind | None, now: float) -> None:
        """Set out for a place, as fast as limits and hindrance allow; nowhere while it is held."""
        factor = self.freedom(now)
        if factor == 0.0:
            return
        position, velocity = self.at(now)
        slowed = Limits(limits.velocity * factor, limits.acceleration * factor)
        motion = move_to(target, position, velocity, slowed)
        self.start(motion if kind is None else replace(motion, kind=kind), now)

    def hinder(self, factor: float, now: float, until: float) -> None:
        """Let something hold it until then: it moves so many times as fast, or with 0 not at all."""
        if factor == 0.0:
            self.halt(now)
        self._hindrance = (factor, until)

    def freedom(self, now: float) -> float:
        """How many times as fast as it should it moves."""
        factor, until = self._hindrance
        return factor if now < until else 1.0

    def released(self, now: float) -> float | None:
        """When what held it let go, once; None if nothing did, or still does."""
        factor, until = self._hindrance
        if factor != 0.0 or now < until:
            return None
        self._hindrance = (1.0, until)
        return until
