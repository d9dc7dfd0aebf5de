"""Stray light of a housing as one value over the sample, where it is so little that it may be rough.

The walls' patches are seen from the sample's middle, each as its own middle tells. That does for lobes about
as broad as a patch looks, and for light that is smooth on the walls; where either is not so, nothing is said.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit

if TYPE_CHECKING:
    from collections.abc import Callable

    from simulator.light.scene import Scene
    from simulator.light.wall_light import WallLight

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]

ERROR = 0.15
"""RMS error over the sample, relative to the mean: what it may be. Tests over drawn scenes hold it."""
_SHARPER = 1.5
"""Times as bright as any patch shows it, in its mirror direction and back: a lobe that falls between them."""
_UNEVEN = 0.1
"""Difference between what every other patch says, relative to the whole, that tells the same."""


class RoughWalls:
    """Radiance of a sample lit by the walls of its housing.

    Parameters
    ----------
    scene : Scene
        With a housing.
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr of the sample.
    light : WallLight
        On the walls.
    """

    def __init__(self, scene: Scene, reflectance: Reflectance, light: WallLight) -> None:
        if scene.housing is None:
            raise ValueError("walls need a housing")
        self._scene, self._reflectance, self._light = scene, reflectance, light
        walls = light.walls
        self._above = np.flatnonzero(walls.centres[:, 2] > 0.0)
        centres, normals = walls.centres[self._above], walls.normals[self._above]
        self._wi = unit(centres)
        there = -np.sum(self._wi * normals, axis=1)
        squared = np.sum(centres**2, axis=1)
        self._weights = (self._wi[:, 2] * there * walls.patch_area / squared)[:, None]
        # Of neighbours on a wall one is even and one odd.
        along = np.where(normals == 0.0, centres, 0.0) / np.sqrt(walls.patch_area)
        self._even = np.floor(along).sum(axis=1) % 2 == 0

    def radiance(self, lamp_mm: Array, camera_mm: Array) -> Array | None:
        """Return the sample's radiance (3,); None where its patches do not tell.

        Parameters
        ----------
        lamp_mm, camera_mm : ndarray, shape (3,)
        """
        # A point that shines backwards lights the wall behind it, which may be near.
        if not self._scene.lamp_cosine or camera_mm[2] <= 0.0 or not self._light.wanted.mostly_lamp:
            return None
        wo = unit(camera_mm)
        asked = np.vstack([self._wi, wo * [-1.0, -1.0, 1.0], wo])
        f_r = self._reflectance(asked, np.broadcast_to(wo, asked.shape))
        seen, sharpest = f_r[:-2], f_r[-2:].max(axis=0)
        if np.any(sharpest > _SHARPER * seen.max(axis=0)):
            return None
        parts = seen * self._weights * self._light.from_lamp(lamp_mm)[self._above, None]
        whole = parts.sum(axis=0)
        if np.any(np.abs(2.0 * parts[self._even].sum(axis=0) - whole) > _UNEVEN * whole):
            return None
        return np.asarray(whole)
