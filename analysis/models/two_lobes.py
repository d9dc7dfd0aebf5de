"""Sums of two GGX lobes that share one specular scale: narrow and wide, forward and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, KS, Coordinate, Geometry, Kind, Lobe, Model, Parameter, product
from analysis.models.ggx import ALPHA, F0
from analysis.models.microfacet import facets_ggx, facets_schlick

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

WIDENING = Parameter(
    "widening",
    Kind.SHAPE,
    bounds=(1.05, 100.0),
    minimum=1.0,
    default=4.0,
    coordinate=Coordinate.LOG_ABOVE_ONE,
    scan=(1.6, 4.0, 12.0),
)
SHARE = Parameter(
    "share",
    Kind.SHAPE,
    bounds=(0.0, 1.0),
    minimum=0.0,
    default=0.3,
    scan=(1e-3, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999, 0.9999),
    maximum=1.0,
)
ALPHA_RETRO = Parameter(
    "alpha_retro",
    Kind.SHAPE,
    bounds=ALPHA.bounds,
    minimum=ALPHA.minimum,
    default=0.1,
    coordinate=Coordinate.LOG,
    scan=ALPHA.scan,
)


def _mixed(first: Lobe, second: Lobe, share: ArrayLike) -> Lobe:
    """(1 - share) first + share second, and its derivatives."""
    weight = np.asarray(share)
    slopes = {name: (1.0 - weight) * slope for name, slope in first.slopes.items()}
    for name, slope in second.slopes.items():
        own = weight * slope
        slopes[name] = slopes[name] + own if name in slopes else own
    slopes["share"] = second.value - first.value
    return Lobe((1.0 - weight) * first.value + weight * second.value, slopes)


@dataclass(frozen=True, eq=False)
class GGXTwoLobes(Model):
    """`GGX` with two widths: a share of the facets lies on slopes `widening` times as steep.

    Metallic paints and worn metals have a narrow core on a wide halo. The second width is a factor above 1,
    so that the lobes cannot change places in a fit; one specular scale serves both.

    Parameters
    ----------
    kd, ks, alpha, f0 : float or array_like, shape (channels,)
        As in `GGX`, alpha of the narrow lobe.
    widening : float or array_like, shape (channels,)
        Width of the wide lobe over that of the narrow one.
    share : float or array_like, shape (channels,)
        Share of the wide lobe.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    alpha: ArrayLike = ALPHA.default
    widening: ArrayLike = WIDENING.default
    share: ArrayLike = SHARE.default
    f0: ArrayLike = F0.default

    NAME: ClassVar[str] = "ggx-two-lobes"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, ALPHA, WIDENING, SHARE, F0)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """Return both lobes and their derivatives by alpha, widening, share and f0."""
        alpha, widening = np.asarray(self.alpha), np.asarray(self.widening)
        narrow, wide = facets_ggx(geometry, alpha), facets_ggx(geometry, alpha * widening)
        slope = wide.slopes["alpha"]
        wide = Lobe(wide.value, {"alpha": widening * slope, "widening": alpha * slope})
        return product(_mixed(narrow, wide, self.share), facets_schlick(geometry, self.f0))


@dataclass(frozen=True, eq=False)
class GGXRetro(Model):
    """`GGX` with a second lobe that points back to the light.

    The second lobe is D G / (4 (N.L)(N.E)) with the camera mirrored about the normal, so that its half vector
    is the back vector (Belcour, Barla & Pacanowski 2014) and its peak lies where E is L. It has no Fresnel
    term: what returns light in beads and corner cubes is not the surface. share = 1 is a lobe back alone.

    Parameters
    ----------
    kd, ks, alpha, f0 : float or array_like, shape (channels,)
        As in `GGX`, for the lobe about the mirror direction.
    alpha_retro : float or array_like, shape (channels,)
        Width of the lobe back to the light.
    share : float or array_like, shape (channels,)
        Share of the lobe back to the light.
    """

    kd: ArrayLike = KD.default
    ks: ArrayLike = KS.default
    alpha: ArrayLike = ALPHA.default
    alpha_retro: ArrayLike = ALPHA_RETRO.default
    share: ArrayLike = SHARE.default
    f0: ArrayLike = F0.default

    NAME: ClassVar[str] = "ggx-retro"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, KS, ALPHA, ALPHA_RETRO, SHARE, F0)
    CONSERVES: ClassVar[bool] = True

    def lobe_at(self, geometry: Geometry) -> Lobe:
        """Return both lobes and their derivatives by alpha, alpha_retro, share and f0."""
        forth = product(facets_ggx(geometry, self.alpha), facets_schlick(geometry, self.f0))
        back = facets_ggx(geometry.retro, self.alpha_retro)
        return _mixed(forth, Lobe(back.value, {"alpha_retro": back.slopes["alpha"]}), self.share)
