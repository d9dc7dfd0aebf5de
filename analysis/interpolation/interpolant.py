"""The interpolant: trend times ratio, in layers where the samples share few polar angles of the light."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.interpolation.isotropy import require_isotropic
from analysis.interpolation.kriging import Estimate, Kriging, Settings, tuned, with_misfit
from analysis.interpolation.trend import Trend, fit_trend
from rig.angles import direction_to_spherical, half_vector
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

FEWEST_IN_LAYER = 16
MOST_LAYERS = 64
SAME_ANGLE_RAD = 1e-4
IN_PLANE = 1e-6
LONE_LAYER_RAD = np.radians(1.0)
"""How far a single incidence is taken to hold."""
WIDE_GAP = 3.0
"""Gaps between incidences, in units of their median, that are holes but for their edges."""
TESTS = 100
FLIP = np.array([1.0, -1.0, 1.0])


class Interpolated(NamedTuple):
    """What an interpolant gives.

    Attributes
    ----------
    f_r, u_f_r : ndarray, shape (N, C)
        1/sr; the standard uncertainty is that of interpolation and of the samples together.
    borrowed : ndarray of bool, shape (N,)
        No sample is near, but one is at the exchanged or mirrored directions: that value was taken.
    hole : ndarray of bool, shape (N,)
        No sample is near there either: the value is a guess, its uncertainty says nothing.
    """

    f_r: Array
    u_f_r: Array
    borrowed: Mask
    hole: Mask


class Interpolant:
    """f_r between scattered samples of an isotropic surface.

    Parameters
    ----------
    wi, wo : ndarray, shape (N, 3)
        Unit directions above the surface.
    f_r : ndarray, shape (N, C)
        Finite values in 1/sr.
    u_independent, u_common : ndarray, shape (N, C), optional
        Standard uncertainty that is each sample's own, and that all share.
    mirrored : bool
        Whether f_r is the same on both sides of the plane of incidence, and with light and view exchanged:
        not in one scan of an anisotropic surface, the light at one azimuth.

    Raises
    ------
    BadInput
        If the samples lie in one plane, so that nothing is known beside it.
    Refused
        If they depend on the light's azimuth; see `analysis.interpolation.isotropy`.
    """

    def __init__(
        self,
        wi: Array,
        wo: Array,
        f_r: Array,
        *,
        u_independent: Array | None = None,
        u_common: Array | None = None,
        mirrored: bool = True,
    ) -> None:
        place = places(wi, wo)
        if np.abs(place[:, 1]).max() < IN_PLANE:
            raise BadInput(
                "lie in one plane: nothing is known beside it",
                where="samples",
                todo="measure out of the plane too, or write a table of samples",
            )
        require_isotropic(place, wi, f_r)
        self.trend: Trend = fit_trend(wi, wo, f_r)
        level = self.trend(wi, wo)
        own, shared = (np.zeros_like(f_r) if u is None else u for u in (u_independent, u_common))
        table = np.hstack([f_r / level, own / level, shared / level])
        self._mirrored = mirrored
        if mirrored and ((place[:, 1] >= -IN_PLANE).all() or (place[:, 1] <= IN_PLANE).all()):
            beside = np.abs(place[:, 1]) > IN_PLANE
            place = np.concatenate([place, place[beside] * FLIP])
            table = np.concatenate([table, table[beside]])
        ratio, own, common = np.hsplit(table, 3)
        self.theta_i: Array = _layers(place[:, 2])
        if self.theta_i.size:
            rows = [np.flatnonzero(_same(place[:, 2], angle)) for angle in self.theta_i]
            self._fields = _tuned_layers([(place[r, :2], ratio[r], own[r], common[r]) for r in rows])
        else:
            self._fields = [tuned(Kriging(place, ratio, own, common, Settings()))]
        self.largest_theta_i = float(place[:, 2].max())
        self._curvature = self._between_layers()

    def __call__(self, wi: Array, wo: Array) -> Interpolated:
        """Interpolate.

        Parameters
        ----------
        wi, wo : ndarray, shape (N, 3)
            Unit directions above the surface.
        """
        ratio = self._direct(wi, wo)
        borrowed = np.zeros(len(wi), dtype=bool)
        turns: list[Callable[[Array, Array], tuple[Array, Array]]] = [
            lambda i, o: (i * FLIP, o * FLIP),
            lambda i, o: (o, i),
            lambda i, o: (o * FLIP, i * FLIP),
        ]
        level = self.trend(wi, wo)
        f_r, u = self._scaled(ratio, level)
        hole = ratio.hole.copy()
        for turn in turns if self._mirrored else ():
            rows = np.flatnonzero(hole)
            other_wi, other_wo = turn(wi[rows], wo[rows])
            if self.theta_i.size:
                # What no layer is near to is a hole still.
                there = ~self._beyond(direction_to_spherical(other_wi)[0])
                rows, other_wi, other_wo = rows[there], other_wi[there], other_wo[there]
            if not rows.size:
                continue
            other = self._direct(other_wi, other_wo)
            near = ~other.hole
            if not near.any():
                continue
            f_r[rows[near]], u[rows[near]] = self._scaled(
                other.rows(near), self.trend(other_wi[near], other_wo[near])
            )
            hole[rows[near]], borrowed[rows[near]] = False, True
        return Interpolated(f_r, u, borrowed, hole)

    @property
    def finest_radius(self) -> float:
        """Step of the half vector's radius that the densest samples of a layer resolve."""
        return min(field.finest_radius for field in self._fields)

    @staticmethod
    def _scaled(ratio: Estimate, level: Array) -> tuple[Array, Array]:
        return ratio.value * level, np.sqrt(ratio.variance + np.square(ratio.common)) * level

    def _direct(self, wi: Array, wo: Array) -> Estimate:
        place = places(wi, wo)
        if not self.theta_i.size:
            return self._fields[0](place)
        below, above, upper = self._around(place[:, 2])
        gap = self.theta_i[above] - self.theta_i[below]
        bend = self._curvature * (upper * (1.0 - upper) * np.square(gap))[:, None]
        total = Estimate(np.zeros_like(bend), np.square(bend), np.zeros_like(bend), self._beyond(place[:, 2]))
        for index, weight in ((below, 1.0 - upper), (above, upper)):
            for layer in np.unique(index[weight > 0.0]):
                rows = np.flatnonzero((index == layer) & (weight > 0.0))
                part, share = self._fields[layer](place[rows, :2]), weight[rows, None]
                total.value[rows] += share * part.value
                total.variance[rows] += np.square(share) * part.variance
                total.common[rows] += share * part.common
                total.hole[rows] |= part.hole
        return total

    def _around(self, theta_i: Array) -> tuple[Indices, Indices, Array]:
        """Layers below and above each polar angle, and the weight of the upper one."""
        last = self.theta_i.size - 1
        below = np.clip(np.searchsorted(self.theta_i, theta_i + SAME_ANGLE_RAD, side="right") - 1, 0, last)
        above = np.minimum(below + 1, last)
        span = np.where(above > below, self.theta_i[above] - self.theta_i[below], 1.0)
        upper = np.clip((theta_i - self.theta_i[below]) / span, 0.0, 1.0)
        return below, above, np.where(upper * span < SAME_ANGLE_RAD, 0.0, upper)

    def _beyond(self, theta_i: Array) -> Mask:
        """Whether no layer is near: beyond the first and last, or in the middle of a wide gap."""
        gaps = np.diff(self.theta_i)
        reach = 0.5 * float(np.median(gaps)) if gaps.size else LONE_LAYER_RAD
        away = np.abs(theta_i[:, None] - self.theta_i).min(axis=1) > reach + SAME_ANGLE_RAD
        below, above, _ = self._around(theta_i)
        wide = self.theta_i[above] - self.theta_i[below] > 2.0 * WIDE_GAP * reach
        ends = (theta_i < self.theta_i[0]) | (theta_i > self.theta_i[-1])
        return np.asarray(away & (wide | ends))

    def _between_layers(self) -> Array:
        """Curvature of the ratio from layer to layer, (C,), by leaving layers out.

        Between two nodes the error of a straight line is curvature times the distances to both.
        """
        errors: list[Array] = []
        for layer in range(1, self.theta_i.size - 1):
            field, around = self._fields[layer], (self.theta_i[layer - 1], self.theta_i[layer + 1])
            place, known = field.place[:TESTS], field.value[:TESTS]
            upper = (self.theta_i[layer] - around[0]) / (around[1] - around[0])
            low, high = (self._fields[layer + step](place) for step in (-1, 1))
            expected = np.square(1.0 - upper) * low.variance + np.square(upper) * high.variance
            error = np.square((1.0 - upper) * low.value + upper * high.value - known)
            excess = error - expected - np.square(field.noise[:TESTS])
            kept = excess[~(low.hole | high.hole)]
            errors.append(kept / np.square(upper * (1.0 - upper) * (around[1] - around[0]) ** 2))
        if not errors or not sum(map(len, errors)):
            return np.zeros(self._fields[0].value.shape[1])
        return np.asarray(np.sqrt(np.maximum(np.concatenate(errors).mean(axis=0), 0.0)))


def places(wi: Array, wo: Array) -> Array:
    """Return coordinates in which an isotropic surface has one value.

    Parameters
    ----------
    wi, wo : ndarray, shape (N, 3)
        Unit directions above the surface.

    Returns
    -------
    ndarray, shape (N, 3)
        Half vector on a disc of radius sqrt(2 theta_h / pi), azimuth from the light's; theta_i in radians.
    """
    theta_i, phi_i = direction_to_spherical(wi)
    theta_h, phi_h = direction_to_spherical(half_vector(wi, wo))
    radius, phi = np.sqrt(theta_h * (2.0 / np.pi)), phi_h - phi_i
    return np.stack([radius * np.cos(phi), radius * np.sin(phi), theta_i], axis=-1)


def _same(theta_i: Array, angle: float) -> Mask:
    return np.asarray(np.round(theta_i / SAME_ANGLE_RAD) == round(angle / SAME_ANGLE_RAD))


def _layers(theta_i: Array) -> Array:
    """Polar angles of the light that many samples share, if all samples have one of few; else empty."""
    known, counts = np.unique(np.round(theta_i / SAME_ANGLE_RAD), return_counts=True)
    layered = known.size <= MOST_LAYERS and counts.min() >= FEWEST_IN_LAYER
    return known * SAME_ANGLE_RAD if layered else np.zeros(0)


def _tuned_layers(layers: list[tuple[Array, Array, Array, Array]]) -> list[Kriging]:
    """Choose the settings in the middle layer; each layer has its own misfit."""
    fields = [Kriging(*layer, Settings()) for layer in layers]
    settings = tuned(fields[len(fields) // 2]).settings
    return [with_misfit(replace(field, settings=settings)) for field in fields]
