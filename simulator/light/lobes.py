"""How bright a sample can be in its own image: light that goes from it over one planar mirror back to it.

A lobe is bright in few directions. Between the sample and its image light goes only in those of a narrow
cone, and it is there that f_r is asked for, and not over the hemisphere: between pairs of places for what a
pose makes of it, and for its largest value where light goes to and fro.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit

if TYPE_CHECKING:
    from collections.abc import Callable

    from simulator.light.scene import PlanarMirror, Scene

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_RINGS, _TURNS = 12, 24
_BOTH = 160
"""Directions of the cone from which pairs are made."""
_SPREAD = 7
"""Places along a diameter of the sample that lights itself; of the one that is lit, every third."""


class Cone(NamedTuple):
    """Directions (K, 3) above the sample from its points to those of its image, and its solid angle there."""

    directions: Array
    solid_angle: float


def image_cone(scene: Scene, mirror: PlanarMirror) -> Cone | None:
    """Return the cone of a mirror; None where the image is so near that it is none.

    Parameters
    ----------
    scene : Scene
    mirror : PlanarMirror
    """
    centre, across_mm = mirror.image(np.zeros(3)), 2.0 * scene.sample_radius_mm
    distance = float(np.linalg.norm(centre))
    if distance <= across_mm:
        return None
    axis, most = centre / distance, np.arcsin(across_mm / distance)
    gamma, phi = (
        grid.ravel()
        for grid in np.meshgrid(
            most * np.linspace(0.0, 1.0, _RINGS),
            2.0 * np.pi * np.arange(_TURNS) / _TURNS,
            indexing="ij",
        )
    )
    ring = np.stack([np.sin(gamma) * np.cos(phi), np.sin(gamma) * np.sin(phi), np.cos(gamma)], axis=-1)
    first = unit(np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis))
    found = ring @ np.stack([first, np.cross(axis, first), axis])
    area = np.pi * scene.sample_radius_mm**2
    return Cone(found[found[:, 2] > 0.0], area / (distance - across_mm) ** 2)


def brightest_within(reflectance: Reflectance, cone: Cone) -> Array:
    """Return the largest f_r (3,) times both cosines between directions of a cone."""
    few = cone.directions[:: max(1, len(cone.directions) // _BOTH)]
    if not len(few):
        return np.zeros(3)
    wi, wo = np.repeat(few, len(few), axis=0), np.tile(few, (len(few), 1))
    return np.asarray((reflectance(wi, wo) * wi[:, 2:] * wo[:, 2:]).max(axis=0))


class OwnImage:
    """A sample that lights itself over a planar mirror, in pairs of places.

    Parameters
    ----------
    scene : Scene
    mirror : PlanarMirror
    """

    def __init__(self, scene: Scene, mirror: PlanarMirror) -> None:
        radius, self._intensity = scene.sample_radius_mm, scene.lamp_intensity
        step = 2.0 / _SPREAD
        grid = step * (np.arange(_SPREAD) - (_SPREAD - 1) / 2.0)
        x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
        kept = np.hypot(x, y) <= 1.0
        from_mm = radius * np.column_stack([x, y, 0.0 * x])[kept]
        to_mm = (
            radius * np.column_stack([x, y, 0.0 * x])[kept & np.isin(x, grid[::3]) & np.isin(y, grid[::3])]
        )
        shown = mirror.image(from_mm)
        way = shown - to_mm[:, None]
        squared = np.sum(way**2, axis=-1)
        wi = way / np.sqrt(squared)[..., None]
        # Seen from its image, the sample faces the other way; the light leaves it as the image's does.
        wo = wi - 2.0 * (wi @ mirror.normal)[..., None] * mirror.normal
        wo = -wo
        through = _through(mirror, to_mm, shown, 0.5 * step * radius)
        lit = through & (wi[..., 2] > 0.0) & (wo[..., 2] > 0.0)
        self._to, self._from = np.nonzero(lit)
        self._to_mm, self._from_mm, self._wi, self._wo = to_mm, from_mm, wi[lit], wo[lit]
        area = np.pi * radius**2 / len(from_mm)
        self._kept = (mirror.reflectance * area * wi[..., 2] * wo[..., 2] / squared)[lit]

    def radiance(self, reflectance: Reflectance, lamp_mm: Array, camera_mm: Array) -> Array:
        """Radiance of the brightest of the places lit, by pairs.

        Parameters
        ----------
        reflectance : callable
            (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr.
        lamp_mm, camera_mm : ndarray, shape (P, 3)

        Returns
        -------
        ndarray, shape (P, 3)
        """
        poses, pairs = len(lamp_mm), len(self._to)
        if not pairs:
            return np.zeros((poses, 3))
        way = lamp_mm[:, None] - self._from_mm[self._from]
        distance = np.linalg.norm(way, axis=-1, keepdims=True)
        wi, wo = way / distance, unit(camera_mm[:, None] - self._to_mm[self._to])
        strength = self._kept[:, None] * self._intensity * np.maximum(wi[..., 2:], 0.0) / distance**2
        thrown, seen = (
            reflectance(first.reshape(-1, 3), second.reshape(-1, 3)).reshape(poses, pairs, 3)
            for first, second in (
                (np.where(wi[..., 2:] > 0.0, wi, [0.0, 0.0, 1.0]), np.broadcast_to(self._wo, wi.shape)),
                (np.broadcast_to(self._wi, wo.shape), wo),
            )
        )
        found = np.zeros((len(self._to_mm), poses, 3))
        np.add.at(found, self._to, np.swapaxes(thrown * seen * strength, 0, 1))
        return np.asarray(found.max(axis=0))


def _through(mirror: PlanarMirror, start: Array, end: Array, more_mm: float) -> Bools:
    """Tell which ways (M, N) from points (M, 3) to points (N, 3) pass a mirror, made larger by a seam."""
    centre = np.asarray(mirror.centre_mm)
    before, behind = (start - centre) @ mirror.normal, (centre - end) @ mirror.normal
    bright = (before[:, None] > 0.0) & (behind > 0.0)
    share = before[:, None] / np.where(bright, before[:, None] + behind, 1.0)
    met = start[:, None] + share[..., None] * (end - start[:, None]) - centre
    for side in (np.asarray(mirror.across_mm), np.asarray(mirror.up_mm)):
        length = float(np.linalg.norm(side))
        bright &= np.abs(met @ side) <= length * (length + more_mm)
    return np.asarray(bright)
