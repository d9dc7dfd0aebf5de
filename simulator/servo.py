"""One Dynamixel X servo with its whole control table: what it remembers, refuses, does and reports.

Source: ROBOTIS e-manual, XH430-W350. Time comes in from outside (seconds of a monotonic clock); motion runs
`speed` times faster than that clock, the bus watchdog and the tick counter do not.

Three positions matter. The shaft's is physical, in ticks of the encoder, turns included, and nothing but
motion changes it. What the servo reports is the shaft's with direction, homing offset and the turns it has
counted since power-up. The goal is in the reported frame.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from rig.control_table import (
    ALERT_BIT,
    MOVING_IN_POSITION,
    MOVING_PROFILE_ONGOING,
    Area,
    DriveMode,
    HardwareError,
    OperatingMode,
    Register,
    StatusError,
)
from rig.servo_models import MODELS, control_table
from simulator.motion import Limits, Motion, move_to, turn_at
from simulator.profile import Profile
from simulator.registers import Registers

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

TICKS_PER_TURN = 4096
SUPPLY_DV, TEMPERATURE_DEG_C = 120, 32
"""What a healthy servo measures of itself: 12.0 V and a body a little warmer than the room."""
WATCHDOG_UNIT_S = 0.02
NEVER = 255
"""A secondary ID that answers to nobody."""
BUS_WATCHDOG_TRIPPED = -1

_POSITION_MODES = (
    OperatingMode.POSITION,
    OperatingMode.EXTENDED_POSITION,
    OperatingMode.CURRENT_BASED_POSITION,
)
_GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")
_LIMITED_BY = {"goal_pwm": "pwm_limit", "goal_current": "current_limit", "goal_velocity": "velocity_limit"}
_HOMING_LIMIT_IN_ONE_TURN = 1024
_MEASURED_FROM, _MEASURED_TO = 120, 147
_CLEAR_TURNS = b"\x01\x44\x58\x4c\x22"


def _nearest(ticks: float) -> int:
    return math.floor(ticks + 0.5)


class Servo:
    """One servo.

    Parameters
    ----------
    servo_id : int
        Its ID on the bus.
    model : str
        A model of `rig.servo_models.MODELS`.
    shaft_ticks : int
        Where the shaft stands at power-up.
    speed : float
        How many times faster than the clock the shaft moves.
    now : float
        Time of power-up, seconds.
    eeprom : mapping of str to int, optional
        EEPROM registers that differ from the factory's.
    """

    def __init__(
        self,
        servo_id: int,
        model: str = "XH430-W350",
        *,
        shaft_ticks: int = 2048,
        speed: float = 1.0,
        now: float = 0.0,
        eeprom: Mapping[str, int] | None = None,
    ) -> None:
        self.model = MODELS[model]
        self._registers = Registers(control_table(model))
        self._profile = Profile(self.model, self._registers)
        self._speed, self._power_up, self._heard = speed, now, now
        self._motion, self._motion_start = Motion(float(shaft_ticks)), now
        self._counted_turns = 0
        self._temperature_deg_c = TEMPERATURE_DEG_C
        self._hindrance = (1.0, now)
        self._shut_down = False
        self._registered: tuple[int, bytes] | None = None
        self._after: dict[str, Callable[[int, float], None]] = {
            "torque_enable": self._after_torque,
            "goal_position": self._after_goal_position,
            "goal_velocity": self._after_goal_velocity,
            "operating_mode": self._after_frame_change,
            "homing_offset": self._after_frame_change,
            "drive_mode": self._after_frame_change,
            "temperature_limit": self._after_limit,
            "max_voltage_limit": self._after_limit,
            "min_voltage_limit": self._after_limit,
        }
        self._registers.reset(Area.EEPROM)
        for name, value in {"id": servo_id, **(eeprom or {})}.items():
            self._registers.set(name, value)
        self.reboot(now)

    # -- what the line asks

    @property
    def servo_id(self) -> int:
        """The ID it answers to."""
        return self.value("id")

    @property
    def status_return_level(self) -> int:
        """What it answers: 0 only ping, 1 also reads, 2 everything."""
        return self.value("status_return_level")

    @property
    def alert(self) -> int:
        """The alert bit of its status packets: 0x80 while there is a hardware error, else 0."""
        return ALERT_BIT if self.value("hardware_error_status") else 0

    def listens_silently_to(self, servo_id: int) -> bool:
        """Tell whether an instruction for this ID is executed, unanswered, because it is the secondary ID."""
        return self.value("secondary_id") == servo_id != NEVER

    def hear(self, now: float) -> None:
        """Take note that an instruction came over the bus: the bus watchdog starts again."""
        self._check_watchdog(now)
        self._heard = now

    def value(self, name: str) -> int:
        """Value of a register as it was last written or measured."""
        return self._registers.get(name)

    def read(self, address: int, length: int, now: float) -> tuple[StatusError, bytes]:
        """Bytes of the control table; gaps between registers read 0.

        Returns
        -------
        error : StatusError
            ACCESS outside the table or where there is no register at all, DATA_LENGTH for nothing.
        data : bytes
            Empty with an error.
        """
        error, places = self._registers.places(address, length)
        if any(_MEASURED_FROM <= place <= _MEASURED_TO for place in places):
            self._measure(now)
        return error, self._registers.read(places)

    def write(self, address: int, data: bytes, now: float) -> StatusError:
        """Write registers; all of them or, with an error, none.

        Returns
        -------
        StatusError
            ACCESS (no such register, read only, or EEPROM under torque), DATA_LENGTH (part of a register),
            DATA_RANGE, DATA_LIMIT (beyond a limit register), RESULT_FAIL, or NONE.
        """
        self._check_watchdog(now)
        error, values = self._registers.split(address, data)
        if not error:
            error = next((e for e in (self._refusal(r, v) for r, v in values) if e), StatusError.NONE)
        if not error:
            for register, value in values:
                self._registers.set(register.name, value)
                if register.name in self._after:
                    self._after[register.name](value, now)
        return error

    def register_write(self, address: int, data: bytes) -> StatusError:
        """Keep a write for `act`, if it would be accepted now."""
        error, values = self._registers.split(address, data)
        error = error or next((e for e in (self._refusal(r, v) for r, v in values) if e), StatusError.NONE)
        if not error:
            self._registered = (address, data)
            self._registers.set("registered_instruction", 1)
        return error

    def act(self, now: float) -> StatusError:
        """Execute the registered write; INSTRUCTION if there is none."""
        if self._registered is None:
            return StatusError.INSTRUCTION
        address, data = self._registered
        self._registered = None
        self._registers.set("registered_instruction", 0)
        return self.write(address, data, now)

    def reboot(self, now: float) -> None:
        """Power-up: RAM at its defaults, torque off, hardware errors cleared, turns forgotten."""
        self._halt(now)
        self._registers.reset(Area.RAM)
        self._registered, self._shut_down = None, False
        self._temperature_deg_c = TEMPERATURE_DEG_C
        self._heard = now
        self._forget_turns(now)
        self._registers.set("goal_position", self.present_ticks(now))
        self._check_hardware(now)
        if self.value("startup_configuration") & 1 and not self._shut_down:
            self._registers.set("torque_enable", 1)

    def factory_reset(self, option: int, now: float) -> StatusError:
        """EEPROM at the factory's values: all (0xFF), all but the ID (1), all but ID and baud rate (2)."""
        kept = {0xFF: (), 0x01: ("id",), 0x02: ("id", "baud_rate")}.get(option)
        if kept is None:
            return StatusError.DATA_RANGE
        values = {name: self.value(name) for name in kept}
        self._registers.reset(Area.EEPROM)
        for name, value in values.items():
            self._registers.set(name, value)
        self.reboot(now)
        return StatusError.NONE

    def clear(self, parameters: bytes, now: float) -> StatusError:
        """Bring the reported position back into one turn; only while the shaft stands still."""
        if parameters != _CLEAR_TURNS:
            return StatusError.DATA_RANGE
        if self.moving(now):
            return StatusError.RESULT_FAIL
        self._forget_turns(now)
        self._registers.set("goal_position", self.present_ticks(now))
        return StatusError.NONE

    def fail(self, errors: HardwareError, now: float) -> None:
        """Let hardware errors happen; those in the shutdown mask cut the torque until a reboot."""
        self._registers.set("hardware_error_status", self.value("hardware_error_status") | errors)
        if errors & self.value("shutdown"):
            self._halt(now)
            self._registers.set("torque_enable", 0)
            self._shut_down = True

    def heat(self, temperature_deg_c: int, now: float) -> None:
        """Let it grow warm; beyond its limit that is a hardware error. It has cooled after a reboot."""
        self._temperature_deg_c = temperature_deg_c
        self._check_hardware(now)

    def hinder(self, factor: float, now: float, until: float) -> None:
        """Let something hold the shaft until then: it moves so many times as fast, or with 0 not at all."""
        if factor == 0.0:
            self._halt(now)
        self._hindrance = (factor, until)

    def lose_turn(self) -> None:
        """Let the count of turns be off by one; in position mode, of one turn, there is nothing to lose."""
        if self.value("operating_mode") != OperatingMode.POSITION:
            self._counted_turns += 1

    def trip_watchdog(self, now: float) -> None:
        """Let the bus watchdog trip: the shaft stops, and goals are refused until it is cleared."""
        self._halt(now)
        self._registers.set("bus_watchdog", BUS_WATCHDOG_TRIPPED)

    # -- where it is

    def shaft_ticks(self, now: float) -> int:
        """Tick of the encoder that the shaft stands at, turns included, whatever the offsets say."""
        self._check_watchdog(now)
        return _nearest(self._shaft(now)[0])

    def moving(self, now: float) -> bool:
        """Tell whether a profile is running or the shaft turns faster than the moving threshold."""
        self._check_watchdog(now)
        speed = abs(self._shaft(now)[1]) / self._profile.velocity_unit
        return self._running(now) or speed > self.value("moving_threshold")

    def present_ticks(self, now: float) -> int:
        """Position as the servo reports it."""
        return _nearest(self._reported(self._shaft(now)[0]))

    # -- frames

    @property
    def _direction(self) -> int:
        return -1 if self.value("drive_mode") & DriveMode.REVERSE else 1

    @property
    def _offset_ticks(self) -> int:
        offset = self.value("homing_offset")
        one_turn = self.value("operating_mode") == OperatingMode.POSITION
        ignored = one_turn and abs(offset) > _HOMING_LIMIT_IN_ONE_TURN
        return (0 if ignored else offset) + self._counted_turns * TICKS_PER_TURN

    def _reported(self, shaft: float) -> float:
        return self._direction * shaft + self._offset_ticks

    def _to_shaft(self, reported: float) -> float:
        return self._direction * (reported - self._offset_ticks)

    def _forget_turns(self, now: float) -> None:
        self._counted_turns = 0
        self._counted_turns = -(self.present_ticks(now) // TICKS_PER_TURN)

    # -- motion

    def _motion_time(self, now: float) -> float:
        return (now - self._motion_start) * self._speed

    def _shaft(self, now: float) -> tuple[float, float]:
        return self._motion.at(self._motion_time(now))

    def _running(self, now: float) -> bool:
        return self._motion_time(now) < self._motion.duration_s

    def _start(self, motion: Motion, now: float) -> None:
        self._motion, self._motion_start = motion, now

    def _halt(self, now: float) -> None:
        """Stand still at once, on a whole tick: what is reported is where the shaft is."""
        self._start(Motion(float(_nearest(self._shaft(now)[0]))), now)

    # -- what follows a write

    def _after_torque(self, value: int, now: float) -> None:
        self._halt(now)
        if value and self.value("operating_mode") == OperatingMode.POSITION:
            self._forget_turns(now)
        # The goal follows the shaft: switching the torque on never makes an arm jump.
        self._registers.set("goal_position", self.present_ticks(now))
        self._registers.set("goal_velocity", 0)

    def _after_goal_position(self, value: int, now: float) -> None:
        if not self.value("torque_enable"):
            if not self.value("drive_mode") & DriveMode.TORQUE_ON_BY_GOAL or self._shut_down:
                return
            self._registers.set("torque_enable", 1)
        if self.value("operating_mode") not in _POSITION_MODES:
            return
        position, velocity = self._shaft(now)
        target = self._to_shaft(value)
        limits, kind = self._profile.limits(target - position)
        factor, until = self._hindrance
        if now < until:
            if factor == 0.0:
                return
            limits = Limits(limits.velocity * factor, limits.acceleration * factor)
        motion = move_to(target, position, velocity, limits)
        self._start(motion if kind is None else replace(motion, kind=kind), now)

    def _after_goal_velocity(self, value: int, now: float) -> None:
        if self.value("operating_mode") == OperatingMode.VELOCITY and self.value("torque_enable"):
            goal = self._direction * value * self._profile.velocity_unit
            self._start(turn_at(goal, *self._shaft(now), self._profile.acceleration()), now)

    def _after_frame_change(self, _value: int, now: float) -> None:
        if self.value("operating_mode") == OperatingMode.POSITION:
            self._forget_turns(now)
        self._registers.set("goal_position", self.present_ticks(now))

    def _after_limit(self, _value: int, now: float) -> None:
        self._check_hardware(now)

    # -- supervision

    def _check_watchdog(self, now: float) -> None:
        """Stop where the shaft was when the bus had been silent for too long."""
        limit = self.value("bus_watchdog")
        expiry = self._heard + limit * WATCHDOG_UNIT_S
        if limit > 0 and self.value("torque_enable") and now > expiry:
            self._halt(expiry)
            self._registers.set("bus_watchdog", BUS_WATCHDOG_TRIPPED)

    def _check_hardware(self, now: float) -> None:
        errors = HardwareError(0)
        if not self.value("min_voltage_limit") <= SUPPLY_DV <= self.value("max_voltage_limit"):
            errors |= HardwareError.INPUT_VOLTAGE
        if self.value("temperature_limit") < self._temperature_deg_c:
            errors |= HardwareError.OVERHEATING
        if errors:
            self.fail(errors, now)

    # -- what it refuses

    def _refusal(self, register: Register, value: int) -> StatusError:
        """Why a register does not take a value; NONE if it does."""
        name = register.name
        if not register.writable or (register.area is Area.EEPROM and self.value("torque_enable")):
            return StatusError.ACCESS
        if name in _GOALS and self.value("bus_watchdog") == BUS_WATCHDOG_TRIPPED:
            return StatusError.DATA_RANGE
        if not register.minimum <= value <= register.maximum or self._is_undefined(name, value):
            return StatusError.DATA_RANGE
        if self._exceeds_limit(name, value):
            return StatusError.DATA_LIMIT
        if (name == "torque_enable" and value and self._shut_down) or (
            name == "protocol_type" and value != 2
        ):
            return StatusError.RESULT_FAIL
        return StatusError.NONE

    def _is_undefined(self, name: str, value: int) -> bool:
        """Tell whether a value lies in the register's range but means nothing."""
        match name:
            case "operating_mode":
                return value not in set(OperatingMode)
            case "drive_mode":
                return bool(value & 0x02)
            case "secondary_id":
                return value in {0xFD, 0xFE}
            case "bus_watchdog":
                return value < 0
            case _:
                return False

    def _exceeds_limit(self, name: str, value: int) -> bool:
        """Tell whether a goal lies beyond the register that limits it."""
        if name == "goal_position" and self.value("operating_mode") == OperatingMode.POSITION:
            return not self.value("min_position_limit") <= value <= self.value("max_position_limit")
        return name in _LIMITED_BY and abs(value) > self.value(_LIMITED_BY[name])

    # -- measurement

    def _measure(self, now: float) -> None:
        """Bring the registers that the servo measures up to date."""
        self._check_watchdog(now)
        shaft, shaft_velocity = self._shaft(now)
        velocity = _nearest(self._direction * shaft_velocity / self._profile.velocity_unit)
        position, running = _nearest(self._reported(shaft)), self._running(now)
        status = int(self._motion.kind) | (MOVING_PROFILE_ONGOING if running else 0)
        if self.value("operating_mode") in _POSITION_MODES and position == self.value("goal_position"):
            status |= 0 if running else MOVING_IN_POSITION
        # A light arm on a strong motor: friction while it turns, nothing while it stands.
        effort = 8 * (velocity > 0) - 8 * (velocity < 0)
        for name, value in (
            ("realtime_tick", int((now - self._power_up) * 1000.0) % 32_768),
            ("moving", int(running or abs(velocity) > self.value("moving_threshold"))),
            ("moving_status", status),
            ("present_pwm", effort),
            ("present_current", effort),
            ("present_velocity", velocity),
            ("present_position", position),
            ("velocity_trajectory", velocity),
            ("position_trajectory", position),
            ("present_input_voltage", SUPPLY_DV),
            ("present_temperature", self._temperature_deg_c),
            ("backup_ready", 0),
        ):
            self._registers.set(name, value)
