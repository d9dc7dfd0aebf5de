"""`gonio capture` asks a person at a terminal what a machine without a wheel has mounted."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest

from capture.plan import dump_plan, plan_from
from capture.session import Session
from rig.description import default_rig, dump_rig
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = pytest.mark.render


class Terminal:
    """A capture at a terminal of its own."""

    def __init__(self, *arguments: str | Path) -> None:
        self._near, far = os.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "gonio.cli", "capture", *map(str, arguments)],
            stdin=far,
            stdout=far,
            stderr=far,
            start_new_session=True,
        )
        os.close(far)
        self.text = ""

    def wait_for(self, text: str) -> None:
        end = time.monotonic() + 60.0
        while text not in self.text:
            assert time.monotonic() < end, self.text
            self._read(0.1)

    def answer(self, text: str) -> None:
        os.write(self._near, text.encode())

    def end(self) -> int:
        code = self.process.wait(30)
        self._read(0.2)
        return code

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._near)

    def _read(self, timeout_s: float) -> None:
        if select.select([self._near], [], [], timeout_s)[0]:
            with contextlib.suppress(OSError):  # how a pty says that the other end has closed
                self.text += os.read(self._near, 65536).decode()


@pytest.fixture
def bare_twin(tmp_path: Path) -> Iterator[Twin]:
    """Return a twin of a machine without a station wheel."""
    rig = default_rig(folder=tmp_path)
    bare = default_rig(
        folder=tmp_path,
        joints=tuple(joint for joint in rig.joints if joint.name != "station_wheel"),
        arms=rig.arms.model_copy(update={"station": ()}),
        stations={},
    )
    dump_rig(bare, tmp_path / "bare.toml")
    with Twin({"sample": "lambert:kd=0.5"}, rig=tmp_path / "bare.toml", speed=100.0) as twin:
        yield twin


def test_a_person_mounts_white_and_sample(bare_twin: Twin, tmp_path: Path) -> None:
    """Would catch a pass that starts unasked, and a question that Ctrl-C cannot leave."""
    content = {
        "plan": {"name": "velvet", "sample": "velvet"},
        "darks": {"count": 1},
        "poses": [{"kind": "sweep", "theta_i_deg": [30], "theta_o_deg": [0, 30]}],
    }
    dump_plan(plan_from(content, "test"), tmp_path / "plan.toml")
    out = tmp_path / "s"
    first = Terminal(tmp_path / "plan.toml", "--rig", bare_twin.rig, "--out", out)
    try:
        first.wait_for("Mount the white reference")
        with Session.open(out) as session:
            assert session.poses() == []
        first.answer("\n")
        first.wait_for("Mount the sample velvet")
        first.process.send_signal(signal.SIGINT)
        assert first.end() == 130, first.text
        assert f"gonio capture --resume {out}" in first.text
    finally:
        first.close()
    second = Terminal("--resume", out)
    try:
        second.wait_for("Mount the sample velvet")
        second.answer("\n")
        assert second.end() == 0, second.text
        assert "white reference" not in second.text
    finally:
        second.close()
    with Session.open(out) as session:
        assert session.complete()
        assert [event.kind for event in session.events()].count("mounted") == 2
