"""The Dynamixel X models that gonio knows, as data: numbers, units, limits, and which registers each has.

Source: ROBOTIS e-manual, the page of each model (control table, specifications at the recommended voltage).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from rig.control_table import CONTROL_TABLE, Access, Area, OperatingMode, Register

if TYPE_CHECKING:
    from collections.abc import Mapping

_NO_CURRENT = frozenset({"current_limit", "goal_current"})
"""Registers of a servo that measures and controls current."""

_CURRENT_MODES = frozenset({OperatingMode.CURRENT, OperatingMode.CURRENT_BASED_POSITION})

_EXTERNAL_PORTS: tuple[Register, ...] = (
    *(
        Register(f"external_port_mode_{n}", 55 + n, 1, Access.READ_WRITE, Area.EEPROM, 3, 0, 3)
        for n in (1, 2, 3)
    ),
    *(
        Register(f"external_port_data_{n}", 150 + 2 * n, 2, Access.READ_WRITE, Area.RAM, 0, 0, 4_095)
        for n in (1, 2, 3)
    ),
)


@dataclass(frozen=True, slots=True)
class ModelInfo:
    """What one servo model is.

    Attributes
    ----------
    name : str
        As printed on the servo.
    number : int
        What it answers to a ping.
    no_load_rpm : float
        Speed at the recommended voltage without load: no profile makes it faster.
    stall_a : float
        Current at that voltage when the shaft is held.
    ticks_per_turn : int
        Encoder counts in one turn of the horn.
    velocity_unit_rpm, acceleration_unit_rpm2 : float
        One count of a velocity (rev/min) and of a profile acceleration (rev/min^2).
    current_unit_ma : float or None
        One count of a current; None where `present_current` holds the load in 0.1 % instead.
    supply_v : float
        The recommended voltage.
    input_v : tuple of float
        Lowest and highest voltage that it is made for.
    firmware : int
        Lowest firmware version this table was checked against.
    defaults : mapping
        Where the model's registers differ from `CONTROL_TABLE`: name -> (default, minimum, maximum).
    lacks : frozenset of str
        Registers of `CONTROL_TABLE` that it does not have.
    extra : tuple of Register
        Registers that `CONTROL_TABLE` does not have.
    modes : frozenset of OperatingMode
        What it can be set to.
    dual : bool
        Whether two of them can be one joint: bit 1 of `drive_mode` makes one the follower.
    """

    name: str
    number: int
    no_load_rpm: float
    stall_a: float
    ticks_per_turn: int = 4_096
    velocity_unit_rpm: float = 0.229
    acceleration_unit_rpm2: float = 214.577
    current_unit_ma: float | None = 2.69
    supply_v: float = 12.0
    input_v: tuple[float, float] = (10.0, 14.8)
    firmware: int = 38
    defaults: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)
    lacks: frozenset[str] = frozenset()
    extra: tuple[Register, ...] = ()
    modes: frozenset[OperatingMode] = frozenset(OperatingMode)
    dual: bool = False


def _limits(
    *, current: int | None = None, velocity: int, p_gain: int = 800
) -> dict[str, tuple[int, int, int]]:
    """Defaults and ranges that differ from the XH430-W350's."""
    changed = {"velocity_limit": (velocity, 0, 1_023), "position_p_gain": (p_gain, 0, 16_383)}
    if current is not None:
        changed |= {"current_limit": (current, 0, current), "goal_current": (current, -current, current)}
    return changed


def _large(name: str, number: int, no_load_rpm: float, stall_a: float, velocity: int) -> ModelInfo:
    """One of the 540 series: more current, three external ports, leader and follower."""
    limits = _limits(current=2_047, velocity=velocity)
    drive_mode = {"drive_mode": (0, 0, 15)}
    return ModelInfo(
        name, number, no_load_rpm, stall_a, defaults=limits | drive_mode, extra=_EXTERNAL_PORTS, dual=True
    )


MODELS: Mapping[str, ModelInfo] = MappingProxyType(
    {
        model.name: model
        for model in (
            ModelInfo("XH430-W350", 1000, 30.0, 1.3),
            ModelInfo("XH430-W210", 1010, 50.0, 1.3, defaults=_limits(velocity=210, p_gain=900)),
            ModelInfo("XM430-W350", 1020, 46.0, 2.3, defaults=_limits(current=1_193, velocity=200)),
            ModelInfo("XM430-W210", 1030, 77.0, 2.3, defaults=_limits(current=1_193, velocity=330)),
            ModelInfo(
                "XL430-W250",
                1060,
                57.0,
                1.3,
                current_unit_ma=None,
                supply_v=11.1,
                input_v=(6.5, 12.0),
                defaults=_limits(velocity=265, p_gain=640)
                | {
                    "temperature_limit": (72, 0, 100),
                    "max_voltage_limit": (140, 60, 140),
                    "min_voltage_limit": (60, 60, 140),
                    "velocity_i_gain": (1_000, 0, 16_383),
                    "position_d_gain": (4_000, 0, 16_383),
                },
                lacks=_NO_CURRENT,
                modes=frozenset(OperatingMode) - _CURRENT_MODES,
            ),
            _large("XH540-W270", 1100, 39.0, 4.9, velocity=167),
            _large("XH540-W150", 1110, 70.0, 4.9, velocity=300),
            _large("XM540-W270", 1120, 30.0, 4.4, velocity=128),
            _large("XM540-W150", 1130, 53.0, 4.4, velocity=230),
        )
    }
)
"""Model name -> what it is."""

MODEL_NAMES: Mapping[int, str] = MappingProxyType({model.number: name for name, model in MODELS.items()})
"""Model number -> model name."""


def control_table(model: str) -> dict[str, Register]:
    """Control table of one model: `CONTROL_TABLE` with its own number, registers, defaults and ranges.

    Raises
    ------
    KeyError
        If the model is not in `MODELS`.
    """
    info = MODELS[model]
    table = {name: register for name, register in CONTROL_TABLE.items() if name not in info.lacks}
    table |= {register.name: register for register in info.extra}
    table["model_number"] = replace(table["model_number"], default=info.number)
    if info.current_unit_ma is None:
        table["present_current"] = replace(table["present_current"], unit="0.1 %")
    for name, (default, minimum, maximum) in info.defaults.items():
        table[name] = replace(table[name], default=default, minimum=minimum, maximum=maximum)
    return table
