"""Upper bounds of the light between a housing's walls and a sample, by intervals: never below the truth.

The walls of the cube are cut into cells. Between two cells, or a cell and the sample, the kernel
cos cos' / (pi r^2) is at most the product of the largest cosines over the smallest distance, each over the
whole of both. The light that a point receives is a mean of the walls' with weights that add up to at most 1
(the projected hemisphere) and are each at most their bound: the largest such mean fills the brightest cells
first. Shadows only take light away.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_Boxes = tuple[Array, Array, Array]
"""Lowest and highest corners, and the normals of what lies in the boxes."""

SIDE_CELLS = 8
"""Cells along each side of a wall: 384 in all, whose pairs fit into a millisecond."""


class Cells:
    """A housing's walls in cells, around a sample.

    Parameters
    ----------
    half_size_mm : float
        Half the cube's side.
    sample_radius_mm : float
        The sample's.
    """

    def __init__(self, half_size_mm: float, sample_radius_mm: float) -> None:
        edges = np.linspace(-half_size_mm, half_size_mm, SIDE_CELLS + 1)
        low, high = (axis.ravel() for axis in np.meshgrid(edges[:-1], edges[:-1], indexing="ij"))
        side_mm = edges[1] - edges[0]
        lows, highs, normals = [], [], []
        for axis in range(3):
            for sign in (-1.0, 1.0):
                corner = np.insert(np.stack([low, high], axis=1), axis, sign * half_size_mm, axis=1)
                extent = np.insert(np.full(2, side_mm), axis, 0.0)
                lows.append(corner)
                highs.append(corner + extent)
                normals.append(np.broadcast_to(-sign * np.eye(3)[axis], corner.shape))
        self._low, self._high = np.concatenate(lows), np.concatenate(highs)
        self._normal = np.concatenate(normals)
        area = side_mm**2
        disc = np.array([sample_radius_mm, sample_radius_mm, 0.0])
        disc_area = np.pi * sample_radius_mm**2
        up = np.array([0.0, 0.0, 1.0])
        here = (self._low[:, None], self._high[:, None], self._normal[:, None])
        there = (self._low[None], self._high[None], self._normal[None])
        self._between = np.minimum(area * _kernel(here, there) / np.pi, 1.0)
        to_sample = _kernel((self._low, self._high, self._normal), (-disc, disc, up))
        self._seen_by_sample = np.minimum(area * to_sample / np.pi, 1.0)
        self.above = self._high[:, 2] > 0.0
        # Of the sample the product of radiance and cosine is known: its own cosine is left out here.
        self.from_sample = disc_area * _half_kernel(self._low, self._high, self._normal, -disc, disc)

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
        near = np.maximum(_gap(self._low, self._high, lamp_mm, lamp_mm) - radius_mm, np.finfo(float).tiny)
        height = _most(self._low, self._high, lamp_mm, lamp_mm, self._normal) + radius_mm
        found = intensity * np.minimum(height / near, 1.0) / near**2
        if axis is None:
            return np.asarray(found)
        ahead = _most(lamp_mm, lamp_mm, self._low, self._high, axis) + radius_mm
        return np.asarray(found * np.clip(ahead / near, 0.0, 1.0))

    def exchange(self, leaving: Array) -> Array:
        """Irradiance of the walls by radiosities (cells, channels) of all walls, at most."""
        return _brightest_first(leaving, self._between)

    def on_sample(self, leaving: Array) -> Array:
        """Irradiance (channels,) of the sample by radiosities (cells, channels) of the walls, at most."""
        return np.asarray(_brightest_first(leaving, self._seen_by_sample[None])[0])


def _brightest_first(leaving: Array, most: Array) -> Array:
    """Largest means (rows, channels) of values (cells, channels), weights (rows, cells) at most as given."""
    columns = []
    for values in leaving.T:
        order = np.argsort(-values)
        filled = np.minimum(np.cumsum(most[:, order], axis=1), 1.0)
        columns.append(np.diff(filled, axis=1, prepend=0.0) @ values[order])
    return np.stack(columns, axis=1)


def _gap(low: Array, high: Array, other_low: Array, other_high: Array) -> Array:
    """Smallest distance of two boxes."""
    apart = np.maximum(np.maximum(other_low - high, low - other_high), 0.0)
    return np.asarray(np.linalg.norm(apart, axis=-1))


def _most(low: Array, high: Array, other_low: Array, other_high: Array, normal: Array) -> Array:
    """Largest height of a point of the other box over a point of the first, along a normal."""
    ways = np.where(normal > 0.0, normal * (other_high - low), normal * (other_low - high))
    return np.asarray(np.maximum(ways.sum(axis=-1), 0.0))


def _kernel(first: _Boxes, second: _Boxes) -> Array:
    """Largest cos cos' / r^2 between points of two boxes; infinite where they touch."""
    (low, high, normal), (other_low, other_high, other_normal) = first, second
    gap = _gap(low, high, other_low, other_high)
    here = _most(low, high, other_low, other_high, normal)
    there = _most(other_low, other_high, low, high, other_normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = np.minimum(here / gap, 1.0) * np.minimum(there / gap, 1.0) / gap**2
    return np.where((here > 0.0) & (there > 0.0), np.nan_to_num(bound, nan=np.inf, posinf=np.inf), 0.0)


def _half_kernel(low: Array, high: Array, normal: Array, other_low: Array, other_high: Array) -> Array:
    """Largest cos / r^2, with the first box's cosine alone."""
    gap = _gap(low, high, other_low, other_high)
    here = _most(low, high, other_low, other_high, normal)
    return np.where(high[..., 2] > 0.0, np.minimum(here / gap, 1.0) / gap**2, 0.0)
