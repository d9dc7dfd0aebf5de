"""Bagher, Soler and Holzschuch's shifted gamma distribution, with its fitted masking."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, KS, Coordinate, Geometry, Kind, Lobe, Model, Parameter, product
from analysis.models.ggx import F0

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from analysis.models.base import Array

ALPHA = Parameter(
    "alpha",
    Kind.SHAPE,
    bounds=(1e-5, 1.0),
    minimum=1e-7,
    default=0.1,
    coordinate=Coordinate.LOG,
    scan=(1e-4, 1e-3, 0.01, 0.05, 0.2, 0.6),
    of_slope=float,
)
P = Parameter("p", Kind.SHAPE, bounds=(0.0, 2.0), minimum=-np.inf, default=0.5, scan=(0.3, 0.8))
F1 = Parameter("f1", Kind.SHAPE, bounds=(-1.0, 1.0), minimum=-np.inf, default=0.0, scan=(0.0,))
F0_ONE_START = Parameter(
    "f0",
    Kind.SHAPE,
    bounds=F0.bounds,
    minimum=F0.minimum,
    default=F0.default,
    coordinate=F0.coordinate,
    scan=(0.04, 0.5),
    maximum=F0.maximum,
)
THETA0 = Parameter(
    "theta0_rad", Kind.SHAPE, bounds=(-0.9, 1.3), minimum=-np.inf, default=-0.3, unit="rad", scan=(-0.3,)
)
K = Parameter(
    "k",
    Kind.SHAPE,
    bounds=(2.0, 100.0),
    minimum=0.0,
    default=20.0,
    coordinate=Coordinate.LOG,
    scan=(2.5, 4.0, 8.0, 20.0),
)
LAM = Parameter(
    "lam",
    Kind.SHAPE,
    bounds=(0.01, 100.0),
    minimum=1e-9,
    default=4.0,
    coordinate=Coordinate.LOG,
    scan=(1.0, 10.0, 100.0),
)
C = Parameter(
    "c", Kind.SHAPE, bounds=(1e-9, 10.0), minimum=0.0, default=1e-6, coordinate=Coordinate.LOG, scan=(1e-6,)
)
HORIZON_RAD = (1.4, 1.8)
"""Angles at which a search begins with masking complete; beyond theta0's bounds."""


@dataclass(frozen=True, eq=False)
class SGD(Model):
    """f_r = kd/pi + ks F D G(theta_i) G(theta_o) / (4 (N.L)(N.E)) (Bagher, Soler & Holzschuch 2012).

    D = exp(-tan^2/alpha) (1 + tan^2/alpha^2)^-p / cos^4, with cos_d = E.H
    F = f0 - f1 cos_d + (1 - f0)(1 - cos_d)^5, and
    G(theta) = max(0, 1 + lam (1 - exp(c max(0, theta - theta0)^k))).

    D is 1 at its peak, and ks holds the published norm, which has pi alpha Gamma(1 - p, alpha) and
    e^alpha alpha^p in its denominator: ks is no albedo. The four parameters of G follow the masking that D
    implies and are nearly degenerate: published sets run over 45 decades in c. Nothing keeps F from zero, or
    below, where f1 cos_d is more than the rest, nor the albedo from growing. Fit it to dense data only.

    Parameters
    ----------
    kd, ks : float or array_like, shape (channels,)
        Diffuse albedo; specular scale in 1/sr.
    alpha, p : float or array_like, shape (channels,)
        Width of the peak, and the power of its near flank.
    f0, f1 : float or array_like, shape (channels,)
        Reflectance of the facets, and its linear correction.
    theta0_rad, k, lam, c : float or array_like, shape (channels,)
        Masking and shadowing.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    alpha: ArrayLike = ALPHA.default
    p: ArrayLike = P.default
    f0: ArrayLike = F0.default
    f1: ArrayLike = F1.default
    theta0_rad: ArrayLike = THETA0.default
    k: ArrayLike = K.default
    lam: ArrayLike = LAM.default
    c: ArrayLike = C.default

    NAME: ClassVar[str] = "sgd"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, ALPHA, P, F0_ONE_START, F1, THETA0, K, LAM, C)

    @classmethod
    def likely(cls, shapes: dict[str, Array]) -> dict[str, Array]:
        """Put c where G falls to zero about the horizon: anywhere else G is 1, or there is no lobe."""
        bounds = C.bounds
        share = np.log(shapes["c"] / bounds[0]) / np.log(bounds[1] / bounds[0])
        foot = HORIZON_RAD[0] + share * (HORIZON_RAD[1] - HORIZON_RAD[0])
        c = np.log1p(1.0 / shapes["lam"]) / np.power(foot - shapes["theta0_rad"], shapes["k"])
        return shapes | {"c": np.clip(c, *bounds)}

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G G / (4 (N.L)(N.E)) and its derivatives by all shapes."""
        cosines = Lobe(0.25 / geometry.cos_i / geometry.cos_o, {})
        light = self._masking(np.arctan2(np.sqrt(geometry.sin2_i), geometry.cos_i))
        camera = self._masking(np.arctan2(np.sqrt(geometry.sin2_o), geometry.cos_o))
        return product(
            self._distribution(geometry.tan2_h), self._reflectance(geometry), light, camera, cosines
        )

    def _distribution(self, tan2: Array) -> Lobe:
        alpha, p = np.asarray(self.alpha), np.asarray(self.p)
        shifted = np.log1p(tan2 / np.square(alpha))
        value = np.exp(-tan2 / alpha - p * shifted) * np.square(1.0 + tan2)
        by_alpha = tan2 / np.square(alpha) + 2.0 * p * (tan2 / (np.square(alpha) + tan2)) / alpha
        return Lobe(value, {"alpha": value * by_alpha, "p": -value * shifted})

    def _reflectance(self, geometry: Geometry) -> Lobe:
        f0, f1 = np.asarray(self.f0), np.asarray(self.f1)
        # f0 - f1 cos_d, where both are close: with 1 - cos_d, which keeps its digits near normal incidence.
        drop = geometry.sin2_d / (1.0 + geometry.cos_d)
        rise = drop**5
        straight = geometry.cos_d + np.zeros_like(f1)
        value = (f0 - f1) + f1 * drop + (1.0 - f0) * rise
        return Lobe(value, {"f0": 1.0 - rise + np.zeros_like(f0), "f1": -straight})

    def _masking(self, theta: Array) -> Lobe:
        k, lam, c = np.asarray(self.k), np.asarray(self.lam), np.asarray(self.c)
        beyond = np.maximum(theta - np.asarray(self.theta0_rad), 1e-30)
        logarithm = np.log(beyond)
        power = np.exp(np.minimum(k * logarithm, 600.0))
        # G is zero long before the exponent reaches 50; the cap keeps what is thrown away finite.
        argument = np.minimum(c * power, 50.0)
        value = 1.0 - lam * np.expm1(argument)
        lit = value > 0.0
        steep = np.where(lit, -lam * np.exp(argument), 0.0)
        return Lobe(
            np.where(lit, value, 0.0),
            {
                "lam": np.where(lit, -np.expm1(argument), 0.0),
                "c": steep * np.where(lit, power, 0.0),
                "k": steep * argument * logarithm,
                "theta0_rad": -steep * argument * k / beyond,
            },
        )
