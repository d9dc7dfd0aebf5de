"""The servo bus: one thread owns the wire, others ask it by register name, with retries and a deadline."""

from __future__ import annotations

import itertools
import queue
import threading
import time
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from rig.control_table import CONTROL_TABLE, StatusError
from rig.errors import DeviceLost, Transient
from rig.packets import Reply, Wire, check, missing

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from types import TracebackType

T = TypeVar("T")

DEADLINE_S = 5.0
"""A request not served for this long is lost: a bus with five servos needs milliseconds."""

URGENT, NORMAL = 0, 1


@dataclass(frozen=True, slots=True)
class State:
    """Registers of one servo, read in one packet.

    Attributes
    ----------
    values : mapping
        Register name -> value.
    alert : bool
        The servo has a hardware error standing.
    again : bool
        Not read together with the others: its first answer was lost, and it was asked again.
    """

    values: Mapping[str, int]
    alert: bool
    again: bool = False

    def __getitem__(self, name: str) -> int:
        return self.values[name]


@dataclass(order=True, slots=True)
class _Job:
    priority: int
    number: int
    deadline: float = field(compare=False)
    action: Callable[[Wire], Any] | None = field(compare=False)
    future: Future[Any] = field(compare=False, default_factory=Future)


class ServoBus:
    """The servos on one port.

    Any thread may call any method; a thread of the bus does the talking, one request after the other, urgent
    ones first. A fault that a retry may cure is retried; what remains is raised.

    Parameters
    ----------
    port : str
        Serial port.
    baud : int
        Bits per second.
    names : mapping, optional
        Servo id -> name of its joint, for messages.
    timeout_s : float
        How long a reply may take beyond its time on the wire.
    retries : int
        How often a lost or corrupt reply is asked for again.

    Raises
    ------
    BadInput, Refused, DeviceLost
        When the port cannot be opened.
    """

    def __init__(
        self,
        port: str,
        baud: int = 1_000_000,
        *,
        names: Mapping[int, str] | None = None,
        timeout_s: float = 0.2,
        retries: int = 2,
    ) -> None:
        self.port, self.retries = port, retries
        self._names = dict(names or {})
        self._wire = Wire(port, baud, timeout_s)
        self.statistics = self._wire.statistics
        self._jobs: queue.PriorityQueue[_Job] = queue.PriorityQueue()
        self._numbers = itertools.count()
        self._closed = False
        self._thread = threading.Thread(target=self._serve, name=f"servo bus {port}", daemon=True)
        self._thread.start()

    def __enter__(self) -> ServoBus:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the thread and close the port; a second time does nothing."""
        if self._closed:
            return
        self._closed = True
        self._jobs.put(_Job(URGENT, -1, 0.0, None))
        self._thread.join(DEADLINE_S)
        self._wire.close()

    def label(self, servo_id: int) -> str:
        """How messages name a servo: `servo 3 (camera_elevation)`."""
        name = self._names.get(servo_id)
        return f"servo {servo_id} ({name})" if name else f"servo {servo_id}"

    def ping(self, servo_id: int) -> tuple[int, int]:
        """Model number and firmware version of one servo.

        Raises
        ------
        DeviceLost
            If it does not answer.
        """
        data = self._ask(lambda wire: wire.ping(servo_id), servo_id, "answer a ping").data
        return int.from_bytes(data[:2], "little"), data[2]

    def scan(self) -> dict[int, tuple[int, int]]:
        """Everybody on the bus: id -> (model number, firmware version); takes about a second."""
        return self._submit(lambda wire: wire.broadcast_ping(), urgent=False)

    def read(self, servo_id: int, name: str) -> int:
        """One register of one servo.

        Raises
        ------
        DeviceLost
            If it does not answer.
        Refused
            If it declines.
        """
        register = CONTROL_TABLE[name]
        reply = self._ask(
            lambda wire: wire.read(servo_id, register.address, register.size), servo_id, f"read {name}"
        )
        return register.decode(reply.data)

    def write(self, servo_id: int, name: str, value: int, *, urgent: bool = False) -> None:
        """Write one register of one servo, confirmed by the servo.

        Raises
        ------
        DeviceLost
            If it does not answer.
        Refused
            If it declines: out of range, read only, or EEPROM while torque is on.
        """
        register = CONTROL_TABLE[name]
        data = register.encode(value)
        action = f"set {name} to {value}"
        self._ask(lambda wire: wire.write(servo_id, register.address, data), servo_id, action, urgent=urgent)

    def reboot(self, servo_id: int) -> None:
        """Restart one servo; its torque goes off."""
        self._ask(lambda wire: wire.reboot(servo_id), servo_id, "reboot")

    def sync_read(
        self,
        servo_ids: Sequence[int],
        names: Sequence[str],
        *,
        partial: bool = False,
        urgent: bool = False,
        retries: int | None = None,
    ) -> dict[int, State]:
        """Read the same registers of several servos in one request.

        Parameters
        ----------
        servo_ids : sequence of int
        names : sequence of str
            Registers, close together: everything between the first and the last is read.
        partial : bool
            Leave out who does not answer, instead of raising.
        urgent : bool
            Before every request that waits and is not urgent.
        retries : int, optional
            How often who does not answer is asked again; as usual by default.

        Raises
        ------
        DeviceLost
            If a servo does not answer and `partial` is false.
        """
        registers = [CONTROL_TABLE[name] for name in names]
        start = min(register.address for register in registers)
        length = max(register.end for register in registers) - start
        again = self.retries if retries is None else retries
        first, later = self._submit(
            lambda wire: self._read_all(wire, servo_ids, start, length, again), urgent=urgent
        )
        replies = first | later
        lost = missing(servo_ids, replies)
        if lost and not partial:
            raise self._lost(", ".join(map(self.label, lost)), "no answer")
        states = {}
        for servo_id, reply in replies.items():
            check(reply, "read " + ", ".join(names), self.port)
            states[servo_id] = State(
                {r.name: r.decode(reply.data[r.address - start : r.end - start]) for r in registers},
                reply.alert,
                again=servo_id in later,
            )
        return states

    def sync_write(self, name: str, values: Mapping[int, int], *, urgent: bool = False) -> None:
        """Write one register of several servos in one packet; nobody confirms it: read back."""
        register = CONTROL_TABLE[name]
        data = {servo_id: register.encode(value) for servo_id, value in values.items()}
        self._submit(lambda wire: wire.sync_write(register.address, data), urgent=urgent)

    def _read_all(
        self, wire: Wire, servo_ids: Sequence[int], start: int, length: int, retries: int
    ) -> tuple[dict[int, Reply], dict[int, Reply]]:
        """Who answered when all were asked, and who only when asked again."""
        first = _intact(wire.sync_read(servo_ids, start, length))
        later: dict[int, Reply] = {}
        for _ in range(retries):
            lost = missing(servo_ids, first | later)
            if not lost:
                break
            wire.statistics.retries += 1
            later |= _intact(wire.sync_read(lost, start, length))
        return first, later

    def _ask(
        self, action: Callable[[Wire], Reply], servo_id: int, what: str, *, urgent: bool = False
    ) -> Reply:
        return self._submit(lambda wire: self._retrying(wire, action, servo_id, what), urgent=urgent)

    def _retrying(self, wire: Wire, action: Callable[[Wire], Reply], servo_id: int, what: str) -> Reply:
        for attempt in itertools.count():
            try:
                return check(action(wire), what, self.port)
            except Transient as error:
                if attempt >= self.retries:
                    raise self._lost(self.label(servo_id), f"did not {what}: {error.what}") from error
                wire.statistics.retries += 1
        raise AssertionError("unreachable")  # pragma: no cover - count() never ends

    def _lost(self, who: str, what: str) -> DeviceLost:
        return DeviceLost(
            what, where=f"{who} on {self.port}", todo="check its power and cable, then run 'gonio rig check'"
        )

    def _submit(self, action: Callable[[Wire], T], *, urgent: bool) -> T:
        if self._closed:
            raise DeviceLost("the bus is closed", where=self.port, todo="open the machine again")
        job = _Job(URGENT if urgent else NORMAL, next(self._numbers), time.monotonic() + DEADLINE_S, action)
        self._jobs.put(job)
        try:
            result: T = job.future.result(DEADLINE_S)
        except FutureTimeoutError:
            job.future.cancel()
            raise DeviceLost(
                f"the bus did not serve a request within {DEADLINE_S:g} s",
                where=self.port,
                todo="check adapter and cable, then run 'gonio rig check'",
            ) from None
        return result

    def _serve(self) -> None:
        while True:
            job = self._jobs.get()
            if job.action is None:
                return
            if time.monotonic() > job.deadline or not job.future.set_running_or_notify_cancel():
                continue  # nobody waits for it any more; doing it late would be doing it unasked
            try:
                job.future.set_result(job.action(self._wire))
            except BaseException as error:  # noqa: BLE001 - whoever asked gets it
                job.future.set_exception(error)


def _intact(replies: dict[int, Reply]) -> dict[int, Reply]:
    """Leave out servos that saw a corrupt request: they are asked again like those that are silent."""
    return {servo_id: reply for servo_id, reply in replies.items() if reply.error != StatusError.CRC}
