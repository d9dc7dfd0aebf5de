"""Where rays meet a sample of any form, its normal and axes there, and what it is made of: in float64.

A sample has coordinates of its own: its apex is their origin, +z its normal there. Mounting turns and raises
them into those of the scene. All forms are convex, so a point sees everything above its tangent plane, and
shadows are attached ones alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from simulator.mounting import Form
from simulator.patterns import pattern_cells, pattern_weight, relief_slopes, relief_waves

if TYPE_CHECKING:
    from collections.abc import Callable

    from simulator.mounting import Mounting

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Met:
    """Where N rays meet a sample; what misses it is NaN.

    Attributes
    ----------
    points_mm, normals : ndarray, shape (N, 3)
        In the scene's coordinates; the normal is the form's, without the relief.
    places_mm : ndarray, shape (N, 2)
        The points in the sample's own x and y.
    seen : ndarray of bool, shape (N,)
        Whether the ray meets the sample, from above, within its disc.
    """

    points_mm: Array
    normals: Array
    places_mm: Array
    seen: NDArray[np.bool_]

    def __getitem__(self, rows: NDArray[np.bool_]) -> Met:
        return Met(self.points_mm[rows], self.normals[rows], self.places_mm[rows], self.seen[rows])


class SampleSurface:
    """A sample of a form, mounted.

    Parameters
    ----------
    mounting : Mounting
    sample_radius_mm : float
        Of its disc, seen along its normal.
    """

    def __init__(self, mounting: Mounting, sample_radius_mm: float) -> None:
        self._mounting, self._radius_mm = mounting, sample_radius_mm
        self._turn = mounting.rotation
        self._apex = np.array([0.0, 0.0, mounting.height_mm])
        self._waves = None if mounting.relief is None else relief_waves(mounting.relief)

    @property
    def reach_mm(self) -> float:
        """How far from the origin some point of the sample may be."""
        return abs(self._mounting.height_mm) + 2.0 * self._radius_mm

    def meet(self, origin_mm: Array, directions: Array) -> Met:
        """Intersect rays.

        Parameters
        ----------
        origin_mm : ndarray, shape (3,)
        directions : ndarray, shape (N, 3)
            Unit vectors.
        """
        origin, ways = (origin_mm - self._apex) @ self._turn, directions @ self._turn
        with np.errstate(divide="ignore", invalid="ignore"):
            local, normal = self._intersect(origin, ways)
            inside = np.sum(local[:, :2] ** 2, axis=-1) <= self._radius_mm**2
            seen = inside & (np.sum(normal * ways, axis=-1) < 0.0)
        return Met(local @ self._turn.T + self._apex, normal @ self._turn.T, local[:, :2], seen)

    def _intersect(self, origin: Array, ways: Array) -> tuple[Array, Array]:
        """First points on the form, and normals, both (N, 3), in the sample's own coordinates."""
        if self._mounting.form is Form.FLAT:
            distance = -origin[2] / ways[:, 2]
            local = origin + np.where(distance > 0.0, distance, np.nan)[:, None] * ways
            local[:, 2] = 0.0  # what is left there is rounding
            return local, np.broadcast_to([0.0, 0.0, 1.0], local.shape)
        radius = self._mounting.radius_mm
        # Of a cylinder only what is at right angles to its axis counts.
        across = np.eye(3)
        if self._mounting.form is Form.CYLINDER:
            axis = np.array([np.cos(self._mounting.axis_rad), np.sin(self._mounting.axis_rad), 0.0])
            across = across - np.outer(axis, axis)
        start, flat_ways = across @ (origin + np.array([0.0, 0.0, radius])), ways @ across
        squared = np.sum(flat_ways**2, axis=-1)
        to_closest = -(flat_ways @ start) / squared
        closest = start + to_closest[:, None] * flat_ways
        # The distance of the ray from the middle, not a difference of large squares.
        half_chord = np.sqrt((radius**2 - np.sum(closest**2, axis=-1)) / squared)
        distance = to_closest - half_chord
        distance = np.where(distance > 0.0, distance, np.nan)[:, None]
        return origin + distance * ways, (start + distance * flat_ways) / radius

    def edges(self, met: list[Met]) -> NDArray[np.bool_]:
        """Tell for which pixels it makes a difference in kind where in them one looks.

        Parameters
        ----------
        met : list of Met
            Of several places of the same N pixels.

        Returns
        -------
        ndarray of bool, shape (N,)
            Some of them miss the sample and some do not, or the pattern changes in between.
        """
        seen = np.stack([points.seen for points in met])
        differ = seen.any(axis=0) & ~seen.all(axis=0)
        pattern = self._mounting.pattern
        if pattern is not None:
            places = [np.where(points.seen[:, None], points.places_mm, 0.0) for points in met]
            cells = np.stack([pattern_cells(pattern, self._radius_mm, place) for place in places])
            differ |= seen.all(axis=0) & (np.ptp(cells, axis=0) > 0.0).any(axis=-1)
        return np.asarray(differ)

    def frames(self, met: Met) -> Array:
        """Return the material's axes at points: rows along its x and y, and the normal of the relief.

        Along x is what the sample's own x (turned by `turn_rad`) leaves in the tangent plane.

        Returns
        -------
        ndarray, shape (N, 3, 3)
            In the scene's coordinates.
        """
        normal = met.normals
        if self._waves is not None:
            slopes = relief_slopes(self._waves, met.places_mm)
            along, across = self._tangents(normal, 0.0)
            normal = unit(normal - slopes[:, :1] * along - slopes[:, 1:] * across)
        return np.stack([*self._tangents(normal, self._mounting.turn_rad), normal], axis=1)

    def _tangents(self, normal: Array, turn_rad: float) -> tuple[Array, Array]:
        axis = self._turn @ [np.cos(turn_rad), np.sin(turn_rad), 0.0]
        along = unit(axis - (normal @ axis)[:, None] * normal)
        return along, np.cross(normal, along)

    def f_r(self, own: Reflectance, other: Reflectance | None, met: Met, wi: Array, wo: Array) -> Array:
        """Evaluate the materials at points.

        Parameters
        ----------
        own, other : callable
            (wi (N, 3), wo (N, 3)) -> f_r (N, 3) of the material, and of a pattern's second one.
        met : Met
            N points.
        wi, wo : ndarray, shape (N, 3)
            In the material's axes.
        """
        values = own(wi, wo)
        pattern = self._mounting.pattern
        if pattern is None or other is None:
            return values
        weight = pattern_weight(pattern, self._radius_mm, met.places_mm)
        some = weight.any(axis=-1)
        values = np.array(values)
        values[some] += weight[some] * (other(wi[some], wo[some]) - values[some])
        return values
