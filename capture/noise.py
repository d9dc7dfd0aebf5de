"""The noise that a bracket shows by itself: how far its frames scatter about their common radiance.

Without a sensor model the weights of a merge are Poisson's, which need no gain; but variances and a
consistency check need the gain. The residuals of the frames hold it: with the Poisson estimate L = sum x /
sum t of n frames and p = t_i / sum t, the residual r_i = x_i - L t_i has

    var(r_i) = K L t_i (1 - p) + c (1 - 2 p + n p^2)

for noise K x + c per frame: a straight line whose slope is the gain (quasi-likelihood: McCullagh and Nelder
1989, section 9.2). Errors of the exposure times shift whole frames, not single pixels: each frame's median
residual at each level is taken off first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_FEWEST = 1000
_LEVELS = 24
_PER_LEVEL = 50
_SMALLEST_GAIN = 1e-6  # DN per electron and DN of range: no pixel holds more than a million electrons


@dataclass(frozen=True)
class Noise:
    """Variance of a count: ``gain_dn_per_e * signal + floor_dn2``.

    Attributes
    ----------
    gain_dn_per_e : float
        DN per electron.
    floor_dn2 : float
        Variance without light, in DN squared.
    source : str
        "sensor model", "measured from the frames", or "assumed".
    """

    gain_dn_per_e: float
    floor_dn2: float
    source: str


def measured_noise(
    signal_dn: NDArray[np.floating],
    usable: NDArray[np.bool_],
    exposure_s: NDArray[np.float64],
    least_floor_dn2: float,
) -> Noise | None:
    """Gain and floor from the scatter of the frames about their common radiance.

    Parameters
    ----------
    signal_dn : ndarray, shape (N, P)
        Counts above black of P pixels in N frames.
    usable : ndarray of bool, shape (N, P)
        Samples to use.
    exposure_s : ndarray, shape (N,)
        Exposure times.
    least_floor_dn2 : float
        The floor is not below this: the rounding of the counts.

    Returns
    -------
    Noise or None
        None where there are too few samples, or no noise to see.
    """
    times = exposure_s[:, np.newaxis]
    number = usable.sum(axis=0)
    total = (usable * times).sum(axis=0)
    use = usable & (number > 1)
    if np.count_nonzero(use) < _FEWEST:
        return None
    radiance = np.where(use, signal_dn, 0.0).sum(axis=0) / np.where(total > 0, total, 1.0)
    part = times / np.where(total > 0, total, 1.0)
    predicted = radiance * times
    shot = predicted * (1.0 - part)
    floor = 1.0 - 2.0 * part + number * part**2
    use &= shot > 0.0
    rows = _rows(signal_dn - predicted, shot, floor, predicted, use)
    if len(rows) < 2:
        return None
    squares, shots, floors, sizes = np.array(rows).T
    gain, constant = _line(squares, shots, floors, sizes, least_floor_dn2)
    if gain < _SMALLEST_GAIN * float(predicted[use].max()):
        return None
    return Noise(gain, max(constant, least_floor_dn2), "measured from the frames")


def _rows(
    residual: NDArray[Any],
    shot: NDArray[Any],
    floor: NDArray[Any],
    level: NDArray[Any],
    use: NDArray[np.bool_],
) -> list[tuple[float, float, float, float]]:
    """Mean squared residual, shot and floor coefficient, and number, for each frame and level."""
    rows = []
    for frame, mask in enumerate(use):
        if np.count_nonzero(mask) < _PER_LEVEL:
            continue
        columns = np.stack([values[frame][mask] for values in (level, residual, shot, floor)])
        columns = columns[:, np.argsort(columns[0], kind="stable")]
        # Equal levels belong together: a part begins where the level changes.
        edges = columns[0][(np.arange(1, _LEVELS) * columns.shape[1]) // _LEVELS]
        starts = np.unique(np.concatenate([[0], np.searchsorted(columns[0], edges)]))
        for _level, found, of_shot, of_floor in np.split(columns, starts[1:], axis=1):
            size = len(found)
            if size < _PER_LEVEL:
                continue
            squares = (found - np.median(found)) ** 2
            # Pixels that moved or burn hot are no noise: leave out what is beyond five standard deviations.
            for _ in range(3):
                squares = squares[squares <= 25.0 * squares.mean()]
            kept = len(squares)
            rows.append(
                (
                    float(squares.mean()) * kept / (kept - 1),
                    float(of_shot.mean()),
                    float(of_floor.mean()),
                    float(kept),
                )
            )
    return rows


def _line(
    squares: NDArray[np.float64],
    shots: NDArray[np.float64],
    floors: NDArray[np.float64],
    sizes: NDArray[np.float64],
    least: float,
) -> tuple[float, float]:
    """Weighted least squares of squares = gain shots + constant floors, the constant not below its least."""
    gain, constant = 0.0, least
    expected = np.maximum(squares, 1e-12)
    for _ in range(4):
        weights = sizes / expected**2  # the variance of a mean square is 2 (mean square)^2 / n
        design = np.column_stack([shots, floors])
        normal = design.T @ (weights[:, np.newaxis] * design)
        if np.linalg.cond(normal) < 1e14:
            gain, constant = np.linalg.solve(normal, design.T @ (weights * squares))
        if constant < least or np.linalg.cond(normal) >= 1e14:
            constant = least
            rest = squares - constant * floors
            gain = float((weights * shots * rest).sum() / (weights * shots**2).sum())
        gain = max(float(gain), 0.0)
        expected = np.maximum(gain * shots + constant * floors, 1e-12)
    return gain, float(constant)
