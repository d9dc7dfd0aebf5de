"""Ordinary kriging from the nearest samples, with lengths that leaving samples out has chosen.

Cressie (1993), "Statistics for spatial data", section 3.2. The covariance's range is a multiple of each
query's own neighbourhood, so that dense and sparse regions are treated alike, and so is its variance: that of
the neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

NEIGHBOURS = 18
CHUNK = 800
"""Queries solved at a time: bounds the memory, and keeps it near the processor."""
RANGE = 4.0
"""Range of the covariance in distances to the farthest neighbour."""
DENSE_PERCENT = 5.0
SAME_PLACE = 1e-9
LEAST_SIGNAL = 0.01
"""Part of the neighbours' variance that is always taken as signal, however large their noise."""
TESTS = 500
LARGEST_PULL = 12.0
LEAST_MISFIT = 1e-3
SPACINGS = (4, 3.0)
"""A query is in a hole if its nearest sample is farther than 3 of the distances that the neighbours have to
their own fourth nearest."""

SMOOTHNESS = (0.5, 1.5, 2.5)
NUGGETS = (1e-6, 1e-4, 1e-2, 0.1)
STRETCHES = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
DEPTHS = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2)


@dataclass(frozen=True)
class Settings:
    """What leaving samples out chooses.

    Attributes
    ----------
    smoothness : float
        Matern's nu: 0.5, 1.5 or 2.5.
    nugget : float
        Variance of what no neighbour shares, beside the stated noise, in units of the local variance.
    stretch : float
        How much faster the ratio changes along theta_h than around: weight of the radius.
    depth : float
        Weight of the light's polar angle.
    """

    smoothness: float = 1.5
    nugget: float = 1e-4
    stretch: float = 4.0
    depth: float = 0.8


class Solution(NamedTuple):
    """Values (N, C), their variances, and the uncertainty that all samples share."""

    value: Array
    variance: Array
    common: Array


class Estimate(NamedTuple):
    """A solution, and whether no sample is near (N,)."""

    value: Array
    variance: Array
    common: Array
    hole: NDArray[np.bool_]

    def rows(self, chosen: Indices | NDArray[np.bool_]) -> Estimate:
        """Choose rows, or repeat them."""
        return Estimate(self.value[chosen], self.variance[chosen], self.common[chosen], self.hole[chosen])


@dataclass(frozen=True, eq=False)
class Kriging:
    """Samples of a field.

    Attributes
    ----------
    place : ndarray, shape (N, 2 or 3)
        The half vector's place on the disc and, where samples do not lie in layers, the light's polar angle.
    value : ndarray, shape (N, C)
        Samples.
    noise : ndarray, shape (N, C)
        Their independent standard uncertainty; 0 where none is stated.
    common : ndarray, shape (N, C)
        The uncertainty that all share.
    settings : Settings
        Lengths and covariance.
    misfit : float
        Factor on the standard deviation that makes it true of samples left out.
    """

    place: Array
    value: Array
    noise: Array
    common: Array
    settings: Settings
    misfit: float = 1.0

    def __call__(self, place: Array) -> Estimate:
        """Interpolate at places, shape (M, 2 or 3); one that is asked for several times is solved once."""
        if place.shape[1] > 2:
            return self._solved(place)
        rounded = np.round(place / SAME_PLACE) @ np.array([1.0, 1.0j])
        _, first, again = np.unique(rounded, return_index=True, return_inverse=True)
        return self._solved(place[first]).rows(again)

    def _solved(self, place: Array) -> Estimate:
        """Solve where samples are near; a hole gets the mean of its neighbours, which costs nothing."""
        shape = (len(place), self.value.shape[1])
        total = Estimate(np.zeros(shape), np.zeros(shape), np.zeros(shape), np.ones(len(place), dtype=bool))
        for start in range(0, len(place), CHUNK):
            some = slice(start, start + CHUNK)
            away, found = self._nearest(self._embed(place[some]), NEIGHBOURS)
            hole = away[:, 0] > SPACINGS[1] * np.median(self._spacing[found], axis=1)
            total.hole[some] = hole
            rows, far = np.flatnonzero(~hole), found[hole]
            part = self._estimate(place[some][rows], found[rows])
            means = self.value[far].mean(axis=1), self.value[far].var(axis=1), self.common[far].mean(axis=1)
            for column, values, mean in zip(total[:3], part, means, strict=True):
                column[some][hole], column[some][rows] = mean, values
        return total

    def leave_out(self, rows: Indices) -> Solution:
        """Estimate samples as if they had not been taken."""
        _, found = self._nearest(self._embedded[rows], NEIGHBOURS + 1)
        # The sample itself is the nearest, but where several lie in one place.
        own = found == rows[:, None]
        own[~own.any(axis=1), -1] = True
        others = found[~own].reshape(len(rows), -1)
        return self._estimate(self.place[rows], others)

    @property
    def finest_radius(self) -> float:
        """Step of the radius that counts as much as the distance between samples where they are dense."""
        return float(np.percentile(self._spacing, DENSE_PERCENT) / np.hypot(1.0, self.settings.stretch))

    @cached_property
    def _embedded(self) -> Array:
        return self._embed(self.place)

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import KDTree

        return KDTree(self._embedded)

    @cached_property
    def _spacing(self) -> Array:
        """Distance of each sample to its fourth neighbour."""
        nearest = min(SPACINGS[0] + 1, len(self.place))
        return np.asarray(self._tree.query(self._embedded, k=[nearest])[0][:, 0])

    def _embed(self, place: Array) -> Array:
        """Coordinates whose Euclidean distance counts.

        The radius stands beside the place on the disc: steps outward then count more than steps around.
        """
        radius = np.hypot(place[:, 0], place[:, 1])
        columns = [place[:, 0], place[:, 1], self.settings.stretch * radius]
        columns += [self.settings.depth * place[:, 2]] if place.shape[1] > 2 else []
        return np.stack(columns, axis=-1)

    def _nearest(self, point: Array, count: int) -> tuple[Array, Indices]:
        """Distances and numbers of the nearest samples, nearest first."""
        # One neighbour at least, as a list: scipy drops the axis otherwise.
        wanted = np.arange(1, min(count, len(self.place)) + 1)
        away, found = self._tree.query(point, k=wanted)
        return away, np.asarray(found, dtype=np.intp)

    def _estimate(self, place: Array, found: Indices) -> Solution:
        offset = self._embedded[found] - self._embed(place)[:, None]
        products = offset @ offset.transpose(0, 2, 1)
        squared = np.einsum("nii->ni", products)
        # Products of offsets, not of positions: what cancels is small.
        between = np.sqrt(np.maximum(squared[:, :, None] + squared[:, None] - 2.0 * products, 0.0))
        away = np.sqrt(squared)
        far = np.maximum(away.max(axis=1), np.finfo(float).tiny)
        z, noise = self.value[found], np.square(self.noise[found])
        nugget = self.settings.nugget + _noise_part(z, noise)
        scale = 1.0 / (RANGE * far)
        covariance = _matern(between * scale[:, None, None], self.settings.smoothness)
        np.einsum("nii->ni", covariance)[:] += nugget
        near = _matern(away * scale[:, None], self.settings.smoothness)
        # About their own mean, so that what cancels in the scatter is small.
        middle = z.mean(axis=1, keepdims=True)
        sides = np.concatenate([near[..., None], np.ones((*near.shape, 1)), z - middle], axis=-1)
        solved = np.linalg.solve(covariance, sides)
        total = solved[..., 1].sum(axis=1)
        lagrange = (1.0 - solved[..., 0].sum(axis=1)) / total
        weights = solved[..., 0] + lagrange[:, None] * solved[..., 1]
        mean = solved[..., 2:].sum(axis=1) / total[:, None]
        scatter = np.einsum("nkc,nkc->nc", z - middle, solved[..., 2:]) - np.square(mean) * total[:, None]
        sill = np.maximum(scatter, 0.0) / max(found.shape[1] - 1, 1)
        kept = np.maximum(1.0 + self.settings.nugget + lagrange - (weights * near).sum(axis=1), 0.0)
        return Solution(
            np.einsum("nk,nkc->nc", weights, z),
            np.square(self.misfit) * sill * kept[:, None],
            np.abs(np.einsum("nk,nkc->nc", weights, self.common[found])),
        )


def tuned(kriging: Kriging) -> Kriging:
    """Choose the settings, one after the other, by the errors at samples that are left out."""
    rows = np.random.default_rng(0).permutation(len(kriging.place))[:TESTS]
    choices: dict[str, tuple[float, ...]] = {
        "stretch": STRETCHES,
        "depth": DEPTHS if kriging.place.shape[1] > 2 else (),
        "smoothness": SMOOTHNESS,
        "nugget": NUGGETS,
    }
    best, least = kriging, _error(kriging, rows)
    for names in (("stretch", "depth", "stretch", "depth"), ("smoothness", "nugget")):
        for name in names:
            for choice in choices[name]:
                tried = replace(kriging, settings=replace(best.settings, **{name: choice}))
                error = _error(tried, rows)
                if error < least:
                    best, least = tried, error
    return with_misfit(best)


def with_misfit(kriging: Kriging) -> Kriging:
    """Measure the errors at samples that are left out in their own standard deviations, and scale those."""
    rows = np.random.default_rng(0).permutation(len(kriging.place))[:TESTS]
    found = kriging.leave_out(rows)
    expected = found.variance + np.square(kriging.noise[rows]) + np.finfo(float).tiny
    pull = np.minimum(np.abs(found.value - kriging.value[rows]) / np.sqrt(expected), LARGEST_PULL)
    misfit = max(float(np.sqrt(np.square(pull).mean())), LEAST_MISFIT)
    return replace(kriging, misfit=kriging.misfit * misfit)


def _error(kriging: Kriging, rows: Indices) -> float:
    """Mean root of the absolute error: neither blind to the tail, nor led by it."""
    return float(np.sqrt(np.abs(kriging.leave_out(rows).value - kriging.value[rows])).mean())


def _noise_part(z: Array, noise: Array) -> Array:
    """Stated noise of each neighbour in units of the neighbourhood's variance without it, shape (N, K)."""
    spread = z.var(axis=1).mean(axis=-1)
    mean_noise = noise.mean(axis=(1, 2))
    signal = np.maximum(spread - mean_noise, LEAST_SIGNAL * spread) + np.finfo(float).tiny
    return np.asarray(np.minimum(noise.mean(axis=-1) / signal[:, None], 1.0 / LEAST_SIGNAL))


def _matern(distance: Array, smoothness: float) -> Array:
    fast = np.exp(-np.sqrt(2.0 * smoothness) * distance)
    if smoothness == 0.5:
        return np.asarray(fast)
    scaled = np.sqrt(2.0 * smoothness) * distance
    return np.asarray((1.0 + scaled * (1.0 + (scaled / 3.0 if smoothness > 2.0 else 0.0))) * fast)
