"""The servos as one body: attach without a drop, move and verify, measure, stop.

Positions here are ticks; `rig.machine` turns angles into ticks and back.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rig import bus_watchdog
from rig.errors import DeviceLost, GonioError, Refused, Unsafe
from rig.handshake import Handshake, ServoSpec, configure, shake_hands
from rig.servo_found import describe_errors
from rig.stop_report import PartStop, StopOutcome, StopReport

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rig.bus import ServoBus, State

MOTION = ("goal_position", "moving", "moving_status", "present_position")
"""What a poll reads: 20 adjacent bytes a servo, one packet for all."""

RESEND_LIMIT = 3
"""Nobody confirms a synchronous write; a goal that did not arrive is sent again so often."""

STALL_S = 1.0
"""A servo that has not reached its goal and stands still for this long is stuck."""

STALL_TICKS = 2
"""Less than this is no progress: the encoder's last digit flickers."""

MARGIN_S = 2.0
"""On top of one and a half times the profile's own time."""

STOP_TICKS = 64
"""A stopped arm may hang this far from its goal by its own weight; further away, the goal was not taken."""

STANDSTILL_S = 3.0
"""How long a stop waits for the arms to come to rest."""

POLL_MIN_S, POLL_MAX_S, POLL_GROWTH = 0.001, 0.02, 0.2
"""Pause between two polls: a fifth of the time since the start, within these bounds."""


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


class Servos:
    """All servos of a machine.

    Parameters
    ----------
    bus : ServoBus
    specs : sequence of ServoSpec
        In the order of the rig file.
    torque_on_stop : {"hold", "off"}
        What a stop does with torque.
    settle_reads : int
        Quiet polls in a row that count as arrived.
    watchdog_s : float
        Silence of the bus after which arms on their way stop by themselves; 0 for never.
    """

    def __init__(
        self,
        bus: ServoBus,
        specs: Sequence[ServoSpec],
        *,
        torque_on_stop: str = "hold",
        settle_reads: int = 3,
        watchdog_s: float = 1.0,
    ) -> None:
        self.bus = bus
        self.specs = {spec.servo_id: spec for spec in specs}
        self.ids = tuple(self.specs)
        self._torque_after_stop = 0 if torque_on_stop == "off" else 1
        self._settle_reads = settle_reads
        self._watchdog_s = watchdog_s

    def handshake(self) -> Handshake:
        """Compare expected and found; raises only when the port is gone."""
        return shake_hands(self.bus, tuple(self.specs.values()))

    def attach(self) -> Handshake:
        """Take the arms over where they are, moving nothing: handshake, set-up, goal := present, torque on.

        Raises
        ------
        DeviceLost, Refused
            If the handshake or the set-up fails.
        """
        handshake = self.handshake()
        handshake.require()
        bus_watchdog.disarm(self.bus, self.ids)  # one that tripped refuses every goal
        configure(self.bus, handshake)
        self._adopt(self.bus.sync_read(self.ids, MOTION), handshake)
        for servo_id in self.ids:
            self.bus.write(servo_id, "torque_enable", 1)
            if self.bus.read(servo_id, "torque_enable") != 1:
                raise Refused(
                    "torque does not switch on",
                    where=self.bus.label(servo_id),
                    todo="switch the servo off and on, then run 'gonio rig check'",
                )
        return handshake

    def present(self) -> dict[int, int]:
        """Measured positions, id -> ticks.

        Raises
        ------
        DeviceLost
            If a servo does not answer.
        """
        states = self.bus.sync_read(self.ids, ("present_position",))
        return {servo_id: state["present_position"] for servo_id, state in states.items()}

    def require_held(self, held: Mapping[int, int]) -> None:
        """Pass only if every servo stands still where it was measured.

        Raises
        ------
        Unsafe
            If one moves, or has left its place by more than its tolerance.
        """
        states = self.bus.sync_read(self.ids, MOTION)
        self._require_healthy(states)
        for servo_id, ticks in held.items():
            state, spec = states[servo_id], self.specs[servo_id]
            if state["moving"] or abs(state["present_position"] - ticks) > spec.tolerance:
                raise Unsafe(
                    f"the arm left its place: held at {ticks} ticks, now at {state['present_position']}",
                    where=self.bus.label(servo_id),
                    todo="see what pushed it, then measure this pose again",
                )

    def move(
        self, goals: Mapping[int, int], *, cancelled: Callable[[], bool] = lambda: False
    ) -> dict[int, int]:
        """Move servos together and return only when every one has verifiably arrived.

        Parameters
        ----------
        goals : mapping
            Servo id -> ticks; servos left out keep their place.
        cancelled : callable
            Asked at every poll; true ends the waiting (the stop itself is the asker's business).

        Returns
        -------
        dict
            Measured positions of all servos, id -> ticks.

        Raises
        ------
        Refused
            If a goal lies outside the limits, or the move is cancelled.
        Unsafe
            If a servo does not take its goal, is stuck, stops short, or reports a hardware error; the message
            names it.
        DeviceLost
            If a servo stops answering.
        """
        for servo_id, goal in goals.items():
            self._require_inside(self.specs[servo_id], goal)
        begin = self.bus.sync_read(self.ids, MOTION)
        self._require_healthy(begin)
        start = {servo_id: begin[servo_id]["present_position"] for servo_id in goals}
        with bus_watchdog.armed(self.bus, self.ids, self._watchdog_s):
            self.bus.sync_write("goal_position", goals)
            return self._arrive(goals, start, cancelled)

    def halt(self) -> tuple[PartStop, ...]:
        """Stop every servo where it is: goal := present, torque as the rig file says, read back.

        Never raises: one servo's failure does not keep the others from being stopped.
        """
        try:
            # Asked once: who does not answer is asked again when the others have been told.
            states = self.bus.sync_read(self.ids, ("present_position",), partial=True, urgent=True, retries=0)
            present = {i: self.specs[i].clamp(state["present_position"]) for i, state in states.items()}
            if present:
                self.bus.sync_write("goal_position", present, urgent=True)
            if not self._torque_after_stop:
                self.bus.sync_write("torque_enable", dict.fromkeys(self.ids, 0), urgent=True)
        except GonioError:
            pass  # each servo is now asked on its own, and what fails there is reported
        # Step by step for all: nobody is told to stop only when another one has come to rest.
        steps = [
            [self._try(step, servo_id) for servo_id in self.ids]
            for step in (self._hold, self._relax, self._read_back)
        ]
        # The worst of each servo's steps, of equal ones the last: it has been read back.
        return tuple(StopReport(tries[::-1]).worst for tries in zip(*steps, strict=True))

    def _adopt(self, states: Mapping[int, State], handshake: Handshake) -> None:
        """Goal := present, except where a servo holds its goal: a sagging arm would sink further."""
        torque = {
            row.spec.servo_id: row.found and row.found.registers["torque_enable"] for row in handshake.rows
        }
        for servo_id, state in states.items():
            spec, present, goal = self.specs[servo_id], state["present_position"], state["goal_position"]
            holds = torque[servo_id] and not state["moving"] and abs(goal - present) <= spec.tolerance
            if holds:
                continue
            if spec.clamp(present) != present and abs(spec.clamp(present) - present) > spec.tolerance:
                raise Refused(
                    f"stands at {present} ticks, outside its limits {spec.minimum} to {spec.maximum}",
                    where=self.bus.label(servo_id),
                    todo="switch the servos off and bring the arm inside by hand",
                )
            self.bus.write(servo_id, "goal_position", spec.clamp(present))

    def _require_inside(self, spec: ServoSpec, goal: int) -> None:
        if spec.clamp(goal) != goal:
            raise Refused(
                f"goal {goal} ticks lies outside {spec.minimum} to {spec.maximum}",
                where=self.bus.label(spec.servo_id),
                todo="choose a pose inside limits_deg of the rig file",
            )

    def _require_healthy(self, states: Mapping[int, State]) -> None:
        for servo_id, state in states.items():
            if state.alert:
                errors = describe_errors(self.bus.read(servo_id, "hardware_error_status"))
                raise Unsafe(
                    f"reports {errors or 'a hardware error'}",
                    where=self.bus.label(servo_id),
                    todo="let it cool or free it, switch the servos off and on, then run 'gonio rig check'",
                )

    def _arrive(
        self, goals: Mapping[int, int], start: Mapping[int, int], cancelled: Callable[[], bool]
    ) -> dict[int, int]:
        began = time.monotonic()
        longest = max((self.specs[i].duration_s(goal - start[i]) for i, goal in goals.items()), default=0.0)
        deadline = began + 1.5 * longest + MARGIN_S
        progress = _Progress(dict(start), dict.fromkeys(start, began))
        quiet, resent, last = 0, 0, dict(start)
        while True:
            states = self.bus.sync_read(self.ids, MOTION)
            if cancelled():
                raise Refused("the move was stopped", where=self.bus.port, todo="see why, then run again")
            self._require_healthy(states)
            positions = {servo_id: state["present_position"] for servo_id, state in states.items()}
            lost = {i: goal for i, goal in goals.items() if states[i]["goal_position"] != goal}
            if lost:
                resent = self._resend(lost, resent)
            progress.update({servo_id: positions[servo_id] for servo_id in goals})
            travelling = [i for i in goals if not self._is_there(i, goals[i], states[i])]
            calm = all(abs(positions[i] - last[i]) <= 1 for i in goals)
            quiet = quiet + 1 if calm and not travelling and not lost else 0
            if quiet >= self._settle_reads:
                return positions
            self._require_progress(travelling, goals, positions, progress, deadline)
            last = {servo_id: positions[servo_id] for servo_id in goals}
            pause = POLL_GROWTH * (time.monotonic() - began) if travelling else 0.0
            time.sleep(min(max(pause, POLL_MIN_S), POLL_MAX_S))

    def _is_there(self, servo_id: int, goal: int, state: State) -> bool:
        return not state["moving"] and abs(goal - state["present_position"]) <= self.specs[servo_id].tolerance

    def _resend(self, goals: Mapping[int, int], resent: int) -> int:
        if resent >= RESEND_LIMIT:
            servo_id, goal = next(iter(goals.items()))
            raise Unsafe(
                f"does not take the goal {goal} ticks{self._torque_hint(servo_id)}",
                where=self.bus.label(servo_id),
                todo="run 'gonio rig check': its torque, mode or limits may have changed",
            )
        self.bus.sync_write("goal_position", goals)
        return resent + 1

    def _require_progress(
        self,
        travelling: Sequence[int],
        goals: Mapping[int, int],
        positions: Mapping[int, int],
        progress: _Progress,
        deadline: float,
    ) -> None:
        for servo_id in travelling:
            spec = self.specs[servo_id]
            patience = STALL_S + math.sqrt(2.0) * spec.duration_s(2 * STALL_TICKS)
            if time.monotonic() < deadline and progress.still_s(servo_id) < patience:
                continue
            short = abs(goals[servo_id] - positions[servo_id])
            raise Unsafe(
                f"stands at {positions[servo_id]} ticks, goal {goals[servo_id]}, "
                f"{short * spec.tick_deg:.2f} degrees short{self._torque_hint(servo_id)}",
                where=self.bus.label(servo_id),
                todo="look what blocks the arm; if it only sags, raise tolerance_deg",
            )

    def _torque_hint(self, servo_id: int) -> str:
        try:
            if self.bus.read(servo_id, bus_watchdog.REGISTER) == bus_watchdog.TRIPPED:
                return ", its bus watchdog has tripped"
            return "" if self.bus.read(servo_id, "torque_enable") else ", its torque is off"
        except DeviceLost:
            return ", and it no longer answers"

    def _try(self, step: Callable[[int], str], servo_id: int) -> PartStop:
        """Take one step of a stop with one servo, whatever becomes of it."""
        part = self.bus.label(servo_id)
        try:
            return PartStop(part, StopOutcome.CONFIRMED, step(servo_id))
        except Refused as error:
            return PartStop(part, StopOutcome.REFUSED, error.what)
        except GonioError as error:
            return PartStop(part, StopOutcome.UNKNOWN, error.what)

    def _hold(self, servo_id: int) -> str:
        """Goal := present, unless the synchronous write has already done it."""
        state = self._state(servo_id)
        goal = self.specs[servo_id].clamp(state["present_position"])
        distance = abs(state["goal_position"] - goal)
        if distance > STOP_TICKS or (state["moving"] and distance > self.specs[servo_id].tolerance):
            self.bus.write(servo_id, "goal_position", goal, urgent=True)
        return ""

    def _relax(self, servo_id: int) -> str:
        # "hold" never switches a limp arm on: a stop may not make anything move.
        if not self._torque_after_stop:
            self.bus.write(servo_id, "torque_enable", 0, urgent=True)
        return ""

    def _read_back(self, servo_id: int) -> str:
        deadline = time.monotonic() + STANDSTILL_S
        pause = POLL_MIN_S
        while (state := self._state(servo_id))["moving"]:
            if time.monotonic() > deadline:
                raise Refused(f"still moving after {STANDSTILL_S:g} s")
            time.sleep(pause)
            pause = min(2.0 * pause, POLL_MAX_S)
        present, goal = state["present_position"], state["goal_position"]
        torque = self.bus.read(servo_id, "torque_enable")
        if torque and not self._torque_after_stop:
            raise Refused("torque is still on")
        if torque and abs(goal - present) > STOP_TICKS:
            raise Refused(f"stands at {present} ticks but its goal reads {goal}")
        return f"at {present} ticks, torque {'on' if torque else 'off'}"

    def _state(self, servo_id: int) -> State:
        return self.bus.sync_read((servo_id,), MOTION, urgent=True)[servo_id]
