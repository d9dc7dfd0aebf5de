"""The description of one machine: `rig.toml` in, a frozen `Rig` out.

Everything that a person can write into the file is in `rig.parts`, with unit and range; this module ties the
parts together, checks what no part can check alone, and hashes the machine. Importing it loads pydantic, so
commands import it when they run.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from pathlib import Path
from typing import Any

from pydantic import Field, PrivateAttr, ValidationError, model_validator

from rig.default_solids import default_solids
from rig.errors import BadInput
from rig.parts import (
    Arms,
    Bus,
    Camera,
    Clearance,
    Joint,
    Lamp,
    Name,
    Part,
    Ports,
    Sample,
    Station,
    Supervision,
    Trap,
    White,
)
from rig.rig_checks import contradictions
from rig.rig_errors import explain
from rig.solids import Box, Capsule, Cylinder, Solid, Sphere
from rig.surroundings import TwinLight

__all__ = [
    "Arms",
    "Box",
    "Bus",
    "Camera",
    "Capsule",
    "Clearance",
    "Cylinder",
    "Joint",
    "Lamp",
    "Ports",
    "Rig",
    "Sample",
    "Solid",
    "Sphere",
    "Station",
    "Supervision",
    "Trap",
    "TwinLight",
    "White",
    "default_rig",
    "dump_rig",
    "load_rig",
]


_LARGEST_FILE = 1_000_000


class Rig(Part):
    """One machine. Two rigs are equal when their contents are, wherever their files lie."""

    name: str = Field(
        "gonio", min_length=1, max_length=200, description="the machine's name, 1 to 200 characters"
    )
    ports: Ports = Field(default_factory=Ports, description="ports and folders of this computer")
    bus: Bus = Field(default_factory=Bus, description="the servo bus")
    joints: tuple[Joint, ...] = Field(
        min_length=1, description="the servos; this order is the order of every pose"
    )
    arms: Arms = Field(description="chains of joints for light, camera, sample and station")
    lamp: Lamp = Field(default_factory=Lamp, description="the light source")
    camera: Camera = Field(default_factory=Camera, description="the camera")
    sample: Sample = Field(default_factory=Sample, description="the sample")
    stations: dict[Name, Station] = Field(
        default_factory=dict, description="places on the station wheel by name; none when there is no wheel"
    )
    white: White = Field(default_factory=White, description="the white reference")
    trap: Trap = Field(default_factory=Trap, description="the light trap")
    clearance: Clearance = Field(default_factory=Clearance, description="what keeps the arms apart")
    supervision: Supervision = Field(
        default_factory=Supervision, description="levels that pause a capture when they leave their band"
    )
    twin: TwinLight = Field(
        default_factory=TwinLight, description="housing, mirrors and the exactness of the twin's light"
    )
    solids: tuple[Solid, ...] = Field(
        (), max_length=200, description="what must not touch, at most 200; none: only angles are checked"
    )

    _folder: Path = PrivateAttr(default_factory=Path)

    @model_validator(mode="after")
    def _check_together(self) -> Rig:
        for error in contradictions(self):
            raise error
        return self

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rig) and self.model_dump() == other.model_dump()

    def __hash__(self) -> int:
        return hash(self.hash)

    @property
    def folder(self) -> Path:
        """The folder of the rig file; calibration files lie in `calibration` beside it."""
        return self._folder

    @property
    def hash(self) -> str:
        """SHA-256 (hex) of everything but the ports, blind to the file's layout, key order and comments.

        A field that says what it would say anyway does not count: a gonio that knows more fields than the
        one that began a session still takes the machine for the same.
        """
        content = _canonical(self.model_dump(mode="json", exclude={"ports"}, exclude_defaults=True))
        return hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode()).hexdigest()

    @property
    def station_joint(self) -> Joint | None:
        """The station wheel, or None for a machine without one."""
        return self.joint(self.arms.station[0]) if self.arms.station else None

    @property
    def arm_joints(self) -> tuple[Joint, ...]:
        """The joints of a pose: all but the station wheel, in the file's order."""
        return tuple(joint for joint in self.joints if joint.name not in self.arms.station)

    def joint(self, name: str) -> Joint:
        """Return the joint of that name.

        Raises
        ------
        BadInput
            There is none.
        """
        return self.joints[self.joint_index(name)]

    def joint_index(self, name: str) -> int:
        """Return the place in `joints` of the joint of that name.

        Raises
        ------
        BadInput
            There is none.
        """
        names = [joint.name for joint in self.joints]
        if name not in names:
            raise BadInput(
                f"no joint is named {name!r}", where="rig", todo=f"the joints are {', '.join(names)}"
            )
        return names.index(name)


def load_rig(
    path: str | Path,
    *,
    servos: str | None = None,
    lamp: str | None = None,
    frames: str | Path | None = None,
) -> Rig:
    """Read a rig file.

    Parameters
    ----------
    path : path
        The TOML file.
    servos, lamp : str, optional
        Serial ports that replace the file's.
    frames : path, optional
        Hot folder that replaces the file's; relative to the working folder, whereas the file's is relative to
        the file.

    Returns
    -------
    Rig
        With an absolute `ports.frames`.

    Raises
    ------
    BadInput
        The file is missing, unreadable, not TOML, or describes no possible machine. One line names file,
        field, value, and what is allowed.
    """
    file = Path(path)
    content = _read_toml(file)
    try:
        rig = Rig.model_validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        raise explain(error, content, Rig, str(file)) from None
    given = {
        "servos": servos,
        "lamp": lamp,
        "frames": None if frames is None else Path(frames).absolute(),
    }
    ports = rig.ports.model_copy(update={field: value for field, value in given.items() if value is not None})
    return _placed(rig.model_copy(update={"ports": ports}), file.absolute().parent)


def dump_rig(rig: Rig, path: str | Path) -> None:
    """Write a rig file that `load_rig` reads back equal.

    Parameters
    ----------
    rig : Rig
    path : path
        Replaced when it exists. A hot folder below the file's folder is written relative, so that both can
        move together.

    Raises
    ------
    BadInput
        The file cannot be written.
    """
    import tomli_w

    file = Path(path)
    content = rig.model_dump(mode="json")
    frames, folder = rig.ports.frames, file.absolute().parent
    if frames.is_absolute() and frames.is_relative_to(folder):
        content["ports"]["frames"] = frames.relative_to(folder).as_posix()
    try:
        file.write_text(tomli_w.dumps(content), encoding="utf-8")
    except OSError as error:
        raise BadInput(
            f"cannot write: {error.strerror}", where=str(file), todo="choose another place"
        ) from None


def default_rig(*, folder: str | Path = ".", **parts: Any) -> Rig:
    """Describe the default machine, which is the twin's: five servos, two arms, turntable, station wheel.

    Its solids suit the distances of lamp and camera; with other joints or arms it has none but those given.

    Parameters
    ----------
    folder : path
        Where the rig file would lie; a relative hot folder lies in it.
    **parts
        Fields of `Rig` that replace the default ones, such as ``camera=Camera(width_px=64, ...)`` or
        ``ports=Ports(servos="/dev/ttyUSB0")``.

    Returns
    -------
    Rig

    Raises
    ------
    pydantic.ValidationError
        The replaced parts describe no possible machine.
    """
    full_turn = (-180.0, 179.9)  # +180 degrees is the tick after the servo's last
    fields: dict[str, Any] = {
        "name": "gonio default",
        "joints": (
            Joint(
                name="light_elevation", id=1, axis=(0.0, 1.0, 0.0), limits_deg=(-85.0, 85.0), park_deg=-45.0
            ),
            Joint(name="camera_azimuth", id=2, axis=(0.0, 0.0, 1.0), limits_deg=full_turn),
            Joint(
                name="camera_elevation", id=3, axis=(0.0, 1.0, 0.0), limits_deg=(-85.0, 85.0), park_deg=45.0
            ),
            Joint(name="turntable", id=4, axis=(0.0, 0.0, 1.0), limits_deg=full_turn),
            Joint(name="station_wheel", id=5, axis=(0.0, 0.0, 1.0), limits_deg=full_turn),
        ),
        "arms": Arms(
            light=("light_elevation",),
            camera=("camera_azimuth", "camera_elevation"),
            sample=("turntable",),
            station=("station_wheel",),
        ),
        "camera": Camera(serial="TWIN-0001"),
        "stations": {
            "white": Station(angle_deg=0.0, kind="white"),
            "trap": Station(angle_deg=72.0, kind="trap"),
            "sample1": Station(angle_deg=144.0, kind="sample"),
            "sample2": Station(angle_deg=-144.0, kind="sample"),
            "sample3": Station(angle_deg=-72.0, kind="sample"),
        },
    }
    fields |= parts
    if not parts.keys() & {"solids", "joints", "arms"}:
        fields["solids"] = default_solids(
            fields.get("lamp", Lamp()), fields["camera"], fields.get("sample", Sample())
        )
    return _placed(Rig(**fields), Path(folder).absolute())


def _placed(rig: Rig, folder: Path) -> Rig:
    """Tell a rig where its file lies, and make its hot folder absolute."""
    ports = rig.ports.model_copy(update={"frames": folder / rig.ports.frames})
    placed = rig.model_copy(update={"ports": ports})
    placed._folder = folder  # noqa: SLF001 - only who reads or makes a rig knows it
    return placed


def _read_toml(file: Path) -> dict[str, Any]:
    try:
        with file.open("rb") as stream:
            text = stream.read(_LARGEST_FILE + 1)
        if len(text) > _LARGEST_FILE:
            raise BadInput(f"larger than {_LARGEST_FILE} bytes", where=str(file), todo="give a rig.toml")
        return tomllib.loads(text.decode("utf-8"))
    except FileNotFoundError:
        raise BadInput("no such rig file", where=str(file), todo="give the path of a rig.toml") from None
    except OSError as error:
        raise BadInput(f"cannot read: {error.strerror}", where=str(file), todo="give a rig.toml") from None
    except UnicodeDecodeError as error:
        raise BadInput(
            f"not UTF-8 at byte {error.start}", where=str(file), todo="save it as UTF-8 text"
        ) from None
    except (ValueError, RecursionError) as error:
        # Besides syntax errors: numbers of thousands of digits, and nesting deeper than any rig.
        raise BadInput(f"not TOML: {error}", where=str(file), todo="mend that line") from None


def _canonical(content: Any) -> Any:
    """Make equal contents equal as text: minus zero is zero."""
    if isinstance(content, dict):
        return {key: _canonical(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_canonical(value) for value in content]
    return content + 0.0 if isinstance(content, float) else content
