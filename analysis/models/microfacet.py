"""The parts of microfacet models: distribution of slopes, masking and shadowing, reflectance."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis.models.base import Lobe, product
from analysis.models.fresnel import conductor_with_slopes, dielectric_with_slope, schlick_with_slope

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from analysis.models.base import Array, Geometry


def beckmann_width(slope: float) -> float:
    """Return Beckmann's m at a mean absolute slope of the facets along a line (Dupuy et al. 2015)."""
    return float(np.sqrt(np.pi)) * slope


def beckmann(tan2_h: Array, m: Array) -> tuple[Array, Array]:
    """Beckmann's distribution, normalised to a projected area of 1, and its derivative by m.

    D = exp(-tan^2(alpha)/m^2) / (pi m^2 cos^4(alpha)) (Beckmann & Spizzichino 1963; with the pi, Walter et
    al. 2007, equation 25), with cos^-4 = (1 + tan^2)^2 finite for every `Geometry.tan2_h`, so that the
    exponential takes it to zero at grazing alpha.

    Parameters
    ----------
    tan2_h : ndarray, shape (..., 1)
        Squared tangent of the angle alpha between half vector and normal.
    m : ndarray, shape () or (channels,)
        Root-mean-square slope of the facets.

    Returns
    -------
    tuple of ndarray, shape (..., 1 or channels)
        D in 1/sr and dD/dm.
    """
    m2 = np.square(m)
    steepness = tan2_h / m2
    density = np.exp(-steepness) * np.square(1.0 + tan2_h) / (np.pi * m2)
    return density, density * (2.0 / m) * (steepness - 1.0)


def v_groove_visibility(geometry: Geometry) -> Array:
    """G / ((N.L)(N.E)) for V-shaped grooves.

    G = min(1, 2 (N.H)(N.E)/(E.H), 2 (N.H)(N.L)/(E.H)) (Torrance & Sparrow 1967; Blinn 1977). The division by
    the cosines is done by hand: of the last two terms the smaller one leaves 2 (N.H)/((E.H) max(N.L, N.E)),
    which has no 0/0 where both cosines vanish.

    Parameters
    ----------
    geometry : Geometry
        The pairs of directions.

    Returns
    -------
    ndarray, shape (..., 1)
        G / ((N.L)(N.E)).
    """
    unshadowed = 1.0 / (geometry.cos_i * geometry.cos_o)
    grooved = 2.0 * geometry.cos_h / (geometry.cos_d * np.maximum(geometry.cos_i, geometry.cos_o))
    return np.minimum(unshadowed, grooved)


def ggx(tan2_h: Array, alpha: Array) -> tuple[Array, Array]:
    """GGX distribution, normalised to a projected area of 1, and its derivative by alpha.

    D = alpha^2 / (pi cos^4 (alpha^2 + tan^2)^2) (Trowbridge & Reitz 1975; Walter et al. 2007, equation 33).

    Parameters
    ----------
    tan2_h : ndarray, shape (..., 1)
        Squared tangent of the angle between half vector and normal.
    alpha : ndarray, shape () or (channels,)
        Width: D falls to a quarter of its peak, but for cos^-4, where the tangent is alpha.

    Returns
    -------
    tuple of ndarray, shape (..., 1 or channels)
        D in 1/sr and dD/dalpha.
    """
    a2 = np.square(alpha)
    ratio = (1.0 + tan2_h) / (a2 + tan2_h)
    density = a2 * np.square(ratio) / np.pi
    return density, density * (2.0 / alpha) * (tan2_h - a2) / (tan2_h + a2)


class Smith(NamedTuple):
    """What Smith's masking needs of one direction.

    Attributes
    ----------
    value : ndarray
        cos (1 + Lambda), Lambda the auxiliary function: finite where cos vanishes.
    slopes : dict of str to ndarray
        Its derivative by each width.
    """

    value: Array
    slopes: dict[str, Array]


def smith_ggx(cosine: Array, sine2: Array, alpha: Array) -> Smith:
    """GGX: cos (1 + Lambda) = (cos + sqrt(cos^2 + alpha^2 sin^2))/2 (Walter et al. 2007, equation 34)."""
    root = np.hypot(cosine, alpha * np.sqrt(sine2))
    return Smith(0.5 * (cosine + root), {"alpha": 0.5 * alpha * sine2 / root})


def smith_beckmann(cosine: Array, sine2: Array, m: Array) -> Smith:
    """Return cos (1 + Lambda) of Beckmann's distribution, and its derivative by m.

    Lambda = (erf(a) - 1)/2 + exp(-a^2)/(2 a sqrt(pi)), a = cos/(m sin) (Smith 1967; Walter et al. 2007,
    section 5.2), times the cosine by hand.
    """
    from scipy.special import erfc

    run = np.maximum(m * np.sqrt(sine2), 1e-150)
    a = cosine / run
    bell = np.exp(-np.square(a)) / np.sqrt(np.pi)
    slope = 0.5 * (run / m) * bell
    return Smith(cosine * (1.0 - 0.5 * erfc(a)) + 0.5 * run * bell, {"m": slope})


def correlated(cos_i: Array, cos_o: Array, light: Smith, camera: Smith) -> Lobe:
    """G / ((N.L)(N.E)) of Smith's model with heights correlated, and its derivatives.

    G = 1/(1 + Lambda_i + Lambda_o) (Ross, Dion & Potvin 2005; Heitz 2014, equation 99).

    Parameters
    ----------
    cos_i, cos_o : ndarray, shape (..., 1)
        N.L and N.E.
    light, camera : Smith
        Of the two directions.
    """
    # (N.L)(N.E)(1 + Lambda_i + Lambda_o): each value holds one cosine that is counted twice.
    excess = light.value - cos_i
    value = 1.0 / (cos_o * excess + cos_i * camera.value)
    slopes = {
        name: -value * (value * (cos_o * slope + cos_i * camera.slopes[name]))
        for name, slope in light.slopes.items()
    }
    return Lobe(value, slopes)


def separable(light: Smith, camera: Smith) -> Lobe:
    """G / ((N.L)(N.E)) of Smith's model with masking and shadowing independent: G1(L) G1(E).

    G1 = 1/(1 + Lambda) (Smith 1967; Walter et al. 2007, equation 23).
    """
    inverse_i, inverse_o = 1.0 / light.value, 1.0 / camera.value
    value = inverse_i * inverse_o
    slopes = {
        name: -(value * (inverse_i * slope) + value * (inverse_o * camera.slopes[name]))
        for name, slope in light.slopes.items()
    }
    return Lobe(value, slopes)


def facets_schlick(geometry: Geometry, f0: ArrayLike) -> Lobe:
    """Schlick's reflectance of the facet that mirrors; see `schlick_with_slope`."""
    value, slope = schlick_with_slope(geometry.cos_d, geometry.sin2_d, f0)
    return Lobe(value, {"f0": slope})


def facets_dielectric(geometry: Geometry, ior: ArrayLike) -> Lobe:
    """Exact reflectance of a dielectric facet; see `dielectric_with_slope`."""
    value, slope = dielectric_with_slope(geometry.cos_d, ior)
    return Lobe(value, {"ior": slope})


def facets_conductor(geometry: Geometry, eta: ArrayLike, k: ArrayLike) -> Lobe:
    """Exact reflectance of a metal facet; see `conductor_with_slopes`."""
    value, by_eta, by_k = conductor_with_slopes(geometry.cos_d, eta, k)
    return Lobe(value, {"eta": by_eta, "k": by_k})


def facets_ggx(geometry: Geometry, alpha: ArrayLike, *, heights_correlated: bool = True) -> Lobe:
    """D G / (4 (N.L)(N.E)) of GGX with Smith's masking: the lobe of facets that are perfect mirrors."""
    width = np.asarray(alpha)
    light = smith_ggx(geometry.cos_i, geometry.sin2_i, width)
    camera = smith_ggx(geometry.cos_o, geometry.sin2_o, width)
    density, slope = ggx(geometry.tan2_h, width)
    mirrors = Lobe(0.25 * density, {"alpha": 0.25 * slope})
    return product(mirrors, _visibility(geometry, light, camera, heights_correlated=heights_correlated))


def facets_beckmann(geometry: Geometry, m: ArrayLike, *, heights_correlated: bool = True) -> Lobe:
    """D G / (4 (N.L)(N.E)) of Beckmann's distribution with Smith's masking; as `facets_ggx`."""
    width = np.asarray(m)
    light = smith_beckmann(geometry.cos_i, geometry.sin2_i, width)
    camera = smith_beckmann(geometry.cos_o, geometry.sin2_o, width)
    density, slope = beckmann(geometry.tan2_h, width)
    mirrors = Lobe(0.25 * density, {"m": 0.25 * slope})
    return product(mirrors, _visibility(geometry, light, camera, heights_correlated=heights_correlated))


def _visibility(geometry: Geometry, light: Smith, camera: Smith, *, heights_correlated: bool) -> Lobe:
    """G / ((N.L)(N.E)) from Smith's term of each side, for heights that correlate or not."""
    if heights_correlated:
        return correlated(geometry.cos_i, geometry.cos_o, light, camera)
    return separable(light, camera)


def facets_in_grooves(geometry: Geometry, density: Array, slope: Array, width: str) -> Lobe:
    """D G / (4 (N.L)(N.E)) with V-groove masking, which does not depend on the width."""
    visibility = 0.25 * v_groove_visibility(geometry)
    return Lobe(density * visibility, {width: slope * visibility})
