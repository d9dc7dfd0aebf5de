"""A new session: a folder with everything that it begins with, complete or not at all."""

from __future__ import annotations

import getpass
import json
import platform
import shutil
import tempfile
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture.exposure import Shutter
from capture.journal import Journal, now
from capture.plan import dump_plan
from capture.session import (
    CALIBRATION_FOLDER,
    FORMAT_VERSION,
    JOURNAL_FILE,
    PLAN_FILE,
    RIG_FILE,
    SESSION_FILE,
    STRAY_FOLDER,
    calibration_hashes,
)
from capture.store import full_disk_in_one_line, sync_file, sync_folder, write_durably
from rig.description import dump_rig
from rig.errors import Refused

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capture.itinerary import Itinerary

CONVENTIONS = {
    "frame": "sample frame: right-handed, +z the normal, +x the sample's mark",
    "directions": "wi to the light, wo to the camera, unit vectors away from the surface",
    "angles": "radians unless a name says deg; joints in the order of rig.toml without the station wheel",
}

_LIBRARIES = ("gonio", "numpy", "bluesky", "dynamixel-sdk", "pyserial", "rawpy")


def create_session(
    out: Path, itinerary: Itinerary, *, rig_file: Path | None, servos: Mapping[str, Any]
) -> None:
    """Make a session folder, complete or not at all.

    Parameters
    ----------
    out : Path
        Where; nothing may be there yet.
    itinerary : Itinerary
        The plan on this machine.
    rig_file : Path, optional
        The file that describes the machine.
    servos : mapping
        What the handshake found, plain values.

    Raises
    ------
    Refused
        Something is there already, or the disk is full.
    """
    require_free(out)
    with full_disk_in_one_line(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
        try:
            _fill(folder, itinerary, rig_file, servos)
            folder.rename(out)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        sync_folder(out.parent)


def _fill(folder: Path, itinerary: Itinerary, rig_file: Path | None, servos: Mapping[str, Any]) -> None:
    """Put everything that a session begins with into an empty folder, and on the disk."""
    folder.chmod(0o755)
    (folder / STRAY_FOLDER).mkdir(parents=True)
    calibration = _copy_calibration(itinerary.rig.folder, folder)
    dump_plan(itinerary.plan, folder / PLAN_FILE)
    dump_rig(itinerary.rig, folder / RIG_FILE)
    facts = _facts(itinerary, rig_file, calibration, servos)
    (folder / SESSION_FILE).write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    with Journal.create(folder / JOURNAL_FILE, itinerary.planned(), itinerary.visits()) as journal:
        journal.note("started", by=facts["operator"])
        refused = itinerary.feasible.counts
        if refused:
            journal.note("refused", reasons=refused)
        for mark in itinerary.feasible.marks:
            journal.note("spoiled", pose=mark.index, reason=mark.reason.value, detail=mark.detail)
    for file in folder.iterdir():
        if file.is_file():
            sync_file(file)
    sync_folder(folder)


def require_free(out: Path) -> None:
    """Pass only if there is nothing at a place.

    Raises
    ------
    Refused
        There is.
    """
    if out.exists():
        raise Refused(
            "something is there already",
            where=str(out),
            todo=f"choose another --out, or go on with gonio capture --resume {out}",
        )


def _copy_calibration(source: Path, folder: Path) -> dict[str, str]:
    (folder / CALIBRATION_FOLDER).mkdir()
    for file in sorted((source / CALIBRATION_FOLDER).glob("*.toml")):
        write_durably(folder / CALIBRATION_FOLDER / file.name, file.read_bytes())
    return calibration_hashes(folder)


def _facts(
    itinerary: Itinerary, rig_file: Path | None, calibration: dict[str, str], servos: Mapping[str, Any]
) -> dict[str, Any]:
    plan, rig = itinerary.plan, itinerary.rig
    path = None if rig_file is None else str(rig_file.absolute())
    return {
        "gonio_session": FORMAT_VERSION,
        "name": plan.name,
        "sample": plan.sample,
        "operator": getpass.getuser(),
        "created": now(),
        "plan": {"hash": plan.hash},
        "rig": {"name": rig.name, "hash": rig.hash, "path": path},
        "calibration": calibration,
        "camera": rig.camera.serial,
        "exposures_s": list(Shutter.of(rig).times_s),
        "servos": dict(servos),
        "versions": {"python": platform.python_version()}
        | {library: metadata.version(library) for library in _LIBRARIES},
        "conventions": CONVENTIONS,
    }
