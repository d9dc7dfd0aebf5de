"""A session's journal: one SQLite file, the single truth of what was planned, shot and verified.

Each step is committed and on the disk (WAL, `synchronous=FULL`) before the next one starts: the intent before
the shutter opens, the file's name and hash before the file takes that name, its statistics when it is there.
So a process that dies anywhere leaves either a verified frame or an intent to shoot again. The tables are
documented in `docs/session.md`.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
import threading
import time
from typing import TYPE_CHECKING, Any, TypeVar

from capture.journal_schema import ADDED, SCHEMA, SCHEMA_VERSION
from capture.records import (
    SPOILED,
    Event,
    Held,
    LevelsRecord,
    PlannedPose,
    PoseFlag,
    Role,
    Shot,
    ShotState,
    Visit,
)
from capture.statistics import FrameStatistics
from rig.errors import BadInput, Refused

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path
    from types import TracebackType

Record = TypeVar("Record")


class Journal:
    """An open journal. Any thread may call any method.

    Parameters
    ----------
    path : Path
        An existing journal; `Journal.create` makes one.
    read_only : bool
        Whether to refuse every change; a session on a read-only disk can be read.

    Raises
    ------
    BadInput
        The file is not there, or is no journal that this version reads.
    """

    def __init__(self, path: Path, *, read_only: bool = False) -> None:
        if not path.is_file():
            raise BadInput("no journal here", where=str(path), todo="give the folder of a session")
        self.path = path
        self._lock = threading.RLock()
        try:
            self._connection = _connect(path, "ro" if read_only else "rw")
            version = self._connection.execute("PRAGMA user_version").fetchone()[0]
        except sqlite3.Error as error:
            raise _unreadable(path, error) from None
        if version != SCHEMA_VERSION:
            self._connection.close()
            raise BadInput(
                f"journal of version {version}, this gonio reads {SCHEMA_VERSION}",
                where=str(path),
                todo="use the gonio that wrote it",
            )
        known = {name for (name,) in self._connection.execute("SELECT name FROM sqlite_master")}
        self._has_levels = "levels" in known
        if not read_only and not self._has_levels:
            with self._change() as change:
                change.execute(ADDED)
            self._has_levels = True

    @classmethod
    def create(cls, path: Path, poses: Sequence[PlannedPose], visits: Sequence[Visit]) -> Journal:
        """Make a journal with its plan in it, and open it.

        Raises
        ------
        Refused
            The disk is full.
        """
        connection = _connect(path, "rwc")
        with contextlib.closing(connection), _one_line(path):
            connection.execute("PRAGMA journal_mode=WAL")
            connection.executescript(SCHEMA)
        journal = cls(path)
        with journal._change() as change:
            change.executemany(
                "INSERT INTO poses VALUES (?, ?, ?, ?, ?)",
                [(p.index, _text(p.wi), _text(p.wo), _text(p.angles_rad), p.refused) for p in poses],
            )
        journal.add_visits(visits)
        return journal

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; a second time does nothing."""
        with self._lock:
            self._connection.close()

    def poses(self) -> list[PlannedPose]:
        """All poses of the expanded plan, refused ones too."""
        return self._read(
            lambda pose, wi, wo, angles, refused: PlannedPose(
                pose, _floats(wi), _floats(wo), _floats(angles) if angles else None, refused
            ),
            "SELECT pose, wi, wo, angles_rad, refused FROM poses ORDER BY pose",
        )

    def visits(self, number: int | None = None) -> list[Visit]:
        """All visits in the session's order, or the one of that number."""
        return self._read(
            lambda number, role, pose, station, angles, ticks, held, flags, done: Visit(
                number,
                Role(role),
                pose,
                station,
                _floats(angles),
                Held(tuple(json.loads(ticks)), _floats(held)) if ticks else None,
                PoseFlag(flags),
                bool(done),
            ),
            "SELECT visit, role, pose, station, angles_rad, held_ticks, held_rad, flags, done "
            "FROM visits WHERE ?1 IS NULL OR visit = ?1 ORDER BY visit",
            (number,),
        )

    def shots(self, visit: int | None = None) -> list[Shot]:
        """All shots, or those of one visit, in the order of visits and frames."""
        return self._read(
            lambda shot_id, number, frame, exposure_s, lit, state, path, sha256, statistics: Shot(
                shot_id,
                number,
                frame,
                exposure_s,
                bool(lit),
                ShotState(state),
                path,
                sha256,
                FrameStatistics.from_json(statistics) if statistics else None,
            ),
            "SELECT shot_id, visit, frame, exposure_s, lit, state, path, sha256, statistics FROM shots "
            "WHERE ?1 IS NULL OR visit = ?1 ORDER BY visit, frame",
            (visit,),
        )

    def events(self) -> list[Event]:
        """Everything that happened, in order."""
        return self._read(
            lambda moment, kind, detail: Event(moment, kind, json.loads(detail)),
            "SELECT time, kind, detail FROM events ORDER BY event",
        )

    def levels(self) -> list[LevelsRecord]:
        """All levels logged, in order; none in a session from before they were."""
        if not self._has_levels:
            return []
        return self._read(
            lambda moment, visit, temperature, voltage, current, load, lamp_deg_c, output, drift: (
                LevelsRecord(
                    visit,
                    _floats(temperature),
                    _floats(voltage),
                    tuple(json.loads(current)),
                    _floats(load),
                    lamp_deg_c,
                    output,
                    drift,
                    moment,
                )
            ),
            "SELECT time, visit, temperature_deg_c, voltage_v, current_ma, load, lamp_deg_c, lamp_output, "
            "lamp_drift FROM levels ORDER BY level",
        )

    def first_lamp_output(self) -> float | None:
        """Light of the session's first lit pose over what the lamp's level promises; None before it."""
        if not self._has_levels:
            return None
        query = "SELECT lamp_output FROM levels WHERE lamp_output IS NOT NULL ORDER BY level LIMIT 1"
        return next(iter(self._read(float, query)), None)

    def camera(self) -> tuple[str | None, str | None] | None:
        """Tell serial number and model of the camera of the session's frames; None before the first."""
        found = [event.detail for event in self.events() if event.kind == "camera"]
        return (found[0].get("serial"), found[0].get("model")) if found else None

    def add_visits(self, visits: Sequence[Visit]) -> None:
        """Add planned visits; one that is there already, by role and pose, stays as it is."""
        with self._change() as change:
            change.executemany(
                "INSERT INTO visits (visit, role, pose, station, angles_rad, flags) "
                "VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT (role, pose) DO NOTHING",
                [
                    (v.number, v.role.value, v.pose, v.station, _text(v.angles_rad), int(v.flags))
                    for v in visits
                ],
            )

    def hold(self, visit: int, held: Held) -> None:
        """Record where the arms stand for a visit."""
        with self._change() as change:
            change.execute(
                "UPDATE visits SET held_ticks = ?, held_rad = ? WHERE visit = ?",
                (_text(held.ticks), _text(held.angles_rad), visit),
            )

    def intend(self, shot: Shot) -> None:
        """Record a shot before it is made; again under the same ID when it was lost."""
        with self._change() as change:
            change.execute(
                "INSERT INTO shots (shot_id, visit, frame, exposure_s, lit, state, time) "
                "VALUES (?, ?, ?, ?, ?, 'intent', ?) "
                "ON CONFLICT (shot_id) DO UPDATE SET exposure_s = excluded.exposure_s, time = excluded.time",
                (shot.shot_id, shot.visit, shot.frame, shot.exposure_s, int(shot.lit), now()),
            )

    def file(self, shot_id: str, path: str, sha256: str) -> None:
        """Record which file, with which content, is about to take its place."""
        with self._change() as change:
            change.execute(
                "UPDATE shots SET state = 'filed', path = ?, sha256 = ?, time = ? WHERE shot_id = ?",
                (path, sha256, now(), shot_id),
            )

    def verify(self, shot_id: str, statistics: FrameStatistics) -> None:
        """Record that a filed shot is in its place and checked, and what it shows."""
        with self._change() as change:
            change.execute(
                "UPDATE shots SET state = 'verified', statistics = ?, time = ? WHERE shot_id = ?",
                (statistics.to_json(), now(), shot_id),
            )

    def withdraw(self, shot: Shot) -> None:
        """Put a shot back to its intent, because its file is not what was recorded.

        Its visit counts no more, and the frames after it are forgotten: their exposures were chosen from it.
        """
        with self._change() as change:
            change.execute("DELETE FROM shots WHERE visit = ? AND frame > ?", (shot.visit, shot.frame))
            change.execute(
                "UPDATE shots SET state = 'intent', path = NULL, sha256 = NULL, statistics = NULL, time = ? "
                "WHERE shot_id = ?",
                (now(), shot.shot_id),
            )
            change.execute(
                "UPDATE visits SET flags = flags & ?, done = 0 WHERE visit = ?", (int(SPOILED), shot.visit)
            )

    def reopen(self, visit: int) -> None:
        """Forget a visit's shots and place, because the arms no longer stand where they stood."""
        with self._change() as change:
            change.execute("DELETE FROM shots WHERE visit = ?", (visit,))
            change.execute(
                "UPDATE visits SET held_ticks = NULL, held_rad = NULL, flags = flags & ?, done = 0 "
                "WHERE visit = ?",
                (int(SPOILED), visit),
            )

    def finish(self, visit: int, flags: PoseFlag) -> None:
        """Record that all frames of a visit are hashed and checked, and what they could not reach."""
        with self._change() as change:
            change.execute(
                "UPDATE visits SET flags = (flags & ?) | ?, done = 1 WHERE visit = ?",
                (int(SPOILED), int(flags), visit),
            )

    def log_levels(self, levels: LevelsRecord) -> None:
        """Record the levels at the end of a visit."""
        with self._change() as change:
            change.execute(
                "INSERT INTO levels (time, visit, temperature_deg_c, voltage_v, current_ma, load, "
                "lamp_deg_c, lamp_output, lamp_drift) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    now(),
                    levels.visit,
                    _text(levels.temperature_deg_c),
                    _text(levels.voltage_v),
                    json.dumps(levels.current_ma),
                    _text(levels.load),
                    levels.lamp_deg_c,
                    levels.lamp_output,
                    levels.lamp_drift,
                ),
            )

    def note(self, kind: str, **detail: Any) -> None:
        """Record an event."""
        with self._change() as change:
            change.execute(
                "INSERT INTO events (time, kind, detail) VALUES (?, ?, ?)",
                (now(), kind, json.dumps(detail, default=str)),
            )

    def _read(self, make: Callable[..., Record], query: str, values: tuple[Any, ...] = ()) -> list[Record]:
        """Make a record of each row that a query finds; rows that hold rubbish are a damaged journal."""
        with self._lock, _one_line(self.path):
            rows = self._connection.execute(query, values).fetchall()
        try:
            return [make(*row) for row in rows]
        except (ValueError, KeyError, TypeError) as error:
            raise _unreadable(self.path, error) from error

    @contextlib.contextmanager
    def _change(self) -> Iterator[sqlite3.Connection]:
        """Commit one change as a whole, on the disk when this returns, or change nothing."""
        with self._lock, _one_line(self.path):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                with contextlib.suppress(sqlite3.Error):  # a full disk has rolled back already
                    self._connection.execute("ROLLBACK")
                raise


def now() -> str:
    """Return the time in UTC, ISO 8601 with milliseconds."""
    seconds = time.time()
    return f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(seconds))}.{int(seconds % 1 * 1000):03d}Z"


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    connection = sqlite3.connect(
        f"{path.absolute().as_uri()}?mode={mode}", uri=True, isolation_level=None, check_same_thread=False
    )
    if mode == "ro":
        try:
            connection.execute("PRAGMA schema_version")
        except sqlite3.OperationalError:
            # On a read-only disk WAL's side files cannot be made; nobody can be writing there either.
            connection.close()
            uri = f"{path.absolute().as_uri()}?immutable=1"
            return sqlite3.connect(uri, uri=True, isolation_level=None, check_same_thread=False)
    else:
        connection.execute("PRAGMA synchronous=FULL")
        connection.execute("PRAGMA foreign_keys=ON")
    return connection


@contextlib.contextmanager
def _one_line(path: Path) -> Iterator[None]:
    """Say a full disk, or a damaged file, in one line; everything committed stays."""
    try:
        yield
    except sqlite3.IntegrityError:
        raise  # a step out of order: our own fault, not the file's
    except sqlite3.OperationalError as error:
        if "full" not in str(error) and "I/O" not in str(error):
            raise BadInput(
                f"the journal cannot be used ({error})",
                where=str(path),
                todo="check its disk and permissions",
            ) from error
        raise disk_full(path.parent) from error
    except sqlite3.DatabaseError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> BadInput:
    return BadInput(f"not a readable journal ({error})", where=str(path), todo="restore the session")


def disk_full(folder: Path) -> Refused:
    """Return the error of a session whose disk is full; what was recorded stays."""
    return Refused(
        "the disk is full; nothing recorded is lost",
        where=str(folder),
        todo=f"free some space, then gonio capture --resume {folder}",
    )


def _text(numbers: Sequence[float] | None) -> str | None:
    return None if numbers is None else json.dumps(list(numbers))


def _floats(text: str) -> tuple[float, ...]:
    return tuple(float(number) for number in json.loads(text))
