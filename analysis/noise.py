"""How the noise goes with the brightness, from residuals alone.

Samples that state no uncertainty still show one. A detector has noise that does not know the signal (dark
current, reading), noise that grows with its root (photons), and noise that grows with it (lamp, distances,
speckle): the variance of f_r is a + b f + c f^2, none of them negative; and it may be constant in the loss's
own measure. All data of a channel determine these few numbers, so that the data which alone see a narrow lobe
need not tell their own noise as well (Carroll & Ruppert 1988, chapter 3).

The coefficients are those under which normal residuals are most likely, found by Fisher's scoring: least
squares of the squared residuals, weighted by the variance of the round before, without negative coefficients.
Gross errors are kept out by medians in place of the squares, among data of like brightness.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TOP, MOST, MOST_ROBUST = 100, 300, 900
"""How many of the brightest samples, and at most how many of the others, tell the noise."""
ROUNDS, SETTLED = 30, 0.05
MOST_IN_A_ROUND = 100.0
"""Largest growth of a datum's variance in a round: one that a law all but forbids would decide the next."""
ALIKE = 40
"""Data of like brightness of which half may be gross errors."""
NORMAL = 1.4826**2
"""Variance of normal residuals over the median of their squares."""
LEAST = 1e-24
"""Least variance in units of the mean square: an exact fit leaves no noise to describe."""
RIDGE = 1e-10
"""Keeps terms apart that are the same for all data, as where the light never moves."""
SUBSETS = np.array([[bool(number >> k & 1) for k in range(4)] for number in range(1, 16)])
"""Which of the four terms may be there."""
WORTH = 4.0
"""Gain of chi-square for which a term is taken in: 1 in 20 terms that are not there passes."""


def noise_variance(
    square: Array, f: Array, slope: Array, used: NDArray[np.bool_], *, robust: bool = False
) -> Array:
    """Estimate the variance of each residual, each channel alone.

    Parameters
    ----------
    square : ndarray, shape (N, C)
        Squared residuals.
    f : ndarray, shape (N, C)
        The model, in 1/sr.
    slope : ndarray, shape (N, C)
        Derivative of the residual by f.
    used : ndarray of bool, shape (N, C)
        Which data count.
    robust : bool
        Whether some of the data may be gross errors.

    Returns
    -------
    ndarray, shape (N, C)
        Variances.
    """
    bright = np.maximum(f, 0.0)
    # Channels of a sample go together, masked, so that all channels are searched at once.
    ones = np.ones(len(f))
    brightness = bright @ (1.0 / np.maximum(ones @ bright, LEAST))
    rows = _told(np.flatnonzero(used @ ones[: f.shape[1]]), brightness, MOST_ROBUST if robust else MOST)
    terms = _terms(bright[rows].T, slope[rows].T)
    size = np.maximum(terms.max(axis=2), LEAST)
    share = _shares(square[rows].T, terms / size[..., None], used[rows].T, robust=robust) / size
    flat, constant, photons, signal = share.T
    variance = flat + np.square(slope) * (constant + bright * (photons + bright * signal))
    # Where a model is black, noise in proportion to it would be none.
    return np.asarray(np.maximum(variance, LEAST * (ones[: len(rows)] @ square[rows]) / len(rows)))


def _terms(bright: Array, slope: Array) -> Array:
    """Variances of residuals (C, 4, n) for unit coefficients: of noise of the four kinds named above."""
    square = np.square(slope)
    return np.stack([np.ones_like(bright), square, square * bright, square * np.square(bright)], axis=1)


def _told(rows: NDArray[np.intp], brightness: Array, most: int) -> NDArray[np.intp]:
    """Choose rows that tell the noise: the brightest, which are few, and some of the others."""
    if len(rows) <= TOP + most:
        return rows
    split = np.argpartition(brightness[rows], -TOP)
    return np.asarray(rows[np.concatenate([split[-TOP:], split[: -TOP : -(-len(rows) // most)]])])


def _shares(square: Array, terms: Array, used: NDArray[np.bool_], *, robust: bool) -> Array:
    """Find the coefficients (C, K) of terms (C, K, n) from squared residuals (C, n)."""
    unit = np.array([np.median(each[known]) for each, known in zip(square, used, strict=True)])
    mean = np.array([np.mean(each[known]) for each, known in zip(square, used, strict=True)])
    unit = np.where(robust & (unit > 0.0), unit, mean)[:, None]
    square = square / np.where(unit > 0.0, unit, 1.0)
    groups = [_groups(each[-1], known) for each, known in zip(terms, used, strict=True)] if robust else []
    # Begin with noise of which every term has its part.
    share = 1.0 / np.maximum(terms.mean(axis=2), LEAST)
    best, least = share, np.full(len(share), np.inf)
    for _ in range(ROUNDS):
        variance = (share[:, None] @ terms)[:, 0] + LEAST
        standard = square / variance
        for c, each in enumerate(groups):
            for group in each:
                standard[c, group] = NORMAL * np.median(standard[c, group])
        # Rounds may overshoot; the one under which the residuals are most likely counts.
        unlikely = np.einsum("cn,cn->c", used, np.log(variance) + standard)
        better = unlikely < least
        best, least = np.where(better[:, None], share, best), np.where(better, unlikely, least)
        before, weighted = share, terms * (used / variance)[:, None]
        standard = np.minimum(standard, MOST_IN_A_ROUND)
        share = _positive(weighted @ weighted.transpose(0, 2, 1), (weighted @ standard[..., None])[..., 0])
        if np.all(np.abs(share - before) <= SETTLED * share):
            break
    return np.asarray(best * unit)


def _groups(brightness: Array, used: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Group data of like brightness."""
    kept = np.flatnonzero(used)
    order = kept[np.argsort(brightness[kept], kind="stable")]
    return np.array_split(order, max(1, len(order) // ALIKE))


def _positive(normal: Array, right: Array) -> Array:
    """Solve least squares (C, K, K), (C, K) by the subset of positive coefficients that is worth most."""
    size = np.sqrt(np.maximum(np.einsum("ckk->ck", normal), np.finfo(float).tiny))
    scaled = normal / (size[:, :, None] * size[:, None, :]) + RIDGE * np.eye(right.shape[1])
    right = right / size
    kept = SUBSETS[:, None, :, None] & SUBSETS[:, None, None, :]
    found = np.linalg.solve(
        np.where(kept, scaled, np.eye(right.shape[1])), np.where(SUBSETS[:, None], right, 0.0)[..., None]
    )[..., 0]
    # Squares of normal residuals have the variance 2: half of the gain is a chi-square's.
    gain = 0.5 * np.einsum("sck,ck->sc", found, right) - WORTH * SUBSETS.sum(axis=1)[:, None]
    gain = np.where((found >= 0.0).all(axis=-1), gain, -np.inf)
    return np.asarray(found[gain.argmax(axis=0), np.arange(len(right))] / size)
