"""The estimator of the merge on one block: weighted means, with the variance of the weights applied."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_TINY = 1e-30
_ZERO: Any = 0.0  # a plain number keeps the precision of what is added to it


@dataclass(frozen=True, eq=False)
class Sample:
    """One frame's samples of a block.

    Attributes
    ----------
    signal_dn : ndarray, shape (H, W)
        Counts above the dark level.
    weight : ndarray, shape (H, W), or None
        0 to 1, from clipping; None: all 1.
    exposure_s : float
        Exposure time.
    floor_dn2 : float
        Variance without light: read, rounding and dark-frame noise.
    """

    signal_dn: NDArray[np.floating]
    weight: NDArray[np.floating] | None
    exposure_s: float
    floor_dn2: float

    def weighted(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Values times the weight."""
        return values if self.weight is None else values * self.weight

    def variance_dn2(self, shot: NDArray[np.floating]) -> NDArray[np.floating]:
        """Variance of the signal for a shot-noise variance per second."""
        return shot * self.exposure_s + (self.floor_dn2 + _TINY)


class Estimate(NamedTuple):
    """Radiance (DN/s), its variance, and the weighted sum of squared residuals over their variances."""

    radiance: NDArray[np.floating]
    variance: NDArray[np.floating]
    chi_square: NDArray[np.floating]


def estimate(
    samples: Sequence[Sample],
    gain_dn_per_e: float,
    dark_rate_dn_per_s: NDArray[np.floating],
    common_dn2: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    iterations: int,
) -> Estimate:
    """Estimate the radiance of each pixel from samples of different exposure.

    Parameters
    ----------
    samples : sequence of Sample
        At least one sample of each pixel has a weight above 0.
    gain_dn_per_e : float
        DN per electron.
    dark_rate_dn_per_s : ndarray, shape (H, W) or (1, 1)
        Dark signal per second; its shot noise is noise.
    common_dn2 : tuple of float
        Variances shared by all frames: of the bias, of bias and rate, of the rate.
    iterations : int
        Fixed-point iterations of the maximum-likelihood weights; 0 leaves the Poisson estimate.

    Returns
    -------
    Estimate
        In the samples' precision.
    """
    # The factor of a signal is w t / v; Poisson's v goes with t, so its factors are the weights themselves.
    factors: list[Any] = [1.0 if sample.weight is None else sample.weight for sample in samples]
    radiance, total = _weighted_mean(samples, factors)
    for _ in range(iterations):
        shot = _shot(radiance, gain_dn_per_e, dark_rate_dn_per_s)
        factors = [sample.weighted(sample.exposure_s / sample.variance_dn2(shot)) for sample in samples]
        radiance, total = _weighted_mean(samples, factors)
    shot = _shot(radiance, gain_dn_per_e, dark_rate_dn_per_s)
    spread, used, chi_square = _ZERO, _ZERO, _ZERO
    for sample, factor in zip(samples, factors, strict=True):
        variance = sample.variance_dn2(shot)
        spread = spread + factor * factor * variance
        used = used + factor
        residual = sample.signal_dn - radiance * sample.exposure_s
        chi_square = chi_square + sample.weighted(residual * residual / variance)
    variance = spread / (total * total)
    bias_bias, bias_rate, rate_rate = common_dn2
    if bias_bias or rate_rate:
        # An error b + r t of all darks moves the estimate by b sum(factors) / sum(factors t) + r.
        lever = used / total
        variance = variance + (bias_bias * lever + 2.0 * bias_rate) * lever + rate_rate
    return Estimate(radiance, variance, chi_square)


def _weighted_mean(samples: Sequence[Sample], factors: Sequence[Any]) -> tuple[Any, Any]:
    """Weighted mean of signal over exposure, and the sum of factor times exposure."""
    top, bottom = _ZERO, _ZERO
    for sample, factor in zip(samples, factors, strict=True):
        top = top + factor * sample.signal_dn
        bottom = bottom + factor * sample.exposure_s
    return top / bottom, bottom


def _shot(radiance: Any, gain: float, dark_rate: Any) -> Any:
    """Variance per second of exposure: gain times signal, never negative."""
    return gain * (np.maximum(radiance, 0.0) + dark_rate)
