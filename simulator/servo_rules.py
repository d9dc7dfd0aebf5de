"""What a servo refuses to have written, and with which error.

Source: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0", Error; X series, the registers' own paragraphs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.control_table import Area, DriveMode, OperatingMode, Register, StatusError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rig.servo_models import ModelInfo
    from simulator.registers import Registers

WATCHDOG_TRIPPED = -1
POSITION_MODES = (
    OperatingMode.POSITION,
    OperatingMode.EXTENDED_POSITION,
    OperatingMode.CURRENT_BASED_POSITION,
)
GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")

_LIMITED_BY = {"goal_pwm": "pwm_limit", "goal_current": "current_limit", "goal_velocity": "velocity_limit"}
_FOLLOWER = 0x02
_NO_SECONDARY_ID = {0xFD, 0xFE}


class Rules:
    """The rules of one servo.

    Parameters
    ----------
    model : ModelInfo
        Decides modes and ranges.
    registers : Registers
        What the limits are now.
    """

    def __init__(self, model: ModelInfo, registers: Registers) -> None:
        self._model, self._registers = model, registers

    def refusal(self, values: Sequence[tuple[Register, int]], *, shut_down: bool) -> StatusError:
        """Why a write is refused as a whole: the first register's reason; NONE if it is accepted.

        Parameters
        ----------
        values : sequence of (Register, int)
            What is to be written, in order.
        shut_down : bool
            Whether a hardware error has cut the torque: it does not come back before a reboot.
        """
        refusals = (self._refusal(register, value, shut_down=shut_down) for register, value in values)
        return next((error for error in refusals if error), StatusError.NONE)

    def _refusal(self, register: Register, value: int, *, shut_down: bool) -> StatusError:
        name, get = register.name, self._registers.get
        if not register.writable or (register.area is Area.EEPROM and get("torque_enable")):
            return StatusError.ACCESS
        awaits_clearing = name in GOALS or (name == "bus_watchdog" and value != 0)
        if awaits_clearing and get("bus_watchdog") == WATCHDOG_TRIPPED:
            return StatusError.DATA_RANGE
        if not register.minimum <= value <= register.maximum or self._is_undefined(name, value):
            return StatusError.DATA_RANGE
        if self._exceeds_limit(name, value):
            return StatusError.DATA_LIMIT
        cannot = (name == "torque_enable" and value and shut_down) or (name == "protocol_type" and value != 2)
        return StatusError.RESULT_FAIL if cannot else StatusError.NONE

    def _is_undefined(self, name: str, value: int) -> bool:
        """Tell whether a value lies in the register's range but means nothing to this model."""
        match name:
            case "operating_mode":
                return value not in self._model.modes
            case "drive_mode":
                known = sum(DriveMode) | (_FOLLOWER if self._model.dual else 0)
                return bool(value & ~known)
            case "secondary_id":
                return value in _NO_SECONDARY_ID
            case "bus_watchdog":
                return value < 0
            case _:
                return False

    def _exceeds_limit(self, name: str, value: int) -> bool:
        """Tell whether a goal lies beyond the register that limits it."""
        get = self._registers.get
        if name == "goal_position" and get("operating_mode") == OperatingMode.POSITION:
            return not get("min_position_limit") <= value <= get("max_position_limit")
        return name in _LIMITED_BY and abs(value) > get(_LIMITED_BY[name])
