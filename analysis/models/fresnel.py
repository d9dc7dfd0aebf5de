"""Reflectance of a smooth boundary for unpolarised light: exact (dielectric, conductor) and Schlick's.

Stable at normal incidence and near n = 1.
"""

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


@np.errstate(under="ignore")
def conductor_with_slopes(cos_d: ArrayLike, eta: ArrayLike, k: ArrayLike) -> tuple[Array, Array, Array]:
    """Fresnel reflectance of a conductor with index n = eta + i k, and its derivatives by eta and k.

    The amplitudes of `dielectric` hold for a complex index (Born & Wolf 1999, section 14.2), and so does the
    form that takes out n^2 - 1. F = (|r_s|^2 + |r_p|^2)/2, and d|r|^2 = 2 Re(conj(r) dr).

    Parameters
    ----------
    cos_d : array_like
        Cosine of the angle of incidence, 0 to 1.
    eta, k : array_like
        Real part, > 0, and imaginary part, >= 0, of the index; broadcast with `cos_d`.

    Returns
    -------
    tuple of ndarray
        F, dF/deta, dF/dk.
    """
    c = np.asarray(cos_d, dtype=np.float64)
    n = np.asarray(eta, dtype=np.float64) + 1j * np.asarray(k, dtype=np.float64)
    contrast = (n - 1.0) * (n + 1.0)
    g = np.sqrt(contrast + c * c)
    g = np.where(np.abs(g) > 1e-150, g, 1e-150)
    s, p = g + c, n * n * c + g
    brewster = (n * n + 1.0) * c * c - 1.0
    r_s = -contrast / s / s
    r_p = contrast / p * brewster / p
    slope_s = -2.0 * n * (c / g) / s / s
    slope_p = (
        (2.0 * n * (brewster + contrast * c * c) - 2.0 * contrast * brewster * (2.0 * n * c + n / g) / p)
        / p
        / p
    )
    gradient = np.conj(r_s) * slope_s + np.conj(r_p) * slope_p
    reflectance = 0.5 * (np.square(np.abs(r_s)) + np.square(np.abs(r_p)))
    return reflectance, np.asarray(gradient.real), np.asarray(-gradient.imag)


@np.errstate(under="ignore")
def schlick_with_slope(cos_d: ArrayLike, sin2_d: ArrayLike, f0: ArrayLike) -> tuple[Array, Array]:
    """F0 + (1 - F0)(1 - c)^5 (Schlick 1994, equation 15), and its derivative by F0.

    1 - c is taken as sin^2/(1 + c), which keeps its digits near normal incidence.

    Parameters
    ----------
    cos_d, sin2_d : array_like
        Cosine of the angle of incidence and the square of its sine.
    f0 : array_like
        Reflectance at normal incidence, 0 to 1; broadcasts with `cos_d`.

    Returns
    -------
    tuple of ndarray
        F and dF/dF0.
    """
    c, sin2 = np.asarray(cos_d, dtype=np.float64), np.asarray(sin2_d, dtype=np.float64)
    rise = (sin2 / (1.0 + c)) ** 5
    f0 = np.asarray(f0, dtype=np.float64)
    return f0 + (1.0 - f0) * rise, 1.0 - rise + np.zeros_like(f0)
