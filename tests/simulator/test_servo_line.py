"""The servo bus by its bytes: who answers what, in which order, and who keeps silent."""

from __future__ import annotations

import pytest

from rig.control_table import HardwareError, StatusError
from simulator.packets import BROADCAST_ID, Instruction, Packet, PacketReader, crc16, packet
from simulator.servo import Servo
from simulator.servo_line import ServoLine

POSITION = b"\x84\x00\x04\x00"


class Bus:
    """Five servos and a client that speaks packets."""

    def __init__(self) -> None:
        self.line = ServoLine([Servo(servo_id, shaft_ticks=1000 * servo_id) for servo_id in (3, 1, 2)])
        self.now = 0.0

    def raw(self, servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
        return self.line.handle(packet(servo_id, instruction, parameters), self.now)

    def ask(self, servo_id: int, instruction: int, parameters: bytes = b"") -> list[tuple[int, int, bytes]]:
        found = PacketReader().feed(self.raw(servo_id, instruction, parameters))
        answers = []
        for answer in found:
            assert isinstance(answer, Packet)
            assert answer.instruction == Instruction.STATUS
            answers.append((answer.servo_id, answer.parameters[0], answer.parameters[1:]))
        return answers

    def write(self, servo_id: int, address: int, data: bytes) -> list[tuple[int, int, bytes]]:
        return self.ask(servo_id, Instruction.WRITE, address.to_bytes(2, "little") + data)

    def position(self, servo_id: int) -> int:
        ((_, error, data),) = self.ask(servo_id, Instruction.READ, POSITION)
        assert error == 0
        return int.from_bytes(data, "little", signed=True)


@pytest.fixture
def bus() -> Bus:
    """Return a bus of its own."""
    return Bus()


def test_ping_and_broadcast_ping(bus: Bus) -> None:
    """Catches a broadcast answered out of order, or a ping without model number and firmware."""
    answers = bus.ask(BROADCAST_ID, Instruction.PING)
    assert [servo_id for servo_id, _, _ in answers] == [1, 2, 3]
    assert {data for _, _, data in answers} == {(1000).to_bytes(2, "little") + bytes([45])}
    assert bus.ask(2, Instruction.PING) == answers[1:2]
    assert bus.ask(9, Instruction.PING) == []


def test_sync_read_answers_in_the_order_asked(bus: Bus) -> None:
    """Catches replies in the servos' own order, or of servos that were not asked."""
    answers = bus.ask(BROADCAST_ID, Instruction.SYNC_READ, POSITION + bytes([2, 9, 1]))
    assert [(servo_id, int.from_bytes(data, "little")) for servo_id, _, data in answers] == [
        (2, 2000),
        (1, 1000),
    ]


def test_bulk_read_reads_different_registers(bus: Bus) -> None:
    """Catches one address used for all, or a length read from the wrong bytes."""
    asked = bytes([3]) + POSITION + bytes([1, 0x92, 0, 1, 0])
    assert bus.ask(BROADCAST_ID, Instruction.BULK_READ, asked) == [
        (3, 0, (3000).to_bytes(4, "little")),
        (1, 0, bytes([32])),
    ]


def test_fast_sync_read_is_one_packet_of_all(bus: Bus) -> None:
    """Catches fast reads answered packet by packet: clients that use them would wait for ever."""
    answer = bus.raw(BROADCAST_ID, Instruction.FAST_SYNC_READ, POSITION + bytes([1, 3]))
    assert answer[:8] == bytes.fromhex("fffffd00fe110055")
    assert crc16(answer[:-2]) == int.from_bytes(answer[-2:], "little")
    assert answer[8:14] == bytes([0, 1]) + (1000).to_bytes(4, "little")
    assert answer[16:22] == bytes([0, 3]) + (3000).to_bytes(4, "little")


def test_sync_and_bulk_write_move_each_servo_in_silence(bus: Bus) -> None:
    """Catches goals given to the wrong servo, or answers that collide on the bus."""
    assert (
        bus.ask(BROADCAST_ID, Instruction.SYNC_WRITE, b"\x40\x00\x01\x00" + bytes([1, 1, 2, 1, 3, 1])) == []
    )
    goals = b"".join(bytes([i]) + (500 * i).to_bytes(4, "little") for i in (1, 2))
    assert bus.raw(BROADCAST_ID, Instruction.SYNC_WRITE, b"\x74\x00\x04\x00" + goals) == b""
    bulk = bytes([3]) + b"\x74\x00\x04\x00" + (77).to_bytes(4, "little") + bytes([1, 65, 0, 1, 0, 1])
    assert bus.raw(BROADCAST_ID, Instruction.BULK_WRITE, bulk) == b""
    bus.now = 10.0
    assert [bus.position(i) for i in (1, 2, 3)] == [500, 1000, 77]
    assert bus.ask(1, Instruction.READ, b"\x41\x00\x01\x00") == [(1, 0, b"\x01")]


def test_a_broadcast_write_reaches_all_and_is_not_answered(bus: Bus) -> None:
    """Catches five answers at once, or a broadcast torque-off that stops nobody."""
    assert bus.write(BROADCAST_ID, 64, b"\x01") == []
    assert [bus.ask(i, Instruction.READ, b"\x40\x00\x01\x00")[0][2] for i in (1, 2, 3)] == [b"\x01"] * 3
    assert bus.ask(BROADCAST_ID, Instruction.READ, POSITION) == []


def test_register_write_waits_for_action(bus: Bus) -> None:
    """Catches a registered goal executed at once, or an action without one that passes."""
    bus.write(1, 64, b"\x01")
    registered = b"\x74\x00" + (1200).to_bytes(4, "little")
    assert bus.ask(1, Instruction.REG_WRITE, registered) == [(1, 0, b"")]
    bus.now = 5.0
    assert bus.position(1) == 1000
    assert bus.ask(1, Instruction.ACTION) == [(1, 0, b"")]
    bus.now = 10.0
    assert bus.position(1) == 1200
    assert bus.ask(1, Instruction.ACTION) == [(1, StatusError.INSTRUCTION, b"")]


def test_errors_on_the_wire(bus: Bus) -> None:
    """Catches unknown instructions, damaged packets and refusals that are swallowed."""
    assert bus.ask(1, 0x77) == [(1, StatusError.INSTRUCTION, b"")]
    assert bus.ask(1, Instruction.READ, b"\x84\x00") == [(1, StatusError.DATA_LENGTH, b"")]
    assert bus.ask(1, Instruction.READ, b"\xff\x02\x04\x00") == [(1, StatusError.ACCESS, b"")]
    damaged = packet(1, Instruction.PING)[:-1] + b"\x00"
    (answer,) = PacketReader().feed(bus.line.handle(damaged, 0.0))
    assert answer == Packet(1, Instruction.STATUS, bytes([StatusError.CRC]))


def test_the_alert_bit_rides_on_every_answer(bus: Bus) -> None:
    """Catches an alert told only once, or that hides whether the instruction worked."""
    bus.line.servos[1].fail(HardwareError.OVERHEATING, 0.0)
    assert bus.ask(1, Instruction.READ, POSITION) == [(1, 0x80, (1000).to_bytes(4, "little"))]
    assert bus.write(1, 116, b"\xff\xff\x00\x00") == [(1, 0x80 | StatusError.DATA_LIMIT, b"")]
    assert bus.ask(1, Instruction.REBOOT) == [(1, 0x80, b"")]
    assert bus.ask(1, Instruction.PING)[0][1] == 0


def test_status_return_level(bus: Bus) -> None:
    """Catches a quiet servo that still answers writes, or one too quiet to be found by a ping."""
    assert bus.write(1, 68, b"\x01") == [(1, 0, b"")]
    assert bus.write(1, 65, b"\x01") == []
    assert bus.position(1) == 1000
    bus.write(1, 68, b"\x00")
    assert bus.ask(1, Instruction.READ, POSITION) == []
    assert len(bus.ask(1, Instruction.PING)) == 1


def test_a_new_id_answers_from_the_next_packet_on(bus: Bus) -> None:
    """Catches a changed ID that answers under both names, or loses the answer to the change itself."""
    assert bus.write(1, 7, b"\x0b") == [(1, 0, b"")]
    assert bus.ask(1, Instruction.PING) == []
    assert bus.position(11) == 1000


def test_a_shadow_obeys_in_silence(bus: Bus) -> None:
    """Catches two servos that answer to one ID because one of them shadows the other."""
    bus.write(2, 12, b"\x01")
    assert bus.write(1, 65, b"\x01") == [(1, 0, b"")]
    assert bus.ask(2, Instruction.READ, b"\x41\x00\x01\x00") == [(2, 0, b"\x01")]


def test_factory_reset_of_everybody_is_not_executed(bus: Bus) -> None:
    """Catches five servos reset to the same ID by one broadcast."""
    assert bus.ask(BROADCAST_ID, Instruction.FACTORY_RESET, b"\xff") == []
    assert len(bus.ask(BROADCAST_ID, Instruction.PING)) == 3
    assert bus.ask(3, Instruction.FACTORY_RESET, b"\x02") == [(3, 0, b"")]


def test_a_goal_with_the_header_inside_arrives(bus: Bus) -> None:
    """Catches missing de-stuffing: -131073 is FF FF FD FF on the wire, and comes back stuffed."""
    bus.write(2, 11, b"\x04")
    bus.write(2, 64, b"\x01")
    goal = (-131_073).to_bytes(4, "little", signed=True)
    assert bus.write(2, 116, goal) == [(2, 0, b"")]
    bus.now = 1e4
    assert b"\xff\xff\xfd\xfd\xff" in bus.raw(2, Instruction.READ, POSITION)
    assert bus.position(2) == -131_073
    assert bus.ask(2, Instruction.CLEAR, b"\x01\x44\x58\x4c\x22") == [(2, 0, b"")]
    assert bus.position(2) == -131_073 % 4096


def test_an_echo_is_not_answered(bus: Bus) -> None:
    """Catches an endless loop with a terminal that echoes the servos' own packets."""
    assert bus.ask(1, Instruction.STATUS, b"\x00") == []
