"""Clearance: no accepted way comes too near, no clear one is refused, and a large plan is dry-run in seconds.

    gonio bench machine

Random moves of the default machine are checked by `benchmarks.clearance_dense`: other code places the
solids, moves them as the twin's servos do, and measures them with FCL, in small steps. Times are CPU time.
"""

from __future__ import annotations

import functools
import math
import os
import time
from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.clearance_dense import DenseClearance, driven_poses
from benchmarks.rows import row
from capture.itinerary import lay_out
from capture.plan import plan_from
from gonio.output import say
from rig.clearance import Clearance
from rig.clearance_pairs import RESOLUTION_MM
from rig.description import default_rig
from rig.detour import Detours

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rig.angles import FloatArray

PAIRS = 100_000
BATCH = 2_000

STEP_RAD = math.radians(1.5)
"""Travel of the fastest joint between two poses that the dense check looks at."""

LOOSE_MM = 0.05
"""How far the other code's distances are off at most: FCL's of a capsule from a cylinder."""

DETOURS = 0.9
DRY_RUN_S = 10.0
PLAN_POSES = 6_561


def run(plots: Path | None) -> Iterator[dict[str, Any]]:  # noqa: ARG001 - nothing to draw
    """Measure, and give one row for each figure."""
    yield from check_moves(PAIRS)
    yield from _dry_run()


def check_moves(count: int, seed: int = 0, *, workers: int | None = None) -> Iterator[dict[str, Any]]:
    """Check random moves between clear poses.

    Parameters
    ----------
    count : int
        Moves.
    seed : int
        Of the poses.
    workers : int, optional
        Processes; by default one for each core.

    Yields
    ------
    dict
        Rows.
    """
    seeds = [(seed, part, min(BATCH, count - part * BATCH)) for part in range(math.ceil(count / BATCH))]
    found = np.zeros(6)
    cpu_s = 0.0
    with ProcessPoolExecutor(workers or os.cpu_count()) as pool:
        for part, (numbers, took_s) in enumerate(pool.map(_check_batch, seeds), start=1):
            found += numbers
            cpu_s += took_s
            say(f"clearance, {min(part * BATCH, count)} of {count} moves")
    blocked, accepted_near, refused_clear, got_round, legs_near, straight_refused = found
    yield row("random moves between clear poses", count)
    yield row("of them blocked", blocked / count)
    yield row("accepted moves nearer than the margin", accepted_near, target=0.0)
    yield row("blocked moves whose witness is not too near", refused_clear, target=0.0)
    yield row("refused moves whose straight line is clear", straight_refused, target=0.0)
    yield row("blocked moves that got a detour", got_round / max(blocked, 1.0), target=DETOURS, at_least=True)
    yield row("detours with a leg nearer than the margin", legs_near, target=0.0)
    yield row("check of a move and its detour, CPU", 1e3 * cpu_s / count, "ms")


@functools.cache
def _codes() -> tuple[Clearance, Detours, DenseClearance]:
    clearance = Clearance(default_rig())
    margin = clearance.rig.clearance.margin_mm
    return clearance, Detours(clearance), DenseClearance(clearance.rig, cutoff_mm=margin + 1.0)


def _check_batch(part: tuple[int, int, int]) -> tuple[FloatArray, float]:
    """Check some moves: counts for the rows, and CPU seconds of the code that is checked."""
    clearance, detours, dense = _codes()
    margin = clearance.rig.clearance.margin_mm
    start, end = _random_moves(clearance, *part)
    began = time.process_time()
    direct = clearance.moves(start, end)
    ways = detours.ways(start, end)
    took_s = time.process_time() - began
    counts = np.zeros(6)
    counts[0] = np.sum(~direct.clear)
    for move, way in enumerate(ways):
        witness = direct.angles_rad[move : move + 1]
        if direct.clear[move]:
            counts[1] += _comes_near(dense, start[move], end[move], margin)
            continue
        counts[2] += dense.nearest_mm(witness) >= margin + RESOLUTION_MM + LOOSE_MM
        if way is None:
            counts[5] += dense.nearest_mm(_straight(start[move], end[move])) >= margin + LOOSE_MM
            continue
        counts[3] += 1.0
        legs = zip([start[move], *way[:-1]], way, strict=True)
        counts[4] += any(_comes_near(dense, *leg, margin) for leg in legs)
    return counts, took_s


def _random_moves(clearance: Clearance, seed: int, part: int, count: int) -> tuple[FloatArray, FloatArray]:
    """Draw clear poses within the limits, in pairs."""
    low, high = clearance.pairs.kinematics.limits_rad.T
    random = np.random.default_rng([seed, part])
    poses = np.empty((0, low.size))
    while len(poses) < 2 * count:
        drawn = random.uniform(low, high, (2 * count, low.size))
        poses = np.concatenate([poses, drawn[clearance.poses(drawn).clear]])
    return poses[:count], poses[count : 2 * count]


def _comes_near(dense: DenseClearance, start: FloatArray, end: FloatArray, margin: float) -> bool:
    poses = driven_poses(dense.rig, start, end, _steps(start, end))
    return dense.nearest_mm(poses, margin - LOOSE_MM) < margin - LOOSE_MM


def _straight(start: FloatArray, end: FloatArray) -> FloatArray:
    share = np.linspace(0.0, 1.0, _steps(start, end))[:, None]
    return np.asarray((1.0 - share) * start + share * end)


def _steps(start: FloatArray, end: FloatArray) -> int:
    return 2 + math.ceil(float(np.max(np.abs(end - start))) / STEP_RAD)


def _dry_run() -> Iterator[dict[str, Any]]:
    """Lay out a plan of 6,561 poses: limits, clearance, shadows, time, disk."""
    azimuths = [round(40.0 * step + 1.5, 3) for step in range(9)]
    content = {
        "version": 1,
        "plan": {"name": "dry run", "sample": "sample1"},
        "poses": [
            {
                "kind": "grid",
                "theta_i_deg": [2.0 + 9.5 * step for step in range(9)],
                "theta_o_deg": [3.0 + 9.5 * step for step in range(9)],
                "phi_deg": azimuths,
                "phi_i_deg": azimuths,
            }
        ],
    }
    plan = plan_from(content, "benchmark")
    began = time.process_time()
    forecast = lay_out(plan, default_rig()).forecast()
    took_s = time.process_time() - began
    poses = forecast.poses + forecast.refused
    yield row("poses of the dry run, refused ones too", poses, target=PLAN_POSES, at_least=True)
    yield row("dry run: limits, clearance, shadows, time, disk; CPU", took_s, "s", DRY_RUN_S)
    yield row("moves of the dry run that go round solids", forecast.detours)
