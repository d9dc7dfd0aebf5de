"""One Dynamixel X servo with its whole control table: what it remembers, does, reports and forgets.

Source: ROBOTIS e-manual, X series. Time comes in from outside (seconds of a monotonic clock); motion and heat
run `speed` times faster than that clock, the bus watchdog, the overload timer and the tick counter do not.

Three positions matter. The shaft's is physical, in ticks of the encoder, turns included, and nothing but
motion changes it. What the servo reports is the shaft's with direction, homing offset and the turns it has
counted since power-up. The goal is in the reported frame.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rig.control_table import ALERT_BIT, Area, DriveMode, HardwareError, OperatingMode, StatusError
from rig.servo_models import MODELS, control_table
from simulator.motion import turn_at
from simulator.profile import Profile
from simulator.registers import Registers
from simulator.servo_body import Body
from simulator.servo_report import Report
from simulator.servo_rules import GOALS, POSITION_MODES, WATCHDOG_TRIPPED, Rules
from simulator.shaft import Flaws, Shaft, nearest

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

TICKS_PER_TURN = 4096
WATCHDOG_UNIT_S = 0.02
NEVER = 255
"""A secondary ID that answers to nobody."""
OVERLOAD_S = 3.0
"""Full effort for so long is an overload."""

_HOMING_LIMIT_IN_ONE_TURN = 1024
_MEASURED_FROM, _MEASURED_TO = 120, 147
_CLEAR_TURNS = b"\x01\x44\x58\x4c\x22"
_GAINS = (
    "velocity_i_gain", "velocity_p_gain", "position_d_gain", "position_i_gain", "position_p_gain",
    "feedforward_1st_gain", "feedforward_2nd_gain",
)  # fmt: skip
_PROFILE = ("profile_velocity", "profile_acceleration")
_GAIN_UNIT = 128.0
_FULL_PWM = 885.0


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
    flaws : Flaws, optional
        Backlash and steady-state error; none by default.
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
        flaws: Flaws | None = None,
    ) -> None:
        self.model = MODELS[model]
        self._registers = Registers(control_table(model))
        self._rules = Rules(self.model, self._registers)
        self._profile = Profile(self.model, self._registers)
        self._shaft = Shaft(float(shaft_ticks), speed=speed, now=now)
        self._body = Body(self.model.supply_v, self.model.stall_a, now=now, speed=speed)
        self._flaws = flaws or Flaws()
        self._power_up = self._heard = now
        self._counted_turns = 0
        self._saturated_since: float | None = None
        self._shut_down = False
        self._registered: tuple[int, bytes] | None = None
        self._after: dict[str, Callable[[int, float], None]] = {
            "torque_enable": self._after_torque,
            "goal_position": self._after_goal_position,
            "goal_velocity": self._after_goal_velocity,
            "goal_pwm": self._after_goal_pwm,
            "goal_current": self._after_goal_current,
            "operating_mode": self._after_mode,
            "homing_offset": self._after_frame_change,
            "drive_mode": self._after_frame_change,
        }
        self._registers.reset(Area.EEPROM)
        for name, value in {"id": servo_id, **(eeprom or {})}.items():
            self._registers.set(name, value)
        self._report = Report(self.model, self._registers, self._profile)
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
        self._advance(now)
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
        self._advance(now)
        error, values = self._registers.split(address, data)
        error = error or self._rules.refusal(values, shut_down=self._shut_down)
        if not error:
            for register, value in values:
                self._registers.set(register.name, value)
                if register.name in self._after:
                    self._after[register.name](value, now)
            self._check_hardware(now)
        return error

    def register_write(self, address: int, data: bytes) -> StatusError:
        """Keep a write for `act`, if it would be accepted now."""
        error, values = self._registers.split(address, data)
        error = error or self._rules.refusal(values, shut_down=self._shut_down)
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
        """Power-up: RAM at its defaults, torque off, errors cleared, turns forgotten; heat stays."""
        self._live(now)
        self._shaft.halt(now)
        self._registers.reset(Area.RAM)
        self._registered, self._shut_down, self._saturated_since = None, False, None
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
            self._live(now)
            self._shaft.halt(now)
            self._registers.set("torque_enable", 0)
            self._shut_down = True

    # -- what befalls it

    def heat(self, temperature_deg_c: float, now: float) -> None:
        """Let it be warm; beyond its limit that is a hardware error. It cools by and by."""
        self._advance(now)
        self._body.temperature_deg_c = temperature_deg_c
        self._check_hardware(now)

    def hinder(self, factor: float, now: float, until: float) -> None:
        """Let something hold the shaft until then: it moves so many times as fast, or with 0 not at all."""
        self._advance(now)
        self._shaft.hinder(factor, now, until)

    def press(self, share: float, now: float, until: float) -> None:
        """Let something lean on the shaft until then: holding against it takes this share of full effort."""
        self._advance(now)
        self._body.press(share, until)

    def weaken_supply(self, factor: float, now: float, until: float) -> None:
        """Let the supply give only so much of its voltage until then."""
        self._advance(now)
        self._body.weaken(factor, until)
        self._check_hardware(now)

    def lose_turn(self) -> None:
        """Let the count of turns be off by one; in position mode, of one turn, there is nothing to lose."""
        if self.value("operating_mode") != OperatingMode.POSITION:
            self._counted_turns += 1

    def trip_watchdog(self, now: float) -> None:
        """Let the bus watchdog trip: the shaft stops, and goals are refused until it is cleared.

        In extended mode with a homing offset the motor runs away instead (DynamixelSDK issue 584).
        """
        self._live(now)
        self._shaft.halt(now)
        self._registers.set("bus_watchdog", WATCHDOG_TRIPPED)
        for name in _PROFILE:
            self._registers.set(name, 0)
        if self.value("operating_mode") == OperatingMode.EXTENDED_POSITION and self.value("homing_offset"):
            self._turn(self._profile.motor, now)

    # -- where it is

    def shaft_ticks(self, now: float) -> int:
        """Tick of the encoder that the shaft stands at, turns included, whatever the offsets say."""
        self._advance(now)
        return nearest(self._shaft.at(now)[0])

    def behind_ticks(self) -> float:
        """How far the arm hangs from where the encoder sees the shaft."""
        return self._shaft.behind_ticks(self._flaws.backlash_ticks)

    def moving(self, now: float) -> bool:
        """Tell whether a profile is running or the shaft turns faster than the moving threshold."""
        self._advance(now)
        speed = abs(self._shaft.at(now)[1]) / self._profile.velocity_unit
        return self._shaft.running(now) or speed > self.value("moving_threshold")

    def present_ticks(self, now: float) -> int:
        """Position as the servo reports it."""
        return nearest(self._reported(self._shaft.at(now)[0]))

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

    # -- what follows a write

    def _after_torque(self, value: int, now: float) -> None:
        self._shaft.halt(now)
        if value and self.value("operating_mode") == OperatingMode.POSITION:
            self._forget_turns(now)
        # The goal follows the shaft: switching the torque on never makes an arm jump.
        self._registers.set("goal_position", self.present_ticks(now))
        self._registers.set("goal_velocity", 0)
        if self.value("operating_mode") == OperatingMode.PWM:
            self._registers.set("goal_pwm", 0)
        if self.value("operating_mode") == OperatingMode.CURRENT:
            self._registers.set("goal_current", 0)

    def _after_goal_position(self, _value: int, now: float) -> None:
        if not self.value("torque_enable"):
            if not self.value("drive_mode") & DriveMode.TORQUE_ON_BY_GOAL or self._shut_down:
                return
            self._registers.set("torque_enable", 1)
        self._set_out(now)

    def _set_out(self, now: float) -> None:
        """Make for the goal, as far as friction lets it come."""
        if self.value("operating_mode") not in POSITION_MODES or not self.value("torque_enable"):
            return
        position = self._shaft.at(now)[0]
        way = self._to_shaft(self.value("goal_position")) - position
        way -= math.copysign(min(self._steady_error_ticks(), abs(way)), way)
        limits, kind = self._profile.limits(way)
        self._shaft.go(position + way, limits, kind, now)

    def _steady_error_ticks(self) -> float:
        if not self._flaws.steady_error_ticks or self.value("position_i_gain"):
            return 0.0
        usual = self._registers.default("position_p_gain")
        return self._flaws.steady_error_ticks * usual / max(self.value("position_p_gain"), 1)

    def _after_goal_velocity(self, value: int, now: float) -> None:
        if self.value("operating_mode") == OperatingMode.VELOCITY:
            self._turn(value * self._profile.velocity_unit, now)

    def _after_goal_pwm(self, value: int, now: float) -> None:
        if self.value("operating_mode") == OperatingMode.PWM:
            self._turn(self._profile.motor * value / _FULL_PWM, now)

    def _after_goal_current(self, value: int, now: float) -> None:
        """Turn at full speed at any current above friction: a light arm has nothing to push against."""
        if self.value("operating_mode") == OperatingMode.CURRENT:
            unit_a = (self.model.current_unit_ma or 0.0) / 1000.0
            turns = abs(value) * unit_a / self.model.stall_a > self._body.friction
            self._turn(math.copysign(self._profile.motor, value) if turns else 0.0, now)

    def _turn(self, velocity: float, now: float) -> None:
        if self.value("torque_enable"):
            goal = self._direction * velocity * self._shaft.freedom(now)
            self._shaft.start(turn_at(goal, *self._shaft.at(now), self._profile.acceleration()), now)

    def _after_mode(self, _value: int, now: float) -> None:
        """Switching the mode forgets turns, gains, profile and what limits the output."""
        self._forget_turns(now)
        for name in (*_GAINS, *_PROFILE):
            self._registers.set(name, self._registers.default(name))
        for goal in set(GOALS) & self._registers.names - {"goal_position"}:
            self._registers.set(goal, self._registers.default(goal))
        self._registers.set("goal_position", self.present_ticks(now))

    def _after_frame_change(self, _value: int, now: float) -> None:
        if self.value("operating_mode") == OperatingMode.POSITION:
            self._forget_turns(now)
        self._registers.set("goal_position", self.present_ticks(now))

    # -- time

    def _advance(self, now: float) -> None:
        """Let happen what happens by itself until now."""
        self._check_watchdog(now)
        released = self._shaft.released(now)
        if released is not None and not self._shaft.running(now):
            self._live(released)
            self._set_out(released)
        self._live(now)
        self._check_hardware(now)

    def _live(self, now: float) -> None:
        """Grow warm or cool: until the motion's end as it moves, and from there as it holds."""
        for end in (min(now, self._shaft.end), now):
            if end > self._body.lived_until:
                self._body.live(end, abs(self._effort(self._body.lived_until)))

    def _effort(self, now: float) -> float:
        """Share of the full effort, -1 to 1, positive where it pushes towards larger shaft ticks."""
        if not self.value("torque_enable"):
            return 0.0
        pressed = self._body.pressed(now)
        if self._shaft.running(now):
            return math.copysign(min(self._body.friction + pressed, 1.0), self._shaft.at(now)[1])
        error = 0.0
        if self.value("operating_mode") in POSITION_MODES:
            error = self._to_shaft(self.value("goal_position")) - self._shaft.at(now)[0]
        output = error * self.value("position_p_gain") / _GAIN_UNIT / _FULL_PWM
        return max(min(output + math.copysign(pressed, output), 1.0), -1.0)

    def _check_watchdog(self, now: float) -> None:
        """Stop where the shaft was when the bus had been silent for too long."""
        limit = self.value("bus_watchdog")
        expiry = self._heard + limit * WATCHDOG_UNIT_S
        if limit > 0 and self.value("torque_enable") and now > expiry:
            self.trip_watchdog(expiry)

    def _check_hardware(self, now: float) -> None:
        errors, effort = HardwareError(0), abs(self._effort(now))
        voltage_dv = nearest(10.0 * self._body.voltage_v(now, effort))
        if not self.value("min_voltage_limit") <= voltage_dv <= self.value("max_voltage_limit"):
            errors |= HardwareError.INPUT_VOLTAGE
        if self.value("temperature_limit") < int(self._body.temperature_deg_c):
            errors |= HardwareError.OVERHEATING
        if effort < 1.0:
            self._saturated_since = None
        elif self._saturated_since is None:
            self._saturated_since = now
        elif now - self._saturated_since >= OVERLOAD_S:
            errors |= HardwareError.OVERLOAD
        if errors & ~self.value("hardware_error_status"):
            self.fail(errors, now)

    def _measure(self, now: float) -> None:
        """Bring the registers that the servo measures up to date."""
        self._advance(now)
        shaft, velocity = self._shaft.at(now)
        effort = self._effort(now)
        self._report.motion(
            position=nearest(self._reported(shaft)),
            velocity=self._direction * velocity,
            running=self._shaft.running(now),
            kind=self._shaft.kind,
        )
        self._report.body(
            effort=self._direction * effort,
            volts=self._body.voltage_v(now, abs(effort)),
            temperature_deg_c=self._body.temperature_deg_c,
            uptime_s=now - self._power_up,
        )
