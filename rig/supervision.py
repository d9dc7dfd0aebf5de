"""Levels of a machine that are logged with every pose, and the bands that they must keep.

A servo's own limits cut its torque: the arm drops, the night is over. The bands here lie inside them, so that
a capture can pause and wait before that happens. Levels are compared whenever they are read, the first time
before anything is measured: one that was out of its band from the start is seen as well.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from rig.servo_models import MODELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rig.bus import ServoBus
    from rig.description import Rig

REGISTERS = ("present_current", "present_input_voltage", "present_temperature")
"""What a look reads: 21 adjacent bytes a servo, one packet for all."""

VOLT_COUNT = 0.1
"""One count of a voltage register, in volts."""

LOAD_COUNT = 0.001
"""One count of `present_current` where it holds the load, as a share."""

CALM_DEG_C, CALM_V, CALM_LOAD = 2.0, 0.1, 0.05
"""How far inside its band a level must be again before a pause ends: else it would soon be the next pause."""


@dataclass(frozen=True, slots=True)
class ServoLevels:
    """Levels of one servo.

    Attributes
    ----------
    joint : str
    temperature_deg_c : float
    voltage_v : float
        At its connector.
    current_ma : float or None
        Signed; None where the model measures its load instead.
    load : float
        Current over the servo's current limit, or the load that the servo estimates; a share, not negative.
    """

    joint: str
    temperature_deg_c: float
    voltage_v: float
    current_ma: float | None
    load: float


@dataclass(frozen=True, slots=True)
class Levels:
    """All levels of a machine at one time.

    Attributes
    ----------
    servos : tuple of ServoLevels
        In the order of the rig file.
    lamp_deg_c : float
        Temperature of the lamp's head.
    lamp_output : float
        Light of the last shot over what the lamp's level promises; NaN for a dark or unmeasured one.
    """

    servos: tuple[ServoLevels, ...]
    lamp_deg_c: float
    lamp_output: float


@dataclass(frozen=True, slots=True)
class Band:
    """What one level of one servo must keep, both ends included.

    Attributes
    ----------
    joint, quantity, unit : str
    low, high : float
        -inf where only too much is a fault.
    calm : float
        How far inside a level that has left it must come again.
    """

    joint: str
    quantity: str
    unit: str
    low: float
    high: float
    calm: float

    def holds(self, value: float, *, calm: bool = False) -> bool:
        """Whether a level lies in the band, or so far inside that a pause may end."""
        # A band narrower than the calm on both sides could never be reached again.
        inset = min(self.calm, 0.25 * (self.high - self.low)) if calm else 0.0
        return self.low + inset - 1e-9 <= value <= self.high - inset + 1e-9


@dataclass(frozen=True, slots=True)
class Breach:
    """A level outside its band."""

    joint: str
    quantity: str
    value: float
    low: float
    high: float
    unit: str

    def told(self) -> str:
        """Write it for a person: `turntable temperature 71 deg C, allowed up to 70`."""
        unit = f" {self.unit}" if self.unit else ""
        least = "up to" if math.isinf(self.low) else f"{self.low:g} to"
        return f"{self.joint} {self.quantity} {self.value:g}{unit}, allowed {least} {self.high:g}"

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON; None for no lower end."""
        return asdict(self) | {"low": None if math.isinf(self.low) else self.low}


class Supervisor:
    """Reads the servos' levels and knows their bands.

    Parameters
    ----------
    rig : Rig
    bus : ServoBus
    """

    def __init__(self, rig: Rig, bus: ServoBus) -> None:
        self._rig, self._bus = rig, bus

    def read(self) -> tuple[ServoLevels, ...]:
        """Read the levels of all servos, in the order of the rig file.

        Raises
        ------
        DeviceLost
            If a servo does not answer.
        """
        joints = self._rig.joints
        states = self._bus.sync_read([joint.id for joint in joints], REGISTERS)
        levels = []
        for joint in joints:
            state, unit = states[joint.id], MODELS[joint.model].current_unit_ma
            count, limit = state["present_current"], self._current_limits[joint.id]
            levels.append(
                ServoLevels(
                    joint.name,
                    float(state["present_temperature"]),
                    round(state["present_input_voltage"] * VOLT_COUNT, 1),
                    None if unit is None else count * unit,
                    abs(count) * LOAD_COUNT if unit is None else abs(count) / max(limit, 1),
                )
            )
        return tuple(levels)

    def breaches(self, levels: Sequence[ServoLevels], after: Sequence[Breach] = ()) -> tuple[Breach, ...]:
        """List the levels outside their bands.

        Parameters
        ----------
        levels : sequence of ServoLevels
        after : sequence of Breach
            Levels that were outside; they are listed until they are well inside again.
        """
        restless = {(breach.joint, breach.quantity) for breach in after}
        found = []
        for level in levels:
            for band in self._bands[level.joint]:
                value = getattr(level, _FIELDS[band.quantity])
                if not band.holds(value, calm=(band.joint, band.quantity) in restless):
                    found.append(Breach(level.joint, band.quantity, value, band.low, band.high, band.unit))
        return tuple(found)

    @cached_property
    def _current_limits(self) -> dict[int, int]:
        """Current limit of each servo that has one, in counts, as it stands in its EEPROM."""
        return {
            joint.id: self._bus.read(joint.id, "current_limit")
            if MODELS[joint.model].current_unit_ma is not None
            else 0
            for joint in self._rig.joints
        }

    @cached_property
    def _bands(self) -> dict[str, tuple[Band, ...]]:
        """Bands of each joint: the rig file's, inside the servo's own limits, inside what its model takes."""
        limits, margin = self._rig.supervision, self._rig.supervision.temperature_margin_deg_c
        bands: dict[str, tuple[Band, ...]] = {}
        for joint in self._rig.joints:
            hottest, lowest, highest = (
                self._bus.read(joint.id, f"{name}_limit")
                for name in ("temperature", "min_voltage", "max_voltage")
            )
            least, most = MODELS[joint.model].input_v
            low = max(limits.voltage_min_v or least, lowest * VOLT_COUNT)
            high = min(limits.voltage_max_v or most, highest * VOLT_COUNT)
            bands[joint.name] = (
                Band(joint.name, "temperature", "deg C", -math.inf, hottest - margin, CALM_DEG_C),
                Band(joint.name, "voltage", "V", low, high, CALM_V),
                Band(joint.name, "load", "", -math.inf, limits.load_max, CALM_LOAD),
            )
        return bands


_FIELDS = {"temperature": "temperature_deg_c", "voltage": "voltage_v", "load": "load"}
