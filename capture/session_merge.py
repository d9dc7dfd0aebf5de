"""The poses of a session to radiance, one file each: `radiance/sample_0007.npz` and so on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capture.dark import DarkModel
from capture.merge import Merged, merge
from capture.radiance import write_radiance
from capture.raw import read_raw
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from capture.sensor import SensorModel
    from capture.session import PoseRecord, Session

RADIANCE_FOLDER = "radiance"


@dataclass(frozen=True, eq=False)
class PoseMerge:
    """One merged pose.

    Attributes
    ----------
    record : PoseRecord
        Which pose, in which role, of which frames.
    merged : Merged
        Radiance, variance, flags.
    path : Path
        The file written.
    """

    record: PoseRecord
    merged: Merged
    path: Path


def session_dark(session: Session) -> DarkModel | None:
    """Dark model of the session's own darks; None where it has none."""
    frames = [frame for record in session.poses("dark") for frame in record.frames]
    if not frames:
        return None
    return DarkModel.from_frames(
        [frame.checked() for frame in frames], [frame.exposure_s for frame in frames]
    )


def merge_session(session: Session, sensor: SensorModel | None = None) -> Iterator[PoseMerge]:
    """Merge all complete poses of sample and white, with nominal exposure times, and write each.

    The times stay nominal because a fit per pose would put its noise between poses.

    Parameters
    ----------
    session : Session
        An opened session.
    sensor : SensorModel, optional
        Noise model; the session's own by default.

    Yields
    ------
    PoseMerge
        As each is written.

    Raises
    ------
    BadInput
        No complete pose, or frames that are missing, changed, or cannot be merged.
    """
    records = [record for role in ("sample", "white") for record in session.poses(role) if record.frames]
    if not records:
        todo = "capture it first: gonio capture --resume"
        raise BadInput("no complete pose to merge", where=str(session.folder), todo=todo)
    dark = session_dark(session)
    folder = session.folder / RADIANCE_FOLDER
    folder.mkdir(exist_ok=True)
    for record in records:
        lit = sorted((frame for frame in record.frames if frame.lit), key=lambda f: (f.exposure_s, f.shot_id))
        frames = [read_raw(frame.checked()) for frame in lit]
        times = [frame.exposure_s for frame in lit]
        merged = merge(frames, times, dark=dark, sensor=sensor or session.sensor)
        path = folder / f"{record.role}_{record.index:04d}.npz"
        write_radiance(
            path,
            merged,
            exposure_nominal_s=times,
            files=[frame.path.name for frame in frames],
            cfa=frames[0].cfa,
            channels=frames[0].channels,
        )
        yield PoseMerge(record, merged, path)
