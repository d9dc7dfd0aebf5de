"""The search: shapes are tried and refined, on few samples first; scales are solved for.

Where samples are many, a subset of them, even along the half vector's angle, tells the basins apart and
brings every start to within a small step of the bottom; only the last steps take all samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis import starts
from analysis.descent import descend
from analysis.equations import Linearised, solve_scales
from analysis.slopes import mean_slope

if TYPE_CHECKING:
    from analysis.losses import Loss
    from analysis.problem import Problem, Terms

Array = NDArray[np.float64]

SCANNED, FEW = 200, 800
"""Samples that a grid's scan, and the search from its best points, make do with."""
SPARSE = 2000
"""Fewer samples than this may be a coarse grid, where each matters: all are scanned.

Models of more shapes than a grid scans have basins that few samples decide, such as a narrow second lobe:
their first steps take `FEW` samples, and their basins are followed on so many."""
AT_ONCE = 128
"""Points evaluated together: their arrays then stay in the cache."""
ALONE = 4000
"""Samples from which on starts are followed one by one: the arrays of two no longer stay there."""
FIRST_STEPS = 12
"""Steps from each point that is tried, before most are dropped."""
REWEIGHTED = 3
"""Times that the scan solves for scales under a loss that is not linear in f."""
RIVAL = 1.5
"""Cost on few samples, as a multiple of the best, up to which a minimum may be the best on all."""
NEARLY = 1.05
"""The same for minima along a line: they lie close, and few samples hardly tell which is the deeper."""
TOLERANCE = 1e-10
FEW_TOLERANCE, GRID_TOLERANCE, ROUGH_TOLERANCE = 1e-2, 1e-4, 1e-5
"""For basins of a grid on few samples, and for telling minima apart: those of a grid lie further from one
another than those of more shapes."""
MOST_STEPS = 300
APART = 1e-2
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
    candidates = _candidates(problem, loss)
    rivals = [each for each in candidates if each.cost <= RIVAL * candidates[0].cost]
    if len(rivals) > 1:
        rivals = _refine(whole, rivals, _rough(problem))
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
    begin = [Solution(shapes[i], kd[i], ks[i], np.inf) for i in range(len(shapes))]
    return _refine(whole, begin, TOLERANCE)


def thinned(problem: Problem, loss: Loss, count: int) -> tuple[Problem, Loss]:
    """Take about `count` samples, every n-th by the half vector's angle to the normal.

    Parameters
    ----------
    problem, loss : Problem, Loss
        As in `minimise`.
    count : int
        How many; all where there are not twice as many.

    Returns
    -------
    tuple of Problem and Loss
        The loss with channels first.
    """
    every = len(problem.geometry.wi) // count
    if every < 2:
        return problem, loss.by_channel()
    rows = np.argsort(problem.geometry.tan2_h[:, 0], kind="stable")[every // 2 :: every]
    return problem.some(rows), loss.by_channel(rows)


def _some(problem: Problem, loss: Loss, count: int) -> Linearised:
    return Linearised(*thinned(problem, loss, count))


def _candidates(problem: Problem, loss: Loss) -> list[Solution]:
    """Return a point near the bottom of each basin that may be the deepest."""
    widths = any(parameter.of_slope is not None for parameter in problem.shapes)
    slope = mean_slope(problem.geometry, loss.data, loss.used) if widths else None
    count = len(problem.geometry.wi)
    if len(problem.shapes) <= starts.GRID_SHAPES:
        grid = starts.grid(problem, slope)
        tried = _evaluate(_some(problem, loss, SPARSE if count <= SPARSE else SCANNED), grid.points)
        chosen = [tried[i] for i in grid.basins(np.array([each.cost for each in tried]))]
        few = _some(problem, loss, FEW)
        found = _refine(few, chosen, FEW_TOLERANCE)
        found = _distinct(problem, sorted([*found, *_across(few, found[0])], key=lambda each: each.cost))
        return _distinct(problem, _refine(few, found, GRID_TOLERANCE)) if len(found) > 1 else found
    scanned = _some(problem, loss, FEW)
    tried = _apart(problem, _evaluate(scanned, starts.spread(problem, slope)), starts.TRIED)
    tried = _refine(scanned, tried, ROUGH_TOLERANCE, most=FIRST_STEPS)
    chosen = _apart(problem, tried, starts.KEPT * len(problem.shapes))
    return _distinct(problem, _refine(_some(problem, loss, SPARSE), chosen, ROUGH_TOLERANCE))


def _across(equations: Linearised, best: Solution) -> list[Solution]:
    """Return deeper minima that lie across a ridge from the best, along another shape than the width.

    A scan does not see such a pair before the width is right: a narrow lobe of ior 3.6, or of 100.
    """
    problem = equations.problem
    if len(problem.shapes) < 2:
        return []
    beyond: list[Solution] = []
    for points, own in starts.lines(problem, best.shapes):
        line = evaluate_near(equations, points, best)
        line[own] = best
        cost = np.array([np.inf, *(each.cost for each in line), np.inf])
        lowest = np.flatnonzero((cost[1:-1] < cost[:-2]) & (cost[1:-1] < cost[2:]))
        beyond += [line[i] for i in lowest if i != own and line[i].cost <= RIVAL * best.cost]
    beyond = _distinct(problem, beyond)
    found = _refine(equations, beyond, FEW_TOLERANCE) if beyond else []
    return [each for each in found if each.cost <= NEARLY * best.cost]


def _evaluate(equations: Linearised, points: Array) -> list[Solution]:
    """Solve for the scales at points (M, S) of the search, for a loss that is not linear in f nearly."""
    loss, found = equations.loss, []
    for shapes in np.array_split(points, -(-len(points) // AT_ONCE)):
        terms = equations.problem.terms(shapes)
        kd, ks = equations.linear_scales(terms)
        for _ in range(0 if loss.linear else REWEIGHTED):
            kd, ks = solve_scales(loss.secant(terms.values(kd, ks)), loss.data, terms.pair())
        found += _solutions(equations, shapes, terms, kd, ks)
    return found


def evaluate_near(equations: Linearised, points: Array, near: Solution) -> list[Solution]:
    """Solve for the scales by Newton's steps, from lobes of the size that one nearby has.

    They end at the minimum, which secants miss by some per cent of the cost, but lead there only from nearby.

    Parameters
    ----------
    equations : Linearised
        The problem.
    points : ndarray, shape (M, S)
        Shapes in search coordinates.
    near : Solution
        One of the same problem, not far from any point.

    Returns
    -------
    list of Solution
        One for each point.
    """
    loss, terms = equations.loss, equations.problem.terms(points)
    size = equations.size(equations.problem.terms(near.shapes[None]).lobe)
    kd, ks = np.tile(near.kd, (len(points), 1)), near.ks * size / equations.size(terms.lobe)
    for _ in range(1 if loss.linear else REWEIGHTED):
        f = terms.values(kd, ks)
        slope = loss.slope(f)
        wanted = f - loss.residual(f) / np.where(slope > 0.0, slope, 1.0)
        kd, ks = solve_scales(slope, wanted, terms.pair())
    return _solutions(equations, points, terms, kd, ks)


def _solutions(equations: Linearised, shapes: Array, terms: Terms, kd: Array, ks: Array) -> list[Solution]:
    residual = equations.loss.residual(terms.values(kd, ks))
    cost = 0.5 * np.einsum("mcn,mcn->m", residual, residual)
    return [Solution(shapes[i], kd[i], ks[i], float(cost[i])) for i in range(len(shapes))]


def _rough(problem: Problem) -> float:
    return GRID_TOLERANCE if len(problem.shapes) <= starts.GRID_SHAPES else ROUGH_TOLERANCE


def _apart(problem: Problem, solutions: list[Solution], most: int) -> list[Solution]:
    points = np.array([each.shapes for each in solutions])
    cost = np.array([each.cost for each in solutions])
    return [solutions[i] for i in starts.apart(problem, points, cost, most)]


def _refine(
    equations: Linearised, begin: list[Solution], tolerance: float, most: int = MOST_STEPS
) -> list[Solution]:
    """Follow starts to the bottom, or for some steps; best first."""
    each = 1 if len(equations.problem.geometry.wi) > ALONE else len(begin)
    ends = [
        end
        for first in range(0, len(begin), each)
        for end in _descended(equations, begin[first : first + each], tolerance, most)
    ]
    return sorted(ends, key=lambda solution: solution.cost)


def _descended(equations: Linearised, begin: list[Solution], tolerance: float, most: int) -> list[Solution]:
    """Follow starts together, one end for each."""
    problem, loss = equations.problem, equations.loss
    shapes, low, high = np.array([s.shapes for s in begin]), *problem.bounds()
    if loss.linear:
        if shapes.size:
            found = descend(equations.shapes_alone, shapes, (low, high), tolerance=tolerance, most=most)
            shapes = found.x
        terms = problem.terms(shapes)
        kd, ks = equations.linear_scales(terms)
        return _solutions(equations, shapes, terms, kd, ks)
    kd, ks = np.array([s.kd for s in begin]), np.array([s.ks for s in begin])
    size = equations.size(problem.terms(shapes).lobe)
    bottom, top = np.zeros(2 * problem.channels), np.full(2 * problem.channels, np.inf)
    x, cost = descend(
        equations.all_parameters,
        np.hstack([shapes, kd, ks * size]),
        (np.concatenate([low, bottom]), np.concatenate([high, top])),
        tolerance=tolerance,
        most=most,
    )
    shapes, kd, s = equations.unpack(x)
    ks = s / equations.size(problem.terms(shapes).lobe)
    return [Solution(shapes[i], kd[i], ks[i], float(cost[i])) for i in range(len(cost))]


def _distinct(problem: Problem, solutions: list[Solution]) -> list[Solution]:
    """Keep one of each minimum; without a lobe, whose shapes do nothing, only where there is no other."""
    if problem.has_lobe and problem.model.LAMBERT_TERM:
        solutions = [each for each in solutions if each.ks.any()] or solutions[:1]
    kept: list[Solution] = []
    for solution in solutions:
        if all(np.max(np.abs(solution.shapes - other.shapes), initial=0.0) > APART for other in kept):
            kept.append(solution)
    return kept
