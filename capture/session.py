"""A session on disk: everything that one run of a plan recorded, in one folder.

`Session` reads it; nothing here writes frames or talks to hardware. The layout, the journal's tables and the
flags are documented in `docs/session.md`.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture.journal import Journal
from capture.records import Role, ShotState
from rig.errors import BadInput

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator
    from types import TracebackType

    import numpy as np
    from numpy.typing import NDArray

    from capture.plan import Plan
    from capture.records import Event, PlannedPose, PoseFlag, Shot, Visit
    from capture.sensor import SensorModel
    from rig.description import Rig

FORMAT_VERSION = 1

SESSION_FILE, JOURNAL_FILE, PLAN_FILE, RIG_FILE = "session.json", "journal.db", "plan.toml", "rig.toml"
DOCUMENTS_FILE = "documents.jsonl"
FRAMES_FOLDER, STRAY_FOLDER, CALIBRATION_FOLDER = "frames", "frames/stray", "calibration"
GUARD_FOLDER = "frames/guard"

_BLOCK = 1 << 20


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """One verified frame.

    Attributes
    ----------
    path : Path
        Its file.
    shot_id : str
    exposure_s : float
        How long light was collected.
    lit : bool
        Whether the lamp was on.
    sha256 : str
        Of the file's bytes, hex.
    """

    path: Path
    shot_id: str
    exposure_s: float
    lit: bool
    sha256: str

    def checked(self) -> Path:
        """Give the frame's file, once it is proved to be the one recorded.

        Raises
        ------
        BadInput
            It is missing, or its bytes are not those whose hash the journal holds.
        """
        todo = f"restore it, or shoot it again: gonio capture --resume {self.path.parent.parent}"
        try:
            found = hash_file(self.path)
        except OSError as error:
            what = "the frame is missing" if isinstance(error, FileNotFoundError) else str(error.strerror)
            raise BadInput(what, where=str(self.path), todo=todo) from None
        if found != self.sha256:
            what = "the frame has changed since it was recorded (its hash differs)"
            raise BadInput(what, where=str(self.path), todo=todo)
        return self.path


@dataclass(frozen=True, slots=True)
class PoseRecord:
    """One pose in one role, with all its frames.

    Attributes
    ----------
    index : int
        The pose's number in the plan; equal for sample and white of the same pose. For darks 0 is the
        shortest exposure, 1 the longest.
    station : str or None
        What the wheel had brought; None without a wheel.
    role : str
        "sample", "white", "trap" or "dark".
    angles_rad : tuple of float
        Measured angles of `rig.arm_joints`.
    ticks : tuple of int
        Measured positions of all servos, in the order of the rig file.
    frames : tuple of FrameRecord
        In the order in which they were shot.
    flags : PoseFlag
        What they could not reach.
    complete : bool
        Whether the pose counts: all its frames hashed and checked.
    """

    index: int
    station: str | None
    role: str
    angles_rad: tuple[float, ...]
    ticks: tuple[int, ...]
    frames: tuple[FrameRecord, ...]
    flags: PoseFlag
    complete: bool


class Session:
    """A session folder, read only; `Session.open` opens one, and a `with` block closes its journal.

    Attributes
    ----------
    folder : Path
    facts : dict
        Content of `session.json`.
    journal : Journal
        Read only.
    """

    def __init__(self, folder: Path, facts: dict[str, Any], journal: Journal) -> None:
        self.folder, self.facts, self.journal = folder, facts, journal

    @classmethod
    def open(cls, folder: str | Path) -> Session:
        """Open a session for reading, also while it is being captured.

        Parameters
        ----------
        folder : path

        Raises
        ------
        BadInput
            It is no session, or one of another version.
        """
        place = Path(folder)
        return cls(place, read_facts(place), Journal(place / JOURNAL_FILE, read_only=True))

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the journal."""
        self.journal.close()

    @property
    def name(self) -> str:
        """The session's title."""
        return str(self.facts["name"])

    @cached_property
    def rig(self) -> Rig:
        """The machine, from the session's own copy of its file."""
        from rig.description import load_rig

        return load_rig(self.folder / RIG_FILE)

    @cached_property
    def plan(self) -> Plan:
        """The plan, from the session's own copy of its file."""
        from capture.plan import load_plan

        return load_plan(self.folder / PLAN_FILE)

    @cached_property
    def lamp_outputs(self) -> dict[str, float]:
        """Light over what the lamp's level promises, by the shot's ID; those where it was measured.

        See `lamp_outputs`.
        """
        return lamp_outputs(self.folder, self.journal)

    @cached_property
    def sensor(self) -> SensorModel | None:
        """The sensor's calibration, None where the machine had none."""
        return load_session_sensor(self.folder)

    @property
    def hot_pixels(self) -> NDArray[np.bool_] | None:
        """The hot pixels of the sensor's calibration, shape (H, W), None where the machine had no map."""
        from capture.hot_pixels import HOT_PIXELS_FILE, load_hot_pixels

        return load_hot_pixels(self.folder / CALIBRATION_FOLDER / HOT_PIXELS_FILE)

    def edited_files(self) -> list[str]:
        """Names of the session's files that are no longer as the capture left them.

        Those of the machine and its calibration: a person may have meant it, so it is for him to judge.
        """
        changed = changed_calibration(self.folder, self.facts["calibration"])
        edited = [f"{CALIBRATION_FOLDER}/{name}" for name in changed]
        return edited if self.rig.hash == self.facts["rig"]["hash"] else [RIG_FILE, *edited]

    def planned(self) -> list[PlannedPose]:
        """All poses of the expanded plan, refused ones too."""
        return self.journal.poses()

    def poses(self, role: str | None = None, *, complete: bool = True) -> list[PoseRecord]:
        """All poses recorded, in the plan's order, the sample's, the white's, the light trap's, the darks.

        Parameters
        ----------
        role : str, optional
            Only "sample", "white", "trap" or "dark".
        complete : bool
            Only those that count; otherwise also those that the capture has not finished.

        Returns
        -------
        list of PoseRecord
        """
        shots: dict[int, list[Shot]] = {}
        for shot in self.journal.shots():
            if shot.state is ShotState.VERIFIED:
                shots.setdefault(shot.visit, []).append(shot)
        order = [Role.SAMPLE, Role.WHITE, Role.TRAP, Role.DARK]
        visits = [
            visit
            for visit in self.journal.visits()
            if visit.held is not None and role in {None, visit.role} and (visit.done or not complete)
        ]
        visits.sort(key=lambda visit: (order.index(visit.role), visit.pose))
        return [self._record(visit, shots.get(visit.number, [])) for visit in visits]

    def frames_of(self, pose_index: int, role: str) -> list[FrameRecord]:
        """Frames of one pose in one role; none where it does not count (yet)."""
        return [frame for pose in self.poses(role) if pose.index == pose_index for frame in pose.frames]

    def complete(self) -> bool:
        """Whether everything planned has been done."""
        return is_complete(self.journal, self.plan)

    def events(self) -> list[Event]:
        """Interruptions, strays, stops."""
        return self.journal.events()

    def damaged(self) -> list[str]:
        """Check every verified frame's hash.

        Returns
        -------
        list of str
            One line for each file that is missing or changed; empty when all is well.
        """
        faults = []
        for shot in self.journal.shots():
            if shot.state is not ShotState.VERIFIED or shot.path is None:
                continue
            path = self.folder / shot.path
            if not path.is_file():
                faults.append(f"{shot.path} is missing")
            elif hash_file(path) != shot.sha256:
                faults.append(f"{shot.path} has changed")
        return faults

    def _record(self, visit: Visit, shots: list[Shot]) -> PoseRecord:
        if visit.held is None:
            raise BadInput("a pose without its place", where=str(self.folder), todo="restore the session")
        frames = tuple(
            FrameRecord(
                self.folder / (shot.path or ""), shot.shot_id, shot.exposure_s, shot.lit, shot.sha256 or ""
            )
            for shot in shots
        )
        return PoseRecord(
            index=visit.pose,
            station=visit.station,
            role=visit.role.value,
            angles_rad=visit.held.angles_rad,
            ticks=visit.held.ticks,
            frames=frames,
            flags=visit.flags,
            complete=visit.done,
        )


def lamp_outputs(folder: Path, journal: Journal) -> dict[str, float]:
    """Light over what the lamp's level promises, by the shot's ID; those where it was measured.

    From the documents, which hold every frame's; where their end is lost, from the journal's levels, which
    hold that of the last frame of each visit.
    """
    last = {row.visit: row.lamp_output for row in journal.levels()}
    shots = journal.shots()
    found = {shot.shot_id: last.get(shot.visit) for shot in shots if shot.lit}
    for name, document in read_documents(folder / DOCUMENTS_FILE):
        data = document.get("data", {}) if name == "event" else {}
        if data.get("camera_shot_id") in found:
            found[data["camera_shot_id"]] = data.get("camera_lamp_output")
    usable = {shot: value for shot, value in found.items() if isinstance(value, float) and value > 0.0}
    return {shot: value for shot, value in usable.items() if math.isfinite(value)}


def is_complete(journal: Journal, plan: Plan) -> bool:
    """Whether everything planned has been done, darks included.

    Parameters
    ----------
    journal : Journal
    plan : Plan
        The session's.
    """
    visits = journal.visits()
    darks = any(visit.role is Role.DARK for visit in visits)
    return all(visit.done for visit in visits) and (darks or not plan.darks.count)


def read_facts(folder: Path) -> dict[str, Any]:
    """Read `session.json`.

    Raises
    ------
    BadInput
        The folder is no session, or one of another version.
    """
    path = folder / SESSION_FILE
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BadInput(
            "not a session", where=str(folder), todo="give a folder made by gonio capture"
        ) from None
    except (OSError, ValueError) as error:
        raise BadInput(f"unreadable ({error})", where=str(path), todo="restore the session") from None
    if not isinstance(facts, dict) or facts.get("gonio_session") != FORMAT_VERSION:
        raise BadInput("a session of another version", where=str(path), todo="use the gonio that wrote it")
    return facts


def read_documents(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Read a session's documents; lines that a dead process cut short are passed over."""
    if not path.is_file():
        return
    with path.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            try:
                name, document = json.loads(line)
            except ValueError:
                continue
            if isinstance(name, str) and isinstance(document, dict):
                yield name, document


def load_session_sensor(folder: Path) -> SensorModel | None:
    """Read the sensor's calibration below a folder, None where there is none.

    Raises
    ------
    BadInput
        There is one that cannot be used.
    """
    from capture.sensor import load_sensor

    path = folder / CALIBRATION_FOLDER / "sensor.toml"
    return load_sensor(path) if path.is_file() else None


def calibration_hashes(folder: Path) -> dict[str, str]:
    """Hash the calibration files below a folder: name -> SHA-256 (hex)."""
    files = sorted((folder / CALIBRATION_FOLDER).glob("*.toml"))
    return {file.name: hash_file(file) for file in files}


def changed_calibration(folder: Path, hashes: dict[str, str]) -> list[str]:
    """Names of the calibration files below a folder that do not have these hashes, or are gone, or new."""
    found = calibration_hashes(folder)
    return sorted(name for name in found.keys() | hashes.keys() if found.get(name) != hashes.get(name))


def hash_file(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes, hex."""
    digest = hashlib.sha256()
    with Path(path).open("rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()
