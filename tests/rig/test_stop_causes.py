"""Every cause of a stop, by the bytes on the wires: light off, all servos told, read back and confirmed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest

from benchmarks.machine_stops import CALM, FAILING, stops
from gonio.signals import StopRequests

if TYPE_CHECKING:
    from pathlib import Path

CAUSES = {*CALM, *FAILING}


@pytest.mark.render
def test_every_cause_reaches_the_one_stop_path() -> None:
    """Catches a cause that stops nothing, skips a servo or the light, or is not read back."""
    assert {name: told for name, _, told in stops(each=1)} == dict.fromkeys(CAUSES, True)


def test_a_program_started_by_nohup_outlives_its_parent() -> None:
    """Catches a night that ends when somebody logs off, though he said that it was to go on."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopRequests("frame") as requests:
            os.kill(os.getpid(), signal.SIGHUP)
            time.sleep(0.1)
            assert not requests.abort_requested
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


ORPHAN = """
import os, sys, time
from gonio.signals import StopRequests
with StopRequests("frame") as requests:
    requests.on_abort(lambda: print("stopped", flush=True))
    print("ready", flush=True)
    for _ in range(600):
        time.sleep(0.1)
        if requests.abort_requested:
            break
print(requests.exit_code, flush=True)
"""


def test_a_program_in_the_background_hears_ctrl_c() -> None:
    """Catches SIGINT that stays ignored, as shells have it for what a script starts in the background."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with StopRequests("frame") as requests:
            signal.raise_signal(signal.SIGINT)
            assert requests.finish_requested
    finally:
        signal.signal(signal.SIGINT, before)


def test_the_end_of_its_parent_stops_a_program(tmp_path: Path) -> None:
    """Catches arms that go on for a script that was killed, and a program that calls that a success."""
    program = tmp_path / "orphan.py"
    program.write_text(ORPHAN)
    start = f"import subprocess, sys; subprocess.run([sys.executable, {str(program)!r}])"
    with subprocess.Popen([sys.executable, "-c", start], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "ready\n"
        parent.kill()
        assert parent.stdout.read().split() == ["stopped", "143"]
