"""The wire process's end of the light process: starts it, sends it orders, hears when frames have arrived."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections import deque
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rig.errors import DeviceLost
from simulator.light_process import error_from

if TYPE_CHECKING:
    from simulator.light_process import LightSettings

_ENOUGH_AHEAD = 2
"""Orders that the light process holds: one in work, one waiting, so that a pipe can never fill up."""
_FAREWELL_S = 2.0


class LightLink:
    """A running light process.

    Parameters
    ----------
    settings : LightSettings
        What it is started with.
    """

    def __init__(self, settings: LightSettings) -> None:
        # A session of its own: Ctrl-C in the terminal is for the wire process, which then ends this one.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "simulator.light_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        self._waiting: deque[dict[str, Any]] = deque()
        self._ahead = 0
        self._received = b""
        self._send(asdict(settings))

    @property
    def fd(self) -> int:
        """The descriptor on which answers arrive."""
        assert self._process.stdout  # noqa: S101 - opened as a pipe above
        return self._process.stdout.fileno()

    def wait_until_ready(self) -> dict[str, Any]:
        """Wait for the first answer.

        Returns
        -------
        dict
            The machine, as `light_process.machine_record` describes it.

        Raises
        ------
        GonioError
            What kept the light process from starting.
        """
        while True:
            for answer in self.answers():
                if "error" in answer:
                    raise error_from(answer["error"])
                return answer

    def order(self, order: dict[str, Any]) -> None:
        """Ask for a frame."""
        self._waiting.append(order)
        self._send_waiting()

    def answers(self) -> list[dict[str, Any]]:
        """Read what has arrived; call it when the descriptor is readable.

        Raises
        ------
        DeviceLost
            The light process has ended.
        """
        chunk = os.read(self.fd, 1 << 16)
        if not chunk:
            raise DeviceLost(
                f"the light process has ended with code {self._process.wait()}",
                where="twin",
                todo="see the lines above; GONIO_VARIANT=scalar avoids LLVM",
            )
        *lines, self._received = (self._received + chunk).split(b"\n")
        answers = [json.loads(line) for line in lines]
        self._ahead -= sum("shot" in answer for answer in answers)
        self._send_waiting()
        return answers

    def close(self) -> None:
        """End the light process."""
        with contextlib.suppress(OSError):
            if self._process.stdin:
                self._process.stdin.close()
        try:
            self._process.wait(_FAREWELL_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout:
            self._process.stdout.close()

    def _send_waiting(self) -> None:
        while self._waiting and self._ahead < _ENOUGH_AHEAD:
            self._send(self._waiting.popleft())
            self._ahead += 1

    def _send(self, message: dict[str, Any]) -> None:
        assert self._process.stdin  # noqa: S101 - opened as a pipe above
        with contextlib.suppress(BrokenPipeError):  # told by the end of the answers, with its exit code
            self._process.stdin.write(json.dumps(message).encode() + b"\n")
            self._process.stdin.flush()
