"""Linearity of a sensor: mean signal over exposure time (EMVA 1288 release 4, section 6.7)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

FILL = (0.05, 0.95)
"""Part of the range in which deviations count."""

LEAST_LEVELS = 5
"""Levels from which a bend is fitted; with fewer it would follow their noise."""

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


@dataclass(frozen=True)
class Bend:
    """How a response departs from proportion: count over light, relative to that near nought.

    It is 1 + sum c_k s^k, k from 1, with s the count above black over `range_dn`.

    Attributes
    ----------
    range_dn : float
        Clip level above black, DN.
    coefficients : tuple of float
        c_1, c_2, ...
    error : float
        Relative standard uncertainty that is left where the bend is taken out.
    """

    range_dn: float
    coefficients: tuple[float, ...]
    error: float

    def of(self, signal_dn: Any) -> Any:
        """Count over light at counts above black, relative to that near nought; beyond the range as at it."""
        share = np.clip(np.asarray(signal_dn) / self.range_dn, 0.0, 1.0)
        return 1.0 + sum(c * share ** (k + 1) for k, c in enumerate(self.coefficients))

    @property
    def spread(self) -> float:
        """Standard deviation over the range of what it takes out."""
        return float(np.std(self.of(np.linspace(0.0, self.range_dn, 101))))


def fit_bend(of_channels: Sequence[Linearity], range_dn: float) -> Bend | None:
    """Fit one bend to the levels of all channels, each with a responsivity of its own.

    The line is through nought, unlike that of `fit_linearity`: an offset that a bend puts into a straight
    line would be light where there is none.

    Parameters
    ----------
    of_channels : sequence of Linearity
    range_dn : float

    Returns
    -------
    Bend or None
        None with too few levels.
    """
    usable = [each for each in of_channels if len(each.signal_dn) >= LEAST_LEVELS]
    if not usable:
        return None
    fits = []
    for each in usable:
        share = each.signal_dn / range_dn
        rate = each.signal_dn / each.exposure_s
        design = np.column_stack([np.ones_like(share), share, share**2])
        solution, *_ = np.linalg.lstsq(design, rate / rate.mean(), rcond=None)
        left = rate / rate.mean() - design @ solution
        freedom = len(share) - len(solution)
        covariance = np.linalg.inv(design.T @ design) * float(left @ left) / freedom
        fits.append((solution / solution[0], covariance / solution[0] ** 2, left))
    mean = np.mean([solution for solution, _, _ in fits], axis=0)
    covariance = np.sum([each for _, each, _ in fits], axis=0) / len(fits) ** 2
    shares = np.linspace(0.0, 1.0, 21)
    powers = np.column_stack([shares, shares**2])
    u_fit = float(np.sqrt(np.einsum("ij,jk,ik->i", powers, covariance[1:, 1:], powers).max()))
    scatter = math.sqrt(float(np.mean(np.concatenate([left for _, _, left in fits]) ** 2)))
    return Bend(range_dn, tuple(float(c) for c in mean[1:]), math.hypot(u_fit, scatter))
