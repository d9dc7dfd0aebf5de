"""What a servo says of itself: the registers that it measures, in their own units."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.control_table import MOVING_IN_POSITION, MOVING_PROFILE_ONGOING
from simulator.servo_rules import POSITION_MODES
from simulator.shaft import nearest

if TYPE_CHECKING:
    from rig.servo_models import ModelInfo
    from simulator.motion import ProfileKind
    from simulator.profile import Profile
    from simulator.registers import Registers

_FULL_PWM, _FULL_LOAD = 885, 1000
_TICK_COUNTER = 32_768


class Report:
    """Writes what is measured into the registers of one servo.

    Parameters
    ----------
    model : ModelInfo
        Decides units.
    registers : Registers
    profile : Profile
    """

    def __init__(self, model: ModelInfo, registers: Registers, profile: Profile) -> None:
        self._model, self._registers, self._profile = model, registers, profile

    def motion(self, *, position: int, velocity: float, running: bool, kind: ProfileKind) -> None:
        """Write where it is, how fast it turns (ticks/s), and what its profile does."""
        get = self._registers.get
        counts = nearest(velocity / self._profile.velocity_unit)
        status = int(kind) | (MOVING_PROFILE_ONGOING if running else 0)
        arrived = position == get("goal_position") and get("operating_mode") in POSITION_MODES
        status |= MOVING_IN_POSITION if arrived and not running else 0
        self._write(
            moving=int(running or abs(counts) > get("moving_threshold")),
            moving_status=status,
            present_velocity=counts,
            present_position=position,
            velocity_trajectory=counts,
            position_trajectory=position,
        )

    def body(self, *, effort: float, volts: float, temperature_deg_c: float, uptime_s: float) -> None:
        """Write what it costs: signed share of full effort, volts, degrees, seconds since power-up."""
        unit_ma = self._model.current_unit_ma
        full = _FULL_LOAD if unit_ma is None else 1000.0 * self._model.stall_a / unit_ma
        turning = self._registers.get("present_velocity") * self._profile.velocity_unit / self._profile.motor
        self._write(
            realtime_tick=int(uptime_s * 1000.0) % _TICK_COUNTER,
            present_current=nearest(effort * full),
            present_pwm=nearest(_FULL_PWM * max(min(turning + effort, 1.0), -1.0)),
            present_input_voltage=nearest(10.0 * volts),
            present_temperature=int(temperature_deg_c),
        )

    def _write(self, **values: int) -> None:
        for name, value in values.items():
            self._registers.set(name, value)
