"""Looking a machine over without moving it: who answers on which port, and what does not fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rig.bus import ServoBus
from rig.errors import BadInput, GonioError, Unsafe
from rig.handshake import ServoSpec, shake_hands
from rig.hotfolder import RAW_SUFFIXES
from rig.lamp import Lamp
from rig.machine import require_port
from rig.owner import PortOwner
from rig.stop_report import StopReport

if TYPE_CHECKING:
    from pathlib import Path

    from rig.description import Rig
    from rig.handshake import Handshake


@dataclass(frozen=True, slots=True)
class Checkup:
    """What was found.

    Attributes
    ----------
    handshake : Handshake or None
        Servos; None where their port could not be used.
    lamp : dict or None
        Identity, interlock, temperature; None where its port could not be used.
    frames : dict
        Hot folder: path, whether it exists, how many RAW files lie in it.
    faults : tuple of GonioError
        Everything that would keep the machine from working, worst exit code first.
    """

    handshake: Handshake | None
    lamp: dict[str, Any] | None
    frames: dict[str, Any]
    faults: tuple[GonioError, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        servos = self.handshake.as_dict() if self.handshake else None
        faults = [str(fault) for fault in self.faults]
        return {"servos": servos, "lamp": self.lamp, "frames": self.frames, "faults": faults}


def check_machine(rig: Rig) -> Checkup:
    """Look a machine over; nothing moves, no torque changes, the light goes off.

    Raises
    ------
    BadInput
        If a port is not named, or the rig file describes an impossible servo.
    Refused
        If another process runs the machine.
    """
    specs = [ServoSpec.of(joint) for joint in rig.joints]
    require_port(rig.ports.servos, "servo bus", "--servos")
    require_port(rig.ports.lamp, "lamp controller", "--lamp")
    owner = PortOwner(rig, lambda: StopReport(()))
    faults: list[GonioError] = []
    try:
        lamp = _check_lamp(rig.ports.lamp, faults)
        handshake = _check_servos(rig, specs, faults)
    finally:
        owner.release()
    frames = _check_frames(rig.ports.frames, faults)
    return Checkup(handshake, lamp, frames, tuple(sorted(faults, key=lambda fault: -fault.exit_code)))


def _check_lamp(port: str, faults: list[GonioError]) -> dict[str, Any] | None:
    try:
        with Lamp(port) as lamp:
            closed = lamp.interlock_closed()
            if not closed:
                faults.append(Unsafe("the interlock is open", where=port, todo="close the dark room"))
            found = {"port": port, "identity": lamp.identity, "interlock_closed": closed}
            return found | {"temperature_deg_c": lamp.temperature_deg_c()}
    except GonioError as fault:
        faults.append(fault)
        return None


def _check_servos(rig: Rig, specs: list[ServoSpec], faults: list[GonioError]) -> Handshake | None:
    names = {joint.id: joint.name for joint in rig.joints}
    handshake = None
    try:
        with ServoBus(rig.ports.servos, rig.bus.baud, names=names) as bus:
            handshake = shake_hands(bus, specs)
            handshake.require()
    except GonioError as fault:
        faults.append(fault)
    return handshake


def _check_frames(folder: Path, faults: list[GonioError]) -> dict[str, Any]:
    exists = folder.is_dir()
    if not exists:
        faults.append(
            BadInput(
                "no such folder for the camera's files", where=str(folder), todo="make it, or use --frames"
            )
        )
    count = sum(path.suffix.lower() in RAW_SUFFIXES for path in folder.iterdir()) if exists else 0
    return {"folder": str(folder), "exists": exists, "files": count}
