"""The machine's own time on the twin: moves and shots beyond motion and exposure, and stops.

    gonio bench machine

Every figure includes real packets on pseudo-terminals. The stop is timed from the call to the first byte that
turns the light off, by the twin's own record of the wire.
"""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING, Any

from capture.raw import inspect_frame
from rig.description import load_rig
from rig.machine import open_machine
from simulator.twin import Twin

if TYPE_CHECKING:
    from pathlib import Path

    from rig.description import Rig

REPEATS = 20
STOPS = 10
POSE_RAD = (-0.8, 0.0, 0.8, 0.0)
LIGHT_OFF = b"OUTP OFF"

MOVE_TARGET_MS = 60.0
SHOT_TARGET_MS = 60.0
STOP_TARGET_MS = 100.0


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - nothing to draw
    """Measure, and return one row for each figure."""
    with Twin(speed=100.0) as twin:
        rig = load_rig(twin.rig)
        moves_ms, shots_ms = _overheads_ms(rig)
        stops_ms = [_stop_ms(rig, twin) for _ in range(STOPS)]
    return [
        _row("move to where the arms stand, median", statistics.median(moves_ms), MOVE_TARGET_MS),
        _row("shot of 1 ms with its file, median", statistics.median(shots_ms), SHOT_TARGET_MS),
        _row("stop asked for to light off on the wire, worst", max(stops_ms), STOP_TARGET_MS),
    ]


def _overheads_ms(rig: Rig) -> tuple[list[float], list[float]]:
    moves, shots = [], []
    with open_machine(rig, inspect=inspect_frame) as machine:
        machine.move(POSE_RAD, "white")
        machine.shoot("warm", 0.001)
        for index in range(REPEATS):
            began = time.perf_counter()
            machine.move(POSE_RAD, "white")
            moved = time.perf_counter()
            machine.shoot(f"shot-{index}", 0.001)
            moves.append(1e3 * (moved - began))
            shots.append(1e3 * (time.perf_counter() - moved))
    return moves, shots


def _stop_ms(rig: Rig, twin: Twin) -> float:
    with open_machine(rig, inspect=inspect_frame) as machine:
        machine.lamp.on()
        asked = time.monotonic()
        machine.stop()
    heard = (
        event["t"]
        for event in twin.wire_log()
        if event["t"] >= asked
        and event["line"] == "lamp"
        and event.get("direction") == "in"
        and LIGHT_OFF in bytes.fromhex(event["data"])
    )
    return 1e3 * (next(heard) - asked)


def _row(name: str, value_ms: float, target_ms: float) -> dict[str, Any]:
    return {"name": name, "value": value_ms, "unit": "ms", "target": target_ms, "ok": value_ms <= target_ms}
