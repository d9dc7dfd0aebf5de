"""Upper bounds of the light between a housing's walls and a sample.

The walls of the cube are cut into cells. What the lamp gives a cell is the largest of its values at nine
nodes, corners and middle, which bound a function that is smooth there; in cells near the lamp it is bounded
by intervals: the largest cosines over the smallest distance. From cell to cell, and to the sample, light goes
by form factors, and margins make up for what a mean over a cell does not know. Shadows only take light away.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from simulator.light.walls import Walls

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

SIDE_CELLS = 8
"""Cells along each side of a wall: 384 in all."""
_NODES = np.array([-1.0, 0.0, 1.0])
_SIMPSON = np.array([1.0, 4.0, 1.0]) / 6.0
_NEAR = 1.0
"""Distance of lamp and cell, in sides of a cell, up to which it is bounded by intervals."""
_SAMPLE_MARGIN, _CELL_MARGIN = 1.1, 1.25
"""What a place of the sample, or of a cell, may receive above the mean that form factors know."""


class Cells:
    """A housing's walls in cells, around a sample.

    Parameters
    ----------
    half_size_mm : float
        Half the cube's side.
    sample_radius_mm : float
        The sample's.

    Attributes
    ----------
    above : ndarray of bool, shape (cells,)
        Whether the sample sees it.
    from_sample : ndarray, shape (cells,)
        Irradiance at most by a sample whose radiance times cosine is 1.
    """

    def __init__(self, half_size_mm: float, sample_radius_mm: float) -> None:
        self._walls = Walls(half_size_mm, SIDE_CELLS)
        self._half_mm = half_size_mm / SIDE_CELLS
        normals = self._walls.normals
        sides = [np.roll(normals, shift, axis=1) * self._half_mm for shift in (1, 2)]
        self._points = (
            self._walls.centres[:, None, None]
            + _NODES[:, None, None] * sides[0][:, None, None]
            + _NODES[:, None] * sides[1][:, None, None]
        ).reshape(-1, len(_NODES) ** 2, 3)
        self._low, self._high = self._points.min(axis=1), self._points.max(axis=1)
        self.above = self._high[:, 2] > 1e-9 * half_size_mm
        distance = np.linalg.norm(self._points, axis=-1)
        there = -np.einsum("pnj,pj->pn", self._points, normals) / distance
        here = np.maximum(self._points[..., 2], 0.0) / distance
        means = np.outer(_SIMPSON, _SIMPSON).ravel()
        area = self._walls.patch_area
        self._seen_by_sample = (here * there / distance**2) @ means * area / np.pi
        disc_area = np.pi * sample_radius_mm**2
        visible = disc_area * (there / distance**2).max(axis=1) * self.above
        self.from_sample = _SAMPLE_MARGIN * visible

    def lit_by(self, lamp_mm: Array, intensity: float, radius_mm: float, axis: Array | None) -> Array:
        """Irradiance of the walls by the lamp, at most.

        Parameters
        ----------
        lamp_mm : ndarray, shape (3,)
            Its centre.
        intensity : float
            Radiant intensity along its axis.
        radius_mm : float
            Radius of its disc.
        axis : ndarray, shape (3,), optional
            Where a disc faces; by default the lamp shines in all directions alike.

        Returns
        -------
        ndarray, shape (cells,)
        """
        gap = np.linalg.norm(np.maximum(np.maximum(self._low - lamp_mm, lamp_mm - self._high), 0.0), axis=-1)
        near = gap <= 2.0 * _NEAR * self._half_mm + radius_mm
        way = self._points - lamp_mm
        distance = np.maximum(np.linalg.norm(way, axis=-1), np.finfo(float).tiny)
        cosine = np.maximum(-np.einsum("pnj,pj->pn", way, self._walls.normals), 0.0) / distance
        emitted = np.ones_like(cosine) if axis is None else np.maximum(way @ axis, 0.0) / distance
        found = intensity * (cosine * emitted / distance**2).max(axis=1)
        closest = np.maximum(gap - radius_mm, np.finfo(float).tiny)
        height = np.max(-np.einsum("pnj,pj->pn", way, self._walls.normals), axis=1) + radius_mm
        bound = intensity * np.clip(height / closest, 0.0, 1.0) / closest**2
        if axis is not None:
            bound = bound * np.clip(((way @ axis).max(axis=1) + radius_mm) / closest, 0.0, 1.0)
        return np.asarray(np.where(near, bound, found))

    def exchange(self, leaving: Array) -> Array:
        """Irradiance of the walls by radiosities (cells, channels) of all walls, at most."""
        return np.asarray(_CELL_MARGIN * _form_factors() @ leaving)

    def on_sample(self, leaving: Array) -> Array:
        """Irradiance (channels,) of the sample by radiosities (cells, channels) of the walls, at most."""
        return np.asarray(_SAMPLE_MARGIN * self._seen_by_sample @ leaving)

    def seen(self, directions: Array) -> Indices:
        """Return the cells (N,) that the sample's centre sees in directions (N, 3)."""
        return self._walls.hit(np.zeros_like(directions), directions).patches


@cache
def _form_factors() -> Array:
    """Shares (cells, cells) of what a cell receives that comes from each: of all cubes alike."""
    return Walls(1.0, SIDE_CELLS).form_factors()
