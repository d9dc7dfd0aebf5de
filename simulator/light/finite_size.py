"""What is left out when lamp, pixel and pupil are taken for points: estimated before anything is rendered."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from simulator.light.direct_view import extents_of, out_of_focus
from simulator.light.looks import Looks
from simulator.light.reflectance import material_reflectance

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from simulator.light.scene import Scene

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]
Pose = tuple[float, ...]

_ROWS = 6
"""Rows and columns of pixels, of the whole frame, that are looked at."""
_CAUTION = 1.1
"""For pixels between those that are looked at, and towards the frame's rim."""
_GAUSS = 1.0 / np.sqrt(12.0)
_FOOTPRINT = ((0.0, 0.0), *((v, u) for v in (-_GAUSS, _GAUSS) for u in (-_GAUSS, _GAUSS)))
"""A pixel's centre, and Gauss's four nodes of its footprint: (down, right)."""
_DISC = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]) / 2.0
"""Equal-weight nodes on the unit disc, exact for polynomials of degree 3."""
_TOGETHER = 16
"""Poses that are looked at in one go, so that their places stay near the processor."""
_REMEMBERED = 4096
"""Poses of a scene whose errors are kept: several methods leave out the same, and ask one after another."""

_KNOWN: WeakKeyDictionary[Scene, dict[tuple[Any, Pose], float]] = WeakKeyDictionary()
_LOOKS: WeakKeyDictionary[Scene, Looks] = WeakKeyDictionary()


def pose_error(mi: Any, scene: Scene, angles_rad: Pose) -> float:
    """Return the error at one pose; see `pose_errors`.

    Parameters
    ----------
    mi : module
        Mitsuba, `simulator.bsdfs` registered.
    scene : Scene
    angles_rad : tuple of float
        True angles of the arm joints.
    """
    found = _KNOWN.get(scene, {}).get((mi, angles_rad))
    return pose_errors(mi, scene, [angles_rad])[0] if found is None else found


def pose_errors(mi: Any, scene: Scene, poses_rad: Iterable[Pose]) -> list[float]:
    """Return `point_errors` of a scene at poses, asked for once each.

    Parameters
    ----------
    mi : module
        Mitsuba, `simulator.bsdfs` registered.
    scene : Scene
    poses_rad : iterable of tuple of float
        True angles of the arm joints.
    """
    asked = list(poses_rad)
    known = _KNOWN.setdefault(scene, {})
    new = list(dict.fromkeys(pose for pose in asked if (mi, pose) not in known))
    if new:
        if len(known) + len(new) > _REMEMBERED:
            known.clear()
            new = list(dict.fromkeys(asked))
        reflectance = material_reflectance(mi, scene.material)
        for first in range(0, len(new), _TOGETHER):
            part = new[first : first + _TOGETHER]
            errors = point_errors(scene, reflectance, part)
            known |= {(mi, pose): float(error) for pose, error in zip(part, errors, strict=True)}
    return [known[mi, pose] for pose in asked]


def point_errors(scene: Scene, reflectance: Reflectance, poses_rad: Sequence[Sequence[float]]) -> Array:
    """Estimate the errors of f_r E at pixel centres, for a lamp at a point and a pinhole.

    The means over a pixel, over the pupil and over the lamp's disc are each taken with four nodes. Where the
    lobe is so narrow that four do not do, they still show that one does not.

    Parameters
    ----------
    scene : Scene
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr.
    poses_rad : sequence of sequences of float
        True angles of the arm joints, of P poses.

    Returns
    -------
    ndarray, shape (P,)
        RMS over the sample's pixels, relative to their mean radiance; 0 where the sample is not seen or dark.
    """
    if scene not in _LOOKS:
        _LOOKS[scene] = Looks(scene.rig, _ROWS, _FOOTPRINT)
    return _errors(scene, reflectance, np.asarray(poses_rad, dtype=np.float64), _LOOKS[scene])


def _errors(
    scene: Scene, reflectance: Reflectance, poses: Array, looks: Looks, *, every: bool = False
) -> Array:
    """Estimate errors at places of the frame; poses that show no sample there are looked at everywhere."""
    look = looks.at(poses)
    errors = np.zeros(len(poses))
    lost = ~look.seen.any(axis=1)
    if lost.any() and not every:
        errors[lost] = _errors(scene, reflectance, poses[lost], looks.all_pixels(), every=True)
    pupil = _discs(look.camera_mm, scene.rig.camera.aperture_diameter_mm / 2.0)
    lamp = _discs(look.light_mm, scene.lamp_radius_mm)
    # Per pixel: its centre and four points of it, four of the pupil, four of the lamp.
    centre = look.points_mm[:, :1]
    points = np.concatenate([look.points_mm, np.repeat(centre, 8, axis=1)], axis=1)
    cameras, lamps = (
        np.repeat(place[:, None], len(_FOOTPRINT) + 8, axis=1) for place in (look.camera_mm, look.light_mm)
    )
    cameras[:, 5:9], lamps[:, 9:] = pupil, lamp
    eye = look.camera_mm[:, None, None]
    points[:, 5:9] = out_of_focus(
        centre, eye, -unit(eye), pupil[:, :, None] - eye, extents_of(scene.rig).focus_mm
    )
    seen = np.broadcast_to(look.seen[:, None], points.shape[:3])
    cameras, lamps = (np.broadcast_to(place[:, :, None], points.shape)[seen] for place in (cameras, lamps))
    found = np.zeros(points.shape)
    found[seen] = _radiance(scene, reflectance, points[seen], cameras, lamps)
    if scene.lamp_cosine:
        axes = np.broadcast_to(unit(look.light_mm)[:, None, None], points.shape)[seen]
        found[seen] *= np.sum(unit(lamps - points[seen]) * axes, axis=-1, keepdims=True)
        # A disc's irradiance falls short of a point's by this factor: it is made up for.
        made_up = 1.0 + scene.lamp_radius_mm**2 / np.sum(look.light_mm**2, axis=-1)
        found[:, 9:] *= made_up[:, None, None, None]
    parts = found[:, 1:].reshape(len(poses), 3, 4, *found.shape[2:])
    left_out = parts.mean(axis=2).sum(axis=1) - 3.0 * found[:, 0]
    for pose in np.flatnonzero(~lost):
        seen = look.seen[pose]
        mean = found[pose, 0, seen].mean()
        if mean > 0.0:
            errors[pose] = _CAUTION * np.sqrt(np.mean(left_out[pose, seen] ** 2)) / mean
    return errors


def _radiance(
    scene: Scene, reflectance: Reflectance, points_mm: Array, camera_mm: Array, lamp_mm: Array
) -> Array:
    """Radiance (N, 3) of points lit by a point lamp, seen from a point each."""
    way, back = lamp_mm - points_mm, camera_mm - points_mm
    distance = np.sqrt(np.sum(way**2, axis=-1))
    wi, wo = way / distance[:, None], back / np.sqrt(np.sum(back**2, axis=-1))[:, None]
    above = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
    found = np.zeros((len(points_mm), 3))
    irradiance = scene.lamp_intensity * wi[above, 2] / distance[above] ** 2
    found[above] = reflectance(wi[above], wo[above]) * irradiance[:, None]
    return found


def _discs(centres_mm: Array, radius_mm: float) -> Array:
    """Nodes (P, 4, 3) of discs that face the origin."""
    facing = centres_mm / np.linalg.norm(centres_mm, axis=-1, keepdims=True)
    across = np.cross(np.eye(3)[np.argmin(np.abs(facing), axis=-1)], facing)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    up = np.cross(facing, across)
    sides = radius_mm * (_DISC[:, :1] * across[:, None] + _DISC[:, 1:] * up[:, None])
    return np.asarray(centres_mm[:, None] + sides)
