"""Where a sensor saturates, from frames that are far too long, told by shorter ones.

A pixel that a shorter frame predicts far above everything the sensor ever delivers is saturated, whatever
it reads; the spread of such readings is that of the level itself. Metadata are not asked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

CLIP_SIGMAS = 6.0
"""A count within so many standard deviations of the saturation level may be a clipped one."""

SURELY = 1.3
"""A pixel is saturated where it should read this many times the largest signal there is."""

_LEAST_PIXELS = 100


@dataclass(frozen=True, eq=False)
class Saturation:
    """Saturation at each position of the 2 x 2 cell.

    Attributes
    ----------
    level_dn : ndarray, shape (2, 2)
        Mean reading of saturated pixels, black included, DN; NaN where none were seen.
    spread_dn : ndarray, shape (2, 2)
        Their standard deviation, DN: 0 where the converter ends first.
    pixels : ndarray of int, shape (2, 2)
        How many there were.
    """

    level_dn: NDArray[np.float64]
    spread_dn: NDArray[np.float64]
    pixels: NDArray[np.int64]

    @property
    def clip_dn(self) -> NDArray[np.float64]:
        """Count from which a sample may be clipped, whole DN, shape (2, 2)."""
        return np.floor(self.level_dn - CLIP_SIGMAS * self.spread_dn + 0.5)

    def clip_of_channels(self, cfa: Any, channels: int) -> tuple[float, ...]:
        """Clip level of each channel: the lowest of its positions."""
        cells = np.asarray(cfa)
        return tuple(float(self.clip_dn[cells == channel].min()) for channel in range(channels))


def measure_saturation(over: Any, rate_dn_per_s: Any, bias_dn: Any, exposure_s: float) -> Saturation:
    """Look at one frame that is far too long.

    Parameters
    ----------
    over : ndarray, shape (H, W)
        Its counts, black included, DN.
    rate_dn_per_s : ndarray, shape (H, W)
        Signal per second, from a frame that clips nowhere.
    bias_dn : ndarray, shape (H, W), or float
        Level without signal, DN.
    exposure_s : float
        Of the long frame.

    Returns
    -------
    Saturation
    """
    level, spread = np.full((2, 2), np.nan), np.full((2, 2), np.nan)
    pixels = np.zeros((2, 2), dtype=np.int64)
    largest = float(np.max(over - bias_dn))
    surely = np.asarray(rate_dn_per_s) * exposure_s > SURELY * largest
    for row in (0, 1):
        for col in (0, 1):
            cut = np.s_[row::2, col::2]
            readings = np.asarray(over)[cut][surely[cut]].astype(np.float64)
            pixels[row, col] = readings.size
            if readings.size >= _LEAST_PIXELS:
                level[row, col], spread[row, col] = readings.mean(), readings.std()
    return Saturation(level, spread, pixels)
