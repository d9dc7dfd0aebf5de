"""Phong's lobe about the mirror direction: as published (1975), and normalised (1994)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, KS, Array, Coordinate, Geometry, Kind, Lobe, Model, Parameter
from analysis.models.microfacet import beckmann_width

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

EXPONENT = Parameter(
    "exponent",
    Kind.SHAPE,
    bounds=(0.1, 1e6),
    minimum=0.0,
    default=20.0,
    coordinate=Coordinate.LOG,
    scan=(0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1e3, 2e3, 5e3, 2e4, 1e5),
    # The mirror direction turns twice as far as a facet: cos^n(2 x) is about Beckmann's with m^2 = 1/(2n).
    of_slope=lambda slope: 0.5 / beckmann_width(slope) ** 2,
)


def cosine_power(log_cosine: Array, exponent: Array) -> tuple[Array, Array]:
    """Power of a cosine, and its derivative by the exponent.

    Parameters
    ----------
    log_cosine : ndarray, shape (..., 1)
        Natural logarithm of the cosine; -inf, where the cosine is not positive, gives 0 for every exponent.
    exponent : ndarray, shape () or (channels,)
        The exponent, >= 0.

    Returns
    -------
    tuple of ndarray, shape (..., 1 or channels)
        cosine**exponent and cosine**exponent * log(cosine).
    """
    lit = np.isfinite(log_cosine)
    logarithm = np.where(lit, log_cosine, 0.0)
    power = np.where(lit, np.exp(exponent * logarithm), 0.0)
    return power, power * logarithm


@dataclass(frozen=True, eq=False)
class Phong(Model):
    """f_r = kd/pi + ks (R.E)^exponent / (N.L): Phong 1975 as a BRDF.

    Phong's specular term has no cosine of the light, so the BRDF has one in the denominator: it is not
    reciprocal, and not bounded for grazing light. It is here because a great deal of published work used it.

    Parameters
    ----------
    kd, ks : float or array_like, shape (channels,)
        Diffuse albedo; specular scale in 1/sr.
    exponent : float or array_like, shape (channels,)
        Sharpness of the lobe.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    exponent: ArrayLike = EXPONENT.default

    NAME: ClassVar[str] = "phong"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, EXPONENT)
    RECIPROCAL: ClassVar[bool] = False

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """(R.E)^exponent / (N.L) and its derivative by the exponent."""
        power, slope = cosine_power(geometry.log_mirror, np.asarray(self.exponent))
        return Lobe(power / geometry.cos_i, {"exponent": slope / geometry.cos_i})


@dataclass(frozen=True, eq=False)
class ModifiedPhong(Model):
    """f_r = kd/pi + ks (exponent + 2)/(2 pi) (R.E)^exponent (Lafortune & Willems 1994, equation 3).

    Reciprocal; ks is the lobe's albedo at normal incidence, where it is largest.

    Parameters
    ----------
    kd, ks : float or array_like, shape (channels,)
        Diffuse and specular albedo.
    exponent : float or array_like, shape (channels,)
        Sharpness of the lobe.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    exponent: ArrayLike = EXPONENT.default

    NAME: ClassVar[str] = "modified-phong"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, EXPONENT)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """(exponent + 2)/(2 pi) (R.E)^exponent and its derivative by the exponent."""
        exponent = np.asarray(self.exponent)
        power, slope = cosine_power(geometry.log_mirror, exponent)
        scale = (exponent + 2.0) / (2.0 * np.pi)
        return Lobe(scale * power, {"exponent": scale * slope + power / (2.0 * np.pi)})
