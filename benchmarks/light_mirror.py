"""A mirror that throws the lamp's light on the sample: images, and path tracing, against the closed form.

Where the lamp is a point, path tracing finds none of that light, and says nothing.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.rows import row
from rig.description import default_rig
from rig.kinematics import Kinematics
from rig.pixels import irradiance, pixel_geometry
from simulator import bsdfs
from simulator.light.path_tracer import PathLight
from simulator.light.paths import LightPaths
from simulator.light.pixelwise import PixelwiseLight
from simulator.light.reflectance import material_reflectance
from simulator.light.scene import Event, PlanarMirror, Scene
from simulator.light.virtual_lights import VirtualLights
from simulator.materials import parse_material
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from pathlib import Path

Array = NDArray[np.float64]

ANGLES_DEG = (30.0, 0.0, 0.0, 0.0)
REFLECTANCE = 0.9
X_MM, HALF_MM = -80.0, 600.0
TARGET = 1e-3
MISSED_TARGET = 0.3
"""Least share of the light that shows that something is amiss."""


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - no figure says more than the rows
    """Light a white by a lamp and its image; rows as `gonio bench` prints them."""
    mi = load_mitsuba()
    bsdfs.register(mi)
    scene, angles = _scene(), np.radians(ANGLES_DEG)
    lit = pixel_geometry(scene.rig, angles).on_sample
    wanted = _closed_form(scene, angles)[lit]
    f_r = material_reflectance(mi, scene.material)
    direct, images = PixelwiseLight(scene.rig, f_r), VirtualLights(scene, f_r, LightPaths("LS+DE"))
    start = time.process_time()
    found = direct.radiance(angles) + images.render(angles, TARGET).radiance
    seconds = time.process_time() - start
    path = PathLight(mi, scene, samples_per_pixel=64).render(angles, 1e-2).radiance
    return [
        row("mirror: virtual lights, largest relative error", _largest(found[lit, 0], wanted), "", TARGET),
        row("mirror: virtual lights, a pose", 1e3 * seconds, "ms"),
        row(
            "mirror: path tracing with a point lamp, light missed without a word",
            1.0 - path[lit, 0].mean() / wanted.mean(),
            "",
            MISSED_TARGET,
            at_least=True,
        ),
    ]


def _scene() -> Scene:
    mirror = PlanarMirror((X_MM, 0.0, 0.0), (0.0, HALF_MM, 0.0), (0.0, 0.0, HALF_MM), REFLECTANCE)
    events = frozenset({Event.LAMBERTIAN})
    return Scene(default_rig(), parse_material("lambert:kd=1"), events, mirrors=(mirror,), lamp_cosine=False)


def _closed_form(scene: Scene, angles: Array) -> Array:
    """Radiance of a white lit by the lamp and by its image in an upright mirror at X_MM."""
    pixels = pixel_geometry(scene.rig, angles)
    lamp = Kinematics(scene.rig).frames(angles).light_mm
    image = np.array([2.0 * X_MM - lamp[0], lamp[1], lamp[2]])
    way = image - np.concatenate([pixels.position_mm, np.zeros((*pixels.on_sample.shape, 1))], axis=-1)
    over_mirror = REFLECTANCE * scene.lamp_intensity * way[..., 2] / np.linalg.norm(way, axis=-1) ** 3
    return np.asarray((irradiance(scene.rig, pixels) + over_mirror) / np.pi)


def _largest(found: Array, wanted: Array) -> float:
    return float(np.abs(found / wanted - 1.0).max())
