"""The lamp as it appears in planar mirrors: which images there are, and the ways of their light."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.light.classes import mirror_faces_sample, walks
from simulator.light.scene import Event, PlanarMirror, Scene
from simulator.light.ways import TOUCHING, crosses_disc, meet_mirror

if TYPE_CHECKING:
    from simulator.light.paths import LightPaths

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MOST_IMAGES = 6
"""Mirrors in a row that are followed: two of reflectance 0.9 that face each other have lost half by then."""


@dataclass(frozen=True, eq=False)
class VirtualLamp:
    """The lamp in mirrors, in the order in which its light meets them.

    Parameters
    ----------
    mirrors : tuple of PlanarMirror
    """

    mirrors: tuple[PlanarMirror, ...]

    @property
    def reflectance(self) -> float:
        """What the mirrors leave of its light."""
        return float(np.prod([mirror.reflectance for mirror in self.mirrors]))

    def image(self, points_mm: Array) -> Array:
        """Return where points (..., 3) appear in the last mirror."""
        for mirror in self.mirrors:
            points_mm = mirror.image(points_mm)
        return points_mm

    def ways(self, lamp_mm: Array, points_mm: Array) -> tuple[Bools, list[Array]]:
        """Follow light from a lamp over the mirrors to points.

        Parameters
        ----------
        lamp_mm : ndarray, shape (3,)
            The lamp itself.
        points_mm : ndarray, shape (N, 3)
            Where the light goes.

        Returns
        -------
        passes : ndarray of bool, shape (N,)
            Whether every mirror is met inside its rectangle and on its bright side.
        corners : list of ndarray, shape (N, 3)
            The way's ends and bends, lamp first; what passes nowhere is anything.
        """
        images = [lamp_mm]
        for mirror in self.mirrors:
            images.append(mirror.image(images[-1]))
        corners, passes = [points_mm], np.ones(len(points_mm), dtype=bool)
        for mirror, shown in zip(reversed(self.mirrors), reversed(images[1:]), strict=True):
            met, share, inside = meet_mirror(mirror, corners[-1], np.broadcast_to(shown, points_mm.shape))
            bright = (corners[-1] - np.asarray(mirror.centre_mm)) @ mirror.normal > 0.0
            passes &= inside & bright & (share > 0.0) & (share < 1.0)
            corners.append(met)
        return passes, [np.broadcast_to(lamp_mm, points_mm.shape), *reversed(corners)]


@lru_cache(maxsize=64)
def virtual_lamps(scene: Scene, paths: LightPaths) -> tuple[VirtualLamp, ...]:
    """Every lamp in mirrors that can light the sample and is asked for, fewest mirrors first.

    Parameters
    ----------
    scene : Scene
    paths : LightPaths
        Paths that are wanted; only L S+ D E are found.
    """
    letters = sorted(scene.events - {Event.MIRROR})
    lamps = []
    for length in range(1, MOST_IMAGES + 1 if len(scene.mirrors) > 1 else 2):
        if not any("L" + "S" * length + letter + "E" in paths for letter in letters):
            continue
        for walk in walks(scene, length):
            met = [node for node, _ in walk if isinstance(node, int)]
            if len(met) == length and mirror_faces_sample(scene, scene.mirrors[met[-1]]):
                mirrors = [scene.mirrors[node] for node in met]
                lamps.append(VirtualLamp(tuple(one for one in mirrors if isinstance(one, PlanarMirror))))
    return tuple(lamps)


def hidden(scene: Scene, lamp: VirtualLamp, corners: list[Array]) -> Bools:
    """Tell where the sample, or a mirror that a part of the way does not end at, stands in the way.

    Parameters
    ----------
    scene : Scene
    lamp : VirtualLamp
    corners : list of ndarray, shape (N, 3)
        As `VirtualLamp.ways` gives them.
    """
    found = np.zeros(len(corners[0]), dtype=bool)
    ends = (None, *lamp.mirrors, None)
    planar = [mirror for mirror in scene.mirrors if isinstance(mirror, PlanarMirror)]
    for part, (start, end) in enumerate(pairwise(corners)):
        for mirror in planar:
            if mirror is not ends[part] and mirror is not ends[part + 1]:
                _, share, inside = meet_mirror(mirror, start, end)
                found |= inside & (share > TOUCHING) & (share < 1.0 - TOUCHING)
        if part < len(corners) - 2:
            found |= crosses_disc(start, end, scene.sample_radius_mm)
    return found
