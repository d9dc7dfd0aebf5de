"""The lamp controller: light and exposures over its serial protocol, dark whenever this program is gone.

The controller's watchdog is armed before the light can be on; a heartbeat keeps it fed while we live. The
serial line itself, questions and answers, is `rig.lamp_line`.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from typing import TYPE_CHECKING

from rig.errors import BadInput, DeviceLost, GonioError, Refused, Transient, Unsafe
from rig.lamp_line import LampLine, decimal
from rig.stop_report import PartStop, StopOutcome

if TYPE_CHECKING:
    from types import TracebackType

LOCK_S = 0.005
"""How long one read of the port blocks."""

REPLY_S = 1.0
"""Deadline of an answer."""

LOCK_S = 0.25
"""A stop, having told the light to go off, waits no longer than this for its turn to ask whether it did."""

HEARTBEATS_PER_WATCHDOG = 4
"""More than three, so that one late beat does not put the light out."""

POLL_MIN_S, POLL_MAX_S, POLL_GROWTH = 0.001, 0.02, 0.1
"""Pause between two looks whether the exposure is over: a tenth of the time so far, within these bounds."""

EXPOSURE_MARGIN_S = 5.0
"""On top of the exposure's own time, which the controller may shorten but never stretch."""

OPEN_MARGIN_S = 0.1
"""In LAMP mode the shutter is open this much longer than the lamp is lit, half before and half after."""

MONITOR_S = 0.1
"""The photodiode's window while the light is on: as long it must have burned before a reading is its own."""

ID_CHARACTERS = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-")
ID_LENGTH = 40


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
        self._count = 0
        self._heart: threading.Thread | None = None
        self._heart_stop = threading.Event()
        self._fault: GonioError | None = None
        self._uptime_s = self._steady_from = -math.inf
        self._line = LampLine(port)
        try:
            self._line.command("OUTP OFF")  # whatever a predecessor left on
        except BaseException:
            self._line.close()
            raise

    @property
    def identity(self) -> str:
        """Maker, model, serial number, firmware version."""
        return self._line.identity

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
        with self._line.lock:
            self._line.command("*RST")
            for header, value in (("SHUT:MODE", self.mode), ("SOUR:LEV", decimal(self.level))):
                self._line.set(header, value)
            self._count = self._shutter()[1]
            self._uptime_s = -math.inf

    def interlock_closed(self) -> bool:
        """Whether the interlock loop is closed; while it is open the light is forced off."""
        return self._line.query("INTL?") == "1"

    def temperature_deg_c(self) -> float:
        """Temperature of the lamp head, deg C."""
        return self._line.number("MEAS:TEMP?")

    def monitor(self) -> float:
        """Photodiode over the last lit exposure, 1 = nominal; NaN if there was none."""
        return self._line.number("MEAS:MON?")

    def output(self) -> float:
        """Light of the last lit exposure over what the level promises; NaN if it was too short to be read."""
        return self.monitor() / self.level

    def is_on(self) -> bool:
        """Whether the continuous light is on."""
        return self._line.query("OUTP?") == "1"

    @property
    def armed(self) -> bool:
        """Whether the light can be on: from before it is switched on until it has been read back as off."""
        return self._heart is not None

    def on(self) -> None:
        """Switch the continuous light on, the watchdog armed before, and read it back.

        Raises
        ------
        Unsafe
            If the interlock is open.
        """
        with self._line.lock:
            self._arm()
            self._line.command("OUTP ON")
            if not self.is_on():
                self.require_closed_interlock()
                raise DeviceLost(
                    "the light does not switch on", where=self.port, todo="check lamp and supply"
                )
            self._steady_from = time.monotonic() + MONITOR_S

    def off(self) -> None:
        """Switch the light off for good: read back, watchdog disarmed, heartbeat ended.

        Raises
        ------
        Unsafe
            If the light stays on.
        """
        with self._line.lock:
            self._line.command("OUTP OFF")
            if self.is_on():
                raise Unsafe("the light stays on", where=self.port, todo="cut its power by hand")
            self._heart_stop.set()
            if self._heart is not None:
                self._line.command("SYST:WDOG 0")
                self._heart = None

    def darken(self) -> None:
        """Tell the light to go off, whoever is talking: a whole line between two of his. Never raises."""
        with contextlib.suppress(GonioError):
            self._line.send("OUTP OFF")

    def halt(self) -> PartStop:
        """Light off, now: also during an exposure, which ends with it. Never raises.

        If another thread is stuck in talk with the controller, OUTP OFF is written all the same.
        """
        self.darken()
        got = self._line.lock.acquire(timeout=LOCK_S)
        try:
            if not got:
                return PartStop("lamp", StopOutcome.UNKNOWN, "off was sent, the answer is blocked")
            # Two lines, one question each: what the light does counts, not whether a command was liked.
            on = self._line.exchange(["SHUT:ABOR", "OUTP OFF", "OUTP?"], 1)[0]
            self._line.drain_errors()
        except GonioError as error:
            return PartStop("lamp", StopOutcome.UNKNOWN, error.what)
        finally:
            if got:
                self._line.lock.release()
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
        with self._line.lock:
            error, light, state = self._line.exchange(
                [f"SHUT:ID {shot_id}", f"{verb} {decimal(exposure_s)}", "SYST:ERR?", "OUTP?", "SHUT?"], 3
            )
            self._line.check(error, verb)
        if light != "1" and not dark and self.mode != "LAMP":
            self._line.command("SHUT:ABOR")
            self.require_closed_interlock()
            raise Transient("the light went out before it", where=f"shot {shot_id}", todo="make it again")
        self._wait(state, before, shot_id, self.shutter_s(exposure_s))
        if dark:
            self._steady_from = time.monotonic() + MONITOR_S

    def _prepare(self, exposure_s: float, *, dark: bool) -> None:
        if self.mode == "LAMP":
            self._line.command(f"SHUT:OPEN {decimal(self.shutter_s(exposure_s))}")
        if dark:
            return
        if self.mode == "LAMP":
            self._arm()
        else:
            self.burn()

    def burn(self) -> None:
        """Have the continuous light on, for as long as the photodiode looks back.

        Raises
        ------
        Unsafe
            If the interlock is open.
        """
        if not self._lit():
            self.on()
        time.sleep(max(self._steady_from - time.monotonic(), 0.0))

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
        self.require_closed_interlock()
        self._line.check(self._line.query("SYST:ERR?"), "expose")
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
        self._line.set("SYST:WDOG", decimal(self.watchdog_s))
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
                with self._line.lock:
                    if stop.is_set():
                        return
                    uptime_s = self._line.number("SYST:UPT?")
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

    def _shutter(self) -> tuple[str, int, str]:
        return self._parse_shutter(self._line.query("SHUT?"))

    def _parse_shutter(self, answer: str) -> tuple[str, int, str]:
        parts = answer.split(",", 2)
        if len(parts) != 3 or parts[0] not in {"IDLE", "BUSY"} or not parts[1].isdecimal():
            raise DeviceLost(f"SHUT? answers {answer!r}", where=self.port, todo="update its firmware")
        return parts[0], int(parts[1]), parts[2]

    def require_closed_interlock(self) -> None:
        """Pass only if the interlock is closed.

        Raises
        ------
        Unsafe
            If it is open.
        """
        if not self.interlock_closed():
            raise Unsafe("the interlock is open", where=self.port, todo="close the dark room, then run again")
