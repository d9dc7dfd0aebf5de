"""A microfacet model whose D(theta_h), F(theta_d) and G(theta) are smooth tables estimated from the data.

f_r = kd/pi + ks L exp(d(theta_h) + r(theta_d) + g(theta_i) + g(theta_o)), where L is the lobe of a GGX model
that was fitted to the same data, and d, r, g are cubic splines: corrections to the logarithms of
distribution, reflectance (one table a channel: reflectance is what has colour) and masking. The factors are
those of Bagher, Snyder & Nowrouzezahrai 2016, "A non-parametric factor microfacet model for isotropic BRDFs";
started from a parametric fit, the result is never worse than that.

Tables that bend too easily follow noise, and go astray between and beyond the incidences measured, where they
can be far worse than the model they started from. How easily is one number, the stiffness;
`analysis.factored_fit` finds it by cross-validation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from analysis.losses import make_loss
from analysis.models.base import Geometry
from analysis.models.fresnel import schlick_with_slope
from analysis.models.microfacet import ggx
from rig.errors import BadInput

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from analysis.losses import Loss
    from analysis.models.base import Array, Model

DISTRIBUTION_KNOTS, REFLECTANCE_KNOTS, MASKING_KNOTS = 24, 10, 8
STIFFNESS = 1e-2
"""Where nothing better is known."""
PULL = 0.3
"""Weight, in units of the stiffness, that keeps entries without data near zero."""
LEAST_SCALE = 1e-6
"""Residual, as a share of the data's own size, below which the start is as good as exact."""
MOST_STEPS = 60
ENOUGH = 1e-5
"""Relative gain of a step from which on the search goes on."""
STUCK = 1e6
QUARTER = 0.5 * np.pi


class Table(NamedTuple):
    """One of a model's factors.

    Attributes
    ----------
    theta_deg : ndarray, shape (K,)
        Half-vector angle, difference angle, or angle to the normal.
    value : ndarray, shape (K,) or (K, channels)
        The factor.
    relative_u : ndarray, of the same shape
        Standard uncertainty of the correction to its logarithm; large where only the start speaks.
    """

    theta_deg: Array
    value: Array
    relative_u: Array


@dataclass(frozen=True, eq=False)
class Factored:
    """A GGX model with tables over it; reciprocal and isotropic, and no promise on energy.

    Attributes
    ----------
    start : Model
        The parametric model whose lobe is corrected: `GGX`.
    kd, ks : ndarray, shape (channels,)
        Scales of the diffuse term and of the lobe.
    shared : ndarray
        Spline coefficients of ln D (`DISTRIBUTION_KNOTS` + 2) and ln G (`MASKING_KNOTS` + 2), corrections.
    reflectance : ndarray, shape (channels, `REFLECTANCE_KNOTS` + 2)
        Spline coefficients of ln F, corrections.
    """

    NAME: ClassVar[str] = "factored"

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
        common, angular = _bases(geometry)
        corrections = (common @ self.shared)[:, None] + angular @ self.reflectance.T
        lobe = np.exp(_log_lobe(self.start, geometry).reshape(-1, 1) + corrections)
        f = self.kd / np.pi + self.ks * lobe
        return geometry.finish(f.reshape(*geometry.visible.shape, len(self.kd)))


class Estimate(NamedTuple):
    """Tables, and how well they are known.

    Attributes
    ----------
    model : Factored
        The tables.
    covariance : ndarray, shape (U, U)
        Of shared coefficients, reflectance by channel, kd by channel, ln ks by channel, in this order:
        of the smoothing spline as a Bayesian would have it (Wahba 1983).
    freedom : float
        Number of parameters that the data decide: the trace of the smoother.
    """

    model: Factored
    covariance: Array
    freedom: float


def estimate(
    wi: ArrayLike, wo: ArrayLike, f_r: ArrayLike, start: Model, *, stiffness: float = STIFFNESS
) -> Factored:
    """Estimate the tables by least squares in ln(1 + f cos), from a fitted model.

    Parameters
    ----------
    wi, wo : array_like, shape (N, 3)
        Unit directions to the light and to the camera, in the sample frame.
    f_r : array_like, shape (N, channels)
        Samples in 1/sr; NaN where there is none.
    start : Model
        A `GGX` with shapes common to all channels, fitted to these samples.
    stiffness : float
        See `estimate_under`.

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
    used = np.isfinite(data) & geometry.visible[:, None]
    loss = make_loss("log", data, used, geometry.cos_i.reshape(-1, 1), None)
    return estimate_under(loss, geometry, start, stiffness=stiffness).model


def estimate_under(loss: Loss, geometry: Geometry, start: Model, *, stiffness: float = STIFFNESS) -> Estimate:
    """Estimate the tables under a loss, from a fitted model.

    Levenberg-Marquardt over all tables and scales at once, in few steps: the model is nearly linear.

    Parameters
    ----------
    loss : Loss
        Data and what to make small, arrays (N, channels).
    geometry : Geometry
        The directions of the N pairs.
    start : Model
        As in `estimate`.
    stiffness : float
        Weight of the squared second differences of a table (`PULL` squared of the squared entries) against
        the mean squared residual, the residual in units of the start's.

    Returns
    -------
    Estimate

    Raises
    ------
    BadInput
        As `estimate`.
    """
    require_enough(loss)
    return _Search(start, geometry, loss, stiffness).run()


def require_enough(loss: Loss) -> None:
    """Refuse fewer samples than one channel's tables have entries; BadInput."""
    unknowns = sum(_sizes(1)) + 2
    fewest = int(loss.used.sum(axis=0).min())
    if fewest < unknowns:
        raise BadInput(
            f"{fewest} samples for {unknowns} table entries",
            where=Factored.NAME,
            todo=f"measure at least {unknowns} pairs of directions, or fit a model with fewer parameters",
        )


def tables(found: Estimate) -> dict[str, Table]:
    """Tabulate the factors of a model over GGX.

    Parameters
    ----------
    found : Estimate
        Of `estimate_under`.

    Returns
    -------
    dict of str to Table
        `D` over theta_h in 1/sr, normalised like GGX's (its integral with the cosine over the hemisphere is
        1); `F` over theta_d by channel, which takes the rest of the scale: ks times reflectance; `G` over
        theta, by which Smith's masking is multiplied once for the light and once for the camera, 1 at 0.
    """
    model, covariance = found.model, found.covariance
    start = {name: float(np.ravel(vars(model.start)[name])[0]) for name in ("alpha", "f0")}
    first = DISTRIBUTION_KNOTS + 2
    root = np.linspace(0.0, 1.0, DISTRIBUTION_KNOTS)
    basis = _splines(root, DISTRIBUTION_KNOTS)
    theta_h = QUARTER * np.square(root)
    d_u = _spread(basis, covariance[:first, :first])

    def density(root: Array) -> Array:
        tan2 = np.square(np.tan(np.minimum(QUARTER * np.square(root), QUARTER - 1e-9)))
        bent = np.exp(_splines(root, DISTRIBUTION_KNOTS) @ model.shared[:first])
        return ggx(tan2, np.asarray(start["alpha"]))[0] * bent

    nodes, weights = np.polynomial.legendre.leggauss(2000)
    fine, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    angle = QUARTER * np.square(fine)
    area = (
        2.0
        * np.pi
        * float((weights * 2.0 * QUARTER * fine) @ (density(fine) * np.cos(angle) * np.sin(angle)))
    )
    theta = np.linspace(0.0, QUARTER, MASKING_KNOTS)
    g_basis = _splines(theta / QUARTER, MASKING_KNOTS)
    masking = np.exp(g_basis @ model.shared[first:])
    theta_d = np.linspace(0.0, QUARTER, REFLECTANCE_KNOTS)
    f_basis = _splines(theta_d / QUARTER, REFLECTANCE_KNOTS)
    schlick = schlick_with_slope(np.cos(theta_d), np.square(np.sin(theta_d)), start["f0"])[0]
    scale = model.ks * area * np.square(masking[0])
    each, begin = f_basis.shape[1], model.shared.size
    blocks = [slice(begin + c * each, begin + (c + 1) * each) for c in range(len(model.kd))]
    f_u = np.stack([_spread(f_basis, covariance[block, block]) for block in blocks], axis=1)
    g_u = _spread(g_basis, covariance[first:begin, first:begin])
    return {
        "D": Table(np.degrees(theta_h), density(root) / area, d_u),
        "F": Table(
            np.degrees(theta_d), schlick[:, None] * np.exp(f_basis @ model.reflectance.T) * scale, f_u
        ),
        "G": Table(np.degrees(theta), masking / masking[0], g_u),
    }


def _spread(basis: Array, covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.einsum("kp,pq,kq->k", basis, covariance, basis), 0.0)))


@np.errstate(under="ignore", over="ignore")
def _log_lobe(start: Model, geometry: Geometry) -> Array:
    lobe = start.lobe_at(geometry)
    if lobe is None:
        raise BadInput("a model without a lobe has none to correct", where=f"factored from {start.NAME}")
    return np.asarray(np.log(np.maximum(lobe.value[..., 0], 1e-300)))


def _bases(geometry: Geometry) -> tuple[Array, Array]:
    """Spline basis at each pair: that of ln D and ln G side by side, and that of ln F."""
    theta_h = np.arctan(np.sqrt(geometry.tan2_h)).ravel()
    theta_d = np.arctan2(np.sqrt(geometry.sin2_d), geometry.cos_d).ravel()
    theta_i = np.arctan2(np.sqrt(geometry.sin2_i), geometry.cos_i).ravel()
    theta_o = np.arctan2(np.sqrt(geometry.sin2_o), geometry.cos_o).ravel()
    # The square root puts half of the distribution's knots within 22 degrees of the peak.
    distribution = _splines(np.sqrt(theta_h / QUARTER), DISTRIBUTION_KNOTS)
    masking = _splines(theta_i / QUARTER, MASKING_KNOTS) + _splines(theta_o / QUARTER, MASKING_KNOTS)
    return np.hstack([distribution, masking]), _splines(theta_d / QUARTER, REFLECTANCE_KNOTS)


def _splines(x: Array, knots: int) -> Array:
    """Cubic B-splines on evenly spaced knots of [0, 1], (N, knots + 2)."""
    from scipy.interpolate import BSpline

    inner = np.linspace(0.0, 1.0, knots)
    padded = np.concatenate([np.zeros(3), inner, np.ones(3)])
    return np.asarray(BSpline.design_matrix(np.clip(x, 0.0, 1.0), padded, 3).toarray())


def _sizes(channels: int) -> tuple[int, ...]:
    return DISTRIBUTION_KNOTS + 2, MASKING_KNOTS + 2, *[REFLECTANCE_KNOTS + 2] * channels


def _roughness(sizes: tuple[int, ...]) -> Array:
    """Return the matrix of squared second differences within each table, and of squared entries."""
    matrix: Array = PULL**2 * np.eye(sum(sizes))
    begin = 0
    for size in sizes:
        second = np.diff(np.eye(size), 2, axis=0)
        matrix[begin : begin + size, begin : begin + size] += second.T @ second
        begin += size
    return matrix


class _Search:
    """The least-squares problem: unknowns are shared tables, then F by channel, kd, and ln ks."""

    def __init__(self, start: Model, geometry: Geometry, loss: Loss, stiffness: float) -> None:
        self._start, self._loss = start, loss
        self._log_lobe = _log_lobe(start, geometry).ravel()
        self._common, self._angular = _bases(geometry)
        self._channels = loss.data.shape[1]
        self._tables = sum(_sizes(self._channels))
        self._penalty = np.zeros((self._tables + 2 * self._channels,) * 2)
        square = self._square(self._first())
        size = float(np.sum(np.square(loss.residual(np.zeros_like(loss.data)))))
        self._penalty[: self._tables, : self._tables] = (
            stiffness * max(square, np.square(LEAST_SCALE) * size) * _roughness(_sizes(self._channels))
        )

    def run(self) -> Estimate:
        x, damping = self._first(), 1e-3
        cost, normal, gradient = self._linearised(x)
        for _ in range(MOST_STEPS):
            gain = 0.0
            while damping < STUCK:
                scale = np.diag(np.diag(normal) + 1e-9)
                tried = self._admissible(x - np.linalg.solve(normal + damping * scale, gradient))
                new = self._linearised(tried)
                if new[0] < cost:
                    gain, damping = cost - new[0], max(damping / 5.0, 1e-9)
                    x, (cost, normal, gradient) = tried, new
                    break
                damping *= 4.0
            if gain <= ENOUGH * cost:
                break
        return self._judged(x, normal)

    def _judged(self, x: Array, normal: Array) -> Estimate:
        channels = self._channels
        shared, reflectance = self._split(x)
        kd, ks = x[-2 * channels : -channels], np.exp(x[-channels:])
        # Scaled to a diagonal of ones; what no datum and no penalty holds stays out.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        inverse = np.linalg.pinv(normal * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
        freedom = float(np.sum(inverse * (normal - self._penalty)))
        count = int(self._loss.used.sum())
        scatter = self._square(x) / max(count - freedom, 1.0)
        return Estimate(Factored(self._start, kd, ks, shared, reflectance), scatter * inverse, freedom)

    def _first(self) -> Array:
        kd = np.broadcast_to(vars(self._start)["kd"], self._channels)
        ks = np.maximum(np.broadcast_to(vars(self._start)["ks"], self._channels), 1e-9)
        return np.concatenate([np.zeros(self._tables), kd, np.log(ks)])

    def _admissible(self, x: Array) -> Array:
        kept = x.copy()
        scales = slice(-2 * self._channels, -self._channels)
        kept[scales] = np.maximum(kept[scales], 0.0)
        return kept

    def _split(self, x: Array) -> tuple[Array, Array]:
        first = self._common.shape[1]
        return x[:first], x[first : self._tables].reshape(self._channels, -1)

    def _specular(self, x: Array) -> Array:
        shared, reflectance = self._split(x)
        exponent = (self._log_lobe + self._common @ shared)[:, None] + self._angular @ reflectance.T
        return np.asarray(np.exp(np.clip(exponent + x[-self._channels :], -700.0, 300.0)))

    def _square(self, x: Array) -> float:
        kd = x[-2 * self._channels : -self._channels]
        return float(np.sum(np.square(self._loss.residual(kd / np.pi + self._specular(x)))))

    @np.errstate(under="ignore")
    def _linearised(self, x: Array) -> tuple[float, Array, Array]:
        """Half the sum of squares with the penalty, its Gauss-Newton matrix and its gradient."""
        channels, first, each = self._channels, self._common.shape[1], self._angular.shape[1]
        specular = self._specular(x)
        f = x[-2 * channels : -channels] / np.pi + specular
        residual, slope = self._loss.residual(f), self._loss.slope(f)
        normal, gradient = self._penalty.copy(), self._penalty @ x
        cost = 0.5 * float(x @ gradient) + 0.5 * float(np.sum(np.square(residual)))
        for c in range(channels):
            lobe, own_slope = (slope * specular)[:, c, None], slope[:, c, None]
            columns = np.hstack([self._common * lobe, self._angular * lobe, own_slope / np.pi, lobe])
            begin = first + c * each
            own = np.r_[:first, begin : begin + each, x.size - 2 * channels + c, x.size - channels + c]
            normal[np.ix_(own, own)] += columns.T @ columns
            gradient[own] += columns.T @ residual[:, c]
        return cost, normal, gradient
