"""How far values are from reciprocal, as a power of cos(theta_i) / cos(theta_o): what a wrong cosine does.

Files rarely hold exchanged pairs of directions, but samples whose exchanged directions are neighbours. So

    ln f = s(theta_h, theta_d, phi_d) + g ln(cos(theta_i) / cos(theta_o)) + noise,

a partially linear model (Robinson 1988) whose smooth and reciprocal part s drops out of the differences
between neighbours (Yatchew 1997): between samples with the light nearer to the normal and samples with the
view nearer to it, at nearly the same half and difference angles. g is the weighted median of what they say,
as few pairs at a peak must not rule. A reciprocal surface has g = 0; one cosine too many or too few makes it
0.5 or -0.5, one of each 1 or -1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.angles import half_difference

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

NARROWEST = np.radians(5.0)
"""Angle between half vector and normal below which lengths shrink with the angle no further."""
NEIGHBOURS = 4
AT_THE_SAME = 1e-3
"""Distance below which a neighbour is taken to lie at the same place."""
NEAREST = 0.5
"""Share of the pairs, nearest first, that is used: the others tell more of s than of g."""
LEAST_LEVER = 0.15
"""Difference of ln(cos(theta_i) / cos(theta_o)) below which a pair tells nothing."""
FEWEST = 20
USUAL = 0.1
"""Standard deviation of g of measured surfaces as they should be read."""
PER_SPREAD = 0.3
"""Uncertainty of g over the spread of what the pairs say: neighbours share what they are wrong in."""
MOST = 5.5
"""Deviations beyond which g speaks no louder: where directions are wrong, it means nothing."""


class Asymmetry(NamedTuple):
    """Power of cos(theta_i) / cos(theta_o) in values, and its uncertainty (k = 1); NaN where too few tell."""

    power: float
    uncertainty: float

    @property
    def log_likelihood(self) -> float:
        """Natural logarithm of the likelihood that the values are reciprocal, 0 where nothing tells."""
        if np.isnan(self.power):
            return 0.0
        return -0.5 * min(abs(self.power) / self.uncertainty, MOST) ** 2


@dataclass(frozen=True, eq=False)
class Exchange:
    """Pairs of samples whose exchanged directions are neighbours.

    Attributes
    ----------
    of : ndarray of int, shape (P,)
        Samples.
    neighbours : ndarray of int, shape (P, K)
        Samples near the exchanged directions of each.
    shares : ndarray, shape (P, K)
        How much each of them counts; the sum is 1.
    lever : ndarray, shape (P,)
        Difference of ln(cos(theta_i) / cos(theta_o)).
    weights : ndarray, shape (P,)
    """

    of: Indices
    neighbours: Indices
    shares: Array
    lever: Array
    weights: Array

    @classmethod
    def at(cls, wi: Array, wo: Array, weights: Array) -> Exchange:
        """Find the pairs of directions (N, 3), samples weighing `weights` (N,)."""
        features = half_angle_features(wi, wo)
        ratio = np.log(wi[:, 2] / wo[:, 2])
        sides = [np.flatnonzero(ratio >= 0.0), np.flatnonzero(ratio < 0.0)]
        if min(map(len, sides)) < FEWEST:
            return _none()
        found = [_pairs(features, ratio, *which) for which in (sides, sides[::-1])]
        of, neighbours, shares, lever, distance = (np.concatenate(part) for part in zip(*found, strict=True))
        telling = np.abs(lever) > LEAST_LEVER
        if np.count_nonzero(telling) < FEWEST:
            return _none()
        use = telling & (distance <= np.quantile(distance[telling], NEAREST))
        size = weights[of[use]] * np.abs(lever[use])
        return cls(of[use], neighbours[use], shares[use], lever[use], size)

    def asymmetry(self, log_f: Array) -> Asymmetry:
        """Return g of values (N,), ln f or what a reciprocal model leaves of it."""
        if len(self.of) < FEWEST:
            return Asymmetry(np.nan, np.nan)
        difference = log_f[self.of] - (self.shares * log_f[self.neighbours]).sum(axis=1)
        each = difference / self.lever
        power = _weighted_median(each, self.weights)
        spread = float(np.abs(each - power) @ self.weights / self.weights.sum())
        return Asymmetry(power, float(np.hypot(USUAL, PER_SPREAD * spread)))


def half_angle_features(wi: Array, wo: Array) -> Array:
    """Return angles (N, 3) that are the same for light and view exchanged and for both sides of the plane."""
    theta_h, _, theta_d, phi_d = half_difference(wi, wo)
    out_of_plane = np.sin(theta_h) * np.sin(theta_d) * np.cos(2.0 * phi_d)
    return np.stack([np.arcsinh(theta_h / NARROWEST), 2.0 * theta_d, 2.0 * out_of_plane], axis=1)


def _pairs(
    features: Array, ratio: Array, one: Indices, other: Indices
) -> tuple[Indices, Indices, Array, Array, Array]:
    """Return for each sample of one side its neighbours of the other, their shares, lever and distance."""
    from scipy.spatial import cKDTree

    distance, near = cKDTree(features[other]).query(features[one], k=NEIGHBOURS)
    shares = 1.0 / np.maximum(distance, AT_THE_SAME) ** 2
    shares /= shares.sum(axis=1, keepdims=True)
    neighbours = other[near]
    lever = ratio[one] - (shares * ratio[neighbours]).sum(axis=1)
    return one, neighbours, shares, lever, distance[:, 0]


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(reached, 0.5 * reached[-1])]])


def _none() -> Exchange:
    empty = np.empty(0, dtype=np.intp)
    return Exchange(
        empty, np.empty((0, NEIGHBOURS), dtype=np.intp), np.empty((0, NEIGHBOURS)), np.empty(0), np.empty(0)
    )
