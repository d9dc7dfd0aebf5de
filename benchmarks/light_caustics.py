"""Light that a hollow mirror gathers on the sample: the photon map against rays followed one by one.

The lamp, a point on the axis, is imaged with spherical aberration: its rays meet in a ring, inside of
which it is bright and beyond which it is dark. Rays in the plane of the axis tell how much light falls where.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.rows import row
from rig.description import default_rig
from rig.pixels import pixel_geometry
from simulator import bsdfs
from simulator.light.paths import LightPaths
from simulator.light.photon_map import PhotonMap
from simulator.light.reflectance import material_reflectance
from simulator.light.scene import Event, PlanarMirror, Scene, SphericalMirror
from simulator.light.virtual_lights import VirtualLights
from simulator.materials import parse_material
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from pathlib import Path

Array = NDArray[np.float64]

RADIUS_MM, RIM_MM, HEIGHT_MM, REFLECTANCE = 450.0, 150.0, 800.0, 0.8
INSIDE_MM = 7.5
"""Radius within which the ring of this mirror leaves the picture smooth."""
RAYS = 400_001
ANGLES_DEG = (30.0, 20.0, 15.0, 0.0)
BOUNCED = LightPaths("LS+DE")
MIRRORS = {
    "plane": PlanarMirror((-80.0, 0.0, 0.0), (0.0, 600.0, 0.0), (0.0, 0.0, 600.0), 0.9),
    "window": PlanarMirror((-120.0, 0.0, 80.0), (0.0, 30.0, 0.0), (0.0, 0.0, 30.0), 0.9),
}
TOLERANCES = {"plane": (0.02, 0.005), "window": (0.2, 0.05)}
KNOWN = 2.0
"""Largest true error over the stated one."""
FLUX_TARGET = 0.01


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - no figure says more than the rows
    """Compare with closed forms; rows as `gonio bench` prints them."""
    mi = load_mitsuba()
    bsdfs.register(mi)
    return [*_caustic(mi), *(each for name in MIRRORS for each in _planar(mi, name))]


def _caustic(mi: Any) -> list[dict[str, Any]]:
    mirror = SphericalMirror((0.0, 0.0, HEIGHT_MM), (0.0, 0.0, -1.0), RADIUS_MM, RIM_MM, REFLECTANCE)
    scene, angles = _scene(mirror, lamp_cosine=False), (0.0,) * 4
    start = time.process_time()
    rendering = _photons(mi, scene).render(angles, 0.1)
    seconds = time.process_time() - start
    pixels = pixel_geometry(scene.rig, angles)
    inside = np.linalg.norm(pixels.position_mm, axis=-1) < INSIDE_MM
    wanted = scene.lamp_intensity * REFLECTANCE * _flux_within(INSIDE_MM, scene.rig.lamp.distance_mm)
    wanted /= np.pi * INSIDE_MM**2 * np.pi
    found = float(rendering.radiance[inside].mean())
    return [
        row(
            "caustic: mean radiance inside the ring, relative error",
            abs(found / wanted - 1.0),
            "",
            FLUX_TARGET,
        ),
        row("caustic: error stated for the whole picture", rendering.error, ""),
        row("caustic: a pose", 1e3 * seconds, "ms"),
    ]


def _flux_within(radius_mm: float, lamp_mm: float) -> float:
    """Flux of a unit intensity inside a circle on the sample, over the mirror, from rays in one plane."""
    depth = RADIUS_MM - np.sqrt(RADIUS_MM**2 - RIM_MM**2)
    angle = np.linspace(0.0, np.arctan2(RIM_MM, HEIGHT_MM - depth - lamp_mm), RAYS)
    way = np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    start = np.array([0.0, lamp_mm - (HEIGHT_MM - RADIUS_MM)])
    along = way @ start
    met = start + (np.sqrt(along**2 - start @ start + RADIUS_MM**2) - along)[:, None] * way
    normal = met / RADIUS_MM
    down = way - 2.0 * np.sum(way * normal, axis=1, keepdims=True) * normal
    landing = met[:, 0] - (met[:, 1] + HEIGHT_MM - RADIUS_MM) / down[:, 1] * down[:, 0]
    inside = np.abs(landing[1:]) < radius_mm
    return float(2.0 * np.pi * np.sum(-np.diff(np.cos(angle))[inside]))


def _planar(mi: Any, name: str) -> list[dict[str, Any]]:
    """Compare with the lamp's image in a planar mirror, without and with an edge in the picture."""
    scene, angles = _scene(MIRRORS[name]), tuple(np.radians(ANGLES_DEG).tolist())
    seen = pixel_geometry(scene.rig, angles).on_sample
    exact = VirtualLights(scene, material_reflectance(mi, scene.material), BOUNCED)
    wanted = exact.render(angles, 1e-4).radiance[seen]
    rows = []
    for tolerance in TOLERANCES[name]:
        evaluator = _photons(mi, scene)
        start = time.process_time()
        found = evaluator.render(angles, tolerance)
        seconds = time.process_time() - start
        error = float(np.sqrt(np.mean((found.radiance[seen] - wanted) ** 2)) / wanted.mean())
        label = f"{name}, tolerance {tolerance:g}"
        rows += [
            row(f"{label}: error", error, ""),
            row(f"{label}: true over stated error", error / found.error, "", KNOWN),
            row(f"{label}: a pose", 1e3 * seconds, "ms"),
        ]
    return rows


def _scene(mirror: PlanarMirror | SphericalMirror, *, lamp_cosine: bool = True) -> Scene:
    events = frozenset({Event.LAMBERTIAN})
    material = parse_material("lambert:kd=1")
    return Scene(default_rig(), material, events, mirrors=(mirror,), lamp_cosine=lamp_cosine)


def _photons(mi: Any, scene: Scene) -> PhotonMap:
    return PhotonMap(mi, scene, material_reflectance(mi, scene.material), BOUNCED)
