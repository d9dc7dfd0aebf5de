"""The poses of a session to radiance, one file each: `radiance/sample_0007.npz` and so on."""

from __future__ import annotations

import logging
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING

from capture.bracket_checks import (
    is_all_clipped,
    refuse_foreign_calibration,
    refuse_foreign_darks,
    refuse_foreign_frame,
    refuse_light_in_darks,
)
from capture.dark import DarkModel, subtrahend, with_hot_pixels
from capture.frames import as_stack
from capture.merge import Merged, merge_stack
from capture.radiance import write_radiance
from capture.raw import RawFrame, RawHead, read_raw
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from capture.sensor import SensorModel
    from capture.session import PoseRecord, Session

_LOG = logging.getLogger("gonio.capture.session_merge")

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


@dataclass(frozen=True, eq=False)
class RecordMerge:
    """The merged frames of one record.

    Attributes
    ----------
    frames : tuple of RawFrame
        By ascending exposure.
    exposure_s : tuple of float
        Their nominal exposure times.
    merged : Merged
        Radiance, variance, flags.
    """

    frames: tuple[RawFrame, ...]
    exposure_s: tuple[float, ...]
    merged: Merged


class SessionMerger:
    """Merges the records of a session, with its darks, its calibration, and all checks of a bracket.

    Parameters
    ----------
    session : Session
        An opened session.
    sensor : SensorModel, optional
        Noise model; the session's own by default.
    """

    def __init__(self, session: Session, sensor: SensorModel | None = None) -> None:
        self._session = session
        self._sensor = sensor or session.sensor
        self._hot = session.hot_pixels
        self._first: RawHead | None = None
        self._looked_for_light: set[str] = set()
        self._dark_heads: list[RawHead] = []

    @cached_property
    def dark(self) -> DarkModel | None:
        """Dark model of the session's own darks; None where it has none."""
        records = [frame for record in self._session.poses("dark") for frame in record.frames]
        if not records:
            return None
        frames = (self._noted(read_raw(frame.checked()), frame.exposure_s) for frame in records)
        return DarkModel.from_frames(frames, [frame.exposure_s for frame in records])

    def _noted(self, frame: RawFrame, exposure_s: float) -> RawFrame:
        """Keep what a dark frame says of itself, without its counts."""
        head = RawHead(**{item.name: getattr(frame, item.name) for item in fields(RawHead)})
        self._dark_heads.append(replace(head, exposure_s=exposure_s))
        return frame

    def merge(self, record: PoseRecord) -> RecordMerge:
        """Merge the lit frames of a record, with nominal exposure times.

        Raises
        ------
        BadInput
            A frame is missing, changed, damaged, of another camera or setting than the session's others or
            than the sensor's calibration, or the darks are, or hold light.
        """
        lit = sorted((frame for frame in record.frames if frame.lit), key=lambda f: (f.exposure_s, f.shot_id))
        frames = tuple(read_raw(frame.checked()) for frame in lit)
        times = tuple(frame.exposure_s for frame in lit)
        stack = as_stack(frames, times)
        self._first = self._first or frames[0]
        refuse_foreign_frame(self._first, frames[0])
        if self._sensor is not None:
            refuse_foreign_calibration(self._sensor, frames[0])
        levels = with_hot_pixels(subtrahend(self.dark, stack, self._sensor), self._hot, stack)
        if self.dark is not None and record.role in {"sample", "white"} - self._looked_for_light:
            self._looked_for_light.add(record.role)
            refuse_foreign_darks(frames, self._dark_heads)
            refuse_light_in_darks(self.dark, stack, self._dark_heads)
        merged = merge_stack(stack, levels, self._sensor)
        if is_all_clipped(merged):
            what = f"every pixel of {record.role} pose {record.index} is clipped in every frame"
            _LOG.warning("%s: nothing of it is used; plan shorter exposures for it", what)
        return RecordMerge(frames, times, merged)


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
    merger = SessionMerger(session, sensor)
    folder = session.folder / RADIANCE_FOLDER
    folder.mkdir(exist_ok=True)
    for record in records:
        done = merger.merge(record)
        path = folder / f"{record.role}_{record.index:04d}.npz"
        write_radiance(
            path,
            done.merged,
            exposure_nominal_s=done.exposure_s,
            files=[frame.path.name for frame in done.frames],
            cfa=done.frames[0].cfa,
            channels=done.frames[0].channels,
        )
        yield PoseMerge(record, done.merged, path)
