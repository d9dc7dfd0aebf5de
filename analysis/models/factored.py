"""A microfacet model whose D(theta_h), F(theta_d) and G(theta) are smooth tables estimated from the data.

f_r = kd/pi + ks L exp(d(theta_h) + r(theta_d) + g(theta_i) + g(theta_o)), where L is the lobe of a GGX model
that was fitted to the same data, and d, r, g are cubic splines: corrections to the logarithms of
distribution, reflectance (one table a channel: reflectance is what has colour) and masking. The factors are
those of Bagher, Snyder & Nowrouzezahrai 2016, "A non-parametric factor microfacet model for isotropic BRDFs";
started from a parametric fit, the result is never worse than that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.models.base import Geometry
from rig.errors import BadInput

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from analysis.models.base import Array, Model

DISTRIBUTION_KNOTS, REFLECTANCE_KNOTS, MASKING_KNOTS = 24, 10, 8
SMOOTHNESS = 0.01
"""Weight of a table's second differences against residuals of ln(1 + f cos)."""
PULL = 0.3
"""Weight, in units of `SMOOTHNESS`, that keeps entries without data near zero."""
MOST_STEPS = 60
ENOUGH = 1e-5
"""Relative gain of a step from which on the search goes on."""
STUCK = 1e6


@dataclass(frozen=True, eq=False)
class Factored:
    """A GGX model with tables over it; reciprocal and isotropic, and no promise on energy.

    Attributes
    ----------
    start : Model
        The parametric model whose lobe is corrected.
    kd, ks : ndarray, shape (channels,)
        Scales of the diffuse term and of the lobe.
    shared : ndarray
        Spline coefficients of ln D (`DISTRIBUTION_KNOTS` + 2) and ln G (`MASKING_KNOTS` + 2), corrections.
    reflectance : ndarray, shape (channels, `REFLECTANCE_KNOTS` + 2)
        Spline coefficients of ln F, corrections.
    """

    start: Model
    kd: Array
    ks: Array
    shared: Array
    reflectance: Array

    @np.errstate(under="ignore", over="ignore")
    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> Array:
        """Evaluate the model; as `analysis.models.base.Model.evaluate`.

        Parameters
        ----------
        wi, wo : array_like, shape (..., 3)
            Unit directions to the light and to the camera, in the sample frame; leading dimensions broadcast.

        Returns
        -------
        ndarray, shape (..., channels)
            f_r in 1/sr.
        """
        geometry = Geometry(wi, wo)
        lobe = np.exp(_log_lobe(self.start, geometry).reshape(-1, 1) + self._corrections(geometry))
        f = self.kd / np.pi + self.ks * lobe
        return geometry.finish(f.reshape(*geometry.visible.shape, len(self.kd)))

    def _corrections(self, geometry: Geometry) -> Array:
        common, angular = _tables(geometry)
        return (common @ self.shared)[:, None] + angular @ self.reflectance.T


def estimate(wi: ArrayLike, wo: ArrayLike, f_r: ArrayLike, start: Model) -> Factored:
    """Estimate the tables by least squares in ln(1 + f cos), from a fitted model.

    Levenberg-Marquardt over all tables and scales at once, in few steps: the model is nearly linear.

    Parameters
    ----------
    wi, wo : array_like, shape (N, 3)
        Unit directions to the light and to the camera, in the sample frame.
    f_r : array_like, shape (N, channels)
        Samples in 1/sr; NaN where there is none.
    start : Model
        A model with Lambert's term and shapes common to all channels, fitted to these samples: `GGX`.

    Returns
    -------
    Factored

    Raises
    ------
    BadInput
        If there are fewer samples than table entries.
    """
    geometry = Geometry(wi, wo)
    data = np.asarray(f_r, dtype=np.float64)
    common, angular = _tables(geometry)
    used = np.isfinite(data) & geometry.visible[:, None]
    unknowns = common.shape[1] + angular.shape[1] + 2
    if used.sum(axis=0).min() < unknowns:
        raise BadInput(
            f"{used.sum(axis=0).min()} samples for {unknowns} table entries",
            where="factored",
            todo=f"measure at least {unknowns} pairs of directions, or fit a model with fewer parameters",
        )
    return _Search(start, geometry, np.where(used, data, 0.0), used, common, angular).run()


@np.errstate(under="ignore", over="ignore")
def _log_lobe(start: Model, geometry: Geometry) -> Array:
    lobe = start.lobe_at(geometry)
    if lobe is None:
        raise BadInput("a model without a lobe has none to correct", where=f"factored from {start.NAME}")
    return np.asarray(np.log(np.maximum(lobe.value[..., 0], 1e-300)))


def _tables(geometry: Geometry) -> tuple[Array, Array]:
    """Spline basis at each pair: that of ln D and ln G side by side, and that of ln F."""
    theta_h = np.arctan(np.sqrt(geometry.tan2_h)).ravel()
    theta_d = np.arctan2(np.sqrt(geometry.sin2_d), geometry.cos_d).ravel()
    theta_i = np.arctan2(np.sqrt(geometry.sin2_i), geometry.cos_i).ravel()
    theta_o = np.arctan2(np.sqrt(geometry.sin2_o), geometry.cos_o).ravel()
    quarter = 0.5 * np.pi
    # The square root puts half of the distribution's knots within 22 degrees of the peak.
    distribution = _splines(np.sqrt(theta_h / quarter), DISTRIBUTION_KNOTS)
    masking = _splines(theta_i / quarter, MASKING_KNOTS) + _splines(theta_o / quarter, MASKING_KNOTS)
    return np.hstack([distribution, masking]), _splines(theta_d / quarter, REFLECTANCE_KNOTS)


def _splines(x: Array, knots: int) -> Array:
    """Cubic B-splines on evenly spaced knots of [0, 1], (N, knots + 2)."""
    from scipy.interpolate import BSpline

    inner = np.linspace(0.0, 1.0, knots)
    padded = np.concatenate([np.zeros(3), inner, np.ones(3)])
    return np.asarray(BSpline.design_matrix(np.clip(x, 0.0, 1.0), padded, 3).toarray())


def _roughness(sizes: tuple[int, ...]) -> Array:
    """Return the normal matrix of the penalty on second differences within each table, and on size."""
    total = sum(sizes)
    matrix = np.square(PULL) * np.eye(total)
    begin = 0
    for size in sizes:
        second = np.diff(np.eye(size), 2, axis=0)
        matrix[begin : begin + size, begin : begin + size] += second.T @ second
        begin += size
    return np.asarray(np.square(SMOOTHNESS) * matrix)


@dataclass(frozen=True, eq=False)
class _Search:
    """The least-squares problem: unknowns are shared tables, then F by channel, kd, and ln ks."""

    start: Model
    geometry: Geometry
    data: Array
    used: NDArray[np.bool_]
    common: Array
    angular: Array

    def run(self) -> Factored:
        log_lobe = _log_lobe(self.start, self.geometry)
        x, penalty = self._first(), self._penalty()
        damping = 1e-3
        cost, normal, gradient = self._linearised(x, log_lobe, penalty)
        for _ in range(MOST_STEPS):
            gain = 0.0
            while damping < STUCK:
                scale = np.diag(np.diag(normal) + 1e-9)
                tried = self._admissible(x - np.linalg.solve(normal + damping * scale, gradient))
                new = self._linearised(tried, log_lobe, penalty)
                if new[0] < cost:
                    gain, damping = cost - new[0], max(damping / 5.0, 1e-9)
                    x, (cost, normal, gradient) = tried, new
                    break
                damping *= 4.0
            if gain <= ENOUGH * cost:
                break
        kd, ks, shared, reflectance = self._unpack(x)
        return Factored(self.start, kd, ks, shared, reflectance)

    def _first(self) -> Array:
        channels = self.data.shape[1]
        kd = np.broadcast_to(vars(self.start)["kd"], channels)
        ks = np.maximum(np.broadcast_to(vars(self.start)["ks"], channels), 1e-9)
        tables = np.zeros(self.common.shape[1] + channels * self.angular.shape[1])
        return np.concatenate([tables, kd, np.log(ks)])

    def _penalty(self) -> Array:
        channels = self.data.shape[1]
        sizes = (DISTRIBUTION_KNOTS + 2, MASKING_KNOTS + 2, *[self.angular.shape[1]] * channels)
        tables = sum(sizes)
        full = np.zeros((tables + 2 * channels,) * 2)
        full[:tables, :tables] = _roughness(sizes)
        return full

    def _admissible(self, x: Array) -> Array:
        channels = self.data.shape[1]
        kept = x.copy()
        kept[-2 * channels : -channels] = np.maximum(kept[-2 * channels : -channels], 0.0)
        return kept

    def _unpack(self, x: Array) -> tuple[Array, Array, Array, Array]:
        channels, first = self.data.shape[1], self.common.shape[1]
        reflectance = x[first : -2 * channels].reshape(channels, -1)
        return x[-2 * channels : -channels], np.exp(x[-channels:]), x[:first], reflectance

    def _linearised(self, x: Array, log_lobe: Array, penalty: Array) -> tuple[float, Array, Array]:
        """Half the sum of squares with the penalty, its Gauss-Newton matrix and its gradient."""
        kd, ks, shared, reflectance = self._unpack(x)
        cos_i, channels = self.geometry.cos_i[:, 0], self.data.shape[1]
        normal, gradient = penalty.copy(), penalty @ x
        cost = 0.5 * float(x @ gradient)
        exponent = log_lobe + self.common @ shared
        first, each = self.common.shape[1], self.angular.shape[1]
        for c in range(channels):
            specular = ks[c] * np.exp(np.minimum(exponent + self.angular @ reflectance[c], 300.0))
            f = kd[c] / np.pi + specular
            residual = np.log1p(f * cos_i) - np.log1p(np.maximum(self.data[:, c] * cos_i, -0.999))
            residual = np.where(self.used[:, c], residual, 0.0)
            slope = np.where(self.used[:, c], cos_i / (1.0 + f * cos_i), 0.0)
            lobe = (slope * specular)[:, None]
            columns = np.hstack([self.common * lobe, self.angular * lobe, slope[:, None] / np.pi, lobe])
            begin = first + c * each
            tables = np.arange(begin, begin + each)
            own = np.concatenate(
                [np.arange(first), tables, [x.size - 2 * channels + c, x.size - channels + c]]
            )
            normal[np.ix_(own, own)] += columns.T @ columns
            gradient[own] += columns.T @ residual
            cost += 0.5 * float(residual @ residual)
        return cost, normal, gradient
