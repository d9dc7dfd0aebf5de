"""What is left out when lamp, pixel and pupil are taken for points: estimated before anything is rendered."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.reflectance import material_reflectance

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from simulator.light.scene import Scene

Array = NDArray[np.float64]

_ROWS = 8
"""Rows and columns of pixels, of the whole frame, that are looked at."""
_DISC = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]) / 2.0
"""Equal-weight nodes on the unit disc, exact for polynomials of degree 3; a pixel's are Gauss's."""
_FOOTPRINT = ((0, 0), (1, 1), (1, 2), (2, 1), (2, 2))
"""Of the offsets (0, -, +) of row and column: a pixel's centre and the four nodes of its footprint."""


@lru_cache(maxsize=4)
def pose_error(mi: Any, scene: Scene, angles_rad: tuple[float, ...]) -> float:
    """Return `point_error` of a scene at a pose, asked once: several methods leave out the same.

    Parameters
    ----------
    mi : module
        Mitsuba, `simulator.bsdfs` registered.
    scene : Scene
    angles_rad : tuple of float
        True angles of the arm joints.
    """
    return point_error(scene, material_reflectance(mi, scene.material), angles_rad)


def point_error(
    scene: Scene, reflectance: Callable[[Array, Array], Array], angles_rad: Sequence[float]
) -> float:
    """Estimate the error of f_r E at pixel centres, for a point lamp and a pinhole.

    The means over a pixel, over the pupil and over the lamp's disc are each taken with four nodes. Where the
    lobe is so narrow that four do not do, they still show that one does not.

    Parameters
    ----------
    scene : Scene
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr.
    angles_rad : sequence of float
        True angles of the arm joints.

    Returns
    -------
    float
        RMS over the sample's pixels, relative to their mean radiance; 0 where the sample is not seen or dark.
    """
    rig = scene.rig
    frames = Kinematics(rig).frames(angles_rad)
    rows, cols = (np.linspace(0, n - 1, min(n, _ROWS)) for n in (rig.camera.height_px, rig.camera.width_px))
    seen = pixel_geometry(rig, angles_rad, rows=rows, cols=cols).on_sample
    if not seen.any():
        rows, cols = (np.arange(float(n)) for n in (rig.camera.height_px, rig.camera.width_px))
        seen = pixel_geometry(rig, angles_rad).on_sample
        if not seen.any():
            return 0.0
    # Each pixel's centre, then four points of its footprint.
    offsets = np.array([0.0, -1.0, 1.0]) / np.sqrt(12.0)
    fine = pixel_geometry(
        rig, angles_rad, rows=np.add.outer(rows, offsets).ravel(), cols=np.add.outer(cols, offsets).ravel()
    ).position_mm.reshape(len(rows), 3, len(cols), 3, 2)
    points = [fine[:, v, :, u][seen] for v, u in _FOOTPRINT]
    centre = points[0]
    camera, lamp = frames.camera_mm, frames.light_mm
    places = np.concatenate([*points, *[centre] * 8])
    cameras = [camera] * 5 + list(_disc(camera, rig.camera.aperture_diameter_mm / 2.0)) + [camera] * 4
    lamps = [lamp] * 9 + list(_disc(lamp, scene.lamp_radius_mm))
    found = _radiance(
        scene,
        reflectance,
        np.column_stack([places, np.zeros(len(places))]),
        np.repeat(cameras, len(centre), axis=0),
        np.repeat(lamps, len(centre), axis=0),
    ).reshape(13, len(centre), 3)
    if scene.lamp_cosine:
        way = lamp - np.column_stack([centre, np.zeros(len(centre))])
        # A disc's irradiance falls short of a point's by the second factor: it is made up for.
        made_up = 1.0 + scene.lamp_radius_mm**2 / float(lamp @ lamp)
        found[9:] *= made_up * (unit(way) @ unit(lamp))[:, None]
    left_out = found[1:].reshape(3, 4, len(centre), 3).mean(axis=1).sum(axis=0) - 3.0 * found[0]
    mean = found[0].mean()
    return float(np.sqrt(np.mean(left_out**2)) / mean) if mean > 0.0 else 0.0


def _radiance(
    scene: Scene,
    reflectance: Callable[[Array, Array], Array],
    points_mm: Array,
    camera_mm: Array,
    lamp_mm: Array,
) -> Array:
    """Radiance (N, 3) of points lit by a point lamp, seen from a point each."""
    way = lamp_mm - points_mm
    distance = np.linalg.norm(way, axis=-1)
    wi, wo = way / distance[:, None], unit(camera_mm - points_mm)
    above = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
    found = np.zeros((len(points_mm), 3))
    irradiance = scene.lamp_intensity * wi[above, 2] / distance[above] ** 2
    found[above] = reflectance(wi[above], wo[above]) * irradiance[:, None]
    return found


def _disc(centre_mm: Array, radius_mm: float) -> Array:
    """Nodes (4, 3) of a disc that faces the origin."""
    facing = unit(centre_mm)
    across = unit(np.cross(np.eye(3)[np.argmin(np.abs(facing))], facing))
    return np.asarray(centre_mm + radius_mm * _DISC @ np.stack([across, np.cross(facing, across)]))
