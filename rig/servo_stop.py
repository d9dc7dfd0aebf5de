"""Stopping servos where they are, whatever becomes of one of them."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from rig.arrival import MOTION, POLL_MAX_S, POLL_MIN_S
from rig.errors import GonioError, Refused
from rig.stop_report import PartStop, StopOutcome, StopReport

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rig.bus import ServoBus, State
    from rig.handshake import ServoSpec

STOP_TICKS = 64
"""A stopped arm may hang this far from its goal by its own weight; further away, the goal was not taken."""

STANDSTILL_S = 3.0
"""How long a stop waits for the arms to come to rest."""


class ServoStop:
    """Stops all servos of a bus.

    Parameters
    ----------
    bus : ServoBus
    specs : mapping of int to ServoSpec
    torque : bool
        Whether the servos hold their place afterwards; else they go limp.
    """

    def __init__(self, bus: ServoBus, specs: Mapping[int, ServoSpec], *, torque: bool) -> None:
        self._bus, self._specs, self._torque = bus, specs, torque

    def halt(self) -> tuple[PartStop, ...]:
        """Stop every servo where it is: goal := present, torque as it shall be, read back.

        Never raises: one servo's failure does not keep the others from being stopped.
        """
        ids = tuple(self._specs)
        try:
            # Asked once: who does not answer is asked again when the others have been told.
            states = self._bus.sync_read(ids, ("present_position",), partial=True, urgent=True, retries=0)
            present = {i: self._specs[i].clamp(state["present_position"]) for i, state in states.items()}
            if present:
                self._bus.sync_write("goal_position", present, urgent=True)
            if not self._torque:
                self._bus.sync_write("torque_enable", dict.fromkeys(ids, 0), urgent=True)
        except GonioError:
            pass  # each servo is now asked on its own, and what fails there is reported
        # Step by step for all: nobody is told to stop only when another one has come to rest.
        steps = [
            [self._try(step, servo_id) for servo_id in ids]
            for step in (self._hold, self._relax, self._read_back)
        ]
        # The worst of each servo's steps, of equal ones the last: it has been read back.
        return tuple(StopReport(tries[::-1]).worst for tries in zip(*steps, strict=True))

    def _try(self, step: Callable[[int], str], servo_id: int) -> PartStop:
        """Take one step of a stop with one servo, whatever becomes of it."""
        part = self._bus.label(servo_id)
        try:
            return PartStop(part, StopOutcome.CONFIRMED, step(servo_id))
        except Refused as error:
            return PartStop(part, StopOutcome.REFUSED, error.what)
        except GonioError as error:
            return PartStop(part, StopOutcome.UNKNOWN, error.what)

    def _hold(self, servo_id: int) -> str:
        """Goal := present, unless the synchronous write has already done it."""
        state = self._state(servo_id)
        goal = self._specs[servo_id].clamp(state["present_position"])
        distance = abs(state["goal_position"] - goal)
        if distance > STOP_TICKS or (state["moving"] and distance > self._specs[servo_id].tolerance):
            self._bus.write(servo_id, "goal_position", goal, urgent=True)
        return ""

    def _relax(self, servo_id: int) -> str:
        # A stop that holds never switches a limp arm on: it may not make anything move.
        if not self._torque:
            self._bus.write(servo_id, "torque_enable", 0, urgent=True)
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
        torque = self._bus.read(servo_id, "torque_enable")
        if torque and not self._torque:
            raise Refused("torque is still on")
        if torque and abs(goal - present) > STOP_TICKS:
            raise Refused(f"stands at {present} ticks but its goal reads {goal}")
        return f"at {present} ticks, torque {'on' if torque else 'off'}"

    def _state(self, servo_id: int) -> State:
        return self._bus.sync_read((servo_id,), MOTION, urgent=True)[servo_id]
