"""The control table of Dynamixel X servos as data: address, width, who may write it, range and unit.

Source: ROBOTIS e-manual (Protocol 2.0), XH430-W350. The X series shares one table; what differs from model to
model (number, limits, gains, a few registers) stands in `rig.servo_models`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum, IntFlag
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


class Area(Enum):
    """Where a register lives."""

    EEPROM = "EEPROM"
    """Survives power loss; writable only while torque is off."""
    RAM = "RAM"
    """Returns to its default at power-up and reboot."""


class Access(Enum):
    """Who may write a register."""

    READ = "R"
    READ_WRITE = "RW"


@dataclass(frozen=True, slots=True)
class Register:
    """One register of the control table.

    Attributes
    ----------
    name : str
        Its key in `CONTROL_TABLE`.
    address, size : int
        First byte, and width in bytes (little-endian).
    access : Access
        Read only, or read and write.
    area : Area
        EEPROM or RAM.
    default : int
        Value of a new servo (EEPROM) or after power-up (RAM).
    minimum, maximum : int
        Range that a write must keep; anything that fits where the manual gives none.
    signed : bool
        Two's complement.
    unit : str
        What one count is, "" where it is a code.
    """

    name: str
    address: int
    size: int
    access: Access
    area: Area
    default: int
    minimum: int
    maximum: int
    signed: bool = False
    unit: str = ""

    @property
    def writable(self) -> bool:
        """Whether a client may write it."""
        return self.access is Access.READ_WRITE

    @property
    def end(self) -> int:
        """Address of the first byte after it."""
        return self.address + self.size

    def encode(self, value: int) -> bytes:
        """Bytes of a value on the wire.

        Raises
        ------
        OverflowError
            If the value does not fit into the register's bytes.
        """
        return value.to_bytes(self.size, "little", signed=self.signed)

    def decode(self, data: bytes) -> int:
        """Value of the register's bytes.

        Raises
        ------
        ValueError
            If there are not exactly `size` bytes: a short reply must never pass as a number.
        """
        if len(data) != self.size:
            raise ValueError(f"{self.name} needs {self.size} bytes, got {len(data)}")
        return int.from_bytes(data, "little", signed=self.signed)


class OperatingMode(IntEnum):
    """Values of `operating_mode`."""

    CURRENT = 0
    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5
    PWM = 16


class DriveMode(IntFlag):
    """Bits of `drive_mode`."""

    REVERSE = 0x01
    TIME_BASED_PROFILE = 0x04
    TORQUE_ON_BY_GOAL = 0x08


class HardwareError(IntFlag):
    """Bits of `hardware_error_status` and of the `shutdown` mask."""

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20


class StatusError(IntEnum):
    """Error numbers of a status packet (its low seven bits)."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


ALERT_BIT = 0x80
"""Rides on every status packet while `hardware_error_status` is not 0; the instruction may have worked."""

MOVING_IN_POSITION = 0x01
"""Bit of `moving_status`: the goal is reached."""

MOVING_PROFILE_ONGOING = 0x02
"""Bit of `moving_status`: the profile towards the goal is still running."""

BAUD_CODES: Mapping[int, int] = MappingProxyType(
    {0: 9_600, 1: 57_600, 2: 115_200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000, 7: 4_500_000}
)
"""Code in `baud_rate` -> bits per second."""

TABLE_SIZE = 662
"""Bytes of the control table: addresses 0 to 661."""


def _eeprom(
    name: str,
    address: int,
    size: int,
    default: int,
    bounds: tuple[int, int],
    *,
    unit: str = "",
    signed: bool = False,
    access: Access = Access.READ_WRITE,
) -> Register:
    return Register(name, address, size, access, Area.EEPROM, default, *bounds, signed, unit)


def _ram(
    name: str,
    address: int,
    size: int,
    default: int,
    bounds: tuple[int, int],
    *,
    unit: str = "",
    signed: bool = False,
) -> Register:
    return Register(name, address, size, Access.READ_WRITE, Area.RAM, default, *bounds, signed, unit)


def _state(name: str, address: int, size: int, unit: str = "", *, signed: bool = False) -> Register:
    bits = 8 * size - signed
    lowest = -(1 << bits) if signed else 0
    return Register(name, address, size, Access.READ, Area.RAM, 0, lowest, (1 << bits) - 1, signed, unit)


_REGISTERS: tuple[Register, ...] = (
    _eeprom("model_number", 0, 2, 1000, (0, 65_535), access=Access.READ),
    _eeprom("model_information", 2, 4, 0, (0, 0xFFFF_FFFF), access=Access.READ),
    _eeprom("firmware_version", 6, 1, 45, (0, 255), access=Access.READ),
    _eeprom("id", 7, 1, 1, (0, 252)),
    _eeprom("baud_rate", 8, 1, 1, (0, 7)),
    _eeprom("return_delay_time", 9, 1, 250, (0, 254), unit="2 us"),
    _eeprom("drive_mode", 10, 1, 0, (0, 13)),
    _eeprom("operating_mode", 11, 1, 3, (0, 16)),
    _eeprom("secondary_id", 12, 1, 255, (0, 255)),
    _eeprom("protocol_type", 13, 1, 2, (1, 2)),
    _eeprom("homing_offset", 20, 4, 0, (-1_044_479, 1_044_479), unit="tick", signed=True),
    _eeprom("moving_threshold", 24, 4, 10, (0, 1_023), unit="0.229 rev/min"),
    _eeprom("temperature_limit", 31, 1, 80, (0, 100), unit="deg C"),
    _eeprom("max_voltage_limit", 32, 2, 160, (95, 160), unit="0.1 V"),
    _eeprom("min_voltage_limit", 34, 2, 95, (95, 160), unit="0.1 V"),
    _eeprom("pwm_limit", 36, 2, 885, (0, 885), unit="0.113 %"),
    _eeprom("current_limit", 38, 2, 648, (0, 648), unit="2.69 mA"),
    _eeprom("velocity_limit", 44, 4, 130, (0, 1_023), unit="0.229 rev/min"),
    _eeprom("max_position_limit", 48, 4, 4_095, (0, 4_095), unit="tick"),
    _eeprom("min_position_limit", 52, 4, 0, (0, 4_095), unit="tick"),
    _eeprom("startup_configuration", 60, 1, 0, (0, 3)),
    _eeprom("shutdown", 63, 1, 52, (0, 255)),
    _ram("torque_enable", 64, 1, 0, (0, 1)),
    _ram("led", 65, 1, 0, (0, 1)),
    _ram("status_return_level", 68, 1, 2, (0, 2)),
    _state("registered_instruction", 69, 1),
    _state("hardware_error_status", 70, 1),
    _ram("velocity_i_gain", 76, 2, 1_920, (0, 16_383)),
    _ram("velocity_p_gain", 78, 2, 100, (0, 16_383)),
    _ram("position_d_gain", 80, 2, 0, (0, 16_383)),
    _ram("position_i_gain", 82, 2, 0, (0, 16_383)),
    _ram("position_p_gain", 84, 2, 900, (0, 16_383)),
    _ram("feedforward_2nd_gain", 88, 2, 0, (0, 16_383)),
    _ram("feedforward_1st_gain", 90, 2, 0, (0, 16_383)),
    _ram("bus_watchdog", 98, 1, 0, (-1, 127), unit="20 ms", signed=True),
    _ram("goal_pwm", 100, 2, 885, (-885, 885), unit="0.113 %", signed=True),
    _ram("goal_current", 102, 2, 648, (-648, 648), unit="2.69 mA", signed=True),
    _ram("goal_velocity", 104, 4, 0, (-1_023, 1_023), unit="0.229 rev/min", signed=True),
    _ram("profile_acceleration", 108, 4, 0, (0, 32_767), unit="214.577 rev/min2"),
    _ram("profile_velocity", 112, 4, 0, (0, 32_767), unit="0.229 rev/min"),
    _ram("goal_position", 116, 4, 0, (-1_048_575, 1_048_575), unit="tick", signed=True),
    _state("realtime_tick", 120, 2, "ms"),
    _state("moving", 122, 1),
    _state("moving_status", 123, 1),
    _state("present_pwm", 124, 2, "0.113 %", signed=True),
    _state("present_current", 126, 2, "2.69 mA", signed=True),
    _state("present_velocity", 128, 4, "0.229 rev/min", signed=True),
    _state("present_position", 132, 4, "tick", signed=True),
    _state("velocity_trajectory", 136, 4, "0.229 rev/min", signed=True),
    _state("position_trajectory", 140, 4, "tick", signed=True),
    _state("present_input_voltage", 144, 2, "0.1 V"),
    _state("present_temperature", 146, 1, "deg C"),
    _state("backup_ready", 147, 1),
    *(_ram(f"indirect_address_{n}", 166 + 2 * n, 2, 223 + n, (64, 661)) for n in range(1, 29)),
    *(_ram(f"indirect_data_{n}", 223 + n, 1, 0, (0, 255)) for n in range(1, 29)),
    *(_ram(f"indirect_address_{n}", 520 + 2 * n, 2, 605 + n, (64, 661)) for n in range(29, 57)),
    *(_ram(f"indirect_data_{n}", 605 + n, 1, 0, (0, 255)) for n in range(29, 57)),
)

CONTROL_TABLE: Mapping[str, Register] = MappingProxyType({register.name: register for register in _REGISTERS})
"""Register name -> register, with the XH430-W350's defaults and ranges."""
