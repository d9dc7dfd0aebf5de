"""The handshake with the servos: what the rig file expects, what is on the bus, and making both agree."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rig import bus_watchdog
from rig.control_table import CONTROL_TABLE, OperatingMode
from rig.errors import BadInput, DeviceLost, Refused
from rig.packets import PortLost
from rig.servo_found import HandshakeRow, ServoFound
from rig.servo_models import MODEL_NAMES, MODELS
from rig.ticks import rad_to_ticks, tick_rad
from rig.trapezoid import Trapezoid

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rig.bus import ServoBus
    from rig.description import Joint

RPM_PER_DEG_S = 1.0 / 6.0
RPM2_PER_DEG_S2 = 10.0

_EEPROM_SHOWN = ("baud_rate", "return_delay_time", "drive_mode", "operating_mode", "homing_offset")
_LIMITS = ("max_position_limit", "min_position_limit")
_HEALTH = ("present_input_voltage", "present_temperature")


@dataclass(frozen=True, slots=True)
class ServoSpec:
    """What the rig file demands of one servo, in the servo's own units.

    Attributes
    ----------
    name, servo_id, model : str, int, str
        Joint, id on the bus, model.
    minimum, maximum : int
        Position limits in ticks, inside the joint's limits.
    velocity, acceleration : int
        Profile in the servo's counts, rounded down: never faster than asked, never 0, which means unlimited.
    tolerance : int
        Ticks from the goal that count as arrived, at least 1.
    tick_deg : float
        Degrees of the joint in one tick, for messages.
    """

    name: str
    servo_id: int
    model: str
    minimum: int
    maximum: int
    velocity: int
    acceleration: int
    tolerance: int
    tick_deg: float

    @classmethod
    def of(cls, joint: Joint) -> ServoSpec:
        """Translate one joint of the rig file.

        Raises
        ------
        BadInput
            If its model is not known, or its limits leave the one turn of position mode.
        """
        if joint.model not in MODELS:
            raise BadInput(
                f"unknown servo model {joint.model!r}", where=f"joint {joint.name}",
                todo=f"use one of {', '.join(MODELS)}",
            )  # fmt: skip
        model = MODELS[joint.model]
        ends = sorted(rad_to_ticks(joint, math.radians(limit)) for limit in joint.limits_deg)
        register = CONTROL_TABLE["max_position_limit"]
        if ends[0] < register.minimum or ends[1] > register.maximum:
            raise BadInput(
                f"limits_deg {joint.limits_deg} are ticks {ends[0]} to {ends[1]}, beyond one turn",
                where=f"joint {joint.name}",
                todo=f"keep them within {register.minimum} to {register.maximum} ticks",
            )
        rpm = joint.speed_deg_s * joint.gear_ratio * RPM_PER_DEG_S
        rpm2 = joint.acceleration_deg_s2 * joint.gear_ratio * RPM2_PER_DEG_S2
        tick_deg = math.degrees(tick_rad(joint))
        return cls(
            name=joint.name,
            servo_id=joint.id,
            model=joint.model,
            minimum=ends[0],
            maximum=ends[1],
            velocity=_counts(rpm / model.velocity_unit_rpm, "profile_velocity"),
            acceleration=_counts(rpm2 / model.acceleration_unit_rpm2, "profile_acceleration"),
            tolerance=max(1, int(joint.tolerance_deg / tick_deg)),
            tick_deg=tick_deg,
        )

    @property
    def eeprom(self) -> dict[str, int]:
        """Registers that survive power loss, and what they must hold."""
        return {
            "return_delay_time": 0,
            "operating_mode": OperatingMode.POSITION,
            "max_position_limit": self.maximum,
            "min_position_limit": self.minimum,
        }

    @property
    def profile(self) -> dict[str, int]:
        """Registers that must be written after every power-up."""
        return {"profile_acceleration": self.acceleration, "profile_velocity": self.velocity}

    def clamp(self, ticks: int) -> int:
        """Nearest position inside the limits: the servo refuses any other goal."""
        return min(max(ticks, self.minimum), self.maximum)

    @property
    def speed_ticks_s(self) -> float:
        """Top speed of the profile, ticks per second."""
        model = MODELS[self.model]
        return self.velocity * model.velocity_unit_rpm / 60.0 * model.ticks_per_turn

    @property
    def acceleration_ticks_s2(self) -> float:
        """Acceleration of the profile, ticks per second squared."""
        model = MODELS[self.model]
        return self.acceleration * model.acceleration_unit_rpm2 / 3600.0 * model.ticks_per_turn

    def profile_over(self, distance_ticks: float) -> Trapezoid:
        """How this servo covers a distance in ticks, either way."""
        return Trapezoid(abs(distance_ticks), self.speed_ticks_s, self.acceleration_ticks_s2)

    def duration_s(self, distance_ticks: float) -> float:
        """Time that this servo takes over a distance."""
        return self.profile_over(distance_ticks).duration_s


def _counts(value: float, register: str) -> int:
    return min(max(1, math.floor(value + 1e-9)), CONTROL_TABLE[register].maximum)


@dataclass(frozen=True, slots=True)
class Handshake:
    """Everything expected and found on a servo bus.

    Attributes
    ----------
    port : str
        The bus.
    rows : tuple of HandshakeRow
        One per servo of the rig file, in its order.
    strangers : mapping
        Servos on the bus that the rig file does not know: id -> (model number, firmware). Looked for only
        when one is missing, because that takes a second.
    """

    port: str
    rows: tuple[HandshakeRow, ...]
    strangers: Mapping[int, tuple[int, int]]

    def table(self) -> str:
        """Write expected against found, a line per servo."""
        head = ("id", "joint", "expected", "found", "firmware", "baud", "mode", "limits", "torque", "state")
        lines = [head, *(row.cells() for row in self.rows)]
        for servo_id, (model, firmware) in self.strangers.items():
            found = MODEL_NAMES.get(model, str(model))
            unread = ("",) * 4
            lines.append((str(servo_id), "-", "-", found, str(firmware), *unread, "not in the rig file"))
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join(
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
            for line in lines
        )

    def require(self) -> None:
        """Pass only if every servo can be used.

        Raises
        ------
        DeviceLost
            If one does not answer.
        Refused
            If one is of another model, reports a hardware error, or is set up unusably.
        """
        faults = [f"servo {r.spec.servo_id} ({r.spec.name}) {r.fault}" for r in self.rows if r.fault]
        if not faults:
            return
        lost = any(row.found is None for row in self.rows)
        kind = DeviceLost if lost else Refused
        todo = (
            "check power, cable, baud and ids"
            if lost
            else "mend rig.toml or the servo; an error clears when the servo is switched off and on"
        )
        raise kind(f"{'; '.join(faults)}; found {self._found()}", where=self.port, todo=todo)

    def _found(self) -> str:
        found = [f"{r.spec.servo_id}: {r.found.model}" for r in self.rows if r.found is not None]
        found += [f"{i}: {MODEL_NAMES.get(model, model)}" for i, (model, _) in self.strangers.items()]
        return ", ".join(found) or "no servo at all"

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        strangers = [{"id": i, "model_number": m, "firmware": f} for i, (m, f) in self.strangers.items()]
        return {"port": self.port, "servos": [row.as_dict() for row in self.rows], "strangers": strangers}


def shake_hands(bus: ServoBus, specs: Sequence[ServoSpec]) -> Handshake:
    """Ask every expected servo who it is; nothing moves; only whether it answers is written.

    Raises
    ------
    DeviceLost
        If the port is gone.
    """
    rows = tuple(HandshakeRow(spec, _find(bus, spec)) for spec in specs)
    strangers: dict[int, tuple[int, int]] = {}
    if any(row.found is None for row in rows):
        expected = {spec.servo_id for spec in specs}
        strangers = {i: found for i, found in bus.scan().items() if i not in expected}
    return Handshake(bus.port, rows, strangers)


def _find(bus: ServoBus, spec: ServoSpec) -> ServoFound | None:
    try:
        model_number, firmware = bus.ping(spec.servo_id)
        if MODEL_NAMES.get(model_number) != spec.model:
            return ServoFound(model_number, firmware, {})
        # A servo told to keep quiet would look like a lost one at the first write.
        bus.sync_write("status_return_level", {spec.servo_id: 2})
        return ServoFound(model_number, firmware, _registers(bus, spec.servo_id))
    except PortLost:
        raise
    except DeviceLost:
        return None


def _shown() -> tuple[str, ...]:
    state = ("torque_enable", "hardware_error_status", bus_watchdog.REGISTER)
    return (*_EEPROM_SHOWN, *_LIMITS, *state, *_HEALTH)


def _registers(bus: ServoBus, servo_id: int) -> dict[str, int]:
    return {name: bus.read(servo_id, name) for name in _shown()}


def configure(bus: ServoBus, handshake: Handshake) -> None:
    """Write what the rig file wants: EEPROM where it differs, profiles always, all read back.

    Raises
    ------
    Refused
        If EEPROM differs while torque is on (an arm would fall), or a value does not stick.
    DeviceLost
        If a servo stops answering.
    """
    for row in handshake.rows:
        if row.differences and row.found is not None and row.found.registers["torque_enable"]:
            changes = ", ".join(f"{name} {a} -> {b}" for name, (a, b) in row.differences.items())
            raise Refused(
                f"must be set up ({changes}), but its torque is on and the arm would fall",
                where=bus.label(row.spec.servo_id),
                todo="support the arms, switch the servos off and on, and run again",
            )
    for row in handshake.rows:
        for name, (_, wanted) in row.differences.items():
            _write_and_read_back(bus, row.spec.servo_id, name, wanted)
        for name, wanted in row.spec.profile.items():
            _write_and_read_back(bus, row.spec.servo_id, name, wanted)


def _write_and_read_back(bus: ServoBus, servo_id: int, name: str, wanted: int) -> None:
    bus.write(servo_id, name, wanted)
    held = bus.read(servo_id, name)
    if held != wanted:
        raise Refused(
            f"{name} was set to {wanted} but reads {held}",
            where=bus.label(servo_id),
            todo="compare speed, acceleration and limits in rig.toml with the servo's own limits",
        )
