"""Who owns the machine, and a stop asked for from outside."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import textwrap
import time
from typing import TYPE_CHECKING

import pytest

from rig.control_table import CONTROL_TABLE
from rig.description import Ports, default_rig, load_rig
from rig.errors import Refused
from rig.owner import Lock, PortOwner, is_alive, lock_path, request_stop
from rig.stop_report import PartStop, StopOutcome, StopReport
from simulator.twin import Twin
from tests.rig.conftest import WAIT_S, until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rig.description import Rig

CONFIRMED = StopReport((PartStop("lamp", StopOutcome.CONFIRMED, "light off"),))
GOAL_SYNC_WRITE = bytes([0x83, CONTROL_TABLE["goal_position"].address, 0, 4, 0]).hex()
LIGHT_OFF = b"OUTP OFF\n".hex()

MOVING_CLIENT = """
    import sys
    from rig.description import load_rig
    from rig.errors import GonioError
    from rig.machine import open_machine
    rig = load_rig(sys.argv[1])
    with open_machine(rig) as machine:
        machine.lamp.on()
        print("ready", flush=True)
        try:
            machine.move([1.2, 2.5, 1.2, 2.5], "sample1")
        except GonioError as error:
            print(error.what, flush=True)
"""


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Rig:
    """Return a rig whose lock lies in the test's own folder."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return default_rig(ports=Ports(servos="/dev/gonio-test", lamp="/dev/gonio-test-lamp"), folder=tmp_path)


@pytest.fixture
def slow_twin() -> Iterator[Twin]:
    """Return a twin that moves as slowly as a real machine."""
    with Twin({}, speed=1.0) as twin:
        yield twin


def start_moving(twin: Twin) -> subprocess.Popen[str]:
    """Start a client in a process of its own that has the light on and moves."""
    client = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(MOVING_CLIENT), twin.rig], stdout=subprocess.PIPE, text=True
    )
    assert client.stdout is not None
    assert client.stdout.readline() == "ready\n"
    until(lambda: any(GOAL_SYNC_WRITE in event.get("data", "") for event in twin.wire_log()))
    return client


def assert_dark_and_still(twin: Twin, since: float) -> None:
    """Prove from the wires: light off, then goals for the servos."""
    log = [event for event in twin.wire_log() if event["t"] >= since]
    dark = next(event["t"] for event in log if event["line"] == "lamp" and LIGHT_OFF in event.get("data", ""))
    stop = next(event["t"] for event in log if GOAL_SYNC_WRITE in event.get("data", ""))
    assert dark < stop
    assert [event["on"] for event in log if event.get("event") == "light"][-1:] in ([False], [])


def test_the_owner_answers_a_stop(rig: Rig) -> None:
    """Catches a request that is answered without stopping, or a report that is lost on the way."""
    calls: list[int] = []

    def stop() -> StopReport:
        calls.append(1)
        return CONFIRMED

    owner = PortOwner(rig, stop)
    assert request_stop(rig) == CONFIRMED
    assert calls == [1]
    owner.release()
    assert not lock_path(rig.ports.servos).exists()
    owner.release()


def test_two_owners_are_refused(rig: Rig) -> None:
    """Catches two programs that drive one machine."""
    owner = PortOwner(rig, lambda: CONFIRMED)
    with pytest.raises(Refused, match=f"process {os.getpid()} already runs"):
        PortOwner(rig, lambda: CONFIRMED)
    owner.release()
    PortOwner(rig, lambda: CONFIRMED).release()


@pytest.mark.parametrize("content", ["", "{", "[]", '{"pid": 1}', "dead"])
def test_a_stale_lock_is_taken_over(rig: Rig, content: str) -> None:
    """Catches a machine that can never be opened again after a crash."""
    if content == "dead":
        with socket.create_server(("127.0.0.1", 0)) as server:
            content = json.dumps({"pid": 1, "port": server.getsockname()[1], "token": "x"})
    lock_path(rig.ports.servos).write_text(content, encoding="utf-8")
    PortOwner(rig, lambda: CONFIRMED).release()


def test_a_stranger_without_the_token_stops_nothing(rig: Rig) -> None:
    """Catches a loopback port that obeys any program or web page on this computer."""
    calls: list[int] = []

    def stop() -> StopReport:
        calls.append(1)
        return CONFIRMED

    owner = PortOwner(rig, stop)
    lock = Lock.read(lock_path(rig.ports.servos))
    assert lock is not None
    assert is_alive(lock)
    assert not is_alive(Lock(lock.pid, lock.port, "0" * 32))
    with socket.create_connection(("127.0.0.1", lock.port)) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\n\r\n")
    if os.name == "posix":
        assert lock_path(rig.ports.servos).stat().st_mode & 0o077 == 0
    owner.release()
    assert calls == []


def test_one_port_has_one_lock_whatever_its_name(rig: Rig, tmp_path: Path) -> None:
    """Catches two names of one adapter that make two owners."""
    port = tmp_path / "tty"
    port.touch()
    (tmp_path / "by-id").symlink_to(port)
    assert lock_path(str(tmp_path / "by-id")) == lock_path(str(port))


def test_nobody_there_is_unknown_not_confirmed(rig: Rig) -> None:
    """Catches a stop that reports success without having opened a port."""
    report = request_stop(rig)
    assert report.outcome is StopOutcome.UNKNOWN
    assert {part.part for part in report.parts} == {"lamp", "servos"}


@pytest.mark.render
def test_a_running_process_is_stopped_from_outside(slow_twin: Twin) -> None:
    """Catches `gonio rig stop` that cannot reach the process that has the ports."""
    client = start_moving(slow_twin)
    since = time.monotonic()
    report = request_stop(load_rig(slow_twin.rig))
    assert report.outcome is StopOutcome.CONFIRMED, report.details
    output, _ = client.communicate(timeout=WAIT_S)
    assert "stopped" in output
    assert_dark_and_still(slow_twin, since)


@pytest.mark.render
def test_a_killed_process_leaves_a_machine_that_can_be_stopped(slow_twin: Twin) -> None:
    """Catches a lock left by kill -9 that keeps everybody from stopping the arms."""
    client = start_moving(slow_twin)
    client.send_signal(signal.SIGKILL)
    client.communicate(timeout=WAIT_S)
    since = time.monotonic()
    report = request_stop(load_rig(slow_twin.rig))
    assert report.outcome is StopOutcome.CONFIRMED, report.details
    assert_dark_and_still(slow_twin, since)
    assert (
        not lock_path(slow_twin.servos).exists()
        or PortOwner(load_rig(slow_twin.rig), lambda: CONFIRMED).release() is None
    )


@pytest.mark.render
def test_a_killed_process_leaves_the_dark_within_the_watchdog(slow_twin: Twin) -> None:
    """Catches a light that burns on after kill -9."""
    client = start_moving(slow_twin)
    client.send_signal(signal.SIGKILL)
    client.communicate(timeout=WAIT_S)
    until(
        lambda: (
            [event["on"] for event in slow_twin.wire_log() if event.get("event") == "light"] == [True, False]
        )
    )
