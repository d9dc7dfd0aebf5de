"""Benches for the drivers: emulated servos and lamp behind a pseudo-terminal, with faults on demand."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from typing import TYPE_CHECKING, Any

import pytest

from simulator.lamp import Lamp as TwinLamp
from simulator.servo import Servo
from simulator.servo_line import ServoLine
from simulator.twin import Twin
from tests.rig.lamp_firmware import FirmwareLamp

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


WAIT_S = 30.0
"""How long a test waits for what must come: much longer than it takes on the slowest computer."""


def until(condition: Callable[[], object]) -> None:
    """Wait until something holds: as long as this computer takes, however busy it is."""
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, "it did not come"
        time.sleep(0.005)


class Bench:
    """A device on a pseudo-terminal: what it hears, what it says, and what a fault makes of it."""

    def __init__(self) -> None:
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        self.port = os.ttyname(self._far)
        self.heard: list[tuple[float, bytes]] = []
        self.hears: Callable[[bytes], bytes] = lambda data: data
        self.says: Callable[[bytes, bytes], bytes] = lambda _request, reply: reply
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def answer(self, data: bytes) -> bytes:
        raise NotImplementedError

    @property
    def bytes_heard(self) -> bytes:
        return b"".join(data for _, data in self.heard)

    def unplug(self) -> None:
        if not self._stop.is_set():
            self._stop.set()
            self._thread.join()
            os.close(self._near)
            os.close(self._far)

    def _serve(self) -> None:
        while not self._stop.is_set():
            ready, _, _ = select.select([self._near], [], [], 0.002)
            data = os.read(self._near, 4096) if ready else b""
            if data:
                self.heard.append((time.monotonic(), data))
            reply = self.answer(self.hears(data) if data else b"")
            reply = self.says(data, reply) if data else reply
            if reply:
                os.write(self._near, reply)


class ServoBench(Bench):
    """Servos 1 to `count`."""

    def __init__(self, count: int = 3, speed: float = 1.0, models: dict[int, str] | None = None) -> None:
        now = time.monotonic()
        names = models or {}
        self.servos = {
            i: Servo(i, names.get(i, "XH430-W350"), speed=speed, now=now) for i in range(1, count + 1)
        }
        self.line = ServoLine(tuple(self.servos.values()))
        super().__init__()

    def answer(self, data: bytes) -> bytes:
        return self.line.handle(data, time.monotonic()) if data else b""


class LampBench(Bench):
    """The lamp controller: the twin's, or the compiled firmware."""

    def __init__(self, speed: float = 1.0, *, firmware: bool = False) -> None:
        self.events: list[tuple[str, float, dict[str, object]]] = []
        self._power_up = time.monotonic()
        hooks: Any = {
            "on_event": lambda event, now, details: self.events.append((event, now, details)),
            "on_exposure": lambda _exposure, _now: None,
        }
        self.controller: Any = FirmwareLamp(**hooks) if firmware else TwinLamp(0.0, speed=speed, **hooks)
        super().__init__()

    def answer(self, data: bytes) -> bytes:
        return bytes(self.controller.handle(data, self.now()))

    def now(self) -> float:
        """Seconds since power-up."""
        return time.monotonic() - self._power_up

    @property
    def lines(self) -> list[str]:
        return [line for line in self.bytes_heard.decode("ascii").split("\n") if line]

    @property
    def light(self) -> bool:
        edges = [details["on"] for event, _, details in self.events if event == "light"]
        return bool(edges and edges[-1])


@pytest.fixture
def servo_bench() -> Iterator[Callable[..., ServoBench]]:
    """Return a maker of servo benches; all are unplugged at the end."""
    benches: list[ServoBench] = []

    def make(*args: object, **options: object) -> ServoBench:
        benches.append(ServoBench(*args, **options))  # type: ignore[arg-type]
        return benches[-1]

    yield make
    for bench in benches:
        bench.unplug()


@pytest.fixture
def lamp_bench() -> Iterator[Callable[..., LampBench]]:
    """Return a maker of lamp benches; all are unplugged at the end."""
    benches: list[LampBench] = []

    def make(*args: object, **options: object) -> LampBench:
        benches.append(LampBench(*args, **options))  # type: ignore[arg-type]
        return benches[-1]

    yield make
    for bench in benches:
        bench.unplug()
        if isinstance(bench.controller, FirmwareLamp):
            bench.controller.close()


@pytest.fixture
def twin() -> Iterator[Twin]:
    """Return a twin of its own, a hundred times faster than the clock."""
    with Twin({"sample1": "lambert:kd=0.5"}, speed=100.0) as twin:
        yield twin
