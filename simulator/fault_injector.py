"""Lets the faults of a script happen: on the wires, in the servos, at lamp and door, to the camera's files.

It stands between the wires and what answers on them. The server tells it what arrives, when an exposure
begins and what time it is; it changes bytes, servos, lamp and orders of frames, and nothing else knows of it.
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
from typing import TYPE_CHECKING, Any

from rig.control_table import HardwareError
from simulator.faults import CAMERA, SERVO, WIRE, Fault, FaultKind, FaultScript

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from simulator.lamp import Lamp
    from simulator.pty_line import PtyLine
    from simulator.servo import Servo


class FaultInjector:
    """The faults of one twin, waiting for their turn.

    Parameters
    ----------
    script : FaultScript
    servos : mapping of str to Servo
        By joint.
    lamp : Lamp
    lines : mapping of str to PtyLine
        "servos" and "lamp".
    now : float
        Time of the start.
    on_event : callable (event, time, details)
        Told of every fault that happens, as "fault".
    """

    def __init__(
        self,
        script: FaultScript,
        *,
        servos: Mapping[str, Servo],
        lamp: Lamp,
        lines: Mapping[str, PtyLine],
        now: float,
        on_event: Callable[[str, float, dict[str, object]], None],
    ) -> None:
        self._servos, self._lamp, self._lines, self._start = servos, lamp, lines, now
        self._on_event = on_event
        self._rate, self._random = script.servo_error_rate, random.Random(script.seed)  # noqa: S311
        self._waiting = list(script.faults)
        self._numbers = itertools.count()
        self._later: list[tuple[float, int, Callable[[float], None]]] = []
        self._packets = self._exposures = 0
        self._hits: list[tuple[Fault, int]] = []
        self._camera: list[tuple[Fault, int]] = []
        self._flicker: tuple[Fault, int] | None = None

    # -- time

    def deadline(self) -> float | None:
        """When something will happen by itself; None if nothing will."""
        times = [due for due, _, _ in self._later[:1]]
        times += [self._start + fault.at_s for fault in self._waiting if fault.at_s is not None]
        return min(times, default=None)

    def advance(self, now: float) -> None:
        """Let happen what is due."""
        self._fire(lambda fault: fault.at_s is not None and self._start + fault.at_s <= now, now)
        while self._later and self._later[0][0] <= now:
            due, _, action = heapq.heappop(self._later)
            action(due)

    def exposure_begins(self, now: float) -> None:
        """Count an exposure, and let happen what waits for it."""
        self._exposures += 1
        if self._flicker is not None:
            fault, left = self._flicker
            self._lamp.set_output(1.0 + (fault.factor - 1.0) * self._random.random() if left else 1.0, now)
            self._flicker = (fault, left - 1) if left else None
        self._fire(lambda fault: fault.at_exposure == self._exposures, now)

    # -- wires

    def heard(self, line: str, data: bytes, now: float) -> bytes:
        """Return what of a client's bytes arrives."""
        if line == "servos" and data:
            self._packets += 1
            self._fire(lambda fault: fault.at_packet is not None and fault.at_packet <= self._packets, now)
        return b"".join(part for _, part in self._on_the_way(line, "in", data, now))

    def say(self, line: str, data: bytes, now: float) -> bytes:
        """Return what of the twin's bytes goes out now; the rest follows by itself."""
        sent = b""
        for due, part in self._on_the_way(line, "out", data, now):
            if due <= now:
                sent += part
            else:
                self._after(due, lambda _now, part=part: self._lines[line].write(part))  # type: ignore[misc]
        return sent

    def _on_the_way(self, line: str, direction: str, data: bytes, now: float) -> list[tuple[float, bytes]]:
        if not data:
            return []
        for place, (fault, left) in enumerate(self._hits):
            if (fault.line, fault.direction) == (line, direction):
                self._hits[place : place + 1] = [(fault, left - 1)] if left > 1 else []
                return self._hit(fault, data, now)
        if line == "servos" and self._random.random() < self._rate:
            return [(now, self._corrupt(data) if self._random.random() < 0.5 else b"")]
        return [(now, data)]

    def _hit(self, fault: Fault, data: bytes, now: float) -> list[tuple[float, bytes]]:
        match fault.kind:
            case FaultKind.DROP:
                return []
            case FaultKind.CORRUPT:
                return [(now, self._corrupt(data))]
            case FaultKind.DUPLICATE:
                return [(now, data + data)]
            case _:
                return [(now + fault.for_s, data)]

    def _corrupt(self, data: bytes) -> bytes:
        """Turn one bit over."""
        place = self._random.randrange(len(data))
        return data[:place] + bytes([data[place] ^ (1 << self._random.randrange(8))]) + data[place + 1 :]

    # -- the camera's files

    def of_frame(self) -> dict[str, Any] | None:
        """Return what befalls the file of the exposure that has just completed; None for nothing."""
        if not self._camera:
            return None
        fault, left = self._camera[0]
        self._camera[:1] = [(fault, left - 1)] if left > 1 else []
        return {"kind": fault.kind.value, "for_s": fault.for_s, "factor": fault.factor}

    # -- what happens

    def _fire(self, ready: Callable[[Fault], bool], now: float) -> None:
        for fault in [each for each in self._waiting if ready(each)]:
            self._waiting.remove(fault)
            self._on_event("fault", now, {"kind": fault.kind.value, "joint": fault.joint, "line": fault.line})
            self._happen(fault, now)

    def _happen(self, fault: Fault, now: float) -> None:
        if fault.kind in WIRE:
            self._hits.append((fault, fault.count))
        elif fault.kind in SERVO:
            _befall(self._servos[fault.joint], fault, now)
        elif fault.kind in CAMERA:
            self._camera.append((fault, fault.count))
        elif fault.kind is FaultKind.UNPLUG:
            line = self._lines[fault.line]
            line.unplug()
            self._after(now + fault.for_s, lambda _now: line.plug_in())
        else:
            self._happen_to_the_lamp(fault, now)

    def _happen_to_the_lamp(self, fault: Fault, now: float) -> None:
        lamp = self._lamp
        match fault.kind:
            case FaultKind.DOOR_OPEN:
                lamp.set_interlock(False, now)
                self._after(now + fault.for_s, lambda then: lamp.set_interlock(True, then))
            case FaultKind.LAMP_DRIFT:
                lamp.drift(fault.factor, now, now + fault.for_s)
            case FaultKind.LAMP_FLICKER:
                self._flicker = (fault, fault.count)
            case FaultKind.LAMP_DEAD:
                lamp.set_output(0.0, now)
                if math.isfinite(fault.for_s):
                    self._after(now + fault.for_s, lambda then: lamp.set_output(1.0, then))
            case _:
                lamp.restart(now)

    def _after(self, due: float, action: Callable[[float], None]) -> None:
        heapq.heappush(self._later, (due, next(self._numbers), action))


def _befall(servo: Servo, fault: Fault, now: float) -> None:
    """Let a servo fail."""
    match fault.kind:
        case FaultKind.STUCK:
            servo.hinder(0.0, now, now + fault.for_s)
        case FaultKind.SLOW:
            servo.hinder(fault.factor, now, now + fault.for_s)
        case FaultKind.OVERLOAD:
            servo.fail(HardwareError.OVERLOAD, now)
        case FaultKind.OVERHEATING:
            servo.heat(fault.deg_c, now)
        case FaultKind.LOAD:
            servo.press(fault.factor, now, now + fault.for_s)
        case FaultKind.LOW_VOLTAGE:
            servo.weaken_supply(fault.factor, now, now + fault.for_s)
        case FaultKind.BROWN_OUT:
            servo.reboot(now)
        case FaultKind.LOST_TURN:
            servo.lose_turn(now)
        case _:
            servo.trip_watchdog(now)
