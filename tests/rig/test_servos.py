"""Servos as one body: handshake, set-up, verified moves, and a stop that is proved by bytes."""

from __future__ import annotations

import itertools
import math
import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

import rig.arrival
from rig.bus import ServoBus
from rig.control_table import CONTROL_TABLE, HardwareError
from rig.description import Joint, default_rig
from rig.errors import BadInput, DeviceLost, Refused, Unsafe
from rig.handshake import ServoSpec
from rig.packets import Wire
from rig.servos import Servos
from rig.stop_report import PartStop, StopOutcome, StopReport

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

NAMES = {1: "light_elevation", 2: "camera_azimuth", 3: "camera_elevation"}
SPECS = tuple(ServoSpec.of(joint) for joint in default_rig().joints[:3])
READ, WRITE, SYNC_WRITE = 0x02, 0x03, 0x83


def packet(servo_id: int, instruction: int, *parameters: int) -> bytes:
    """Everything of an instruction packet but its checksum."""
    length = len(parameters) + 3
    return bytes([0xFF, 0xFF, 0xFD, 0, servo_id, length & 0xFF, length >> 8, instruction, *parameters])


def write_packet(servo_id: int, name: str, value: int) -> bytes:
    """Begin of the packet that writes one register."""
    register = CONTROL_TABLE[name]
    address = (register.address & 0xFF, register.address >> 8)
    return packet(servo_id, WRITE, *address, *register.encode(value))


def sync_packet(name: str, values: dict[int, int]) -> bytes:
    """Begin of the packet that writes one register of several servos."""
    register = CONTROL_TABLE[name]
    payload = [byte for i, value in values.items() for byte in (i, *register.encode(value))]
    return packet(254, SYNC_WRITE, register.address & 0xFF, 0, register.size, 0, *payload)


class Body:
    """A bench and the servos' driver on it."""

    def __init__(self, bench: Any, **options: Any) -> None:
        self.bench = bench
        self.bus = ServoBus(bench.port, names=NAMES, timeout_s=0.05, retries=1)
        self.servos = Servos(self.bus, SPECS, **options)

    @property
    def heard(self) -> bytes:
        heard: bytes = self.bench.bytes_heard
        return heard


@pytest.fixture
def body(servo_bench: Callable[..., Any]) -> Iterator[Callable[..., Body]]:
    """Return a maker of bodies."""
    made: list[Body] = []

    def make(
        *, speed: float = 50.0, models: dict[int, str] | None = None, count: int = 3, **options: Any
    ) -> Body:
        made.append(Body(servo_bench(count, speed, models), **options))
        return made[-1]

    yield make
    for one in made:
        one.bus.close()


def freeze(body: Body, servo_id: int) -> None:
    """Block an axis: the servo takes goals but its shaft does not turn."""
    body.bench.servos[servo_id].hinder(0.0, time.monotonic(), math.inf)


def mute(body: Body, servo_id: int) -> None:
    """Cut a servo off the bus."""
    servos = [servo for i, servo in body.bench.servos.items() if i != servo_id]
    body.bench.line.servos = tuple(servos)


def test_specs_never_exceed_what_the_file_allows() -> None:
    """Catches rounding up to a faster profile, and a profile of 0, which means without any limit."""
    slow = Joint(
        name="a",
        id=1,
        axis=(0.0, 0.0, 1.0),
        limits_deg=(-10.0, 10.0),
        speed_deg_s=0.01,
        acceleration_deg_s2=0.01,
    )
    assert ServoSpec.of(slow).velocity == 1
    assert ServoSpec.of(slow).acceleration == 1
    spec = SPECS[0]
    assert spec.velocity * 0.229 * 6.0 <= 60.0
    assert spec.acceleration * 214.577 / 10.0 <= 120.0


def test_limits_beyond_one_turn_and_unknown_models_are_refused() -> None:
    """Catches a joint that position mode cannot reach, and a typo in a model's name."""
    joint = Joint(name="a", id=1, axis=(0.0, 0.0, 1.0), limits_deg=(-180.0, 180.0))
    with pytest.raises(BadInput, match="4096"):
        ServoSpec.of(joint)
    with pytest.raises(BadInput, match="XH430-W350"):
        ServoSpec.of(joint.model_copy(update={"model": "XH430-W35"}))


def test_handshake_lists_expected_and_found(body: Callable[..., Body]) -> None:
    """Catches a refusal that does not say which servo is wrong, missing, or there without being expected."""
    one = body(models={2: "XL430-W250"}, count=4)
    mute(one, 3)
    handshake = one.servos.handshake()
    table = handshake.table()
    assert "is a XL430-W250, expected XH430-W350" in table
    assert "does not answer" in table
    assert "4   -" in table
    with pytest.raises(DeviceLost) as caught:
        handshake.require()
    for part in ("servo 2 (camera_azimuth)", "servo 3 (camera_elevation)", "4: XH430-W350"):
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_standing_hardware_error_refuses_the_machine(body: Callable[..., Body]) -> None:
    """Catches a run that starts with an overloaded servo."""
    one = body()
    one.bench.servos[2].fail(HardwareError.OVERLOAD | HardwareError.OVERHEATING, time.monotonic())
    with pytest.raises(Refused, match=r"servo 2 \(camera_azimuth\) reports overheating and overload"):
        one.servos.attach()


def test_the_runaway_combination_is_refused(body: Callable[..., Body]) -> None:
    """Catches a servo whose watchdog would start its motor: its firmware runs away on silence."""
    one = body()
    for name, value in (("homing_offset", 100), ("operating_mode", 4), ("bus_watchdog", 127)):
        one.bus.write(2, name, value)
    with pytest.raises(Refused, match=r"servo 2 \(camera_azimuth\) is in extended mode with a homing offset"):
        one.servos.attach()
    assert all(servo.value("torque_enable") == 0 for servo in one.bench.servos.values())
    one.bus.write(2, "bus_watchdog", 0)
    one.servos.attach()  # without it there is nothing to run away from, and the mode is put right
    assert one.bench.servos[2].value("operating_mode") == 3


def test_old_firmware_is_refused(body: Callable[..., Body]) -> None:
    """Catches a servo without the registers that the driver relies on, such as the bus watchdog."""
    one = body()
    one.bench.servos[3]._registers.set("firmware_version", 37)
    with pytest.raises(Refused, match="has firmware 37, needs 38"):
        one.servos.attach()


def test_attach_writes_limits_and_profile_and_moves_nothing(body: Callable[..., Body]) -> None:
    """Catches limits that stay the factory's, a profile without limit, torque before the goal is here."""
    one = body()
    one.servos.attach()
    for spec in SPECS:
        servo = one.bench.servos[spec.servo_id]
        wanted = {**spec.eeprom, **spec.profile, "torque_enable": 1, "goal_position": 2048}
        assert {name: servo.value(name) for name in wanted} == wanted
        goal = one.heard.index(write_packet(spec.servo_id, "goal_position", 2048))
        assert goal < one.heard.index(write_packet(spec.servo_id, "torque_enable", 1))
        assert servo.present_ticks(time.monotonic()) == 2048


def test_a_second_attach_spares_the_eeprom(body: Callable[..., Body]) -> None:
    """Catches EEPROM worn out by a write at every start, and torque that drops in between."""
    one = body()
    one.servos.attach()
    one.servos.move({1: 2200})
    one.bench.heard.clear()
    one.servos.attach()
    for spec in SPECS:
        for name, value in spec.eeprom.items():
            assert write_packet(spec.servo_id, name, value) not in one.heard
        assert write_packet(spec.servo_id, "torque_enable", 0) not in one.heard
    assert one.bench.servos[1].value("goal_position") == 2200


def test_eeprom_that_differs_under_torque_is_refused(body: Callable[..., Body]) -> None:
    """Catches a set-up that switches torque off and lets an arm fall."""
    one = body()
    one.servos.attach()
    other = Servos(one.bus, [replace(SPECS[0], maximum=2500), *SPECS[1:]])
    one.bench.heard.clear()
    with pytest.raises(Refused, match="torque is on"):
        other.attach()
    assert write_packet(1, "torque_enable", 0) not in one.heard


def test_a_value_that_does_not_stick_is_refused(body: Callable[..., Body]) -> None:
    """Catches a profile that the servo took differently: the arm would be faster than the file says."""
    one = body()
    one.bench.servos[1]._registers.set("profile_velocity", 0)
    heard = one.bench.hears
    one.bench.hears = lambda data: (
        b"" if write_packet(1, "profile_velocity", SPECS[0].velocity) in data else heard(data)
    )
    with pytest.raises((Refused, DeviceLost)):
        one.servos.attach()
    assert one.bench.servos[1].value("torque_enable") == 0


def test_move_arrives_and_measures(body: Callable[..., Body]) -> None:
    """Catches a move that returns early: it must stand still within tolerance, and say what was measured."""
    one = body()
    one.servos.attach()
    measured = one.servos.move({1: 2500, 2: 100, 3: 1600})
    now = time.monotonic()
    assert all(not servo.moving(now) for servo in one.bench.servos.values())
    assert measured == {i: servo.present_ticks(now) for i, servo in one.bench.servos.items()}
    assert all(abs(measured[i] - goal) <= 1 for i, goal in {1: 2500, 2: 100, 3: 1600}.items())
    assert sync_packet("goal_position", {1: 2500, 2: 100, 3: 1600}) in one.heard


def test_a_slow_arm_within_tolerance_has_not_arrived_yet(body: Callable[..., Body]) -> None:
    """Catches an arrival that only compares positions: the arm would still creep during the exposure."""
    one = body(speed=4.0)
    one.servos.attach()
    creeping = [replace(spec, velocity=1, tolerance=30) for spec in SPECS]
    Servos(one.bus, creeping).attach()
    measured = Servos(one.bus, creeping).move({1: 2088})
    assert not one.bench.servos[1].moving(time.monotonic())
    assert measured[1] == 2088


def test_move_outside_the_limits_sends_nothing(body: Callable[..., Body]) -> None:
    """Catches a goal beyond the limits that reaches the wire."""
    one = body()
    one.servos.attach()
    one.bench.heard.clear()
    with pytest.raises(Refused, match=r"servo 3 \(camera_elevation\).*outside"):
        one.servos.move({1: 2100, 3: 4000})
    assert one.heard == b""


def test_a_lost_goal_is_sent_again(body: Callable[..., Body]) -> None:
    """Catches a synchronous write that nobody confirms and that was lost: the arms would stay."""
    one = body()
    one.servos.attach()
    goal = sync_packet("goal_position", {1: 2300})
    lost: list[bytes] = []

    def lose_once(data: bytes) -> bytes:
        if goal in data and not lost:
            lost.append(data)
            return b""
        return data

    one.bench.hears = lose_once
    assert abs(one.servos.move({1: 2300})[1] - 2300) <= 1
    assert lost


@pytest.mark.parametrize("cleared", [False, True])
def test_a_forgotten_profile_moves_nothing(body: Callable[..., Body], cleared: bool) -> None:
    """Catches an arm at full speed: a watchdog that tripped, cleared since or not, leaves no limit."""
    one = body()
    one.servos.attach()
    one.bench.servos[2].trip_watchdog(time.monotonic())
    if cleared:
        one.bus.write(2, "bus_watchdog", 0)
    one.bench.heard.clear()
    hint = "" if cleared else ".*its bus watchdog has tripped"
    with pytest.raises(Unsafe, match=rf"servo 2 \(camera_azimuth\).*has forgotten its speed{hint}"):
        one.servos.move({1: 2300, 2: 2500})
    assert sync_packet("goal_position", {1: 2300, 2: 2500}) not in one.heard
    one.servos.attach()
    assert one.servos.move({1: 2300, 2: 2500})[2] == pytest.approx(2500, abs=1)


def test_a_stuck_axis_is_named(body: Callable[..., Body], monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches an image of a pose that was never reached."""
    monkeypatch.setattr(rig.arrival, "STALL_S", 0.1)
    one = body()
    one.servos.attach()
    freeze(one, 2)
    with pytest.raises(Unsafe) as caught:
        one.servos.move({1: 2300, 2: 2500})
    for part in ("servo 2 (camera_azimuth)", "2048", "2500"):
        assert part in str(caught.value)


def test_an_overload_during_a_move_is_unsafe(body: Callable[..., Body]) -> None:
    """Catches an alert bit that nobody looks at while the motor burns."""
    one = body(speed=1.0)
    one.servos.attach()
    threading.Timer(0.1, lambda: one.bench.servos[3].fail(HardwareError.OVERLOAD, time.monotonic())).start()
    with pytest.raises(Unsafe, match=r"servo 3 \(camera_elevation\).*overload"):
        one.servos.move({1: 2900, 3: 2900})


def test_a_cancelled_move_ends(body: Callable[..., Body]) -> None:
    """Catches a stop from another thread that leaves the mover waiting for an arrival."""
    one = body(speed=1.0)
    one.servos.attach()
    asked = itertools.count(1)
    with pytest.raises(Refused, match="stopped"):
        one.servos.move({1: 2900}, cancelled=lambda: next(asked) == 3)
    assert next(asked) == 4
    assert one.bench.servos[1].moving(time.monotonic())


def test_held_means_held(body: Callable[..., Body]) -> None:
    """Catches an exposure while an arm moves or after somebody pushed it."""
    one = body()
    one.servos.attach()
    held = one.servos.move({1: 2200})
    one.servos.require_held(held)
    with pytest.raises(Unsafe, match="left its place"):
        one.servos.require_held({**held, 2: held[2] + 5})
    slow = body(speed=0.1)
    slow.servos.attach()
    slow.bus.sync_write("goal_position", {1: 2900})
    time.sleep(0.3)
    with pytest.raises(Unsafe, match="left its place"):
        slow.servos.require_held(dict.fromkeys((1, 2, 3), 2048))


def test_halt_stops_a_moving_arm_where_it_is(body: Callable[..., Body]) -> None:
    """Catches a stop that reports success without stopping: the bytes and the shaft must prove it."""
    one = body(speed=0.5)
    one.servos.attach()
    one.bus.sync_write("goal_position", {1: 2900, 2: 3500})
    time.sleep(0.3)
    one.bench.heard.clear()
    parts = one.servos.halt()
    assert [part.outcome for part in parts] == [StopOutcome.CONFIRMED] * 3
    now = time.monotonic()
    for servo in one.bench.servos.values():
        assert not servo.moving(now)
        assert abs(servo.value("goal_position") - servo.present_ticks(now)) <= 1
        assert servo.value("torque_enable") == 1
    assert one.bench.servos[2].present_ticks(now) < 3400
    stop = sync_packet("goal_position", {1: 0, 2: 0, 3: 0})[:12]
    assert stop in one.heard
    assert one.bench.heard[1][1].startswith(stop)  # after the one question where they are


def test_nobody_waits_for_another_to_come_to_rest(body: Callable[..., Body]) -> None:
    """Catches a stop that tells the last servo only when the first has braked: a second late."""
    one = body(speed=1.0, torque_on_stop="off")
    one.servos.attach()
    one.bus.sync_write("goal_position", {1: 2900, 2: 3500, 3: 2900})
    time.sleep(0.3)
    one.bench.heard.clear()
    one.servos.halt()
    last = max(one.heard.rindex(write_packet(servo_id, "torque_enable", 0)) for servo_id in (1, 2, 3))
    torque = CONTROL_TABLE["torque_enable"].address
    assert one.heard.index(packet(1, READ, torque, 0, 1, 0)) > last  # the first that is read back


def test_halt_switches_torque_off_where_the_file_says(body: Callable[..., Body]) -> None:
    """Catches torque that stays on, or is only believed to be off."""
    one = body(torque_on_stop="off")
    one.servos.attach()
    parts = one.servos.halt()
    assert all(part.outcome is StopOutcome.CONFIRMED and "torque off" in part.detail for part in parts)
    for servo_id, servo in one.bench.servos.items():
        assert write_packet(servo_id, "torque_enable", 0) in one.heard
        assert servo.value("torque_enable") == 0


def test_a_dead_servo_does_not_keep_the_others_from_stopping(body: Callable[..., Body]) -> None:
    """Catches the loop that ends at the first servo that fails."""
    one = body(speed=1.0, torque_on_stop="off")
    one.servos.attach()
    one.bus.sync_write("goal_position", {1: 2900, 2: 3500, 3: 2900})
    time.sleep(0.1)
    mute(one, 1)
    outcomes = [part.outcome for part in one.servos.halt()]
    assert outcomes == [StopOutcome.UNKNOWN, StopOutcome.CONFIRMED, StopOutcome.CONFIRMED]
    assert [one.bench.servos[i].value("torque_enable") for i in (2, 3)] == [0, 0]
    for servo_id in (2, 3):
        assert write_packet(servo_id, "torque_enable", 0) in one.heard


def test_an_alert_does_not_keep_torque_on(body: Callable[..., Body]) -> None:
    """Catches the driver that takes an overheated servo's alert for a failed write and gives up."""
    one = body(torque_on_stop="off")
    one.servos.attach()
    one.bench.servos[2]._registers.set("hardware_error_status", int(HardwareError.OVERHEATING))
    assert [part.outcome for part in one.servos.halt()] == [StopOutcome.CONFIRMED] * 3
    assert one.bench.servos[2].value("torque_enable") == 0


def test_a_servo_that_keeps_its_torque_is_reported(body: Callable[..., Body]) -> None:
    """Catches a refusal that is reported as confirmed."""
    one = body(torque_on_stop="off")
    one.servos.attach()
    one.bench.servos[3]._after["torque_enable"] = lambda _value, _now: one.bench.servos[3]._registers.set(
        "torque_enable", 1
    )
    parts = one.servos.halt()
    assert [part.outcome for part in parts] == [
        StopOutcome.CONFIRMED,
        StopOutcome.CONFIRMED,
        StopOutcome.REFUSED,
    ]
    assert "torque is still on" in parts[2].detail


def test_a_lost_bus_is_unknown_not_confirmed(body: Callable[..., Body]) -> None:
    """Catches a stop that claims success without a bus."""
    one = body()
    one.servos.attach()
    one.bench.unplug()
    assert [part.outcome for part in one.servos.halt()] == [StopOutcome.UNKNOWN] * 3


def test_the_worst_part_decides_a_report() -> None:
    """Catches an unknown servo hidden behind confirmed ones, and JSON that does not come back."""
    parts = tuple(PartStop(outcome.value, outcome, "") for outcome in StopOutcome)
    assert StopReport(parts[:1]).outcome is StopOutcome.CONFIRMED
    assert StopReport(parts[:2]).outcome is StopOutcome.REFUSED
    assert StopReport(parts).outcome is StopOutcome.UNKNOWN
    assert StopReport(()).outcome is StopOutcome.UNKNOWN
    assert StopReport.from_dict(StopReport(parts).as_dict()) == StopReport(parts)


def test_an_arm_outside_its_limits_is_not_pulled_in(body: Callable[..., Body]) -> None:
    """Catches a start that swings an arm from where a person left it to the nearest limit."""
    one = body()
    one.bench.servos[1].carry(200.0, time.monotonic())
    with pytest.raises(Refused, match="outside its limits"):
        one.servos.attach()
    assert one.bench.servos[1].value("torque_enable") == 0


def test_a_predecessors_torque_is_kept(body: Callable[..., Body]) -> None:
    """Catches a drop when the program attaches to arms that are held already."""
    one = body()
    one.servos.attach()
    one.bus.close()
    wire = Wire(one.bench.port)
    wire.close()
    second = ServoBus(one.bench.port, names=NAMES)
    one.bench.heard.clear()
    Servos(second, SPECS).attach()
    second.close()
    assert write_packet(1, "torque_enable", 0) not in one.heard
    assert sync_packet("torque_enable", {1: 0, 2: 0, 3: 0}) not in one.heard


def test_a_goal_that_is_never_taken_is_unsafe(body: Callable[..., Body]) -> None:
    """Catches arms of which some have moved and one has not, treated as a mere refusal."""
    one = body()
    one.servos.attach()
    goal = sync_packet("goal_position", {2: 2300})
    one.bench.hears = lambda data: b"" if goal in data else data
    with pytest.raises(Unsafe, match=r"servo 2 \(camera_azimuth\).*does not take the goal 2300"):
        one.servos.move({2: 2300})


def test_a_quiet_servo_is_made_to_answer(body: Callable[..., Body]) -> None:
    """Catches a servo that was told to answer pings only, taken for a lost one."""
    one = body()
    one.bench.servos[1]._registers.set("status_return_level", 0)
    one.servos.handshake().require()
