"""Beckmann facets with Smith's masking."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from analysis.models.base import KD, KS, Geometry, Lobe, Model, Parameter, product
from analysis.models.cook_torrance import M
from analysis.models.ggx import F0
from analysis.models.microfacet import facets_beckmann, facets_schlick

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, eq=False)
class Beckmann(Model):
    """f_r = kd/pi + ks F D G / (4 (N.L)(N.E)) with Beckmann facets (Walter et al. 2007, equations 20, 25).

    G is Smith's with heights correlated (Heitz 2014, equation 99), with the exact Lambda and not Walter's
    rational approximation; F is Schlick's.

    Parameters
    ----------
    kd, ks : float or array_like, shape (channels,)
        Diffuse albedo; specular scale.
    m : float or array_like, shape (channels,)
        Root-mean-square slope of the facets.
    f0 : float or array_like, shape (channels,)
        Reflectance of the facets at normal incidence.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    m: ArrayLike = M.default
    f0: ArrayLike = F0.default

    NAME: ClassVar[str] = "beckmann"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, M, F0)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by m and f0."""
        return product(facets_beckmann(geometry, self.m), facets_schlick(geometry, self.f0))


@dataclass(frozen=True, eq=False)
class BeckmannSeparable(Model):
    """`Beckmann` with masking and shadowing independent (Walter et al. 2007, equation 23).

    Parameters
    ----------
    kd, ks, m, f0 : float or array_like, shape (channels,)
        As in `Beckmann`.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    m: ArrayLike = M.default
    f0: ArrayLike = F0.default

    NAME: ClassVar[str] = "beckmann-separable"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, M, F0)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by m and f0."""
        mirrors = facets_beckmann(geometry, self.m, heights_correlated=False)
        return product(mirrors, facets_schlick(geometry, self.f0))
