"""The servo side's packet codec, against the manual's bytes and the maker's SDK."""

from __future__ import annotations

import pytest
from dynamixel_sdk import Protocol2PacketHandler
from hypothesis import assume, given
from hypothesis import strategies as st

from simulator.packets import (
    BROADCAST_ID,
    DamagedPacket,
    Packet,
    PacketReader,
    crc16,
    fast_status,
    packet,
    status,
)

PING_1 = bytes.fromhex("fffffd00 01 0300 01 194e".replace(" ", ""))
TRICKY = st.lists(st.sampled_from([b"\xff", b"\xfd", b"\x00", b"\x55", b"\xff\xff\xfd"]), max_size=40).map(
    b"".join
)


def read_all(data: bytes) -> list[Packet | DamagedPacket]:
    """Read with a new reader."""
    return list(PacketReader().feed(data))


@pytest.mark.parametrize(
    ("built", "manual"),
    [
        (packet(1, 0x01), "fffffd00010300 01194e"),
        (packet(BROADCAST_ID, 0x01), "fffffd00fe0300 013142"),
        (status(1, 0, bytes.fromhex("060426")), "fffffd00010700 5500060426655d"),
        (packet(1, 0x02, bytes.fromhex("84000400")), "fffffd00010700 02840004001d15"),
        (status(1, 0, bytes.fromhex("a6000000")), "fffffd00010800 5500a60000008cc0"),
        (packet(1, 0x03, bytes.fromhex("740000020000")), "fffffd00010900 03740000020000ca89"),
        (packet(BROADCAST_ID, 0x82, bytes.fromhex("840004000102")), "fffffd00fe0900 82840004000102cefa"),
    ],
)
def test_examples_of_the_manual(built: bytes, manual: str) -> None:
    """Catches a wrong CRC, length or byte order: the manual prints these very bytes."""
    assert built == bytes.fromhex(manual.replace(" ", ""))


@given(TRICKY | st.binary(max_size=60))
def test_crc_is_the_sdk_s(data: bytes) -> None:
    """Catches a CRC table that is right only for the examples."""
    assert crc16(data) == Protocol2PacketHandler().updateCRC(0, data, len(data))


@given(st.integers(0, 252), TRICKY)
def test_a_packet_survives_the_wire(servo_id: int, parameters: bytes) -> None:
    """Catches stuffing that is lost, doubled, or missed where patterns touch."""
    wire = packet(servo_id, 0x03, parameters)
    assert read_all(wire) == [Packet(servo_id, 0x03, parameters)]
    assert wire.count(b"\xff\xff\xfd", 5, len(wire) - 2) == wire.count(b"\xff\xff\xfd\xfd", 5, len(wire) - 2)


@given(TRICKY)
def test_the_sdk_removes_our_stuffing(parameters: bytes) -> None:
    """Catches stuffing that only our own reader understands."""
    # The SDK unstuffs in place and, one byte behind itself, takes a later FF FD FD for a stuffed pattern.
    assume(b"\xff\xfd\xfd" not in parameters)
    received = Protocol2PacketHandler().removeStuffing(list(status(1, 0, parameters)))
    length = received[5] | received[6] << 8
    assert bytes(received[9 : 9 + length - 4]) == parameters


@given(TRICKY, st.lists(st.integers(1, 7), min_size=1, max_size=30))
def test_chunks_do_not_matter(parameters: bytes, sizes: list[int]) -> None:
    """Catches a reader that needs a packet in one piece."""
    wire = packet(3, 0x03, parameters) + PING_1
    reader, found = PacketReader(), []
    while wire:
        size = sizes[len(found) % len(sizes)] if sizes else 1
        found += list(reader.feed(wire[:size]))
        wire = wire[size:]
    assert found == [Packet(3, 0x03, parameters), Packet(1, 0x01, b"")]


@given(st.integers(1, 15), st.integers(0, 3))
def test_a_cut_packet_does_not_swallow_the_next(kept: int, times: int) -> None:
    """Catches a reader that waits for the rest of a packet whose sender was killed."""
    cut = packet(2, 0x03, bytes(8))[:kept] * (times + 1)
    assert Packet(1, 0x01, b"") in read_all(cut + PING_1)


@given(st.binary(max_size=50))
def test_garbage_costs_at_most_itself(garbage: bytes) -> None:
    """Catches a reader that loses its way: after noise the second packet at the latest is read."""
    reader = PacketReader()
    found = list(reader.feed(garbage)) + list(reader.feed(PING_1)) + list(reader.feed(PING_1))
    assert Packet(1, 0x01, b"") in found


def test_a_wrong_crc_is_reported_with_the_id() -> None:
    """Catches damaged packets that are executed, or dropped without the status that a servo sends."""
    assert read_all(PING_1[:-1] + b"\x00" + PING_1) == [DamagedPacket(1), Packet(1, 0x01, b"")]


def test_an_unstuffed_packet_is_not_understood() -> None:
    """Catches an emulator more lenient than a servo: the driver's missing stuffing would pass unseen."""
    raw = bytes.fromhex("fffffd00 01 0900 03 7400 fffffdff".replace(" ", ""))
    wire = raw + crc16(raw).to_bytes(2, "little")
    assert read_all(wire + PING_1) == [Packet(1, 0x01, b"")]


def test_a_fast_answer_is_one_packet() -> None:
    """Catches CRCs that do not run on through the servos' blocks: the last one must be the packet's."""
    data = {3: "a6000000", 7: "1f080000", 4: "ff030000"}
    blocks = [(0, servo_id, bytes.fromhex(text)) for servo_id, text in data.items()]
    wire = fast_status(blocks, promised_bytes=24)
    assert wire[:8] == bytes.fromhex("fffffd00fe190055")
    assert len(wire) == 7 + 25
    assert crc16(wire[:-2]) == int.from_bytes(wire[-2:], "little")
    assert crc16(wire[:14]) == int.from_bytes(wire[14:16], "little")
