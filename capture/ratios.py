"""Exposure ratios measured from the frames themselves, and exposure times that fit them.

Shutters keep their marked times to a percent or two; the frames know better. For two frames a, b of
exposures in the ratio r, samples are chosen by their sum a + b alone: given the sum, the Poisson split into
a and b depends on r only, so the choice biases nothing, while choosing by either frame would. Chosen
samples are summed over small blocks, the blocks' log-ratios combined robustly per position of the CFA cell
and brightness, and these groups joined with their scatter (DerSimonian and Laird 1986), which holds what
noise does not: non-linearity, crosstalk, glare.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.clip import Ramp
from capture.frames import any_in_cell, over, thin, thinning

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.dark import Subtrahend
    from capture.frames import Stack

TRUSTED_TOP = 0.88
"""Brightest predicted signal of the longer frame, as a fraction of the clip level: noise stays off it."""

TRUSTED_BOTTOM_DN = (50.0, 25.0)
"""Faintest predicted signal of the shorter frame, in DN: an error of half a DN in its black level stays
below 1 %. The second is taken where the first leaves too few samples."""

SIGNIFICANT_P = 1e-4
"""Fitted times replace the nominal ones where chance would explain the difference more rarely than this."""

_BLOCK = 4
_FEWEST_IN_BLOCK = 4
_FEWEST_BLOCKS = 12
_LEVELS = 3
_SAMPLE_PIXELS = 2_000_000


@dataclass(frozen=True)
class Ratio:
    """Measured ratio of two neighbouring exposures.

    Attributes
    ----------
    shorter, longer : int
        Indices of the two frames.
    nominal : float
        Ratio of the stated times.
    value, u : float
        Measured ratio and its standard uncertainty (k = 1), spread between channels and levels included;
        NaN where there were too few samples.
    blocks : int
        Blocks of samples it rests on.
    clean : bool
        False where samples beside clipped ones had to be taken: the ratio may be a few percent low.
    """

    shorter: int
    longer: int
    nominal: float
    value: float
    u: float
    blocks: int
    clean: bool


@dataclass(frozen=True)
class ExposureFit:
    """Exposure times that fit the measured ratios best.

    Attributes
    ----------
    exposure_s : tuple of float
        Times in seconds, in the frames' order; their geometric mean is that of the nominal times.
    chi_square : float
        Of the nominal ratios against the measured ones.
    freedom : int
        Number of measured ratios.
    significant : bool
        Whether the nominal times are refuted at `SIGNIFICANT_P`.
    """

    exposure_s: tuple[float, ...]
    chi_square: float
    freedom: int
    significant: bool


def measure_ratios(stack: Stack, dark: Subtrahend, clip_dn: NDArray[np.float64]) -> tuple[Ratio, ...]:
    """Measure the ratio of each pair of neighbouring exposures.

    Parameters
    ----------
    stack : Stack
        The frames of one scene.
    dark : Subtrahend
        Their dark levels.
    clip_dn : ndarray, shape (2, 2)
        Clip level per position of the cell, black included.

    Returns
    -------
    tuple of Ratio
        N - 1 ratios, by ascending exposure.
    """
    step = thinning(stack.shape, _SAMPLE_PIXELS)
    part = stack.thinned(step)
    order = sorted(range(len(part.counts)), key=lambda index: part.exposure_s[index])
    frames = part.arrays()
    levels = [over(thin(level, step), part.shape) for level in dark.level_dn]
    usable = np.ones(part.shape, dtype=bool) if dark.hot is None else ~thin(dark.hot, step)
    black = float(np.median(levels[0]))
    span = float(np.min(clip_dn)) - black
    ramp = Ramp(clip_dn, np.full((2, 2), black), part.shape, np.dtype(np.float64))
    ratios = []
    for shorter, longer in itertools.pairwise(order):
        counts = frames[longer].astype(np.float64)
        beside = any_in_cell(ramp.clipped(counts))
        low = frames[shorter] - levels[shorter].astype(np.float64)
        high = counts - levels[longer]
        nominal = part.exposure_s[longer] / part.exposure_s[shorter]
        attempts = [(usable & ~beside, bottom, True) for bottom in TRUSTED_BOTTOM_DN]
        attempts.append((usable, TRUSTED_BOTTOM_DN[0], False))
        value, u, blocks, clean = math.nan, math.nan, 0, True
        for mask, bottom, is_clean in attempts:
            groups = _groups(low, high, mask, nominal, (bottom, TRUSTED_TOP * span))
            if groups:
                log_ratio, u_log = _join(groups)
                value, u = math.exp(log_ratio), u_log * math.exp(log_ratio)
                blocks, clean = sum(group.blocks for group in groups), is_clean
                break
        ratios.append(Ratio(shorter, longer, nominal, value, u, blocks, clean))
    return tuple(ratios)


@dataclass(frozen=True)
class _Group:
    log_ratio: float
    variance: float
    blocks: int


def _groups(
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    usable: NDArray[np.bool_],
    nominal: float,
    limits: tuple[float, float],
) -> list[_Group]:
    """Log-ratio of each position of the cell and level of brightness that has enough blocks."""
    bottom, top = limits
    total = low + high
    chosen = usable & (total / (1.0 + nominal) >= bottom) & (total * nominal / (1.0 + nominal) <= top)
    groups = []
    for row, col in itertools.product((0, 1), (0, 1)):
        mask = chosen[row::2, col::2]
        number, a, b = (
            _block_sums(values)
            for values in (mask * 1.0, low[row::2, col::2] * mask, high[row::2, col::2] * mask)
        )
        full = (number >= _FEWEST_IN_BLOCK) & (a > 0.0) & (b > 0.0)
        number, a, b = number[full], a[full], b[full]
        if number.size < _FEWEST_BLOCKS:
            continue
        brightness = (a + b) / number
        parts = _LEVELS if number.size >= _LEVELS * _FEWEST_BLOCKS else 1
        rank = np.argsort(np.argsort(brightness, kind="stable"), kind="stable") * parts // number.size
        for level in range(parts):
            inside = rank == level
            groups.append(_group(np.log(b[inside] / a[inside]), a[inside] + b[inside]))
    return groups


def _block_sums(values: NDArray[Any]) -> Any:
    rows, cols = (size // _BLOCK for size in values.shape)
    cut = values[: rows * _BLOCK, : cols * _BLOCK]
    return cut.reshape(rows, _BLOCK, cols, _BLOCK).sum(axis=(1, 3))


def _group(logs: NDArray[np.float64], weights: NDArray[np.float64]) -> _Group:
    """Weighted mean of what lies within three robust standard deviations of the median."""
    middle = np.median(logs)
    spread = 1.4826 * np.median(np.abs(logs - middle))
    kept = np.abs(logs - middle) <= 3.0 * spread + 1e-12
    mean = float(np.average(logs[kept], weights=weights[kept]))
    number = int(np.count_nonzero(kept))
    variance = float(np.var(logs[kept], ddof=1)) / number if number > 1 else float(spread) ** 2
    return _Group(mean, max(variance, 1e-12), number)


def _join(groups: list[_Group]) -> tuple[float, float]:
    """Random-effects mean of the groups; u holds the spread between groups in full."""
    values = np.array([group.log_ratio for group in groups])
    weights = 1.0 / np.array([group.variance for group in groups])
    mean = float(np.average(values, weights=weights))
    excess = float((weights * (values - mean) ** 2).sum()) - (len(groups) - 1)
    scale = float(weights.sum() - (weights**2).sum() / weights.sum())
    between = max(0.0, excess / scale) if scale > 0.0 else 0.0
    weights = 1.0 / (1.0 / weights + between)
    return float(np.average(values, weights=weights)), math.sqrt(1.0 / float(weights.sum()) + between)


def fit_exposures(exposure_s: tuple[float, ...], ratios: tuple[Ratio, ...]) -> ExposureFit:
    """Exposure times that have the measured ratios, and whether the nominal times are refuted.

    Ratios of neighbours leave no redundancy, so the times follow exactly; a pair that could not be
    measured, or not without clipped neighbours, keeps its nominal ratio.

    Parameters
    ----------
    exposure_s : tuple of float
        Nominal times in seconds.
    ratios : tuple of Ratio
        From `measure_ratios`.

    Returns
    -------
    ExposureFit
    """
    from scipy.special import chdtri

    shift = np.zeros(len(exposure_s))
    chi_square, freedom = 0.0, 0
    for ratio in ratios:
        step = 0.0
        if ratio.clean and math.isfinite(ratio.value):
            step = math.log(ratio.value / ratio.nominal)
            chi_square += (step * ratio.value / ratio.u) ** 2
            freedom += 1
        shift[ratio.longer] = shift[ratio.shorter] + step
    times = np.asarray(exposure_s) * np.exp(shift - shift.mean())
    significant = freedom > 0 and chi_square > float(chdtri(freedom, SIGNIFICANT_P))
    return ExposureFit(tuple(float(t) for t in times), chi_square, freedom, significant)
