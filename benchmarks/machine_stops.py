"""Stops of every cause, timed on the wire: from what told the program to the last byte that stops something.

    gonio bench machine_stops

The twin's record of the wire and the program share the monotonic clock. A stop counts from the moment when
the program could know: the answer that told it on the wire, the signal that was sent, the error that was
raised; a first Ctrl-C from the end of its frame; a dead parent from when it was missed (it is looked for five
times a second). It ends with the last byte that puts out the light, halts an arm or cuts a torque; what is
read back later stops nothing. Every stop must be complete: light off, and all five servos told.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from benchmarks import machine_stop_causes as causes
from benchmarks.rows import row
from gonio.output import say
from rig.control_table import CONTROL_TABLE
from rig.description import default_rig, dump_rig
from simulator.packets import Instruction, Packet, PacketReader
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

EACH = 21
"""Stops of each cause: 210 of all ten."""

TARGET_MS = 100.0

CALM = {
    "gonio rig stop": causes.stopped_from_outside,
    "an exception": causes.an_exception,
    "Ctrl-C": causes.ctrl_c,
    "Ctrl-C twice": causes.ctrl_c_twice,
    "SIGTERM": causes.sigterm,
    "a dead parent": causes.a_dead_parent,
}
"""Causes on a twin that is well, in no hurry: arms are in full motion when it comes."""

FAILING = {
    "an open door": (causes.an_open_door, ({"kind": "door-open", "for_s": 0.3},)),
    "an overheated servo": (causes.an_overheated_servo, ({"kind": "overheating"},)),
    "an overloaded servo": (causes.an_overloaded_servo, ({"kind": "overload"},)),
    "a drifting lamp": (
        causes.a_drifting_lamp,
        (
            {"kind": "lamp-drift", "factor": 0.5, "for_s": 0.0},
            {"kind": "lamp-drift", "factor": 1.0, "for_s": 0.0},
        ),
    ),
}
"""Causes that a script of faults makes happen: one exposure of the twin for each fault."""

CALM_SPEED, FAILING_SPEED = 2.0, 50.0

_STOPPING = {CONTROL_TABLE[name].address for name in ("goal_position", "torque_enable")}
_DARK = (b"OUTP OFF", b"SHUT:ABOR")


def stops(each: int = EACH) -> Iterator[tuple[str, float, bool]]:
    """Stop machines.

    Parameters
    ----------
    each : int
        How often for each cause.

    Yields
    ------
    tuple of str, float and bool
        The cause, the time to the last stopping byte in milliseconds, and whether all was told and confirmed.
    """
    with tempfile.TemporaryDirectory(prefix="gonio-stops-") as place:
        folder = Path(place)
        rig = _rig(folder)
        with Twin(speed=CALM_SPEED, rig=rig) as twin:
            scene = causes.Scene(twin)
            for name, cause in CALM.items():
                yield from _repeat(name, cause, scene, each)
        for name, (cause, faults) in FAILING.items():
            script = folder / "faults.toml"
            script.write_text(tomli_w.dumps({"fault": _often(faults, each)}))
            with Twin(speed=FAILING_SPEED, rig=rig, faults=script) as twin:
                yield from _repeat(name, cause, causes.Scene(twin), each)


def _repeat(
    name: str, cause: Callable[[causes.Scene], causes.Stop], scene: causes.Scene, each: int
) -> Iterator[tuple[str, float, bool]]:
    say(f"stops: {name}, {each} times")
    for _ in range(each):
        stop = cause(scene)
        last, complete = _last_byte(scene, stop)
        yield name, 1e3 * (last - stop.known), complete and stop.confirmed


def _last_byte(scene: causes.Scene, stop: causes.Stop) -> tuple[float, bool]:
    """When the last byte of a stop arrived, and whether light and every servo were told."""
    told: dict[object, float] = {}
    reader = PacketReader()
    for event in scene.twin.wire_log():
        if not stop.known <= event["t"] <= stop.end or event.get("direction") != "in":
            continue
        data = bytes.fromhex(event["data"])
        if event["line"] == "lamp":
            if any(word in data for word in _DARK):
                told["light"] = event["t"]
            continue
        for packet in reader.feed(data):
            if isinstance(packet, Packet):
                told |= dict.fromkeys(_stopped_by(packet), event["t"])
    complete = told.keys() >= {"light", *(joint.id for joint in scene.rig.joints)}
    return max(told.values(), default=stop.end), complete


def _stopped_by(packet: Packet) -> list[int]:
    """Servos that a packet halts or makes limp."""
    address = int.from_bytes(packet.parameters[:2], "little")
    if address not in _STOPPING:
        return []
    if packet.instruction == Instruction.WRITE:
        return [packet.servo_id]
    if packet.instruction == Instruction.SYNC_WRITE:
        step = int.from_bytes(packet.parameters[2:4], "little") + 1
        return list(packet.parameters[4::step])
    return []


def _often(faults: tuple[dict[str, Any], ...], each: int) -> list[dict[str, Any]]:
    """Let the same happen at one exposure after the other."""
    return [
        {**fault, "at_exposure": len(faults) * turn + number, **_place(fault["kind"])}
        for turn in range(each)
        for number, fault in enumerate(faults, start=1)
    ]


def _place(kind: str) -> dict[str, str]:
    return {"joint": causes.FAILING_JOINT} if kind in {"overheating", "overload"} else {}


def _rig(folder: Path) -> Path:
    """Write the default machine with a small picture, and nothing that could be in its way."""
    rig = default_rig()
    camera = rig.camera.model_copy(
        update={
            "width_px": 32, "height_px": 24, "focal_length_px": 600.0, "principal_point_px": (15.5, 11.5)
        }
    )  # fmt: skip
    path = folder / "machine.toml"
    dump_rig(rig.model_copy(update={"camera": camera, "solids": ()}), path)
    return path


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Stop machines, and return a row for each cause and one for all; see the module."""
    del plots
    worst_ms: dict[str, float] = {}
    count = incomplete = 0
    for name, time_ms, complete in stops():
        worst_ms[name] = max(worst_ms.get(name, 0.0), time_ms)
        count, incomplete = count + 1, incomplete + (not complete)
    return [
        *(row(f"{name}: last stop byte, worst", value, "ms", TARGET_MS) for name, value in worst_ms.items()),
        row("stops", count, "", 200, at_least=True),
        row("stops that left something untold or unconfirmed", incomplete, "", 0),
    ]
