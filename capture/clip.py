"""Where a sensor clips: from its calibration, from the frames, or, last, from what the file claims.

Metadata are often wrong and never per channel. A clipped region gives itself away: many samples at one
level near the top of a frame, where a shorter frame says that they should differ and be brighter.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from capture.frames import Stack, tile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.sensor import SensorModel

RAMP_START, RAMP_END = 0.90, 0.97
"""A sample's weight falls from 1 to 0 between these fractions of the clip level, black taken off. A hard
limit would let noise decide which samples survive, and bias radiances near it by up to 0.15 %."""

CLIPPED = 0.99
"""From this fraction of the clip level on a sample is clipped, and its neighbours in the cell are suspect."""

_SPIKE_WINDOW = 0.01
_SPIKE_SAMPLES = 20
_SPIKE_FRACTION = 1e-4
_BRIGHTER = 1.1
_NEAR_TOP = 0.05
_CROWDED = 10.0  # how many times more samples clip than have one of the codes just below
_LEAST_SPAN_DN = 50.0  # below, rounding makes levels repeat
_LEAST_FRACTION = 0.5  # no position of the cell clips at less than half of another's clip level
_NEVER = 1e30
_NATURAL_LIMITS = frozenset(2**bits - 1 for bits in range(8, 17))


def clip_levels(
    stack: Stack, black_dn: NDArray[np.float64], sensor: SensorModel | None = None
) -> NDArray[np.float64]:
    """Clip level at each position of the 2 x 2 cell.

    Parameters
    ----------
    stack : Stack
        The frames; pass a part of a large one.
    black_dn : ndarray, shape (2, 2)
        Black level per position.
    sensor : SensorModel, optional
        Its clip levels are used where it is given.

    Returns
    -------
    ndarray of float, shape (2, 2)
        In DN, black included; infinite where nothing is known.
    """
    if sensor is not None:
        channels = stack.cfa if stack.cfa is not None else np.zeros((2, 2), dtype=np.int64)
        return np.array([[sensor.clip_of_channel(int(c)) for c in row] for row in channels])
    measured = measured_clip(stack, black_dn)
    return np.array(
        [[stack.white_dn if lv is None else min(lv, stack.white_dn) for lv in row] for row in measured]
    )


def measured_clip(stack: Stack, black_dn: NDArray[np.float64]) -> list[list[float | None]]:
    """Clip level that the frames show at each position of the 2 x 2 cell; None where they show none.

    Parameters
    ----------
    stack : Stack
        The frames; pass a part of a large one.
    black_dn : ndarray, shape (2, 2)
        Black level per position.
    """
    return [[_measured_level(stack, r, c, float(black_dn[r, c])) for c in (0, 1)] for r in (0, 1)]


def single_frame_clip(counts: NDArray[np.integer[Any]], black_dn: float) -> float | None:
    """Clip level that one frame shows by itself: far more samples at its highest count than just below.

    Parameters
    ----------
    counts : ndarray of int
        Samples of one position of the cell.
    black_dn : float
        Their black level.
    """
    if counts.size == 0:
        return None
    top = int(counts.max())
    span = top - black_dn
    if span < _LEAST_SPAN_DN:
        return None
    at_top = np.count_nonzero(counts == top)
    below = np.count_nonzero(counts >= top - _NEAR_TOP * span) - at_top
    usual = below / (_NEAR_TOP * span)
    enough = max(_SPIKE_SAMPLES, _SPIKE_FRACTION * counts.size, _CROWDED * usual)
    return float(top) if at_top >= enough else None


def _measured_level(stack: Stack, row: int, col: int, black_dn: float) -> float | None:
    """Lowest clip level that frames longer than the shortest show at one position of the cell."""
    order = np.argsort(stack.exposure_s, kind="stable")
    frames = stack.arrays()
    least = max(_LEAST_SPAN_DN, _LEAST_FRACTION * (max(float(c.max()) for c in frames) - black_dn))
    found = []
    for shorter, longer in itertools.pairwise(order):
        ratio = stack.exposure_s[longer] / stack.exposure_s[shorter]
        counts = frames[longer][row::2, col::2].ravel()
        if ratio < _BRIGHTER or counts.size == 0:
            continue
        top = float(counts.max())
        near = counts >= top - max(2.0, _SPIKE_WINDOW * (top - black_dn))
        if top - black_dn < least or np.count_nonzero(near) < max(
            _SPIKE_SAMPLES, _SPIKE_FRACTION * counts.size
        ):
            continue
        level, spread = _spike(counts[near])
        predicted = (frames[shorter][row::2, col::2].ravel()[near] - black_dn) * ratio
        brighter = float(np.median(predicted)) > _BRIGHTER * (level - black_dn)
        if brighter or (level == top and level in _NATURAL_LIMITS):
            found.append(level - 4.0 * spread)
    # The shortest frame has none to compare with: only a spike where converters end is believed.
    samples = frames[int(order[0])][row::2, col::2]
    alone = single_frame_clip(samples, black_dn) if np.issubdtype(samples.dtype, np.integer) else None
    if alone is not None and alone in _NATURAL_LIMITS:
        found.append(alone)
    return min(found) if found else None


def _spike(samples: NDArray[Any]) -> tuple[float, float]:
    """Most frequent level among the brightest samples, and the robust spread above it.

    Samples below the level may be ordinary ones; those above can only be clipped ones with noise.
    """
    values, numbers = np.unique(np.rint(samples), return_counts=True)
    level = float(values[np.argmax(numbers)])
    return level, 1.4826 * float(np.median(samples[samples >= level] - level))


class RampLevels(NamedTuple):
    """Where the ramp runs at each position of the cell, each of shape (2, 2).

    Attributes
    ----------
    start, end : ndarray
        Counts from which a sample loses weight, and from which it has none.
    slope : ndarray
        Weight lost per DN between them.
    clipped : ndarray
        Count from which a sample is clipped.
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    slope: NDArray[np.float64]
    clipped: NDArray[np.float64]

    @classmethod
    def of(cls, clip_dn: NDArray[np.float64], black_dn: NDArray[np.float64]) -> RampLevels:
        """Levels for clip levels, which may be infinite, and black levels."""
        span = np.minimum(clip_dn - black_dn, _NEVER)
        start, end, clipped = (black_dn + part * span for part in (RAMP_START, RAMP_END, CLIPPED))
        return cls(start, end, 1.0 / (end - start), clipped)


class Ramp:
    """Weights of samples near the clip level, as tiles over a block of rows.

    Parameters
    ----------
    clip_dn, black_dn : ndarray, shape (2, 2)
        Per position of the cell; clip levels may be infinite.
    shape : tuple of int
        Rows (even start) and columns of the largest block.
    dtype : numpy dtype
        Of the weights.
    """

    def __init__(
        self,
        clip_dn: NDArray[np.float64],
        black_dn: NDArray[np.float64],
        shape: tuple[int, int],
        dtype: np.dtype[np.floating],
    ) -> None:
        levels = RampLevels.of(clip_dn, black_dn)
        self.lowest_start = float(levels.start.min())
        """No sample below this level is near its clip level."""
        self.highest_end = float(levels.end.max())
        """No sample from this level on has any weight."""
        self._end = self._tile(levels.end, shape).astype(dtype)
        self._slope = self._tile(levels.slope, shape).astype(dtype)
        self._clipped = self._tile(levels.clipped, shape).astype(dtype)

    @staticmethod
    def _tile(cell: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
        return cell[:1, :1] if np.all(cell == cell[0, 0]) else tile(cell, shape)

    def weights(
        self, counts: NDArray[np.floating], out: NDArray[np.floating] | None = None
    ) -> NDArray[np.floating]:
        """Weight of each sample of a block: 1 well below the clip level, 0 near it."""
        weights: NDArray[np.floating] = np.subtract(self._cut(self._end, counts), counts, out=out)
        weights *= self._cut(self._slope, counts)
        return np.clip(weights, 0.0, 1.0, out=weights)

    def clipped(self, counts: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Whether each sample of a block is clipped."""
        return counts >= self._cut(self._clipped, counts)

    @staticmethod
    def _cut(values: NDArray[np.floating], counts: NDArray[np.floating]) -> NDArray[np.floating]:
        return values if values.size == 1 else values[: counts.shape[0], : counts.shape[1]]
