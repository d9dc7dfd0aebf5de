"""The writing side of a session: taking frames in so that no death of the process loses any.

A frame's way: its name and hash are journalled, then a copy takes that name with everything on the disk
(written aside, synced, renamed), then it is journalled as verified, and only then the file in the hot folder
goes. After a death `Store.recover` finds each frame before, between or after these steps.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
from typing import TYPE_CHECKING

from capture.journal import Journal, disk_full
from capture.records import Role, Shot, ShotState, Visit
from capture.session import (
    FRAMES_FOLDER,
    GUARD_FOLDER,
    SESSION_FILE,
    STRAY_FOLDER,
    hash_file,
    read_facts,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from capture.statistics import FrameStatistics

    Examine = Callable[[Path, Visit], FrameStatistics]

PARTIAL_SUFFIX = ".part"

CLOCK_SLACK_S = 5.0
"""How much older than the session a file of it may read: other clocks, coarse file systems."""


class Store:
    """Takes frames into a session.

    Parameters
    ----------
    folder : Path
        Of the session.
    journal : Journal
    """

    def __init__(self, folder: Path, journal: Journal) -> None:
        self.folder, self.journal = folder, journal

    def take(self, shot: Shot, visit: Visit, arrived: Path, statistics: FrameStatistics) -> Shot:
        """Take a checked frame out of the hot folder.

        Parameters
        ----------
        shot : Shot
            Its intent.
        visit : Visit
            Where it belongs.
        arrived : Path
            Its file.
        statistics : FrameStatistics
            What it shows.

        Returns
        -------
        Shot
            Verified.

        Raises
        ------
        Refused
            The disk is full; the file stays where it arrived.
        """
        with full_disk_in_one_line(self.folder):
            data = arrived.read_bytes()
            sha256 = hashlib.sha256(data).hexdigest()
            path = frame_path(visit, shot.frame, arrived.suffix)
            self.journal.file(shot.shot_id, path, sha256)
            write_durably(self.folder / path, data)
            self.journal.verify(shot.shot_id, statistics)
            arrived.unlink(missing_ok=True)
        return Shot(
            shot.shot_id,
            shot.visit,
            shot.frame,
            shot.exposure_s,
            shot.lit,
            ShotState.VERIFIED,
            path,
            sha256,
            statistics,
        )

    def keep_guard(self, arrived: Path, name: str) -> tuple[str, str]:
        """Take a frame that only guards the session out of the hot folder.

        Parameters
        ----------
        arrived : Path
            Its file.
        name : str
            Of the shot.

        Returns
        -------
        path : str
            Below the session's folder.
        sha256 : str

        Raises
        ------
        Refused
            The disk is full; the file stays where it arrived.
        """
        with full_disk_in_one_line(self.folder):
            (self.folder / GUARD_FOLDER).mkdir(exist_ok=True)
            data = arrived.read_bytes()
            path = f"{GUARD_FOLDER}/{name}{arrived.suffix.lower()}"
            write_durably(self.folder / path, data)
            arrived.unlink(missing_ok=True)
        return path, hashlib.sha256(data).hexdigest()

    def set_aside(self, path: Path, reason: str) -> None:
        """Move a file that is not the picture waited for to `frames/stray/`, and say why in the journal."""
        target = self.folder / STRAY_FOLDER / path.name
        number = 1
        while target.exists():
            number += 1
            target = self.folder / STRAY_FOLDER / f"{path.stem}-{number}{path.suffix}"
        with full_disk_in_one_line(self.folder):
            try:
                path.rename(target)
            except FileNotFoundError:
                return  # its owner took it back
            except OSError as error:
                if error.errno != errno.EXDEV:
                    raise
                write_durably(target, path.read_bytes())
                path.unlink()
        self.journal.note("stray", file=path.name, reason=reason, kept=f"{STRAY_FOLDER}/{target.name}")

    def recover(self, hot_folder: Path, shot_of: Callable[[Path], str | None], examine: Examine) -> None:
        """Mend what a death left behind: no verified frame is lost, nothing unproved counts.

        Parameters
        ----------
        hot_folder : Path
            Where the camera's files arrive.
        shot_of : callable
            Path -> the shot's ID that a file carries, None where it carries none or does not decode.
        examine : callable
            (path, visit) -> what a frame shows; raises `BadInput` where it does not decode.
        """
        for left in (self.folder / FRAMES_FOLDER).rglob(f".*{PARTIAL_SUFFIX}"):
            left.unlink()
        visits = {visit.number: visit for visit in self.journal.visits()}
        arrivals = self._arrivals(hot_folder, shot_of)
        lost: set[int] = set()
        for shot in self.journal.shots():
            if shot.visit in lost:
                self._forget(shot)
            elif shot.state is not ShotState.INTENT and not self._mend(
                shot, visits[shot.visit], arrivals.get(shot.shot_id, []), examine
            ):
                lost.add(shot.visit)
        verified = {s.shot_id: s.sha256 for s in self.journal.shots() if s.state is ShotState.VERIFIED}
        for shot_id, files in arrivals.items():
            for file in files:
                if not file.exists():
                    continue
                if hash_file(file) == verified.get(shot_id):
                    file.unlink()  # the original of a frame that is safely here
                else:
                    self.set_aside(file, f"of shot {shot_id}, lost when the capture ended")

    def _mend(self, shot: Shot, visit: Visit, arrivals: list[Path], examine: Examine) -> bool:
        """Bring a filed or verified shot in order; False where it must be made again."""
        path = self.folder / (shot.path or "")
        if path.is_file() and hash_file(path) == shot.sha256:
            if shot.state is ShotState.FILED:
                self.journal.verify(shot.shot_id, examine(path, visit))
            return True
        for file in arrivals:
            if file.exists() and hash_file(file) == shot.sha256:
                self.take(shot, visit, file, examine(file, visit))
                return True
        self._forget(shot)
        self.journal.withdraw(shot)
        self.journal.note("withdrawn", shot_id=shot.shot_id, file=shot.path)
        return False

    def _forget(self, shot: Shot) -> None:
        path = self.folder / (shot.path or "")
        if shot.path and path.is_file():
            self.set_aside(path, f"of shot {shot.shot_id}, which is made again")

    def _arrivals(self, hot_folder: Path, shot_of: Callable[[Path], str | None]) -> dict[str, list[Path]]:
        """Files in the hot folder, newer than the session, with the name of one of its shots or guards."""
        known = {shot.shot_id for shot in self.journal.shots()}
        guards = guard_series(read_facts(self.folder)["plan"]["hash"], "")
        begun_s = (self.folder / SESSION_FILE).stat().st_mtime - CLOCK_SLACK_S
        found: dict[str, list[Path]] = {}
        for file in sorted(hot_folder.iterdir()):
            if file.name.startswith(".") or not file.is_file() or file.stat().st_mtime < begun_s:
                continue
            shot_id = shot_of(file)
            if shot_id is not None and (shot_id in known or shot_id.startswith(guards)):
                found.setdefault(shot_id, []).append(file)
        return found


def frame_path(visit: Visit, frame: int, suffix: str) -> str:
    """Place of a frame below the session's folder."""
    return f"{FRAMES_FOLDER}/{visit.role}-{visit.pose:04d}-{frame}{suffix.lower()}"


def shot_id(plan_hash: str, role: Role, pose: int, frame: int) -> str:
    """Name of a shot: the same in every run of the same plan, and in no other plan."""
    return f"{plan_hash[:8]}-{role}-{pose:04d}-{frame}"


def guard_series(plan_hash: str, series: str | int) -> str:
    """Begin the names of the shots of one comparison with a reference pose; no other shots begin so."""
    return f"{plan_hash[:8]}-guard-{series}"


def write_durably(path: Path, data: bytes) -> None:
    """Write a file that is on the disk, whole and under its name, when this returns, or not there at all."""
    aside = path.with_name(f".{path.name}{PARTIAL_SUFFIX}")
    try:
        with aside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        aside.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            aside.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_file(path: Path) -> None:
    """Bring a file's content to the disk."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Bring a folder's names to the disk, where the system lets a folder be opened."""
    with contextlib.suppress(PermissionError):  # Windows does not, and keeps names by itself
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextlib.contextmanager
def full_disk_in_one_line(folder: Path) -> Iterator[None]:
    """Turn a full disk into one line that says how to go on."""
    try:
        yield
    except OSError as error:
        if error.errno in {errno.ENOSPC, errno.EDQUOT}:
            raise disk_full(folder) from error
        raise
