"""Stray light over a housing: error against time of radiosity and of path tracing."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.style import SERIES, figure
from benchmarks.rows import row
from rig.description import default_rig
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator import bsdfs
from simulator.light.gather_nodes import LEVELS
from simulator.light.path_tracer import PathLight
from simulator.light.paths import LightPaths
from simulator.light.radiosity import Radiosity
from simulator.light.reflectance import material_reflectance
from simulator.light.scene import Event, Scene, default_housing
from simulator.materials import parse_material
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from pathlib import Path

Array = NDArray[np.float64]

ALBEDO = 0.04
MATERIALS = {
    "white": ("lambert:kd=0.9", Event.LAMBERTIAN),
    "paint": ("cook-torrance:kd=0.2,ks=0.6,m=0.3,ior=1.5", Event.GLOSSY),
    "gloss": ("cook-torrance:kd=0.05,ks=0.8,m=0.1,ior=1.5", Event.GLOSSY),
}
ANGLES_DEG = (30.0, 40.0, -20.0, 15.0)
DEEPEST = 8
ERROR_TARGET, TIME_TARGET = 0.02, 20.0
STRAY = LightPaths("LD*DlDE")
APART_TARGET = 4.0
PATH_SAMPLES, PATH_RENDERS = 64, 8
REPEATS = 5
CHOSEN = 2
"""Of `LEVELS`, the one whose rows are printed: a tolerance of 1e-2 ends there."""


class Traced(NamedTuple):
    """Path tracing: mean stray light, relative standard error of that of one render, and its time."""

    mean: float
    error: float
    seconds: float


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Compare both for three materials; rows as `gonio bench` prints them."""
    mi = load_mitsuba()
    bsdfs.register(mi)
    rows, curves = [], {}
    for name, (line, event) in MATERIALS.items():
        rig = default_rig()
        scene = Scene(rig, parse_material(line), frozenset({event}), housing=default_housing(rig, ALBEDO))
        means, seconds = _radiosity(mi, scene)
        path = _path(mi, scene)
        # Against its own finest, and against the path tracer as far as that knows: the larger.
        noise = path.error / np.sqrt(PATH_RENDERS)
        apart = abs(means[-1] / path.mean - 1.0)
        own = np.abs(means[:-1] / means[-1] - 1.0)
        error = max(own[CHOSEN], apart + noise)
        # Of independent samples the error falls with the root of the time.
        needed = path.seconds * (path.error / error) ** 2
        curves[name] = (own, seconds[:-1], path)
        rows += [
            row(f"{name}: stray light, error of its mean, at most", error, "", ERROR_TARGET),
            row(f"{name}: stray light, change to the finest", own[CHOSEN], ""),
            row(f"{name}: stray light, a pose", 1e3 * seconds[CHOSEN], "ms"),
            row(f"{name}: path tracing, time for that error", 1e3 * needed, "ms"),
            row(
                f"{name}: path tracing takes longer by",
                needed / seconds[CHOSEN],
                "",
                TIME_TARGET,
                at_least=True,
            ),
            row(f"{name}: path tracing is apart by, in its standard errors", apart / noise, "", APART_TARGET),
        ]
    if plots is not None:
        _plot(curves, plots / "light_housing.png")
    return rows


def _radiosity(mi: Any, scene: Scene) -> tuple[Array, Array]:
    """Mean stray light over the sample, and the time of a pose that ends there, at every level."""
    angles = np.radians(ANGLES_DEG)
    method = Radiosity(scene, material_reflectance(mi, scene.material), STRAY)
    frames, pixels = Kinematics(scene.rig).frames(angles), pixel_geometry(scene.rig, angles)
    places = pixels.position_mm[pixels.on_sample]
    means, seconds = [], []
    for level in LEVELS:
        times = []
        for _ in range(REPEATS):
            start = time.process_time()
            picture = method.picture(frames.light_mm, frames.camera_mm, places, level)[0]
            times.append(time.process_time() - start)
        means.append(picture.mean())
        seconds.append(min(times))
    # A pose goes through all levels below.
    return np.array(means), np.cumsum(seconds)


def _path(mi: Any, scene: Scene) -> Traced:
    """Trace the same pose."""
    angles = np.radians(ANGLES_DEG)
    lit = pixel_geometry(scene.rig, angles).on_sample
    light = PathLight(mi, scene, first=2, last=DEEPEST, samples_per_pixel=PATH_SAMPLES)
    light.estimate(angles, 2)  # compiles
    whole = PathLight(mi, scene, last=DEEPEST, samples_per_pixel=PATH_SAMPLES)
    whole.estimate(angles, 2)
    start = time.process_time()
    whole.estimate(angles, PATH_RENDERS)
    seconds = (time.process_time() - start) / PATH_RENDERS
    # Its direct light, which it renders as well, is left out of its noise.
    found = light.estimate(angles, PATH_RENDERS)
    mean = float(found.mean[lit].mean())
    variance = np.square(found.standard_error[lit]).mean(axis=-1) * PATH_RENDERS
    return Traced(mean, float(np.sqrt(variance.mean() / lit.sum())) / mean, seconds)


def _plot(curves: dict[str, Any], path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    longer = np.array([0.1, 1e4])
    with figure(5.2, 3.2) as drawn:
        axes = drawn.add_subplot()
        for (name, (errors, seconds, traced)), colour in zip(curves.items(), SERIES, strict=False):
            axes.loglog(1e3 * seconds, errors, "o-", color=colour, label=f"{name}, radiosity")
            axes.loglog(
                1e3 * traced.seconds * longer,
                traced.error / np.sqrt(longer),
                "--",
                color=colour,
                label=f"{name}, path tracing",
            )
            axes.loglog(1e3 * seconds[CHOSEN], errors[CHOSEN], "s", color=colour)
        axes.set_xlabel("time of a pose / ms")
        axes.set_ylabel("relative error of the mean")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        drawn.savefig(path, dpi=80, metadata={"Software": None})
