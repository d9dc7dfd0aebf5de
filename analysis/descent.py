"""Bounded nonlinear least squares in few parameters and many residuals.

Levenberg-Marquardt (Marquardt 1963; damping as Nielsen 1999) on the normal equations, with parameters on a
bound taken out of the step while the gradient holds them there (Bertsekas 1982). The usual libraries factor
the whole Jacobian at every step, thousands of rows for a handful of columns, and keep strictly inside the
bounds; here a step costs one product of the Jacobian with itself, and a scale that is zero becomes exactly
zero. Normal equations square the condition number, which is harmless for the well-scaled coordinates of
`analysis.solver`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Callable

Array = NDArray[np.float64]

FIRST_DAMPING = 1e-3
LARGEST_DAMPING = 1e12


class Minimum(NamedTuple):
    """Where the search ended: parameters (P,) and half the sum of squares."""

    x: Array
    cost: float


def descend(
    residual: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    start: Array,
    bounds: tuple[Array, Array],
    *,
    tolerance: float,
    most: int,
) -> Minimum:
    """Minimise half a sum of squares within bounds.

    Parameters
    ----------
    residual : callable
        Parameters (P,) to residuals (R,).
    jacobian : callable
        Parameters (P,) to the residuals' derivatives (R, P).
    start : ndarray, shape (P,)
        Where to begin; brought within the bounds.
    bounds : tuple of ndarray, shape (P,)
        Lowest and highest values.
    tolerance : float
        Ends when a step promises to lower the cost by less than this share of it.
    most : int
        Largest number of steps tried.

    Returns
    -------
    Minimum
    """
    low, high = bounds
    x = np.clip(start, low, high)
    r = residual(x)
    cost, damping, growth = 0.5 * float(r @ r), FIRST_DAMPING, 2.0
    slopes = jacobian(x)
    normal, gradient = slopes.T @ slopes, slopes.T @ r
    scale = np.diag(normal).copy()
    for _ in range(most):
        step = _step(x, normal, gradient, damping=damping * np.where(scale > 0.0, scale, 1.0), bounds=bounds)
        promised = -float(gradient @ step + 0.5 * step @ normal @ step)
        if not promised > tolerance * cost or damping > LARGEST_DAMPING:
            break
        trial = residual(x + step)
        gained = cost - 0.5 * float(trial @ trial)
        if not gained > 0.0:
            damping, growth = damping * growth, 2.0 * growth
            continue
        x, r, cost = x + step, trial, cost - gained
        slopes = jacobian(x)
        normal, gradient = slopes.T @ slopes, slopes.T @ r
        scale = np.maximum(scale, np.diag(normal))
        damping, growth = damping * max(1.0 / 3.0, 1.0 - (2.0 * gained / promised - 1.0) ** 3), 2.0
    return Minimum(x, cost)


def _step(x: Array, normal: Array, gradient: Array, *, damping: Array, bounds: tuple[Array, Array]) -> Array:
    """Damped step of the free parameters; those that meet a bound stop there, and the others step anew."""
    low, high = bounds
    step = np.zeros_like(x)
    held = ((x <= low) & (gradient > 0.0)) | ((x >= high) & (gradient < 0.0))
    for _ in range(len(x)):
        free = ~held
        if not free.any():
            break
        matrix = normal[np.ix_(free, free)] + np.diag(damping[free])
        rest = gradient[free] + normal[np.ix_(free, held)] @ step[held]
        step[free] = -np.linalg.solve(matrix, rest)
        target = x + step
        beyond = free & ((target < low) | (target > high))
        if not beyond.any():
            break
        step[beyond] = np.clip(target[beyond], low[beyond], high[beyond]) - x[beyond]
        held |= beyond
    return np.asarray(np.clip(x + step, low, high) - x)
