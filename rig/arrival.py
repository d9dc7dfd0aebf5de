"""Waiting until servos have verifiably arrived, and telling at the next look when they will not.

Each look reads all servos in one packet. It ends the wait when one is stuck, off the way that was checked,
does not take its goal, or reports an error; the message names it.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rig import bus_watchdog
from rig.errors import DeviceLost, Refused, Unsafe
from rig.servo_found import describe_errors

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rig.bus import ServoBus, State
    from rig.handshake import ServoSpec
    from rig.lag import CheckedWay

MOTION = ("goal_position", "moving", "moving_status", "present_position")
"""What a look reads: 20 adjacent bytes a servo, one packet for all."""

RESEND_LIMIT = 3
"""Nobody confirms a synchronous write; a goal that did not arrive is sent again so often."""

STALL_S = 1.0
"""A servo that has not reached its goal and stands still for this long is stuck."""

STALL_TICKS = 2
"""Less than this is no progress: the encoder's last digit flickers."""

MARGIN_S = 2.0
"""On top of one and a half times the profile's own time."""

POLL_MIN_S, POLL_MAX_S, POLL_GROWTH = 0.001, 0.02, 0.2
"""Pause between two looks: a fifth of the time since the start, within these bounds."""


@dataclass(slots=True)
class _Progress:
    """When each servo was last seen to come closer."""

    position: dict[int, int]
    changed: dict[int, float]

    def update(self, positions: Mapping[int, int]) -> None:
        now = time.monotonic()
        for servo_id, ticks in positions.items():
            if abs(ticks - self.position[servo_id]) >= STALL_TICKS:
                self.position[servo_id], self.changed[servo_id] = ticks, now

    def still_s(self, servo_id: int) -> float:
        return time.monotonic() - self.changed[servo_id]


class Arrival:
    """One move on its way: its goals have been written.

    Parameters
    ----------
    bus : ServoBus
    specs : mapping of int to ServoSpec
        All servos of the machine.
    goals, start : mapping of int to int
        Servo id -> ticks.
    way : CheckedWay
        Where the servos may be.
    """

    def __init__(
        self,
        bus: ServoBus,
        specs: Mapping[int, ServoSpec],
        goals: Mapping[int, int],
        start: Mapping[int, int],
        way: CheckedWay,
    ) -> None:
        self._bus, self._specs, self._goals, self._way = bus, specs, goals, way
        self._began = time.monotonic()
        longest = max((specs[i].duration_s(goal - start[i]) for i, goal in goals.items()), default=0.0)
        self._deadline = self._began + 1.5 * longest + MARGIN_S
        self._progress = _Progress(dict(start), dict.fromkeys(start, self._began))
        self._last, self._resent = dict(start), 0

    def wait(self, settle_reads: int, cancelled: Callable[[], bool]) -> dict[int, int]:
        """Wait until every servo is within its tolerance and all were quiet for so many looks in a row.

        Returns
        -------
        dict
            Measured positions of all servos, id -> ticks.

        Raises
        ------
        Refused
            If the move is cancelled.
        Unsafe
            If a servo does not take its goal, is stuck, leaves the way, stops short, or reports an error.
        DeviceLost
            If a servo stops answering.
        """
        quiet = 0
        while True:
            states = self._bus.sync_read(tuple(self._specs), MOTION)
            if cancelled():
                raise Refused("the move was stopped", where=self._bus.port, todo="see why, then run again")
            require_healthy(self._bus, states)
            positions = {servo_id: state["present_position"] for servo_id, state in states.items()}
            lost = {i: goal for i, goal in self._goals.items() if states[i]["goal_position"] != goal}
            if lost:
                self._resend(lost)
            self._require_on_way(states)
            self._progress.update({servo_id: positions[servo_id] for servo_id in self._goals})
            travelling = [i for i in self._goals if not self._is_there(i, states[i])]
            calm = all(abs(positions[i] - self._last[i]) <= 1 for i in self._goals)
            quiet = quiet + 1 if calm and not travelling and not lost else 0
            if quiet >= settle_reads:
                return positions
            self._require_progress(travelling, positions)
            self._last = {servo_id: positions[servo_id] for servo_id in self._goals}
            pause = POLL_GROWTH * (time.monotonic() - self._began) if travelling else 0.0
            time.sleep(min(max(pause, POLL_MIN_S), POLL_MAX_S))

    def _is_there(self, servo_id: int, state: State) -> bool:
        distance = abs(self._goals[servo_id] - state["present_position"])
        return not state["moving"] and distance <= self._specs[servo_id].tolerance

    def _resend(self, goals: Mapping[int, int]) -> None:
        if self._resent >= RESEND_LIMIT:
            servo_id, goal = next(iter(goals.items()))
            raise Unsafe(
                f"does not take the goal {goal} ticks{torque_hint(self._bus, servo_id)}",
                where=self._bus.label(servo_id),
                todo="run 'gonio rig check': its torque, mode or limits may have changed",
            )
        self._bus.sync_write("goal_position", goals)
        self._resent += 1

    def _require_on_way(self, states: Mapping[int, State]) -> None:
        """Stop all servos at once where one leaves the way: the others are where nothing was checked."""
        # Who was asked again answered later than the others: its place says nothing about theirs.
        together = {i: state["present_position"] for i, state in states.items() if not state.again}
        lag = self._way.lag(together)
        if lag is None:
            return
        places = {i: self._specs[i].clamp(states[i]["present_position"]) for i in self._goals}
        self._bus.sync_write("goal_position", places, urgent=True)
        behind = "" if lag.ahead is None else f"behind {self._bus.label(lag.ahead)}, "
        raise Unsafe(
            f"is {lag.ticks * self._specs[lag.servo_id].tick_deg:.2f} degrees {behind}"
            f"off the way that was checked for clearance{torque_hint(self._bus, lag.servo_id)}",
            where=self._bus.label(lag.servo_id),
            todo="look what holds or pushes the arm; if it only follows unevenly, raise clearance.lag_deg",
        )

    def _require_progress(self, travelling: Sequence[int], positions: Mapping[int, int]) -> None:
        for servo_id in travelling:
            spec = self._specs[servo_id]
            patience = STALL_S + math.sqrt(2.0) * spec.duration_s(2 * STALL_TICKS)
            if time.monotonic() < self._deadline and self._progress.still_s(servo_id) < patience:
                continue
            short = abs(self._goals[servo_id] - positions[servo_id])
            raise Unsafe(
                f"stands at {positions[servo_id]} ticks, goal {self._goals[servo_id]}, "
                f"{short * spec.tick_deg:.2f} degrees short{torque_hint(self._bus, servo_id)}",
                where=self._bus.label(servo_id),
                todo="look what blocks the arm; if it only sags, raise tolerance_deg",
            )


def require_healthy(bus: ServoBus, states: Mapping[int, State]) -> None:
    """Pass only if no servo reports a hardware error.

    Raises
    ------
    Unsafe
        If one does; the message names it and its errors.
    DeviceLost
        If it does not answer which.
    """
    for servo_id, state in states.items():
        if state.alert:
            errors = describe_errors(bus.read(servo_id, "hardware_error_status"))
            raise Unsafe(
                f"reports {errors or 'a hardware error'}",
                where=bus.label(servo_id),
                todo="let it cool or free it, switch the servos off and on, then run 'gonio rig check'",
            )


def torque_hint(bus: ServoBus, servo_id: int) -> str:
    """Say why a servo may not move, to follow what it did not do; nothing where it could."""
    try:
        if bus.read(servo_id, bus_watchdog.REGISTER) == bus_watchdog.TRIPPED:
            return ", its bus watchdog has tripped"
        return "" if bus.read(servo_id, "torque_enable") else ", its torque is off"
    except DeviceLost:
        return ", and it no longer answers"
