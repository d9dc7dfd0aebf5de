"""Joints that leave the way that was checked for them: all arms stop while there is still room."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.arms import Arms
from rig.bus import ServoBus
from rig.clearance import Clearance
from rig.control_table import CONTROL_TABLE
from rig.description import default_rig
from rig.errors import Unsafe
from rig.handshake import ServoSpec
from rig.lag import CheckedWay
from rig.servos import Servos
from rig.swept import near_poses
from rig.ticks import rad_to_ticks, ticks_to_rad
from rig.travel import Travel
from tests.rig.conftest import ServoBench

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rig.angles import FloatArray
    from rig.description import Rig

RIG = default_rig()
SPECS = {joint.id: ServoSpec.of(joint) for joint in RIG.joints}
LAMP, AZIMUTH, CAMERA = 1, 2, 3
BEFORE, AFTER = (0.3, 0.0, -0.4, 0.0), (1.1, 0.0, 0.5, 0.0)
"""The camera follows the lamp to where the lamp was: clear only as long as both go."""

STEP_S = 0.04
GOAL_WRITE = bytes([0x83, CONTROL_TABLE["goal_position"].address, 0, 4, 0])
SYNC_READ = b"\x82"


class SteppedBench(ServoBench):
    """Servos whose time goes on with every packet and never else: a loaded computer changes nothing."""

    def __init__(self, speed: float) -> None:
        super().__init__(5, speed)
        self._clock = self.servos[1]._power_up
        self.truth: list[tuple[int, ...]] = []
        self.events: dict[int, Callable[[float], None]] = {}
        """What happens before a packet, by how many there have been."""

    def answer(self, data: bytes) -> bytes:
        if not data:
            return b""
        self._clock += STEP_S
        self.events.pop(len(self.truth), lambda _now: None)(self._clock)
        said = self.line.handle(data, self._clock)
        self.truth.append(tuple(servo.shaft_ticks(self._clock) for servo in self.servos.values()))
        return said

    def soon(self, packets: int, event: Callable[[float], None]) -> None:
        """Let something happen so many packets from now."""
        self.events[len(self.truth) + packets] = event


class Stage:
    """A machine's arms on such a bench."""

    def __init__(self, rig: Rig = RIG, speed: float = 1.0) -> None:
        self.bench = SteppedBench(speed)
        for joint, angle_rad in zip(rig.arm_joints, BEFORE, strict=True):
            servo = self.bench.servos[joint.id]
            servo.carry(rad_to_ticks(joint, angle_rad), servo._power_up)
        self.bus = ServoBus(self.bench.port, 1_000_000)
        self.servos = Servos(self.bus, [ServoSpec.of(joint) for joint in rig.joints], watchdog_s=0.0)
        self.servos.attach()
        self.travel = Travel(rig, Arms(rig, self.servos, lambda: False))
        self.travel.move(BEFORE)
        self.bench.truth.clear()
        self.bench.heard.clear()

    def poses(self) -> FloatArray:
        """Where the arms truly were at every packet since, shape (K, 4)."""
        return np.array(
            [
                [ticks_to_rad(j, t) for j, t in zip(RIG.arm_joints, ticks, strict=False)]
                for ticks in self.bench.truth
            ]
        )

    def close(self) -> None:
        self.bus.close()
        self.bench.unplug()


@pytest.fixture
def stage() -> Iterator[Callable[..., Stage]]:
    """Return a maker of stages."""
    made: list[Stage] = []

    def make(*args: Any, **options: Any) -> Stage:
        made.append(Stage(*args, **options))
        return made[-1]

    yield make
    for each in made:
        each.close()


def way_of(goals: dict[int, int], slack: float = 10.0) -> CheckedWay:
    """Make a way from the middle of every servo."""
    return CheckedWay(SPECS, dict.fromkeys(goals, 2048), goals, dict.fromkeys(goals, slack))


GOALS = st.dictionaries(st.integers(1, 4), st.integers(1200, 2900), min_size=2)


@given(GOALS, st.floats(0.0, 6.0))
def test_all_at_one_time_of_the_profile_is_no_lag(goals: dict[int, int], time_s: float) -> None:
    """Would catch an alarm for arms that do exactly what they were told, at whatever time they are seen."""
    seen = {
        i: round(2048 + math.copysign(SPECS[i].profile_over(goal - 2048).travelled(time_s), goal - 2048))
        for i, goal in goals.items()
    }
    assert way_of(goals, slack=0.0).lag(seen) is None


@given(GOALS, st.floats(0.0, 6.0), st.data())
def test_one_joint_off_by_more_than_all_slack_is_found(
    goals: dict[int, int], time_s: float, data: st.DataObject
) -> None:
    """Would catch a joint that hangs back, runs ahead, or was pushed, and is not seen or not by its name."""
    seen = {
        i: round(2048 + math.copysign(SPECS[i].profile_over(goal - 2048).travelled(time_s), goal - 2048))
        for i, goal in goals.items()
    }
    stray = data.draw(st.sampled_from(sorted(goals)))
    sign = 1 if goals[stray] >= 2048 else -1
    seen[stray] = 2048 - 40 * sign  # the other way
    lag = way_of(goals).lag(seen)
    assert lag is not None
    assert (lag.servo_id, lag.ticks) == (stray, 40)


def test_a_lag_is_measured_against_the_others() -> None:
    """Would catch a joint blamed for the lag of another, or a lag told as what is left of the way."""
    goals = {LAMP: 2548, CAMERA: 2448}
    way = way_of(goals)
    due = round(SPECS[LAMP].profile_over(500).travelled(0.9))
    there = round(SPECS[CAMERA].profile_over(400).travelled(0.9))
    for behind in (12, 25, 80):
        lag = way.lag({LAMP: 2048 + due, CAMERA: 2048 + there - behind})
        assert (lag is None) == (behind == 12)
        if lag is not None:
            assert lag.servo_id == CAMERA
            assert lag.ticks == pytest.approx(behind, abs=1.5)
    assert way.lag({LAMP: 2548, CAMERA: 2448 - 5}) is None
    assert way.lag({CAMERA: 2200}) is None  # alone it says nothing


def test_the_slack_leaves_the_solids_apart() -> None:
    """Would catch a tolerance that uses up more than the margin that the way was proved with."""
    clearance = Clearance(RIG)
    slack = clearance.slack_rad
    moved_mm = clearance.pairs.levers_mm * slack
    assert (moved_mm <= clearance.pairs.margins_mm[:, None] * (1.0 + 1e-12)).all()
    assert moved_mm.max() == pytest.approx(RIG.clearance.margin_mm)


def test_a_stuck_arm_stops_the_others_while_there_is_room(stage: Callable[..., Stage]) -> None:
    """Would catch a camera that goes on, for a second, to where a stuck lamp still is."""
    one, clearance = stage(), Clearance(RIG)
    assert clearance.moves(np.array([BEFORE]), np.array([AFTER])).clear[0]
    blind = (BEFORE[0], *AFTER[1:])
    assert not clearance.moves(np.array([BEFORE]), np.array([blind])).clear[0]
    one.bench.soon(20, lambda now: one.bench.servos[LAMP].hinder(0.0, now, math.inf))
    with pytest.raises(Unsafe, match=r"servo 1.* degrees behind servo 3, off the way that was checked"):
        one.travel.move(AFTER)
    one.servos.halt()
    poses = one.poses()
    assert near_poses(clearance.pairs, poses).clear.all()
    stuck = poses[-1, 0]
    assert BEFORE[0] + 0.05 < stuck < AFTER[0] - 0.3
    # How far the camera came beyond where it was when the lamp stuck: slack, a look or two, and braking.
    camera = poses[:, 2]
    at = camera[int(np.argmax(np.isclose(poses[:, 0], stuck)))]
    spec = SPECS[CAMERA]
    speed = math.radians(spec.speed_ticks_s * spec.tick_deg)
    acceleration = math.radians(spec.acceleration_ticks_s2 * spec.tick_deg)
    bound = 2.0 * clearance.slack_rad + 3.0 * STEP_S * speed + speed**2 / (2.0 * acceleration)
    assert 0.0 < camera.max() - at < bound < AFTER[2] - at


def test_the_look_that_shows_a_lag_is_followed_by_the_stop(stage: Callable[..., Stage]) -> None:
    """Would catch a stop that comes some looks late, or after questions about the culprit."""
    one = stage()
    one.bench.soon(20, lambda now: one.bench.servos[LAMP].hinder(0.0, now, math.inf))
    with pytest.raises(Unsafe, match="off the way"):
        one.travel.move(AFTER)
    packets = [data for _, data in one.bench.heard]
    writes = [number for number, data in enumerate(packets) if GOAL_WRITE in data]
    start, goals = dict(enumerate(one.bench.truth[writes[0]], 1)), {LAMP: 0, CAMERA: 0}
    sent = packets[writes[0]].split(GOAL_WRITE)[1]
    goals = {sent[k]: int.from_bytes(sent[k + 1 : k + 5], "little") for k in range(0, 20, 5)}
    slack = Clearance(RIG).slack_rad
    ticks = dict.fromkeys(goals, math.degrees(slack) / SPECS[LAMP].tick_deg)
    way = CheckedWay(SPECS, start, goals, ticks)
    seen = [dict(enumerate(truth, 1)) for truth in one.bench.truth]
    first = next(n for n in range(writes[0] + 1, len(seen)) if way.lag(seen[n]) is not None)
    assert len(writes) == 2
    assert writes[1] == first + 1


@pytest.mark.parametrize(("factor", "stops"), [(0.2, True), (0.98, False)])
def test_a_slow_arm_stops_all_only_where_it_matters(
    stage: Callable[..., Stage], factor: float, stops: bool
) -> None:
    """Would catch a slow arm that is left behind unseen, and a little less speed that ends a night."""
    one = stage()
    one.bench.soon(0, lambda now: one.bench.servos[CAMERA].hinder(factor, now, math.inf))
    if stops:
        with pytest.raises(Unsafe, match=r"servo 3.* off the way"):
            one.travel.move(AFTER)
        one.servos.halt()
        assert near_poses(Clearance(RIG).pairs, one.poses()).clear.all()
        return
    assert one.travel.move(AFTER).angles_rad == pytest.approx(AFTER, abs=2e-3)


def test_an_arm_that_is_pushed_during_a_move_stops_the_others(stage: Callable[..., Stage]) -> None:
    """Would catch a joint that has nothing to do and is not looked at: the way was checked for its place."""
    one = stage()
    one.bench.soon(10, lambda now: one.bench.servos[AZIMUTH].carry(2048 + 60, now))
    with pytest.raises(Unsafe, match=r"servo 2.* off the way"):
        one.travel.move(AFTER)


def test_a_single_arm_that_is_slow_is_on_its_way(stage: Callable[..., Stage]) -> None:
    """Would catch a clock in the comparison: alone, an arm can be late, but nowhere else."""
    one = stage()
    one.bench.soon(0, lambda now: one.bench.servos[CAMERA].hinder(0.3, now, math.inf))
    goal = (*BEFORE[:2], -0.9, BEFORE[3])
    assert one.travel.move(goal).angles_rad == pytest.approx(goal, abs=2e-3)


def test_answers_that_come_later_than_the_others_raise_no_alarm(stage: Callable[..., Stage]) -> None:
    """Would catch places of different times taken for one pose: a servo that was asked again has moved on."""
    one = stage()
    looks: list[int] = []

    def lose_some(request: bytes, reply: bytes) -> bytes:
        if request[7:8] != SYNC_READ or reply.count(b"\xff\xff\xfd") < 5:
            return reply
        looks.append(len(reply))
        first = len(reply) // 5
        return reply[first:] if len(looks) % 3 == 0 else reply

    one.bench.says = lose_some
    assert one.travel.move(AFTER).angles_rad == pytest.approx(AFTER, abs=2e-3)
    assert len(looks) > 10
    assert one.bus.statistics.retries > 3


def test_a_hurried_twin_raises_no_alarm(stage: Callable[..., Stage]) -> None:
    """Would catch profiles compared with the clock: a twin moves many times as fast as its servos say."""
    one = stage(speed=7.0)
    assert one.travel.move(AFTER).angles_rad == pytest.approx(AFTER, abs=2e-3)
    assert one.travel.move(BEFORE).angles_rad == pytest.approx(BEFORE, abs=2e-3)


@pytest.mark.parametrize(
    ("lag_deg", "solids", "stops"), [(30.0, True, False), (0.5, False, True), (0.0, False, False)]
)
def test_the_rig_file_says_how_far(
    stage: Callable[..., Stage], lag_deg: float, solids: bool, stops: bool
) -> None:
    """Would catch a field that changes nothing, and an alarm where nothing was checked."""
    clearance = RIG.clearance.model_copy(update={"lag_deg": lag_deg})
    changes: dict[str, Any] = {"clearance": clearance} if solids else {"clearance": clearance, "solids": ()}
    one = stage(RIG.model_copy(update=changes))
    one.bench.soon(0, lambda now: one.bench.servos[CAMERA].hinder(0.6, now, math.inf))
    if stops:
        with pytest.raises(Unsafe, match=r"clearance\.lag_deg"):
            one.travel.move(AFTER)
    else:
        assert one.travel.move(AFTER).angles_rad == pytest.approx(AFTER, abs=2e-3)
