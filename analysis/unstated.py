"""The covariance of a fit to samples that do not state their uncertainty: the residuals tell it.

The size of each datum's error follows from a law of its brightness, which all residuals determine together:
see `analysis.noise`. Where the residuals that decide a parameter contradict the law, their own sizes widen
its uncertainty: HC2 of MacKinnon & White (1985), r^2 / (1 - h) with h the leverage, on the degrees of freedom
that so few data have (Satterthwaite 1946). Least squares of a curved measure of f, a logarithm or a cube
root, is off by as much as the noise bends it; this, too, is part of the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.noise import noise_variance
from analysis.robust import beyond_given_weights

if TYPE_CHECKING:
    from analysis.covariance import NormalEquations
    from analysis.losses import Loss

Array = NDArray[np.float64]

LEAST_FREE = 1e-3
"""Share of a datum's error that its residual must keep to say how large that error is."""
RARE = 3.09
"""Normal quantile of the chance, 0.1 %, with which a true law is contradicted."""


@dataclass(frozen=True)
class Unstated:
    """What residuals tell.

    Attributes
    ----------
    own : ndarray, shape (N, C)
        Standard uncertainty of each datum, in 1/sr.
    covariance : ndarray, shape (P, P)
        Of the search coordinates.
    freedom : ndarray, shape (P,)
        Degrees of freedom of their uncertainty (JCGM 100:2008, annex G).
    """

    own: Array
    covariance: Array
    freedom: Array


def from_residuals(normal: NormalEquations, loss: Loss, f: Array, scatter: Array | None = None) -> Unstated:
    """Estimate uncertainties from residuals.

    Parameters
    ----------
    normal : NormalEquations
        Of the fit.
    loss : Loss
        Its loss, arrays (N, C).
    f : ndarray, shape (N, C)
        The model, in 1/sr.
    scatter : ndarray, shape (N, C), optional
        Standard deviation of each residual, where a robust fit knows it.

    Returns
    -------
    Unstated
    """
    plain = loss.reweighted(None)
    per_unit = plain.weight()
    per_unit = np.divide(1.0, per_unit, out=np.zeros_like(per_unit), where=per_unit > 0.0)
    coordinates = normal.influence.shape[-1]
    spare = float(int(loss.counted.sum()) - coordinates)
    if spare < 1.0:
        # As many data as coordinates are met whatever they are, and say nothing of their errors.
        unknown = normal.among_all(np.full(coordinates, np.inf), np.inf)
        return Unstated(np.zeros_like(f), np.diag(unknown), np.full(len(unknown), 1.0))
    if scatter is not None:
        u = scatter * per_unit
        moves = beyond_given_weights() * u.reshape(-1, 1) * normal.influence
        return Unstated(u, normal.propagated(moves), normal.among_all(np.full(coordinates, spare), np.inf))
    left = 1.0 - normal.leverages()
    known = loss.used & (left > LEAST_FREE)
    # A channel that is met throughout tells its noise as well as it can.
    known = np.where(known.any(axis=0), known, loss.used)
    square = np.square(plain.residual(f)) / np.where(known, np.maximum(left, LEAST_FREE), 1.0)
    variance = noise_variance(square, f, plain.slope(f), known)
    u = np.sqrt(variance) * per_unit
    moves = u.reshape(-1, 1) * normal.influence
    # What a datum's own size is to that of the law.
    larger = np.divide(square, variance, out=np.ones_like(square), where=known & (variance > 0.0))
    wider, freedom = _contradicted(moves, larger.ravel(), spare)
    stretch = normal.among_all(wider, 1.0)
    covariance = normal.propagated(moves) * np.outer(stretch, stretch)
    return Unstated(u, covariance, normal.among_all(freedom, np.inf))


def _contradicted(moves: Array, larger: Array, spare: float) -> tuple[Array, Array]:
    """Compare the variances of coordinates under a law with those under each datum's own size.

    Parameters
    ----------
    moves : ndarray, shape (N, P)
        How far each datum moves each coordinate, with the size of error that the law gives it.
    larger : ndarray, shape (N,)
        The datum's own variance over the law's.
    spare : float
        Degrees of freedom of the law.

    Returns
    -------
    ndarray, shape (P,)
        Factor by which the law's uncertainty is widened: 1 where chance explains the difference.
    ndarray, shape (P,)
        Degrees of freedom of the uncertainty.
    """
    square = np.square(moves)
    by_law, by_own = np.ones(len(square)) @ square, larger @ square
    few = np.square(by_law) / np.maximum(np.einsum("np,np->p", square, square), np.finfo(float).tiny)
    # The quantile of chi-square over its degrees of freedom (Wilson & Hilferty 1931).
    step = 2.0 / (9.0 * np.maximum(few, 1.0))
    limit = (1.0 - step + RARE * np.sqrt(step)) ** 3
    contradicted = by_own > limit * by_law
    ratio = by_own / np.where(by_law > 0.0, by_law, 1.0)
    return np.sqrt(np.where(contradicted, ratio, 1.0)), np.where(contradicted, few, spare)


def bend(loss: Loss, f: Array, u: Array) -> Array:
    """Return the error of f that noise amounts to in the mean, to second order: 0 for a loss linear in f.

    Parameters
    ----------
    loss : Loss
        The loss, arrays (N, C).
    f, u : ndarray, shape (N, C)
        The model and the standard uncertainty of the data, in 1/sr.

    Returns
    -------
    ndarray, shape (N, C)
        In 1/sr.
    """
    if loss.linear:
        return np.zeros_like(f)
    # Where noise is as large as f no second order holds, and no measure is off by more than half the noise.
    step = np.maximum(np.minimum(u, 0.5 * np.abs(f)), np.finfo(float).tiny)
    weight = loss.weight()
    mean = 0.25 * np.square(u) * (loss.slope(f + step) - loss.slope(f - step)) / step
    mean = np.divide(mean, weight, out=np.zeros_like(f), where=weight > 0.0)
    return np.asarray(np.clip(mean, -0.5 * u, 0.5 * u))
