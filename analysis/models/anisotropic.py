"""Anisotropic GGX and Beckmann facets with Smith's masking: brushed and woven surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, KS, Coordinate, Geometry, Kind, Lobe, Model, Parameter, product
from analysis.models.ggx import F0
from analysis.models.microfacet import Smith, beckmann_width, correlated, facets_schlick

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from analysis.models.base import Array

AXIS = Parameter(
    "axis_rad",
    Kind.SHAPE,
    bounds=(-0.5 * np.pi, 0.5 * np.pi),
    minimum=-np.inf,
    default=0.0,
    unit="rad",
    scan=(-0.8, 0.0, 0.8),
)


def _width(name: str, default: float, of_slope: Callable[[float], float]) -> Parameter:
    return Parameter(
        name,
        Kind.SHAPE,
        bounds=(0.003, 2.0),
        minimum=1e-6,
        default=default,
        coordinate=Coordinate.LOG,
        scan=(0.02, 0.06, 0.15, 0.4),
        of_slope=of_slope,
    )


ALPHA_X, ALPHA_Y = _width("alpha_x", 0.3, float), _width("alpha_y", 0.1, float)
M_X, M_Y = _width("m_x", 0.3, beckmann_width), _width("m_y", 0.1, beckmann_width)


def _turned(x: Array, y: Array, axis: Array) -> tuple[Array, Array]:
    """Components along and across the axis; their derivatives by it are (across, -along)."""
    c, s = np.cos(axis), np.sin(axis)
    return c * x + s * y, c * y - s * x


def _ellipse(x: Array, y: Array, scales: tuple[Array, Array], axis: Array) -> tuple[Array, tuple[Array, ...]]:
    """Square of (along * scale, across * scale), and its derivatives by both scales and the axis."""
    along, across = _turned(x, y, axis)
    one, two = np.square(along * scales[0]), np.square(across * scales[1])
    slopes = (
        2.0 * one / scales[0],
        2.0 * two / scales[1],
        2.0 * along * across * (scales[0] - scales[1]) * (scales[0] + scales[1]),
    )
    return one + two, slopes


def _slope_names(names: tuple[str, str], slopes: tuple[Array, ...]) -> dict[str, Array]:
    return dict(zip((*names, "axis_rad"), slopes, strict=True))


def _steepness(
    geometry: Geometry, widths: tuple[Array, Array], axis: Array
) -> tuple[Array, tuple[Array, ...]]:
    """(tan_x/width_x)^2 + (tan_y/width_y)^2 of H, and its derivatives by both widths and the axis."""
    x, y = geometry.tangents
    inverse = (1.0 / widths[0], 1.0 / widths[1])
    value, (by_x, by_y, by_axis) = _ellipse(x, y, inverse, axis)
    return value, (-by_x * np.square(inverse[0]), -by_y * np.square(inverse[1]), by_axis)


def ggx_density(geometry: Geometry, names: tuple[str, str], widths: tuple[Array, Array], axis: Array) -> Lobe:
    """GGX distribution of two widths, normalised to a projected area of 1 (Heitz 2014, equation 85).

    Parameters
    ----------
    geometry : Geometry
        Pairs of directions whose half vector is the facets' normal.
    names : tuple of str
        Names of the widths, by which the derivatives go; that of the axis is `AXIS`'s.
    widths : tuple of ndarray, shape () or (channels,)
        Widths along and across the axis.
    axis : ndarray, shape () or (channels,)
        Azimuth of the axis, in radians.

    Returns
    -------
    Lobe
        D in 1/sr, and its derivatives by both widths and the axis.
    """
    steepness, slopes = _steepness(geometry, widths, axis)
    ratio = (1.0 + geometry.tan2_h) / (1.0 + steepness)
    density = np.square(ratio) / (np.pi * widths[0] * widths[1])
    return _with_norm(density, tuple(-2.0 * slope / (1.0 + steepness) for slope in slopes), names, widths)


def beckmann_density(
    geometry: Geometry, names: tuple[str, str], widths: tuple[Array, Array], axis: Array
) -> Lobe:
    """Beckmann's distribution of two widths (Heitz 2014, equation 80); as `ggx_density`."""
    steepness, slopes = _steepness(geometry, widths, axis)
    density = np.exp(-steepness) * np.square(1.0 + geometry.tan2_h) / (np.pi * widths[0] * widths[1])
    return _with_norm(density, tuple(-slope for slope in slopes), names, widths)


def _with_norm(
    density: Array, relative: tuple[Array, ...], names: tuple[str, str], widths: tuple[Array, Array]
) -> Lobe:
    """Add what 1/(width_x width_y) does to the logarithmic derivatives."""
    by_x, by_y, by_axis = relative
    own = (density * (by_x - 1.0 / widths[0]), density * (by_y - 1.0 / widths[1]), density * by_axis)
    return Lobe(density, _slope_names(names, own))


_QUARTER = Lobe(np.asarray(0.25), {})


def _smith(
    direction: Array, cosine: Array, names: tuple[str, str], widths: tuple[Array, Array], axis: Array
) -> Smith:
    """GGX: cos (1 + Lambda) with (alpha sin)^2 taken along the direction's azimuth (Heitz 2014, eq. 86)."""
    run2, slopes = _ellipse(direction[..., 0:1], direction[..., 1:2], widths, axis)
    root = np.hypot(cosine, np.sqrt(run2))
    return Smith(0.5 * (cosine + root), _slope_names(names, tuple(0.25 * slope / root for slope in slopes)))


def _smith_beckmann(
    direction: Array, cosine: Array, names: tuple[str, str], widths: tuple[Array, Array], axis: Array
) -> Smith:
    """Return cos (1 + Lambda) of Beckmann's distribution; as `_smith`."""
    from scipy.special import erfc

    run2, slopes = _ellipse(direction[..., 0:1], direction[..., 1:2], widths, axis)
    run = np.maximum(np.sqrt(run2), 1e-150)
    a = cosine / run
    bell = np.exp(-np.square(a)) / np.sqrt(np.pi)
    value = cosine * (1.0 - 0.5 * erfc(a)) + 0.5 * run * bell
    return Smith(value, _slope_names(names, tuple(0.25 * bell * (slope / run) for slope in slopes)))


@dataclass(frozen=True, eq=False)
class GGXAnisotropic(Model):
    """`GGX` with two widths, along and across an axis in the surface (Burley 2012; Heitz 2014, section 5.3).

    Exchanging the widths and turning the axis by a quarter is the same surface: axis_rad is searched over
    half a turn, with no order of the widths, so that no surface lies on a bound only.

    Parameters
    ----------
    kd, ks, f0 : float or array_like, shape (channels,)
        As in `GGX`.
    alpha_x, alpha_y : float or array_like, shape (channels,)
        Widths along and across the axis; light spreads most along the larger one.
    axis_rad : float or array_like, shape (channels,)
        Azimuth of the axis in the sample frame.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    alpha_x: ArrayLike = ALPHA_X.default
    alpha_y: ArrayLike = ALPHA_Y.default
    axis_rad: ArrayLike = AXIS.default
    f0: ArrayLike = F0.default

    NAME: ClassVar[str] = "ggx-anisotropic"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, ALPHA_X, ALPHA_Y, AXIS, F0)
    ISOTROPIC: ClassVar[bool] = False
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by widths, axis and f0."""
        names, axis = ("alpha_x", "alpha_y"), np.asarray(self.axis_rad)
        widths = np.asarray(self.alpha_x), np.asarray(self.alpha_y)
        light = _smith(geometry.wi, geometry.cos_i, names, widths, axis)
        camera = _smith(geometry.wo, geometry.cos_o, names, widths, axis)
        return product(
            ggx_density(geometry, names, widths, axis),
            _QUARTER,
            correlated(geometry.cos_i, geometry.cos_o, light, camera),
            facets_schlick(geometry, self.f0),
        )


@dataclass(frozen=True, eq=False)
class BeckmannAnisotropic(Model):
    """`Beckmann` with two widths, along and across an axis in the surface; as `GGXAnisotropic`.

    Parameters
    ----------
    kd, ks, f0 : float or array_like, shape (channels,)
        As in `Beckmann`.
    m_x, m_y : float or array_like, shape (channels,)
        Root-mean-square slopes along and across the axis, times sqrt(2).
    axis_rad : float or array_like, shape (channels,)
        Azimuth of the axis in the sample frame.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    m_x: ArrayLike = M_X.default
    m_y: ArrayLike = M_Y.default
    axis_rad: ArrayLike = AXIS.default
    f0: ArrayLike = F0.default

    NAME: ClassVar[str] = "beckmann-anisotropic"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, M_X, M_Y, AXIS, F0)
    ISOTROPIC: ClassVar[bool] = False
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """F D G / (4 (N.L)(N.E)) and its derivatives by widths, axis and f0."""
        names, axis = ("m_x", "m_y"), np.asarray(self.axis_rad)
        widths = np.asarray(self.m_x), np.asarray(self.m_y)
        light = _smith_beckmann(geometry.wi, geometry.cos_i, names, widths, axis)
        camera = _smith_beckmann(geometry.wo, geometry.cos_o, names, widths, axis)
        return product(
            beckmann_density(geometry, names, widths, axis),
            _QUARTER,
            correlated(geometry.cos_i, geometry.cos_o, light, camera),
            facets_schlick(geometry, self.f0),
        )
