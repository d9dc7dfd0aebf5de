"""Blinn's lobe about the normal, in the half vector, normalised exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, KS, Array, Geometry, Lobe, Model, Parameter
from analysis.models.microfacet import beckmann_width
from analysis.models.phong import EXPONENT as MIRROR_EXPONENT
from analysis.models.phong import cosine_power

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

EXPONENT = replace(MIRROR_EXPONENT, of_slope=lambda slope: 2.0 / beckmann_width(slope) ** 2)


def normalisation(exponent: Array) -> tuple[Array, Array]:
    """Factor that makes the lobe's albedo at normal incidence 1, and its derivative by the exponent.

    (n + 2)(n + 4) / (8 pi (2^(-n/2) + n)), Giesen 2009, "Phong normalization factor derivation"; the
    customary (n + 8)/(8 pi) of Akenine-Moller, Haines & Hoffman 2008 lies above it by up to 4 %, and so
    creates energy.

    Parameters
    ----------
    exponent : ndarray
        n, >= 0.

    Returns
    -------
    tuple of ndarray
        The factor in 1/sr and its derivative.
    """
    decay = np.exp2(-0.5 * exponent)
    factor = (exponent + 2.0) * (exponent + 4.0) / (8.0 * np.pi * (decay + exponent))
    logarithmic = (
        1.0 / (exponent + 2.0)
        + 1.0 / (exponent + 4.0)
        - (1.0 - 0.5 * np.log(2.0) * decay) / (decay + exponent)
    )
    return factor, factor * logarithmic


@dataclass(frozen=True, eq=False)
class BlinnPhong(Model):
    """f_r = kd/pi + ks c(exponent) (N.H)^exponent (Blinn 1977), c from `normalisation`.

    Reciprocal; ks is the lobe's albedo at normal incidence, where it is largest.

    Parameters
    ----------
    kd, ks : float or array_like, shape (channels,)
        Diffuse and specular albedo.
    exponent : float or array_like, shape (channels,)
        Sharpness of the lobe; about four times Phong's for the same highlight.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    exponent: ArrayLike = EXPONENT.default

    NAME: ClassVar[str] = "blinn-phong"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, EXPONENT)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """Return c (N.H)^exponent and its derivative by the exponent."""
        exponent = np.asarray(self.exponent)
        power, slope = cosine_power(-0.5 * np.log1p(geometry.tan2_h), exponent)
        factor, factor_slope = normalisation(exponent)
        return Lobe(factor * power, {"exponent": factor * slope + factor_slope * power})
