"""The wire: every known defect of the SDK has a test that fails without its mend."""

from __future__ import annotations

import contextlib
import itertools
import struct
import threading
import time
from typing import TYPE_CHECKING, Any

import pytest

from rig.bus import ServoBus
from rig.control_table import CONTROL_TABLE, HardwareError
from rig.errors import BadInput, DeviceLost, Refused, Transient
from rig.packets import DeadlinePort, PortLost, Wire
from rig.servo_models import MODELS, control_table
from tests.rig.conftest import WAIT_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

POSITION = CONTROL_TABLE["present_position"]
GOAL = CONTROL_TABLE["goal_position"]
VELOCITY = CONTROL_TABLE["profile_velocity"]


@pytest.fixture
def bench(servo_bench: Callable[..., Any]) -> Any:
    """Return three servos on a line."""
    return servo_bench()


@pytest.fixture
def wire(bench: Any) -> Iterator[Wire]:
    """Return our end of the line."""
    wire = Wire(bench.port, timeout_s=0.25)
    yield wire
    wire.close()


def test_registers_do_not_overlap_and_defaults_are_in_range() -> None:
    """Catches a typo in an address, a size or a default, for every model."""
    for model in MODELS:
        registers = sorted(control_table(model).values(), key=lambda register: register.address)
        assert all(a.end <= b.address for a, b in itertools.pairwise(registers))
        assert all(r.minimum <= r.default <= r.maximum for r in registers)


def test_a_short_reply_is_no_number() -> None:
    """Catches missing bytes that pass as a small position."""
    with pytest.raises(ValueError, match="needs 4 bytes"):
        GOAL.decode(b"\x01")


def test_negative_positions_are_signed() -> None:
    """Catches -1 that reads as 4294967295."""
    assert POSITION.decode(b"\xff\xff\xff\xff") == -1


def test_outgoing_payload_is_stuffed(bench: Any, wire: Wire) -> None:
    """Catches the SDK's unstuffed payload: -131073 is FF FF FD FF and never reached the servo."""
    wire.write(1, CONTROL_TABLE["operating_mode"].address, b"\x04")
    wire.sync_write(GOAL.address, {1: GOAL.encode(-131_073)})
    wire.ping(1)
    assert b"\xff\xff\xfd\xfd\xff" in bench.bytes_heard
    assert bench.servos[1].value("goal_position") == -131_073


def test_incoming_payload_is_unstuffed(bench: Any, wire: Wire) -> None:
    """Catches a reply whose FF FF FD is read with its stuffing."""
    wire.write(1, CONTROL_TABLE["operating_mode"].address, b"\x04")
    reply = wire.write(1, GOAL.address, GOAL.encode(-131_073))
    assert reply.error == 0
    assert GOAL.decode(wire.read(1, GOAL.address, GOAL.size).data) == -131_073


def test_a_missing_servo_is_missing_not_zero(wire: Wire) -> None:
    """Catches the SDK's silent 0 for a servo that did not answer, and an abort at the first one missing."""
    replies = wire.sync_read([1, 7, 3], POSITION.address, POSITION.size)
    assert set(replies) == {1, 3}
    assert POSITION.decode(replies[3].data) == 2048


def test_a_servo_that_falls_silent_is_missing_too(bench: Any, wire: Wire) -> None:
    """Catches 0 for a servo that had answered before, and the others' replies left for the next request."""
    everybody = set(wire.sync_read([1, 2, 3], POSITION.address, POSITION.size))
    assert everybody == {1, 2, 3}
    bench.line.servos = tuple(servo for servo in bench.line.servos if servo.servo_id != 2)
    for _ in range(2):
        replies = wire.sync_read([1, 2, 3], POSITION.address, POSITION.size)
        assert {i: POSITION.decode(reply.data) for i, reply in replies.items()} == {1: 2048, 3: 2048}


def test_an_alert_fails_nothing(bench: Any, wire: Wire) -> None:
    """Catches an overloaded servo that can neither be read nor switched off."""
    bench.servos[2].fail(HardwareError.OVERLOAD, time.monotonic())
    reply = wire.read(2, CONTROL_TABLE["hardware_error_status"].address, 1)
    assert reply.alert
    assert reply.error == 0
    assert reply.data == bytes([HardwareError.OVERLOAD])
    assert wire.write(2, CONTROL_TABLE["torque_enable"].address, b"\x00").error == 0


@pytest.mark.parametrize("delay_s", [0.205, 0.3, 0.5])
def test_a_late_reply_never_answers_the_next_request(bench: Any, delay_s: float) -> None:
    """Catches a position that comes late and is taken for the profile's velocity, of the same length."""

    def late_once(_request: bytes, reply: bytes) -> bytes:
        bench.says = lambda _request, reply: reply
        time.sleep(delay_s)
        return reply

    with ServoBus(bench.port, timeout_s=0.2, retries=0) as once:
        once.write(1, "profile_velocity", 77)
        bench.says = late_once
        with pytest.raises(DeviceLost):
            once.read(1, "present_position")
    with ServoBus(bench.port, timeout_s=0.2, retries=3) as bus:
        bench.says = late_once  # a predecessor's
        assert bus.read(1, "profile_velocity") == 77
        bench.says = late_once  # our own
        assert bus.read(1, "profile_velocity") == 77
        assert bus.read(1, "present_position") == 2048
        assert bus.read(1, "profile_velocity") == 77


def test_a_late_velocity_is_no_position(bench: Any, wire: Wire) -> None:
    """Catches the next question, of another register of equal length, answered by the late reply."""
    wire.write(1, VELOCITY.address, VELOCITY.encode(77))

    def late_once(_request: bytes, reply: bytes) -> bytes:
        bench.says = lambda _request, reply: reply
        time.sleep(0.3)
        return reply

    bench.says = late_once
    with pytest.raises(Transient):
        wire.read(1, VELOCITY.address, VELOCITY.size)
    assert POSITION.decode(wire.read(1, POSITION.address, POSITION.size).data) == 2048


def test_a_corrupt_reply_is_asked_for_again(bench: Any) -> None:
    """Catches a flipped bit that is believed, or that ends the run."""

    def corrupt_once(_request: bytes, reply: bytes) -> bytes:
        bench.says = lambda _request, reply: reply
        return reply[:9] + bytes([reply[9] ^ 1]) + reply[10:]

    with ServoBus(bench.port) as bus:
        bench.says = corrupt_once
        assert bus.read(1, "present_position") == 2048
        assert bus.statistics.corrupt == 1
        assert bus.statistics.retries == 1


def test_waiting_does_not_spin(bench: Any) -> None:
    """Catches the SDK's busy wait, which starves whoever shares the core."""
    wire = Wire(bench.port, timeout_s=0.5)
    bench.says = lambda _request, _reply: b""
    before = time.thread_time()
    with pytest.raises(Transient):
        wire.ping(1)
    wire.close()
    assert time.thread_time() - before < 0.25


def test_the_reply_timeout_is_ours(bench: Any) -> None:
    """Catches the SDK's fixed 34 ms, which a loaded machine exceeds."""
    wire = Wire(bench.port, timeout_s=WAIT_S)

    def slow(_request: bytes, reply: bytes) -> bytes:
        time.sleep(0.2)
        return reply

    bench.says = slow
    assert wire.ping(1).data[:2] == struct.pack("<H", 1000)
    wire.close()


def test_time_is_monotonic(monkeypatch: pytest.MonkeyPatch, bench: Any) -> None:
    """Catches a clock set back during a wait, which would stretch it for an hour."""
    clock = [0.0]
    monkeypatch.setattr(time, "time", lambda: -3600.0 * clock[0])
    port = DeadlinePort(bench.port, 1_000_000, 0.01)
    with monkeypatch.context() as patch:
        patch.setattr(time, "monotonic", lambda: clock[0])
        port.setPacketTimeout(11)
        late = []
        for clock[0] in (0.009, 0.011):
            late.append(port.isPacketTimeout())
    assert late == [False, True]


def test_the_port_is_ours_alone(bench: Any, wire: Wire) -> None:
    """Catches two programs that talk on one bus and mix their replies."""
    with pytest.raises(Refused, match="in use by another program"):
        Wire(bench.port)
    assert wire.ping(1).error == 0


def test_ports_that_cannot_be_opened_say_why() -> None:
    """Catches a traceback, or a message without a next step, for a missing port and an impossible speed."""
    with pytest.raises(DeviceLost, match=r"no such port.*at hand"):
        Wire("/dev/no-such-port")
    with pytest.raises(BadInput, match="57600"):
        Wire("/dev/no-such-port", baud=1234)


def test_an_unplugged_bus_is_lost_at_once(bench: Any) -> None:
    """Catches a cable pulled out that hangs, or raises what nobody catches."""
    with ServoBus(bench.port) as bus:
        bench.unplug()
        with pytest.raises(PortLost, match="is gone"):
            bus.read(1, "present_position")
        assert bus.statistics.retries == 0


def test_threads_do_not_mix_replies(bench: Any) -> None:
    """Catches a bus without an owner: two threads would get COMM_PORT_BUSY or each other's answers."""
    wrong: list[object] = []

    def ask(name: str, expected: int) -> None:
        try:
            wrong.extend(v for v in (bus.read(1, name) for _ in range(100)) if v != expected)
        except Exception as error:  # noqa: BLE001 - any is wrong
            wrong.append(error)

    with ServoBus(bench.port) as bus:
        questions = {"present_position": 2048, "velocity_limit": 130, "max_position_limit": 4095}
        threads = [threading.Thread(target=ask, args=question) for question in questions.items()]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert wrong == []


def test_an_exception_does_not_leave_the_port_busy(bench: Any, wire: Wire) -> None:
    """Catches the SDK's flag that stays set for ever after an exception between sending and receiving."""
    wire._line.is_using = True
    assert wire.ping(1).error == 0


def test_a_refusal_names_servo_and_register(bench: Any) -> None:
    """Catches a write out of range that nobody notices."""
    with ServoBus(bench.port, names={2: "camera_azimuth"}) as bus, pytest.raises(Refused) as caught:
        bus.write(2, "torque_enable", 9)
    assert "torque_enable" in str(caught.value)
    assert "servo 2" in str(caught.value)


def test_a_servo_that_stopped_answering_is_named(bench: Any) -> None:
    """Catches a loss without a name, when nobody knows which of five servos has no power."""
    with ServoBus(bench.port, names={9: "turntable"}, timeout_s=0.02) as bus:
        with pytest.raises(DeviceLost, match=r"servo 9 \(turntable\)"):
            bus.sync_read((1, 9), ("present_position",))
        assert set(bus.sync_read((1, 9), ("present_position",), partial=True)) == {1}


def test_everybody_on_the_bus_is_found(wire: Wire) -> None:
    """Catches a scan that loses servos when replies follow each other."""
    assert wire.broadcast_ping() == {i: (1000, wire.ping(i).data[2]) for i in (1, 2, 3)}


def test_a_duplicated_reply_answers_one_question(bench: Any, wire: Wire) -> None:
    """Catches the copy of a reply that is taken for the answer to the next question, of equal length."""
    bench.says = lambda _request, reply: reply + reply
    wire.write(1, VELOCITY.address, VELOCITY.encode(77))
    for _ in range(5):
        assert VELOCITY.decode(wire.read(1, VELOCITY.address, VELOCITY.size).data) == 77
        assert POSITION.decode(wire.read(1, POSITION.address, POSITION.size).data) == 2048
        replies = wire.sync_read([1, 2, 3], POSITION.address, POSITION.size)
        assert [POSITION.decode(replies[i].data) for i in (1, 2, 3)] == [2048] * 3


def test_a_goal_of_minus_131073_reaches_the_servo(bench: Any) -> None:
    """Catches the goal whose bytes are FF FF FD FF: unstuffed it never arrives, alone or in a group."""
    goal = -131_073
    with ServoBus(bench.port) as bus:
        for servo_id in (1, 2):
            bus.write(servo_id, "operating_mode", 4)
            bus.write(servo_id, "torque_enable", 1)
        bus.write(1, "goal_position", goal)
        bus.sync_write("goal_position", {2: goal})
        assert [bus.read(servo_id, "goal_position") for servo_id in (1, 2)] == [goal, goal]


def test_the_fastest_rate_is_known() -> None:
    """Catches 4.5 MBd, which the servos speak and the SDK's table lacks."""
    assert DeadlinePort("/dev/no-such-port", 4_500_000, 0.1).getCFlagBaud(4_500_000) == 4_500_000


def test_a_scan_keeps_who_was_understood(bench: Any, wire: Wire) -> None:
    """Catches one damaged reply to a broadcast that hides everybody else."""
    bench.says = lambda _request, reply: reply[:-1] + bytes([reply[-1] ^ 1])  # the last servo's checksum
    assert set(wire.broadcast_ping()) >= {1, 2}


def test_a_request_that_came_too_late_is_not_carried_out(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a goal that is written long after whoever asked for it was told that it had failed."""
    monkeypatch.setattr("rig.bus.DEADLINE_S", 0.1)
    with ServoBus(bench.port) as bus:
        held, free = threading.Event(), threading.Event()

        def hold(_wire: Wire) -> None:
            held.set()
            free.wait(5.0)

        threading.Thread(target=lambda: _ignoring(lambda: bus._submit(hold, urgent=True))).start()
        assert held.wait(5.0)
        with pytest.raises(DeviceLost, match="did not serve"):
            bus.write(1, "led", 1)
        free.set()
        assert bus.read(1, "led") == 0


def _ignoring(action: Callable[[], object]) -> None:
    with contextlib.suppress(DeviceLost):
        action()
