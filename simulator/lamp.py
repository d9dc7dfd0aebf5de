"""The lamp controller: light, shutter, interlock and watchdog behind a line of text.

It follows the lamp controller's protocol to the letter. Times come in from outside (seconds of a monotonic
clock); exposures run `speed` times faster than that clock, the watchdog does not. What decides an exposure's
picture (lit or not, level) is taken at its start and held to its end, so that a frame depends on settings and
never on timing.
"""

from __future__ import annotations

import math
import re
from collections import deque
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(E[+-]?\d+)?")
_SHOT_ID = re.compile(r"[A-Za-z0-9._-]{1,40}")
_QUEUE_LENGTH = 16
_LONGEST_LINE = 256
_MONITOR_S = 0.1
EXPOSURE_RANGE_S = (0.00001, 600.0)
OPEN_RANGE_S = (0.001, 600.0)
WATCHDOG_RANGE_S = (0.1, 60.0)
HEAD_TEMPERATURE_DEG_C = 31.5
FIRMWARE = "1.0.0"


class LampError(Enum):
    """What the error queue can hold."""

    NONE = '0,"No error"'
    HEADER = '-113,"Undefined header"'
    RANGE = '-222,"Data out of range"'
    RUNNING = '-284,"Exposure running"'
    INTERLOCK = '-240,"Interlock open"'
    WATCHDOG = '-241,"Watchdog tripped"'
    OVERFLOW = '-350,"Queue overflow"'


class ShutterMode(Enum):
    """What times an exposure."""

    BULB = "BULB"
    WIDTH = "WIDTH"
    LAMP = "LAMP"


@dataclass(frozen=True, slots=True)
class Exposure:
    """One exposure, as decided when it began.

    Parameters
    ----------
    exposure_s : float
        Time that it was asked for.
    shutter_open_s : float
        Time that the shutter is open.
    lit : bool
        Whether the lamp lights it.
    level : float
        Lamp level, 0 to 1.
    mode : ShutterMode
        What times it.
    shot_id : str
        Its name, empty if the client gave none.
    shot : int
        Its number since power-up, from 1, if it completes.
    begin, end : float
        When the shutter opens and closes, on the wall clock.
    light_begin, light_end : float
        When the lamp is lit in it, on the wall clock; empty if it is not.
    output : float
        Light that the lamp gave, over what it gives at that level when nothing is wrong with it.
    """

    exposure_s: float
    shutter_open_s: float
    lit: bool
    level: float
    mode: ShutterMode
    shot_id: str
    shot: int
    begin: float
    end: float
    light_begin: float
    light_end: float
    output: float = 1.0


class _Refusal(Exception):  # noqa: N818 - not an error of ours: an entry for the queue
    def __init__(self, error: LampError) -> None:
        self.error = error
        super().__init__(error.value)


class Lamp:
    """The controller's firmware.

    Parameters
    ----------
    now : float
        Time of power-up.
    speed : float
        How many times faster than the clock exposures run.
    serial : str
        Serial number in `*IDN?`.
    on_event : callable (event, time, details)
        Called with "light" (details: on), "shutter" (details: open, and of the exposure), "watchdog",
        "interlock" and "aborted".
    on_exposure : callable (exposure, time)
        Called when an exposure has completed.
    """

    def __init__(
        self,
        now: float,
        *,
        speed: float = 1.0,
        serial: str = "twin",
        on_event: Callable[[str, float, dict[str, object]], None],
        on_exposure: Callable[[Exposure, float], None],
    ) -> None:
        self._speed, self._serial = speed, serial
        self._on_event, self._on_exposure = on_event, on_exposure
        self._running: Exposure | None = None
        self._light_edges: list[float] = []
        self._light, self._interlock_closed = False, True
        self._ageing = (now, 1.0, now, 1.0)
        self._power(now)
        self._queries: dict[str, Callable[[float], str]] = {
            "*IDN?": lambda _now: f"gonio,lamp,{self._serial},{FIRMWARE}",
            "OUTP?": lambda _now: str(int(self._output)),
            "SOUR:LEV?": lambda _now: _decimal(self._level),
            "SHUT:MODE?": lambda _now: self._mode.value,
            "SHUT:OPEN?": lambda _now: _decimal(self._open_s),
            "SHUT?": lambda _now: f"{'BUSY' if self._running else 'IDLE'},{self._completed},{self._last_id}",
            "MEAS:MON?": lambda now: _decimal(self._monitored(now)),
            "MEAS:TEMP?": lambda _now: f"{HEAD_TEMPERATURE_DEG_C:.1f}",
            "INTL?": lambda _now: str(int(self._interlock_closed)),
            "SYST:WDOG?": lambda _now: _decimal(self._watchdog_s),
            "SYST:ERR?": lambda _now: (self._errors.popleft() if self._errors else LampError.NONE).value,
            "SYST:UPT?": lambda now: f"{now - self._power_up:.3f}",
        }
        self._commands: dict[str, Callable[[str, float], None]] = {
            "*RST": self._reset,
            "OUTP": self._set_output,
            "SOUR:LEV": self._set_level,
            "SHUT:MODE": self._set_mode,
            "SHUT:OPEN": self._set_open,
            "SHUT:ID": self._set_id,
            "SHUT:EXP": self._expose,
            "SHUT:DARK": self._expose_dark,
            "SHUT:ABOR": self._abort_command,
            "SYST:WDOG": self._set_watchdog,
        }

    def _power(self, now: float) -> None:
        """Everything as after power-up."""
        self._power_up = self._heard = now
        self._line = bytearray()
        self._errors: deque[LampError] = deque()
        self._completed, self._last_id, self._next_id = 0, "", ""
        self._open_s, self._tripped = 1.0, False
        self._brightness: deque[tuple[float, float]] = deque([(now, 0.0)])
        self._monitor = math.nan
        self._output, self._level, self._mode, self._watchdog_s = False, 1.0, ShutterMode.BULB, 0.0

    # -- what the server asks

    @property
    def exposure(self) -> Exposure | None:
        """The running exposure."""
        return self._running

    def deadline(self) -> float | None:
        """When something will happen by itself; None if nothing will."""
        times = [*self._light_edges]
        if self._running:
            times.append(self._running.end)
        if (trip := self._trip_time()) is not None:
            times.append(trip)
        return min(times, default=None)

    def advance(self, now: float) -> None:
        """Let happen, in order, what was due until now."""
        while (due := self.deadline()) is not None and due <= now:
            trip = self._trip_time()
            if trip is not None and trip <= due:
                self._tripped = True
                self._on_event("watchdog", due, {"limit_s": self._watchdog_s})
                self._darken(due)
            elif due in self._light_edges:
                self._light_edges.remove(due)
                self._follow_light(due)
            elif self._running:
                self._complete(self._running, due)

    def handle(self, data: bytes, now: float) -> bytes:
        """Take bytes off the line and return the answers."""
        self.advance(now)
        answers = []
        for byte in data:
            if byte == ord("\n"):
                answers.append(self._obey(bytes(self._line), now))
                self._line.clear()
            elif byte != ord("\r") and len(self._line) <= _LONGEST_LINE:
                self._line.append(byte)
        return "".join(answers).encode()

    def forget_partial_line(self) -> None:
        """Drop the beginning of a line whose sender is gone."""
        self._line.clear()

    def set_interlock(self, closed: bool, now: float) -> None:
        """Close or open the interlock loop; opening it forces the light off."""
        self.advance(now)
        self._interlock_closed = closed
        self._on_event("interlock", now, {"closed": closed})
        if not closed and (self._running is None or self._running.lit):
            self._darken(now)

    # -- what goes wrong

    def set_output(self, factor: float, now: float) -> None:
        """Let the lamp give so many times the light that its level says, from now on."""
        self.drift(factor, now, now)

    def drift(self, factor: float, now: float, until: float) -> None:
        """Let the lamp's light go to so many times what its level says, evenly until then."""
        self.advance(now)
        self._ageing = (now, self._output_at(now), until, factor)
        self._follow_light(now)

    def restart(self, now: float) -> None:
        """Cut the power for a moment: the light is off, and nothing is remembered."""
        self.advance(now)
        self._darken(now)
        self._power(now)

    def _output_at(self, time: float) -> float:
        begin, before, end, after = self._ageing
        if time >= end:
            return after
        return before + (after - before) * max(time - begin, 0.0) / (end - begin)

    # -- the line

    def _obey(self, line: bytes, now: float) -> str:
        try:
            text = line.decode("ascii").strip()
        except UnicodeDecodeError:
            text = "\x00"
        if not text:
            return ""
        header, _, argument = text.partition(" ")
        header, argument = header.upper(), argument.strip()
        if len(line) > _LONGEST_LINE:
            header = ""  # no header of ours is that long
        try:
            answer = self._dispatch(header, argument, now)
        except _Refusal as refusal:
            self._queue(refusal.error)
            if refusal.error in {LampError.HEADER, LampError.RANGE}:
                return ""  # not a valid line: the watchdog did not hear it
            answer = ""
        self._heard = now
        return answer

    def _dispatch(self, header: str, argument: str, now: float) -> str:
        if header in self._queries:
            if argument:
                raise _Refusal(LampError.HEADER)
            return self._queries[header](now) + "\n"
        if header not in self._commands:
            raise _Refusal(LampError.HEADER)
        self._commands[header](argument, now)
        return ""

    def _queue(self, error: LampError) -> None:
        if len(self._errors) < _QUEUE_LENGTH:
            self._errors.append(error)
        else:
            self._errors[-1] = LampError.OVERFLOW

    # -- commands

    def _reset(self, argument: str, now: float) -> None:
        _no_argument(argument)
        self._darken(now)
        self._level, self._mode, self._watchdog_s, self._tripped = 1.0, ShutterMode.BULB, 0.0, False
        self._errors.clear()

    def _set_output(self, argument: str, now: float) -> None:
        match argument.upper():
            case "ON":
                self._require_light_allowed()
                self._output = True
                self._follow_light(now)
            case "OFF":
                self._darken(now)
            case _:
                raise _Refusal(LampError.RANGE)

    def _set_level(self, argument: str, now: float) -> None:
        self._level = _number(argument, (0.0, 1.0))
        self._follow_light(now)

    def _set_mode(self, argument: str, _now: float) -> None:
        try:
            self._mode = ShutterMode(argument.upper())
        except ValueError:
            raise _Refusal(LampError.RANGE) from None

    def _set_open(self, argument: str, _now: float) -> None:
        self._open_s = _number(argument, OPEN_RANGE_S)

    def _set_id(self, argument: str, _now: float) -> None:
        if not _SHOT_ID.fullmatch(argument):
            raise _Refusal(LampError.RANGE)
        self._next_id = self._last_id = argument

    def _set_watchdog(self, argument: str, _now: float) -> None:
        seconds = _number(argument, (0.0, WATCHDOG_RANGE_S[1]))
        if 0.0 < seconds < WATCHDOG_RANGE_S[0]:
            raise _Refusal(LampError.RANGE)
        self._watchdog_s, self._tripped = seconds, False

    def _expose(self, argument: str, now: float) -> None:
        lit = self._output or self._mode is ShutterMode.LAMP
        self._begin(_number(argument, EXPOSURE_RANGE_S), lit, now)

    def _expose_dark(self, argument: str, now: float) -> None:
        self._begin(_number(argument, EXPOSURE_RANGE_S), False, now)

    def _abort_command(self, argument: str, now: float) -> None:
        _no_argument(argument)
        self._abort(now)

    def _require_light_allowed(self) -> None:
        if not self._interlock_closed:
            raise _Refusal(LampError.INTERLOCK)
        if self._tripped:
            raise _Refusal(LampError.WATCHDOG)

    # -- exposures

    def _begin(self, exposure_s: float, lit: bool, now: float) -> None:
        if self._running:
            raise _Refusal(LampError.RUNNING)
        if self._tripped:
            raise _Refusal(LampError.WATCHDOG)
        if lit and not self._interlock_closed:
            raise _Refusal(LampError.INTERLOCK)
        timed_by_lamp = self._mode is ShutterMode.LAMP
        if timed_by_lamp and exposure_s > self._open_s:
            raise _Refusal(LampError.RANGE)  # the shutter would cut the light short
        open_s = self._open_s if timed_by_lamp else exposure_s
        begin, end = now, now + open_s / self._speed
        light_begin = begin + (open_s - exposure_s) / 2.0 / self._speed
        self._running = Exposure(
            exposure_s,
            open_s,
            lit,
            self._level,
            self._mode,
            self._next_id,
            self._completed + 1,
            begin,
            end,
            light_begin if lit else end,
            light_begin + exposure_s / self._speed if lit else end,
        )
        self._next_id = ""
        if lit and timed_by_lamp:
            self._light_edges = [light_begin, self._running.light_end]
        self._on_event("shutter", now, {"open": True, **_summary(self._running)})
        self._follow_light(now)

    def _complete(self, exposure: Exposure, now: float) -> None:
        self._close_shutter(exposure, now)
        self._completed += 1
        output = self._output_at((exposure.light_begin + exposure.light_end) / 2.0)
        if exposure.lit:
            self._monitor = exposure.level * output
        self._on_exposure(replace(exposure, output=output), now)

    def _abort(self, now: float) -> None:
        if self._running:
            exposure = self._running
            self._close_shutter(exposure, now)
            self._on_event("aborted", now, _summary(exposure))

    def _close_shutter(self, exposure: Exposure, now: float) -> None:
        self._running, self._light_edges = None, []
        self._on_event("shutter", now, {"open": False, **_summary(exposure)})
        self._follow_light(now)

    # -- light

    def _darken(self, now: float) -> None:
        """Light off at once; a running exposure counts as aborted."""
        self._output = False
        self._follow_light(now, forced_off=True)
        self._abort(now)

    def _follow_light(self, now: float, *, forced_off: bool = False) -> None:
        """Switch the lamp as output, exposure and time demand."""
        exposure = self._running
        if exposure:
            on = exposure.lit and exposure.light_begin <= now < exposure.light_end
            level = exposure.level
        else:
            on, level = self._output, self._level
        on = on and not forced_off
        if on != self._light:
            self._light = on
            self._on_event("light", now, {"on": on, "level": level})
        self._brightness.append((now, level * self._output_at(now) if on else 0.0))
        while len(self._brightness) > 2 and self._brightness[1][0] < now - _MONITOR_S / self._speed:
            self._brightness.popleft()

    def _trip_time(self) -> float | None:
        armed = self._watchdog_s > 0.0 and not self._tripped
        return self._heard + self._watchdog_s if armed else None

    def _monitored(self, now: float) -> float:
        """Photodiode's mean over the last 0.1 s while the light is on, else over the last lit exposure."""
        if not self._light:
            return self._monitor
        window_begin = now - _MONITOR_S / self._speed
        total, end = 0.0, now
        for time, level in reversed(self._brightness):
            begin = max(time, window_begin)
            total += level * (end - begin)
            end = begin
            if begin == window_begin:
                break
        return total / (now - window_begin)


def _summary(exposure: Exposure) -> dict[str, object]:
    return {
        "shot": exposure.shot,
        "id": exposure.shot_id,
        "exposure_s": exposure.exposure_s,
        "shutter_open_s": exposure.shutter_open_s,
        "mode": exposure.mode.value,
        "lit": exposure.lit,
    }


def _no_argument(argument: str) -> None:
    if argument:
        raise _Refusal(LampError.RANGE)


def _decimal(value: float) -> str:
    """Write a number without an exponent, which small controllers do not write either."""
    text = f"{value:.9f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _number(argument: str, bounds: tuple[float, float]) -> float:
    """Decimal number within bounds; words, nan and infinities are out of range like any other number."""
    if not _NUMBER.fullmatch(argument.upper()):
        raise _Refusal(LampError.RANGE)
    value = float(argument)
    if not bounds[0] <= value <= bounds[1]:
        raise _Refusal(LampError.RANGE)
    return value
