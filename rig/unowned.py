"""Stopping a machine that no living process owns: its ports are opened just for that."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.bus import ServoBus
from rig.errors import GonioError
from rig.handshake import ServoSpec
from rig.lamp import Lamp
from rig.servos import Servos
from rig.stop_report import PartStop, StopOutcome, StopReport

if TYPE_CHECKING:
    from rig.description import Rig


def stop_unowned(rig: Rig) -> StopReport:
    """Light off, then every servo stopped where it is; what cannot be reached is reported as unknown.

    Raises
    ------
    BadInput
        If the rig file describes an impossible servo.
    """
    specs = [ServoSpec.of(joint) for joint in rig.joints]
    lamp = _stop_lamp(rig.ports.lamp)
    return StopReport((lamp, *_stop_servos(rig, specs)))


def _stop_lamp(port: str) -> PartStop:
    try:
        lamp = Lamp(port)
    except GonioError as error:
        return PartStop("lamp", StopOutcome.UNKNOWN, str(error))
    with lamp:
        return lamp.halt()


def _stop_servos(rig: Rig, specs: list[ServoSpec]) -> tuple[PartStop, ...]:
    names = {joint.id: joint.name for joint in rig.joints}
    try:
        bus = ServoBus(rig.ports.servos, rig.bus.baud, names=names)
    except GonioError as error:
        return (PartStop("servos", StopOutcome.UNKNOWN, str(error)),)
    with bus:
        return Servos(bus, specs, torque_on_stop=rig.bus.torque_on_stop).halt()
