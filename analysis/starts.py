"""Where a search begins: all combinations of scan values, or points spread evenly over the box of the shapes.

One or two shapes are scanned on a grid, and its local minima are the basins. For more shapes a grid is too
coarse in each to tell basins apart and most of it is of no use; a Kronecker sequence fills the box evenly at
any number of points (Niederreiter 1992, chapter 1; here with the powers of the root of x^(d+1) = x + 1, the
golden section's kin), and a few steps from many points tell which of them lead somewhere.

Both also try the width that `analysis.slopes` reads from the data.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from analysis.models.base import Parameter
    from analysis.problem import Problem

Array = NDArray[np.float64]

GRID_SHAPES = 2
"""Shapes that a grid scans."""
BASINS = 5
"""Local minima of a grid that are followed to their bottom."""
POINTS, KEPT = 64, 3
"""Points spread, and basins followed to their bottom, for each shape of a model that no grid scans."""
TRIED = 64
"""Points spread from which a few steps are made."""
EVERY = 4
"""One of so many points begins at the width read from the data."""
APART = 0.05
"""Distance, as a share of the box, from which on two points may lie in two basins."""
ALIKE = 1e-4
"""Relative difference of costs below which they lie in one, apart along a shape that does nothing there."""
PLAIN = 1e-9
"""Relative difference of costs below which points of a grid lie on one plain."""
SAME = 1e-2
"""Distance in search coordinates below which a width read from the data is one of the scan's."""


@dataclass(frozen=True)
class Grid:
    """All combinations of values along each shape.

    Attributes
    ----------
    points : ndarray, shape (M, S)
        In search coordinates.
    sizes : tuple of int
        Number of values along each shape.
    """

    points: Array
    sizes: tuple[int, ...]

    def basins(self, cost: Array) -> list[int]:
        """Return the local minima among neighbours, best first, at most `BASINS`; cost (M,)."""
        grid = cost.reshape(self.sizes)
        lowest = [
            flat
            for flat, index in enumerate(np.ndindex(grid.shape))
            if grid[index] <= grid[tuple(slice(max(i - 1, 0), i + 2) for i in index)].min()
        ]
        kept: list[int] = []
        for flat in sorted(lowest, key=lambda flat: float(cost[flat])):
            # Where no lobe helps, its shapes do nothing: all of that plain is one basin.
            if not kept or cost[flat] - cost[kept[-1]] > PLAIN * cost[flat]:
                kept.append(flat)
        return kept[:BASINS]


def grid(problem: Problem, slope: float | None) -> Grid:
    """Combine the scan values of all shapes.

    Parameters
    ----------
    problem : Problem
        For its shapes.
    slope : float or None
        Mean slope of the facets, if known: the width that has it joins its scan values.

    Returns
    -------
    Grid
    """
    axes = [_axis(parameter, slope) for parameter in problem.shapes]
    return Grid(np.array(list(itertools.product(*axes))), tuple(len(axis) for axis in axes))


def lines(problem: Problem, shapes: Array) -> list[tuple[Array, int]]:
    """Return the lines along each shape but the width through a point: its scan values and bounds.

    Parameters
    ----------
    problem : Problem
        For its S shapes and their bounds.
    shapes : ndarray, shape (S,)
        The point, in search coordinates.

    Returns
    -------
    list of (ndarray of shape (M, S), int)
        For each such shape the points in order, and which of them is the given one.
    """
    found = []
    for i, (parameter, low, high) in enumerate(zip(problem.shapes, *problem.bounds(), strict=True)):
        if parameter.of_slope is not None:
            continue
        values = np.unique(np.clip([low, *_axis(parameter, None), high, shapes[i]], low, high))
        points = np.tile(shapes, (len(values), 1))
        points[:, i] = values
        found.append((points, int(np.searchsorted(values, shapes[i]))))
    return found


def _axis(parameter: Parameter, slope: float | None) -> list[float]:
    values = [parameter.coordinate.forward(value) for value in parameter.scan]
    width = _width(parameter, slope)
    if width is not None and all(abs(width - value) > SAME for value in values):
        values.append(width)
    return sorted(values)


def _width(parameter: Parameter, slope: float | None) -> float | None:
    """Search coordinate of a width at a mean slope, within its bounds; None for what is no width."""
    if slope is None or parameter.of_slope is None:
        return None
    return parameter.coordinate.forward(float(np.clip(parameter.of_slope(slope), *parameter.bounds)))


def spread(problem: Problem, slope: float | None) -> Array:
    """Spread points over the box of the shapes, along each as densely as its scan values lie.

    Parameters
    ----------
    problem : Problem
        For its S shapes and their bounds.
    slope : float or None
        Mean slope of the facets, if known: one point of `EVERY` has the widths that have it.

    Returns
    -------
    ndarray, shape (POINTS S, S)
        In search coordinates.
    """
    low, high = problem.bounds()
    points = _kronecker(POINTS * len(low), len(low))
    for i, parameter in enumerate(problem.shapes):
        inner = [parameter.coordinate.forward(value) for value in parameter.scan]
        nodes = np.unique(np.clip([low[i], *inner, high[i]], low[i], high[i]))
        points[:, i] = np.interp(points[:, i], np.linspace(0.0, 1.0, len(nodes)), nodes)
        width = _width(parameter, slope)
        if width is not None:
            points[::EVERY, i] = width
    likely = problem.model.likely(problem.natural(points))
    columns = [
        [p.coordinate.forward(float(value)) for value in np.clip(likely[p.name], *p.bounds)]
        for p in problem.shapes
    ]
    return np.asarray(np.clip(np.array(columns).T, low, high))


def _kronecker(count: int, dimensions: int) -> Array:
    """Return points (count, dimensions) that fill the unit cube evenly."""
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1.0)
    return np.asarray((0.5 + np.arange(1.0, count + 1.0)[:, None] * steps) % 1.0)


def apart(problem: Problem, points: Array, cost: Array, most: int) -> list[int]:
    """Choose points that may lie in different basins.

    Parameters
    ----------
    problem : Problem
        For the bounds of its shapes.
    points : ndarray, shape (M, S)
        In search coordinates.
    cost : ndarray, shape (M,)
        What they cost.
    most : int
        How many to choose.

    Returns
    -------
    list of int
        Their numbers, best first; any two differ by `APART` in a shape, and by `ALIKE` in cost.
    """
    low, high = problem.bounds()
    share = (points - low) / (high - low)
    chosen: list[int] = []
    for i in np.argsort(cost, kind="stable"):
        if len(chosen) == most:
            break
        differs = [abs(cost[i] - cost[other]) > ALIKE * cost[i] for other in chosen]
        away = [np.max(np.abs(share[i] - share[other])) > APART for other in chosen]
        if all(differs) and all(away):
            chosen.append(int(i))
    return chosen
