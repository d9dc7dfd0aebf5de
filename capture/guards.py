"""What must hold before a capture starts or goes on: enough disk; the same plan, machine, calibration."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture.plan import Plan, load_plan
from capture.session import CALIBRATION_FOLDER, PLAN_FILE, RIG_FILE, changed_calibration
from rig.description import Rig, load_rig
from rig.errors import Refused

if TYPE_CHECKING:
    from collections.abc import Sequence

DISK_MARGIN = 1.5
"""Free space over the predicted size below which a capture does not start."""


def same_plan(folder: Path, facts: dict[str, Any], given: str | Path | None) -> Plan:
    """Load a session's plan and make sure that it is still the one it began with.

    Parameters
    ----------
    folder : Path
        Of the session.
    facts : dict
        Its `session.json`.
    given : path, optional
        A plan that must be the same.

    Raises
    ------
    Refused
        It is not.
    """
    plan = load_plan(folder / PLAN_FILE)
    if plan.hash != facts["plan"]["hash"]:
        raise Refused(
            "the session's plan was changed after it began",
            where=str(folder / PLAN_FILE),
            todo="put back the plan as it was, or begin a new session",
        )
    if given is not None and load_plan(given).hash != plan.hash:
        raise Refused(
            "not the session's plan",
            where=str(given),
            todo=f"resume with {folder / PLAN_FILE}, or begin a new session",
        )
    return plan


def same_rig(folder: Path, facts: dict[str, Any], given: str | Path | None, ports: dict[str, Any]) -> Rig:
    """Load the machine and make sure that it is the session's, but for its ports.

    Parameters
    ----------
    folder : Path
        Of the session.
    facts : dict
        Its `session.json`.
    given : path, optional
        The machine's file; by default where it was when the session began.
    ports : dict
        Ports and hot folder that replace the file's, as `load_rig` takes them.

    Raises
    ------
    Refused
        The machine's description or its calibration has changed, or its file is gone.
    """
    copy = load_rig(folder / RIG_FILE)
    file = Path(given or facts["rig"]["path"] or folder / RIG_FILE)
    if not file.is_file():
        raise Refused(
            "the machine's file is gone", where=str(file), todo="say where it is now with --rig FILE"
        )
    rig = load_rig(file, **ports)
    for described, where in ((copy, folder / RIG_FILE), (rig, file)):
        if described.hash != facts["rig"]["hash"]:
            raise Refused(
                "the machine is not the session's: its description has changed",
                where=str(where),
                todo="put it back as it was, or begin a new session",
            )
    for place in (rig.folder, folder):
        _require_same_calibration(place, facts["calibration"])
    filled = {name: getattr(rig.ports, name) or getattr(copy.ports, name) for name in ("servos", "lamp")}
    return rig.model_copy(update={"ports": rig.ports.model_copy(update=filled)})


def same_exposures(folder: Path, facts: dict[str, Any], times_s: Sequence[float]) -> None:
    """Make sure that exposures are still chosen from the times that the session began with.

    Parameters
    ----------
    folder : Path
        Of the session.
    facts : dict
        Its `session.json`; one of an older gonio does not name the times.
    times_s : sequence of float
        What they would be chosen from now.

    Raises
    ------
    Refused
        They are others.
    """
    if facts.get("exposures_s", list(times_s)) != list(times_s):
        raise Refused(
            "exposures would be chosen from other times than when the session began",
            where=str(folder),
            todo="go on with the gonio that began it, or begin a new session",
        )


def _require_same_calibration(place: Path, wanted: dict[str, str]) -> None:
    changed = changed_calibration(place, wanted)
    if changed:
        raise Refused(
            f"the calibration has changed since the session began: {', '.join(changed)}",
            where=str(place / CALIBRATION_FOLDER),
            todo="put it back, or begin a new session",
        )


def require_disk(out: Path, needed: int) -> None:
    """Make sure that a session will fit.

    Parameters
    ----------
    out : Path
        Where it will be.
    needed : int
        Its predicted size in bytes.

    Raises
    ------
    Refused
        It will not, with some margin.
    """
    place = next(parent for parent in out.absolute().parents if parent.is_dir())
    free = shutil.disk_usage(place).free
    if free < needed * DISK_MARGIN:
        raise Refused(
            f"{free / 1e6:.1f} MB free, {needed * DISK_MARGIN / 1e6:.1f} MB needed with a margin",
            where=str(place),
            todo="free some space, or choose another disk",
        )
