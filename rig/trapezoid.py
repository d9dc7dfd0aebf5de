"""One axis on its way: speeding up, cruising, braking, or without the cruise where the way is short."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """A way from standing to standing, in any unit of length.

    Attributes
    ----------
    way : float
        Its length, 0 or more.
    speed : float
        Highest speed, per second; above 0.
    acceleration : float
        Of speeding up and of braking, per second squared; above 0.
    """

    way: float
    speed: float
    acceleration: float

    @property
    def duration_s(self) -> float:
        """Time that it takes."""
        if self.way == 0.0:
            return 0.0
        return self.way / self._peak + self._peak / self.acceleration

    @property
    def _peak(self) -> float:
        return min(self.speed, math.sqrt(self.way * self.acceleration))

    def travelled(self, time_s: float) -> float:
        """How far it has come at a time; nowhere before the start, and all the way after the end."""
        left_s = self.duration_s - time_s
        if time_s <= 0.0 or left_s <= 0.0:
            return 0.0 if time_s <= 0.0 else self.way
        ramp_s = self._peak / self.acceleration
        if time_s < ramp_s:
            return self.acceleration * time_s**2 / 2.0
        if left_s < ramp_s:
            return self.way - self.acceleration * left_s**2 / 2.0
        return self._peak * (time_s - ramp_s / 2.0)

    def reached_s(self, distance: float) -> float:
        """When it has come so far; `travelled` the other way round.

        Parameters
        ----------
        distance : float
            Less than 0 counts as 0, more than the way as the way.
        """
        done = min(max(distance, 0.0), self.way)
        if self.way == 0.0 or done == 0.0:
            return 0.0
        ramp = self._peak**2 / (2.0 * self.acceleration)
        if done < ramp:
            return math.sqrt(2.0 * done / self.acceleration)
        if self.way - done < ramp:
            return self.duration_s - math.sqrt(2.0 * (self.way - done) / self.acceleration)
        return done / self._peak + self._peak / (2.0 * self.acceleration)
