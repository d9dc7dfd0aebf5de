"""What a journal holds: planned poses, visits, shots, levels, events.

The words are those of the journal's tables in `docs/session.md`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag, StrEnum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from capture.statistics import FrameStatistics


class Role(StrEnum):
    """What a frame is of."""

    WHITE = "white"
    SAMPLE = "sample"
    TRAP = "trap"
    DARK = "dark"


class ShotState(StrEnum):
    """How far a shot has come."""

    INTENT = "intent"
    FILED = "filed"
    VERIFIED = "verified"


class PoseFlag(IntFlag):
    """What to know about a pose and its frames; the values are part of the file format."""

    OVER_RANGE = 1
    """The brightest part clips even in the shortest frame."""
    UNDER_RANGE = 2
    """The brightest part stays below the wanted level even in the longest frame."""
    NOISY = 4
    """The dim part stays below the plan's signal-to-noise ratio."""
    SHADED = 8
    """A solid of the machine shades what is measured."""
    HIDDEN = 16
    """A solid of the machine hides it from the camera."""
    LAMP_IN_VIEW = 32
    """The lamp shines into the camera's frame."""


NO_FLAG = PoseFlag(0)

SPOILED = PoseFlag.SHADED | PoseFlag.HIDDEN | PoseFlag.LAMP_IN_VIEW
"""What the plan knew before: the pictures are not of the sample in the lamp's light alone."""


@dataclass(frozen=True, slots=True)
class PlannedPose:
    """One pose of the expanded plan.

    Attributes
    ----------
    index : int
        Its number in the plan's order.
    wi, wo : tuple of float, shape (3,)
        Directions to light and camera.
    angles_rad : tuple of float or None
        Angles of the arm joints; None where the pose was refused.
    refused : str or None
        Why the machine cannot take it.
    """

    index: int
    wi: tuple[float, ...]
    wo: tuple[float, ...]
    angles_rad: tuple[float, ...] | None
    refused: str | None = None


@dataclass(frozen=True, slots=True)
class Held:
    """Where the arms verifiably stood: ticks of all servos, angles of the arm joints."""

    ticks: tuple[int, ...]
    angles_rad: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Visit:
    """One stay at one pose in one role.

    Attributes
    ----------
    number : int
        Its place in the order of the session.
    role : Role
    pose : int
        The pose's index; for darks 0 is the shortest exposure, 1 the longest.
    station : str or None
        Station of the wheel, None without one.
    angles_rad : tuple of float
        Planned angles of the arm joints.
    held : Held or None
        Measured; None before the arms got there.
    flags : PoseFlag
    done : bool
        Whether all its frames are hashed and checked.
    """

    number: int
    role: Role
    pose: int
    station: str | None
    angles_rad: tuple[float, ...]
    held: Held | None = None
    flags: PoseFlag = NO_FLAG
    done: bool = False


@dataclass(frozen=True, slots=True)
class Shot:
    """One exposure, from its intent to its verified file.

    Attributes
    ----------
    shot_id : str
    visit : int
    frame : int
        Its number within the visit.
    exposure_s : float
    lit : bool
    state : ShotState
    path : str or None
        Below the session's folder, with forward slashes.
    sha256 : str or None
        Of the file's bytes.
    statistics : FrameStatistics or None
    """

    shot_id: str
    visit: int
    frame: int
    exposure_s: float
    lit: bool
    state: ShotState = ShotState.INTENT
    path: str | None = None
    sha256: str | None = None
    statistics: FrameStatistics | None = None


@dataclass(frozen=True, slots=True)
class LevelsRecord:
    """Levels at the end of a visit; those of the servos in the rig file's order.

    Attributes
    ----------
    visit : int
    temperature_deg_c, voltage_v : tuple of float
    current_ma : tuple of float or None
        None for a model that measures its load instead.
    load : tuple of float
        Share of the servo's limit.
    lamp_deg_c : float or None
        Temperature of the lamp's head.
    lamp_output : float or None
        Light of the last frame over what the lamp's level promises; None for darks.
    lamp_drift : float or None
        The same over that of the session's first pose.
    time : str
        Empty before it is logged.
    """

    visit: int
    temperature_deg_c: tuple[float, ...]
    voltage_v: tuple[float, ...]
    current_ma: tuple[float | None, ...]
    load: tuple[float, ...]
    lamp_deg_c: float | None
    lamp_output: float | None
    lamp_drift: float | None
    time: str = ""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened: an interruption, a stray file, a stop."""

    time: str
    kind: str
    detail: dict[str, Any]
