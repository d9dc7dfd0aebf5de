"""What a servo's motor costs it: current, heat, and the voltage that is left, by time alone.

The body is one lump that is warmed by the square of the motor's current and cools towards its rest: each
step is exact for a constant current, however long it is. The figures are of the usual size for small geared
servos; their maker publishes none. It warms and cools as many times faster than the clock as the shaft moves.
"""

from __future__ import annotations

import math

REST_DEG_C = 32.0
"""A powered servo that does nothing, a little warmer than the room."""
STALL_RISE_K = 110.0
"""How much warmer the full current would make it in the end: beyond any limit after some minutes."""
HEAT_S = 600.0
"""Time constant of warming and cooling."""
STALL_SAG = 0.05
"""Share of the supply that the cable takes at full current."""
FRICTION_A = 0.0215
"""Current of a light arm that turns."""


class Body:
    """Temperature and supply of one servo.

    Parameters
    ----------
    supply_v : float
        Voltage of the supply without load.
    stall_a : float
        Current when the shaft is held.
    now : float
        Time of power-up, seconds of the clock.
    speed : float
        How many times faster than the clock it warms and cools.
    """

    def __init__(self, supply_v: float, stall_a: float, *, now: float, speed: float) -> None:
        self.temperature_deg_c = REST_DEG_C
        self.friction = FRICTION_A / stall_a
        self._supply_v, self._speed, self.lived_until = supply_v, speed, now
        self._sag = (1.0, now)
        self._press = (0.0, now)

    def live(self, now: float, effort: float) -> None:
        """Let time pass at one effort, the share of the full current that flowed since the last call."""
        passed_s = max(now - self.lived_until, 0.0) * self._speed
        end = REST_DEG_C + STALL_RISE_K * effort * effort
        self.temperature_deg_c = end + (self.temperature_deg_c - end) * math.exp(-passed_s / HEAT_S)
        self.lived_until = max(self.lived_until, now)

    def voltage_v(self, now: float, effort: float) -> float:
        """Voltage at its terminals."""
        factor, until = self._sag
        return self._supply_v * (factor if now < until else 1.0) * (1.0 - STALL_SAG * effort)

    def pressed(self, now: float) -> float:
        """Share of the full current that something outside makes the motor hold against."""
        share, until = self._press
        return share if now < until else 0.0

    def weaken(self, factor: float, until: float) -> None:
        """Let the supply give only so much of its voltage until then."""
        self._sag = (factor, until)

    def press(self, share: float, until: float) -> None:
        """Let something lean on the shaft until then."""
        self._press = (share, until)
