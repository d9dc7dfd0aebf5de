"""Whether an instrument's discs matter to a fit, where they do, and the fit with them.

The test is cheap: over a small disc of radius a the mean of f exceeds its centre by a^2/8 times its
Laplacian, and rings of four nodes on each disc measure that second moment without forming it. What a mean
changes is judged in residuals: leaving out changes whose squares sum to d^2 moves no parameter by more than
d of its own standard uncertainty, because the move is a projection of them.

Three answers, cheapest first: nothing to do; a lobe that is wide beside the discs is raised by its second
moment, found anew after each fit until it stays; a narrow one is averaged inside the fit.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.identifiability import half_width
from analysis.instrument import Gain, Instrument, Spread
from analysis.models.base import Coordinate
from analysis.solver import follow

if TYPE_CHECKING:
    from analysis.losses import Loss
    from analysis.models.base import Model
    from analysis.problem import Problem
    from analysis.solver import Solution

Array = NDArray[np.float64]

TOLERATED = 0.1
"""How far, in its standard uncertainty, a parameter may move by what is left out, and again by the rule."""
FINEST = 3
"""Highest order of the rule."""
ROUNDS = 4
"""Times that a narrower lobe may ask for more samples, or for a finer rule."""
MILD = 0.03
"""A lobe is wide where the discs change it by less than this share, in the mean square over its residuals."""
NARROWER = (0.5, 0.25)
"""Widths, as shares of that of the lobe as it is seen, from which the lobe itself is searched."""


def resolve(
    problem: Problem, loss: Loss, solution: Solution, instrument: Instrument, scatter: Array | float
) -> tuple[Problem, Solution]:
    """Take the mean over an instrument's discs where that matters, and fit again.

    Parameters
    ----------
    problem : Problem
        Directions and model, perhaps with a spread already.
    loss : Loss
        Data and measure, arrays (N, C).
    solution : Solution
        Its fit.
    instrument : Instrument
        The discs.
    scatter : ndarray, shape (N, C), or float
        Standard deviation of the residuals.

    Returns
    -------
    tuple of Problem and Solution
        The same where the lobe is wide beside the discs.
    """
    if not problem.has_lobe:
        return problem, solution
    if not isinstance(problem.spread, Spread):
        raised = _raised(problem, loss, solution, instrument, scatter)
        if raised is not None:
            return raised
        problem = replace(problem, spread=None)
    return _averaged(problem, loss, solution, instrument, scatter)


def _raised(
    problem: Problem, loss: Loss, solution: Solution, instrument: Instrument, scatter: Array | float
) -> tuple[Problem, Solution] | None:
    """Fit a wide lobe with its gain by the discs; None where it is not wide, or the gain does not settle."""
    for _ in range(ROUNDS):
        gain = Gain.of(_model(problem, solution), problem.geometry, instrument)
        now, point, raised, beyond = (
            _residual(replace(problem, spread=spread), loss, solution) / scatter
            for spread in (problem.spread, None, gain, gain.beyond)
        )
        dull = replace(solution, ks=np.zeros_like(solution.ks))
        lobe = point - _residual(replace(problem, spread=None), loss, dull) / scatter
        if _squares(raised - point) > MILD**2 * _squares(lobe) or _squares(beyond - raised) > TOLERATED**2:
            return None
        if _squares(raised - now) <= TOLERATED**2:
            return problem, solution
        problem = replace(problem, spread=gain)
        solution = follow(problem, loss, solution.shapes[None])[0]
    return None


def _averaged(
    problem: Problem, loss: Loss, solution: Solution, instrument: Instrument, scatter: Array | float
) -> tuple[Problem, Solution]:
    """Fit with the mean over both discs at every sample that needs it."""
    for _ in range(ROUNDS):
        finer = _finer(problem, loss, solution, instrument, scatter)
        if finer is problem:
            break
        problem = finer
        solution = follow(problem, loss, _starts(problem, solution))[0]
    return problem, solution


def _finer(
    problem: Problem, loss: Loss, solution: Solution, instrument: Instrument, scatter: Array | float
) -> Problem:
    """Return the problem with every sample that needs it averaged well enough; itself where that is so."""
    spread = problem.spread if isinstance(problem.spread, Spread) else None
    rows = np.zeros(len(problem.geometry.wi), dtype=bool) if spread is None else spread.rows
    first = 1 if spread is None else spread.order
    change = second_moment(problem, loss, solution, instrument) / scatter
    squares = np.where(rows, 0.0, np.einsum("nc,nc->n", change, change))
    order = np.argsort(squares)
    more = np.zeros_like(rows)
    more[order] = np.cumsum(squares[order]) > TOLERATED**2
    wanted = rows | more
    if not wanted.any():
        return problem
    geometry = problem.geometry
    spread = Spread(instrument, geometry.wi, geometry.wo, wanted, first)
    coarse = _residual(replace(problem, spread=spread), loss, solution)
    while spread.order < FINEST:
        finer = replace(spread, order=spread.order + 1)
        fine = _residual(replace(problem, spread=finer), loss, solution)
        if np.sum(np.square((fine - coarse) / scatter)) <= TOLERATED**2:
            break
        spread, coarse = finer, fine
    if problem.spread is not None and not more.any() and spread.order == first:
        return problem
    return replace(problem, spread=spread)


def second_moment(problem: Problem, loss: Loss, solution: Solution, instrument: Instrument) -> Array:
    """Return what the discs change in the residuals (N, C), to the second order in their radii.

    The changes by each disc alone are added: to that order they do not know of one another.
    """
    geometry, every = problem.geometry, np.ones(len(problem.geometry.wi), dtype=bool)
    centre = _residual(replace(problem, spread=None), loss, solution)
    change = np.zeros_like(centre)
    for alone in (replace(instrument, source_rad=0.0), replace(instrument, receiver_rad=0.0)):
        spread = Spread(alone, geometry.wi, geometry.wo, every, 1)
        change += _residual(replace(problem, spread=spread), loss, solution) - centre
    return change


def _residual(problem: Problem, loss: Loss, solution: Solution) -> Array:
    terms = problem.terms(solution.shapes[None])
    return loss.residual(terms.values(solution.kd[None], solution.ks[None])[0].T)


def _model(problem: Problem, solution: Solution) -> Model:
    return problem.model(**problem.natural(solution.shapes[None]))


def _squares(residual: Array) -> float:
    return float(np.einsum("nc,nc->", residual, residual))


def _starts(problem: Problem, solution: Solution) -> Array:
    """Shapes of the fit so far, and lobes that are narrower in all their widths together."""
    narrowing = np.zeros(len(solution.shapes))
    width = half_width(problem, solution.shapes)
    low, high = problem.bounds()
    for i, parameter in enumerate(problem.shapes):
        if parameter.coordinate is not Coordinate.LOG:
            continue
        step = np.zeros_like(narrowing)
        step[i] = np.log(2.0)
        less, more = (half_width(problem, np.clip(solution.shapes + s * step, low, high)) for s in (-1, 1))
        if less < width and less < more:
            narrowing[i] = -1.0
        elif more < width:
            narrowing[i] = 2.0  # exponents go as the inverse square of a width
    starts = [solution.shapes, *(solution.shapes - narrowing * np.log(share) for share in NARROWER)]
    return np.asarray(np.clip(np.array(starts), low, high))
