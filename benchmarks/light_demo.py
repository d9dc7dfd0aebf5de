"""The demo's light: the chooser against path tracing, time for the same error.

The demo's materials at poses of its machine, in black surroundings as it has them. A pose is decided and
rendered as the twin does it; path tracing is given the time that it needs for the error of that, which falls
with the root of the time. Both sides take turns, and times are processor times.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.light_scenes import Drawn
from benchmarks.light_truth import truth_of
from benchmarks.rows import row
from gonio.demo_samples import SAMPLES
from rig.description import default_rig
from simulator import bsdfs
from simulator.light.audit import audit_poses
from simulator.light.mitsuba_scene import sample_events
from simulator.light.path_tracer import PathLight
from simulator.light.renderer import Renderer
from simulator.light.scene import Scene
from simulator.materials import parse_material
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from pathlib import Path

POSES, SEED = 6, 3
PATH_TOLERANCE = 1e-2
LEAST_RATIO = 1.0


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - one ratio needs no figure
    """Render the demo's materials both ways; rows as `gonio bench` prints them."""
    mi = load_mitsuba("llvm")
    bsdfs.register(mi)
    # Without the machine's solids, of whose light the truth holds nothing.
    rig = default_rig(solids=())
    renderer = Renderer(rig, {sample.station: sample.material for sample in SAMPLES})
    renderer.prewarm()
    rows, ratios = [], []
    for sample in SAMPLES:
        material = parse_material(sample.material)
        scene = Scene(rig, material, sample_events(mi, material))
        path, poses = PathLight(mi, scene), audit_poses(rig, POSES, SEED)
        path.render(poses[0], 1.0)  # kernels
        errors, seconds, path_seconds = [], [], []
        for pose in poses:
            truth = truth_of(mi, Drawn(scene, pose, sample.name), rig.twin.tolerance)
            if truth is None:
                continue
            begin = time.process_time()
            radiance = renderer.radiance(sample.station, pose)
            between = time.process_time()
            traced = path.render(pose, PATH_TOLERANCE)
            end = time.process_time()
            errors.append(truth.error(radiance))
            seconds.append(between - begin)
            path_seconds.append((end - between) * (truth.error(traced.radiance) / errors[-1]) ** 2)
        ratio = float(np.sum(path_seconds) / np.sum(seconds))
        ratios.append(ratio)
        rows += [
            row(f"{sample.name}: error, worst of {len(errors)} poses", max(errors), "", rig.twin.tolerance),
            row(f"{sample.name}: a pose, decided and rendered", 1e3 * np.median(seconds), "ms"),
            row(f"{sample.name}: path tracing, for the same error", 1e3 * np.median(path_seconds), "ms"),
            row(f"{sample.name}: path tracing takes longer by", ratio, "x", LEAST_RATIO, at_least=True),
        ]
    return rows
