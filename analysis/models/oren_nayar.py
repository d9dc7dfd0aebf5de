"""Diffuse reflection of rough surfaces: Oren and Nayar's, and Fujii's, which keeps its energy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, Geometry, Kind, Lobe, OwnDiffuse, Parameter

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

SIGMA = Parameter(
    "sigma_rad",
    Kind.SHAPE,
    bounds=(0.0, 0.5 * np.pi),
    minimum=0.0,
    default=0.35,
    unit="rad",
    scan=(0.05, 0.2, 0.4, 0.8, 1.3),
)
ROUGHNESS = Parameter(
    "roughness",
    Kind.SHAPE,
    bounds=(0.0, 1.0),
    minimum=0.0,
    default=0.5,
    scan=(0.05, 0.2, 0.5, 0.8, 1.0),
    maximum=1.0,
)

LOSS = 0.5 - 2.0 / (3.0 * np.pi)
"""What roughness 1 takes from the level of `Fujii`, over what is left."""


@dataclass(frozen=True, eq=False)
class OrenNayar(OwnDiffuse):
    """f_r = kd/pi (A + B max(0, cos(phi_i - phi_o)) sin(larger) tan(smaller)).

    A = 1 - 0.5 s^2/(s^2 + 0.33), B = 0.45 s^2/(s^2 + 0.09) (Oren & Nayar 1994, equation 30, the qualitative
    model): V-grooves of Lambert's material, without light that goes between facets. kd is the facets' albedo;
    the surface's is less, by up to a third on rough ones, and up to half a percent more on smooth ones at
    grazing angles, which is the approximation's fault.

    Parameters
    ----------
    kd : float or array_like, shape (channels,)
        Albedo of the facets.
    sigma_rad : float or array_like, shape (channels,)
        Standard deviation of the facets' slope angle.
    """

    kd: ArrayLike = KD.default
    sigma_rad: ArrayLike = SIGMA.default

    NAME: ClassVar[str] = "oren-nayar"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, SIGMA)

    def terms_at(self, geometry: Geometry) -> dict[str, Lobe]:
        """Return the diffuse term and its derivative by sigma."""
        sigma = np.asarray(self.sigma_rad)
        square = np.square(sigma)
        # sin(larger) tan(smaller) cos(phi_i - phi_o) = dot product in the surface / larger cosine.
        towards = np.maximum(geometry.tangential_dot, 0.0) / np.maximum(geometry.cos_i, geometry.cos_o)
        level, rise = 1.0 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)
        level_slope = -0.33 * sigma / np.square(square + 0.33)
        rise_slope = 0.081 * sigma / np.square(square + 0.09)
        value = (level + rise * towards) / np.pi
        return {"kd": Lobe(value, {"sigma_rad": (level_slope + rise_slope * towards) / np.pi})}


@dataclass(frozen=True, eq=False)
class Fujii(OwnDiffuse):
    """f_r = kd/pi A (1 + roughness s/t), A = 1/(1 + (1/2 - 2/(3 pi)) roughness).

    s is the dot product in the surface, t the larger cosine where s > 0, else 1 (Fujii 2012, "A tiny
    improvement of Oren-Nayar reflectance model"; so written by Portsmouth, Kutz & Hill 2024). Without
    `OrenNayar`'s break at right angles, and with a directional albedo that never exceeds kd. The light that
    goes between facets, which Portsmouth et al. add, is in `EON`.

    Parameters
    ----------
    kd : float or array_like, shape (channels,)
        Albedo of the facets.
    roughness : float or array_like, shape (channels,)
        0 (Lambert) to 1.
    """

    kd: ArrayLike = KD.default
    roughness: ArrayLike = ROUGHNESS.default

    NAME: ClassVar[str] = "fujii"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, ROUGHNESS)
    CONSERVES: ClassVar[bool] = True

    def terms_at(self, geometry: Geometry) -> dict[str, Lobe]:
        """Return the diffuse term and its derivative by roughness."""
        return {"kd": fujii_term(geometry, self.roughness)}


def fujii_term(geometry: Geometry, roughness: ArrayLike) -> Lobe:
    """Return f_r of `Fujii` at kd = 1, in 1/sr, and its derivative by roughness.

    Parameters
    ----------
    geometry : Geometry
        The pairs of directions.
    roughness : float or array_like, shape (channels,)
        0 to 1.
    """
    r = np.asarray(roughness)
    dot = geometry.tangential_dot
    towards = dot / np.where(dot > 0.0, np.maximum(geometry.cos_i, geometry.cos_o), 1.0)
    # 1 + s cancels where light and camera graze from opposite sides: twice it is a sum of squares.
    sideways = geometry.half[..., 0:1], geometry.half[..., 1:2]
    squares = sum(np.square(x) for x in (*sideways, geometry.cos_i, geometry.cos_o))
    raised = np.where(dot > 0.0, 1.0 + towards, 0.5 * squares)
    level = 1.0 / (1.0 + LOSS * r)
    value = level * ((1.0 - r) + r * raised) / np.pi
    return Lobe(value, {"roughness": np.square(level) * (towards - LOSS) / np.pi})
