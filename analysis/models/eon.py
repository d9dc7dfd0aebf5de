"""Oren and Nayar's rough diffuser with the light that goes between facets: no energy is lost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.models.base import KD, Geometry, Kind, Lobe, OwnDiffuse, Parameter, product
from analysis.models.oren_nayar import LOSS, ROUGHNESS, fujii_term

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from analysis.models.base import Array

FACET_ALBEDO = Parameter(
    "facet_albedo",
    Kind.SHAPE,
    bounds=(0.0, 1.0),
    minimum=0.0,
    default=KD.default,
    scan=(0.2, 0.9),
    maximum=1.0,
)

MEAN_LOSS = LOSS - (2.0 / 3.0 - 28.0 / (15.0 * np.pi))
"""The mean of `_lost` over the hemisphere, cosine-weighted."""


def _lost(cosine: Array, sine2: Array) -> Array:
    """Light that leaves a facet for another: (1 - E(cos)) (1 + LOSS r)/r, E the albedo of `Fujii`.

    E is Portsmouth et al. 2025, equation of the directional albedo of FON, in closed form with
    G = sin (theta - sin cos) + 2/3 (sin/cos (1 - sin^3) - sin). Here LOSS - G/pi, which vanishes at grazing
    angles, with the differences taken by hand: the complement of theta, 1 - sin = cos^2/(1 + sin), and
    the two terms that go as sin cos.
    """
    sine = np.sqrt(sine2)
    complement = np.arctan2(cosine, sine)
    level = (0.5 * np.pi - 2.0 / 3.0) * np.square(cosine) / (1.0 + sine)
    rest = sine * cosine * np.square(cosine) * (sine + 2.0) / (3.0 * np.square(1.0 + sine))
    return np.asarray((level + sine * complement - rest) / np.pi)


@dataclass(frozen=True, eq=False)
class EON(OwnDiffuse):
    """f_r = `Fujii` + kd/pi a <E>/(1 - a (1 - <E>)) (1 - E_i) (1 - E_o)/(1 - <E>), a = facet_albedo.

    The second term is light that goes between facets (Portsmouth, Kutz & Hill 2025, "EON: A practical
    energy-preserving rough diffuse BRDF", listing 1, with the exact albedo): E is the directional albedo of
    `Fujii` at kd = 1 for the light's and the camera's angle, <E> = (1 + (2/3 - 28/(15 pi)) roughness) /
    (1 + (1/2 - 2/(3 pi)) roughness) its mean.

    In the published model a is kd. Here it is a shape of its own, so that kd stays a linear scale: a = 0 is
    `Fujii`; with a = 1 nothing is lost, and the albedo is kd in every direction and for every roughness.
    Samples tell a from kd by a small change of shape alone, and not at all on smooth surfaces.

    Parameters
    ----------
    kd : float or array_like, shape (channels,)
        Albedo of the facets.
    roughness : float or array_like, shape (channels,)
        0 (Lambert) to 1.
    facet_albedo : float or array_like, shape (channels,)
        Albedo of the facets as the light between them meets it: kd in the published model.
    """

    kd: ArrayLike = KD.default
    roughness: ArrayLike = ROUGHNESS.default
    facet_albedo: ArrayLike = FACET_ALBEDO.default

    NAME: ClassVar[str] = "eon"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (KD, ROUGHNESS, FACET_ALBEDO)
    CONSERVES: ClassVar[bool] = True

    def terms_at(self, geometry: Geometry) -> dict[str, Lobe]:
        """Return the diffuse term and its derivatives by roughness and facet albedo."""
        lost = _lost(geometry.cos_i, geometry.sin2_i) * _lost(geometry.cos_o, geometry.sin2_o) / MEAN_LOSS
        between = product(self._returned(), Lobe(lost / np.pi, {}))
        once = fujii_term(geometry, self.roughness)
        slopes = dict(between.slopes)
        slopes["roughness"] = slopes["roughness"] + once.slopes["roughness"]
        return {"kd": Lobe(once.value + between.value, slopes)}

    def _returned(self) -> Lobe:
        """Part of what leaves a facet for another and comes out at last, times r A; A = 1/(1 + LOSS r)."""
        r, a = np.asarray(self.roughness), np.asarray(self.facet_albedo)
        entering, mean = 1.0 + LOSS * r, 1.0 + (LOSS - MEAN_LOSS) * r
        kept = entering - a * r * MEAN_LOSS
        share = Lobe(
            a * mean / kept,
            {
                "roughness": -a * (1.0 - a) * MEAN_LOSS / np.square(kept),
                "facet_albedo": mean * entering / np.square(kept),
            },
        )
        return product(share, Lobe(r / entering, {"roughness": 1.0 / np.square(entering)}))
