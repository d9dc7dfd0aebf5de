"""How well a reading agrees with what surfaces do: numbers that compare between readings of one file.

A surface's BRDF is reciprocal, mostly the same on both sides of the plane of incidence, smooth, and has its
peak, where it has one, at the mirror direction. So ln f is taken as

    ln f = ln(mixture of facets' lobes and diffusers) + s(theta_h, theta_d, cos 2 phi_d) + noise,

with s a Gaussian process of angles that do not change when light and view are exchanged or mirrored
(Rusinkiewicz 1998). What is not reciprocal, symmetric or smooth goes into the noise; a lobe in the wrong
place has to be made up for by s. The evidence is the process's marginal likelihood (Rasmussen & Williams
2006, equation 2.30) with the noise's size profiled and few centres in place of all samples (section 8.3.2).
A factor on the values is a shift of ln f, so that readings with and without a cosine compare.

All that depends on directions only is found once for all readings of the values there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.doctor_exchange import Asymmetry, Exchange, half_angle_features
from analysis.doctor_lobes import Lobes

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]

LENGTHS = (0.5, 1.0, 2.0)
SIGNALS = (0.0, 0.1, 1.0, 10.0, 100.0, 1000.0)
"""Variance of the process over that of the noise."""
CENTRES = 80
KNOWN = 0.1
"""RMS about the lobes below which no reading is better for it: no surface follows formulas so far."""
TYPICAL = 0.2
"""Deviation from the lobes beyond which Cauchy's measure grows but slowly."""
USUAL_SHARE, LARGEST = 0.68, 2.5
"""Share of samples whose deviation from the lobes is usual; what multiple of it the process sees at most."""


@dataclass(frozen=True)
class Evidence:
    """What speaks for a reading, per sample, in natural logarithms.

    Attributes
    ----------
    total : float
        Logarithm of the marginal likelihood over the number of samples.
    lobe_rms : float
        RMS of ln f about the lobes alone.
    lobe_misfit : float
        How far ln f is from the lobes alone, as the mean of two measures: one that the largest deviations
        rule, and Cauchy's, which the many rule. A few samples at a peak do not decide, nor do all others.
    noise_rms : float
        RMS of what is neither lobe nor smooth, reciprocal and symmetric, but for the largest deviations.
    asymmetry : Asymmetry
        How far what the lobes leave is from reciprocal, by samples whose exchanged directions are near.
    """

    total: float
    lobe_rms: float
    lobe_misfit: float
    noise_rms: float
    asymmetry: Asymmetry


class _Process(NamedTuple):
    """A Gaussian process of one length at fixed directions, brought to its principal axes."""

    values: Array
    """Variances (K,) along the axes, over that of the signal."""
    axes: Array
    """From samples to axes, (K, N); the weights are in it."""


class Directions:
    """What the readings of values at the same directions share.

    Parameters
    ----------
    wi, wo : ndarray, shape (N, 3)
        Above the horizon.
    weights : ndarray, shape (N,)
        Inverse relative variance of each value, up to a factor.
    lengths : sequence of float
        Lengths of the process's covariance that are tried.
    """

    def __init__(self, wi: Array, wo: Array, weights: Array, lengths: Sequence[float] = LENGTHS) -> None:
        self._lobes = Lobes.at(wi, wo, weights)
        self._exchange = Exchange.at(wi, wo, weights)
        self._root = np.sqrt(weights)
        features = half_angle_features(wi, wo)
        centres = features[_spread_out(features)]
        self._processes = [_process(features / size, centres / size, self._root) for size in lengths]

    def evidence(self, f_r: Array, *, mixture: bool = True) -> Evidence:
        """Weigh values.

        Parameters
        ----------
        f_r : ndarray, shape (N,)
            All positive.
        mixture : bool
            Whether the mixture of lobes is found, or but the best single one, which is quicker.
        """
        residual = self._lobes.residual(np.log(f_r), mixture=mixture)
        bounded = self._bounded(residual)
        total, left = max(_marginal(process, self._root * bounded) for process in self._processes)
        share = self._lobes.share
        rms = float(np.sqrt(share @ np.square(residual)))
        robust = float(share @ np.log(np.hypot(residual, TYPICAL)))
        noise = float(np.sqrt(left / np.square(self._root).sum()))
        misfit = 0.5 * (float(np.log(np.hypot(rms, KNOWN))) + robust)
        return Evidence(total, rms, misfit, noise, self._exchange.asymmetry(residual))

    def _bounded(self, residual: Array) -> Array:
        """Return residuals (N,), the largest cut: the process is normal, and flakes and mirrors are not."""
        size = np.abs(residual)
        order = np.argsort(size)
        typical = size[order[np.searchsorted(np.cumsum(self._lobes.share[order]), USUAL_SHARE)]]
        return np.clip(residual, -LARGEST * typical, LARGEST * typical)


def _process(features: Array, centres: Array, root: Array) -> _Process:
    basis = _kernel(features, centres) * root[:, None]
    # Whitened by the centres' own covariance, basis.T @ basis is the process's (Nystrom 1930).
    factor = np.linalg.cholesky(_kernel(centres, centres) + 1e-6 * np.eye(len(centres)))
    basis = np.linalg.solve(factor, basis.T)
    values, vectors = np.linalg.eigh(basis @ basis.T)
    return _Process(np.maximum(values, 0.0), vectors.T @ basis)


def _marginal(process: _Process, whitened: Array) -> tuple[float, float]:
    """Return the best marginal likelihood over signals, per sample, and the noise's weighted square sum."""
    count = len(whitened)
    projected = np.square(process.axes @ whitened)
    signals = np.array(SIGNALS)[:, None]
    grown = 1.0 + signals * process.values
    left = np.maximum(np.square(whitened).sum() - (signals / grown) @ projected, 1e-12 * count)
    likelihood = -0.5 * np.log(left / count) - 0.5 * np.log(grown).sum(axis=1) / count
    best = int(np.argmax(likelihood))
    return float(likelihood[best]), float(left[best])


def _kernel(a: Array, b: Array) -> Array:
    """Squared-exponential covariance (Rasmussen & Williams 2006, equation 4.9)."""
    square = np.square(a).sum(1)[:, None] + np.square(b).sum(1) - 2.0 * a @ b.T
    return np.asarray(np.exp(-0.5 * np.maximum(square, 0.0)))


def _spread_out(features: Array) -> NDArray[np.intp]:
    """Choose centres: each the point farthest from those chosen before (Gonzalez 1985)."""
    chosen = [0]
    distance = np.square(features - features[0]).sum(1)
    while len(chosen) < min(CENTRES, len(features)):
        farthest = int(np.argmax(distance))
        if distance[farthest] < 1e-8:
            break
        chosen.append(farthest)
        distance = np.minimum(distance, np.square(features - features[farthest]).sum(1))
    return np.array(chosen, dtype=np.intp)
