"""The search: shapes are scanned and refined, on few samples first; scales are solved for.

Where samples are many, a subset of them, even along the half vector's angle, tells the basins apart and
brings every start to within a small step of the bottom; only the last steps take all samples.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.descent import descend
from analysis.equations import Linearised, solve_scales

if TYPE_CHECKING:
    from analysis.losses import Loss
    from analysis.problem import Problem

Array = NDArray[np.float64]

STARTS = 5
"""Basins of the scan that are followed to their bottom."""
SCANNED, FEW = 300, 800
"""Samples that the scan, and the search from its best points, make do with."""
SPARSE = 2000
"""Fewer samples than this may be a coarse grid, where each matters: all are scanned."""
REWEIGHTED = 3
"""Times that the scan solves for scales under a loss that is not linear in f."""
RIVAL = 1.5
"""Cost on few samples, as a multiple of the best, up to which a minimum may be the best on all."""
TOLERANCE = 1e-11
ROUGH_TOLERANCE = 1e-5
MOST_STEPS = 300
APART = 1e-3
"""Distance in search coordinates from which on two minima are two."""


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


def minimise(problem: Problem, loss: Loss, start: Solution | None = None) -> Solution:
    """Find the best parameters under a loss.

    Parameters
    ----------
    problem : Problem
        Directions and model.
    loss : Loss
        Data and what to make small, arrays (N, C).
    start : Solution, optional
        A solution of nearly the same problem: it is refined and nothing else is tried.

    Returns
    -------
    Solution
    """
    whole = Linearised(problem, loss.by_channel())
    if start is not None:
        return _refine(whole, [start], TOLERANCE)[0]
    few = _some(problem, loss, FEW)
    sparse = len(problem.geometry.wi) <= SPARSE
    scanned = _some(problem, loss, SPARSE if sparse else SCANNED)
    candidates = _distinct(_refine(few, _scan(scanned), ROUGH_TOLERANCE))
    rivals = [each for each in candidates if each.cost <= RIVAL * candidates[0].cost]
    if len(rivals) > 1:
        rivals = _refine(whole, rivals, ROUGH_TOLERANCE)
    return _refine(whole, rivals[:1], TOLERANCE)[0]


def follow(problem: Problem, loss: Loss, shapes: Array) -> list[Solution]:
    """Follow given shapes to the bottom, on all samples and to the last digit.

    Parameters
    ----------
    problem, loss : Problem, Loss
        As in `minimise`.
    shapes : ndarray, shape (M, S)
        Starts in search coordinates; scales start where a linear loss puts them.

    Returns
    -------
    list of Solution
        The M minima, best first.
    """
    whole = Linearised(problem, loss.by_channel())
    kd, ks = whole.linear_scales(problem.terms(shapes))
    starts = [Solution(shapes[i], kd[i], ks[i], np.inf) for i in range(len(shapes))]
    return _refine(whole, starts, TOLERANCE)


def _some(problem: Problem, loss: Loss, count: int) -> Linearised:
    """Return the problem on about `count` samples, every n-th by the half vector's angle to the normal."""
    every = len(problem.geometry.wi) // count
    if every < 2:
        return Linearised(problem, loss.by_channel())
    rows = np.argsort(problem.geometry.tan2_h[:, 0], kind="stable")[every // 2 :: every]
    return Linearised(problem.some(rows), loss.by_channel(rows))


def _scan(equations: Linearised) -> list[Solution]:
    """Evaluate every combination of the parameters' scan values; return the local minima, best first."""
    problem, loss = equations.problem, equations.loss
    axes = [[p.coordinate.forward(value) for value in p.scan] for p in problem.shapes]
    points = np.array(list(itertools.product(*axes)))
    terms = problem.terms(points)
    kd, ks = equations.linear_scales(terms)
    for _ in range(0 if loss.linear else REWEIGHTED):
        kd, ks = solve_scales(loss.secant(terms.values(kd, ks)), loss.data, terms.pair())
    residual = loss.residual(terms.values(kd, ks))
    cost = 0.5 * np.einsum("mcn,mcn->m", residual, residual)
    grid = cost.reshape([len(axis) for axis in axes])
    lowest = [
        flat
        for flat, index in enumerate(np.ndindex(grid.shape))
        if grid[index] <= grid[tuple(slice(max(i - 1, 0), i + 2) for i in index)].min()
    ]
    best = sorted(lowest, key=lambda flat: float(cost[flat]))[:STARTS]
    return [Solution(points[i], kd[i], ks[i], float(cost[i])) for i in best]


def _refine(equations: Linearised, starts: list[Solution], tolerance: float) -> list[Solution]:
    """Follow starts to the bottom, together; best first."""
    problem, loss = equations.problem, equations.loss
    shapes, low, high = np.array([s.shapes for s in starts]), *problem.bounds()
    if loss.linear:
        if shapes.size:
            found = descend(equations.shapes_alone, shapes, (low, high), tolerance=tolerance, most=MOST_STEPS)
            shapes = found.x
        terms = problem.terms(shapes)
        kd, ks = equations.linear_scales(terms)
        residual = loss.residual(terms.values(kd, ks))
        cost = 0.5 * np.einsum("mcn,mcn->m", residual, residual)
    else:
        kd, ks = np.array([s.kd for s in starts]), np.array([s.ks for s in starts])
        size = equations.size(problem.terms(shapes).lobe)
        bottom, top = np.zeros(2 * problem.channels), np.full(2 * problem.channels, np.inf)
        x, cost = descend(
            equations.all_parameters,
            np.hstack([shapes, kd, ks * size]),
            (np.concatenate([low, bottom]), np.concatenate([high, top])),
            tolerance=tolerance,
            most=MOST_STEPS,
        )
        shapes, kd, s = equations.unpack(x)
        ks = s / equations.size(problem.terms(shapes).lobe)
    ends = [Solution(shapes[i], kd[i], ks[i], float(cost[i])) for i in range(len(cost))]
    return sorted(ends, key=lambda solution: solution.cost)


def _distinct(solutions: list[Solution]) -> list[Solution]:
    kept: list[Solution] = []
    for solution in solutions:
        if all(np.max(np.abs(solution.shapes - other.shapes), initial=0.0) > APART for other in kept):
            kept.append(solution)
    return kept
