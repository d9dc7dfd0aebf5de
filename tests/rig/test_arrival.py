"""When a move counts as arrived, and when it is given up, on servos behind a wire."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

import rig.arrival
from rig.bus import ServoBus
from rig.description import default_rig
from rig.errors import Unsafe
from rig.handshake import ServoSpec
from rig.servos import Servos
from simulator.shaft import Flaws

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

SPECS = [ServoSpec.of(joint) for joint in default_rig().joints[:3]]


@pytest.fixture
def attached(servo_bench: Callable[..., Any]) -> Iterator[Callable[..., tuple[Any, Servos]]]:
    """Return a maker of attached servos on a bench."""
    buses: list[ServoBus] = []

    def make(speed: float = 50.0, specs: list[ServoSpec] = SPECS, **options: Any) -> tuple[Any, Servos]:
        bench = servo_bench(3, speed)
        buses.append(ServoBus(bench.port, 1_000_000))
        servos = Servos(buses[-1], specs, **options)
        servos.attach()
        return bench, servos

    yield make
    for bus in buses:
        bus.close()


@pytest.mark.parametrize("reads", [1, 8])
def test_arrival_needs_so_many_quiet_reads(attached: Callable[..., Any], reads: int) -> None:
    """Would catch a single look that passes for standing still."""
    bench, servos = attached(settle_reads=reads)
    positions: list[tuple[int, int]] = []
    real = servos.bus.sync_read

    def spied(*args: Any, **options: Any) -> Any:
        states = real(*args, **options)
        if "moving" in states[1].values:
            positions.append((states[1]["present_position"], states[1]["moving"]))
        return states

    servos.bus.sync_read = spied  # type: ignore[method-assign]
    servos.move({1: 2500})
    assert len(positions) > reads
    quiet = [abs(ticks - 2500) <= SPECS[0].tolerance and not moving for ticks, moving in positions]
    assert all(quiet[-reads:])
    assert not bench.servos[1].moving(time.monotonic())


def test_one_restless_read_begins_the_count_anew(attached: Callable[..., Any]) -> None:
    """Would catch quiet reads that are added up over an arm that swings."""
    _, servos = attached(settle_reads=4)
    servos.move({1: 2500})
    real, looks = servos.bus.sync_read, []

    def swinging(*args: Any, **options: Any) -> Any:
        states = real(*args, **options)
        if "moving" not in states[1].values:
            return states
        looks.append(len(looks))
        if len(looks) in {4, 7}:
            states[1].values["moving"] = 1
        return states

    servos.bus.sync_read = swinging  # type: ignore[method-assign]
    servos.move({1: 2500})
    assert len(looks) >= 7 + 4


def test_an_arm_that_creeps_is_given_up_at_a_deadline_from_distance_and_profile(
    attached: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch a wait without an end for an arm that always comes a little closer."""
    monkeypatch.setattr(rig.arrival, "MARGIN_S", 0.2)
    bench, servos = attached(speed=1.0)
    bench.servos[1].hinder(0.1, time.monotonic(), math.inf)
    for distance in (40, 160):
        start = servos.present()[1]
        allowed_s = 1.5 * SPECS[0].duration_s(distance) + 0.2
        began_s = time.monotonic()
        with pytest.raises(Unsafe, match="degrees short"):
            servos.move({1: start + distance})
        assert time.monotonic() - began_s >= 0.99 * allowed_s
        servos.halt()


def test_a_steady_error_beyond_the_tolerance_is_no_arrival_and_one_inside_is_recorded(
    attached: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch a goal that is recorded where the arm stands elsewhere."""
    monkeypatch.setattr(rig.arrival, "STALL_S", 0.1)
    for tolerance, arrives in ((3, False), (12, True)):
        specs = [replace(spec, tolerance=tolerance) for spec in SPECS]
        bench, servos = attached(specs=specs)
        bench.servos[2]._drive._flaws = Flaws(steady_error_ticks=8.0)
        if not arrives:
            with pytest.raises(Unsafe, match=r"servo 2.*if it only sags, raise tolerance_deg"):
                servos.move({2: 2600})
            continue
        measured = servos.move({2: 2600})
        assert 6 <= abs(measured[2] - 2600) <= 10
        assert measured[2] == bench.servos[2].present_ticks(time.monotonic())
