"""Parking what can be parked: one servo's error skips none of the others."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import pytest

from rig.control_table import HardwareError, OperatingMode
from rig.description import Ports, default_rig
from rig.errors import Refused, Unsafe
from rig.rescue import park_others
from rig.stop_report import StopOutcome
from rig.ticks import rad_to_ticks

if TYPE_CHECKING:
    from collections.abc import Callable

    from rig.description import Rig

AILING = 2
AWAY = 2400


class Scene:
    """The default machine's servos away from their park angles, one of them ailing, and its lamp, lit."""

    def __init__(self, servo_bench: Callable[..., Any], lamp_bench: Callable[..., Any]) -> None:
        self.servos = servo_bench(5, 50.0)
        self.lamp = lamp_bench()
        for servo in self.servos.servos.values():
            servo.carry(AWAY, 0.0)
        rig = default_rig()
        ports = Ports(servos=self.servos.port, lamp=self.lamp.port, frames=rig.ports.frames)
        self.rig: Rig = rig.model_copy(update={"ports": ports, "solids": ()})
        self.stops: list[Callable[[], object]] = []

    def park(self) -> list[StopOutcome]:
        report = park_others(self.rig, self.stops.append)
        return [part.outcome for part in report.parts]

    def at(self, servo_id: int) -> int:
        ticks: int = self.servos.servos[servo_id].shaft_ticks(time.monotonic())
        return ticks


@pytest.fixture
def scene(servo_bench: Callable[..., Any], lamp_bench: Callable[..., Any]) -> Scene:
    """Return a scene."""
    return Scene(servo_bench, lamp_bench)


def test_an_alert_on_one_servo_still_lets_the_others_be_parked(scene: Scene) -> None:
    """Catches the driver that takes one servo's alert for everybody's failure and parks nobody."""
    scene.servos.servos[AILING].fail(HardwareError.OVERLOAD, 0.0)
    ok, refused = StopOutcome.CONFIRMED, StopOutcome.REFUSED
    assert scene.park() == [ok, ok, refused, ok, ok, ok]  # the lamp first
    for joint in scene.rig.arm_joints:
        parked = rad_to_ticks(joint, math.radians(joint.park_deg))
        assert scene.at(joint.id) == (AWAY if joint.id == AILING else parked)
    assert not scene.lamp.light
    assert len(scene.stops) == 1


def test_a_silent_servo_is_unknown_and_the_others_are_parked(scene: Scene) -> None:
    """Catches a dead servo that is reported as parked, or keeps the others from it."""
    scene.servos.line.servos = tuple(s for i, s in scene.servos.servos.items() if i != AILING)
    assert scene.park()[AILING] is StopOutcome.UNKNOWN
    first = scene.rig.arm_joints[0]
    assert scene.at(first.id) == rad_to_ticks(first, math.radians(first.park_deg))


def test_arms_do_not_pass_one_of_which_nobody_knows_where_it_is(scene: Scene) -> None:
    """Catches arms that are driven into a dead one."""
    scene.rig = scene.rig.model_copy(update={"solids": default_rig().solids})
    scene.servos.line.servos = tuple(s for i, s in scene.servos.servos.items() if i != AILING)
    with pytest.raises(Refused, match="camera_azimuth stands is not known"):
        scene.park()
    assert scene.at(1) == AWAY


def test_a_stuck_arm_stops_the_others_on_their_way_to_park(scene: Scene) -> None:
    """Catches arms that are parked past solids with nobody looking whether they keep to their way."""
    scene.rig = scene.rig.model_copy(update={"solids": default_rig().solids})
    stuck = scene.rig.arm_joints[-1]
    scene.servos.servos[stuck.id].hinder(0.0, time.monotonic(), math.inf)
    with pytest.raises(Unsafe, match=rf"{stuck.name}.*off the way that was checked"):
        scene.park()
    assert len(scene.stops) == 1
    assert {servo.moving(time.monotonic()) for servo in scene.servos.servos.values()} == {False}
    assert scene.at(stuck.id) == AWAY


def test_an_unusable_mode_is_not_an_error_to_the_others(scene: Scene) -> None:
    """Catches set-up of a servo that must be left alone."""
    servo = scene.servos.servos[AILING]
    servo._registers.set("operating_mode", OperatingMode.EXTENDED_POSITION)
    servo._registers.set("homing_offset", 5)
    servo._registers.set("bus_watchdog", 100)
    assert scene.park()[AILING] is StopOutcome.REFUSED
    assert servo.value("operating_mode") == OperatingMode.EXTENDED_POSITION
