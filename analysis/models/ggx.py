"""GGX (Trowbridge-Reitz) facets with Smith's masking, by the reflectance of the facets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from analysis.models.base import KD, KS, Coordinate, Geometry, Kind, Lobe, Model, Parameter, product
from analysis.models.cook_torrance import IOR
from analysis.models.microfacet import facets_conductor, facets_dielectric, facets_ggx, facets_schlick

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

ALPHA = Parameter(
    "alpha",
    Kind.SHAPE,
    bounds=(0.001, 2.0),
    minimum=1e-6,
    default=0.2,
    coordinate=Coordinate.LOG,
    scan=(0.003, 0.007, 0.015, 0.03, 0.05, 0.08, 0.12, 0.18, 0.27, 0.4, 0.6, 1.0),
    of_slope=float,
)
F0 = Parameter(
    "f0",
    Kind.SHAPE,
    bounds=(0.001, 1.0),
    minimum=0.0,
    default=0.04,
    coordinate=Coordinate.LOG,
    scan=(0.004, 0.04, 0.3, 1.0),
    maximum=1.0,
)
ETA = Parameter(
    "eta",
    Kind.SHAPE,
    bounds=(0.05, 10.0),
    minimum=0.01,
    default=1.0,
    coordinate=Coordinate.LOG,
    scan=(0.2, 1.0, 3.0),
)
K = Parameter(
    "k",
    Kind.SHAPE,
    bounds=(0.05, 15.0),
    minimum=0.0,
    default=5.0,
    coordinate=Coordinate.LOG,
    scan=(0.5, 2.0, 6.0),
)


@dataclass(frozen=True, eq=False)
class GGX(Model):
    """f_r = kd/pi + ks F D G / (4 (N.L)(N.E)) with GGX facets (Walter et al. 2007, equation 20).

    G is Smith's with heights correlated (Heitz 2014, equation 99), F Schlick's. ks = 1 is a surface that is
    all facets; of ks and f0 the samples often hold the product alone.

    Parameters
    ----------
    kd, ks : float or array_like, shape (channels,)
        Diffuse albedo; specular scale.
    alpha : float or array_like, shape (channels,)
        Width of the distribution itself (not a roughness whose square it is).
    f0 : float or array_like, shape (channels,)
        Reflectance of the facets at normal incidence.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    alpha: ArrayLike = ALPHA.default
    f0: ArrayLike = F0.default

    NAME: ClassVar[str] = "ggx"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, ALPHA, F0)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by alpha and f0."""
        return product(facets_ggx(geometry, self.alpha), facets_schlick(geometry, self.f0))


@dataclass(frozen=True, eq=False)
class GGXSeparable(Model):
    """`GGX` with masking and shadowing independent: G = G1(L) G1(E) (Walter et al. 2007, equation 23).

    Darker than `GGX`, most of all at grazing angles; what most renderers before 2014 computed.

    Parameters
    ----------
    kd, ks, alpha, f0 : float or array_like, shape (channels,)
        As in `GGX`.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    alpha: ArrayLike = ALPHA.default
    f0: ArrayLike = F0.default

    NAME: ClassVar[str] = "ggx-separable"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, ALPHA, F0)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by alpha and f0."""
        mirrors = facets_ggx(geometry, self.alpha, heights_correlated=False)
        return product(mirrors, facets_schlick(geometry, self.f0))


@dataclass(frozen=True, eq=False)
class GGXDielectric(Model):
    """`GGX` with the exact reflectance of a dielectric in place of Schlick's.

    Parameters
    ----------
    kd, ks, alpha : float or array_like, shape (channels,)
        As in `GGX`.
    ior : float or array_like, shape (channels,)
        Index of refraction of the facets, >= 1.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    alpha: ArrayLike = ALPHA.default
    ior: ArrayLike = IOR.default

    NAME: ClassVar[str] = "ggx-dielectric"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, ALPHA, IOR)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by alpha and ior."""
        return product(facets_ggx(geometry, self.alpha), facets_dielectric(geometry, self.ior))


@dataclass(frozen=True, eq=False)
class GGXConductor(Model):
    """`GGX` with the exact reflectance of a metal of index eta + i k in place of Schlick's.

    Angles below grazing hardly tell eta from k and ks: fix what a table gives.

    Parameters
    ----------
    kd, ks, alpha : float or array_like, shape (channels,)
        As in `GGX`.
    eta, k : float or array_like, shape (channels,)
        Real and imaginary part of the index of refraction.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    alpha: ArrayLike = ALPHA.default
    eta: ArrayLike = ETA.default
    k: ArrayLike = K.default

    NAME: ClassVar[str] = "ggx-conductor"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, ALPHA, ETA, K)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by alpha, eta and k."""
        return product(facets_ggx(geometry, self.alpha), facets_conductor(geometry, self.eta, self.k))
