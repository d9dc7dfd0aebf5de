"""A fit that gross errors do not move: residuals far beyond the scatter count for nothing.

Least squares follows one glint, one finger mark, one frame with the lamp off. The robust fit reweighs the
data and fits again until nothing changes (iteratively reweighted least squares, Holland & Welsch 1977): first
with weights that fall as 1/|residual| (Huber 1964), for a scatter that gross errors do not widen (from the
median absolute residual), then with Tukey's biweight (Beaton & Tukey 1974), which gives a datum beyond 4.7
scatters no say at all: the two steps of Yohai's MM estimate (1987). On clean data it costs 5 % of the
information.

The scatter is taken among data of like brightness (Carroll & Ruppert 1988, chapter 3): a lobe is noisier than
the rest, or met less well by the model, and is no gross error for that. The whole begins twice, from the loss
and from one that large values rule less, and the better end is taken: where gross errors decide the first
fit, the weights would never let the lobe in again. Where samples state no uncertainty, the scatter at the end
is a law of the brightness (see `analysis.noise`): groups are too coarse for the top of a narrow lobe.

The covariance takes the final weights as given; `beyond_given_weights` is what that leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.noise import noise_variance
from analysis.solver import minimise

if TYPE_CHECKING:
    from collections.abc import Callable

    from analysis.losses import Loss
    from analysis.problem import Problem
    from analysis.solver import Solution

Array = NDArray[np.float64]

BIWEIGHT = 4.685
"""Residual, in scatters, from which on a datum counts for nothing (95 % efficient for normal errors)."""
NORMAL = 1.4826
"""Standard deviation of normal residuals over their median absolute value."""
MOST_ROUNDS = 40
SETTLED = 1e-3
"""Largest change of a weight at which a search has ended."""
EXACT = 1e-7
"""Least scatter, as a share of the data's own size in the loss's measure."""
ALIKE, MOST_GROUPS = 60, 12
"""Fewest data of like brightness whose scatter is taken, and the largest number of such groups."""


@dataclass(frozen=True, eq=False)
class RobustFit:
    """A robust fit of channels that share their shapes.

    Attributes
    ----------
    loss : Loss
        The loss with the final weights.
    solution : Solution
        Its minimum.
    scatter : ndarray, shape (N, C)
        Standard deviation of each residual, if it is no gross error.
    """

    loss: Loss
    solution: Solution
    scatter: Array


def minimise_robustly(problem: Problem, loss: Loss, calm: Loss, start: Solution | None = None) -> RobustFit:
    """Find the best parameters for the data that are no gross errors.

    Parameters
    ----------
    problem : Problem
        Directions and model.
    loss : Loss
        Data and measure, arrays (N, C).
    calm : Loss
        Of the same data, one that large values rule less.
    start : Solution, optional
        A robust solution of nearly the same problem.

    Returns
    -------
    RobustFit
    """
    if start is None:
        starts = [minimise(problem, each) for each in ((loss,) if calm.name == loss.name else (loss, calm))]
    else:
        starts = [start]
    ends = [_reweighted(problem, loss, each, _falling)[1] for each in starts]
    scatters = [_scatter(problem, loss, each) for each in ends]
    scatter = min(scatters, key=lambda each: float(np.median(each[loss.used])))
    found = [_reweighted(problem, loss, each, _biweight, scatter) for each in ends]
    weighted, solution = min(
        found, key=lambda each: _loss_of_biweight(_residual(problem, loss, each[1]) / scatter, loss.used)
    )
    if loss.name != "chi2":
        # Uncertainties tell how noise goes with brightness; without them the first scatter is a coarse one.
        scatter = _law(problem, loss, solution, loss.used, robust=True)
        weighted, solution = _reweighted(problem, loss, solution, _biweight, scatter)
        scatter = _law(problem, loss, solution, weighted.counted, robust=False)
    return RobustFit(weighted, solution, scatter)


def _reweighted(
    problem: Problem,
    loss: Loss,
    solution: Solution,
    weigh: Callable[[Array], Array],
    scatter: Array | None = None,
) -> tuple[Loss, Solution]:
    """Weigh residuals and fit again until the weights stay; without a scatter each round takes its own."""
    weights, weighted = np.ones(loss.data.shape), loss
    for _ in range(MOST_ROUNDS):
        own = _scatter(problem, loss, solution) if scatter is None else scatter
        before, weights = weights, weigh(_residual(problem, loss, solution) / own)
        weighted = loss.reweighted(weights)
        solution = minimise(problem, weighted, solution)
        if np.max(np.abs(weights - before)) < SETTLED:
            break
    return weighted, solution


def _scatter(problem: Problem, loss: Loss, solution: Solution) -> Array:
    found = scatter_of(_residual(problem, loss, solution), loss.used, _f(problem, solution))
    return _at_least(found, loss)


def _law(
    problem: Problem, loss: Loss, solution: Solution, known: NDArray[np.bool_], *, robust: bool
) -> Array:
    """Scatter as a smooth law of the brightness, which goes on to the few brightest data."""
    f = _f(problem, solution)
    found = noise_variance(np.square(loss.residual(f)), f, loss.slope(f), known, robust=robust)
    return _at_least(np.sqrt(found), loss)


def _at_least(scatter: Array, loss: Loss) -> Array:
    size = np.abs(loss.residual(np.zeros_like(loss.data)))
    return np.maximum(scatter, EXACT * float(np.median(size[loss.used])) + np.finfo(float).tiny)


def scatter_of(residual: Array, used: NDArray[np.bool_], brightness: Array) -> Array:
    """Estimate the standard deviation of residuals by the median size among data of like brightness.

    Parameters
    ----------
    residual : ndarray, shape (N, C)
        Residuals.
    used : ndarray of bool, shape (N, C)
        Which data count.
    brightness : ndarray, shape (N, C)
        By which data are grouped, each channel alone.

    Returns
    -------
    ndarray, shape (N, C)
        Along the brightness, between the groups, it is interpolated.
    """
    scatter, size = np.empty_like(residual), np.abs(residual)
    for c in range(residual.shape[1]):
        kept = np.flatnonzero(used[:, c])
        order = kept[np.argsort(brightness[kept, c], kind="stable")]
        groups = np.array_split(order, max(1, min(MOST_GROUPS, len(order) // ALIKE)))
        levels = [float(np.median(brightness[group, c])) for group in groups]
        medians = [float(np.median(size[group, c])) for group in groups]
        scatter[:, c] = NORMAL * np.interp(brightness[:, c], levels, medians)
    return scatter


@cache
def beyond_given_weights() -> float:
    """Return u of a fit with Tukey's biweight over u with its weights w taken as given, for normal errors.

    They follow the residuals r: the variance is E[psi^2] / E[psi']^2 (Huber 1981, eq. 7.6.1) with psi = w r,
    and not E[w^2] / E[w]^2.
    """
    r = np.linspace(-BIWEIGHT, BIWEIGHT, 4001)
    normal = np.exp(-0.5 * np.square(r))
    within = 1.0 - np.square(r / BIWEIGHT)
    weight, slope = np.square(within), within * (5.0 * within - 4.0)
    follows = np.sum(normal * np.square(weight * r)) / np.square(np.sum(normal * slope))
    given = np.sum(normal * np.square(weight)) / np.square(np.sum(normal * weight))
    return float(np.sqrt(follows / given))


def _f(problem: Problem, solution: Solution) -> Array:
    return np.asarray(problem.terms(solution.shapes[None]).values(solution.kd[None], solution.ks[None])[0].T)


def _residual(problem: Problem, loss: Loss, solution: Solution) -> Array:
    return loss.residual(_f(problem, solution))


def _falling(residual: Array) -> Array:
    """Weights of Huber's loss: 1 within the scatter, then as 1/|residual|."""
    return np.asarray(1.0 / np.maximum(np.abs(residual), 1.0))


def _biweight(residual: Array) -> Array:
    return np.square(np.maximum(1.0 - np.square(residual / BIWEIGHT), 0.0))


def _loss_of_biweight(residual: Array, used: NDArray[np.bool_]) -> float:
    """Sum up what Tukey's biweight makes small: at most 1 for a datum."""
    within = np.maximum(1.0 - np.square(residual[used] / BIWEIGHT), 0.0)
    return float(np.sum(1.0 - within**3))
