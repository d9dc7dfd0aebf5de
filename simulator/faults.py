"""The twin's faults as a person writes them: a TOML file that says what fails, where, and when.

    seed = 7                    # decides which packets the rate hits
    servo_error_rate = 0.01     # share of servo packets, either way, that are dropped or corrupted

    [[fault]]
    kind = "overload"
    joint = "camera_azimuth"
    at_exposure = 12            # or at_packet = 400 (of the servo line), or at_s = 3.5 (since power-up)

The same file on the same client does the same: nothing depends on chance but through the seed. Times are the
clock's, not the hurried motion's.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from rig.errors import BadInput


class FaultKind(StrEnum):
    """What can fail."""

    DROP = "drop"
    CORRUPT = "corrupt"
    DUPLICATE = "duplicate"
    DELAY = "delay"
    UNPLUG = "unplug"
    STUCK = "stuck"
    SLOW = "slow"
    OVERLOAD = "overload"
    OVERHEATING = "overheating"
    LOAD = "load"
    LOW_VOLTAGE = "low-voltage"
    BROWN_OUT = "brown-out"
    LOST_TURN = "lost-turn"
    BUS_WATCHDOG = "bus-watchdog"
    DOOR_OPEN = "door-open"
    LAMP_DRIFT = "lamp-drift"
    LAMP_FLICKER = "lamp-flicker"
    LAMP_DEAD = "lamp-dead"
    LAMP_RESTART = "lamp-restart"
    NO_FILE = "no-file"
    LATE_FILE = "late-file"
    TRUNCATED_FILE = "truncated-file"
    FILE_TWICE = "file-twice"
    FILE_OUT_OF_ORDER = "file-out-of-order"
    WRONG_EXPOSURE = "wrong-exposure"
    DISK_FULL = "disk-full"
    CLOCK_STEP = "clock-step"


WIRE = frozenset({FaultKind.DROP, FaultKind.CORRUPT, FaultKind.DUPLICATE, FaultKind.DELAY})
SERVO = frozenset(
    {
        FaultKind.STUCK, FaultKind.SLOW, FaultKind.OVERLOAD, FaultKind.OVERHEATING, FaultKind.BROWN_OUT,
        FaultKind.LOST_TURN, FaultKind.BUS_WATCHDOG, FaultKind.LOAD, FaultKind.LOW_VOLTAGE,
    }
)  # fmt: skip
CAMERA = frozenset(
    {
        FaultKind.NO_FILE, FaultKind.LATE_FILE, FaultKind.TRUNCATED_FILE, FaultKind.FILE_TWICE,
        FaultKind.FILE_OUT_OF_ORDER, FaultKind.WRONG_EXPOSURE, FaultKind.DISK_FULL, FaultKind.CLOCK_STEP,
    }
)  # fmt: skip

WHEN = ("at_exposure", "at_packet", "at_s")
LINES, DIRECTIONS = ("servos", "lamp"), ("in", "out")

_DEFAULTS: dict[FaultKind, dict[str, Any]] = {
    **{kind: {"line": "servos", "direction": "out", "count": 1} for kind in WIRE},
    **{kind: {"joint": None} for kind in SERVO},
    **{kind: {"count": 1} for kind in CAMERA},
    FaultKind.DELAY: {"line": "servos", "direction": "out", "count": 1, "for_s": 0.5},
    FaultKind.UNPLUG: {"line": "servos", "for_s": 1.0},
    FaultKind.STUCK: {"joint": None, "for_s": math.inf},
    FaultKind.OVERHEATING: {"joint": None, "deg_c": 85.0},
    FaultKind.LOAD: {"joint": None, "for_s": 10.0, "factor": 0.5},
    FaultKind.LOW_VOLTAGE: {"joint": None, "for_s": 10.0, "factor": 0.75},
    FaultKind.SLOW: {"joint": None, "for_s": math.inf, "factor": 0.2},
    FaultKind.DOOR_OPEN: {"for_s": 1.0},
    FaultKind.LAMP_DRIFT: {"for_s": 10.0, "factor": 0.95},
    FaultKind.LAMP_FLICKER: {"count": 1, "factor": 0.8},
    FaultKind.LAMP_DEAD: {"for_s": math.inf},
    FaultKind.LAMP_RESTART: {},
    FaultKind.LATE_FILE: {"count": 1, "for_s": 1.0},
    FaultKind.WRONG_EXPOSURE: {"count": 1, "factor": 2.0},
    FaultKind.CLOCK_STEP: {"count": 1, "for_s": -3600.0},
}
"""Which fields a kind has, and what they are where the file does not say; a joint has no default."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Attributes
    ----------
    kind : FaultKind
    at_exposure, at_packet : int or None
        It happens when the exposure of this number has begun, or this servo packet arrives, both counted
        from 1 since the twin's start.
    at_s : float or None
        It happens so long after the twin's start. Exactly one of the three is given.
    joint : str
        Whose servo.
    line, direction : str
        Which wire, and whether what comes from the client ("in") or goes to it ("out") is hit.
    count : int
        Packets, lines or exposures that are hit.
    for_s : float
        How long it lasts; for a clock's step how far it goes.
    factor : float
        Of the speed, of the light in the end, of the exposure, of the full effort, of the voltage.
    deg_c : float
        How warm the servo is.
    """

    kind: FaultKind
    at_exposure: int | None = None
    at_packet: int | None = None
    at_s: float | None = None
    joint: str = ""
    line: str = ""
    direction: str = ""
    count: int = 0
    for_s: float = 0.0
    factor: float = 1.0
    deg_c: float = 0.0


@dataclass(frozen=True, slots=True)
class FaultScript:
    """All faults of a twin.

    Attributes
    ----------
    faults : tuple of Fault
    servo_error_rate : float
        Share of servo packets, either way, that are dropped or corrupted, half and half.
    seed : int
        Decides which.
    """

    faults: tuple[Fault, ...] = ()
    servo_error_rate: float = 0.0
    seed: int = 0


def load_faults(path: str | Path, joints: tuple[str, ...]) -> FaultScript:
    """Read a fault script.

    Parameters
    ----------
    path : path
    joints : tuple of str
        Names of the machine's joints.

    Returns
    -------
    FaultScript

    Raises
    ------
    BadInput
        It cannot be read, or says something that cannot happen; the message names the fault.
    """
    where = str(path)
    try:
        content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput(error.strerror or "unreadable", where=where, todo="give a TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"not TOML: {error}", where=where, todo="mend that line") from None
    unknown = sorted(content.keys() - {"fault", "seed", "servo_error_rate"})
    if unknown:
        todo = "a script has seed, servo_error_rate and [[fault]] tables"
        raise BadInput(f"unknown key {unknown[0]!r}", where=where, todo=todo)
    listed = content.get("fault", [])
    if not isinstance(listed, list) or not all(isinstance(each, dict) for each in listed):
        raise BadInput("fault is no list of tables", where=where, todo="write each as [[fault]]")
    rate = _number(content.get("servo_error_rate", 0.0), 0.0, 1.0, f"{where} servo_error_rate")
    seed = content.get("seed", 0)
    if not isinstance(seed, int) or isinstance(seed, bool):
        raise BadInput(f"a seed of {seed!r}", where=where, todo="give a whole number")
    faults = (_fault(each, f"{where} fault {number}", joints) for number, each in enumerate(listed, 1))
    return FaultScript(tuple(faults), rate, seed)


def _fault(table: dict[str, Any], where: str, joints: tuple[str, ...]) -> Fault:
    try:
        kind = FaultKind(table.get("kind", ""))
    except ValueError:
        todo = f"choose from {', '.join(FaultKind)}"
        raise BadInput(f"unknown kind {table.get('kind')!r}", where=where, todo=todo) from None
    given = [name for name in WHEN if name in table]
    if len(given) != 1:
        raise BadInput("it is not clear when", where=where, todo=f"give one of {', '.join(WHEN)}")
    allowed = _DEFAULTS[kind]
    unknown = sorted(table.keys() - {"kind", *WHEN, *allowed})
    if unknown:
        todo = f"{kind} takes {', '.join(allowed) or 'nothing else'}"
        raise BadInput(f"unknown key {unknown[0]!r}", where=where, todo=todo)
    values = {name: table.get(name, value) for name, value in allowed.items()}
    _require_known(values, where, joints)
    for name, (low, high) in _ranges(kind).items():
        if name in values:
            values[name] = _number(values[name], low, high, f"{where} {name}")
    when = table[given[0]]
    values[given[0]] = (
        _number(when, 0.0, math.inf, where) if given == ["at_s"] else _count(when, f"{where} {given[0]}")
    )
    if "count" in values:
        values["count"] = _count(values["count"], f"{where} count")
    return Fault(kind, **values)


def _require_known(values: dict[str, Any], where: str, joints: tuple[str, ...]) -> None:
    for name, known in (("joint", joints), ("line", LINES), ("direction", DIRECTIONS)):
        if name in values and values[name] not in known:
            todo = f"choose from {', '.join(known)}"
            raise BadInput(f"no {name} {values[name]!r}", where=where, todo=todo)


def _ranges(kind: FaultKind) -> dict[str, tuple[float, float]]:
    longest = -math.inf if kind is FaultKind.CLOCK_STEP else 0.0
    return {"for_s": (longest, math.inf), "factor": (0.0, 1000.0), "deg_c": (0.0, 150.0)}


def _number(value: object, low: float, high: float, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise BadInput(f"{value!r} is no number from {low:g} to {high:g}", where=where, todo="mend it")
    return float(value)


def _count(value: object, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise BadInput(f"{value!r} is no whole number from 1", where=where, todo="mend it")
    return value
