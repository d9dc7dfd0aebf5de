"""Error against time of every method, in scenes that need different ones; the chosen one at each tolerance.

Each scene is rendered at several tolerances in every way that skips no more than the choice does: by one
method alone, or with its direct light as the choice would compute it and the rest by every method that can.
Ways that would take longer than a given time are left out. Truth is that of `benchmarks.light_truth`; times
are processor times of one pose, its kernels compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D

from analysis.style import SERIES, figure
from benchmarks.light_chooser import SMALLEST, Renderings, Way
from benchmarks.light_scenes import Drawn
from benchmarks.light_truth import truth_of
from benchmarks.rows import row
from gonio.output import Progress
from rig.description import Camera, default_rig
from simulator import bsdfs
from simulator.light.choice import Chooser
from simulator.light.methods import METHODS
from simulator.light.mitsuba_scene import sample_events
from simulator.light.scene import PlanarMirror, Scene, default_housing
from simulator.materials import parse_material
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from simulator.light.choice import Decision, Part

TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4)
TOLD = 1e-3
"""The tolerance at which every way is a row."""
SIDE_PX, SAMPLE_PX = 96, 60.0
LONGEST_S = 6.0
MIRROR = PlanarMirror((-90.0, 0.0, 40.0), (0.0, 60.0, 0.0), (0.0, 0.0, 35.0), 0.9)


@dataclass(frozen=True)
class Setting:
    """A scene to be made: a material's line, the pose in degrees, the walls' albedo, mirrors."""

    material: str
    pose_deg: tuple[float, float, float, float]
    albedo: float = 0.0
    mirrors: tuple[PlanarMirror, ...] = ()


SETTINGS = {
    "matte": Setting("lambert:kd=0.5", (30.0, 40.0, -20.0, 15.0)),
    "gloss, m = 0.1": Setting("cook-torrance:kd=0.1,ks=0.5,m=0.1,ior=1.5", (30.0, 0.0, -32.0, 15.0)),
    "gloss, m = 0.01": Setting("cook-torrance:kd=0.1,ks=0.5,m=0.01,ior=1.5", (30.0, 0.0, -30.3, 15.0)),
    "matte, housing 4 %": Setting("lambert:kd=0.5", (30.0, 40.0, -20.0, 15.0), albedo=0.04),
    "m = 0.3, housing 30 %": Setting(
        "cook-torrance:kd=0.2,ks=0.6,m=0.3,ior=1.5", (30.0, 40.0, -20.0, 15.0), albedo=0.3
    ),
    "m = 0.3, mirror": Setting(
        "cook-torrance:kd=0.2,ks=0.6,m=0.3,ior=1.5", (40.0, 0.0, 10.0, 0.0), mirrors=(MIRROR,)
    ),
}


@dataclass(frozen=True, eq=False)
class Tried:
    """A scene's ways at one tolerance: what was chosen, and the others."""

    tolerance: float
    chosen: Way
    others: list[Way]


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Render all scenes by all methods; rows as `gonio bench` prints them."""
    mi = load_mitsuba("llvm")
    bsdfs.register(mi)
    found: dict[str, list[Tried]] = {}
    progress = Progress("scenes", len(SETTINGS))
    for name, setting in SETTINGS.items():
        found[name] = _tried(mi, _drawn(mi, name, setting))
        progress(note=name)
        yield from _rows(name, found[name])
    if plots is not None:
        draw(plots / "light_methods.png", found)


def _drawn(mi: Any, name: str, setting: Setting) -> Drawn:
    """Make a scene whose sample fills most of a small frame."""
    rig = default_rig()
    middle = (SIDE_PX - 1) / 2.0
    camera = Camera(
        width_px=SIDE_PX,
        height_px=SIDE_PX,
        focal_length_px=SAMPLE_PX * rig.camera.distance_mm / rig.sample.diameter_mm,
        principal_point_px=(middle, middle),
    )
    rig, material = default_rig(camera=camera, solids=()), parse_material(setting.material)
    scene = Scene(
        rig,
        material,
        sample_events(mi, material),
        default_housing(rig, setting.albedo),
        mirrors=setting.mirrors,
    )
    return Drawn(scene, tuple(np.radians(setting.pose_deg).tolist()), name)


def _tried(mi: Any, drawn: Drawn) -> list[Tried]:
    """Render a scene in all ways, at all tolerances."""
    truth = truth_of(mi, drawn, min(TOLERANCES))
    if truth is None:
        raise ValueError(f"{drawn.label}: the sample is not seen")
    renderings, found = Renderings(mi, drawn), []
    for tolerance in TOLERANCES:
        chooser = Chooser(mi, drawn.scene, tolerance, METHODS)
        decision = chooser.decide(drawn.pose)
        chosen = renderings.way(decision.parts, truth)
        others = [renderings.way(parts, truth) for parts in _ways(chooser, drawn, decision)]
        found.append(Tried(tolerance, chosen, others))
    return found


def _ways(chooser: Chooser, drawn: Drawn, decision: Decision) -> Iterator[tuple[Part, ...]]:
    """Yield the ways that skip no more than the choice does, one method at a time."""
    direct = decision.by(decision.classes[0])
    kept = len(decision.classes) - len(decision.skipped)
    for parts in chooser.ways(drawn.pose):
        enough = sum(len(part.classes) for part in parts) >= kept
        alone = len(parts) == 1
        rest_by_one = len(parts) == 2 and direct is not None and parts[0].method is direct.method
        if enough and (alone or rest_by_one) and sum(part.seconds for part in parts) < LONGEST_S:
            yield parts


def _rows(name: str, tried: Sequence[Tried]) -> Iterator[dict[str, Any]]:
    for one in tried:
        label = f"{name}, tolerance {one.tolerance:g}, chosen: {' + '.join(one.chosen.methods)}"
        yield row(f"{label}: error", one.chosen.error, "", one.tolerance)
        yield row(f"{label}: time", 1e3 * one.chosen.seconds, "ms")
        if one.tolerance == TOLD:
            for way in sorted(one.others, key=lambda way: way.seconds):
                other = f"{name}, asked for {TOLD:g}: {' + '.join(way.methods)}"
                yield row(f"{other}: error", way.error)
                yield row(f"{other}: time", 1e3 * way.seconds, "ms")


def draw(path: Path, found: dict[str, list[Tried]]) -> None:
    """Draw a panel for each scene, a line for each method over the tolerances, the chosen ones in rings."""
    with figure(9.5, 5.6) as drawn:
        panels = drawn.subplots(2, len(found) // 2, sharex=True, sharey=True)
        colours: dict[str, str] = {}
        for axes, (name, tried) in zip(panels.flat, found.items(), strict=True):
            curves: dict[str, list[Way]] = {}
            for one in tried:
                for way in one.others:
                    curves.setdefault(way.methods[-1], []).append(way)
            for method, ways in curves.items():
                colour = colours.setdefault(method, SERIES[len(colours) % len(SERIES)])
                at = [1e3 * way.seconds for way in ways], [max(way.error, SMALLEST) for way in ways]
                axes.plot(*at, "o-", color=colour, ms=3.0, lw=0.9)
            for one in tried:
                at_chosen = 1e3 * one.chosen.seconds, max(one.chosen.error, SMALLEST)
                axes.plot(*at_chosen, "o", mfc="none", mec="0.15", mew=0.7, ms=7.0)
            axes.set(xscale="log", yscale="log", title=name)
        for axes in panels[-1]:
            axes.set_xlabel("processor time of a pose, ms")
        for axes in panels[:, 0]:
            axes.set_ylabel("RMS error over mean radiance")
        handles = [Line2D([], [], ls="-", marker="o", ms=3, color=c) for c in colours.values()]
        drawn.legend(handles, list(colours), loc="outside lower center", ncol=3, fontsize="small")
        drawn.savefig(path, dpi=110, metadata={"Software": None})
