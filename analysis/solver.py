"""The search: shapes are scanned and refined, scales are solved for (variable projection).

Search coordinates. A shape parameter is searched in the coordinate it names (log m, ...). A specular scale is
replaced by s = ks |w lobe|, the size of the specular part of the weighted data: unlike ks it hardly depends
on the shapes, so the long curved valleys of (ks, ior) and of (ks, m) become straight.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.descent import descend
from analysis.models.base import Geometry, Kind, Parameter

if TYPE_CHECKING:
    from analysis.losses import Loss
    from analysis.models.base import Model

Array = NDArray[np.float64]

STARTS = 4
"""Basins of the scan that are followed to their bottom."""
TOLERANCE = 1e-11
ROUGH_TOLERANCE = 1e-5
MOST_STEPS = 300
DEGENERATE = 1e-12
"""Squared sine between the two scaled columns below which they count as one."""


@dataclass(frozen=True)
class Problem:
    """Samples and the model to meet them.

    Attributes
    ----------
    model : type of Model
        The model.
    geometry : Geometry
        The samples' N pairs of directions.
    channels : int
        Number C of channels.
    """

    model: type[Model]
    geometry: Geometry
    channels: int

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """The model's shape parameters, in its order."""
        return tuple(p for p in self.model.PARAMETERS if p.kind is Kind.SHAPE)

    @property
    def has_lobe(self) -> bool:
        """Whether there is a specular scale."""
        return any(p.kind is Kind.SPECULAR_SCALE for p in self.model.PARAMETERS)

    def lobe(self, coordinates: Array) -> tuple[Array, list[Array]]:
        """Return the lobe (N, 1) at unit scale and its derivatives by the search coordinates."""
        values = {p.name: p.coordinate.inverse(x) for p, x in zip(self.shapes, coordinates, strict=True)}
        with np.errstate(under="ignore", over="ignore"):
            lobe = self.model(**values).lobe_at(self.geometry)
        if lobe is None:
            return np.zeros((len(self.geometry.wi), 1)), []
        visible = self.geometry.visible[:, None]
        slopes = [
            np.where(visible, lobe.slopes[p.name] * p.coordinate.slope(values[p.name]), 0.0)
            for p in self.shapes
        ]
        return np.where(visible, lobe.value, 0.0), slopes

    def bounds(self) -> tuple[Array, Array]:
        """Return bounds of the shapes in search coordinates."""
        low, high = (np.array([p.coordinate.forward(p.bounds[side]) for p in self.shapes]) for side in (0, 1))
        return low, high


@dataclass(frozen=True)
class Solution:
    """A point of the search.

    Attributes
    ----------
    shapes : ndarray, shape (S,)
        Shape parameters in search coordinates.
    kd, ks : ndarray, shape (C,)
        Scales.
    cost : float
        Half the sum of squared residuals.
    """

    shapes: Array
    kd: Array
    ks: Array
    cost: float


def solve_scales(weight: Array, data: Array, lobe: Array, *, has_lobe: bool = True) -> tuple[Array, Array]:
    """Solve for the non-negative scales of kd/pi + ks lobe, each channel alone.

    Least squares in two unknowns with both >= 0 has four candidates: both free, either one zero, both zero.
    The problem is convex, so the free solution is taken where it is admissible, else the better of the
    others.

    Parameters
    ----------
    weight, data : ndarray, shape (N, C)
        Weights (0 for unused data) and data.
    lobe : ndarray, shape (N, 1 or C)
        The lobe at unit scale.
    has_lobe : bool
        False for a model that is kd alone.

    Returns
    -------
    tuple of ndarray, shape (C,)
        kd and ks.
    """
    target = weight * data
    diffuse, specular = weight / np.pi, weight * lobe
    dd, ds, ss = (
        np.einsum("nc,nc->c", a, b)
        for a, b in ((diffuse, diffuse), (diffuse, specular), (specular, specular))
    )
    dt, st = (np.einsum("nc,nc->c", a, target) for a in (diffuse, specular))
    kd_alone = np.maximum(dt, 0.0) / np.where(dd > 0.0, dd, 1.0)
    if not has_lobe:
        return kd_alone, np.zeros_like(kd_alone)
    ks_alone = np.maximum(st, 0.0) / np.where(ss > 0.0, ss, 1.0)
    determinant = dd * ss - ds * ds
    separable = determinant > DEGENERATE * dd * ss
    safe = np.where(separable, determinant, 1.0)
    kd, ks = (dt * ss - st * ds) / safe, (st * dd - dt * ds) / safe
    free = separable & (kd >= 0.0) & (ks >= 0.0)
    # The objective falls by kd_alone * dt / 2 or ks_alone * st / 2 from that of both zero.
    diffuse_wins = kd_alone * dt >= ks_alone * st
    kd = np.where(free, kd, np.where(diffuse_wins, kd_alone, 0.0))
    ks = np.where(free, ks, np.where(diffuse_wins, 0.0, ks_alone))
    return kd, ks


def minimise(problem: Problem, loss: Loss, start: Solution | None = None) -> Solution:
    """Find the best parameters under a loss.

    Parameters
    ----------
    problem : Problem
        Directions and model.
    loss : Loss
        Data and what to make small.
    start : Solution, optional
        A solution of nearly the same problem: it is refined and nothing else is tried.

    Returns
    -------
    Solution
    """
    starts = [start.shapes] if start is not None else _scan(problem, loss.weight(), loss.data)
    projected = [_refine_projected(problem, loss.weight(), loss.data, shapes) for shapes in starts]
    if loss.linear:
        return min(projected, key=lambda solution: solution.cost)
    # Neighbouring starts often meet in one point: only distinct ones are worth a search of all parameters,
    # and only the best of those is worth the last digits.
    distinct = _distinct(sorted(projected, key=lambda solution: solution.cost))
    rough = [_refine_all(problem, loss, solution, ROUGH_TOLERANCE) for solution in distinct]
    return _refine_all(problem, loss, min(rough, key=lambda solution: solution.cost), TOLERANCE)


def _scan(problem: Problem, weight: Array, data: Array) -> list[Array]:
    """Evaluate every combination of the parameters' scan values; return the local minima, best first."""
    if not problem.shapes:
        return [np.empty(0)]
    axes = [[p.coordinate.forward(value) for value in p.scan] for p in problem.shapes]
    cost = np.empty([len(axis) for axis in axes])
    for index in itertools.product(*(range(len(axis)) for axis in axes)):
        point = np.array([axis[i] for axis, i in zip(axes, index, strict=True)])
        lobe, _ = problem.lobe(point)
        kd, ks = solve_scales(weight, data, lobe)
        cost[index] = np.sum(np.square(weight * (kd / np.pi + ks * lobe - data)))
    minima = []
    for index in itertools.product(*(range(len(axis)) for axis in axes)):
        around = tuple(slice(max(i - 1, 0), i + 2) for i in index)
        if cost[index] <= cost[around].min():
            minima.append((cost[index], [axis[i] for axis, i in zip(axes, index, strict=True)]))
    minima.sort(key=lambda entry: float(entry[0]))
    return [np.array(point) for _, point in minima[:STARTS]]


def _refine_projected(problem: Problem, weight: Array, data: Array, shapes: Array) -> Solution:
    """Refine the shapes with the scales solved for at every step (Golub & Pereyra 1973; Kaufman 1975)."""

    def residual(x: Array) -> Array:
        lobe, _ = problem.lobe(x)
        kd, ks = solve_scales(weight, data, lobe, has_lobe=problem.has_lobe)
        return (weight * (kd / np.pi + ks * lobe - data)).ravel()

    def jacobian(x: Array) -> Array:
        lobe, slopes = problem.lobe(x)
        kd, ks = solve_scales(weight, data, lobe)
        basis = _orthonormal(weight, lobe, kd > 0.0, ks > 0.0)
        columns = []
        for slope in slopes:
            column = weight * ks * slope
            for vector in basis:
                column = column - vector * np.einsum("nc,nc->c", vector, column)
            columns.append(column.ravel())
        return np.stack(columns, axis=1)

    if problem.shapes:
        shapes = descend(residual, jacobian, shapes, problem.bounds(), tolerance=TOLERANCE, most=MOST_STEPS).x
    lobe, _ = problem.lobe(shapes)
    kd, ks = solve_scales(weight, data, lobe, has_lobe=problem.has_lobe)
    return Solution(shapes, kd, ks, 0.5 * float(np.sum(np.square(residual(shapes)))))


def _orthonormal(
    weight: Array, lobe: Array, diffuse_on: NDArray[np.bool_], specular_on: NDArray[np.bool_]
) -> list[Array]:
    """Return orthonormal columns (N, C) that span, channel by channel, what the active scales can do."""
    first = _unit_columns(np.where(diffuse_on, weight / np.pi, 0.0))
    specular = np.where(specular_on, weight * lobe, 0.0)
    second = _unit_columns(specular - first * np.einsum("nc,nc->c", first, specular))
    return [first, second]


def _unit_columns(columns: Array) -> Array:
    length = np.sqrt(np.einsum("nc,nc->c", columns, columns))
    return columns / np.where(length > 0.0, length, 1.0)


def _distinct(solutions: list[Solution]) -> list[Solution]:
    kept: list[Solution] = []
    for solution in solutions:
        if all(np.max(np.abs(solution.shapes - other.shapes), initial=0.0) > 1e-3 for other in kept):
            kept.append(solution)
    return kept


@dataclass(frozen=True)
class SearchJacobian:
    """Derivatives of f by the search coordinates (shapes, then kd by channel, then s by channel).

    Attributes
    ----------
    f : ndarray, shape (N, C)
        The model.
    columns : ndarray, shape (N, C, S + 2 C or S + C)
        df / d coordinate.
    size : ndarray, shape (C,)
        |w lobe|, so that ks = s / size.
    size_slopes : ndarray, shape (S, C)
        Its logarithmic derivative by the shapes' coordinates.
    """

    f: Array
    columns: Array
    size: Array
    size_slopes: Array


def search_jacobian(problem: Problem, weight: Array, shapes: Array, kd: Array, ks: Array) -> SearchJacobian:
    """Differentiate f by the search coordinates.

    Parameters
    ----------
    problem : Problem
        Directions and model.
    weight : ndarray, shape (N, C)
        The weights that define s.
    shapes : ndarray, shape (S,)
        Shapes in search coordinates.
    kd, ks : ndarray, shape (C,)
        Scales.

    Returns
    -------
    SearchJacobian
    """
    lobe, slopes = problem.lobe(shapes)
    size, size_slopes = _size(weight, lobe, slopes)
    count, channels = weight.shape
    visible = problem.geometry.visible[:, None]
    each = np.eye(channels)
    columns = [ks * (slope - lobe * relative) for slope, relative in zip(slopes, size_slopes, strict=True)]
    scales = [np.where(visible, 1.0 / np.pi, 0.0) * each[c] for c in range(channels)]
    if problem.has_lobe:
        scales += [lobe / size * each[c] for c in range(channels)]
    stacked = np.stack([np.broadcast_to(c, (count, channels)) for c in (*columns, *scales)], axis=-1)
    f = np.where(visible, kd / np.pi, 0.0) + ks * lobe
    return SearchJacobian(f, stacked, size, size_slopes)


def _size(weight: Array, lobe: Array, slopes: list[Array]) -> tuple[Array, Array]:
    weighted = weight * lobe
    square = np.einsum("nc,nc->c", weighted, weighted)
    square = np.where(square > 0.0, square, 1.0)
    relative = [np.einsum("nc,nc->c", weighted, weight * slope) / square for slope in slopes]
    return np.sqrt(square), np.array(relative).reshape(len(slopes), weight.shape[1])


def _refine_all(problem: Problem, loss: Loss, start: Solution, tolerance: float) -> Solution:
    """Search shapes and scales together, for losses that are not linear in f."""
    weight = loss.weight()
    shape_count, channels = len(start.shapes), problem.channels

    def unpack(x: Array) -> tuple[Array, Array, Array]:
        shapes, kd, s = np.split(x, [shape_count, shape_count + channels])
        if not problem.has_lobe:
            return shapes, kd, np.zeros(channels)
        return shapes, kd, s / _size(weight, problem.lobe(shapes)[0], [])[0]

    def residual(x: Array) -> Array:
        shapes, kd, ks = unpack(x)
        return loss.residual(_evaluate(problem, shapes, kd, ks)).ravel()

    def jacobian(x: Array) -> Array:
        derivative = search_jacobian(problem, weight, *unpack(x))
        slope = loss.slope(derivative.f)[..., None]
        return (slope * derivative.columns).reshape(-1, x.size)

    size = _size(weight, problem.lobe(start.shapes)[0], [])[0]
    low, high = problem.bounds()
    scales = [start.kd, start.ks * size] if problem.has_lobe else [start.kd]
    lowest = np.concatenate([low, *(np.zeros(channels) for _ in scales)])
    highest = np.concatenate([high, *(np.full(channels, np.inf) for _ in scales)])
    found = descend(
        residual,
        jacobian,
        np.concatenate([start.shapes, *scales]),
        (lowest, highest),
        tolerance=tolerance,
        most=MOST_STEPS,
    )
    shapes, kd, ks = unpack(found.x)
    return Solution(shapes, kd, ks, found.cost)


def _evaluate(problem: Problem, shapes: Array, kd: Array, ks: Array) -> Array:
    visible = problem.geometry.visible[:, None]
    return np.where(visible, kd / np.pi, 0.0) + ks * problem.lobe(shapes)[0]
