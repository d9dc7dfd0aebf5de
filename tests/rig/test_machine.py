"""The whole machine on the twin: poses, pictures, and every way out ends dark and still, on the wires."""

from __future__ import annotations

import math
import threading
import time
from typing import TYPE_CHECKING, Any

import pytest
from bluesky import protocols

from capture.raw import inspect_frame
from rig.control_table import CONTROL_TABLE
from rig.description import load_rig
from rig.devices import ArmsDevice, CameraDevice, PoseGoal, Shot, Status
from rig.errors import BadInput, DeviceLost, GonioError, Refused, Unsafe
from rig.machine import Machine, open_machine
from rig.stop_report import StopOutcome
from simulator.twin import Twin
from tests.rig.conftest import WAIT_S, until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rig.description import Rig

pytestmark = pytest.mark.render

GOAL_SYNC_WRITE = bytes([0x83, CONTROL_TABLE["goal_position"].address, 0, 4, 0])
LIGHT_OFF = b"OUTP OFF\n"


@pytest.fixture(scope="module")
def shared_twin() -> Iterator[Twin]:
    """Return one twin for all tests that leave it as they found it."""
    with Twin({"sample1": "lambert:kd=0.5"}, speed=100.0) as twin:
        yield twin


@pytest.fixture
def shared_rig(shared_twin: Twin) -> Rig:
    """Return its rig."""
    return load_rig(shared_twin.rig)


@pytest.fixture
def slow_twin() -> Iterator[Twin]:
    """Return a twin that moves half as fast as a real machine: a test may dawdle."""
    with Twin({}, speed=0.5) as twin:
        yield twin


def heard(twin: Twin, since: float) -> list[tuple[str, bytes]]:
    """Everything that the twin heard since, in order, adjacent pieces of one line joined."""
    pieces: list[tuple[str, bytes]] = []
    for event in twin.wire_log():
        if event["t"] >= since and event.get("direction") == "in":
            line, data = event["line"], bytes.fromhex(event["data"])
            if pieces and pieces[-1][0] == line:
                pieces[-1] = (line, pieces[-1][1] + data)
            else:
                pieces.append((line, data))
    return pieces


def assert_stopped_light_first(twin: Twin, since: float) -> None:
    """Light off on the lamp's wire, then a goal for every servo on theirs."""
    pieces = heard(twin, since)
    dark = next(i for i, (line, data) in enumerate(pieces) if line == "lamp" and LIGHT_OFF in data)
    stops = [i for i, (line, data) in enumerate(pieces) if line == "servos" and GOAL_SYNC_WRITE in data]
    assert stops
    assert dark < stops[0]
    packet = pieces[stops[0]][1].split(GOAL_SYNC_WRITE)[-1]
    assert [packet[5 * index] for index in range(5)] == [1, 2, 3, 4, 5]
    edges = [event["on"] for event in twin.wire_log() if event.get("event") == "light"]
    assert not edges[-1]


def test_pose_and_pictures(shared_twin: Twin, shared_rig: Rig) -> None:
    """Catches a pose that is not the one asked for, and a picture that is not of the shot asked for."""
    with open_machine(shared_rig, inspect=inspect_frame) as machine:
        pose = machine.move([0.3, -0.2, 0.7, 0.1], "sample1")
        assert pose.station == "sample1"
        assert pose.angles_rad == pytest.approx([0.3, -0.2, 0.7, 0.1], abs=1.1 * math.tau / 4096)
        assert len(pose.ticks) == 5
        for shot_id, dark in (("machine-lit", False), ("machine-dark", True)):
            facts = inspect_frame(machine.shoot(shot_id, 0.02, dark=dark))
            assert (facts.shot_id, facts.lit, facts.exposure_s) == (shot_id, not dark, 0.02)
    assert machine.stop_report is not None
    assert machine.stop_report.outcome is StopOutcome.CONFIRMED


def test_an_exception_leaves_dark_and_still(shared_twin: Twin, shared_rig: Rig) -> None:
    """Catches an exit path that leaves the light on or the arms moving."""

    def run() -> None:
        with open_machine(shared_rig, inspect=inspect_frame) as machine:
            machine.move([0.2, 0.0, 0.5, 0.0])
            machine.shoot("before-the-bug", 0.01)
            begun.append(time.monotonic())
            raise ZeroDivisionError

    begun: list[float] = []
    with pytest.raises(ZeroDivisionError):
        run()
    assert_stopped_light_first(shared_twin, begun[0])


def test_a_stop_from_another_thread_ends_a_move(slow_twin: Twin) -> None:
    """Catches a stop that waits for the move, or a move that goes on after the stop."""
    caught: list[GonioError] = []
    far = [1.2, 2.5, -1.2, 2.5]

    def move() -> None:
        try:
            machine.move(far, "white")
        except GonioError as error:
            caught.append(error)

    with open_machine(load_rig(slow_twin.rig)) as machine:
        machine.lamp.on()
        mover = threading.Thread(target=move)
        mover.start()
        until(lambda: any(GOAL_SYNC_WRITE in data for _, data in heard(slow_twin, 0.0)))
        since = time.monotonic()
        assert machine.stop().outcome is StopOutcome.CONFIRMED
        mover.join(WAIT_S)
        assert isinstance(caught[0], Refused)
        held = machine.arms.measure().angles_rad
        assert all(abs(angle - goal) > 0.1 for angle, goal in zip(held, far, strict=True))
        with pytest.raises(Refused, match="stopped"):
            machine.move([0.0, 0.0, 0.0, 0.0])
        with pytest.raises(Refused, match="stopped"):
            machine.shoot("after", 0.01)
    assert_stopped_light_first(slow_twin, since)


def test_a_condemned_machine_says_why(shared_twin: Twin, shared_rig: Rig) -> None:
    """Catches an open door that a run tells as "the machine was stopped", with the wrong exit code."""
    with open_machine(shared_rig) as machine:
        machine.lamp.on()
        since = time.monotonic()
        machine.condemn(Unsafe("the interlock is open", where="test"))
        machine.condemn(DeviceLost("and then this", where="test"))
        for _ in range(2):
            with pytest.raises(Unsafe, match="interlock is open"):
                machine.move([0.2, 0.0, 0.5, 0.0])
    assert_stopped_light_first(shared_twin, since)


def test_a_lamp_that_breaks_down_does_not_keep_the_arms_from_stopping(
    shared_twin: Twin, shared_rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a stop that ends with the first part that fails in a way nobody foresaw."""

    def broken() -> None:
        raise ZeroDivisionError

    with open_machine(shared_rig) as machine:
        monkeypatch.setattr(machine.lamp, "halt", broken)
        since = time.monotonic()
        report = machine.stop()
        assert report.parts[0].outcome is StopOutcome.UNKNOWN
        assert [part.outcome for part in report.parts[1:]] == [StopOutcome.CONFIRMED] * 5
    assert any(line == "servos" and GOAL_SYNC_WRITE in data for line, data in heard(shared_twin, since))


def test_a_stop_during_an_exposure_ends_it(twin: Twin) -> None:
    """Catches a stop that lets a long exposure burn to its end, or counts its picture."""
    with open_machine(load_rig(twin.rig), inspect=inspect_frame) as machine:
        machine.move([0.2, 0.0, 0.5, 0.0])
        began = time.monotonic()

        def stop() -> None:
            until(lambda: any(event.get("event") == "shutter" for event in twin.wire_log()))
            machine.stop()

        stopper = threading.Thread(target=stop)
        stopper.start()
        with pytest.raises(Refused, match="stopped"):
            machine.shoot("cut", 500.0)
        stopper.join(WAIT_S)
    assert not any(event.get("event") == "exposed" for event in twin.wire_log())
    assert_stopped_light_first(twin, began)


def test_no_exposure_of_a_pose_that_is_not_held(shared_rig: Rig) -> None:
    """Catches a picture before the first move, or after one that failed."""
    with open_machine(shared_rig, inspect=inspect_frame) as machine:
        with pytest.raises(Refused, match="no verified pose"):
            machine.shoot("early", 0.01)
        with pytest.raises(Refused, match="camera_elevation would go to 90"):
            machine.move([0.0, 0.0, math.pi / 2, 0.0])


def test_an_arm_that_was_pushed_stops_the_machine(twin: Twin) -> None:
    """Catches a picture of a pose that somebody changed after it was measured."""
    with open_machine(load_rig(twin.rig), inspect=inspect_frame) as machine:
        machine.move([0.2, 0.0, 0.5, 0.0])
        machine._servos.bus.write(3, "goal_position", 2400)
        time.sleep(0.2)
        with pytest.raises(GonioError, match=r"servo 3 \(camera_elevation\)"):
            machine.shoot("pushed", 0.01)
        assert machine.stopped
    assert not any("pushed" in str(event) for event in twin.wire_log() if event.get("event") == "exposed")


def test_unknown_stations_and_wrong_poses(shared_rig: Rig) -> None:
    """Catches a typo in a station that leaves the wheel where it was."""
    with open_machine(shared_rig) as machine:
        with pytest.raises(BadInput, match="stations are white, trap"):
            machine.move([0.0, 0.0, 0.0, 0.0], "sample9")
        with pytest.raises(BadInput, match="give 4: light_elevation"):
            machine.move([0.0])


def test_missing_ports_and_folders_say_what_to_do(shared_rig: Rig, tmp_path: Path) -> None:
    """Catches a machine that opens without a part of it."""
    for ports, message in (
        ({"servos": ""}, "--servos"),
        ({"lamp": ""}, "--lamp"),
        ({"frames": tmp_path / "nope"}, "--frames"),
    ):
        rig = shared_rig.model_copy(update={"ports": shared_rig.ports.model_copy(update=ports)})
        with pytest.raises(BadInput, match=message):
            open_machine(rig, inspect=inspect_frame)
    rig = shared_rig.model_copy(update={"ports": shared_rig.ports.model_copy(update={"lamp": "/dev/nope"})})
    with pytest.raises(DeviceLost, match="no such port"):
        open_machine(rig)
    with open_machine(shared_rig) as machine:  # nothing of the failed attempts is left behind
        assert machine.handshake.table().count("XH430-W350") == 10


def test_strays_are_told(shared_twin: Twin, shared_rig: Rig) -> None:
    """Catches a foreign file in the hot folder that is lost without a trace."""
    from pathlib import Path

    strays: list[Any] = []
    with open_machine(shared_rig, inspect=inspect_frame) as machine:
        machine.on_stray(strays.append)
        machine.move([0.2, 0.0, 0.5, 0.0])
        machine.shoot("first", 0.01)
        foreign = Path(shared_twin.frames) / "foreign.dng"
        foreign.write_bytes(b"no raw")
        machine.shoot("second", 0.01)
        foreign.unlink()
    assert [stray.path.name for stray in strays] == ["foreign.dng"]


def test_devices_satisfy_bluesky(shared_rig: Rig) -> None:
    """Catches a device that Bluesky's engine would refuse, or whose reading does not fit its description."""
    with open_machine(shared_rig, inspect=inspect_frame) as machine:
        arms, camera = ArmsDevice(machine), CameraDevice(machine)
        for protocol in (protocols.Movable, protocols.Readable, protocols.Stoppable):
            assert isinstance(arms, protocol)
        for protocol in (protocols.Triggerable, protocols.Readable, protocols.Preparable):
            assert isinstance(camera, protocol)
        assert isinstance(Status(), protocols.Status)
        with pytest.raises(RuntimeError, match="before it was prepared"):
            camera.trigger()
        assert arms.set(PoseGoal((0.2, 0.0, 0.5, 0.0), "white")).exception(10.0) is None
        camera.prepare(Shot("device", 0.01))
        assert camera.trigger().exception(10.0) is None
        assert camera.path is not None
        for device in (arms, camera):
            assert set(device.read()) == set(device.describe())
        assert arms.read()["arms_station"]["value"] == "white"
        arms.stop(success=True)
        assert not machine.stopped
        failed = arms.set(PoseGoal((9.0, 0.0, 0.5, 0.0)))
        assert isinstance(failed.exception(10.0), Refused)
        assert not failed.success
        arms.stop(success=False)
        assert machine.stopped
        arms.close()
        camera.close()


def test_a_status_calls_back_once_whenever_it_is_asked() -> None:
    """Catches a callback lost because the work was over before it was registered."""
    status, calls = Status(), []
    status.add_callback(calls.append)
    with pytest.raises(TimeoutError):
        status.exception(0.0)
    status.finish()
    status.add_callback(calls.append)
    assert calls == [status, status]
    assert status.done
    assert status.success


def test_opening_halfway_closes_what_was_open(shared_rig: Rig) -> None:
    """Catches a failed start that keeps the lamp's port, so that the next one is refused."""
    joints = tuple(joint.model_copy(update={"id": joint.id + 100}) for joint in shared_rig.joints[:1])
    rig = shared_rig.model_copy(update={"joints": joints + shared_rig.joints[1:]})
    with pytest.raises(DeviceLost, match=r"servo 101 \(light_elevation\) does not answer"):
        open_machine(rig)
    with open_machine(shared_rig) as machine:
        assert isinstance(machine, Machine)
