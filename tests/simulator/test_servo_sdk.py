"""The emulated servos asked by the maker's own library, every instruction that it has."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from dynamixel_sdk import (
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    GroupBulkRead,
    GroupBulkWrite,
    GroupSyncRead,
    GroupSyncWrite,
    Protocol2PacketHandler,
)

from rig.control_table import ALERT_BIT, HardwareError, StatusError
from simulator.servo import Servo
from simulator.servo_line import ServoLine

if TYPE_CHECKING:
    from collections.abc import Callable

TORQUE, LED, LEVEL, GOAL, PRESENT, TEMPERATURE = 64, 65, 68, 116, 132, 146
SPOT = 1000
DONE = (COMM_SUCCESS, 0)


class Port:
    """A port of the library's kind that leads straight to servos; waiting for nothing takes no time."""

    is_using = False

    def __init__(self, line: ServoLine) -> None:
        self.line, self.now = line, 0.0
        self._arrived = b""

    def clearPort(self) -> None:  # noqa: N802 - the library's names
        """Drop what arrived unasked."""
        self._arrived = b""

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        """Let the servos have it."""
        self._arrived += self.line.handle(bytes(packet), self.now)
        return len(packet)

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Give what they said."""
        said, self._arrived = self._arrived[:length], self._arrived[length:]
        return said

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Wait for no time."""

    def setPacketTimeoutMillis(self, msec: float) -> None:  # noqa: N802
        """Wait for no time."""

    def isPacketTimeout(self) -> bool:  # noqa: N802
        """All has been said."""
        return not self._arrived

    def getBaudRate(self) -> int:  # noqa: N802
        """Any."""
        return 1_000_000


class Client:
    """A script that knows only the library."""

    def __init__(self) -> None:
        self.servos = [Servo(i, shaft_ticks=SPOT * i) for i in (1, 2, 3)]
        self.port = Port(ServoLine(self.servos))
        self.sdk = Protocol2PacketHandler()

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a method of the library's packet handler."""
        return getattr(self.sdk, name)(self.port, *arguments)

    def group(self, kind: Callable[..., Any], *arguments: Any) -> Any:
        """Make a group of the library's."""
        return kind(self.port, self.sdk, *arguments)


@pytest.fixture
def client() -> Client:
    """Return a client of three servos."""
    return Client()


def test_ping_one_and_all(client: Client) -> None:
    """Catches a servo that the library cannot find."""
    assert client.call("ping", 2) == (1000, *DONE)
    assert client.call("ping", 9)[1] == COMM_RX_TIMEOUT
    found, result = client.call("broadcastPing")
    assert (sorted(found), result) == ([1, 2, 3], COMM_SUCCESS)


def test_read_and_write_every_width(client: Client) -> None:
    """Catches a register that the library reads or writes with another meaning."""
    assert client.call("write1ByteTxRx", 1, TORQUE, 1) == DONE
    assert client.call("write4ByteTxRx", 1, GOAL, 1500) == DONE
    assert client.call("read1ByteTxRx", 1, TORQUE) == (1, *DONE)
    assert client.call("read2ByteTxRx", 1, 36) == (885, *DONE)
    client.port.now = 10.0
    assert client.call("read4ByteTxRx", 1, PRESENT) == (1500, *DONE)


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (("write1ByteTxRx", 1, TORQUE, 2), StatusError.DATA_RANGE),
        (("write4ByteTxRx", 1, GOAL, 5000), StatusError.DATA_LIMIT),
        (("write2ByteTxRx", 1, GOAL, 5), StatusError.DATA_LENGTH),
        (("write4ByteTxRx", 1, PRESENT, 5), StatusError.ACCESS),
        (("write1ByteTxRx", 1, 66, 5), StatusError.ACCESS),
        (("action", 1), None),
        (("clearMultiTurn", 1), StatusError.NONE),
        (("factoryReset", 1, 0x03), StatusError.DATA_RANGE),
    ],
)
def test_errors_by_number(client: Client, call: tuple[Any, ...], error: StatusError | None) -> None:
    """Catches a refusal that the library reports as success, or by another number."""
    outcome = client.call(*call)
    if error is None:  # the library waits for no answer to an action
        assert outcome == COMM_SUCCESS
    else:
        assert outcome == (COMM_SUCCESS, error)


def test_eeprom_is_locked_by_torque(client: Client) -> None:
    """Catches limits that change under an arm."""
    client.call("write1ByteTxRx", 1, TORQUE, 1)
    assert client.call("write4ByteTxRx", 1, 48, 3000) == (COMM_SUCCESS, StatusError.ACCESS)
    client.call("write1ByteTxRx", 1, TORQUE, 0)
    assert client.call("write4ByteTxRx", 1, 48, 3000) == DONE


def test_registered_writes_wait_for_one_action(client: Client) -> None:
    """Catches arms that start one after another though they were to start together."""
    for servo_id in (1, 2, 3):
        assert client.call("regWriteTxRx", servo_id, LED, 1, [1]) == DONE
        assert client.call("read1ByteTxRx", servo_id, 69)[0] == 1
        assert client.call("read1ByteTxRx", servo_id, LED)[0] == 0
    assert client.call("action", 0xFE) == COMM_SUCCESS
    assert [client.call("read1ByteTxRx", i, LED)[0] for i in (1, 2, 3)] == [1, 1, 1]


@pytest.mark.parametrize("call", ["txRxPacket", "fastSyncRead"])
def test_sync_read_plain_and_fast(client: Client, call: str) -> None:
    """Catches a group read that the library cannot take apart."""
    group = client.group(GroupSyncRead, PRESENT, 4)
    for servo_id in (3, 1, 2):
        assert group.addParam(servo_id)
    assert getattr(group, call)() == COMM_SUCCESS
    assert [group.getData(i, PRESENT, 4) for i in (1, 2, 3)] == [1000, 2000, 3000]


@pytest.mark.parametrize("call", ["txRxPacket", "fastBulkRead"])
def test_bulk_read_plain_and_fast(client: Client, call: str) -> None:
    """Catches registers of different widths that are mixed up."""
    group = client.group(GroupBulkRead)
    assert group.addParam(1, PRESENT, 4)
    assert group.addParam(2, TEMPERATURE, 1)
    assert getattr(group, call)() == COMM_SUCCESS
    assert (group.getData(1, PRESENT, 4), group.getData(2, TEMPERATURE, 1)) == (1000, 32)


def test_sync_and_bulk_write(client: Client) -> None:
    """Catches goals that do not arrive, or arrive at another servo."""
    torque = client.group(GroupSyncWrite, TORQUE, 1)
    for servo_id in (1, 2):
        assert torque.addParam(servo_id, [1])
    assert torque.txPacket() == COMM_SUCCESS
    both = client.group(GroupBulkWrite)
    assert both.addParam(1, GOAL, 4, list((1100).to_bytes(4, "little")))
    assert both.addParam(2, LED, 1, [1])
    assert both.txPacket() == COMM_SUCCESS
    client.port.now = 10.0
    assert client.call("read4ByteTxRx", 1, PRESENT)[0] == 1100
    assert [client.call("read1ByteTxRx", i, LED)[0] for i in (1, 2, 3)] == [0, 1, 0]


@pytest.mark.parametrize(("level", "reads", "writes"), [(0, False, False), (1, True, False), (2, True, True)])
def test_status_return_levels(client: Client, level: int, reads: bool, writes: bool) -> None:
    """Catches a servo that says more or less than it was told to."""
    client.call("write1ByteTxRx", 1, LEVEL, level)
    assert client.call("ping", 1)[1:] == DONE
    assert (client.call("read1ByteTxRx", 1, LED)[1] == COMM_SUCCESS) is reads
    assert (client.call("write1ByteTxRx", 1, LED, 1)[0] == COMM_SUCCESS) is writes
    assert client.servos[0].value("led") == 1


def test_alert_reboot_and_factory_reset(client: Client) -> None:
    """Catches an alarm that the library does not see, or that outlives what clears it."""
    client.servos[0].fail(HardwareError.OVERLOAD, 0.0)
    assert client.call("read4ByteTxRx", 1, PRESENT) == (1000, COMM_SUCCESS, ALERT_BIT)
    assert client.call("write1ByteTxRx", 1, TORQUE, 1) == (COMM_SUCCESS, ALERT_BIT | StatusError.RESULT_FAIL)
    assert client.call("reboot", 1)[0] == COMM_SUCCESS
    assert client.call("write1ByteTxRx", 1, TORQUE, 1) == DONE
    client.call("write1ByteTxRx", 2, 9, 0)
    assert client.call("factoryReset", 2, 0x01)[0] == COMM_SUCCESS
    assert client.call("read1ByteTxRx", 2, 9) == (250, *DONE)


def test_indirect_addresses_gather_what_lies_apart(client: Client) -> None:
    """Catches indirect data that are copies, or that the library reads from the wrong place."""
    for place, address in enumerate((TEMPERATURE, LED)):
        assert client.call("write2ByteTxRx", 1, 168 + 2 * place, address) == DONE
    assert client.call("write1ByteTxRx", 1, 225, 1) == DONE  # the LED, through the second window
    assert client.call("readTxRx", 1, 224, 2) == ([32, 1], *DONE)
    assert client.servos[0].value("led") == 1


def test_turns_are_cleared_at_rest_only(client: Client) -> None:
    """Catches a count that is cleared under a moving arm, or not at all."""
    client.call("write1ByteTxRx", 1, 11, 4)
    client.call("write1ByteTxRx", 1, TORQUE, 1)
    client.call("write4ByteTxRx", 1, GOAL, 9000)
    client.port.now = 0.1
    assert client.call("clearMultiTurn", 1) == (COMM_SUCCESS, StatusError.RESULT_FAIL)
    client.port.now = 60.0
    assert client.call("clearMultiTurn", 1) == DONE
    assert client.call("read4ByteTxRx", 1, PRESENT)[0] == 9000 % 4096
