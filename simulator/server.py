"""The twin's wire process: one loop that serves both lines and keeps time.

Everything that a client waits for is answered here and at once; frames are rendered by the light process.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from rig.control_table import BAUD_CODES
from rig.errors import BadInput
from rig.servo_models import MODELS
from simulator.drive import TICKS_PER_TURN
from simulator.fault_injector import FaultInjector
from simulator.faults import FaultScript, load_faults
from simulator.lamp import Exposure, Lamp
from simulator.light_link import LightLink
from simulator.light_process import LightSettings
from simulator.pty_line import PtyLine
from simulator.servo import Servo
from simulator.servo_line import ServoLine
from simulator.shaft import Flaws
from simulator.twin_folder import twin_folder
from simulator.wire_log import WireLog

if TYPE_CHECKING:
    from pathlib import Path
    from types import FrameType

    from simulator.options import TwinSettings

Announce = Callable[[dict[str, Any]], None]
"""Called once with the twin's ports when it serves."""

_FLUSH_S = 0.1
_HANG_UP = select.EPOLLHUP


def serve(settings: TwinSettings, announce: Announce) -> int:
    """Run a twin until it is told to stop by a signal or by the end of `settings.commands`.

    Parameters
    ----------
    settings : TwinSettings
    announce : callable
        Called with `servos`, `baud`, `ids`, `lamp`, `frames` and `rig` when everything is ready.

    Returns
    -------
    int
        The signal that ended it; 0 if none did.

    Raises
    ------
    GonioError
        A rig file, material or folder that cannot be used, or that another twin uses; a light process that
        died.
    """
    if not 0.0 < settings.speed < float("inf"):
        raise BadInput(
            f"a speed of {settings.speed:g}", where="twin", todo="give a factor above 0, such as 10"
        )
    os.umask(0o022)
    with twin_folder(settings.folder) as folder:
        server = _Server(settings, folder)
        try:
            return server.run(announce)
        finally:
            server.close()


class _Server:
    """Both lines, what is behind them, and the loop."""

    def __init__(self, settings: TwinSettings, folder: Path) -> None:
        self._settings, self._folder = settings, folder
        self._light_settings = LightSettings(
            folder=str(folder),
            servos=str(folder / "servos"),
            lamp=str(folder / "lamp"),
            rig=settings.rig,
            materials=settings.materials,
            seed=settings.seed,
            variant=settings.variant,
            housing_albedo=settings.housing_albedo,
            tolerance=settings.tolerance,
        )
        self._stopped_by: int | None = None
        self._ended = False
        self._poller = select.epoll()
        self._log = WireLog(folder / "wire.log" if settings.log else None)
        self._servo_pty = PtyLine(folder / "servos", self._poller)
        self._lamp_pty = PtyLine(folder / "lamp", self._poller)
        self._light = LightLink(self._light_settings)
        self._lamp = Lamp(
            time.monotonic(),
            speed=settings.speed,
            serial=f"twin{settings.seed}",
            on_event=self._note,
            on_exposure=self._order_frame,
        )
        self._begun = 0
        self._joints: tuple[str, ...] = ()
        self._line = ServoLine(())
        self._faults = self._injector(FaultScript())
        self._wake_read, self._wake_write = os.pipe()

    def run(self, announce: Announce) -> int:
        """Serve until told to stop; the number of the signal, or 0."""
        with self._signals():
            machine = self._light.wait_until_ready()
            self._power_up(machine)
            for fd in (self._light.fd, self._wake_read, self._settings.commands):
                if fd is not None:
                    self._poller.register(fd, select.EPOLLIN)
            announce(
                {
                    "servos": self._light_settings.servos,
                    "baud": machine["baud"],
                    "ids": [servo.servo_id for servo in self._line.servos],
                    "lamp": self._light_settings.lamp,
                    "frames": str(self._light_settings.frames),
                    "rig": str(self._light_settings.rig_file),
                }
            )
            while not self._ended and self._stopped_by is None:
                self._turn()
        return self._stopped_by or 0

    def close(self) -> None:
        """Let everything go."""
        self._light.close()
        self._servo_pty.close()
        self._lamp_pty.close()
        self._log.close()
        self._poller.close()
        os.close(self._wake_read)
        os.close(self._wake_write)

    # -- start

    @contextlib.contextmanager
    def _signals(self) -> Iterator[None]:
        """Have SIGINT, SIGTERM and SIGHUP end the loop, not the process."""

        def stop(number: int, _frame: FrameType | None) -> None:
            self._stopped_by = number
            os.write(self._wake_write, b"!")

        caught = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        before = [signal.signal(number, stop) for number in caught]
        try:
            yield
        finally:
            for number, handler in zip(caught, before, strict=True):
                signal.signal(number, handler)

    def _power_up(self, machine: dict[str, Any]) -> None:
        """Switch the servos on, parked, at the rig's baud rate."""
        codes = {baud: code for code, baud in BAUD_CODES.items()}
        eeprom = {"baud_rate": codes[machine["baud"]]} if machine["baud"] in codes else {}
        unknown = [joint["model"] for joint in machine["joints"] if joint["model"] not in MODELS]
        if unknown:
            raise BadInput(f"no model {unknown[0]!r}", where="rig", todo=f"one of {', '.join(MODELS)}")
        self._joints = tuple(joint["name"] for joint in machine["joints"])
        script = load_faults(self._settings.faults, self._joints) if self._settings.faults else FaultScript()
        now = time.monotonic()
        flaws = Flaws(self._settings.backlash_deg / 360.0 * TICKS_PER_TURN, self._settings.steady_error_ticks)
        self._line = ServoLine(
            [
                Servo(
                    joint["id"],
                    joint["model"],
                    shaft_ticks=joint["ticks"],
                    speed=self._settings.speed,
                    now=now,
                    eeprom=eeprom,
                    flaws=flaws,
                )
                for joint in machine["joints"]
            ]
        )

        self._faults = self._injector(script)

    def _injector(self, script: FaultScript) -> FaultInjector:
        return FaultInjector(
            script,
            servos=dict(zip(self._joints, self._line.servos, strict=True)),
            lamp=self._lamp,
            lines={"servos": self._servo_pty, "lamp": self._lamp_pty},
            now=time.monotonic(),
            on_event=self._log.event,
        )

    # -- the loop

    def _turn(self) -> None:
        """Wait for the next thing to do, and do it."""
        events = self._poller.poll(self._timeout_s())
        self._lamp.advance(time.monotonic())
        self._faults.advance(time.monotonic())
        for fd, event in events:
            if fd == self._servo_pty.fd:
                self._serve_servos(hung_up=bool(event & _HANG_UP))
            elif fd == self._lamp_pty.fd:
                self._serve_lamp(hung_up=bool(event & _HANG_UP))
            elif fd == self._light.fd:
                self._hear_of_frames()
            elif fd == self._settings.commands:
                self._obey(fd)
        if not events and self._log.dirty:
            self._log.flush()

    def _timeout_s(self) -> float:
        """Time until lamp or fault do something by themselves, or the log wants a flush; -1 for ever."""
        dues = (self._lamp.deadline(), self._faults.deadline())
        times = [max(due - time.monotonic(), 0.0) for due in dues if due is not None]
        if self._log.dirty:
            times.append(_FLUSH_S)
        return min(times, default=-1.0)

    def _serve_servos(self, *, hung_up: bool) -> None:
        data, now = self._servo_pty.read(), time.monotonic()
        answer = self._line.handle(self._faults.heard("servos", data, now), now)
        answer = self._faults.say("servos", answer, now)
        self._servo_pty.write(answer)
        self._log.wire("servos", "in", data, now)
        self._log.wire("servos", "out", answer, now)
        if hung_up and self._servo_pty.renew_if_abandoned():
            self._line.forget_partial_packet()
            self._log.event("client_gone", now, {"port": "servos"})

    def _serve_lamp(self, *, hung_up: bool) -> None:
        data, now = self._lamp_pty.read(), time.monotonic()
        self._log.wire("lamp", "in", data, now)
        answer = self._lamp.handle(self._faults.heard("lamp", data, now), now)
        answer = self._faults.say("lamp", answer, now)
        self._lamp_pty.write(answer)
        self._log.wire("lamp", "out", answer, now)
        if hung_up and self._lamp_pty.renew_if_abandoned():
            self._lamp.forget_partial_line()
            self._log.event("client_gone", now, {"port": "lamp"})
        for _ in range(self._begun):
            self._faults.exposure_begins(now)
        self._begun = 0

    def _note(self, event: str, now: float, details: dict[str, Any]) -> None:
        """Log what lamp and shutter did; faults that wait for an exposure come when the lamp has finished."""
        self._log.event(event, now, details)
        self._begun += event == "shutter" and bool(details["open"])

    def _obey(self, fd: int) -> None:
        """Flush the log for each line from whoever started the twin; end with the last of them."""
        lines = os.read(fd, 4096)
        self._log.flush()
        for _ in range(lines.count(b"\n")):
            print('{"flushed": true}', flush=True)  # noqa: T201 - the agreed answer
        self._ended = not lines

    # -- frames

    def _order_frame(self, exposure: Exposure, end: float) -> None:
        """Have a frame rendered at the pose that the arms held when the shutter closed."""
        ticks = {
            name: servo.shaft_ticks(end) for name, servo in zip(self._joints, self._line.servos, strict=True)
        }
        behind = {
            name: servo.behind_ticks() for name, servo in zip(self._joints, self._line.servos, strict=True)
        }
        moved = any(
            servo.moving(end) or servo.shaft_ticks(exposure.begin) != ticks[name]
            for name, servo in zip(self._joints, self._line.servos, strict=True)
        )
        self._log.event(
            "exposed",
            end,
            {
                "shot": exposure.shot,
                "id": exposure.shot_id,
                "moved": moved,
                "ticks": ticks,
                "behind": behind,
                "output": exposure.output,
            },
        )
        self._light.order(
            {
                "ticks": ticks,
                "behind": behind,
                "level": exposure.level,
                "exposure_s": exposure.exposure_s,
                "shutter_open_s": exposure.shutter_open_s,
                "lit": exposure.lit,
                "mode": exposure.mode.value,
                "shot_id": exposure.shot_id,
                "shot": exposure.shot,
                "output": exposure.output,
                "fault": self._faults.of_frame(),
            }
        )

    def _hear_of_frames(self) -> None:
        now = time.monotonic()
        for answer in self._light.answers():
            if "error" in answer:
                self._log.event("frame_failed", now, answer)
                error = answer["error"]
                print(f"twin: {error['where']}: {error['what']}", file=sys.stderr, flush=True)  # noqa: T201
            else:
                self._log.event("frame", now, answer)
