"""`gonio rig` as a person or a script runs it: exit codes, one line, JSON, signals."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from gonio.signals import StopRequests
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def twin() -> Iterator[Twin]:
    """Return a fast twin."""
    with Twin({}, speed=100.0) as twin:
        yield twin


def gonio(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command to its end."""
    return subprocess.run(
        [sys.executable, "-m", "gonio.cli", "rig", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_check_move_park_stop(twin: Twin) -> None:
    """Catches an action that fails on a healthy machine, or prints more than one object with --json."""
    check = gonio("check", "--rig", twin.rig)
    assert check.returncode == 0, check.stderr
    assert "light_elevation" in check.stdout
    assert "interlock closed" in check.stdout
    move = gonio(
        "move", "light_elevation=-30", "turntable=15", "--station", "trap", "--rig", twin.rig, "--json"
    )
    assert move.returncode == 0, move.stderr
    pose = json.loads(move.stdout)
    assert pose["station"] == "trap"
    assert pose["angles_deg"]["light_elevation"] == pytest.approx(-30, abs=0.1)
    assert pose["angles_deg"]["turntable"] == pytest.approx(15, abs=0.1)
    park = gonio("park", "--rig", twin.rig)
    assert park.returncode == 0, park.stderr
    assert "-44.9" in park.stdout or "-45.0" in park.stdout
    stop = gonio("stop", "--rig", twin.rig, "--json")
    assert stop.returncode == 0, stop.stderr
    assert json.loads(stop.stdout)["outcome"] == "confirmed"


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["check", "--rig", "nope.toml"], 2, "no such rig file"),
        (["check", "--servos", "/dev/nope"], 4, "/dev/nope: no such port"),
        (["check", "--lamp", "/dev/nope"], 4, "/dev/nope: no such port"),
        (["check", "--frames", "nope"], 2, "no such folder"),
        (["move"], 2, "nothing to move"),
        (["move", "turn=3"], 2, "joints are light_elevation"),
        (["move", "turntable=x"], 2, "no angle"),
        (["move", "turntable=nan"], 2, "no angle"),
        (["move", "turntable=200"], 3, "limits -180"),
        (["move", "--station", "sample9"], 2, "stations are white"),
        (["stop", "--servos", "/dev/nope", "--lamp", "/dev/nope"], 4, "lamp, servos not proved stopped"),
    ],
)
def test_mistakes_are_one_line(twin: Twin, arguments: list[str], code: int, message: str) -> None:
    """Catches a traceback, a wrong exit code, or a message that does not say what is wrong."""
    if "--rig" not in arguments:
        arguments = [*arguments, "--rig", twin.rig]
    done = gonio(*arguments)
    assert done.returncode == code, done.stderr
    assert message in done.stderr
    assert len(done.stderr.splitlines()) <= 1


def test_a_wrong_model_is_shown_beside_what_was_expected(twin: Twin, tmp_path: Path) -> None:
    """Catches a refusal without the table that tells which servo to exchange."""
    rig = tmp_path / "rig.toml"
    text = Path(twin.rig).read_text(encoding="utf-8")
    rig.write_text(text.replace("XH430-W350", "XL430-W250", 1), encoding="utf-8")
    done = gonio("check", "--rig", str(rig), "--frames", twin.frames, "--json")
    assert done.returncode == 3, done.stderr
    assert "is a XH430-W350, expected XL430-W250" in done.stderr
    assert json.loads(done.stdout)["servos"]["servos"][0]["fault"]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_during_a_move_stops_it(number: signal.Signals, code: int) -> None:
    """Catches Ctrl-C that leaves the arms moving: the bytes on the wire must show the stop."""
    with Twin({}, speed=1.0) as slow:
        mover = subprocess.Popen(
            [sys.executable, "-m", "gonio.cli", "rig", "move", "turntable=170", "--rig", slow.rig],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        goal = "8374000400"  # a synchronous write of goal positions
        while sum(goal in event.get("data", "") for event in slow.wire_log()) < 1:
            assert mover.poll() is None, mover.communicate()
            time.sleep(0.05)
        time.sleep(0.3)
        since = time.monotonic()
        mover.send_signal(number)
        _, message = mover.communicate(timeout=20)
        assert mover.returncode == code, message
        assert "Traceback" not in message
        log = [event for event in slow.wire_log() if event["t"] >= since]
        dark = next(event["t"] for event in log if b"OUTP OFF\n".hex() in event.get("data", ""))
        stop = next(event["t"] for event in log if goal in event.get("data", ""))
        assert dark < stop
        pose = gonio("check", "--rig", slow.rig, "--json")
        assert pose.returncode == 0


def test_the_first_ctrl_c_finishes_the_second_aborts() -> None:
    """Catches a first Ctrl-C that throws a frame away, or a second one that is swallowed."""
    stopped: list[str] = []
    with StopRequests("frame") as requests:
        requests.on_abort(lambda: stopped.append("machine"))
        assert requests.exit_code is None
        signal.raise_signal(signal.SIGINT)
        assert requests.finish_requested
        assert not requests.abort_requested
        assert stopped == []
        signal.raise_signal(signal.SIGINT)
        assert requests.abort_requested
        assert requests.exit_code == 130
    assert stopped == ["machine"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_sigterm_aborts_at_once_also_before_there_is_a_machine() -> None:
    """Catches a SIGTERM that comes while the machine is being opened and is forgotten."""
    stopped: list[str] = []
    with StopRequests("frame") as requests:
        signal.raise_signal(signal.SIGTERM)
        requests.on_abort(lambda: stopped.append("machine"))
        assert requests.abort_requested
        assert requests.exit_code == 143
    assert stopped == ["machine"]


def test_parking_the_others(twin: Twin) -> None:
    """Catches a rescue that cannot be asked for, or does not say of each part what became of it."""
    done = gonio("park", "--others", "--rig", twin.rig, "--json")
    assert done.returncode == 0, done.stderr
    parts = json.loads(done.stdout)["parts"]
    assert [part["outcome"] for part in parts] == ["confirmed"] * 6
