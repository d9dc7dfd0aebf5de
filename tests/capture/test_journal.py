"""The journal: what is committed stays, whatever happens next."""

from __future__ import annotations

import os
import sqlite3
import stat
import subprocess
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from capture.journal import Journal
from capture.records import Held, PlannedPose, PoseFlag, Role, Shot, ShotState, Visit
from capture.statistics import ChannelStatistics, FrameStatistics
from rig.errors import BadInput, Refused

if TYPE_CHECKING:
    from pathlib import Path

THIRD = 1.0 / 3.0
POSES = [
    PlannedPose(0, (0.0, 0.0, 1.0), (THIRD, 0.0, 0.9), (0.1, THIRD)),
    PlannedPose(1, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), None, "too close"),
]
VISITS = [
    Visit(0, Role.WHITE, 0, "white", (0.1, THIRD)),
    Visit(1, Role.SAMPLE, 0, "sample1", (0.1, THIRD)),
]
SHOWN = FrameStatistics((ChannelStatistics(THIRD, 2.0, 3.0, 4.0, 0.0),), 7)


def first_shot(frame: int = 1) -> Shot:
    """Return an intent of the first visit."""
    return Shot(f"p-white-0000-{frame}", 0, frame, THIRD, lit=True)


@pytest.fixture
def journal(tmp_path: Path) -> Journal:
    """Return a new journal with two visits."""
    return Journal.create(tmp_path / "journal.db", POSES, VISITS)


def test_a_plan_comes_back_bit_for_bit(journal: Journal) -> None:
    """Would catch angles that lose digits: the resumed arms would go elsewhere."""
    assert journal.poses() == POSES
    assert journal.visits() == VISITS
    assert journal.visits(1) == [VISITS[1]]


def test_a_shot_from_intent_to_verified(journal: Journal) -> None:
    """Would catch a state that is skipped, or a column written to another."""
    journal.hold(0, Held((1, 2, 3), (0.1, THIRD)))
    journal.intend(first_shot())
    assert journal.shots() == [first_shot()]
    journal.file("p-white-0000-1", "frames/a.dng", "ab" * 32)
    assert journal.shots(0)[0].state is ShotState.FILED
    journal.verify("p-white-0000-1", SHOWN)
    shot = journal.shots()[0]
    assert (shot.state, shot.path, shot.sha256) == (ShotState.VERIFIED, "frames/a.dng", "ab" * 32)
    assert shot.statistics == SHOWN
    assert shot.exposure_s == THIRD
    journal.finish(0, PoseFlag.NOISY | PoseFlag.UNDER_RANGE)
    done = journal.visits()[0]
    assert (done.done, done.flags) == (True, PoseFlag.NOISY | PoseFlag.UNDER_RANGE)
    assert done.held == Held((1, 2, 3), (0.1, THIRD))


def test_what_the_plan_knew_of_a_pose_stays(tmp_path: Path) -> None:
    """Would catch a mark that is lost when the pose is done, shot again, or its arms stand elsewhere."""
    visit = replace(VISITS[0], flags=PoseFlag.SHADED)
    journal = Journal.create(tmp_path / "marked.db", POSES, [visit])
    assert journal.visits() == [visit]
    journal.intend(first_shot())
    journal.finish(0, PoseFlag.NOISY)
    assert journal.visits()[0].flags == PoseFlag.SHADED | PoseFlag.NOISY
    journal.withdraw(first_shot())
    assert journal.visits()[0].flags == PoseFlag.SHADED
    journal.finish(0, PoseFlag.OVER_RANGE)
    journal.reopen(0)
    assert journal.visits() == [visit]


def test_an_intent_is_made_once(journal: Journal) -> None:
    """Would catch a lost shot that gets a second row when it is made again."""
    journal.intend(first_shot())
    journal.intend(first_shot())
    assert len(journal.shots()) == 1


def test_a_withdrawn_shot_takes_later_frames_with_it(journal: Journal) -> None:
    """Would catch frames kept whose exposures were chosen from one that is gone."""
    for frame in (1, 2, 3):
        journal.intend(first_shot(frame))
        journal.file(f"p-white-0000-{frame}", "x", "y")
        journal.verify(f"p-white-0000-{frame}", SHOWN)
    journal.finish(0, PoseFlag(0))
    journal.withdraw(journal.shots()[1])
    assert [(s.frame, s.state) for s in journal.shots()] == [(1, ShotState.VERIFIED), (2, ShotState.INTENT)]
    assert not journal.visits()[0].done


def test_what_is_committed_outlives_kill_9(journal: Journal) -> None:
    """Would catch a commit that waits in memory: the process dies right after it."""
    script = (
        "import os, sys; from pathlib import Path; from capture.journal import Journal\n"
        "j = Journal(Path(sys.argv[1])); j.note('started', by='me'); os.kill(os.getpid(), 9)"
    )
    ended = subprocess.run([sys.executable, "-c", script, str(journal.path)], check=False)
    assert ended.returncode == -9
    assert [(event.kind, event.detail) for event in journal.events()] == [("started", {"by": "me"})]


def test_every_commit_reaches_the_disk(journal: Journal) -> None:
    """Would catch SQLite's faster settings, which lose the last commits when the power fails."""
    connection = journal._connection
    assert connection.execute("PRAGMA synchronous").fetchone() == (2,)
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_a_torn_log_holds_whole_changes(journal: Journal, tmp_path: Path) -> None:
    """Would catch half a change after a power failure within a write, or a whole one lost."""

    def content(path: Path) -> Any:
        with Journal(path) as opened:
            return opened.visits(), opened.shots(), opened.events()

    journal.close()
    start = journal.path.read_bytes()
    states = [content(journal.path)]
    with Journal(journal.path) as writer:
        writer._connection.execute("PRAGMA wal_autocheckpoint = 0")
        for change in (
            lambda: writer.hold(0, Held((1, 2, 3), (0.1, THIRD))),
            lambda: writer.intend(first_shot()),
            lambda: writer.note("retry", text="x" * 9000),  # several pages
            lambda: writer.file("p-white-0000-1", "x", "y"),
            lambda: writer.finish(0, PoseFlag(0)),
        ):
            change()
            states.append((writer.visits(), writer.shots(), writer.events()))
        log = journal.path.with_name("journal.db-wal").read_bytes()
    page = int.from_bytes(log[8:12], "big")
    frames = range(32, len(log), 24 + page)
    ends = [at + 24 + page for at in frames if int.from_bytes(log[at + 4 : at + 8], "big")]
    assert len(ends) == len(states) - 1
    torn = tmp_path / "torn" / "journal.db"
    torn.parent.mkdir()
    for at in frames:
        for cut in (at, at + 1, at + 24, at + 24 + page // 2, at + 23 + page, at + 24 + page):
            for tail in (b"", b"\xee" * (len(log) - cut)):
                torn.with_name("journal.db-shm").unlink(missing_ok=True)
                torn.write_bytes(start)
                torn.with_name("journal.db-wal").write_bytes(log[:cut] + tail)
                assert content(torn) == states[sum(end <= cut for end in ends)]


def test_a_failed_change_changes_nothing(journal: Journal) -> None:
    """Would catch half a change: the first of two rows stays although the second failed."""
    good = Visit(2, Role.DARK, 0, None, ())
    with pytest.raises(sqlite3.IntegrityError):
        journal.add_visits([good, Visit(0, Role.DARK, 1, None, ())])
    assert journal.visits() == VISITS


def test_a_full_disk_is_one_line_and_loses_nothing(journal: Journal) -> None:
    """Would catch a traceback, or a journal that cannot be read after the disk was full."""
    journal.intend(first_shot())
    pages = journal._connection.execute("PRAGMA page_count").fetchone()[0]
    journal._connection.execute(f"PRAGMA max_page_count = {pages}")

    def note_on() -> None:
        for number in range(1000):
            journal.note("stray", text="x" * 500, number=number)

    with pytest.raises(Refused, match=r"disk is full.*--resume"):
        note_on()
    noted = len(journal.events())
    journal.close()
    with Journal(journal.path) as again:
        assert len(again.events()) == noted
        assert again.shots() == [first_shot()]
        again.note("resumed")


def test_reading_beside_the_writer(journal: Journal) -> None:
    """Would catch a reader that blocks the capture, or does not see its latest commit."""
    with Journal(journal.path, read_only=True) as reader:
        journal.intend(first_shot())
        assert reader.shots() == [first_shot()]
        with pytest.raises((BadInput, Refused)):
            reader.note("never")


@pytest.mark.skipif(
    sys.platform == "win32" or os.geteuid() == 0, reason="needs folders that cannot be written"
)
def test_reading_on_a_read_only_disk(journal: Journal) -> None:
    """Would catch a session on a read-only disk that cannot be reduced."""
    journal.intend(first_shot())
    journal.close()
    folder = journal.path.parent
    folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        with Journal(journal.path, read_only=True) as reader:
            assert reader.shots() == [first_shot()]
    finally:
        folder.chmod(stat.S_IRWXU)


@pytest.mark.parametrize("content", [b"", b"not a database at all" * 100])
def test_a_file_that_is_no_journal(tmp_path: Path, content: bytes) -> None:
    """Would catch a traceback of SQLite's for a damaged file."""
    file = tmp_path / "journal.db"
    file.write_bytes(content)
    with pytest.raises(BadInput, match=r"journal\.db"):
        Journal(file)
    with pytest.raises(BadInput, match="no journal"):
        Journal(tmp_path / "none.db")


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE poses SET wi = 'x'",
        "UPDATE visits SET angles_rad = '[1, \"x\"]'",
        "UPDATE visits SET flags = 'x'",
        "UPDATE events SET detail = '{'",
        "UPDATE shots SET statistics = '[]'",
        'UPDATE shots SET statistics = \'{"channels": [{"a": 1}]}\'',
    ],
)
def test_rubbish_in_a_row_is_one_line(journal: Journal, damage: str) -> None:
    """Would catch a traceback where the file is sound and a text in it is not."""
    journal.note("started")
    journal.intend(first_shot())
    journal._connection.execute(damage)
    with pytest.raises(BadInput, match="not a readable journal"):
        (journal.poses(), journal.visits(), journal.shots(), journal.events())


def test_a_damaged_page_is_one_line(journal: Journal) -> None:
    """Would catch a traceback where the file opens and a table behind its first page is rubbish."""
    for number in range(200):
        journal.note("filler", text="x" * 200, number=number)
    journal.close()
    content = bytearray(journal.path.read_bytes())
    content[4096:] = b"\xee" * (len(content) - 4096)
    journal.path.write_bytes(content)
    with Journal(journal.path, read_only=True) as damaged, pytest.raises(BadInput, match="not a readable"):
        damaged.events()
