"""Path tracing in both of Mitsuba's modes: means of independent renders, compared pixel by pixel.

As in Mitsuba's own tests: a z-test per pixel and channel, corrected for their number after Sidak (1967),
passed if nearly all accept.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from benchmarks.rows import row
from rig.description import Camera, default_rig
from simulator import bsdfs
from simulator.light.mitsuba_scene import sample_events
from simulator.light.path_tracer import Estimate, PathLight
from simulator.light.scene import Scene, default_housing
from simulator.materials import parse_material
from simulator.variant import LLVM, SCALAR, load_mitsuba

if TYPE_CHECKING:
    from pathlib import Path

SIDE_PX, RENDERS, LAST = 24, 48, 4
POSE = (0.5, 0.3, -0.4, 0.2)
SIGNIFICANCE, ACCEPTED = 0.01, 0.9975
ALBEDO = 0.3


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - one share needs no figure
    """Trace the same housing in both modes; rows as `gonio bench` prints them."""
    first, second = _traced(SCALAR), _traced(LLVM)
    variance = np.square(first.standard_error) + np.square(second.standard_error)
    seen = variance > 0.0
    z = np.abs(first.mean - second.mean)[seen] / np.sqrt(variance[seen])
    single = 1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / z.size)
    share = float(np.mean(2.0 * norm.sf(z) >= single))
    return [
        row(
            f"path tracing, scalar and LLVM: share of {z.size} values that the z-test accepts",
            share,
            "",
            ACCEPTED,
            at_least=True,
        ),
        row("path tracing, scalar and LLVM: standard deviation of z", float(np.sqrt(np.mean(z**2)))),
    ]


def _traced(variant: str) -> Estimate:
    """Trace a white in a bright housing."""
    mi = load_mitsuba(variant)
    bsdfs.register(mi)
    middle = (SIDE_PX - 1) / 2.0
    camera = Camera(
        width_px=SIDE_PX,
        height_px=SIDE_PX,
        focal_length_px=20.0 * SIDE_PX,
        principal_point_px=(middle, middle),
    )
    rig, material = default_rig(camera=camera), parse_material("lambert:kd=0.5")
    scene = Scene(rig, material, sample_events(mi, material), default_housing(rig, ALBEDO))
    return PathLight(mi, scene, last=LAST).estimate(POSE, RENDERS)
