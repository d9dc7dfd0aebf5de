"""How a white reference departs from a perfect diffuser: a reciprocal shape, its points, its uncertainty.

Pressed and sintered PTFE scatters in its volume and absorbs next to nothing. A half-space that scatters
evenly and loses nothing has the reflectance factor

    S(wi, wo) = H(mu_i) H(mu_o) / (4 (mu_i + mu_o))

with Chandrasekhar's H (Radiative Transfer, 1960, ch. IV): reciprocal, and of hemispherical reflectance 1 from
every direction. It follows measured Spectralon from 12 to 85 degrees within percents, but real plates add a
weak gloss and a weak memory of direction. These are a smooth factor 1 + sum c_k b_k(wi, wo) of reciprocal
terms, whose coefficients are known beforehand to `PRIOR` only. That is the generic shape with its
uncertainty; measured points narrow the coefficients (linear regression with that prior), where they reach.

Each term has its mean over the hemisphere, seen from 8 degrees, taken off: a certificate of the
8 deg/hemispherical reflectance keeps its meaning whatever the points say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.errors import BadInput

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float = NDArray[np.float64]

CERTIFICATE_RAD = math.radians(8.0)
"""Direction of incidence of an 8 deg/hemispherical certificate."""

PRIOR = 0.06
"""Standard uncertainty of each coefficient beforehand: 2 to 4 % of the factor over most of the hemisphere."""

PRIOR_SCALE = 0.03
"""Of the scale of measured points, which is that of another standard and is fitted: it belongs to the
certificate."""

U_UNSEEN = 0.03
"""Relative standard uncertainty beyond the terms' of a plate of which nothing is measured: plates differ."""

U_REST = 0.005
"""The same of a plate with measured points, and of points that state none."""

_NODES = 96
_TABLE = 4096
_TERMS = 6


@cache
def _h_table() -> tuple[Float, Float]:
    """Chandrasekhar's H for isotropic scattering without loss, on an even grid of mu from 0 to 1.

    Solves 1 / H(mu) = 1/2 int_0^1 mu' H(mu') / (mu + mu') dmu' by iteration on Gauss-Legendre nodes.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    # Squared nodes: dense towards grazing, where H is steep.
    mu = ((nodes + 1.0) / 2.0) ** 2
    weight = weights / 2.0 * (nodes + 1.0)
    kernel = 0.5 * weight * mu / (mu[:, np.newaxis] + mu)
    h = 1.0 + 2.0 * mu
    for _ in range(400):
        # Plain iteration swings about the solution; the mean of two steps does not.
        following = 0.5 * (h + 1.0 / (kernel @ h))
        settled = bool(np.max(np.abs(following - h)) < 1e-13)
        h = following
        if settled:
            break
    grid = np.linspace(0.0, 1.0, _TABLE)
    inverse = (0.5 * weight * mu * h / (grid[:, np.newaxis] + mu)).sum(axis=1)
    return grid, np.asarray(1.0 / inverse, dtype=np.float64)


def chandrasekhar_h(mu: Any) -> Float:
    """Chandrasekhar's H for isotropic scattering without loss.

    Parameters
    ----------
    mu : array_like
        Cosine of the angle from the normal, 0 to 1.

    Returns
    -------
    ndarray
        1 at grazing, 2.908 at the normal.
    """
    grid, table = _h_table()
    return np.asarray(np.interp(mu, grid, table), dtype=np.float64)


def volume_factor(wi: Float, wo: Float) -> Float:
    """Reflectance factor of a half-space that scatters evenly and absorbs nothing.

    Parameters
    ----------
    wi, wo : ndarray, shape (..., 3)
        Unit directions.

    Returns
    -------
    ndarray, shape (...)
        NaN below the horizon.
    """
    mu_i, mu_o = wi[..., 2], wo[..., 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = chandrasekhar_h(mu_i) * chandrasekhar_h(mu_o) / (4.0 * (mu_i + mu_o))
    return np.where((mu_i > 0.0) & (mu_o > 0.0), factor, np.nan)


def _raw_terms(wi: Float, wo: Float) -> Float:
    """Terms that are equal when the directions are exchanged, shape (..., _TERMS)."""
    low_i, low_o = 1.0 - wi[..., 2], 1.0 - wo[..., 2]
    across = wi[..., 0] * wo[..., 0] + wi[..., 1] * wo[..., 1]
    return np.stack(
        np.broadcast_arrays(
            low_i + low_o,
            low_i**2 + low_o**2,
            low_i * low_o,
            across,
            across**2,
            across * (low_i + low_o),
        ),
        axis=-1,
    )


@cache
def _term_means() -> Float:
    """Mean of each term over the hemisphere seen from 8 degrees, weighted as its reflectance is."""
    mu, weight = (part.astype(np.float64) for part in np.polynomial.legendre.leggauss(64))
    mu, weight = (mu + 1.0) / 2.0, weight / 2.0
    phi = (np.arange(64) + 0.5) * 2.0 * np.pi / 64
    sine = np.sqrt(1.0 - mu**2)[:, np.newaxis]
    wo = np.stack(np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), mu[:, np.newaxis]), axis=-1)
    wi = np.array([math.sin(CERTIFICATE_RAD), 0.0, math.cos(CERTIFICATE_RAD)])
    share = (weight * mu)[:, np.newaxis] * volume_factor(np.broadcast_to(wi, wo.shape), wo)
    means = (share[..., np.newaxis] * _raw_terms(wi, wo)).sum(axis=(0, 1)) / share.sum()
    return np.asarray(means, dtype=np.float64)


def terms(wi: Float, wo: Float) -> Float:
    """Terms of the departure from the volume's factor, shape (..., K): reciprocal, of no mean from 8 deg."""
    return np.asarray(_raw_terms(wi, wo) - _term_means(), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class PtfeShape:
    """Shape of a PTFE plate: the volume's factor, times 1 + terms.

    Attributes
    ----------
    coefficients : ndarray, shape (K,)
    covariance : ndarray, shape (K, K)
    u_rest : float
        Relative standard uncertainty of what the terms do not follow.
    """

    coefficients: Float
    covariance: Float
    u_rest: float

    @classmethod
    def generic(cls) -> PtfeShape:
        """Shape of a plate of which nothing is measured."""
        return cls(np.zeros(_TERMS), PRIOR**2 * np.eye(_TERMS), U_UNSEEN)

    @classmethod
    def fitted(cls, wi: Float, wo: Float, factor: Float, u_relative: Float | None = None) -> PtfeShape:
        """Fit measured points.

        Parameters
        ----------
        wi, wo : ndarray, shape (N, 3)
            Unit directions.
        factor : ndarray, shape (N,)
            Reflectance factors; their common scale does not matter.
        u_relative : ndarray, shape (N,), optional
            Relative standard uncertainty of each, without that of the scale.

        Returns
        -------
        PtfeShape

        Raises
        ------
        BadInput
            Points that are not positive, or below the horizon.
        """
        base = volume_factor(wi, wo)
        if not (np.isfinite(base).all() and np.isfinite(factor).all() and np.all(factor > 0.0)):
            raise BadInput(
                "points of the white that are not positive or below the horizon",
                todo="give reflectance factors above 0 at angles below 90 degrees",
            )
        u_points = np.hypot(U_REST, np.zeros(len(factor)) if u_relative is None else u_relative)
        # Linear in the scale's logarithm and, to first order, in the coefficients.
        design = np.column_stack([terms(wi, wo), np.ones(len(factor))])
        prior = np.diag([1.0 / PRIOR**2] * _TERMS + [1.0 / PRIOR_SCALE**2])
        solution = np.zeros(_TERMS + 1)
        covariance = np.linalg.inv(prior)
        for _ in range(8):
            shape = 1.0 + design[:, :-1] @ solution[:-1]
            slope = np.column_stack([design[:, :-1] / shape[:, np.newaxis], design[:, -1]])
            residual = np.log(factor / (base * shape)) - solution[-1]
            weighted = slope / u_points[:, np.newaxis] ** 2
            covariance = np.linalg.inv(weighted.T @ slope + prior)
            solution = solution + covariance @ (weighted.T @ residual - prior @ solution)
        return cls(solution[:-1], covariance[:-1, :-1], U_REST)

    def factor(self, wi: Float, wo: Float) -> Float:
        """Reflectance factor over the 8 deg/hemispherical reflectance, shape (...)."""
        return np.asarray(volume_factor(wi, wo) * (1.0 + terms(wi, wo) @ self.coefficients))

    def u_relative(self, wi: Float, wo: Float) -> Float:
        """Its relative standard uncertainty, shape (...)."""
        each = terms(wi, wo)
        variance = np.einsum("...k,kl,...l->...", each, self.covariance, each)
        return np.asarray(np.sqrt(variance / (1.0 + each @ self.coefficients) ** 2 + self.u_rest**2))
