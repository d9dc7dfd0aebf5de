"""Deaths by SIGKILL at every step of a capture and of a resume: the session ends as if nobody had died."""

from __future__ import annotations

import inspect
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from capture.journal import Journal
from capture.session import Session

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from simulator.twin import Twin

PLAN = {
    "plan": {"name": "brass", "sample": "sample1"},
    "darks": {"count": 1},
    "trap": {"every": 2},
    "poses": [{"kind": "sweep", "theta_i_deg": [30], "theta_o_deg": [0, 30]}],
}

REFERENCED = PLAN | {"references": {"max_interval_s": 1e-6}}
"""References are due before every pose that comes after one."""

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs fork and SIGKILL")


class Mortal:
    """Captures and resumes in processes that may die; see `mortal`."""

    def __init__(self, twin: Twin, folder: Path) -> None:
        self.folder, self._twin = folder, twin
        self._numbers = itertools.count()
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("mortal.py"))],
            env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def live(
        self, session: Path, last: int | None = None, *, plan: dict[str, Any] = PLAN
    ) -> tuple[int, list[str]]:
        """Capture into a session, or resume it; return the exit code and the steps taken."""
        steps = self.folder / "steps.txt"
        request = {
            "session": str(session), "rig": self._twin.rig, "plan": plan, "steps": str(steps), "last": last,
        }  # fmt: skip
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline()), steps.read_text().splitlines()

    def place(self) -> Path:
        """Return where a new session may go."""
        return self.folder / f"session-{next(self._numbers)}"

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


@pytest.fixture(scope="module")
def mortal(twin: Twin, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mortal]:
    """Return what captures and dies."""
    running = Mortal(twin, tmp_path_factory.mktemp("mortal"))
    yield running
    running.close()


@pytest.fixture(scope="module")
def capture_steps(mortal: Mortal) -> tuple[Path, list[str]]:
    """Return an uninterrupted session and its steps."""
    session = mortal.place()
    code, steps = mortal.live(session)
    assert code == 0
    return session, steps


@pytest.fixture(scope="module")
def damaged(mortal: Mortal, capture_steps: tuple[Path, list[str]], twin: Twin) -> Callable[[], Path]:
    """Return a maker of sessions in which every kind of mending is needed."""

    def make() -> Path:
        session = mortal.place()
        shutil.copytree(capture_steps[0], session)
        with Journal(session / "journal.db") as journal:
            lost, moved, filed, arrived = (
                next(shot for shot in journal.shots() if shot.visit == visit) for visit in range(4)
            )
            (session / str(lost.path)).unlink()
            with journal._change() as change:
                change.execute("DROP TABLE levels")  # as in a session of the first version
                change.execute("UPDATE visits SET held_ticks = '[1,2,3,4,5]', done = 0 WHERE visit = 1")
                change.execute("UPDATE visits SET done = 0 WHERE visit IN (2, 3)")
                change.execute("UPDATE shots SET state = 'filed', statistics = NULL WHERE visit IN (2, 3)")
        hot = Path(twin.frames)
        shutil.move(session / str(arrived.path), hot / "arrived.dng")
        shutil.copy(session / str(moved.path), hot / "original.dng")
        (session / "frames" / f".{Path(str(filed.path)).name}.part").write_bytes(b"torn")
        return session

    return make


@pytest.fixture(scope="module")
def resume_steps(mortal: Mortal, damaged: Callable[[], Path]) -> list[str]:
    """Return the steps of a resume that has everything to mend."""
    code, steps = mortal.live(damaged())
    assert code == 0
    return steps


def facts_of(session: Path) -> dict[str, Any]:
    """Return all of a session that must not depend on how often it was interrupted."""
    with Session.open(session) as opened:
        assert opened.complete()
        assert opened.damaged() == []
        journal = opened.journal
        shots = [(s.shot_id, s.visit, s.frame, s.exposure_s, s.path, s.sha256) for s in journal.shots()]
        statistics = [s.statistics for s in journal.shots()]
        frames = sorted(path.name for path in (session / "frames").glob("*.dng"))
        return {"visits": journal.visits(), "shots": shots, "statistics": statistics, "frames": frames}


def die_and_go_on(
    mortal: Mortal, session: Path, number: int, wanted: dict[str, Any], *, plan: dict[str, Any] = PLAN
) -> None:
    """Die at a step, go on, and compare with who never died."""
    code, steps = mortal.live(session, number, plan=plan)
    assert code == -signal.SIGKILL
    code, _ = mortal.live(session)
    assert code == 0, f"cannot go on after {steps[-1]}"
    assert facts_of(session) == wanted, f"differs after {steps[-1]}"
    shutil.rmtree(session)


def once_each(steps: list[str]) -> list[int]:
    """Pick one step of each name: the one in the middle of those that share it."""
    places: dict[str, list[int]] = {}
    for number, step in enumerate(steps):
        places.setdefault(step, []).append(number)
    return sorted(numbers[len(numbers) // 2] for numbers in places.values())


def test_every_line_of_the_protocol_is_a_step(
    capture_steps: tuple[Path, list[str]], resume_steps: list[str]
) -> None:
    """Would catch a change of the journal, added later, at which nobody has died yet."""
    changes = {
        name
        for name, method in inspect.getmembers(Journal)
        if inspect.isfunction(inspect.unwrap(getattr(method, "__func__", method)))
        and "_change" in getattr(method, "__func__", method).__code__.co_names
    }
    assert {"create", "hold", "intend", "file", "verify", "finish", "withdraw", "reopen"} <= changes
    steps = set(capture_steps[1] + resume_steps)
    for name, when in itertools.product(changes, ("before", "after")):
        assert f"journal.{name}: COMMIT, {when}" in steps


def essential(steps: list[str]) -> list[int]:
    """Pick, of each name, what tells most: around commits of a running session, after file steps."""
    running = ("journal.", "store.take", "store.set_aside", "devices._shoot")
    beginning = ("journal.create", "journal.add_visits", "journal.note")
    return [
        number
        for number in once_each(steps)
        if steps[number].startswith(running)
        and not steps[number].startswith(beginning)
        and ("COMMIT" in steps[number] or steps[number].endswith(("replace, after", "shoot, after")))
    ]


def test_a_death_around_each_commit_of_a_capture(
    mortal: Mortal, capture_steps: tuple[Path, list[str]]
) -> None:
    """Would catch a resumed session that differs from an uninterrupted one by a single bit."""
    wanted = facts_of(capture_steps[0])
    for number in essential(capture_steps[1]):
        die_and_go_on(mortal, mortal.place(), number, wanted)


def test_a_death_around_each_commit_of_a_resume(
    mortal: Mortal,
    capture_steps: tuple[Path, list[str]],
    damaged: Callable[[], Path],
    resume_steps: list[str],
) -> None:
    """Would catch mending that, cut short, leaves worse than it found."""
    wanted, known = facts_of(capture_steps[0]), set(capture_steps[1])
    for number in essential(resume_steps):
        if resume_steps[number] not in known:
            die_and_go_on(mortal, damaged(), number, wanted)


def test_a_death_in_a_reference(mortal: Mortal) -> None:
    """Would catch a frame of a reference that ends among the samples', or one that nobody can go on after."""
    session = mortal.place()
    code, steps = mortal.live(session, plan=REFERENCED)
    assert code == 0
    with Session.open(session) as opened:
        told = [event.detail["role"] for event in opened.events() if event.kind == "reference"]
    assert set(told) == {"white", "dark", "trap"}
    wanted = facts_of(session)
    kept = [n for n in once_each(steps) if "keep_guard" in steps[n] and steps[n].endswith("replace, after")]
    assert kept
    for number in kept:
        die_and_go_on(mortal, mortal.place(), number, wanted, plan=REFERENCED)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_death_at_every_single_step(mortal: Mortal, capture_steps: tuple[Path, list[str]]) -> None:
    """Would catch a step that is safe at one frame and not at another: the first, the last, a pass's end."""
    wanted = facts_of(capture_steps[0])
    for number in range(len(capture_steps[1])):
        die_and_go_on(mortal, mortal.place(), number, wanted)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_death_at_every_single_step_of_a_resume(
    mortal: Mortal,
    capture_steps: tuple[Path, list[str]],
    damaged: Callable[[], Path],
    resume_steps: list[str],
) -> None:
    """Would catch mending that is safe at one frame and not at another."""
    wanted = facts_of(capture_steps[0])
    for number in range(len(resume_steps)):
        die_and_go_on(mortal, damaged(), number, wanted)
