"""Lafortune's generalised cosine lobe, about the mirror direction and back to the light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, KS, Coordinate, Geometry, Kind, Lobe, Model, Parameter

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

RATIO = Parameter(
    "ratio",
    Kind.SHAPE,
    bounds=(0.3, 3.0),
    minimum=0.0,
    default=0.9,
    coordinate=Coordinate.LOG,
    scan=(0.5, 0.8, 0.95, 1.05, 1.5),
)
EXPONENT = Parameter(
    "exponent",
    Kind.SHAPE,
    bounds=(0.1, 500.0),
    minimum=0.0,
    default=20.0,
    coordinate=Coordinate.LOG,
    scan=(0.5, 1.5, 4.0, 10.0, 25.0, 60.0, 150.0, 400.0),
)


def _lobe(geometry: Geometry, sideways: float, ratio: ArrayLike, exponent: ArrayLike) -> Lobe:
    """(sideways (L_x E_x + L_y E_y) + ratio L_z E_z)^exponent, 0 where the base is not positive."""
    n = np.asarray(exponent)
    along = geometry.cos_i * geometry.cos_o
    base = sideways * geometry.tangential_dot + np.asarray(ratio) * along
    lit = base > 0.0
    safe = np.where(lit, base, 1.0)
    logarithm = np.log(safe)
    value = np.where(lit, np.exp(n * logarithm), 0.0)
    return Lobe(value, {"ratio": value * n * (along / safe), "exponent": value * logarithm})


@dataclass(frozen=True, eq=False)
class Lafortune(Model):
    """f_r = kd/pi + ks (ratio L_z E_z - L_x E_x - L_y E_y)^exponent (Lafortune et al. 1997, equation 9).

    With C_x = C_y = -1 and C_z = ratio, as the size of C is a factor that ks takes. ratio = 1 is Phong's lobe
    without a norm; below 1 the lobe leans to grazing angles and grows there, as off-specular peaks do.

    Parameters
    ----------
    kd, ks : float or array_like, shape (channels,)
        Diffuse albedo; specular scale in 1/sr.
    ratio : float or array_like, shape (channels,)
        C_z / |C_x|.
    exponent : float or array_like, shape (channels,)
        Sharpness of the lobe.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    ratio: ArrayLike = RATIO.default
    exponent: ArrayLike = EXPONENT.default

    NAME: ClassVar[str] = "lafortune"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, RATIO, EXPONENT)

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """Return the lobe and its derivatives by ratio and exponent."""
        return _lobe(geometry, -1.0, self.ratio, self.exponent)


@dataclass(frozen=True, eq=False)
class LafortuneRetro(Model):
    """`Lafortune` with C_x = C_y = +1: the lobe points back to the light (Lafortune et al. 1997).

    Parameters
    ----------
    kd, ks, ratio, exponent : float or array_like, shape (channels,)
        As in `Lafortune`.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    ratio: ArrayLike = RATIO.default
    exponent: ArrayLike = EXPONENT.default

    NAME: ClassVar[str] = "lafortune-retro"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, RATIO, EXPONENT)

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """Return the lobe and its derivatives by ratio and exponent."""
        return _lobe(geometry, 1.0, self.ratio, self.exponent)
