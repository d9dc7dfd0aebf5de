"""Every method of light in scenes and poses where arithmetic breaks.

The same scene in other units of length, which must change nothing; poses in which light or camera graze the
sample, coincide or are below it; albedos of 0 and 1. Two evaluators have places that can be far from the
origin.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.light_stability_points import POSES, RIG, TOLERANCE, lobe
from benchmarks.rows import row
from rig.angles import unit
from simulator.light.classes import light_paths
from simulator.light.direct_view import POINTS
from simulator.light.methods import METHODS
from simulator.light.mitsuba_scene import sample_events
from simulator.light.reflectance import closed_form_reflectance
from simulator.light.scene import Housing, PlanarMirror, Scene
from simulator.light.surface_light import SurfaceLight
from simulator.light.three_point import PointLamp, Surface, ThreePoint
from simulator.materials import closed_form_material, parse_material
from simulator.variant import LLVM, choose_variant, load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from rig.description import Rig
    from simulator.light.evaluator import Evaluator, Method
    from simulator.materials import ClosedFormMaterial

    Array = NDArray[np.float64]

BELOW: dict[str, tuple[float, ...]] = {
    "light below": (np.pi - 0.5, 0.0, -0.5, 0.0),
    "camera below": (0.5, 0.0, np.pi - 0.5, 0.0),
    "light and camera opposed": (0.5, 0.0, 0.5 - np.pi, 0.0),
}
SCALES = (1e-3, 1e3)
LOOSE = 0.3
"""Tolerance where only numbers of any kind are asked for."""
SINGLE_TARGET, DOUBLE_TARGET, SAMPLED_TARGET = 1e-6, 1e-12, 1e-4
"""Relative change of a picture by other units: rounding, and that of paths which rounding leads elsewhere."""
FAR_MM, FAR_TARGET = 1e9, 1e-7
"""A ball so large is flat to that."""


def white(rho: float) -> ClosedFormMaterial:
    """Return a Lambertian white."""
    return closed_form_material("lambert", {"kd": rho})


def scenes(mi: Any, rig: Rig, material: ClosedFormMaterial, scale: float = 1.0) -> dict[str, Scene]:
    """Return scenes that between them need every method, in units of length so many times smaller."""
    far_mm = 1.5 * scale * max(rig.lamp.distance_mm, rig.camera.distance_mm)
    rig = scaled(rig, scale)
    plain = Scene(rig, material, sample_events(mi, material))
    mirror = PlanarMirror(
        (-300.0 * scale, 0.0, 100.0 * scale), (0.0, 400.0 * scale, 0.0), (0.0, 0.0, 400.0 * scale), 0.8
    )
    tilted = parse_material(f"{material.spec}@tilted:x_deg=3,y_deg=2")
    return {
        "plain": plain,
        "tilted": replace(plain, material=tilted),
        "mirror": replace(plain, mirrors=(mirror,)),
        "housing": replace(plain, housing=Housing(0.3, far_mm)),
    }


def scaled(rig: Rig, scale: float) -> Rig:
    """Return a rig all of whose lengths are multiplied."""

    def times(part: Any, *names: str) -> Any:
        return part.model_copy(update={name: scale * getattr(part, name) for name in names})

    return rig.model_copy(
        update={
            "lamp": times(rig.lamp, "distance_mm", "diameter_mm"),
            "camera": times(rig.camera, "distance_mm", "aperture_diameter_mm"),
            "sample": times(rig.sample, "diameter_mm"),
        }
    )


def served(mi: Any, method: Method, choices: dict[str, Scene]) -> dict[str, Evaluator]:
    """Return a method at work on every scene that it can serve, on as much of its light as it covers."""
    vector, found = mi.variant() == LLVM, {}
    for name, scene in choices.items():
        paths = light_paths(scene) & method.covers
        flat_alone = not scene.plain and not method.any_sample
        if paths and not flat_alone and method.obstacle(scene, paths, vector=vector) is None:
            found[name] = method.build(mi, scene, paths)
    return found


def change_of_units(mi: Any, method: Method, scale: float) -> float:
    """RMS change of a picture in other units of length, relative to its mean; the worst scene."""
    worst = 0.0
    here, there = (served(mi, method, scenes(mi, RIG, lobe(0.3), s)) for s in (1.0, scale))
    for name, evaluator in here.items():
        one, other = (e.render(POSES["oblique"], TOLERANCE).radiance for e in (evaluator, there[name]))
        worst = max(worst, float(np.sqrt(np.mean(np.square(one - other))) / one.mean()))
    return worst


def wrong_values(mi: Any, method: Method) -> int:
    """Count pixels that are no numbers or negative, or lit where they cannot be; over poses and albedos."""
    count = 0
    for material in (white(0.0), white(1.0), lobe(1e-4)):
        for place, evaluator in served(mi, method, scenes(mi, RIG, material)).items():
            for name, pose in (POSES | BELOW).items():
                rendering = evaluator.render(pose, LOOSE)
                values = rendering.radiance
                # From below, only a housing lights the sample, and it is seen beside it.
                dark = material.parameters["kd"] == 0.0 or (name in BELOW and place != "housing")
                wrong = ~np.isfinite(values) | (values < 0.0) | (dark & (values != 0.0))
                count += int(np.count_nonzero(wrong)) + (not np.isfinite(rendering.error))
    return count


def change_far_away(mi: Any) -> float:
    """Change of a picture, relative to its mean, where a flat sample is a ball whose middle is far away."""
    plain = lobe(0.3)
    ball = parse_material(f"{plain.spec}@sphere:radius_mm={FAR_MM:g}")
    f_r, events = closed_form_reflectance(plain), sample_events(mi, plain)
    flat, round_ = (
        SurfaceLight(Scene(RIG, material, events), f_r, None, POINTS).render(POSES["oblique"], TOLERANCE)
        for material in (plain, ball)
    )
    return float(np.abs(flat.radiance - round_.radiance).max() / flat.radiance.mean())


def three_point_change(scale: float, offset_mm: float) -> float:
    """Largest relative change of two facing surfaces' light by other lengths and another origin."""

    def radiance(scale: float, offset_mm: float) -> Array:
        away = offset_mm * np.array([1.0, -1.0, 1.0])
        lower = Surface(away, (30 * scale, 0, 0), (0, 30 * scale, 0), closed_form_reflectance(lobe(0.3)), 4)
        above = away + np.array([0.0, 0.0, 50.0 * scale])
        upper = Surface(above, (20 * scale, 0, 0), (0, -20 * scale, 0), 0.7, 4)
        lamp = PointLamp(away + scale * np.array([40.0, 5.0, 30.0]), scale**2)
        points = away + scale * np.array([[1.0, 2.0, 0.0], [-10.0, 3.0, 0.0]])
        wo = np.tile(unit(np.array([0.5, 0.1, 0.6])), (2, 1))
        return ThreePoint([lower, upper], lamp).camera_radiance(0, points, wo, 3)

    here, there = radiance(1.0, 0.0), radiance(scale, offset_mm)
    return float(np.max(np.abs(there - here) / here))


def units_target(method: Method) -> float:
    """Return the bound of `change_of_units`: double, single precision, or paths that leave each other."""
    if "Mitsuba" in method.name:
        return SINGLE_TARGET
    return SAMPLED_TARGET if method.any_sample and "float64" not in method.name else DOUBLE_TARGET


def rows_of(mi: Any, method: Method) -> Iterator[dict[str, Any]]:
    """Measure a method of the table."""
    for scale in SCALES:
        change = change_of_units(mi, method, scale)
        yield row(f"{method.name}, lengths times {scale:g}", change, "relative", units_target(method))
    yield row(f"{method.name}, degenerate poses and albedos", wrong_values(mi, method), "wrong", 0.0)


def run(plots: Path | None) -> Iterator[dict[str, Any]]:  # noqa: ARG001 - the interface of all parts
    """Measure every evaluator in the fastest variant that runs here."""
    from simulator import bsdfs

    mi = load_mitsuba(choose_variant().variant)
    bsdfs.register(mi)
    for method in METHODS:
        yield from rows_of(mi, method)
    yield row(f"sample's form, middle at {FAR_MM:g} mm", change_far_away(mi), "relative", FAR_TARGET)
    for scale, offset_mm in ((SCALES[0], 0.0), (SCALES[1], 0.0), (1.0, 1e6)):
        change = three_point_change(scale, offset_mm)
        name = f"three-point form, lengths times {scale:g}, origin {offset_mm:g} mm away"
        yield row(name, change, "relative", DOUBLE_TARGET if offset_mm == 0.0 else FAR_TARGET)
