"""The parts of microfacet models: distribution of slopes, masking and shadowing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from analysis.models.base import Array, Geometry


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
