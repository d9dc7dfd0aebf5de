"""Dynamixel Protocol 2.0 on the servo's side: CRC, byte stuffing, packets out of a stream and into it.

Source: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0" and "CRC Calculation". The driver has its own codec from
the makers of the servos; this one is written from the manual, so that the two check each other.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

HEADER = b"\xff\xff\xfd\x00"
BROADCAST_ID = 0xFE
MAX_ID = 0xFC
LONGEST_BODY = 2048
"""Longer packets are taken for a damaged length: five servos' whole control tables fit in less."""

_PATTERN, _STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
_UNSTUFFED_PATTERN = re.compile(rb"\xff\xff\xfd(?!\xfd)")
_PREFIX = len(HEADER) + 3  # header, ID, two bytes of length
_CRC_BYTES = 2


class Instruction(IntEnum):
    """Instructions of Protocol 2.0."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    CONTROL_TABLE_BACKUP = 0x20
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


def _crc_table() -> tuple[int, ...]:
    table = []
    for index in range(256):
        value = index << 8
        for _ in range(8):
            value = (value << 1) ^ 0x8005 if value & 0x8000 else value << 1
        table.append(value & 0xFFFF)
    return tuple(table)


_CRC_TABLE = _crc_table()


def crc16(data: bytes, start: int = 0) -> int:
    """CRC-16 of Protocol 2.0 (polynomial 0x8005, start 0, nothing reflected), continued from `start`."""
    crc = start
    for byte in data:
        crc = ((crc << 8) & 0xFFFF) ^ _CRC_TABLE[(crc >> 8) ^ byte]
    return crc


def packet(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """One packet as it goes over the wire, stuffed and with its CRC."""
    body = (bytes([instruction]) + parameters).replace(_PATTERN, _STUFFED)
    raw = HEADER + bytes([servo_id]) + (len(body) + _CRC_BYTES).to_bytes(2, "little") + body
    return raw + crc16(raw).to_bytes(2, "little")


def status(servo_id: int, error: int, parameters: bytes = b"") -> bytes:
    """One status packet as it goes over the wire."""
    return packet(servo_id, Instruction.STATUS, bytes([error]) + parameters)


def fast_status(blocks: list[tuple[int, int, bytes]], promised_bytes: int) -> bytes:
    """Build the one status packet that several servos write together to answer a fast sync or bulk read.

    Each servo appends error, ID, data and the CRC of everything so far; nothing is stuffed.

    Parameters
    ----------
    blocks : list of (error, servo_id, data)
        What each answering servo adds, in order.
    promised_bytes : int
        Bytes of all blocks that were asked for, which the first servo writes into the packet's length; where
        one of the servos is absent, fewer follow.
    """
    if not blocks:
        return b""
    raw = HEADER + bytes([BROADCAST_ID]) + (promised_bytes + 1).to_bytes(2, "little")
    raw += bytes([Instruction.STATUS])
    crc = crc16(raw)
    for error, servo_id, data in blocks:
        block = bytes([error, servo_id]) + data
        crc = crc16(block, crc)
        crc_bytes = crc.to_bytes(2, "little")
        raw += block + crc_bytes
        crc = crc16(crc_bytes, crc)
    return raw


@dataclass(frozen=True, slots=True)
class Packet:
    """A packet that arrived whole."""

    servo_id: int
    instruction: int
    parameters: bytes


@dataclass(frozen=True, slots=True)
class DamagedPacket:
    """A packet of the right length whose CRC does not match."""

    servo_id: int


class PacketReader:
    """Finds packets in a stream of bytes and finds its way again after garbage.

    Stuffing makes the header unique: inside a packet it can only mean that the packet was cut off and a new
    one began, so the reader never waits for the rest of a packet whose sender was killed.
    """

    def __init__(self) -> None:
        self._buffer = b""

    def reset(self) -> None:
        """Forget a partial packet."""
        self._buffer = b""

    def feed(self, data: bytes) -> Iterator[Packet | DamagedPacket]:
        """Take the next bytes off the wire and give every packet that they complete, in order."""
        self._buffer += data
        while self._align():
            end = _PREFIX + int.from_bytes(self._buffer[5:7], "little")
            if not _PREFIX + 1 + _CRC_BYTES <= end <= LONGEST_BODY:
                self._drop(1)
                continue
            if self._intact(end):
                raw = self._buffer[:end]
                self._drop(end)
                # A sender that forgot the stuffing is not understood: a servo sees a second header there.
                if not _UNSTUFFED_PATTERN.search(raw, _PREFIX, end - _CRC_BYTES):
                    body = raw[_PREFIX:-_CRC_BYTES].replace(_STUFFED, _PATTERN)
                    yield Packet(raw[4], body[0], body[1:])
                continue
            next_header = self._buffer.find(HEADER, 1, end + len(HEADER) - 1)
            if next_header > 0:
                self._drop(next_header)
            elif len(self._buffer) >= end:
                servo_id = self._buffer[4]
                self._drop(end)
                yield DamagedPacket(servo_id)
            else:
                return

    def _intact(self, end: int) -> bool:
        """Tell whether the buffer begins with a whole packet of `end` bytes whose CRC is right."""
        raw = self._buffer[:end]
        return len(raw) == end and crc16(raw[:-_CRC_BYTES]) == int.from_bytes(raw[-_CRC_BYTES:], "little")

    def _align(self) -> bool:
        """Drop what precedes the first header; tell whether a packet's first seven bytes are there."""
        start = self._buffer.find(HEADER)
        if start >= 0:
            self._drop(start)
        else:
            # The beginning of a header may be waiting for its rest.
            keep = next((n for n in (3, 2, 1) if self._buffer.endswith(HEADER[:n])), 0)
            self._drop(len(self._buffer) - keep)
        return len(self._buffer) >= _PREFIX

    def _drop(self, count: int) -> None:
        self._buffer = self._buffer[count:]
