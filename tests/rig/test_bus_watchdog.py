"""The servos' bus watchdog: armed during moves and at no other time, and never in the way."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest

from rig.bus import ServoBus
from rig.bus_watchdog import TRIPPED, armed, disarm
from rig.control_table import CONTROL_TABLE
from rig.description import default_rig
from rig.errors import Refused
from rig.handshake import ServoSpec
from rig.servos import Servos
from tests.rig.conftest import until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

GOAL_WRITE = bytes([0x83, CONTROL_TABLE["goal_position"].address, 0, 4, 0])
SPECS = tuple(ServoSpec.of(joint) for joint in default_rig().joints[:3])


@pytest.fixture
def bench(servo_bench: Callable[..., Any]) -> Any:
    """Return three servos at the clock's own speed."""
    return servo_bench(count=3, speed=1.0)


@pytest.fixture
def bus(bench: Any) -> Iterator[ServoBus]:
    """Return their bus."""
    with ServoBus(bench.port, timeout_s=0.05, retries=1) as bus:
        yield bus


def values(bench: Any) -> list[int]:
    """Every servo's watchdog."""
    return [servo.value("bus_watchdog") for servo in bench.servos.values()]


def test_armed_during_a_move_and_not_after(bench: Any, bus: ServoBus) -> None:
    """Catches arms that nobody watches, or that trip while they stand and the bus is silent."""
    servos = Servos(bus, SPECS, watchdog_s=0.5)
    servos.attach()
    assert values(bench) == [0, 0, 0]
    seen: list[int] = []

    def watch(request: bytes, reply: bytes) -> bytes:
        if GOAL_WRITE in request:
            seen.extend(values(bench))
        return reply

    bench.says = watch
    servos.move({1: 2100})
    assert seen == [25, 25, 25]
    assert values(bench) == [0, 0, 0]
    time.sleep(0.6)
    assert servos.move({1: 2048})[1] == 2048


def test_a_program_that_dies_on_the_way_stops_the_arm(bench: Any, bus: ServoBus) -> None:
    """Catches an arm that goes on to its goal though nobody looks any more."""
    Servos(bus, SPECS).attach()
    bus.sync_write("bus_watchdog", dict.fromkeys((1, 2, 3), 40))
    bus.write(1, "goal_position", 2900)
    until(lambda: bench.servos[1].shaft_ticks(time.monotonic()) and values(bench)[0] == TRIPPED)
    here = bench.servos[1].shaft_ticks(time.monotonic())
    assert 2048 < here < 2800
    time.sleep(0.1)
    assert bench.servos[1].shaft_ticks(time.monotonic()) == here


def test_a_tripped_watchdog_is_cleared_by_the_next_program(bench: Any, bus: ServoBus) -> None:
    """Catches a machine that refuses every goal after a crash until somebody cuts its power."""
    Servos(bus, SPECS).attach()
    bench.servos[2].trip_watchdog(time.monotonic())
    assert values(bench)[1] == TRIPPED
    servos = Servos(bus, SPECS)
    servos.attach()
    assert servos.move({2: 2060})[2] == 2060


def test_a_failure_inside_leaves_nothing_armed(bench: Any, bus: ServoBus) -> None:
    """Catches a watchdog left behind by a move that ended badly."""

    def fail() -> None:
        with armed(bus, (1, 2, 3), 1.0):
            assert bus.read(1, "bus_watchdog") == 50
            raise RuntimeError("on the way")

    with pytest.raises(RuntimeError, match="on the way"):
        fail()
    assert bus.read(1, "bus_watchdog") == 0


def test_zero_arms_nothing(bench: Any, bus: ServoBus) -> None:
    """Catches a watchdog that cannot be done without."""
    with armed(bus, (1, 2, 3), 0.0):
        assert bus.read(1, "bus_watchdog") == 0
    assert bench.heard  # it did ask


def test_one_that_stays_on_is_refused(bench: Any, bus: ServoBus) -> None:
    """Catches a watchdog that is believed to be off: it would stop the next pose."""
    bench.servos[3].trip_watchdog(time.monotonic())
    bench.hears = lambda data: b"" if data[7:8] == b"\x83" else data  # synchronous writes are lost
    with pytest.raises(Refused, match="does not switch off"):
        disarm(bus, (1, 2, 3))
