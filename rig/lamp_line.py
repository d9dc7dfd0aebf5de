"""The lamp controller's line: questions with deadlines, commands whose refusal never stays silent.

Each command is followed, in the same write, by the question for its error. An answer that comes too late is
never taken for the next question's.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from decimal import Decimal
from typing import Any

import serial

from rig.errors import DeviceLost, Refused, Transient, Unsafe
from rig.serial_line import open_port

BAUD = 115_200

BLOCK_S = 0.005
"""How long one read of the port blocks."""

REPLY_S = 2.0
"""Deadline of an answer."""

ERROR_QUEUE = 16

_NO_ERROR, _EXPOSURE_RUNNING, _INTERLOCK, _WATCHDOG = 0, -284, -240, -241


def decimal(value: float) -> str:
    """Write a number so that it reads back as the same, the shortest way, never with an exponent."""
    return format(Decimal(repr(float(value))), "f")


class LampLine:
    """The serial line to one lamp controller. Any thread may call any method.

    Parameters
    ----------
    port : str
        Serial port.

    Attributes
    ----------
    identity : str
        What it calls itself.
    lock : RLock
        Held while one question is asked and answered; hold it to keep several together.

    Raises
    ------
    DeviceLost
        If the port or the controller is not there.
    Refused
        If somebody else holds the port.
    """

    def __init__(self, port: str) -> None:
        self.port = port
        self.lock = threading.RLock()
        self._buffer = b""
        self._answers: deque[str] = deque()
        self._unsure = False
        self._line = open_port(port, BAUD, read_timeout_s=BLOCK_S)
        try:
            self.send("")  # ends what a killed predecessor left half said
            self.identity = self._identify()
            self.drain_errors()
        except BaseException:
            self._line.close()
            raise

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return bool(self._line.is_open)

    def close(self) -> None:
        """Close the port."""
        with self.lock:
            self._line.close()

    def set(self, header: str, value: str) -> None:
        """Command a setting and read it back.

        Raises
        ------
        Refused
            If it does not stick.
        """
        self.command(f"{header} {value}")
        held = self.query(f"{header}?")
        same = held == value
        if not same:
            try:
                same = math.isclose(float(held), float(value), rel_tol=1e-3, abs_tol=1e-6)
            except ValueError:
                same = False
        if not same:
            raise Refused(
                f"{header} was set to {value} but reads {held}", where=self.port, todo="update its firmware"
            )

    def query(self, line: str) -> str:
        """Send a query and return its answer.

        Raises
        ------
        DeviceLost
            If no answer comes in time.
        """
        return self.exchange([line], 1)[0]

    def command(self, line: str) -> None:
        """Send a command and make sure that it was accepted.

        Raises
        ------
        Refused, Transient, Unsafe
            As the controller's error says.
        DeviceLost
            If no answer comes in time.
        """
        self.check(self.exchange([line, "SYST:ERR?"], 1)[0], line)

    def number(self, query: str) -> float:
        """Ask for a number.

        Raises
        ------
        DeviceLost
            If the answer is none.
        """
        answer = self.query(query)
        try:
            return float(answer)
        except ValueError:
            self._unsure = True
            raise DeviceLost(
                f"{query} answers {answer!r}", where=self.port, todo="check the line, then run again"
            ) from None

    def drain_errors(self) -> None:
        """Empty the controller's queue of errors."""
        for _ in range(ERROR_QUEUE + 1):
            if self.query("SYST:ERR?").startswith("0,"):
                return

    def check(self, answer: str, line: str) -> None:
        """Turn an answer to SYST:ERR? into the error tree; `line` is what it is about.

        Raises
        ------
        Transient, Unsafe, Refused, DeviceLost
            As the error says; DeviceLost where the answer is none.
        """
        number_text, _, text = answer.partition(",")
        try:
            number = int(number_text)
        except ValueError:
            self._unsure = True
            raise DeviceLost(
                f"SYST:ERR? answers {answer!r}", where=self.port, todo="check the line, then run again"
            ) from None
        if number == _NO_ERROR:
            return
        self.drain_errors()
        reason = text.strip('"').lower() or f"error {number}"
        if number == _INTERLOCK:
            raise Unsafe("the interlock is open", where=self.port, todo="close the dark room, then run again")
        if number == _WATCHDOG:
            raise Transient(
                "the watchdog put the light out, because this computer was silent for too long",
                where=self.port,
                todo="make the exposure again; if it recurs, raise watchdog_s in rig.toml",
            )
        if number == _EXPOSURE_RUNNING:
            raise Transient("an exposure is still running", where=self.port, todo="wait for its end")
        raise Refused(f"{line}: {reason}", where=self.port, todo="compare rig.toml with the controller")

    def exchange(self, lines: list[str], answers: int, *, first_matching: str = "") -> list[str]:
        """Send lines, wait for so many answers; answers to questions given up earlier never count."""
        with self.lock:
            if self._unsure and not first_matching:
                self._resynchronise()
            if not first_matching:
                self._answers.clear()
            self.send("\n".join(lines))
            deadline = time.monotonic() + REPLY_S
            try:
                if first_matching:
                    return [self._answer_starting(first_matching, deadline)]
                return [self._answer(deadline) for _ in range(answers)]
            except DeviceLost:
                self._unsure = True
                raise

    def _resynchronise(self) -> None:
        # The line keeps order: when the identity comes, everything asked before it has been answered.
        self._identify()
        self._answers.clear()
        self._unsure = False

    def _answer_starting(self, start: str, deadline: float) -> str:
        while True:
            answer = self._answer(deadline)
            if answer.startswith(start):
                return answer

    def _answer(self, deadline: float) -> str:
        while not self._answers:
            if time.monotonic() > deadline:
                raise DeviceLost(
                    f"no answer within {REPLY_S:g} s",
                    where=self.port,
                    todo="check that this is the lamp's port, its cable and its power",
                )
            self._read_more()
        return self._answers.popleft()

    def _read_more(self) -> None:
        try:
            data = self._line.read(max(1, self._line.in_waiting))
        except (serial.SerialException, OSError, TypeError, AttributeError) as error:
            raise self._gone(error) from error
        *lines, self._buffer = (self._buffer + data).replace(b"\r", b"").split(b"\n")
        self._answers.extend(line.decode("ascii", "replace").strip() for line in lines)

    def send(self, line: str) -> None:
        """Write a line and wait for nothing, with or without the lock: a stop speaks over everybody.

        Raises
        ------
        DeviceLost
            If the port is gone.
        """
        data: Any = (line + "\n").encode("ascii")
        try:
            self._line.write(data)
        except (serial.SerialException, OSError, TypeError, AttributeError) as error:
            raise self._gone(error) from error

    def _gone(self, error: Exception) -> DeviceLost:
        return DeviceLost(
            f"the lamp's port is gone ({error})", where=self.port, todo="plug it in and run 'gonio rig check'"
        )

    def _identify(self) -> str:
        return self.exchange(["*IDN?"], 1, first_matching="gonio,lamp,")[0]
