"""How well the frames of a bracket agree with their merge: the check that needs no truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from capture.clip import CLIPPED
from capture.frames import any_in_cell, over, thin, thinning, tile
from capture.merge import Flag

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.dark import Subtrahend
    from capture.frames import Stack
    from capture.merge import Merged

RANGE = (60.0 / 255.0, 240.0 / 255.0)
"""Counts that are compared, as fractions of the clip level: above rounding, below saturation."""

_SAMPLE_PIXELS = 4_000_000


@dataclass(frozen=True)
class FrameAgreement:
    """One frame against the merge.

    Attributes
    ----------
    samples : int
        Samples compared: in range, not hot, not over range in the merge.
    median : float
        Median of |x / (L t) - 1| over them; NaN where there are none.
    median_signed : float
        Median of x / (L t) - 1.
    clean_samples : int
        Those of them with no clipped sample in their 2 x 2 cell.
    clean_median : float
        Median of |x / (L t) - 1| over these.
    """

    samples: int
    median: float
    median_signed: float
    clean_samples: int
    clean_median: float


@dataclass(frozen=True)
class Agreement:
    """All frames against the merge; `overall` pools their samples.

    Attributes
    ----------
    range_dn : tuple of float
        Lowest and highest count compared.
    frames : tuple of FrameAgreement
        In the stack's order.
    overall : FrameAgreement
        All samples together.
    """

    range_dn: tuple[float, float]
    frames: tuple[FrameAgreement, ...]
    overall: FrameAgreement


def agreement(stack: Stack, dark: Subtrahend, merged: Merged) -> Agreement:
    """Compare each frame with what the merge predicts for it; of large frames, a part.

    Parameters
    ----------
    stack : Stack
        The frames, with the exposure times of the merge.
    dark : Subtrahend
        Their dark levels.
    merged : Merged
        Their merge.

    Returns
    -------
    Agreement
    """
    step = thinning(stack.shape, _SAMPLE_PIXELS)
    part, flags, radiance = stack.thinned(step), thin(merged.flags, step), thin(merged.radiance, step)
    clip = np.reshape(np.asarray(merged.report.clip_dn), (2, 2))
    black = float(np.median(dark.level_dn[0]))
    low, high = (black + part * (float(clip.min()) - black) for part in RANGE)
    clipped_from = tile(black + CLIPPED * (clip - black), part.shape)
    usable = (flags & np.uint8(Flag.OVER_RANGE | Flag.HOT)) == 0
    usable &= radiance > 0.0
    deviations, cleans = [], []
    for counts, whole, seconds in zip(part.arrays(), dark.level_dn, stack.exposure_s, strict=True):
        level = over(thin(whole, step), part.shape)
        chosen = usable & (counts >= low) & (counts <= high)
        signal = (counts - level.astype(np.float64))[chosen]
        deviations.append(signal / (radiance[chosen] * seconds) - 1.0)
        cleans.append(~any_in_cell(counts >= clipped_from)[chosen])
    frames = tuple(_summary(d, c) for d, c in zip(deviations, cleans, strict=True))
    return Agreement((low, high), frames, _summary(np.concatenate(deviations), np.concatenate(cleans)))


def _summary(deviation: NDArray[np.float64], clean: NDArray[np.bool_]) -> FrameAgreement:
    cleaned = deviation[clean]
    return FrameAgreement(
        samples=deviation.size,
        median=_median(np.abs(deviation)),
        median_signed=_median(deviation),
        clean_samples=cleaned.size,
        clean_median=_median(np.abs(cleaned)),
    )


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if values.size else math.nan
