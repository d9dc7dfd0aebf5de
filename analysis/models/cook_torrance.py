"""Cook and Torrance's microfacet lobe: as published in 1982, and with today's normalisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, KS, Coordinate, Geometry, Kind, Lobe, Model, Parameter
from analysis.models.fresnel import dielectric_with_slope
from analysis.models.microfacet import beckmann, beckmann_width, v_groove_visibility

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

M = Parameter(
    "m",
    Kind.SHAPE,
    bounds=(0.003, 3.0),
    minimum=1e-6,
    default=0.2,
    coordinate=Coordinate.LOG,
    scan=(0.005, 0.01, 0.02, 0.035, 0.05, 0.075, 0.1, 0.14, 0.2, 0.28, 0.4, 0.55, 0.8, 1.2, 2.0),
    of_slope=beckmann_width,
)
IOR = Parameter(
    "ior",
    Kind.SHAPE,
    bounds=(1.001, 100.0),
    minimum=1.0,
    default=1.5,
    coordinate=Coordinate.LOG_ABOVE_ONE,
    scan=(1.02, 1.15, 1.5, 2.2, 5.0, 15.0, 100.0),
)


def _lobe(geometry: Geometry, m: ArrayLike, ior: ArrayLike, denominator: float) -> Lobe:
    """F D G / (denominator (N.L)(N.E)), with D normalised to a projected area of 1."""
    density, density_slope = beckmann(geometry.tan2_h, np.asarray(m))
    fresnel, fresnel_slope = dielectric_with_slope(geometry.cos_d, ior)
    visibility = v_groove_visibility(geometry) / denominator
    return Lobe(
        density * visibility * fresnel,
        {"m": density_slope * visibility * fresnel, "ior": density * visibility * fresnel_slope},
    )


@dataclass(frozen=True, eq=False)
class CookTorrance(Model):
    """f_r = kd/pi + ks F D G / (4 (N.L)(N.E)), D normalised to a projected area of 1.

    Beckmann's D with 1/(pi m^2 cos^4 alpha), V-groove G, exact dielectric F: Cook & Torrance 1982 with the
    denominator that the geometry of reflection requires (Walter et al. 2007, equation 20). A quarter of
    `CookTorrance1982` at equal ks.

    Parameters
    ----------
    kd, ks : float or array_like, shape (channels,)
        Diffuse albedo; specular scale (1 for a surface that is all facets).
    m : float or array_like, shape (channels,)
        Root-mean-square slope of the facets (Beckmann's m).
    ior : float or array_like, shape (channels,)
        Index of refraction of the facets, >= 1.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    m: ArrayLike = M.default
    ior: ArrayLike = IOR.default

    NAME: ClassVar[str] = "cook-torrance"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, M, IOR)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by m and ior."""
        return _lobe(geometry, self.m, self.ior, 4.0)


@dataclass(frozen=True, eq=False)
class CookTorrance1982(Model):
    """f_r = kd/pi + ks F D G / (pi (N.L)(N.E)), D = exp(-tan^2(alpha)/m^2) / (m^2 cos^4 alpha).

    As in Cook & Torrance 1982: pi in the denominator and none in D. With the normalised D_n = D/pi this is
    ks F D_n G / ((N.L)(N.E)): exactly four times `CookTorrance` at equal ks.

    Parameters
    ----------
    kd, ks, m, ior : float or array_like, shape (channels,)
        As in `CookTorrance`.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    m: ArrayLike = M.default
    ior: ArrayLike = IOR.default

    NAME: ClassVar[str] = "cook-torrance-1982"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, M, IOR)

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (pi (N.L)(N.E)) and its derivatives by m and ior."""
        return _lobe(geometry, self.m, self.ior, 1.0)
