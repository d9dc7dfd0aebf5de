"""The servos as one body: attach without a drop, move and verify, measure, stop.

Positions here are ticks; `rig.machine` turns angles into ticks and back.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig import bus_watchdog
from rig.arrival import MOTION, Arrival, require_healthy, torque_hint
from rig.errors import Refused, Unsafe
from rig.handshake import Handshake, ServoSpec, configure, shake_hands
from rig.lag import CheckedWay
from rig.servo_stop import ServoStop

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rig.bus import ServoBus, State
    from rig.stop_report import PartStop


PROFILE = (bus_watchdog.REGISTER, "profile_acceleration", "profile_velocity")
"""What a servo forgets when it restarts or its watchdog trips."""


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
        self._stop = ServoStop(bus, self.specs, torque=torque_on_stop != "off")
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
        require_healthy(self.bus, states)
        for servo_id, ticks in held.items():
            state, spec = states[servo_id], self.specs[servo_id]
            if state["moving"] or abs(state["present_position"] - ticks) > spec.tolerance:
                raise Unsafe(
                    f"the arm left its place: held at {ticks} ticks, now at {state['present_position']}",
                    where=self.bus.label(servo_id),
                    todo="see what pushed it, then measure this pose again",
                )

    def move(
        self,
        goals: Mapping[int, int],
        *,
        slack: Mapping[int, float] | None = None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> dict[int, int]:
        """Move servos together and return only when every one has verifiably arrived.

        Parameters
        ----------
        goals : mapping
            Servo id -> ticks; servos left out keep their place.
        slack : mapping, optional
            Servo id -> ticks that it may be off the way that was checked; see `rig.lag`.
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
            If a servo has forgotten its profile, does not take its goal, is stuck, leaves the way, stops
            short, or reports a hardware error; the message names it.
        DeviceLost
            If a servo stops answering.
        """
        for servo_id, goal in goals.items():
            self._require_inside(self.specs[servo_id], goal)
        begin = self.bus.sync_read(self.ids, (*PROFILE, *MOTION))
        require_healthy(self.bus, begin)
        self._require_profile(begin)
        start = {servo_id: begin[servo_id]["present_position"] for servo_id in goals}
        way = CheckedWay(self.specs, start, goals, slack or {})
        with bus_watchdog.armed(self.bus, self.ids, self._watchdog_s):
            self.bus.sync_write("goal_position", goals)
            return Arrival(self.bus, self.specs, goals, start, way).wait(self._settle_reads, cancelled)

    def halt(self) -> tuple[PartStop, ...]:
        """Stop every servo where it is: goal := present, torque as the rig file says, read back.

        Never raises: one servo's failure does not keep the others from being stopped.
        """
        return self._stop.halt()

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

    def _require_profile(self, states: Mapping[int, State]) -> None:
        """Pass only if nobody has forgotten how fast to go: 0 is as fast as the motor can."""
        for servo_id, state in states.items():
            told = self.specs[servo_id].profile | {bus_watchdog.REGISTER: 0}
            if any(state[name] != wanted for name, wanted in told.items()):
                raise Unsafe(
                    f"has forgotten its speed and acceleration{torque_hint(self.bus, servo_id)}",
                    where=self.bus.label(servo_id),
                    todo="see to its supply and to the line; the next start sets it up anew",
                )

    def _require_inside(self, spec: ServoSpec, goal: int) -> None:
        if spec.clamp(goal) != goal:
            raise Refused(
                f"goal {goal} ticks lies outside {spec.minimum} to {spec.maximum}",
                where=self.bus.label(spec.servo_id),
                todo="choose a pose inside limits_deg of the rig file",
            )
