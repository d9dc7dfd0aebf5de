"""`gonio plan` and `gonio capture` as a person runs them: one line, JSON, signals, kill -9, `rig stop`."""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import pytest

from capture.journal import Journal
from capture.session import Session
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

pytestmark = pytest.mark.render

WATCHDOG_S = 2.0
LATE_S = 1.0
"""What a loaded machine may add to a deadline."""

GOAL_WRITES = ("037400", "837400")
"""Write and sync write to the goal position, address 116, as a packet's instruction and parameters begin."""


def gonio(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(
        [sys.executable, "-m", "gonio.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        stdin=subprocess.DEVNULL,
    )


def start(*arguments: str | Path) -> subprocess.Popen[str]:
    """Start a capture in the background."""
    return subprocess.Popen(
        [sys.executable, "-m", "gonio.cli", "capture", *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_until(
    condition: Callable[[], bool], process: subprocess.Popen[str], timeout_s: float = 60.0
) -> None:
    """Wait for something that a running capture brings about."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)


def verified(session: Path) -> int:
    """Count a session's verified frames; 0 before it exists."""
    if not (session / "journal.db").exists():
        return 0
    with Journal(session / "journal.db", read_only=True) as journal:
        return sum(shot.sha256 is not None for shot in journal.shots())


def facts_of(session: Path) -> dict[str, Any]:
    """Return all of a session that must not depend on how often it was interrupted."""
    with Journal(session / "journal.db", read_only=True) as journal:
        shots = [(s.shot_id, s.exposure_s, s.path, s.sha256, s.statistics) for s in journal.shots()]
        return {"visits": journal.visits(), "shots": shots}


def lights(twin: Twin) -> list[tuple[float, bool]]:
    """Return when the light went on and off."""
    return [(e["t"], bool(e["on"])) for e in twin.wire_log() if e.get("event") == "light"]


def exposing(twin: Twin) -> bool:
    """Tell whether the shutter is open."""
    edges = [event["open"] for event in twin.wire_log() if event.get("event") == "shutter"]
    return bool(edges and edges[-1])


def sent(twin: Twin, line: str, after_s: float) -> list[str]:
    """Return what reached a line after a moment, as hex."""
    return [
        event["data"]
        for event in twin.wire_log()
        if event["line"] == line and event.get("direction") == "in" and event["t"] > after_s
    ]


def assert_stopped_on_the_wire(twin: Twin, since_s: float) -> None:
    """Check the bytes: light off, then every servo told to stay."""
    assert b"OUTP OFF".hex() in "".join(sent(twin, "lamp", since_s))
    assert not lights(twin)[-1][1]
    packets = "".join(sent(twin, "servos", since_s))
    assert any(write in packets for write in GOAL_WRITES)


@pytest.fixture(scope="module")
def twin() -> Iterator[Twin]:
    """Return a twin that is fast enough for whole captures."""
    with Twin({"sample1": "cook-torrance:kd=0.1,ks=0.5,m=0.2,ior=1.5"}, seed=3, speed=40.0) as running:
        yield running


@pytest.fixture(scope="module")
def slow_twin() -> Iterator[Twin]:
    """Return a twin whose exposures last long enough to be interrupted."""
    with Twin({"sample1": "lambert:kd=0.5"}, speed=4.0) as running:
        yield running


@pytest.fixture(scope="module")
def plan(twin: Twin, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a plan of eight poses."""
    out = tmp_path_factory.mktemp("plan") / "plan.toml"
    angles = ("--theta-i-deg", "20,50", "--theta-o-deg", "0:60:20", "--phi-deg", "90,180")
    made = gonio("plan", "grid", *angles, "--rig", twin.rig, "--out", out, "--darks", "1", "--json")
    assert made.returncode == 0, made.stderr
    facts = json.loads(made.stdout)
    assert facts["poses"] == 14
    assert facts["repeats"] == 2
    assert facts["duration_s"] > facts["travel_s"] > 0
    return out


@pytest.fixture(scope="module")
def reference(twin: Twin, plan: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an uninterrupted session of that plan."""
    out = tmp_path_factory.mktemp("reference") / "s"
    made = gonio("capture", plan, "--rig", twin.rig, "--out", out, "--json")
    assert made.returncode == 0, made.stderr
    facts = json.loads(made.stdout)
    assert facts["complete"] is True
    assert facts["poses"] == 14
    assert facts["stop"] == "confirmed"
    return out


def test_kill_9_three_times_and_on(twin: Twin, plan: Path, reference: Path, tmp_path: Path) -> None:
    """Would catch a light that stays on, a lost pose, and a single bit that an interruption changes."""
    from analysis.reduce import reduce_session

    out = tmp_path / "s"
    moments = random.Random(20)  # noqa: S311 - moments, not secrets
    total = verified(reference)
    for attempt in range(3):
        arguments = (plan, "--rig", twin.rig, "--out", out) if attempt == 0 else ("--resume", out)
        process = start(*arguments)
        enough = total * (attempt + 1) // 5
        wait_until(lambda least=enough: verified(out) >= least, process)
        time.sleep(moments.uniform(0.0, 0.1))
        process.kill()
        process.communicate()
        killed_s = time.monotonic()
        while lights(twin)[-1][1]:
            assert time.monotonic() < killed_s + WATCHDOG_S + LATE_S
            time.sleep(0.02)
    resumed = gonio("capture", "--resume", out, "--json")
    assert resumed.returncode == 0, resumed.stderr
    assert json.loads(resumed.stdout)["complete"] is True
    assert facts_of(out) == facts_of(reference)
    with Session.open(out) as session, Session.open(reference) as whole:
        assert session.damaged() == []
        assert [pose.index for pose in session.poses("sample")] == list(range(14))
        assert reduce_session(session).identical(reduce_session(whole))


def test_ctrl_c_finishes_the_frame(twin: Twin, plan: Path, reference: Path, tmp_path: Path) -> None:
    """Would catch a Ctrl-C that loses the frame under way, leaves the light on, or cannot be resumed."""
    out = tmp_path / "s"
    process = start(plan, "--rig", twin.rig, "--out", out, "--json")
    wait_until(lambda: verified(out) >= 3, process)
    since_s = time.monotonic()
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=30)
    assert process.returncode == 130, stderr
    assert f"gonio capture --resume {out}" in stderr
    assert json.loads(stdout)["complete"] is False
    assert_stopped_on_the_wire(twin, since_s)
    with Journal(out / "journal.db", read_only=True) as journal:
        assert all(shot.sha256 is not None for shot in journal.shots())
        assert "interrupted" in [event.kind for event in journal.events()]
    assert gonio("capture", "--resume", out).returncode == 0
    assert facts_of(out) == facts_of(reference)


@pytest.fixture
def long_plan(slow_twin: Twin, tmp_path: Path) -> Path:
    """Return a plan whose first exposure lasts half a minute on the slow twin."""
    out = tmp_path / "plan.toml"
    angles = ("--theta-i-deg", "20", "--theta-o-deg", "20,40")
    made = gonio("plan", "sweep", *angles, "--rig", slow_twin.rig, "--out", out, "--first-s", "60")
    assert made.returncode == 0, made.stderr
    return out


@pytest.mark.parametrize(
    ("signals", "code"),
    [([signal.SIGINT, signal.SIGINT], 130), ([signal.SIGTERM], 143)],
    ids=["Ctrl-C twice", "SIGTERM"],
)
def test_an_abort_stops_within_the_exposure(
    slow_twin: Twin, long_plan: Path, tmp_path: Path, signals: list[signal.Signals], code: int
) -> None:
    """Would catch an abort that waits for the exposure's end, or leaves light or arms as they are."""
    out = tmp_path / "s"
    process = start(long_plan, "--rig", slow_twin.rig, "--out", out)
    wait_until(lambda: exposing(slow_twin), process)
    since_s = time.monotonic()
    for number in signals:
        process.send_signal(number)
        time.sleep(0.2)
    _, stderr = process.communicate(timeout=10)
    assert process.returncode == code, stderr
    assert "Traceback" not in stderr
    assert f"gonio capture --resume {out}" in stderr
    assert_stopped_on_the_wire(slow_twin, since_s)
    with Session.open(out) as session:
        assert not session.complete()
        assert [event.kind for event in session.events()][-1] == "stopped"
        assert session.events()[-1].detail["outcome"] == "confirmed"


def test_rig_stop_from_another_terminal(slow_twin: Twin, long_plan: Path, tmp_path: Path) -> None:
    """Would catch a stop that the capture ignores, or one after which nobody knows how to go on."""
    out = tmp_path / "s"
    process = start(long_plan, "--rig", slow_twin.rig, "--out", out)
    wait_until(lambda: exposing(slow_twin), process)
    since_s = time.monotonic()
    stop = gonio("rig", "stop", "--rig", slow_twin.rig, "--json")
    assert stop.returncode == 0, stop.stderr
    assert json.loads(stop.stdout)["outcome"] == "confirmed"
    _, stderr = process.communicate(timeout=10)
    assert process.returncode == 3, stderr
    assert len(stderr.strip().splitlines()) == 1
    assert "stopped" in stderr
    assert f"gonio capture --resume {out}" in stderr
    assert_stopped_on_the_wire(slow_twin, since_s)
    with Session.open(out) as session:
        assert not session.complete()


def test_an_existing_session_is_refused(twin: Twin, plan: Path, reference: Path) -> None:
    """Would catch a capture that begins again over a night's work."""
    before = facts_of(reference)
    again = gonio("capture", plan, "--rig", twin.rig, "--out", reference)
    assert again.returncode == 3
    assert "--resume" in again.stderr
    assert facts_of(reference) == before


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["capture"], 2, "for example: gonio capture plan.toml"),
        (["capture", "nope.toml", "--rig", "RIG", "--out", "s"], 2, "nope.toml"),
        (["capture", "PLAN", "--rig", "nope.toml", "--out", "s"], 2, "nope.toml: no such rig file"),
        (["capture", "PLAN", "--rig", "RIG", "--servos", "/dev/nope", "--out", "s"], 4, "/dev/nope"),
        (["capture", "PLAN", "--rig", "RIG", "--lamp", "/dev/nope", "--out", "s"], 4, "/dev/nope"),
        (["capture", "PLAN", "--rig", "RIG", "--frames", "nope", "--out", "s"], 2, "no such folder"),
        (["capture", "PLAN", "--rig", "RIG", "--mounted", "black", "--out", "s"], 2, "'black'"),
        (["capture", "--resume", "nope"], 2, "not a session"),
        (["plan", "sweep", "--theta-i-deg", "x", "--theta-o-deg", "0", "--rig", "RIG"], 2, "'x' is no angle"),
        (
            ["plan", "sweep", "--theta-i-deg", "0:9", "--theta-o-deg", "0", "--rig", "RIG"],
            2,
            "first:last:step",
        ),
        (["plan", "sweep", "--theta-i-deg", "30", "--theta-o-deg", "-30", "--rig", "RIG"], 3, "deg apart"),
        (["plan", "show", "nope.toml", "--rig", "RIG"], 2, "nope.toml"),
        (["plan", "csv", "nope.csv", "--rig", "RIG"], 2, "nope.csv"),
    ],
)
def test_mistakes_are_one_line(  # noqa: PLR0917 - fixtures
    twin: Twin, plan: Path, tmp_path: Path, arguments: list[str], code: int, said: str
) -> None:
    """Would catch a traceback, a wrong exit code, and a session or a plan left behind by a mistake."""
    real = {"RIG": twin.rig, "PLAN": str(plan), "s": str(tmp_path / "s")}
    where = ["--out", str(tmp_path / "p.toml")] if arguments[0] == "plan" and arguments[1] != "show" else []
    ended = gonio(*[real.get(argument, argument) for argument in arguments], *where)
    assert ended.returncode == code, ended.stderr
    lines = ended.stderr.strip().splitlines()
    assert len(lines) == 1
    assert said in lines[0]
    assert ended.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_refused_poses_are_told_and_left_out(twin: Twin, tmp_path: Path) -> None:
    """Would catch poses that disappear between the plan and the session."""
    table = tmp_path / "poses.csv"
    table.write_text("theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg\n30,0,30,180\n30,0,32,0\n")
    strict = gonio("plan", "csv", table, "--rig", twin.rig, "--out", tmp_path / "p.toml")
    assert strict.returncode == 3
    assert "theta_o 32.00" in strict.stderr
    options = ("--rig", twin.rig, "--out", tmp_path / "p.toml", "--no-white", "--darks", "0")
    lenient = gonio("plan", "csv", table, *options, "--skip-refused")
    assert lenient.returncode == 0, lenient.stderr
    assert "1 pose: light and camera too close together" in lenient.stderr
    out = tmp_path / "s"
    made = gonio("capture", tmp_path / "p.toml", "--rig", twin.rig, "--out", out, "--json")
    assert made.returncode == 0, made.stderr
    assert json.loads(made.stdout)["refused"] == 1
    assert "left out" in made.stderr
    with Session.open(out) as session:
        assert [pose.index for pose in session.poses()] == [0]
        assert session.planned()[1].refused is not None
