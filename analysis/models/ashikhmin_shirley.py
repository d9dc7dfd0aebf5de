"""Ashikhmin and Shirley's anisotropic Phong model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.anisotropic import AXIS
from analysis.models.base import KD, KS, Coordinate, Geometry, Kind, Lobe, OwnDiffuse, Parameter, product
from analysis.models.ggx import F0
from analysis.models.microfacet import beckmann_width, facets_schlick

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from analysis.models.base import Array


def _exponent(name: str, default: float) -> Parameter:
    return Parameter(
        name,
        Kind.SHAPE,
        bounds=(0.1, 1e5),
        minimum=0.0,
        default=default,
        coordinate=Coordinate.LOG,
        scan=(3.0, 30.0, 300.0, 3000.0),
        of_slope=lambda slope: 2.0 / beckmann_width(slope) ** 2,
    )


EXPONENT_X, EXPONENT_Y = _exponent("exponent_x", 10.0), _exponent("exponent_y", 100.0)


@dataclass(frozen=True, eq=False)
class AshikhminShirley(OwnDiffuse):
    """Anisotropic Phong lobe with Schlick's F over a diffuse term that gives way to it (2000, eq. 4, 5).

    f_r = kd 28/(23 pi) (1 - f0) (1 - (1 - N.L/2)^5) (1 - (1 - N.E/2)^5)
        + ks sqrt((n_x + 1)(n_y + 1))/(8 pi) (N.H)^(n_x cos^2 + n_y sin^2) F / ((E.H) max(N.L, N.E)),

    cos and sin of the azimuth of H. ks = 1 is the published model.

    Parameters
    ----------
    kd, ks : float or array_like, shape (channels,)
        Diffuse and specular scale; kd is the albedo of what lies below the surface.
    exponent_x, exponent_y : float or array_like, shape (channels,)
        Sharpness along and across the axis.
    axis_rad : float or array_like, shape (channels,)
        Azimuth of the axis in the sample frame.
    f0 : float or array_like, shape (channels,)
        Reflectance of the facets at normal incidence.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    exponent_x: ArrayLike = EXPONENT_X.default
    exponent_y: ArrayLike = EXPONENT_Y.default
    axis_rad: ArrayLike = AXIS.default
    f0: ArrayLike = F0.default

    NAME: ClassVar[str] = "ashikhmin-shirley"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, EXPONENT_X, EXPONENT_Y, AXIS, F0)
    ISOTROPIC: ClassVar[bool] = False
    CONSERVES: ClassVar[bool] = True

    def terms_at(self, geometry: Geometry) -> dict[str, Lobe]:
        """Return both terms and their derivatives by exponents, axis and f0."""
        rest = np.asarray(1.0 - np.asarray(self.f0))
        below = 28.0 / (23.0 * np.pi) * _entered(geometry.cos_i) * _entered(geometry.cos_o)
        diffuse = Lobe(below * rest, {"f0": -below + np.zeros_like(rest)})
        return {"kd": diffuse, "ks": product(self._facets(geometry), facets_schlick(geometry, self.f0))}

    def _facets(self, geometry: Geometry) -> Lobe:
        """Everything of the specular term but F."""
        n_x, n_y = np.asarray(self.exponent_x), np.asarray(self.exponent_y)
        c, s = np.cos(np.asarray(self.axis_rad)), np.sin(np.asarray(self.axis_rad))
        x, y = geometry.tangents
        along, across = c * x + s * y, c * y - s * x
        # log(N.H) = -log1p(tan^2)/2, and the azimuth's squares are those of the tangents over tan^2.
        tan2 = np.maximum(geometry.tan2_h, 1e-300)
        per_square = -0.5 * np.log1p(tan2) / tan2
        by_x, by_y = per_square * np.square(along), per_square * np.square(across)
        by_axis = per_square * 2.0 * along * across * (n_x - n_y)
        norm = np.sqrt(n_x + 1.0) * np.sqrt(n_y + 1.0) / (8.0 * np.pi)
        largest = np.maximum(geometry.cos_i, geometry.cos_o)
        value = norm * np.exp(n_x * by_x + n_y * by_y) / (geometry.cos_d * largest)
        return Lobe(
            value,
            {
                "exponent_x": value * (by_x + 0.5 / (n_x + 1.0)),
                "exponent_y": value * (by_y + 0.5 / (n_y + 1.0)),
                "axis_rad": value * by_axis,
            },
        )


def _entered(cosine: Array) -> Array:
    """1 - (1 - cos/2)^5, without loss at grazing angles."""
    return np.asarray(-np.expm1(5.0 * np.log1p(-0.5 * cosine)))
