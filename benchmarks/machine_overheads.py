"""The machine's own time on the twin: moves and shots beyond motion and exposure.

    gonio bench machine_overheads

Every figure includes real packets on pseudo-terminals.
"""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING, Any

from benchmarks.rows import row
from capture.raw import inspect_frame
from rig.description import load_rig
from rig.machine import open_machine
from simulator.twin import Twin

if TYPE_CHECKING:
    from pathlib import Path

    from rig.description import Rig

REPEATS = 20
POSE_RAD = (-0.8, 0.0, 0.8, 0.0)

MOVE_TARGET_MS = 60.0
SHOT_TARGET_MS = 60.0


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - nothing to draw
    """Measure, and return one row for each figure."""
    with Twin(speed=100.0) as twin:
        rig = load_rig(twin.rig)
        moves_ms, shots_ms = _overheads_ms(rig)
    return [
        row("move to where the arms stand, median", statistics.median(moves_ms), "ms", MOVE_TARGET_MS),
        row("shot of 1 ms with its file, median", statistics.median(shots_ms), "ms", SHOT_TARGET_MS),
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
