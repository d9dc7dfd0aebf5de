"""One-sided approaches on servos behind a wire: whatever was before, the last push has the same sign."""

from __future__ import annotations

import math
import random
import time
from typing import TYPE_CHECKING, Any

import pytest

from rig.arms import Arms
from rig.bus import ServoBus
from rig.description import default_rig, dump_rig, load_rig
from rig.errors import BadInput, Refused
from rig.handshake import ServoSpec
from rig.kinematics import Kinematics
from rig.machine import open_machine
from rig.servos import Servos
from rig.ticks import tick_rad, ticks_to_rad
from simulator.shaft import Flaws
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from rig.description import Rig


def rig_with(**approaches: str) -> Rig:
    """Return the default machine, some joints of it approached from one side."""
    rig = default_rig()
    joints = tuple(
        joint.model_copy(update={"approach": approaches.get(joint.name, "direct"), "overshoot_deg": 2.0})
        for joint in rig.joints
    )
    return rig.model_copy(update={"joints": joints})


class Legs:
    """Arms on a bench, each leg of their moves noted, as `Machine` goes them where no solids are."""

    def __init__(self, rig: Rig, bench: Any) -> None:
        self.rig, self.bench = rig, bench
        bus = ServoBus(bench.port, 1_000_000)
        self.servos = Servos(bus, [ServoSpec.of(joint) for joint in rig.joints], watchdog_s=0.0)
        self.servos.attach()
        self.arms = Arms(rig, self.servos, lambda: False)
        self.legs: list[tuple[dict[int, int], dict[int, int]]] = []
        real = self.servos.move

        def move(goals: Any, **options: Any) -> Any:
            start = self.servos.present()
            self.legs.append((start, {i: goals.get(i, start[i]) for i in start}))
            return real(goals, **options)

        self.servos.move = move  # type: ignore[method-assign]

    def go(self, angles_deg: list[float], station: str | None = None) -> tuple[int, ...]:
        """Move, and return where the arms stand."""
        angles = [math.radians(angle) for angle in angles_deg]
        lead = self.arms.lead_in(angles, station)
        if lead is not None:
            self.arms.move(lead, station, leading=True)
        return self.arms.move(angles, station).ticks


@pytest.fixture
def bench_of(servo_bench: Callable[..., Any]) -> Callable[..., Legs]:
    """Return a maker of arms on a bench, with flaws of every servo."""

    def make(rig: Rig, flaws: Flaws | None = None) -> Legs:
        bench = servo_bench(count=5, speed=400.0)
        for servo in bench.servos.values():
            servo._drive._flaws = flaws or Flaws()
        return Legs(rig, bench)

    return make


def test_the_last_push_has_its_side_and_all_legs_their_limits(bench_of: Callable[..., Legs]) -> None:
    """Would catch an approach from the wrong side after some start, or a lead-in beyond the limits."""
    rig = rig_with(light_elevation="from_below", camera_elevation="from_above", station_wheel="from_below")
    legs, draw = bench_of(rig), random.Random(1)  # noqa: S311
    specs = [ServoSpec.of(joint) for joint in rig.joints]
    overshoot = {spec.servo_id: math.floor(2.0 / spec.tick_deg) for spec in specs}
    sides = {1: 1, 3: -1, 5: 1}
    angles = [[0.0, 0.0, 0.0, 0.0]] * 2
    angles += [[draw.uniform(*joint.reach_deg) for joint in rig.arm_joints] for _ in range(6)]
    angles += [[-83.0, 0.0, 83.0, 0.0], [85.0, 0.0, -85.0, 0.0]]
    for pose in angles:
        before = len(legs.legs)
        legs.go(pose, draw.choice(list(rig.stations)))
        assert len(legs.legs) - before in {1, 2}
        for spec in specs:
            side = sides.get(spec.servo_id)
            pushes = [
                goals[spec.servo_id] - start[spec.servo_id]
                for start, goals in legs.legs[before:]
                if abs(goals[spec.servo_id] - start[spec.servo_id]) > spec.tolerance
            ]
            assert all(spec.minimum <= goals[spec.servo_id] <= spec.maximum for _, goals in legs.legs)
            if side is not None:
                assert pushes[-1] * side >= overshoot[spec.servo_id] - spec.tolerance
            elif spec.servo_id != 5:
                assert len(pushes) <= 1


def test_play_that_a_direct_move_leaves_is_taken_up(bench_of: Callable[..., Legs]) -> None:
    """Would catch an approach that goes the longer way and still ends at the other end of the play."""
    flaws = Flaws(backlash_ticks=12.0)
    spread = {}
    for approach in ("direct", "from_below"):
        legs = bench_of(rig_with(light_elevation=approach), flaws)
        shafts = []
        for before in (-20.0, 40.0, 9.5, 10.5):
            legs.go([before, 0.0, 0.0, 0.0])
            legs.go([10.0, 0.0, 0.0, 0.0])
            servo = legs.bench.servos[1]
            shafts.append(servo.present_ticks(time.monotonic()) + servo.behind_ticks())
        spread[approach] = max(shafts) - min(shafts)
    assert spread["direct"] > 6.0
    assert spread["from_below"] < 3.0


def test_the_machine_approaches_round_its_solids_too(tmp_path: Path) -> None:
    """Would catch a lead-in that only machines without solids take."""
    dump_rig(rig_with(camera_elevation="from_below"), tmp_path / "rig.toml")
    with Twin({"sample1": "lambert:kd=0.5"}, speed=200.0, rig=tmp_path / "rig.toml") as twin:
        rig = load_rig(twin.rig)
        assert rig.solids
        goals: list[int] = []
        with open_machine(rig) as machine:
            real = machine.arms._servos.move

            def move(wanted: Any, **options: Any) -> Any:
                goals.append(wanted[3])
                return real(wanted, **options)

            machine.arms._servos.move = move  # type: ignore[method-assign]
            for camera_deg in (60.0, 30.0):
                goals.clear()
                held = machine.move([math.radians(angle) for angle in (-30.0, 0.0, camera_deg, 0.0)])
                overshoot = math.ceil(2.0 / math.degrees(tick_rad(rig.joints[2])))
                assert goals[-1] == pytest.approx(held.ticks[2], abs=1)
                if camera_deg == 30.0:  # from above
                    assert goals[-2] == goals[-1] - overshoot


def test_poses_without_room_for_the_approach_are_out_of_reach(bench_of: Callable[..., Legs]) -> None:
    """Would catch a pose at the limit that is silently approached from the other side."""
    rig = rig_with(light_elevation="from_below")
    legs = bench_of(rig)
    with pytest.raises(Refused, match=r"-84.00 degrees, allowed are -83 to 85"):
        legs.go([-84.0, 0.0, 0.0, 0.0])
    with pytest.raises(Refused, match="beyond its limits -83 to 85"):
        Kinematics(rig).check([math.radians(-84.0), 0.0, math.radians(30.0), 0.0])
    Kinematics(rig).check([math.radians(-83.0), 0.0, math.radians(30.0), 0.0])


@pytest.mark.parametrize(
    ("field", "value", "what"),
    [("park_deg", -84.5, "park_deg"), ("limits_deg", (-0.5, 85.0), "overshoot_deg")],
)
def test_a_rig_file_that_leaves_no_room_is_refused(tmp_path: Path, field: str, value: Any, what: str) -> None:
    """Would catch a machine that can never park, or never reach its zero."""
    rig = rig_with(light_elevation="from_below")
    joints = tuple(
        joint.model_copy(update={"park_deg": 0.0} | ({field: value} if joint.id == 1 else {}))
        for joint in rig.joints
    )
    dump_rig(rig.model_copy(update={"joints": joints}), tmp_path / "rig.toml")
    with pytest.raises(BadInput, match=what):
        load_rig(tmp_path / "rig.toml")


def test_a_direct_machine_is_not_asked_where_it_stands(bench_of: Callable[..., Legs]) -> None:
    """Would catch a look at the bus for every move of a machine without one-sided joints."""
    legs = bench_of(rig_with())
    legs.servos.present = None  # type: ignore[assignment,method-assign]
    assert legs.arms.lead_in([0.1, 0.2, 0.3, 0.4]) is None
    assert ticks_to_rad(legs.rig.joints[0], 2048) == 0.0
