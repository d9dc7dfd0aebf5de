"""Torrance and Sparrow's D G F / (N.E) with the three classical distributions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, KS, Coordinate, Geometry, Kind, Lobe, Model, Parameter, product
from analysis.models.cook_torrance import IOR
from analysis.models.microfacet import beckmann_width, facets_dielectric, v_groove_visibility

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

HALF_WIDTH = Parameter(
    "half_width_rad",
    Kind.SHAPE,
    bounds=(0.003, 1.2),
    minimum=1e-6,
    default=0.2,
    unit="rad",
    coordinate=Coordinate.LOG,
    scan=(0.005, 0.012, 0.025, 0.05, 0.08, 0.12, 0.18, 0.27, 0.4, 0.6, 0.9),
    of_slope=lambda slope: float(np.arctan(np.sqrt(np.log(2.0)) * beckmann_width(slope))),
    maximum=1.5,
)


def _in_grooves(geometry: Geometry, distribution: Lobe, ior: ArrayLike) -> Lobe:
    """D G F / ((N.L)(N.E))."""
    grooves = Lobe(v_groove_visibility(geometry), {})
    return product(distribution, grooves, facets_dielectric(geometry, ior))


@dataclass(frozen=True, eq=False)
class TorranceSparrowCosine(Model):
    """f_r = kd/pi + ks D G F / ((N.L)(N.E)), D = cos^c(alpha) (Torrance & Sparrow 1967; Blinn 1977, D1).

    The shading formula D G F / (N.E) has the cosine of the light in it already, so the BRDF has both cosines
    in its denominator, and is reciprocal. D is 1 at its peak and not normalised: a narrower lobe is not a
    higher one, and ks is no albedo. c is set by the angle at which D falls to one half.

    Parameters
    ----------
    kd, ks : float or array_like, shape (channels,)
        Diffuse albedo; specular scale in 1/sr.
    half_width_rad : float or array_like, shape (channels,)
        Angle of H to N at which D is one half.
    ior : float or array_like, shape (channels,)
        Index of refraction of the facets, >= 1.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    half_width_rad: ArrayLike = HALF_WIDTH.default
    ior: ArrayLike = IOR.default

    NAME: ClassVar[str] = "torrance-sparrow-cosine"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, HALF_WIDTH, IOR)

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """D G F / ((N.L)(N.E)) and its derivatives by half width and ior."""
        tangent = np.tan(np.asarray(self.half_width_rad))
        power = 2.0 * np.log(2.0) / np.log1p(np.square(tangent))
        logarithm = -0.5 * np.log1p(geometry.tan2_h)
        density = np.exp(power * logarithm)
        slope = density * logarithm * (-np.square(power) * tangent / np.log(2.0))
        return _in_grooves(geometry, Lobe(density, {"half_width_rad": slope}), self.ior)


@dataclass(frozen=True, eq=False)
class TorranceSparrowGauss(Model):
    """`TorranceSparrowCosine` with D = exp(-(c alpha)^2) (Torrance & Sparrow 1967; Blinn 1977, D2).

    Parameters
    ----------
    kd, ks, half_width_rad, ior : float or array_like, shape (channels,)
        As in `TorranceSparrowCosine`.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    half_width_rad: ArrayLike = HALF_WIDTH.default
    ior: ArrayLike = IOR.default

    NAME: ClassVar[str] = "torrance-sparrow-gauss"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, HALF_WIDTH, IOR)

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """D G F / ((N.L)(N.E)) and its derivatives by half width and ior."""
        half_width = np.asarray(self.half_width_rad)
        exponent = np.log(2.0) * np.square(np.arctan(np.sqrt(geometry.tan2_h)) / half_width)
        density = np.exp(-exponent)
        slope = density * exponent * (2.0 / half_width)
        return _in_grooves(geometry, Lobe(density, {"half_width_rad": slope}), self.ior)


@dataclass(frozen=True, eq=False)
class TorranceSparrowTrowbridgeReitz(Model):
    """`TorranceSparrowCosine` with D = (c^2 / (cos^2(alpha) (c^2 - 1) + 1))^2.

    Trowbridge & Reitz 1975; Blinn 1977, D3: the shape of GGX, 1 at its peak.

    Parameters
    ----------
    kd, ks, half_width_rad, ior : float or array_like, shape (channels,)
        As in `TorranceSparrowCosine`.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    half_width_rad: ArrayLike = HALF_WIDTH.default
    ior: ArrayLike = IOR.default

    NAME: ClassVar[str] = "torrance-sparrow-trowbridge-reitz"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, HALF_WIDTH, IOR)

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """D G F / ((N.L)(N.E)) and its derivatives by half width and ior."""
        half_width = np.asarray(self.half_width_rad)
        # D = 1/2 at the half width: c^2 = sin^2 / (sqrt(2) - cos^2), here without a difference.
        sine2, gap = np.square(np.sin(half_width)), np.sqrt(2.0) - 1.0
        c2 = sine2 / (gap + sine2)
        c2_slope = np.sin(2.0 * half_width) * gap / np.square(gap + sine2)
        ratio = (1.0 + geometry.tan2_h) / (geometry.tan2_h + c2)
        density = np.square(c2 * ratio)
        slope = 2.0 * c2 * ratio * ratio * (geometry.tan2_h / (geometry.tan2_h + c2)) * c2_slope
        return _in_grooves(geometry, Lobe(density, {"half_width_rad": slope}), self.ior)
