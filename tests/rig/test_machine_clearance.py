"""Moves of the machine past its own solids: a goal on the wire unchecked, a way not taken."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from rig.clearance import Clearance
from rig.description import load_rig
from rig.errors import Refused
from rig.machine import open_machine
from rig.motion import Moves
from rig.swept import near_poses
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rig.description import Rig

GOAL_SYNC_WRITE = bytes([0x83, 116, 0, 4, 0])
BEFORE, BEHIND = (0.0, 0.0, -0.6, 0.0), (0.0, 0.0, 0.6, 0.0)
"""The camera on either side of the lamp: straight on it would hit the stem."""


@pytest.fixture(scope="module")
def moving_twin() -> Iterator[Twin]:
    """Return a twin that makes no pictures."""
    with Twin(speed=100.0) as twin:
        yield twin


@pytest.fixture
def moving_rig(moving_twin: Twin) -> Rig:
    """Return its rig."""
    return load_rig(moving_twin.rig)


def goals_written(twin: Twin, since: float) -> int:
    """Count the writes of goals that the servos heard."""
    return sum(
        bytes.fromhex(event["data"]).count(GOAL_SYNC_WRITE)
        for event in twin.wire_log()
        if event["t"] >= since and event["line"] == "servos" and event.get("direction") == "in"
    )


def test_a_pose_that_collides_is_refused_before_the_first_goal(moving_twin: Twin, moving_rig: Rig) -> None:
    """Catches a check that comes after the arms have begun to move."""
    with open_machine(moving_rig) as machine:
        machine.move(BEFORE)
        since = time.monotonic()
        with pytest.raises(Refused, match="lamp_stem and camera"):
            machine.move((0.0, 0.0, 0.0, 0.0))
        assert goals_written(moving_twin, since) == 0
        assert machine.move(BEFORE).angles_rad[2] == pytest.approx(-0.6, abs=2e-3)


def test_the_arms_go_round_what_is_in_their_way(moving_twin: Twin, moving_rig: Rig) -> None:
    """Catches a blocked move that is made all the same: all stops on the way must be clear, and all legs."""
    clearance = Clearance(moving_rig)
    assert not clearance.moves(np.array([BEFORE]), np.array([BEHIND])).clear[0]
    with open_machine(moving_rig) as machine:
        stops = [np.array(machine.move(BEFORE).angles_rad)]
        move = machine.arms.move

        def spied(angles_rad: tuple[float, ...], station: str | None = None, **how: Any) -> object:
            held = move(angles_rad, station, **how)
            stops.append(np.array(held.angles_rad))
            return held

        machine.arms.move = spied  # type: ignore[method-assign, assignment]
        assert machine.move(BEHIND).angles_rad == pytest.approx(BEHIND, abs=2e-3)
    assert len(stops) > 2
    legs = Moves(np.stack(stops[:-1]), np.stack(stops[1:]), clearance.profile)
    for share in np.linspace(0.0, 1.0, 101):
        on_the_way = legs.at(np.arange(len(legs.start)), np.full(len(legs.start), share))
        assert near_poses(clearance.pairs, on_the_way).clear.all()
