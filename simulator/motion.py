"""How a servo's shaft moves: piecewise constant acceleration, known in closed form at every time.

Nothing is stepped: position and velocity at a time are computed from the segments, so that a twin that was
not asked for a while, or runs a hundred times faster than the clock, is still exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum


class ProfileKind(IntEnum):
    """Bits 4 and 5 of `moving_status`: the shape of the running profile."""

    STEP = 0x00
    RECTANGULAR = 0x10
    TRIANGULAR = 0x20
    TRAPEZOIDAL = 0x30


@dataclass(frozen=True, slots=True)
class Limits:
    """What bounds one motion, in ticks per second and ticks per second squared."""

    velocity: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Motion:
    """A motion that starts at time 0 and, after its last segment, stands still.

    Parameters
    ----------
    position, velocity : float
        Where it starts, in ticks, and how fast, in ticks per second.
    segments : tuple of (duration_s, acceleration)
        Constant accelerations in ticks per second squared, one after the other.
    target : float or None
        Where it ends, exactly; None where it ends wherever the segments lead.
    kind : ProfileKind
        Its shape, for `moving_status`.
    """

    position: float
    velocity: float = 0.0
    segments: tuple[tuple[float, float], ...] = ()
    target: float | None = None
    kind: ProfileKind = ProfileKind.STEP

    @property
    def duration_s(self) -> float:
        """Time until it stands still; infinite for a motion at constant velocity."""
        return math.fsum(duration for duration, _ in self.segments)

    def at(self, time_s: float) -> tuple[float, float]:
        """Position (ticks) and velocity (ticks/s) at a time; before the start, those of the start."""
        position, velocity, left = self.position, self.velocity, max(time_s, 0.0)
        for duration, acceleration in self.segments:
            step = min(left, duration)
            position += (velocity + acceleration * step / 2.0) * step
            velocity += acceleration * step
            left -= step
            if left <= 0.0 and step < duration:
                return position, velocity
        if self.segments and self.target is not None:
            return self.target, 0.0
        return position, velocity


def move_to(target: float, position: float, velocity: float, limits: Limits) -> Motion:
    """Fastest motion to a target within the limits, from any position and velocity.

    Accelerate, cruise, brake; where the start is faster than allowed it first slows down, and where it cannot
    stop in time, or goes the wrong way, it overshoots, turns and comes back (Kroeger, "On-Line Trajectory
    Generation in Robotic Systems", 2010, type I with zero target velocity).

    Parameters
    ----------
    target, position : float
        Ticks.
    velocity : float
        Ticks per second at the start.
    limits : Limits
        Both positive.
    """
    a = limits.acceleration
    distance = target - position
    if distance == 0.0 and velocity == 0.0:
        return Motion(position)
    # Braking at once would end at `stop`: what lies beyond it decides the direction.
    stop = velocity * abs(velocity) / (2.0 * a)
    direction = math.copysign(1.0, distance - stop) if distance != stop else math.copysign(1.0, velocity)
    d, v0 = direction * distance, direction * velocity
    if v0 > limits.velocity:
        peak, first = limits.velocity, -a
    else:
        peak, first = min(limits.velocity, math.sqrt(max(a * d + v0 * v0 / 2.0, 0.0))), a
    ramp = (peak - v0) / first
    ramp_distance = (peak * peak - v0 * v0) / (2.0 * first)
    cruise_distance = d - ramp_distance - peak * peak / (2.0 * a)
    cruises = peak == limits.velocity  # else only rounding is left between the two ramps
    cruise = max(cruise_distance, 0.0) / peak if cruises else 0.0
    kind = ProfileKind.TRAPEZOIDAL if cruises else ProfileKind.TRIANGULAR
    return Motion(
        position,
        velocity,
        ((max(ramp, 0.0), direction * first), (cruise, 0.0), (peak / a, -direction * a)),
        target,
        kind,
    )


def turn_at(goal_velocity: float, position: float, velocity: float, acceleration: float) -> Motion:
    """Motion that reaches a velocity (ticks/s) at a constant acceleration and keeps it."""
    change = goal_velocity - velocity
    ramp = (abs(change) / acceleration, math.copysign(acceleration, change))
    segments = (ramp,) if goal_velocity == 0.0 else (ramp, (math.inf, 0.0))
    return Motion(position, velocity, segments, None, ProfileKind.TRAPEZOIDAL)
