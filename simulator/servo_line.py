"""Several servos on one wire: takes the bytes of a client, gives back those of the servos.

Source: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0", instruction details.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.control_table import StatusError
from simulator.packets import (
    BROADCAST_ID,
    DamagedPacket,
    Instruction,
    Packet,
    PacketReader,
    fast_status,
    status,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from simulator.servo import Servo

_ANSWERS_PING, _ANSWERS_READ, _ANSWERS_ALL = 0, 1, 2
"""Status return levels from which on an instruction is answered."""
_FAST_BLOCK_OVERHEAD = 4
"""Error, ID and CRC around each servo's data in a fast answer."""


def _word(data: bytes, at: int) -> int:
    return int.from_bytes(data[at : at + 2], "little")


class ServoLine:
    """The bus and its servos.

    Parameters
    ----------
    servos : sequence of Servo
        In any order; two with the same ID both answer, as on a real bus.
    """

    def __init__(self, servos: Sequence[Servo]) -> None:
        self.servos = tuple(servos)
        self._reader = PacketReader()
        self._single: dict[int, Callable[[Servo, bytes, float], bytes]] = {
            Instruction.PING: self._ping,
            Instruction.READ: self._read,
            Instruction.WRITE: self._write,
            Instruction.REG_WRITE: self._register_write,
            Instruction.ACTION: self._action,
            Instruction.FACTORY_RESET: self._factory_reset,
            Instruction.REBOOT: self._reboot,
            Instruction.CLEAR: self._clear,
            Instruction.CONTROL_TABLE_BACKUP: self._back_up,
        }
        self._group: dict[int, Callable[[bytes, float], bytes]] = {
            Instruction.SYNC_READ: self._sync_read,
            Instruction.FAST_SYNC_READ: self._fast_sync_read,
            Instruction.BULK_READ: self._bulk_read,
            Instruction.FAST_BULK_READ: self._fast_bulk_read,
            Instruction.SYNC_WRITE: self._sync_write,
            Instruction.BULK_WRITE: self._bulk_write,
        }

    def forget_partial_packet(self) -> None:
        """Drop the beginning of a packet whose sender is gone."""
        self._reader.reset()

    def handle(self, data: bytes, now: float) -> bytes:
        """Take bytes from the wire, execute what they complete, and return the servos' bytes."""
        return b"".join(self._execute(packet, now) for packet in self._reader.feed(data))

    def _execute(self, packet: Packet | DamagedPacket, now: float) -> bytes:
        if isinstance(packet, DamagedPacket):
            return b"".join(
                self._answer(servo, _ANSWERS_ALL, StatusError.CRC)
                for servo in self.servos
                if servo.servo_id == packet.servo_id
            )
        if packet.instruction == Instruction.STATUS:
            return b""  # an echo of our own, or another bus's servo: not for us
        for servo in self.servos:
            servo.hear(now)
        if packet.servo_id == BROADCAST_ID and packet.instruction in self._group:
            return self._group[packet.instruction](packet.parameters, now)
        if packet.servo_id == BROADCAST_ID:
            return self._broadcast(packet, now)
        answers = []
        for servo in self.servos:
            if servo.servo_id == packet.servo_id:
                handler = self._single.get(packet.instruction, self._unknown)
                answers.append(handler(servo, packet.parameters, now))
            elif servo.listens_silently_to(packet.servo_id) and packet.instruction in self._single:
                self._single[packet.instruction](servo, packet.parameters, now)
        return b"".join(answers)

    def _broadcast(self, packet: Packet, now: float) -> bytes:
        """Execute an instruction on every servo; only a ping is answered, in the order of the IDs."""
        handler = self._single.get(packet.instruction)
        erases_all = packet.instruction == Instruction.FACTORY_RESET and packet.parameters[:1] == b"\xff"
        if handler is None or erases_all:
            return b""
        answers = [handler(servo, packet.parameters, now) for servo in self._in_order()]
        return b"".join(answers) if packet.instruction == Instruction.PING else b""

    def _in_order(self) -> list[Servo]:
        return sorted(self.servos, key=lambda servo: servo.servo_id)

    def _answer(self, servo: Servo, level: int, error: StatusError, parameters: bytes = b"") -> bytes:
        if servo.status_return_level < level:
            return b""
        return status(servo.servo_id, error | servo.alert, parameters)

    # -- one servo

    def _ping(self, servo: Servo, _parameters: bytes, now: float) -> bytes:
        _, model = servo.read(0, 2, now)
        _, firmware = servo.read(6, 1, now)
        return self._answer(servo, _ANSWERS_PING, StatusError.NONE, model + firmware)

    def _read(self, servo: Servo, parameters: bytes, now: float) -> bytes:
        if len(parameters) != 4:
            return self._answer(servo, _ANSWERS_READ, StatusError.DATA_LENGTH)
        error, data = servo.read(_word(parameters, 0), _word(parameters, 2), now)
        return self._answer(servo, _ANSWERS_READ, error, data)

    def _write(self, servo: Servo, parameters: bytes, now: float) -> bytes:
        # The answer carries the ID and the return level from before the write.
        answering, level = servo.servo_id, servo.status_return_level
        error = servo.write(_word(parameters, 0), parameters[2:], now)
        return status(answering, error | servo.alert) if level >= _ANSWERS_ALL else b""

    def _register_write(self, servo: Servo, parameters: bytes, _now: float) -> bytes:
        return self._answer(servo, _ANSWERS_ALL, servo.register_write(_word(parameters, 0), parameters[2:]))

    def _action(self, servo: Servo, _parameters: bytes, now: float) -> bytes:
        return self._answer(servo, _ANSWERS_ALL, servo.act(now))

    def _factory_reset(self, servo: Servo, parameters: bytes, now: float) -> bytes:
        answering, level = servo.servo_id, servo.status_return_level
        if len(parameters) != 1:
            return self._answer(servo, _ANSWERS_ALL, StatusError.DATA_LENGTH)
        error = servo.factory_reset(parameters[0], now)
        return status(answering, error | servo.alert) if level >= _ANSWERS_ALL else b""

    def _back_up(self, servo: Servo, parameters: bytes, now: float) -> bytes:
        answering, level = servo.servo_id, servo.status_return_level
        error = servo.back_up(parameters, now)
        return status(answering, error | servo.alert) if level >= _ANSWERS_ALL else b""

    def _reboot(self, servo: Servo, _parameters: bytes, now: float) -> bytes:
        answer = self._answer(servo, _ANSWERS_ALL, StatusError.NONE)
        servo.reboot(now)
        return answer

    def _clear(self, servo: Servo, parameters: bytes, now: float) -> bytes:
        return self._answer(servo, _ANSWERS_ALL, servo.clear(parameters, now))

    def _unknown(self, servo: Servo, _parameters: bytes, _now: float) -> bytes:
        return self._answer(servo, _ANSWERS_ALL, StatusError.INSTRUCTION)

    # -- several servos

    def _find(self, servo_id: int) -> Iterator[Servo]:
        return (servo for servo in self.servos if servo.servo_id == servo_id)

    def _read_each(self, wanted: list[tuple[int, int, int]], now: float) -> bytes:
        answers = []
        for servo_id, address, length in wanted:
            for servo in self._find(servo_id):
                error, data = servo.read(address, length, now)
                answers.append(self._answer(servo, _ANSWERS_READ, error, data))
        return b"".join(answers)

    def _fast_read(self, wanted: list[tuple[int, int, int]], now: float) -> bytes:
        blocks: list[tuple[int, int, bytes]] = []
        for servo_id, address, length in wanted:
            servo = next(self._find(servo_id), None)
            if servo is None or servo.status_return_level < _ANSWERS_READ:
                break  # every servo waits for the one before it: the rest of the packet never comes
            error, data = servo.read(address, length, now)
            blocks.append((error | servo.alert, servo_id, data.ljust(length, b"\0")))
        promised = sum(length + _FAST_BLOCK_OVERHEAD for _, _, length in wanted)
        return fast_status(blocks, promised)

    def _sync_read(self, parameters: bytes, now: float) -> bytes:
        return self._read_each(_sync_list(parameters), now)

    def _fast_sync_read(self, parameters: bytes, now: float) -> bytes:
        return self._fast_read(_sync_list(parameters), now)

    def _bulk_read(self, parameters: bytes, now: float) -> bytes:
        return self._read_each(_bulk_list(parameters), now)

    def _fast_bulk_read(self, parameters: bytes, now: float) -> bytes:
        return self._fast_read(_bulk_list(parameters), now)

    def _sync_write(self, parameters: bytes, now: float) -> bytes:
        address, length = _word(parameters, 0), _word(parameters, 2)
        step = length + 1
        for start in range(4, len(parameters) - length, step):
            for servo in self._find(parameters[start]):
                servo.write(address, parameters[start + 1 : start + step], now)
        return b""

    def _bulk_write(self, parameters: bytes, now: float) -> bytes:
        start = 0
        while start + 5 <= len(parameters):
            end = start + 5 + _word(parameters, start + 3)
            if end > len(parameters):
                break
            for servo in self._find(parameters[start]):
                servo.write(_word(parameters, start + 1), parameters[start + 5 : end], now)
            start = end
        return b""


def _sync_list(parameters: bytes) -> list[tuple[int, int, int]]:
    """IDs, addresses and lengths of a sync read."""
    address, length = _word(parameters, 0), _word(parameters, 2)
    return [(servo_id, address, length) for servo_id in parameters[4:]]


def _bulk_list(parameters: bytes) -> list[tuple[int, int, int]]:
    """IDs, addresses and lengths of a bulk read."""
    starts = range(0, len(parameters) - 4, 5)
    return [(parameters[at], _word(parameters, at + 1), _word(parameters, at + 3)) for at in starts]
