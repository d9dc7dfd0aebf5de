"""Sessions on disk: made whole or not at all, read back, mended after any death."""

from __future__ import annotations

import errno
import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from capture import creation
from capture import store as store_module
from capture.creation import create_session
from capture.itinerary import lay_out
from capture.journal import Journal
from capture.records import Held, PoseFlag, Role, Shot, ShotState
from capture.session import JOURNAL_FILE, Session
from capture.statistics import ChannelStatistics, FrameStatistics
from capture.store import Store, frame_path, shot_id, write_durably
from rig.errors import BadInput, Refused

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from capture.plan import Plan
    from capture.records import Visit
    from rig.description import Rig

SHOWN = FrameStatistics((ChannelStatistics(1.0, 2.0, 3.0, 4.0, 0.0),), 7)


class Bench:
    """A session and a hot folder whose files carry their shot's ID as their first line."""

    def __init__(self, folder: Path, hot: Path, plan: Plan) -> None:
        self.folder, self.hot, self.plan = folder, hot, plan
        self.journal = Journal(folder / JOURNAL_FILE)
        self.store = Store(folder, self.journal)

    def visit(self, number: int = 0) -> Visit:
        self.journal.hold(number, Held((1, 2, 3, 4, 5), (0.1, 0.2, 0.3, 0.4)))
        return self.journal.visits(number)[0]

    def shot(self, visit: Visit, frame: int = 1) -> Shot:
        name = shot_id(self.plan.hash, visit.role, visit.pose, frame)
        shot = Shot(name, visit.number, frame, 0.5, lit=True)
        self.journal.intend(shot)
        return shot

    def arrive(self, shot: Shot, text: str = "picture", name: str = "0001.DNG") -> Path:
        path = self.hot / name
        path.write_text(f"{shot.shot_id}\n{text}")
        return path

    def recover(self) -> None:
        self.store.recover(
            self.hot, lambda path: path.read_text().split("\n")[0] or None, lambda _path, _visit: SHOWN
        )

    def kinds(self) -> list[str]:
        return [event.kind for event in self.journal.events()]


@pytest.fixture
def bench(tmp_path: Path, default_rig: Rig, make_plan: Callable[..., Plan]) -> Iterator[Bench]:
    """Return a new session with its hot folder."""
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "sensor.toml").write_text(
        "gain_dn_per_e = 0.5\nread_noise_dn = 1.5\nclip_dn = 15000.0\n"
    )
    hot = tmp_path / "hot"
    hot.mkdir()
    plan = make_plan()
    out = tmp_path / "session"
    create_session(out, lay_out(plan, default_rig), rig_file=tmp_path / "rig.toml", servos={"a": {"id": 1}})
    made = Bench(out, hot, plan)
    yield made
    made.journal.close()


def test_a_new_session_holds_plan_machine_and_calibration(bench: Bench, default_rig: Rig) -> None:
    """Would catch a session that cannot be reduced without the machine's own files."""
    with Session.open(bench.folder) as session:
        assert session.plan == bench.plan
        assert session.rig.hash == default_rig.hash
        assert session.sensor is not None
        assert session.sensor.gain_dn_per_e == 0.5
        assert session.name == "brass"
        assert len(session.planned()) == 3
        assert session.poses() == []
        assert not session.complete()
        file = bench.folder / "calibration" / "sensor.toml"
        assert session.facts["calibration"] == {"sensor.toml": hashlib.sha256(file.read_bytes()).hexdigest()}
        assert session.facts["plan"]["hash"] == bench.plan.hash


def test_what_a_person_edits_in_a_session_is_named(bench: Bench) -> None:
    """Would catch another gain, or another machine, than the capture's, used without a word."""
    for edited, name, change in (
        (["calibration/sensor.toml"], "calibration/sensor.toml", ("0.5", "0.6")),
        (["rig.toml", "calibration/sensor.toml"], "rig.toml", ("rho = 0.99", "rho = 0.98")),
    ):
        with Session.open(bench.folder) as session:
            assert name not in session.edited_files()
        file = bench.folder / name
        assert change[0] in file.read_text()
        file.write_text(file.read_text().replace(*change, 1))
        with Session.open(bench.folder) as session:
            assert session.edited_files() == edited


def test_a_session_appears_whole_or_not_at_all(
    tmp_path: Path, default_rig: Rig, make_plan: Callable[..., Plan], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch half a session that neither resumes nor makes room for a new one."""

    def full(*_args: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(creation, "dump_rig", full)
    with pytest.raises(Refused, match="disk is full"):
        create_session(tmp_path / "s", lay_out(make_plan(), default_rig), rig_file=None, servos={})
    assert list(tmp_path.iterdir()) == []


def test_an_existing_place_is_refused(bench: Bench, default_rig: Rig) -> None:
    """Would catch a second capture that writes over the first."""
    with pytest.raises(Refused, match="--resume"):
        create_session(bench.folder, lay_out(bench.plan, default_rig), rig_file=None, servos={})


def test_a_frame_is_taken_with_its_hash(bench: Bench) -> None:
    """Would catch a frame that is recorded with another file's hash, or left in the hot folder."""
    visit = bench.visit()
    arrived = bench.arrive(bench.shot(visit))
    data = arrived.read_bytes()
    taken = bench.store.take(bench.journal.shots()[0], visit, arrived, SHOWN)
    bench.journal.finish(visit.number, PoseFlag.NOISY)
    assert not arrived.exists()
    assert taken.path == f"frames/white-{visit.pose:04d}-1.dng"
    with Session.open(bench.folder) as session:
        (pose,) = session.poses()
        assert (pose.role, pose.station, pose.index, pose.flags) == ("white", "white", visit.pose, 4)
        assert pose.angles_rad == (0.1, 0.2, 0.3, 0.4)
        assert pose.ticks == (1, 2, 3, 4, 5)
        (frame,) = session.frames_of(visit.pose, "white")
        assert frame.path.read_bytes() == data
        assert frame.sha256 == hashlib.sha256(data).hexdigest()
        assert session.damaged() == []
        frame.path.write_bytes(data[:-1])
        assert session.damaged() == [f"{taken.path} has changed"]
        frame.path.unlink()
        assert session.damaged() == [f"{taken.path} is missing"]


def test_poses_that_do_not_count_are_not_shown(bench: Bench) -> None:
    """Would catch a pose reduced while its bracket is still being shot."""
    visit = bench.visit()
    bench.store.take(bench.shot(visit), visit, bench.arrive(bench.journal.shots()[0]), SHOWN)
    with Session.open(bench.folder) as session:
        assert session.poses() == []
        assert len(session.poses(complete=False)) == 1


STEPS = ["file", "write_durably", "verify", "unlink"]


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
def test_death_at_any_step_of_taking(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, step: str, after: bool
) -> None:
    """Would catch a death between two steps that loses the frame, doubles it, or counts what is not there."""
    visit = bench.visit()
    shot = bench.shot(visit)
    arrived = bench.arrive(shot)
    data = arrived.read_bytes()
    owner = {"write_durably": store_module, "unlink": Path}.get(step, Journal)

    class Killed(BaseException):
        pass

    real = getattr(owner, step)

    def die(*args: object, **options: object) -> None:
        if after:
            real(*args, **options)
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(owner, step, die)
        with pytest.raises(Killed):
            bench.store.take(shot, visit, arrived, SHOWN)
    bench.recover()
    (found,) = bench.journal.shots()
    strays = list((bench.folder / "frames" / "stray").iterdir())
    assert not arrived.exists()
    if step == "file" and not after:
        # Nothing proves that this file is the frame: it is kept aside and the shot made again.
        assert found.state is ShotState.INTENT
        assert [stray.read_bytes() for stray in strays] == [data]
        bench.store.take(shot, visit, bench.arrive(shot), SHOWN)
        (found,) = bench.journal.shots()
    else:
        assert strays == []
    assert found.state is ShotState.VERIFIED
    assert found.path is not None
    assert (bench.folder / found.path).read_bytes() == data
    assert found.sha256 == hashlib.sha256(data).hexdigest()
    assert not list((bench.folder / "frames").glob("*.part"))


def test_a_full_disk_keeps_the_frame_where_it_arrived(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch a frame lost because there was no room for its copy."""
    visit = bench.visit()
    shot = bench.shot(visit)
    arrived = bench.arrive(shot)

    def full(_handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
        with pytest.raises(Refused, match=r"disk is full.*--resume"):
            bench.store.take(shot, visit, arrived, SHOWN)
    assert arrived.exists()
    bench.recover()
    assert bench.journal.shots()[0].state is ShotState.VERIFIED
    assert bench.kinds().count("stray") == 0


def test_a_torn_copy_is_made_good_or_made_again(bench: Bench) -> None:
    """Would catch a truncated frame that counts because its name is there."""
    visit = bench.visit()
    shot = bench.shot(visit)
    bench.journal.file(shot.shot_id, frame_path(visit, 1, ".dng"), "ab" * 32)
    write_durably(bench.folder / frame_path(visit, 1, ".dng"), b"half")
    bench.recover()
    assert bench.journal.shots()[0].state is ShotState.INTENT
    assert "withdrawn" in bench.kinds()
    kept = list((bench.folder / "frames" / "stray").iterdir())
    assert [file.read_bytes() for file in kept] == [b"half"]


def test_a_lost_first_frame_is_followed_by_all_after_it(bench: Bench) -> None:
    """Would catch two files under one shot's name after the first of three went missing."""
    visit = bench.visit()
    for frame in (1, 2):
        shot = bench.shot(visit, frame)
        bench.store.take(shot, visit, bench.arrive(shot, f"picture {frame}"), SHOWN)
    bench.journal.finish(visit.number, PoseFlag(0))
    (bench.folder / frame_path(visit, 1, ".dng")).unlink()
    bench.recover()
    assert [(s.frame, s.state) for s in bench.journal.shots()] == [(1, ShotState.INTENT)]
    assert not bench.journal.visits(visit.number)[0].done
    assert not (bench.folder / frame_path(visit, 2, ".dng")).exists()
    assert len(list((bench.folder / "frames" / "stray").iterdir())) == 1


@pytest.mark.parametrize("harm", [b"", b"half", b"Picture"])
def test_a_frame_that_changed_later_is_neither_used_nor_kept(bench: Bench, harm: bytes) -> None:
    """Would catch a frame that is reduced, or counts after a resume, with bytes that were never shot."""
    visit = bench.visit()
    shot = bench.shot(visit)
    bench.store.take(shot, visit, bench.arrive(shot, "picture"), SHOWN)
    bench.journal.finish(visit.number, PoseFlag(0))
    with Session.open(bench.folder) as session:
        (frame,) = session.frames_of(visit.pose, "white")
        assert frame.checked() == frame.path
        frame.path.write_bytes(harm)
        with pytest.raises(BadInput, match=r"has changed.*--resume"):
            frame.checked()
        frame.path.unlink()
        with pytest.raises(BadInput, match=r"is missing.*--resume"):
            frame.checked()
        frame.path.write_bytes(harm)
    bench.recover()
    assert bench.journal.shots()[0].state is ShotState.INTENT
    assert not bench.journal.visits(visit.number)[0].done


def test_files_of_others_in_the_hot_folder_stay(bench: Bench) -> None:
    """Would catch a resume that clears away somebody's holiday pictures."""
    foreign = bench.hot / "IMG_0001.dng"
    foreign.write_text("no shot of ours\n")
    bench.recover()
    assert foreign.exists()


def test_strays_never_write_over_each_other(bench: Bench) -> None:
    """Would catch the second file of one name that replaces the first."""
    for number in range(3):
        path = bench.hot / "a.dng"
        path.write_text(f"\n{number}")
        bench.store.set_aside(path, "for a test")
    kept = sorted(file.read_text() for file in (bench.folder / "frames" / "stray").iterdir())
    assert kept == ["\n0", "\n1", "\n2"]
    noted = [event.detail["kept"] for event in bench.journal.events() if event.kind == "stray"]
    assert len(set(noted)) == 3


def test_shot_names_fit_the_lamp_controller(bench: Bench) -> None:
    """Would catch a name that the controller refuses in the middle of a night."""
    name = shot_id(bench.plan.hash, Role.SAMPLE, 99_999, 16)
    assert len(name) <= 40
    assert set(name) <= set("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-")


@pytest.mark.parametrize("content", [None, "{", "[]", json.dumps({"gonio_session": 99})])
def test_a_folder_that_is_no_session(tmp_path: Path, content: str | None) -> None:
    """Would catch a traceback for a folder that is empty, damaged or from the future."""
    if content is not None:
        (tmp_path / "session.json").write_text(content)
    with pytest.raises(BadInput):
        Session.open(tmp_path)
