"""Cook and Torrance's V-grooves with other facets: Schlick's reflectance, metals, GGX."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, KS, Geometry, Lobe, Model, Parameter, product
from analysis.models.cook_torrance import M
from analysis.models.ggx import ALPHA, ETA, F0, K
from analysis.models.microfacet import beckmann, facets_conductor, facets_in_grooves, facets_schlick, ggx

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, eq=False)
class CookTorranceSchlick(Model):
    """`CookTorrance` with Schlick's reflectance (1994, equation 15) in place of the exact dielectric.

    Parameters
    ----------
    kd, ks, m : float or array_like, shape (channels,)
        As in `CookTorrance`.
    f0 : float or array_like, shape (channels,)
        Reflectance of the facets at normal incidence.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    m: ArrayLike = M.default
    f0: ArrayLike = F0.default

    NAME: ClassVar[str] = "cook-torrance-schlick"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, M, F0)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by m and f0."""
        density, slope = beckmann(geometry.tan2_h, np.asarray(self.m))
        return product(facets_in_grooves(geometry, density, slope, "m"), facets_schlick(geometry, self.f0))


@dataclass(frozen=True, eq=False)
class CookTorranceConductor(Model):
    """`CookTorrance` with the exact reflectance of a metal of index eta + i k.

    Parameters
    ----------
    kd, ks, m : float or array_like, shape (channels,)
        As in `CookTorrance`.
    eta, k : float or array_like, shape (channels,)
        Real and imaginary part of the index of refraction.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    m: ArrayLike = M.default
    eta: ArrayLike = ETA.default
    k: ArrayLike = K.default

    NAME: ClassVar[str] = "cook-torrance-conductor"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, M, ETA, K)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by m, eta and k."""
        density, slope = beckmann(geometry.tan2_h, np.asarray(self.m))
        mirrors = facets_in_grooves(geometry, density, slope, "m")
        return product(mirrors, facets_conductor(geometry, self.eta, self.k))


@dataclass(frozen=True, eq=False)
class CookTorranceGGX(Model):
    """`CookTorranceSchlick` with GGX facets in place of Beckmann's.

    Parameters
    ----------
    kd, ks, alpha, f0 : float or array_like, shape (channels,)
        As in `GGX`.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    alpha: ArrayLike = ALPHA.default
    f0: ArrayLike = F0.default

    NAME: ClassVar[str] = "cook-torrance-ggx"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, ALPHA, F0)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by alpha and f0."""
        density, slope = ggx(geometry.tan2_h, np.asarray(self.alpha))
        mirrors = facets_in_grooves(geometry, density, slope, "alpha")
        return product(mirrors, facets_schlick(geometry, self.f0))
