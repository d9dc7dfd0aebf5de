"""What a servo's registers say about its next motion: units, limits, shape.

Source: ROBOTIS e-manual, XH430-W350, "What is the Profile".
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.control_table import DriveMode
from simulator.motion import Limits, ProfileKind

if TYPE_CHECKING:
    from rig.servo_models import ModelInfo
    from simulator.registers import Registers

_FASTEST_ACCELERATION = 32_767
"""Acceleration 0 means as fast as the motor can: taken for the largest that the register can ask for."""
_CRAWL = 1e-6
"""Ticks per second of a servo whose limits forbid it to turn: a profile that does not get anywhere."""


class Profile:
    """The profile registers of one servo.

    Parameters
    ----------
    model : ModelInfo
        Decides the units and the motor's own limit.
    registers : Registers
        Read whenever a motion begins.
    """

    def __init__(self, model: ModelInfo, registers: Registers) -> None:
        self._registers = registers
        self.velocity_unit = model.velocity_unit_rpm * model.ticks_per_turn / 60.0
        """Ticks per second of one count of a velocity."""
        self.acceleration_unit = model.acceleration_unit_rpm2 * model.ticks_per_turn / 3600.0
        """Ticks per second squared of one count of an acceleration."""
        self.motor = model.no_load_rpm * model.ticks_per_turn / 60.0
        """Ticks per second of the motor without load."""

    def acceleration(self) -> float:
        """Acceleration in ticks per second squared, as velocity-based profiles have it."""
        count = 0 if self._by_time() else self._registers.get("profile_acceleration")
        return (count or _FASTEST_ACCELERATION) * self.acceleration_unit

    def limits(self, distance: float) -> tuple[Limits, ProfileKind | None]:
        """Return what bounds a motion over a distance (ticks).

        Returns
        -------
        limits : Limits
        kind : ProfileKind or None
            Its shape, None where the distance decides it.
        """
        velocity = self._registers.get("profile_velocity")
        acceleration = self._registers.get("profile_acceleration")
        kind = None if acceleration else ProfileKind.RECTANGULAR
        if velocity == 0:
            return Limits(self._slowed(self.motor), self.acceleration()), ProfileKind.STEP
        if not self._by_time():
            return Limits(self._slowed(velocity * self.velocity_unit), self.acceleration()), kind
        total_s = velocity / 1000.0
        ramp_s = min(acceleration / 1000.0, total_s / 2.0)
        cruise = max(abs(distance) / (total_s - ramp_s), _CRAWL)
        return Limits(self._slowed(cruise), cruise / ramp_s if ramp_s else self.acceleration()), kind

    def _by_time(self) -> bool:
        return bool(self._registers.get("drive_mode") & DriveMode.TIME_BASED_PROFILE)

    def _slowed(self, velocity: float) -> float:
        """Keep a velocity within the velocity limit and what the motor can do."""
        limit = self._registers.get("velocity_limit") * self.velocity_unit
        return max(min(velocity, limit, self.motor), _CRAWL)
