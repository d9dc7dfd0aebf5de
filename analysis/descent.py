"""Bounded nonlinear least squares in few parameters and many residuals, for many problems at once.

Levenberg-Marquardt (Marquardt 1963; damping as Nielsen 1999) on the normal equations, with parameters on a
bound taken out of the step while the gradient holds them there (Bertsekas 1982), and with a secant estimate
of the curvature that J^T J leaves out (Dennis, Gay & Welsch 1981), without which a model that does not
describe its data zigzags for hundreds of steps. The usual libraries factor the whole Jacobian at every step,
thousands of rows for a handful of columns, and keep strictly inside the bounds; here a step costs one set of
normal equations, and a scale that is zero becomes exactly zero. Normal equations square the condition number,
which is harmless for the well-scaled coordinates of `analysis.solver`: a step need not be exact, only the
gradient must be.

Starts of one fit, or replicas of it, advance together: each keeps its own damping and ends on its own, and
all share the calls of numpy, which for small problems are most of the time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Callable

Array = NDArray[np.float64]
Members = NDArray[np.intp]

FIRST_DAMPING = 1e-3
LARGEST_DAMPING = 1e12
DEFINITE = 1e-8
"""Smallest eigenvalue, over a diagonal of ones, of a curvature that counts as positive definite."""


class Equations(NamedTuple):
    """What a sum of squares is like at M points.

    Attributes
    ----------
    cost : ndarray, shape (M,)
        Half the sum of squares.
    normal : ndarray, shape (M, P, P)
        J^T J, or another positive semidefinite model of the curvature.
    gradient : ndarray, shape (M, P)
        J^T r.
    """

    cost: Array
    normal: Array
    gradient: Array


class Minima(NamedTuple):
    """Where the searches ended: parameters (M, P) and half the sums of squares (M,)."""

    x: Array
    cost: Array


def from_residuals(
    residual: Callable[[Array], Array], jacobian: Callable[[Array], Array]
) -> Callable[[Array, Members], Equations]:
    """Make normal equations of one problem's residuals (R,) and Jacobian (R, P), functions of (P,)."""

    def linearise(x: Array, members: Members) -> Equations:
        del members
        r = [residual(point) for point in x]
        slopes = [jacobian(point) for point in x]
        return Equations(
            np.array([0.5 * float(each @ each) for each in r]),
            np.array([each.T @ each for each in slopes]),
            np.array([matrix.T @ each for matrix, each in zip(slopes, r, strict=True)]),
        )

    return linearise


def descend(
    linearise: Callable[[Array, Members], Equations],
    start: Array,
    bounds: tuple[Array, Array],
    *,
    tolerance: float,
    most: int,
) -> Minima:
    """Minimise half a sum of squares within bounds, from several starts or for several problems.

    Parameters
    ----------
    linearise : callable
        Parameters (K, P) and the numbers (K,) of the rows of `start` that they belong to, to their
        `Equations`.
    start : ndarray, shape (M, P)
        Where to begin; brought within the bounds.
    bounds : tuple of ndarray, shape (P,) or (M, P)
        Lowest and highest values; where they are equal the parameter stays.
    tolerance : float
        A search ends when a step promises to lower the cost by less than this share of it.
    most : int
        Largest number of steps tried.

    Returns
    -------
    Minima
    """
    low, high = (np.broadcast_to(side, start.shape) for side in bounds)
    x = np.clip(start, low, high)
    cost, normal, gradient = linearise(x, np.arange(len(x)))
    damping, growth = np.full(len(x), FIRST_DAMPING), np.full(len(x), 2.0)
    scale = _diagonal(normal).copy()
    extra = np.zeros_like(normal)
    going = np.arange(len(x))
    for _ in range(most):
        size = np.where(scale[going] > 0.0, scale[going], 1.0)
        matrix = _curvature(normal[going], extra[going])
        box = low[going], high[going]
        step = _steps(x[going], matrix, gradient[going], damping=damping[going, None] * size, bounds=box)
        curvature = _form(matrix, step)
        promised = -(np.einsum("mp,mp->m", gradient[going], step) + 0.5 * curvature)
        worth = (promised > tolerance * cost[going]) & (damping[going] <= LARGEST_DAMPING)
        going, step, promised = going[worth], step[worth], promised[worth]
        if not going.size:
            break
        trial = linearise(x[going] + step, going)
        gained = cost[going] - trial.cost
        better = gained > 0.0
        won, lost = going[better], going[~better]
        damping[lost] *= growth[lost]
        growth[lost] *= 2.0
        x[won] += step[better]
        before = gradient[won]
        cost[won], normal[won], gradient[won] = (part[better] for part in trial)
        scale[won] = np.maximum(scale[won], _diagonal(normal[won]))
        extra[won] = _left_out(step[better], gradient[won] - before, normal[won], extra[won])
        kept = 1.0 - (2.0 * gained[better] / promised[better] - 1.0) ** 3
        damping[won] *= np.maximum(1.0 / 3.0, kept)
        growth[won] = 2.0
    return Minima(x, cost)


def _diagonal(matrices: Array) -> Array:
    return np.asarray(np.einsum("mpp->mp", matrices))


def _form(matrices: Array, step: Array) -> Array:
    """Curvature along steps: s^T A s."""
    return np.asarray(np.einsum("mp,mpq,mq->m", step, matrices, step))


def _curvature(normal: Array, extra: Array) -> Array:
    """J^T J with what it leaves out, where the sum is positive definite; else J^T J alone."""
    whole = normal + extra
    length = np.sqrt(np.abs(_diagonal(whole)))
    length = np.where(length > 0.0, length, 1.0)
    lowest = np.linalg.eigvalsh(whole / (length[:, :, None] * length[:, None, :]))[:, 0]
    return np.where((lowest > DEFINITE)[:, None, None], whole, normal)


def _left_out(step: Array, turned: Array, normal: Array, extra: Array) -> Array:
    """Update the curvature that J^T J leaves out, from how far the gradient turned along the last step.

    Where residuals are large and the model is curved, J^T J alone may be half of the curvature or twice:
    steps then overshoot and zigzag. As in NL2SOL (Dennis, Gay & Welsch 1981, equations 3.4 to 3.9), the part
    left out is sized down to what the last step met, then made to agree with it by their symmetric update.
    """
    missing = turned - np.einsum("mpq,mq->mp", normal, step)
    known, met = _form(extra, step), np.einsum("mp,mp->m", step, missing)
    size = np.minimum(1.0, np.abs(met) / np.where(known != 0.0, np.abs(known), np.inf))
    sized = size[:, None, None] * extra
    rest = missing - np.einsum("mpq,mq->mp", sized, step)
    along = np.einsum("mp,mp->m", turned, step)
    weight = np.where(along > 0.0, 1.0 / np.where(along > 0.0, along, 1.0), 0.0)
    outer = (weight[:, None] * rest)[:, :, None] * turned[:, None, :]
    twice = np.square(weight) * np.einsum("mp,mp->m", rest, step)
    square = twice[:, None, None] * turned[:, :, None] * turned[:, None, :]
    return np.asarray(sized + outer + np.swapaxes(outer, 1, 2) - square)


def _steps(x: Array, normal: Array, gradient: Array, *, damping: Array, bounds: tuple[Array, Array]) -> Array:
    """Damped steps of the free parameters; those that meet a bound stop there, and the others step anew.

    All that lead beyond are stopped together, which takes the fewest turns. Where two parameters make up for
    one another that may lead uphill; there the first to meet its bound is stopped alone.
    """
    step = _stopped(x, normal, gradient, damping, bounds, together=True)
    uphill = np.einsum("mp,mp->m", gradient, step) + 0.5 * _form(normal, step) > 0.0
    if uphill.any():
        low, high = (side[uphill] for side in bounds)
        step[uphill] = _stopped(
            x[uphill], normal[uphill], gradient[uphill], damping[uphill], (low, high), together=False
        )
    return step


def _stopped(
    x: Array, normal: Array, gradient: Array, damping: Array, bounds: tuple[Array, Array], *, together: bool
) -> Array:
    low, high = bounds
    step = np.zeros_like(x)
    held = (low == high) | ((x <= low) & (gradient > 0.0)) | ((x >= high) & (gradient < 0.0))
    unit = np.eye(x.shape[1])
    damped = normal + damping[:, :, None] * unit
    # To a diagonal of ones: the columns may differ in size by any factor. Rounding leaves a curvature of
    # nothing on either side of zero; the damping is then all there is.
    length = np.sqrt(np.maximum(_diagonal(damped), damping))
    damped = damped / (length[:, :, None] * length[:, None, :])
    for _ in range(x.shape[1]):
        free = ~held
        matrix = np.where(free[:, :, None] & free[:, None, :], damped, unit)
        rest = gradient + np.einsum("mpq,mq->mp", normal, np.where(held, step, 0.0))
        wanted = np.where(free, -rest / length, step * length)
        step = np.linalg.solve(matrix, wanted[..., None])[..., 0] / length
        target = np.clip(x + step, low, high)
        beyond = free & (target != x + step) & (step != 0.0)
        if not beyond.any():
            break
        if not together:
            room = np.where(beyond, (target - x) / np.where(beyond, step, 1.0), np.inf)
            beyond &= room == room.min(axis=1, keepdims=True)
        step = np.where(beyond, target - x, step)
        held |= beyond
    return np.asarray(np.clip(x + step, low, high) - x)
