"""The albedo that samples on one side of one plane allow, under several descriptions of the rest.

Views beside the plane of incidence and on the light's side were not measured. If the surface is isotropic,
each of several descriptions says what lies there: models of facets, a trend of half and grazing angles, and
a lobe that is round about the mirror direction. They share what was measured and differ in the rest; how
much, tells how little is known. `gonio bench data_mwir` holds the uncertainty that follows against materials
whose whole hemisphere is known: no error is above 1.5 times that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis.interpolation.trend import fit_trend
from rig.angles import spherical_to_direction
from rig.errors import GonioError

if TYPE_CHECKING:
    from collections.abc import Callable

    from analysis.pairing import Array, Usable

MODELS = ("ggx", "ggx-two-lobes", "cook-torrance-schlick", "abc")
LARGEST_FITTED_DEG = 80.0
FEWEST_DIRECTIONS = 3
"""Directions with samples, from which on descriptions are told apart at all."""
SHARED = 0.1
"""Part of the albedo that all descriptions may miss together."""
STEPS = 180, 180
"""Directions of the integral along theta and azimuth."""


class Range(NamedTuple):
    """Smallest and largest albedo that the descriptions give."""

    low: float
    high: float

    @property
    def middle(self) -> float:
        """Albedo half way between them."""
        return 0.5 * (self.low + self.high)

    @property
    def u(self) -> float:
        """Standard uncertainty of `middle`."""
        return float(np.hypot(0.5 * (self.high - self.low), SHARED * self.middle))


class InPlane:
    """Descriptions of a surface that was measured in the plane of incidence.

    Parameters
    ----------
    usable : Usable
        Samples in the plane of incidence; of several channels the brightest counts.
    """

    def __init__(self, usable: Usable) -> None:
        f_r = usable.f_r.max(axis=1, keepdims=True)
        self._descriptions: list[Callable[[Array, Array], Array]] = [fit_trend(usable.wi, usable.wo, f_r)]
        self._descriptions += _models(usable.wi, usable.wo, f_r)
        middle = (np.arange(STEPS[0]) + 0.5) * (0.5 * np.pi / STEPS[0])
        around = (np.arange(STEPS[1]) + 0.5) * (2.0 * np.pi / STEPS[1])
        theta, phi = (grid.ravel() for grid in np.meshgrid(middle, around, indexing="ij"))
        self._wi = spherical_to_direction(theta, phi)
        self._weight = np.sin(theta) * np.cos(theta) * (0.5 * np.pi / STEPS[0]) * (2.0 * np.pi / STEPS[1])

    def albedo(self, view: Usable) -> Range:
        """Integrate each description.

        Parameters
        ----------
        view : Usable
            Samples that share their light's direction, with views in its plane.
        """
        wo = np.broadcast_to(spherical_to_direction(float(np.mean(view.theta_i)), np.pi), self._wi.shape)
        values = [each(self._wi, wo)[:, 0] for each in self._descriptions]
        values.append(_round_lobe(view, self._wi, wo))
        albedos = [float(np.sum(value * self._weight)) for value in values]
        return Range(min(albedos), max(albedos))


def _models(wi: Array, wo: Array, f_r: Array) -> list[Callable[[Array, Array], Array]]:
    """Fit the models; one that cannot be fitted says nothing."""
    from analysis.fit import fit
    from analysis.samples import make_samples

    samples = make_samples(wi, wo, f_r)
    fitted: list[Callable[[Array, Array], Array]] = []
    for name in MODELS:
        try:
            fitted.append(fit(samples, name, max_theta_deg=LARGEST_FITTED_DEG).model.evaluate)
        except GonioError:
            continue
    return fitted


def _round_lobe(view: Usable, wi: Array, wo: Array) -> Array:
    """Turn what was measured about the mirror direction, the mean of its two sides, shape (N,)."""
    theta = float(np.mean(view.theta_i))
    # Positive where the view leans further from the normal than the mirror direction.
    away = np.where(np.abs(view.turn) > 0.5 * np.pi, view.theta_o, -view.theta_o) - theta
    order = np.argsort(away)
    away, f_r = away[order], view.f_r.max(axis=1)[order]
    angle = np.arccos(np.clip((wi * (wo * [-1.0, -1.0, 1.0])).sum(-1), -1.0, 1.0))
    return np.asarray(0.5 * (np.interp(angle, away, f_r) + np.interp(-angle, away, f_r)))
