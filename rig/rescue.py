"""Parking the arms that can be parked, though one of them reports an error or does not answer.

The light goes off first. Servos that are well go to their park angles at once; the others are left as they
are, and the report says why. Their arms stand where they stand: a way that comes near one is not taken.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rig.bus import ServoBus
from rig.errors import Refused
from rig.handshake import ServoSpec, shake_hands
from rig.lamp import Lamp
from rig.owner import PortOwner
from rig.servos import Servos
from rig.stop_report import PartStop, StopOutcome, StopReport
from rig.ticks import rad_to_ticks, tick_rad, ticks_to_rad

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rig.description import Rig
    from rig.handshake import Handshake


def park_others(rig: Rig, on_abort: Callable[[Callable[[], object]], None]) -> StopReport:
    """Park every arm whose servo is well.

    Parameters
    ----------
    rig : Rig
    on_abort : callable
        Told what stops the arms, for whoever hears of a Ctrl-C.

    Returns
    -------
    StopReport
        Confirmed for the light and for each servo that stands where it parks.

    Raises
    ------
    BadInput, Refused, DeviceLost
        If the ports cannot be used, or another process runs the machine.
    Refused
        If the way of those that are well is blocked, or where an arm stands is not known.
    Unsafe
        If one that was well does not get there; all are stopped then.
    """
    names = {joint.id: joint.name for joint in rig.joints}
    with Lamp(rig.ports.lamp) as lamp, ServoBus(rig.ports.servos, rig.bus.baud, names=names) as bus:
        specs = [ServoSpec.of(joint) for joint in rig.joints]
        all_of_them = Servos(bus, specs, torque_on_stop=rig.bus.torque_on_stop)

        def stop() -> StopReport:
            return StopReport((lamp.halt(), *all_of_them.halt()))

        owner = PortOwner(rig, stop)
        try:
            on_abort(stop)
            dark = lamp.halt()
            found = shake_hands(bus, specs)
            well = [row.spec for row in found.rows if not row.fault]
            left = {row.spec.servo_id: row.fault for row in found.rows if row.fault}
            present = _present(bus, found)
            goals = _goals(rig, {spec.servo_id for spec in well})
            slack = _require_clear(rig, present, goals)
            servos = Servos(bus, well, watchdog_s=rig.bus.watchdog_s)
            held = _park(servos, goals, slack, stop) if well else {}
        finally:
            owner.release()
    return StopReport((dark, *(_told(bus, spec, held, left) for spec in specs)))


def _park(
    servos: Servos, goals: Mapping[int, int], slack: Mapping[int, float], stop: Callable[[], object]
) -> dict[int, int]:
    servos.attach()
    try:
        return servos.move(goals, slack=slack)
    except BaseException:
        stop()
        raise


def _present(bus: ServoBus, found: Handshake) -> dict[int, int]:
    """Where every servo stands that says so."""
    answering = [row.spec.servo_id for row in found.rows if row.found is not None and row.found.registers]
    states = bus.sync_read(answering, ("present_position",), partial=True) if answering else {}
    return {servo_id: state["present_position"] for servo_id, state in states.items()}


def _goals(rig: Rig, well: set[int]) -> dict[int, int]:
    return {
        joint.id: rad_to_ticks(joint, math.radians(joint.park_deg))
        for joint in rig.arm_joints
        if joint.id in well
    }


def _require_clear(rig: Rig, present: Mapping[int, int], goals: Mapping[int, int]) -> dict[int, float]:
    """Pass only if the arms get to their park angles past those that stay; return how far off they may be."""
    if not rig.solids:
        return {}
    unknown = [joint.name for joint in rig.arm_joints if joint.id not in present]
    if unknown:
        raise Refused(
            f"where {unknown[0]} stands is not known, and another arm could run into it",
            where="gonio rig park",
            todo="bring the arms apart by hand",
        )
    from rig.clearance import Clearance

    start, end = (
        np.array([[ticks_to_rad(joint, ticks[joint.id]) for joint in rig.arm_joints]])
        for ticks in (present, {**present, **goals})
    )
    clearance = Clearance(rig)
    if not bool(clearance.moves(start, end).clear[0]):
        raise Refused(
            "on their way to the park angles arms would come too near to one that stays",
            where="gonio rig park",
            todo="bring the arms apart by hand",
        )
    return {joint.id: clearance.slack_rad / tick_rad(joint) for joint in rig.arm_joints if joint.id in goals}


def _told(bus: ServoBus, spec: ServoSpec, held: Mapping[int, int], left: Mapping[int, str]) -> PartStop:
    part = bus.label(spec.servo_id)
    if spec.servo_id not in left:
        return PartStop(part, StopOutcome.CONFIRMED, f"at {held[spec.servo_id]} ticks")
    silent = left[spec.servo_id] == "does not answer"
    return PartStop(part, StopOutcome.UNKNOWN if silent else StopOutcome.REFUSED, left[spec.servo_id])
