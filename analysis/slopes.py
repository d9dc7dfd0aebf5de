"""The slopes of a surface's facets, read from samples without a search: where the width of a lobe begins.

A microfacet lobe holds the distribution D of the facets' normals, and D has a mean slope. Where samples look
back at the light, D comes out of them by power iteration; elsewhere it is f_r times the cosines, averaged at
equal half vectors, which leaves masking and Fresnel in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from analysis.models.base import Geometry

Array = NDArray[np.float64]

RETRO_RAD = np.deg2rad(5.0)
"""Half the angle between light and camera up to which a pair looks back."""
STEEPEST_RAD = np.deg2rad(75.0)
"""Beyond this angle to the normal a half vector or direction tells of masking and little of D."""
NODES = 48
"""Angles at which D is tabulated, at most."""
FEWEST, WIDEST_GAP_RAD = 8, np.deg2rad(15.0)
"""Different angles that pairs looking back must have, and the largest step between them."""
ITERATIONS = 4
"""Power iterations; Dupuy et al. find four enough."""
FOOT = 0.01
"""Share of the peak below which D is taken for what the diffuse term left."""


def mean_slope(geometry: Geometry, f_r: Array, used: NDArray[np.bool_]) -> float | None:
    """Estimate the mean absolute slope of the facets along a line in the surface.

    It is E|x| of Dupuy, Heitz, Iehl, Poulin & Ostromoukhov 2015 ("Extracting microfacet-based BRDF parameters
    from arbitrary materials with power iterations"), who find alpha of GGX equal to it and that of Beckmann
    sqrt(pi) times larger. Tails below a hundredth of the peak are cut, so that GGX's comes out at two thirds.

    Parameters
    ----------
    geometry : Geometry
        N pairs of directions.
    f_r : ndarray, shape (N, C)
        In 1/sr.
    used : ndarray of bool, shape (N, C)
        Which of it counts.

    Returns
    -------
    float or None
        None where no lobe rises above the diffuse term.
    """
    theta_h = np.arctan(np.sqrt(geometry.tan2_h[:, 0]))
    cosines = np.minimum(geometry.cos_i, geometry.cos_o)[:, 0]
    rows = used.any(axis=1) & (theta_h < STEEPEST_RAD) & (cosines > np.cos(STEEPEST_RAD))
    if np.count_nonzero(rows) < FEWEST:
        return None
    f = np.sum(np.where(used, f_r, 0.0), axis=1)[rows] / used.sum(axis=1)[rows]
    theta_h = theta_h[rows]
    # What the steepest third of half vectors see is the diffuse term.
    lobe = f - np.median(f[theta_h >= np.quantile(theta_h, 2.0 / 3.0)])
    back = geometry.sin2_d[rows, 0] < np.sin(RETRO_RAD) ** 2
    if _covers(theta_h[back]):
        theta, seen = _averaged(theta_h[back], lobe[back])
        density = power_iteration(theta, np.maximum(seen, 0.0))
    else:
        weighted = lobe * (geometry.cos_i * geometry.cos_o)[rows, 0]
        theta, density = _averaged(theta_h, weighted)
    return _moment(theta, density)


def _covers(theta: Array) -> bool:
    """Whether angles are many and close enough to tabulate D from the normal to its foot."""
    different = np.unique(np.round(theta, 6))
    if len(different) < FEWEST or different[-1] < 0.5 * STEEPEST_RAD:
        return False
    return bool(np.max(np.diff(different, prepend=0.0)) <= WIDEST_GAP_RAD)


def _averaged(theta: Array, values: Array) -> tuple[Array, Array]:
    """Average values over groups of neighbouring angles, at most `NODES`, of equal numbers of samples."""
    order = np.argsort(theta, kind="stable")
    groups = np.array_split(order, min(NODES, len(order)))
    return np.array([theta[g].mean() for g in groups]), np.array([values[g].mean() for g in groups])


def power_iteration(theta: Array, retro: Array) -> Array:
    """Find the distribution of facets that returns light to where it came from as measured.

    f = F0 D(theta) G1(theta) / (4 cos^2) with Smith's G1 = cos / (integral of the facets' projected area) is
    an eigenvalue problem for D, solved by power iteration (Dupuy et al. 2015, section 4).

    Parameters
    ----------
    theta : ndarray, shape (K,)
        Angles to the normal in radians, ascending.
    retro : ndarray, shape (K,)
        f_r towards the light there, without the diffuse term; not negative.

    Returns
    -------
    ndarray, shape (K,)
        D up to a factor; zero where `retro` is zero everywhere.
    """
    up, side = np.cos(theta), np.sin(theta)
    a, b = np.multiply.outer(up, up), np.multiply.outer(side, side)
    # Facets that face the direction, over all azimuths: integral of max(0, a + b cos phi).
    azimuth = np.arccos(np.clip(-a / np.maximum(b, 1e-300), -1.0, 1.0))
    facing = 2.0 * (a * azimuth + b * np.sin(azimuth))
    kernel = (retro * up)[:, None] * facing * (side * np.gradient(theta))
    density = np.ones_like(theta)
    for _ in range(ITERATIONS):
        density = kernel @ density
        density /= max(float(density.max()), 1e-300)
    return density


def _moment(theta: Array, density: Array) -> float | None:
    """E|x| of an isotropic distribution of slopes: 2/pi of the mean of tan(theta)."""
    peak = float(density.max())
    if not peak > 0.0:
        return None
    foot = np.flatnonzero(density < FOOT * peak)
    foot = foot[foot > int(np.argmax(density))]
    end = foot[0] if foot.size else len(theta)
    theta, density = theta[:end], np.maximum(density[:end], 0.0)
    edges = np.concatenate([[0.0], 0.5 * (theta[1:] + theta[:-1]), theta[-1:]])
    weight = density * np.diff(np.square(np.sin(edges)))
    total = float(weight.sum())
    return float(2.0 / np.pi * np.sum(weight * np.tan(theta)) / total) if total > 0.0 else None
