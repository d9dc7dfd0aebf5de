"""Linearity of a sensor: mean signal over exposure time (EMVA 1288 release 4, section 6.7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.errors import BadInput

if TYPE_CHECKING:
    from numpy.typing import NDArray

FILL = (0.05, 0.95)
"""Part of the range in which deviations count."""

_NEAR_TOP = 0.9
_PERCENTILE = 99.0


@dataclass(frozen=True, eq=False)
class Linearity:
    """Signal over exposure, and how far it is from a straight line.

    Attributes
    ----------
    exposure_s, signal_dn : ndarray, shape (N,)
        The levels between 5 and 95 % of the range.
    offset_dn, slope_dn_per_s : float
        The line of least relative deviations.
    deviation : ndarray, shape (N,)
        Relative deviations from it.
    """

    exposure_s: NDArray[np.float64]
    signal_dn: NDArray[np.float64]
    offset_dn: float
    slope_dn_per_s: float
    deviation: NDArray[np.float64]

    @property
    def error(self) -> float:
        """LE: the mean absolute relative deviation."""
        return float(np.mean(np.abs(self.deviation)))

    @property
    def largest(self) -> float:
        """Largest absolute relative deviation."""
        return float(np.max(np.abs(self.deviation)))


def bright_region(light_dn: Any, usable: NDArray[np.bool_], cfa: Any) -> list[NDArray[np.bool_]]:
    """Pixels of each channel that are nearly as bright as its brightest, so that all clip together.

    Parameters
    ----------
    light_dn : ndarray, shape (H, W)
        A flat that clips nowhere, above dark level, DN.
    usable : ndarray of bool, shape (H, W)
    cfa : ndarray of int, shape (2, 2)

    Returns
    -------
    list of ndarray of bool, shape (H, W)
        One for each channel.
    """
    cells = np.asarray(cfa)
    rows, cols = np.indices(np.shape(light_dn))
    channel = cells[rows % 2, cols % 2]
    regions = []
    for index in range(int(cells.max()) + 1):
        mine = usable & (channel == index)
        top = float(np.percentile(light_dn[mine], _PERCENTILE)) if mine.any() else 0.0
        regions.append(mine & (light_dn > _NEAR_TOP * top))
    return regions


def fit_linearity(exposure_s: Any, signal_dn: Any, clear: NDArray[np.bool_], range_dn: float) -> Linearity:
    """Fit a straight line with least relative deviations.

    Parameters
    ----------
    exposure_s, signal_dn : ndarray, shape (N,)
        Mean light signal at each exposure.
    clear : ndarray of bool, shape (N,)
        Where nothing clips.
    range_dn : float
        Clip level above black, DN.

    Returns
    -------
    Linearity

    Raises
    ------
    BadInput
        Fewer than three levels between 5 and 95 % of the range.
    """
    times, signals = np.asarray(exposure_s, dtype=np.float64), np.asarray(signal_dn, dtype=np.float64)
    inside = clear & (signals > FILL[0] * range_dn) & (signals < FILL[1] * range_dn)
    if np.count_nonzero(inside) < 3:
        what = f"{np.count_nonzero(inside)} levels of light between 5 and 95 % of the range"
        raise BadInput(what, todo="shoot pairs of flats at more exposures below clipping")
    times, signals = times[inside], signals[inside]
    design = np.column_stack([np.ones_like(times), times]) / signals[:, np.newaxis]
    (offset, slope), *_ = np.linalg.lstsq(design, np.ones_like(times), rcond=None)
    line = offset + slope * times
    return Linearity(times, signals, float(offset), float(slope), (signals - line) / line)
