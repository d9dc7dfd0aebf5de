"""How bright a sample can be in its own image: light that goes from it over one planar mirror back to it.

A lobe is bright in few directions. Between the sample and its image light goes only in those of a narrow
cone, and it is there that f_r is asked for its largest value, and not over the hemisphere.
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

_RINGS, _TURNS = 20, 32
_BOTH = 160
"""Directions of the cone from which pairs are made."""


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


def brightest_from(reflectance: Reflectance, cone: Cone, given: Array) -> Array:
    """Return the largest f_r (3,) times the cosine in a cone, between it and given directions (N, 3)."""
    inside = np.repeat(cone.directions, len(given), axis=0)
    other = np.tile(given, (len(cone.directions), 1))
    if not len(inside):
        return np.zeros(3)
    return np.asarray((reflectance(other, inside) * inside[:, 2:]).max(axis=0))


def brightest_within(reflectance: Reflectance, cone: Cone) -> Array:
    """Return the largest f_r (3,) times both cosines between directions of a cone."""
    few = cone.directions[:: max(1, len(cone.directions) // _BOTH)]
    if not len(few):
        return np.zeros(3)
    wi, wo = np.repeat(few, len(few), axis=0), np.tile(few, (len(few), 1))
    return np.asarray((reflectance(wi, wo) * wi[:, 2:] * wo[:, 2:]).max(axis=0))
