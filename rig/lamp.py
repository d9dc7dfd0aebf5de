"""The lamp controller: light and exposures over its serial protocol, dark whenever this program is gone.

Each command is followed, in the same write, by the question for its error: no refusal stays silent. The
controller's watchdog is armed before the light can be on; a heartbeat keeps it fed while we live.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from decimal import Decimal
from typing import TYPE_CHECKING, Any

import serial

from rig.errors import BadInput, DeviceLost, GonioError, Refused, Transient, Unsafe
from rig.serial_line import open_port
from rig.stop_report import PartStop, StopOutcome

if TYPE_CHECKING:
    from types import TracebackType

BAUD = 115_200

BLOCK_S = 0.005
"""How long one read of the port blocks."""

REPLY_S = 1.0
"""Deadline of an answer."""

LOCK_S = 0.25
"""A stop does not wait longer than this for whoever is talking; it then speaks over him."""

HEARTBEATS_PER_WATCHDOG = 4
"""More than three, so that one late beat does not put the light out."""

POLL_MIN_S, POLL_MAX_S, POLL_GROWTH = 0.001, 0.02, 0.1
"""Pause between two looks whether the exposure is over: a tenth of the time so far, within these bounds."""

EXPOSURE_MARGIN_S = 5.0
"""On top of the exposure's own time, which the controller may shorten but never stretch."""

OPEN_MARGIN_S = 0.1
"""In LAMP mode the shutter is open this much longer than the lamp is lit, half before and half after."""

ID_CHARACTERS = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-")
ID_LENGTH = 40

_NO_ERROR, _EXPOSURE_RUNNING, _INTERLOCK, _WATCHDOG = 0, -284, -240, -241


def decimal(value: float) -> str:
    """Shortest decimal that reads back as the same number, never with an exponent."""
    return format(Decimal(repr(float(value))), "f")


class Lamp:
    """One lamp controller. Any thread may call any method.

    Parameters
    ----------
    port : str
        Serial port.
    mode : {"BULB", "WIDTH", "LAMP"}
        What times an exposure.
    level : float
        Brightness, 0 to 1.
    watchdog_s : float
        After this long without a line from us the controller puts the light out, 0.1 to 60 s.

    Raises
    ------
    DeviceLost
        If the port or the controller is not there.
    Refused
        If somebody else holds the port, or something else answers on it.
    """

    def __init__(self, port: str, *, mode: str = "BULB", level: float = 1.0, watchdog_s: float = 2.0) -> None:
        self.port, self.mode, self.level, self.watchdog_s = port, mode, level, watchdog_s
        self._lock = threading.RLock()
        self._buffer = b""
        self._answers: deque[str] = deque()
        self._unsure = False
        self._count = 0
        self._heart: threading.Thread | None = None
        self._heart_stop = threading.Event()
        self._fault: GonioError | None = None
        self._uptime_s = -math.inf
        self._line = open_port(port, BAUD, read_timeout_s=BLOCK_S)
        try:
            # Garbage of a killed predecessor ends here; whatever it left on goes off.
            self._write("")
            self.identity = self._identify()
            self._drain_errors()
            self.command("OUTP OFF")
        except BaseException:
            self._line.close()
            raise

    def __enter__(self) -> Lamp:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def set_up(self) -> None:
        """Reset the controller (light off) and write mode and level, read back.

        Raises
        ------
        Refused
            If a setting does not stick.
        """
        with self._lock:
            self.command("*RST")
            for header, value in (("SHUT:MODE", self.mode), ("SOUR:LEV", decimal(self.level))):
                self.command(f"{header} {value}")
                self._require_same(header, value)
            self._count = self._shutter()[1]
            self._uptime_s = -math.inf

    def query(self, line: str) -> str:
        """Send a query and return its answer.

        Raises
        ------
        DeviceLost
            If no answer comes in time.
        """
        return self._exchange([line], 1)[0]

    def command(self, line: str) -> None:
        """Send a command and make sure that it was accepted.

        Raises
        ------
        Refused, Transient, Unsafe
            As the controller's error says.
        DeviceLost
            If no answer comes in time.
        """
        self._check(self._exchange([line, "SYST:ERR?"], 1)[0], line)

    def interlock_closed(self) -> bool:
        """Whether the interlock loop is closed; while it is open the light is forced off."""
        return self.query("INTL?") == "1"

    def temperature_deg_c(self) -> float:
        """Temperature of the lamp head, deg C."""
        return self._number("MEAS:TEMP?")

    def monitor(self) -> float:
        """Photodiode over the last lit exposure, 1 = nominal; NaN if there was none."""
        return self._number("MEAS:MON?")

    def is_on(self) -> bool:
        """Whether the continuous light is on."""
        return self.query("OUTP?") == "1"

    def on(self) -> None:
        """Switch the continuous light on, the watchdog armed before, and read it back.

        Raises
        ------
        Unsafe
            If the interlock is open.
        """
        with self._lock:
            self._arm()
            self.command("OUTP ON")
            if not self.is_on():
                self._require_closed_interlock()
                raise DeviceLost(
                    "the light does not switch on", where=self.port, todo="check lamp and supply"
                )

    def off(self) -> None:
        """Switch the light off for good: read back, watchdog disarmed, heartbeat ended.

        Raises
        ------
        Unsafe
            If the light stays on.
        """
        with self._lock:
            self.command("OUTP OFF")
            if self.is_on():
                raise Unsafe("the light stays on", where=self.port, todo="cut its power by hand")
            self._heart_stop.set()
            if self._heart is not None:
                self.command("SYST:WDOG 0")
                self._heart = None

    def halt(self) -> PartStop:
        """Light off, now: also during an exposure, which ends with it. Never raises.

        If another thread is stuck in talk with the controller, OUTP OFF is written all the same.
        """
        got = self._lock.acquire(timeout=LOCK_S)
        try:
            self._write("OUTP OFF")
            if not got:
                return PartStop("lamp", StopOutcome.UNKNOWN, "off was sent, the answer is blocked")
            # Two lines, one question each: what the light does counts, not whether a command was liked.
            on = self._exchange(["SHUT:ABOR", "OUTP OFF", "OUTP?"], 1)[0]
            self._drain_errors()
        except GonioError as error:
            return PartStop("lamp", StopOutcome.UNKNOWN, error.what)
        finally:
            if got:
                self._lock.release()
        if on == "0":
            return PartStop("lamp", StopOutcome.CONFIRMED, "light off")
        return PartStop("lamp", StopOutcome.REFUSED, f"OUTP? says {on}")

    def close(self) -> None:
        """Light off as far as it can be told, then close the port; a second time does nothing."""
        if not self._line.is_open:
            return
        self._heart_stop.set()
        try:
            self.off()
        except GonioError:
            self.halt()  # the watchdog, still armed, finishes what we could not
        finally:
            with self._lock:
                self._line.close()

    def shutter_s(self, exposure_s: float) -> float:
        """How long the shutter is open for an exposure: longer than the light only in LAMP mode."""
        return exposure_s + OPEN_MARGIN_S if self.mode == "LAMP" else exposure_s

    def expose(self, exposure_s: float, shot_id: str, *, dark: bool = False) -> None:
        """Make one exposure and return when the controller says that it is complete.

        Parameters
        ----------
        exposure_s : float
            1e-5 to 600 s.
        shot_id : str
            Its name: 1 to 40 characters of A-Z a-z 0-9 . _ -
        dark : bool
            With the lamp off.

        Raises
        ------
        BadInput
            If exposure or name is out of range.
        Transient
            If the exposure was cut short (watchdog, abort): it can be made again.
        Unsafe
            If the interlock is open.
        DeviceLost
            If the controller stops answering or restarts.
        """
        if not shot_id or len(shot_id) > ID_LENGTH or not ID_CHARACTERS.issuperset(shot_id):
            raise BadInput(
                f"unusable shot name {shot_id!r}", where="shot", todo="use 1 to 40 of A-Z a-z 0-9 . _ -"
            )
        if not 1e-5 <= exposure_s <= 600.0:
            raise BadInput(f"exposure {exposure_s} s", where=f"shot {shot_id}", todo="use 0.00001 to 600 s")
        self._raise_fault()
        self._prepare(exposure_s, dark=dark)
        before = self._count
        verb = "SHUT:DARK" if dark else "SHUT:EXP"
        with self._lock:
            error, light, state = self._exchange(
                [f"SHUT:ID {shot_id}", f"{verb} {decimal(exposure_s)}", "SYST:ERR?", "OUTP?", "SHUT?"], 3
            )
            self._check(error, verb)
        if light != "1" and not dark and self.mode != "LAMP":
            self.command("SHUT:ABOR")
            raise Transient("the light went out before it", where=f"shot {shot_id}", todo="make it again")
        self._wait(state, before, shot_id, self.shutter_s(exposure_s))

    def _prepare(self, exposure_s: float, *, dark: bool) -> None:
        if self.mode == "LAMP":
            self.command(f"SHUT:OPEN {decimal(self.shutter_s(exposure_s))}")
        if dark:
            return
        if self.mode == "LAMP":
            self._arm()
        elif not self._lit():
            self.on()

    def _lit(self) -> bool:
        return self._heart is not None and self.is_on()

    def _wait(self, first: str, before: int, shot_id: str, shutter_s: float) -> None:
        began = time.monotonic()
        state, count, echo = self._parse_shutter(first)
        while state == "BUSY":
            elapsed = time.monotonic() - began
            if elapsed > shutter_s + EXPOSURE_MARGIN_S:
                raise DeviceLost(
                    f"the exposure of {shutter_s:g} s does not end",
                    where=self.port,
                    todo="restart the controller",
                )
            time.sleep(min(max(POLL_GROWTH * elapsed, POLL_MIN_S), POLL_MAX_S))
            self._raise_fault()
            state, count, echo = self._shutter()
        self._count = count
        if count == before + 1 and echo == shot_id:
            return
        self._explain_failure(before, count, echo, shot_id)

    def _explain_failure(self, before: int, count: int, echo: str, shot_id: str) -> None:
        self._require_closed_interlock()
        self._check(self.query("SYST:ERR?"), "expose")
        if count <= before:
            raise Transient("the exposure was cut short", where=f"shot {shot_id}", todo="make it again")
        raise Refused(
            f"exposure {count} carries the name {echo!r}, expected {before + 1} and {shot_id!r}",
            where=self.port,
            todo="make sure that nobody else commands the controller, then run again",
        )

    def _arm(self) -> None:
        """Watchdog on and read back, heartbeat running."""
        self._raise_fault()
        value = decimal(self.watchdog_s)
        self.command(f"SYST:WDOG {value}")
        self._require_same("SYST:WDOG", value)
        if self._heart is None:
            self._heart_stop = threading.Event()
            self._heart = threading.Thread(
                target=self._beat, args=(self._heart_stop,), name=f"lamp heartbeat {self.port}", daemon=True
            )
            self._heart.start()

    def _beat(self, stop: threading.Event) -> None:
        missed = 0
        while not stop.wait(self.watchdog_s / HEARTBEATS_PER_WATCHDOG):
            try:
                with self._lock:
                    if stop.is_set():
                        return
                    uptime_s = self._number("SYST:UPT?")
            except GonioError as error:
                missed += 1
                if missed > 1 or not self._line.is_open:
                    self._fault = error
                    return
                continue
            missed = 0
            if uptime_s < self._uptime_s:
                self._fault = DeviceLost(
                    "the controller restarted", where=self.port, todo="check its supply, then run again"
                )
                return
            self._uptime_s = uptime_s

    def _raise_fault(self) -> None:
        if self._fault is not None:
            raise self._fault

    def _identify(self) -> str:
        return self._exchange(["*IDN?"], 1, first_matching="gonio,lamp,")[0]

    def _shutter(self) -> tuple[str, int, str]:
        return self._parse_shutter(self.query("SHUT?"))

    def _parse_shutter(self, answer: str) -> tuple[str, int, str]:
        parts = answer.split(",", 2)
        if len(parts) != 3 or parts[0] not in {"IDLE", "BUSY"} or not parts[1].isdecimal():
            self._unsure = True
            raise DeviceLost(f"SHUT? answers {answer!r}", where=self.port, todo="update its firmware")
        return parts[0], int(parts[1]), parts[2]

    def _require_same(self, header: str, value: str) -> None:
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

    def _require_closed_interlock(self) -> None:
        if not self.interlock_closed():
            raise Unsafe("the interlock is open", where=self.port, todo="close the dark room, then run again")

    def _number(self, query: str) -> float:
        answer = self.query(query)
        try:
            return float(answer)
        except ValueError:
            self._unsure = True
            raise DeviceLost(
                f"{query} answers {answer!r}", where=self.port, todo="check the line, then run again"
            ) from None

    def _drain_errors(self) -> None:
        for _ in range(17):  # the queue holds 16
            if self.query("SYST:ERR?").startswith("0,"):
                return

    def _check(self, answer: str, line: str) -> None:
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
        self._drain_errors()
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

    def _exchange(self, lines: list[str], answers: int, *, first_matching: str = "") -> list[str]:
        """Send lines, wait for so many answers; answers to questions given up earlier never count."""
        with self._lock:
            if self._unsure and not first_matching:
                self._resynchronise()
            if not first_matching:
                self._answers.clear()
            self._write("\n".join(lines))
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

    def _write(self, line: str) -> None:
        data: Any = (line + "\n").encode("ascii")
        try:
            self._line.write(data)
        except (serial.SerialException, OSError, TypeError, AttributeError) as error:
            raise self._gone(error) from error

    def _gone(self, error: Exception) -> DeviceLost:
        return DeviceLost(
            f"the lamp's port is gone ({error})", where=self.port, todo="plug it in and run 'gonio rig check'"
        )
