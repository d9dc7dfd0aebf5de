"""Light between a housing's walls and a sample, many poses at once, never less than there is.

The walls of the cube are cut into cells. What the lamp gives a cell is the mean of its values at nine nodes,
corners and middle, after Simpson, and at most the largest of them; in cells near the lamp both are bounded by
intervals: the largest cosines over the smallest distance. From cell to cell, and to the sample, light goes by
form factors, and margins make up for what a mean over a cell does not know. Shadows only take light away.
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
_SAMPLE_MARGIN, _CELL_MARGIN = 1.03, 1.05
"""What the sample, or a place of a cell, may receive above what form factors know."""
_SPREAD = 2.0
"""What a sample may receive on top, in squares of its radius over the walls' distance: form factors are its
middle's, and the camera sees as much on either side of it."""


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
        self._wall_mm, self._squared = half_size_mm, np.sum(self._points**2, axis=-1)
        self._low, self._high = self._points.min(axis=1), self._points.max(axis=1)
        self.above = self._high[:, 2] > 1e-9 * half_size_mm
        distance = np.linalg.norm(self._points, axis=-1)
        there = -np.einsum("pnj,pj->pn", self._points, normals) / distance
        here = np.maximum(self._points[..., 2], 0.0) / distance
        means = np.outer(_SIMPSON, _SIMPSON).ravel()
        area = self._walls.patch_area
        self._seen_by_sample = (here * there / distance**2) @ means * area / np.pi
        self._margin = _SAMPLE_MARGIN + _SPREAD * (sample_radius_mm / half_size_mm) ** 2
        disc_area = np.pi * sample_radius_mm**2
        visible = disc_area * (there / distance**2).max(axis=1) * self.above
        self.from_sample = self._margin * visible

    def lit_by(
        self, lamp_mm: Array, intensity: float, radius_mm: float, axis: Array | None
    ) -> tuple[Array, Array]:
        """Irradiance of the walls by the lamp.

        Parameters
        ----------
        lamp_mm : ndarray, shape (P, 3)
            Its centre in each pose.
        intensity : float
            Radiant intensity along its axis.
        radius_mm : float
            Radius of its disc.
        axis : ndarray, shape (P, 3), optional
            Where a disc faces; by default the lamp shines in all directions alike.

        Returns
        -------
        mean, most : ndarray, shape (P, cells)
            Of each cell.
        """
        lamp = lamp_mm[:, None]
        beside = np.maximum(np.maximum(self._low - lamp, lamp - self._high), 0.0)
        gap = np.sqrt(beside[..., 0] ** 2 + beside[..., 1] ** 2 + beside[..., 2] ** 2)
        closest = np.maximum(gap - radius_mm, np.finfo(float).tiny)
        # All places of a wall are at one height below the lamp.
        height = np.maximum(self._wall_mm + lamp_mm @ self._walls.normals.T, 0.0)
        bound = intensity * np.clip((height + radius_mm) / closest, 0.0, 1.0) / closest**2
        # One product for each pose: how many there are changes no digit.
        shape = (len(lamp_mm), *self._points.shape[:2])
        towards = (lamp @ self._points.reshape(-1, 3).T).reshape(shape)
        lamp_squared = np.sum(lamp_mm**2, axis=-1)[:, None, None]
        squared = np.maximum(self._squared - 2.0 * towards + lamp_squared, np.finfo(float).tiny)
        found = intensity * height[..., None] / (squared * np.sqrt(squared))
        if axis is not None:
            ahead = (axis[:, None] @ self._points.reshape(-1, 3).T).reshape(shape)
            ahead -= np.sum(lamp_mm * axis, axis=-1)[:, None, None]
            found *= np.maximum(ahead, 0.0) / np.sqrt(squared)
            bound *= np.clip((ahead.max(axis=-1) + radius_mm) / closest, 0.0, 1.0)
        near = gap <= 2.0 * _NEAR * self._half_mm + radius_mm
        means = found @ np.outer(_SIMPSON, _SIMPSON).ravel()
        return np.where(near, bound, means), np.where(near, bound, found.max(axis=-1))

    def exchange(self, leaving: Array) -> Array:
        """Irradiance of the walls by radiosities (P, cells, channels) of all walls, at most."""
        return np.asarray(_CELL_MARGIN * (_form_factors() @ leaving))

    def on_sample(self, leaving: Array) -> Array:
        """Irradiance (P, channels) of the sample by radiosities (P, cells, channels) of walls, at most."""
        return np.asarray(self._margin * (self._seen_by_sample @ leaving))

    def seen(self, directions: Array) -> Indices:
        """Return the cells (...) that the sample's centre sees in directions (..., 3)."""
        ways = directions.reshape(-1, 3)
        return self._walls.hit(np.zeros_like(ways), ways).patches.reshape(directions.shape[:-1])


@cache
def _form_factors() -> Array:
    """Shares (cells, cells) of what a cell receives that comes from each: of all cubes alike."""
    return Walls(1.0, SIDE_CELLS).form_factors()
