"""Dynamixel Protocol 2.0 on a serial port: the SDK's packets, with the SDK's defects mended.

The SDK (ROBOTIS, `dynamixel-sdk` 4.x) builds, stuffs and checks packets. What it leaves open is closed here:
outgoing payloads that need stuffing are sent stuffed; missing data are missing, never 0; a hardware alert is
reported beside the data and fails nothing; time is monotonic and the reply timeout is ours; waiting blocks
instead of spinning; the port is opened exclusively; a late reply never answers the next request.

Nothing here is thread-safe: `rig.bus` gives one thread the wire.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import serial
from dynamixel_sdk import (
    COMM_PORT_BUSY,
    COMM_RX_CORRUPT,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    PortHandler,
    Protocol2PacketHandler,
)

from rig.control_table import ALERT_BIT, BAUD_CODES, StatusError
from rig.errors import BadInput, DeviceLost, Refused, Transient
from rig.serial_line import empty_input, open_port

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

BLOCK_S = 0.005
"""How long one read of the port blocks: the resolution of every deadline, and no spinning."""

PING_PARAMETERS = 3
"""A ping's reply carries model number (2 bytes) and firmware (1); no register read has this length."""

_ID, _LENGTH, _ERROR, _PARAMETERS, _CRC_BYTES = 4, 5, 8, 9, 2


class PortLost(DeviceLost):
    """The serial port itself is gone, and every servo with it."""


@dataclass(frozen=True, slots=True)
class Reply:
    """One status packet.

    Attributes
    ----------
    servo_id : int
        Who answered.
    error : int
        Error number without the alert bit; 0 where the instruction worked.
    alert : bool
        The servo has a hardware error standing: read `hardware_error_status`.
    data : bytes
        Parameters, exactly as many as were asked for; empty after a write or an error.
    """

    servo_id: int
    error: int
    alert: bool
    data: bytes


@dataclass(slots=True)
class WireStatistics:
    """What happened on the wire since it was opened."""

    requests: int = 0
    timeouts: int = 0
    corrupt: int = 0
    late: int = 0
    retries: int = 0

    def as_dict(self) -> dict[str, int]:
        """Counters by name, for a report."""
        return {name: getattr(self, name) for name in self.__slots__}


class DeadlinePort(PortHandler):  # type: ignore[misc] # the SDK is untyped
    """The SDK's port with an exclusive open, a monotonic clock, a reply timeout of ours and reads that block.

    Parameters
    ----------
    port : str
        Name of the serial port.
    baud : int
        Bits per second, one of the servos' own rates.
    timeout_s : float
        How long a reply may take beyond its time on the wire.
    """

    def __init__(self, port: str, baud: int, timeout_s: float) -> None:
        super().__init__(port)
        if baud not in BAUD_CODES.values():
            rates = ", ".join(map(str, BAUD_CODES.values()))
            raise BadInput(f"no servo talks at {baud} baud", where=port, todo=f"choose one of {rates}")
        self.baudrate = baud
        self.reply_timeout_s = timeout_s

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802, ARG002 - the SDK's name and signature
        """Open the port, for us alone."""
        self.ser = open_port(self.port_name, self.baudrate, read_timeout_s=BLOCK_S)
        self.is_open = True
        self.tx_time_per_byte = 1000.0 / self.baudrate * 10.0
        return True

    def getCFlagBaud(self, baudrate: int) -> int:  # noqa: N802
        """Every rate the servos know, 4.5 MBd included; the constructor refused the others."""
        return baudrate

    def clearPort(self) -> None:  # noqa: N802
        """Drop what arrived unasked; a port that is gone says so as every other call does."""
        empty_input(self.ser)

    def getCurrentTime(self) -> float:  # noqa: N802
        """Milliseconds on a clock that nobody sets."""
        return time.monotonic() * 1000.0

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Start the wait for a reply of so many bytes."""
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + self.reply_timeout_s * 1000.0)


class StuffingPacketHandler(Protocol2PacketHandler):  # type: ignore[misc] # the SDK is untyped
    """The SDK's packet handler; its `txPacket` ignores what `addStuffing` returns, so we stuff in place."""

    def addStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802
        """Stuff FF FF FD in the payload, in place."""
        packet[:] = super().addStuffing(packet)
        return packet


@dataclass(slots=True)
class Wire:
    """Transactions with the servos on one port: one request, its replies, a deadline; no retries.

    Parameters
    ----------
    port : str
        Name of the serial port.
    baud : int
        Bits per second.
    timeout_s : float
        How long a reply may take beyond its time on the wire; 0.1 s also holds on a loaded machine.

    Raises
    ------
    BadInput, Refused, DeviceLost
        When the port cannot be opened.
    """

    port: str
    baud: int = 1_000_000
    timeout_s: float = 0.1
    statistics: WireStatistics = field(default_factory=WireStatistics)
    _line: Any = field(init=False, repr=False)
    _packets: Any = field(init=False, repr=False)
    _in_step: set[int] = field(init=False, default_factory=set, repr=False)

    def __post_init__(self) -> None:
        self._packets = StuffingPacketHandler()
        self._line = DeadlinePort(self.port, self.baud, self.timeout_s)
        self._line.openPort()

    def close(self) -> None:
        """Close the port; a second time does nothing."""
        if self._line.is_open:
            self._line.closePort()

    def ping(self, servo_id: int) -> Reply:
        """Ask one servo whether it is there; `data` is model number and firmware version.

        Raises
        ------
        Transient
            If it does not answer in time.
        """
        self._send(lambda: self._packets.txPacket(self._line, self._bare(servo_id, 1)))
        self._line.setPacketTimeout(11 + PING_PARAMETERS)
        return self._reply(servo_id, PING_PARAMETERS)

    def broadcast_ping(self) -> dict[int, tuple[int, int]]:
        """Find every servo on the bus: id -> (model number, firmware); takes about a second."""
        self._release()
        found, _ = self._guard(lambda: self._packets.broadcastPing(self._line))
        return {int(servo_id): (int(model), int(firmware)) for servo_id, (model, firmware) in found.items()}

    def read(self, servo_id: int, address: int, length: int) -> Reply:
        """Read `length` bytes of one servo's control table.

        Raises
        ------
        Transient
            If no valid reply comes in time.
        """
        self._get_in_step(servo_id)
        self._send(lambda: self._packets.readTx(self._line, servo_id, address, length))
        return self._reply(servo_id, length)

    def write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Write bytes into one servo's control table and wait for its confirmation.

        Raises
        ------
        Transient
            If no valid reply comes in time.
        """
        self._get_in_step(servo_id)
        self._send(lambda: self._packets.writeTxOnly(self._line, servo_id, address, len(data), list(data)))
        self._line.setPacketTimeout(11)
        return self._reply(servo_id, 0)

    def reboot(self, servo_id: int) -> Reply:
        """Restart one servo: torque goes off, RAM returns to its defaults, alerts are cleared."""
        self._get_in_step(servo_id)
        self._send(lambda: self._packets.txPacket(self._line, self._bare(servo_id, 8)))
        self._line.setPacketTimeout(11)
        return self._reply(servo_id, 0)

    def sync_read(self, servo_ids: Sequence[int], address: int, length: int) -> dict[int, Reply]:
        """Read the same bytes of several servos; who does not answer is missing from the result, never 0."""
        for servo_id in servo_ids:
            with contextlib.suppress(Transient):  # its absence from the result below says so
                self._get_in_step(servo_id)
        asked = [servo_id for servo_id in servo_ids if servo_id in self._in_step]
        if not asked:
            return {}
        self._send(lambda: self._packets.syncReadTx(self._line, address, length, asked, len(asked), False))
        replies: dict[int, Reply] = {}
        while len(replies) < len(asked):
            reply = self._next(length)
            if reply is None:
                break
            if reply.servo_id in asked and reply.servo_id not in replies:
                replies[reply.servo_id] = reply
            else:
                self.statistics.late += 1
        self._in_step.difference_update(missing(asked, replies))
        return replies

    def sync_write(self, address: int, values: Mapping[int, bytes]) -> None:
        """Write bytes of equal length to several servos in one packet; nobody confirms it: read back."""
        size = len(next(iter(values.values())))
        payload = [byte for servo_id, data in values.items() for byte in (servo_id, *data)]
        self._send(lambda: self._packets.syncWriteTxOnly(self._line, address, size, payload, len(payload)))

    @staticmethod
    def _bare(servo_id: int, instruction: int) -> list[int]:
        return [0, 0, 0, 0, servo_id, 3, 0, instruction, 0, 0]

    def _release(self) -> None:
        # An exception between sending and receiving leaves the SDK's busy flag set for ever.
        self._line.is_using = False

    def _guard(self, action: Any) -> Any:
        """Run an SDK call; a port that vanished under it is a lost device."""
        try:
            return action()
        except (serial.SerialException, OSError, TypeError, AttributeError) as error:
            # pyserial fails with TypeError or AttributeError when the port is closed while it waits.
            raise PortLost(
                f"the servo port is gone ({error})",
                where=self.port,
                todo="check cable, adapter and power, then run 'gonio rig check'",
            ) from error

    def _send(self, action: Any) -> None:
        self._release()
        self.statistics.requests += 1
        result = self._guard(action)
        if result != COMM_SUCCESS:
            busy = " (port busy)" if result == COMM_PORT_BUSY else ""
            raise Transient(f"a packet could not be sent{busy}", where=self.port, todo="try again")

    def _next(self, parameters: int) -> Reply | None:
        """Next status packet that fits the request, None when the time is over; others are dropped."""
        while True:
            packet, result = self._guard(lambda: self._packets.rxPacket(self._line, False))
            if result == COMM_RX_TIMEOUT:
                self.statistics.timeouts += 1
                return None
            if result == COMM_RX_CORRUPT:
                self.statistics.corrupt += 1
                if self._line.getTimeSinceStart() > self._line.packet_timeout:
                    return None
                continue
            count = packet[_LENGTH] + 256 * packet[_LENGTH + 1] - 4
            error = packet[_ERROR] & ~ALERT_BIT
            if count == parameters or (count == 0 and error):
                data = bytes(packet[_PARAMETERS : _PARAMETERS + count])
                return Reply(packet[_ID], error, bool(packet[_ERROR] & ALERT_BIT), data)
            self.statistics.late += 1

    def _reply(self, servo_id: int, parameters: int) -> Reply:
        while True:
            reply = self._next(parameters)
            if reply is None:
                self._in_step.discard(servo_id)
                raise Transient(f"servo {servo_id} did not answer in time", where=self.port, todo="try again")
            if reply.servo_id == servo_id:
                return reply
            self.statistics.late += 1

    def _get_in_step(self, servo_id: int) -> None:
        """Make sure that no reply of a servo is still on its way: our own, given up, or a predecessor's.

        The protocol numbers no packets, but a servo answers in order: once a ping, whose reply has a length
        of its own, is answered, whatever was asked before has been answered or never will be.
        """
        if servo_id not in self._in_step:
            self.ping(servo_id)
            self._in_step.add(servo_id)


def check(reply: Reply, action: str, port: str) -> Reply:
    """Turn a status packet's error number into the error tree; an alert alone passes.

    Raises
    ------
    Transient
        If the servo saw a corrupt packet.
    Refused
        If it declined the instruction.
    """
    if reply.error == StatusError.NONE:
        return reply
    try:
        reason = StatusError(reply.error).name.lower().replace("_", " ")
    except ValueError:
        reason = f"error {reply.error}"
    message = f"servo {reply.servo_id} refused to {action} ({reason})"
    if reply.error == StatusError.CRC:
        raise Transient(message, where=port, todo="try again")
    raise Refused(message, where=port, todo="compare rig.toml with the servo: 'gonio rig check' shows both")


def missing(asked: Iterable[int], answered: Iterable[int]) -> list[int]:
    """Servos that were asked and did not answer, in the order asked."""
    there = set(answered)
    return [servo_id for servo_id in asked if servo_id not in there]
