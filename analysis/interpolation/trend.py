"""The smooth part of f_r: a product of four functions of one angle each, by robust least squares.

ln f = d(theta_h) + r(theta_d) + g(theta_i) + h(theta_o), cubic P-splines (Eilers & Marx 1996, "Flexible
smoothing with B-splines and penalties"). It has the factors of a microfacet model without its formulas, so
that it follows any surface, and only has to be near: what it misses is interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.angles import direction_to_spherical, half_difference

Array = NDArray[np.float64]

KNOTS_HALF, KNOTS_DIFFERENCE, KNOTS_GRAZING = 24, 10, 8
SMOOTHNESS = 1e-3
"""Weight of squared second differences against the mean squared residual."""
RIDGE = 1e-6
FLOOR = 1e-2
"""Values below this part of the median count as this part: a logarithm wants them positive."""
MOST_SAMPLES = 20_000
PASSES = 5
FAR = 2.0
"""Residuals, in units of their median, from which on a sample counts for little."""
LEAST_SCATTER = 0.02
"""The median is never taken as smaller: where the trend fits, no sample is to be left out for a trifle."""


@dataclass(frozen=True, eq=False)
class Trend:
    """A fitted trend.

    Attributes
    ----------
    coefficients : ndarray, shape (K, C)
        Of the splines, one column a channel.
    """

    coefficients: Array

    def __call__(self, wi: Array, wo: Array) -> Array:
        """Evaluate; always positive.

        Parameters
        ----------
        wi, wo : ndarray, shape (N, 3)
            Unit directions above the surface.

        Returns
        -------
        ndarray, shape (N, C)
            1/sr.
        """
        return np.asarray(np.exp(_design(wi, wo) @ self.coefficients))

    def profile(self, radius: Array) -> Array:
        """Return exp d along the half vector's radius sqrt(2 theta_h / pi), the mean of all channels."""
        count = KNOTS_HALF + 2
        return np.asarray(np.exp(_splines(radius, KNOTS_HALF) @ self.coefficients[:count].mean(axis=1)))


def fit_trend(wi: Array, wo: Array, f_r: Array) -> Trend:
    """Fit a trend.

    Parameters
    ----------
    wi, wo : ndarray, shape (N, 3)
        Unit directions above the surface.
    f_r : ndarray, shape (N, C)
        Finite values in 1/sr.
    """
    if len(wi) > MOST_SAMPLES:
        chosen = np.random.default_rng(0).choice(len(wi), MOST_SAMPLES, replace=False)
        wi, wo, f_r = wi[chosen], wo[chosen], f_r[chosen]
    design, size = _design(wi, wo), np.abs(f_r)
    floors = [FLOOR * np.median(column[column > 0.0]) if column.any() else 1.0 for column in size.T]
    target = np.log(np.maximum(size, floors))
    penalty = len(design) * _penalty()
    # About the mean: where samples are few, the penalty then pulls to it.
    mean = target.mean(axis=0)
    target = target - mean
    weight = np.ones(len(design))
    coefficients: Array = np.zeros((design.shape[1], f_r.shape[1]))
    for _ in range(PASSES):
        weighted = design * weight[:, None]
        coefficients = np.asarray(np.linalg.solve(design.T @ weighted + penalty, weighted.T @ target))
        residual = np.abs(target - design @ coefficients).mean(axis=1)
        typical = max(float(np.median(residual)), LEAST_SCATTER)
        # Cauchy's weights: what is floored or far off must not bend the rest.
        weight = 1.0 / (1.0 + np.square(residual / (FAR * typical)))
    # Each of the four functions' splines sum to one.
    return Trend(coefficients + mean / 4.0)


def _design(wi: Array, wo: Array) -> Array:
    """Splines of the four angles side by side, shape (N, K)."""
    quarter = 0.5 * np.pi
    theta_h, _, theta_d, _ = half_difference(wi, wo)
    theta_i, theta_o = direction_to_spherical(wi)[0], direction_to_spherical(wo)[0]
    return np.hstack(
        [
            _splines(np.sqrt(theta_h / quarter), KNOTS_HALF),
            _splines(theta_d / quarter, KNOTS_DIFFERENCE),
            _splines(theta_i / quarter, KNOTS_GRAZING),
            _splines(theta_o / quarter, KNOTS_GRAZING),
        ]
    )


def _splines(x: Array, knots: int) -> Array:
    """Cubic B-splines on evenly spaced knots of [0, 1], shape (N, knots + 2)."""
    from scipy.interpolate import BSpline

    padded = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, knots), np.ones(3)])
    return np.asarray(BSpline.design_matrix(np.clip(x, 0.0, 1.0), padded, 3).toarray())


def _penalty() -> Array:
    """Return the normal matrix of the second differences of each function, and of the size of all."""
    sizes = [knots + 2 for knots in (KNOTS_HALF, KNOTS_DIFFERENCE, KNOTS_GRAZING, KNOTS_GRAZING)]
    matrix, begin = RIDGE * np.eye(sum(sizes)), 0
    for size in sizes:
        second = np.diff(np.eye(size), 2, axis=0)
        matrix[begin : begin + size, begin : begin + size] += SMOOTHNESS * second.T @ second
        begin += size
    return matrix
