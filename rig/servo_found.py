"""One servo at the handshake: what it said of itself, against what the rig file says of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rig import bus_watchdog
from rig.control_table import BAUD_CODES, DriveMode, HardwareError, OperatingMode
from rig.servo_models import MODEL_NAMES, MODELS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rig.handshake import ServoSpec

_UNUSABLE_DRIVE = DriveMode.REVERSE | DriveMode.TIME_BASED_PROFILE


@dataclass(frozen=True, slots=True)
class ServoFound:
    """What one servo said of itself; of a wrong model only model and firmware, its table may differ."""

    model_number: int
    firmware: int
    registers: Mapping[str, int]

    @property
    def model(self) -> str:
        """Model name, or its number where the name is unknown."""
        return MODEL_NAMES.get(self.model_number, f"model {self.model_number}")

    @property
    def errors(self) -> str:
        """Standing hardware errors in words, "" when healthy."""
        return describe_errors(self.registers.get("hardware_error_status", 0))


@dataclass(frozen=True, slots=True)
class HandshakeRow:
    """One servo: expected, found, and what does not fit."""

    spec: ServoSpec
    found: ServoFound | None

    @property
    def fault(self) -> str:
        """Why the machine cannot be used with this servo, "" when it can."""
        if self.found is None:
            return "does not answer"
        if self.found.model != self.spec.model:
            return f"is a {self.found.model}, expected {self.spec.model}"
        return _fault(self.spec, self.found)

    @property
    def differences(self) -> dict[str, tuple[int, int]]:
        """EEPROM registers that differ: name -> (found, wanted)."""
        if self.found is None or not self.found.registers:
            return {}
        found = self.found.registers
        return {n: (found[n], wanted) for n, wanted in self.spec.eeprom.items() if found[n] != wanted}

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        spec = {"id": self.spec.servo_id, "joint": self.spec.name, "model": self.spec.model}
        result: dict[str, Any] = {"expected": spec, "found": None, "fault": self.fault}
        if self.found is not None:
            result["found"] = {
                "model": self.found.model,
                "firmware": self.found.firmware,
                **self.found.registers,
            }
            result["to_write"] = {name: list(pair) for name, pair in self.differences.items()}
        return result

    def cells(self) -> tuple[str, ...]:
        """Its line of the table: id, joint, expected, found, firmware, baud, mode, limits, torque, state."""
        spec, found = self.spec, self.found
        start = (str(spec.servo_id), spec.name, spec.model)
        if found is None:
            return (*start, "-", *("",) * 5, self.fault)
        if not found.registers:
            return (*start, found.model, str(found.firmware), *("",) * 4, self.fault)
        registers = found.registers
        state = self.fault or (
            "ok" if not self.differences else "ok; to write: " + ", ".join(self.differences)
        )
        return (
            *start,
            found.model,
            str(found.firmware),
            str(BAUD_CODES.get(registers["baud_rate"], "?")),
            str(registers["operating_mode"]),
            f"{registers['min_position_limit']}..{registers['max_position_limit']}",
            "on" if registers["torque_enable"] else "off",
            state,
        )


def _fault(spec: ServoSpec, found: ServoFound) -> str:
    """Why a servo of the right model cannot be used, "" when it can."""
    oldest = MODELS[spec.model].firmware
    if found.firmware < oldest:
        return f"has firmware {found.firmware}, needs {oldest} or later"
    if found.errors:
        return f"reports {found.errors}"
    if _runs_away(found):
        return (
            "is in extended mode with a homing offset and its bus watchdog armed: "
            "silence on the bus would make it run away"
        )
    drive = DriveMode(found.registers["drive_mode"]) & _UNUSABLE_DRIVE
    return f"has drive mode {drive.name}, expected neither reverse nor time-based" if drive else ""


def _runs_away(found: ServoFound) -> bool:
    """Tell whether a tripped bus watchdog starts its motor instead of stopping it (SDK issue 584)."""
    registers = found.registers
    extended = registers["operating_mode"] == OperatingMode.EXTENDED_POSITION
    return bool(extended and registers["homing_offset"] and registers[bus_watchdog.REGISTER])


def describe_errors(status: int) -> str:
    """Hardware error bits in words: `overheating and overload`."""
    names = [error.name or str(error.value) for error in HardwareError if status & error]
    return " and ".join(name.lower().replace("_", " ") for name in names)
