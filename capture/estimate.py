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
        variance = shot * self.exposure_s
        variance += self.floor_dn2 + _TINY
        return variance


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
    top, bottom = _sums(samples, [sample.weight for sample in samples])
    radiance = top / bottom
    for _ in range(iterations):
        shot = _shot(radiance, gain_dn_per_e, dark_rate_dn_per_s)
        factors = [sample.weighted(sample.exposure_s / sample.variance_dn2(shot)) for sample in samples]
        top, bottom = _sums(samples, factors)
        radiance = top / bottom
    if iterations:
        spread, used, chi_square = _likelihood_spread(samples, factors, radiance)
    else:
        shot = _shot(radiance, gain_dn_per_e, dark_rate_dn_per_s)
        spread, used, chi_square = _poisson_spread(samples, shot, radiance)
    variance = spread / (bottom * bottom)
    bias_bias, bias_rate, rate_rate = common_dn2
    if bias_bias or rate_rate:
        # An error b + r t of all darks moves the estimate by b sum(factors) / sum(factors t) + r.
        lever = used / bottom
        variance += (bias_bias * lever + 2.0 * bias_rate) * lever + rate_rate
    return Estimate(radiance, variance, chi_square)


def _sums(samples: Sequence[Sample], factors: Sequence[Any]) -> tuple[Any, Any]:
    """Sum of factor times signal, and of factor times exposure; a factor of None is 1."""
    top, bottom = _ZERO, _ZERO
    for sample, factor in zip(samples, factors, strict=True):
        if factor is None:
            top = top + sample.signal_dn
            bottom = bottom + sample.exposure_s
        else:
            top = top + factor * sample.signal_dn
            bottom = bottom + factor * sample.exposure_s
    return top, bottom


def _likelihood_spread(
    samples: Sequence[Sample], factors: Sequence[Any], radiance: Any
) -> tuple[Any, Any, Any]:
    """Sum of factor^2 v, sum of factors, and chi-square, for factors w t / v of the last iteration."""
    spread, used, chi_square = _ZERO, _ZERO, _ZERO
    for sample, factor in zip(samples, factors, strict=True):
        spread = spread + sample.weighted(factor) * sample.exposure_s
        used = used + factor
        residual = _residual(sample, radiance)
        residual *= residual
        residual *= factor
        residual *= 1.0 / sample.exposure_s
        chi_square = chi_square + residual
    return spread, used, chi_square


def _poisson_spread(samples: Sequence[Sample], shot: Any, radiance: Any) -> tuple[Any, Any, Any]:
    """Sum of weight^2 v, sum of weights, and chi-square, for the Poisson estimate."""
    of_shot, of_floor, used, chi_square = _ZERO, _ZERO, _ZERO, _ZERO
    for sample in samples:
        square = 1.0 if sample.weight is None else sample.weight * sample.weight
        of_shot = of_shot + square * sample.exposure_s
        of_floor = of_floor + square * sample.floor_dn2
        used = used + (1.0 if sample.weight is None else sample.weight)
        residual = _residual(sample, radiance)
        residual *= residual
        residual /= sample.variance_dn2(shot)
        chi_square = chi_square + sample.weighted(residual)
    return shot * of_shot + (of_floor + _TINY), used, chi_square


def _residual(sample: Sample, radiance: Any) -> Any:
    expected = radiance * sample.exposure_s
    return np.subtract(sample.signal_dn, expected, out=expected)


def _shot(radiance: Any, gain: float, dark_rate: Any) -> Any:
    """Variance per second of exposure: gain times signal, never negative."""
    shot = np.maximum(radiance, 0.0)
    shot += dark_rate
    shot *= gain
    return shot
