"""One Dynamixel X servo with its whole control table: what it remembers, does, reports and forgets.

Source: ROBOTIS e-manual, X series. Time comes in from outside (seconds of a monotonic clock); motion and heat
run `speed` times faster than that clock, the bus watchdog, the overload timer and the tick counter do not.

Three positions matter. The shaft's is physical, in ticks of the encoder, turns included, and nothing but
motion changes it. What the servo reports is the shaft's with direction, homing offset and the turns it has
counted since power-up. The goal is in the reported frame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.control_table import ALERT_BIT, Area, DriveMode, HardwareError, StatusError
from rig.servo_models import MODELS, control_table
from simulator.backup import Backup
from simulator.drive import Drive
from simulator.registers import Registers
from simulator.servo_report import Report
from simulator.servo_rules import WATCHDOG_TRIPPED, Rules
from simulator.shaft import Flaws, nearest

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

WATCHDOG_UNIT_S = 0.02
NEVER = 255
"""A secondary ID that answers to nobody."""
OVERLOAD_S = 3.0
"""Full effort for so long is an overload."""

_MEASURED_FROM, _MEASURED_TO = 120, 147
_CLEAR_TURNS = b"\x01\x44\x58\x4c\x22"


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
        self._backup = Backup(self._registers)
        self._rules = Rules(self.model, self._registers)
        self._drive = Drive(
            self.model,
            self._registers,
            flaws or Flaws(),
            shaft_ticks=float(shaft_ticks),
            speed=speed,
            now=now,
        )
        self._power_up = self._heard = now
        self._shut_down = False
        self._registered: tuple[int, bytes] | None = None
        drive = self._drive
        self._after: dict[str, Callable[[int, float], None]] = {
            "torque_enable": drive.after_torque,
            "goal_position": self._after_goal_position,
            "goal_velocity": drive.after_goal_velocity,
            "goal_pwm": drive.after_goal_pwm,
            "goal_current": drive.after_goal_current,
            "operating_mode": drive.after_mode,
            "homing_offset": drive.after_frame_change,
            "drive_mode": drive.after_frame_change,
        }
        self._registers.reset(Area.EEPROM)
        for name, value in {"id": servo_id, **(eeprom or {})}.items():
            self._registers.set(name, value)
        self._report = Report(self.model, self._registers, drive.profile)
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
        self._drive.halt(now)
        self._registers.reset(Area.RAM)
        self._backup.power_up()
        self._registered, self._shut_down = None, False
        self._heard = now
        self._drive.power_up(now)
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

    def back_up(self, parameters: bytes, now: float) -> StatusError:
        """Store the settings, or bring them back and restart; see `simulator.backup`."""
        error, restored = self._backup.handle(parameters)
        if restored:
            self.reboot(now)
        return error

    def clear(self, parameters: bytes, now: float) -> StatusError:
        """Bring the reported position back into one turn; only while the shaft stands still."""
        if parameters != _CLEAR_TURNS:
            return StatusError.DATA_RANGE
        if self.moving(now):
            return StatusError.RESULT_FAIL
        self._drive.power_up(now)
        return StatusError.NONE

    def fail(self, errors: HardwareError, now: float) -> None:
        """Let hardware errors happen; those in the shutdown mask cut the torque until a reboot."""
        self._registers.set("hardware_error_status", self.value("hardware_error_status") | errors)
        if errors & self.value("shutdown"):
            self._drive.halt(now)
            self._registers.set("torque_enable", 0)
            self._shut_down = True

    # -- what befalls it

    def heat(self, temperature_deg_c: float, now: float) -> None:
        """Let it be warm; beyond its limit that is a hardware error. It cools by and by."""
        self._advance(now)
        self._drive.body.temperature_deg_c = temperature_deg_c
        self._check_hardware(now)

    def hinder(self, factor: float, now: float, until: float) -> None:
        """Let something hold the shaft until then: it moves so many times as fast, or with 0 not at all."""
        self._advance(now)
        self._drive.hinder(factor, now, until)

    def carry(self, shaft_ticks: float, now: float) -> None:
        """Let a hand bring the shaft somewhere."""
        self._drive.carry(shaft_ticks, now)

    def press(self, share: float, now: float, until: float) -> None:
        """Let something lean on the shaft until then: holding against it takes this share of full effort."""
        self._advance(now)
        self._drive.body.press(share, until)

    def weaken_supply(self, factor: float, now: float, until: float) -> None:
        """Let the supply give only so much of its voltage until then."""
        self._advance(now)
        self._drive.body.weaken(factor, until)
        self._check_hardware(now)

    def lose_turn(self, now: float) -> None:
        """Let the count of turns be off by one; in position mode, of one turn, there is nothing to lose."""
        self._advance(now)
        self._drive.lose_turn(now)

    def trip_watchdog(self, now: float) -> None:
        """Let the bus watchdog trip: the shaft stops, and goals are refused until it is cleared."""
        self._registers.set("bus_watchdog", WATCHDOG_TRIPPED)
        self._drive.stop_for_silence(now)

    # -- where it is

    def shaft_ticks(self, now: float) -> int:
        """Tick of the encoder that the shaft stands at, turns included, whatever the offsets say."""
        self._advance(now)
        return nearest(self._drive.shaft.at(now)[0])

    def behind_ticks(self) -> float:
        """How far the arm hangs from where the encoder sees the shaft."""
        return self._drive.behind_ticks()

    def moving(self, now: float) -> bool:
        """Tell whether a profile is running or the shaft turns faster than the moving threshold."""
        self._advance(now)
        return self._drive.moving(now)

    def present_ticks(self, now: float) -> int:
        """Position as the servo reports it."""
        return self._drive.present_ticks(now)

    # -- inside

    def _after_goal_position(self, value: int, now: float) -> None:
        wakes = self.value("drive_mode") & DriveMode.TORQUE_ON_BY_GOAL and not self._shut_down
        if wakes and not self.value("torque_enable"):
            self._registers.set("torque_enable", 1)
        self._drive.after_goal_position(value, now)

    def _advance(self, now: float) -> None:
        """Let happen what happens by itself until now."""
        self._check_watchdog(now)
        self._drive.go_on(now)
        self._check_hardware(now)

    def _check_watchdog(self, now: float) -> None:
        """Stop where the shaft was when the bus had been silent for too long."""
        limit = self.value("bus_watchdog")
        expiry = self._heard + limit * WATCHDOG_UNIT_S
        if limit > 0 and self.value("torque_enable") and now > expiry:
            self.trip_watchdog(expiry)

    def _check_hardware(self, now: float) -> None:
        errors, effort = HardwareError(0), abs(self._drive.effort(now))
        voltage_dv = nearest(10.0 * self._drive.body.voltage_v(now, effort))
        if not self.value("min_voltage_limit") <= voltage_dv <= self.value("max_voltage_limit"):
            errors |= HardwareError.INPUT_VOLTAGE
        if self.value("temperature_limit") < int(self._drive.body.temperature_deg_c):
            errors |= HardwareError.OVERHEATING
        since = self._drive.saturated_since
        if since is not None and now - since >= OVERLOAD_S:
            errors |= HardwareError.OVERLOAD
        if errors & ~self.value("hardware_error_status"):
            self.fail(errors, now)

    def _measure(self, now: float) -> None:
        """Bring the registers that the servo measures up to date."""
        self._advance(now)
        shaft = self._drive.shaft
        position, velocity = shaft.at(now)
        effort = self._drive.effort(now)
        self._report.motion(
            position=nearest(self._drive.reported(position)),
            velocity=self._drive.direction * velocity,
            running=shaft.running(now),
            kind=shaft.kind,
        )
        self._report.body(
            effort=self._drive.direction * effort,
            volts=self._drive.body.voltage_v(now, abs(effort)),
            temperature_deg_c=self._drive.body.temperature_deg_c,
            uptime_s=now - self._power_up,
        )
