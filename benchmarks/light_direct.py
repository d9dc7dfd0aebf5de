"""Direct light by quadrature against Mitsuba's `direct` at 16 samples per pixel: error, time, honesty.

Errors are RMS over pixels spread over the sample, relative to their mean radiance. Truth is float64's closed
form: at the pixels' centres under a point, as the mean over 64 nodes of the lamp's disc, or as the mean over
4096 nodes of lamp, pixel and pupil together. Efficiency is 1/(MSE t) with t the time of one pose asked for on
its own, from joint angles to a NumPy image, in processor seconds of all threads. Both sides of a ratio take
turns, so that a busy machine slows down both. Half of the poses are in and around the mirror direction, the
others anywhere up to 70 degrees.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.rows import row
from rig.description import Camera, default_rig
from rig.kinematics import Kinematics
from simulator import bsdfs
from simulator.light import mitsuba_scene
from simulator.light.direct import DirectLight
from simulator.light.direct_float64 import Float64Nodes
from simulator.light.direct_llvm import MitsubaNodes
from simulator.light.direct_view import POINTS, Extents, extents_of, lens_of, sample_share, view_of
from simulator.light.reflectance import closed_form_reflectance
from simulator.light.sparse_rules import Levels, product_rule
from simulator.materials import load_bsdf, parse_material
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from simulator.materials import ClosedFormMaterial

Array = NDArray[np.float64]

SIDE_PX, SAMPLES = 256, 16
RIG = default_rig(
    camera=Camera(
        width_px=SIDE_PX, height_px=SIDE_PX, focal_length_px=2400.0, principal_point_px=(127.5, 127.5)
    )
)
RADIUS_MM = RIG.sample.diameter_mm / 2.0
LAMP_ONLY = replace(POINTS, lamp_radius_mm=RIG.lamp.diameter_mm / 2.0)
ALL = extents_of(RIG)
LENS = lens_of(RIG)
POSES, AREA_POSES, HONEST_POSES, NARROW_POSES, SCALAR_POSES = 100, 20, 30, 2, 2
MANY, CHUNK, DIRECT_PER_CHUNK = 1000, 50, 5
EVERY = 37
"""One pixel in so many is compared: no multiple of the frame's width, so that they lie everywhere."""
WIDE = {
    "Lambert": "lambert:kd=0.5",
    "m = 0.3": "cook-torrance:kd=0.1,ks=0.5,m=0.3,ior=1.5",
    "m = 0.1": "cook-torrance:kd=0.1,ks=0.5,m=0.1,ior=1.5",
}
NARROW_M = (0.05, 0.02, 0.01, 0.005)

POINT_ERROR, AREA_ERROR, MODES_ERROR = 5e-7, 1e-6, 1e-6
POINT_EFFICIENCY, AREA_EFFICIENCY, SPEED = 5e5, 1e6, 8.0


@dataclass(frozen=True)
class Compared:
    """One pose: errors and seconds of ours and of Mitsuba's `direct`."""

    pose: tuple[float, ...]
    error: float
    seconds: float
    direct_error: float
    direct_seconds: float

    @property
    def efficiency(self) -> float:
        """1/(MSE t), ours over Mitsuba's."""
        return (self.direct_error / self.error) ** 2 * self.direct_seconds / self.seconds


class MitsubaDirect:
    """Mitsuba's own integrator with independent samples, moved by parameter updates."""

    def __init__(self, mi: Any, material: ClosedFormMaterial, *, disc: bool) -> None:
        self._mi, self._disc, self._kinematics = mi, disc, Kinematics(RIG)
        lamp = mitsuba_scene.disc_lamp(mi, RIG) if disc else mitsuba_scene.point_lamp(RIG)
        to_world = mi.ScalarTransform4f().scale(RADIUS_MM)
        sample = {"type": "rectangle", "to_world": to_world, "bsdf": load_bsdf(mi, material)}
        scene = {
            "type": "scene",
            "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
            "sensor": mitsuba_scene.perspective_camera(mi, RIG, SAMPLES),
            "lamp": lamp,
            "sample": sample,
        }
        self._scene = mi.load_dict(scene, optimize=False)
        self._parameters = mi.traverse(self._scene)

    def render(self, pose: Sequence[float], seed: int = 0) -> Array:
        """Return radiance, (pixels, 3)."""
        mi, frames = self._mi, self._kinematics.frames(np.asarray(pose))
        placed = mitsuba_scene.camera_placed(mi, frames.camera_mm, frames.camera_rotation)
        self._parameters["sensor.to_world"] = placed
        if self._disc:
            self._parameters["lamp.to_world"] = mitsuba_scene.disc_lamp_placed(mi, RIG, frames.light_mm)
        else:
            self._parameters["lamp.position"] = mi.ScalarPoint3f(frames.light_mm.tolist())
        self._parameters.update()
        image = np.asarray(mi.render(self._scene, seed=seed), dtype=np.float64).reshape(-1, 3)
        # Mitsuba's disc has its irradiance of 1 where it is small.
        return image * (1.0 + (LAMP_ONLY.lamp_radius_mm / RIG.lamp.distance_mm) ** 2 if self._disc else 1.0)


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Measure, and return one row for each figure; see the module."""
    mi = load_mitsuba("llvm")
    bsdfs.register(mi)
    rng = np.random.default_rng(20)
    materials = {name: _material(line) for name, line in WIDE.items()}
    rows: list[dict[str, Any]] = []
    compared: dict[str, list[Compared]] = {}
    for label, extents, levels, count, error, efficiency in (
        ("point lamp", POINTS, Levels(0, 0, 0), POSES, POINT_ERROR, POINT_EFFICIENCY),
        ("small area light", LAMP_ONLY, Levels(3, 0, 0), AREA_POSES, AREA_ERROR, AREA_EFFICIENCY),
    ):
        for name, material in materials.items():
            poses = _poses(rng, count, 0.1)
            found = list(_compare(mi, material, extents, levels, poses))
            compared[f"{label}, {name}"] = found
            rows += _compared_rows(f"{label}, {name}", found, error, efficiency)
    rows += _many(mi, materials["m = 0.3"], rng)
    rows += _scalar(materials, rng)
    rows += _modes(mi, materials, rng)
    rows += _honesty(mi, rng)
    rows += _narrow(mi, rng)
    if plots is not None:
        _plot(plots / "light_direct.png", compared)
    return rows


def _material(line: str) -> ClosedFormMaterial:
    material: Any = parse_material(line)
    return material  # type: ignore[no-any-return]


def _poses(rng: np.random.Generator, count: int, spread: float) -> list[tuple[float, ...]]:
    """Poses of which every other one is near the mirror direction."""
    poses: list[tuple[float, ...]] = []
    for index in range(count):
        light, camera, azimuth, table = rng.uniform(-1.2, 1.2, 4)
        if index % 2:
            camera, azimuth = np.array([-light, 0.0]) + rng.normal(0.0, spread, 2)
        poses.append((float(light), float(azimuth), float(np.clip(camera, -1.25, 1.25)), float(table)))
    return poses


def _float64(material: ClosedFormMaterial, extents: Extents) -> DirectLight:
    nodes = Float64Nodes(closed_form_reflectance(material), extents, RADIUS_MM)
    return DirectLight(RIG, nodes, extents)


def _llvm(mi: Any, material: ClosedFormMaterial, extents: Extents) -> DirectLight:
    return DirectLight(RIG, MitsubaNodes(mi, material, extents, RADIUS_MM), extents)


def _truth(
    material: ClosedFormMaterial, extents: Extents, levels: Levels, pose: Sequence[float], every: int = EVERY
) -> tuple[NDArray[np.intp], Array]:
    """Return pixels wholly on the sample, and their radiance by a full product of rules."""
    lens, view = LENS, view_of(Kinematics(RIG).frames(np.asarray(pose)), extents)
    whole = np.flatnonzero(sample_share(view, lens, 3.0, RADIUS_MM) == 1.0)[::every]
    nodes = Float64Nodes(closed_form_reflectance(material), extents, RADIUS_MM)
    return whole, nodes.radiance([view], lens[whole], product_rule(levels))[0]


def _error(image: Array, pixels: NDArray[np.intp], truth: Array) -> float:
    return float(np.sqrt(np.mean(np.square(image.reshape(-1, 3)[pixels] - truth))) / np.mean(truth))


def _timed(call: Callable[[], Any]) -> tuple[float, Any]:
    began = time.process_time()
    result = call()
    return time.process_time() - began, result


def _compare(
    mi: Any,
    material: ClosedFormMaterial,
    extents: Extents,
    levels: Levels,
    poses: Sequence[tuple[float, ...]],
) -> Iterator[Compared]:
    """Render poses both ways in turn."""
    ours = _llvm(mi, material, extents)
    theirs = MitsubaDirect(mi, material, disc=extents.lamp_radius_mm > 0.0)
    for pose in poses[:2]:  # kernels
        ours.render(pose, AREA_ERROR)
        theirs.render(pose)
    for seed, pose in enumerate(poses):
        seconds, rendering = _timed(partial(ours.render, pose, AREA_ERROR))
        direct_seconds, image = _timed(partial(theirs.render, pose, seed))
        pixels, truth = _truth(material, extents, levels, pose)
        error = _error(rendering.radiance, pixels, truth)
        yield Compared(pose, error, seconds, _error(image, pixels, truth), direct_seconds)


def _compared_rows(
    label: str, found: Sequence[Compared], error: float, efficiency: float
) -> list[dict[str, Any]]:
    worst = max(found, key=lambda one: one.error)
    named = np.round(np.degrees(worst.pose), 1).tolist()
    return [
        row(
            f"{label}: error, median of {len(found)} poses",
            np.median([one.error for one in found]),
            "",
            error,
        ),
        row(f"{label}: error, worst pose, {named} deg", worst.error),
        row(f"{label}: error of direct, median", np.median([one.direct_error for one in found])),
        row(f"{label}: time of a pose, median", 1e3 * np.median([one.seconds for one in found]), "ms"),
        row(f"{label}: time of direct", 1e3 * np.median([one.direct_seconds for one in found]), "ms"),
        row(
            f"{label}: 1/(MSE t) over direct, median",
            np.median([one.efficiency for one in found]),
            "x",
            efficiency,
            at_least=True,
        ),
    ]


def _many(mi: Any, material: ClosedFormMaterial, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Many poses in launches of several; Mitsuba's `direct` at a few poses between."""
    poses = _poses(rng, MANY, 0.3)
    points, sizes = _llvm(mi, material, POINTS), _llvm(mi, material, ALL)
    theirs = MitsubaDirect(mi, material, disc=False)
    for warm in (points, sizes):
        list(warm.render_many(poses[:CHUNK], 1e-3))
    theirs.render(poses[0])
    spent = {"points": 0.0, "sizes": 0.0, "direct": 0.0}
    for start in range(0, MANY, CHUNK):
        chunk = poses[start : start + CHUNK]
        spent["points"] += _timed(partial(_drain, points.render_many(chunk, 1e-3)))[0]
        spent["sizes"] += _timed(partial(_drain, sizes.render_many(chunk, 1e-3)))[0]
        for pose in chunk[:DIRECT_PER_CHUNK]:
            spent["direct"] += _timed(partial(theirs.render, pose))[0]
    direct = spent["direct"] * CHUNK / DIRECT_PER_CHUNK
    label = f"{MANY} poses of {SIDE_PX} x {SIDE_PX}, m = 0.3"
    return [
        row(f"{label}: points", spent["points"], "s"),
        row(f"{label}: lamp, pixel and pupil with sizes, tolerance 1e-3", spent["sizes"], "s"),
        row(f"{label}: direct (from every tenth pose)", direct, "s"),
        row(f"{label}: speed over direct, points", direct / spent["points"], "x", SPEED, at_least=True),
        row(f"{label}: speed over direct, sizes", direct / spent["sizes"], "x"),
    ]


def _drain(renderings: Iterator[Any]) -> None:
    for _ in renderings:
        pass


def _scalar(materials: dict[str, ClosedFormMaterial], rng: np.random.Generator) -> list[dict[str, Any]]:
    """Without LLVM: float64 on our side, Mitsuba's scalar variant on the other."""
    mi = load_mitsuba("scalar")
    bsdfs.register(mi)
    rows = []
    # Lambert alone on Mitsuba's side: a BSDF of ours is Python at every sample there.
    theirs = MitsubaDirect(mi, materials["Lambert"], disc=False)
    ours = {name: _float64(material, POINTS) for name, material in materials.items()}
    spent: dict[str, list[float]] = {"direct": [], **{name: [] for name in ours}}
    for pose in _poses(rng, SCALAR_POSES, 0.3):
        for name, light in ours.items():
            spent[name].append(_timed(partial(light.render, pose, 1e-3))[0])
        spent["direct"].append(_timed(partial(theirs.render, pose))[0])
    rows = [row(f"scalar, {name}: time of a pose", 1e3 * np.median(spent[name]), "ms") for name in ours]
    rows.append(row("scalar, Lambert: time of direct", 1e3 * np.median(spent["direct"]), "ms"))
    load_mitsuba("llvm")
    return rows


def _modes(
    mi: Any, materials: dict[str, ClosedFormMaterial], rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Float64 against LLVM, the same nodes, all parts with sizes."""
    rows = []
    for name, material in materials.items():
        both = _float64(material, ALL), _llvm(mi, material, ALL)
        worst = 0.0
        for pose in _poses(rng, 6, 0.1):
            first, second = (light.render(pose, 1e-4).radiance for light in both)
            pixels, _ = _truth(material, POINTS, Levels(0, 0, 0), pose, every=1)
            worst = max(worst, _error(second, pixels, first.reshape(-1, 3)[pixels]))
        rows.append(row(f"float64 and LLVM, {name}: worst difference of 6 poses", worst, "", MODES_ERROR))
    return rows


def _honesty(mi: Any, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Compare true with estimated errors, over lobes of all widths and tolerances drawn from a seed."""
    ratios = []
    for _ in range(HONEST_POSES):
        m, tolerance = 10.0 ** rng.uniform(-2.0, 0.0), 10.0 ** rng.uniform(-4.0, -1.5)
        material = _material(f"cook-torrance:kd=0.1,ks=0.5,m={m!r},ior=1.5")
        pose = _poses(rng, 2, m)[1]
        rendering = _llvm(mi, material, ALL).render(pose, tolerance)
        pixels, truth = _truth(material, ALL, Levels(2, 2, 2), pose, every=11 * EVERY)
        ratios.append(_error(rendering.radiance, pixels, truth) / rendering.error)
    label = f"true over estimated error, {HONEST_POSES} lobes (m 0.01 to 1), poses and tolerances"
    return [row(f"{label}: worst", max(ratios), "", 1.0), row(f"{label}: median", np.median(ratios))]


def _narrow(mi: Any, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Lobes about as wide as lamp and pupil, in the peak."""
    rows = []
    for m in NARROW_M:
        material = _material(f"cook-torrance:kd=0.1,ks=0.5,m={m!r},ior=1.5")
        poses = _poses(rng, 2 * NARROW_POSES, m)[1::2]
        truths = [_truth(material, ALL, Levels(3, 1, 3), pose, every=13 * EVERY) for pose in poses]
        for tolerance in (1e-2, 1e-3, 1e-4):
            light = _llvm(mi, material, ALL)
            light.render(poses[0], tolerance)
            done = [_timed(partial(light.render, pose, tolerance)) for pose in poses]
            errors = [_error(found.radiance, *truth) for (_, found), truth in zip(done, truths, strict=True)]
            label = f"m = {m:g}, tolerance {tolerance:g}, {done[0][1].did.split(':')[0]}"
            rows.append(row(f"{label}: worst error", max(errors), "", tolerance))
            rows.append(row(f"{label}: time", 1e3 * np.median([seconds for seconds, _ in done]), "ms"))
    return rows


def _plot(path: Path, compared: dict[str, list[Compared]]) -> None:
    """Draw error against time of every scene, both ways."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    axes = figure.subplots()
    for place, (label, found) in enumerate(compared.items()):
        colour = f"C{place}"
        ours = [1e3 * one.seconds for one in found], [one.error for one in found]
        theirs = [1e3 * one.direct_seconds for one in found], [one.direct_error for one in found]
        axes.scatter(*ours, s=9, color=colour, label=label)
        axes.scatter(*theirs, s=9, color=colour, marker="x")
    axes.set(xscale="log", yscale="log", xlabel="time of a pose, ms", ylabel="RMS error over mean radiance")
    axes.set_title(f"Quadrature (dots) and Mitsuba's direct, {SAMPLES} samples per pixel (crosses)")
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=150)
