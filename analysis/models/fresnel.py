"""Exact reflectance of a smooth dielectric for unpolarised light, stable at normal incidence and near n=1."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from analysis.models.base import Array


def dielectric(cos_d: ArrayLike, ior: ArrayLike) -> Array:
    """Fresnel reflectance F of a dielectric.

    With c the cosine of incidence and g = sqrt(n^2 + c^2 - 1), the amplitudes (Fresnel 1823; F in the form of
    Cook & Torrance 1982, equation for F)

        r_s = (c - g)/(c + g),   r_p = (n^2 c - g)/(n^2 c + g)

    lose all digits near n = 1. Multiplying by the conjugates takes the factor n^2 - 1 out exactly:

        r_s = -(n^2 - 1)/(g + c)^2,  r_p = (n^2 - 1)((n^2 + 1) c^2 - 1)/(n^2 c + g)^2,  F = (r_s^2 + r_p^2)/2.

    Parameters
    ----------
    cos_d : array_like
        Cosine of the angle of incidence, 0 to 1.
    ior : array_like
        Index of refraction n >= 1, relative to the medium of the light; broadcasts with `cos_d`.

    Returns
    -------
    ndarray
        F, 0 to 1.
    """
    return dielectric_with_slope(cos_d, ior)[0]


@np.errstate(under="ignore")
def dielectric_with_slope(cos_d: ArrayLike, ior: ArrayLike) -> tuple[Array, Array]:
    """`dielectric` and its derivative by the index of refraction.

    Parameters
    ----------
    cos_d, ior : array_like
        As in `dielectric`.

    Returns
    -------
    tuple of ndarray
        F and dF/dn.
    """
    c, n = np.asarray(cos_d, dtype=np.float64), np.asarray(ior, dtype=np.float64)
    contrast = (n - 1.0) * (n + 1.0)
    # At n = 1 and exactly grazing incidence g and c are both 0: the floor keeps 0/0 out, and no more.
    g = np.maximum(np.sqrt(contrast + c * c), 1e-150)
    s, p = g + c, n * n * c + g
    brewster = (n * n + 1.0) * c * c - 1.0
    r_s = -contrast / s / s
    r_p = contrast / p * brewster / p
    slope_s = -2.0 * n * (c / g) / s / s
    # d/dn of contrast * brewster / p^2, with dg/dn = n/g.
    slope_p = (
        (2.0 * n * (brewster + contrast * c * c) - 2.0 * contrast * brewster * (2.0 * n * c + n / g) / p)
        / p
        / p
    )
    return 0.5 * (r_s * r_s + r_p * r_p), r_s * slope_s + r_p * slope_p


def normal_reflectance(ior: ArrayLike) -> Array:
    """F0 = ((n - 1)/(n + 1))^2, the reflectance at normal incidence.

    Parameters
    ----------
    ior : array_like
        Index of refraction n.

    Returns
    -------
    ndarray
        F0, of the shape of `ior`.
    """
    n = np.asarray(ior, dtype=np.float64)
    return np.asarray(np.square((n - 1.0) / (n + 1.0)))


def normal_reflectance_slope(ior: ArrayLike) -> Array:
    """dF0/dn = 4 (n - 1)/(n + 1)^3; argument as in `normal_reflectance`."""
    n = np.asarray(ior, dtype=np.float64)
    return np.asarray(4.0 * (n - 1.0) / (n + 1.0) ** 3)
