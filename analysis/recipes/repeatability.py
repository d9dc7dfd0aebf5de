"""How well repeated measurements of one sample agree: the floor of any uncertainty that is stated for it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROUNDS = 30
VIEW_EDGES_DEG = (0.0, 20.0, 40.0, 60.0, 90.0)
LEVELS = 5


@dataclass(frozen=True)
class Band:
    """Repeatability within a band of levels or of view angles.

    Attributes
    ----------
    quantity : str
        `level` (the reading) or `theta_o_deg`.
    low, high : float
        The band.
    relative : float
        Pooled standard deviation of one file over the band's pooled level.
    dof : int
        Degrees of freedom behind it.
    """

    quantity: str
    low: float
    high: float
    relative: float
    dof: int


@dataclass(frozen=True)
class Repeatability:
    """Standard deviation of one file's cell: root of `additive`^2 + (`relative` x level)^2.

    Attributes
    ----------
    files : int
        How many were compared.
    cells : int
        Cells that at least two of them have.
    additive : float
        In the unit of the readings.
    relative : float
        A part of the level.
    dof : int
        Degrees of freedom of both together.
    median_difference : float
        Median over cells of the range between files over their mean: 0.05 is 5 %. For information; not
        standard.
    bands : tuple of Band
        Pooled by level and by view angle.
    """

    files: int
    cells: int
    additive: float
    relative: float
    dof: int
    median_difference: float
    bands: tuple[Band, ...]

    def standard_deviation(self, level: Array) -> Array:
        """Return the standard deviation of one file at a level, in the unit of the readings."""
        return np.sqrt(self.additive**2 + np.square(self.relative * level))


def repeatability(cells: Array, theta_o: Array) -> Repeatability | None:
    """Compare files of one sample, cell by cell.

    Two components, one that does not depend on the level and one in proportion to it (Rocke & Lorenzato
    1995), fitted to the cells' variances with the weights of their chi-squared distribution.

    Parameters
    ----------
    cells : ndarray, shape (F, N)
        Reading of each file in each cell; NaN where a file has none.
    theta_o : ndarray, shape (N,)
        View angles in radians.

    Returns
    -------
    Repeatability or None
        None where no cell has two files.
    """
    count = np.isfinite(cells).sum(axis=0)
    shared = count >= 2
    if not shared.any():
        return None
    table, count = cells[:, shared], count[shared]
    level = np.nanmean(table, axis=0)
    dof = count - 1
    variance = np.nansum((table - level) ** 2, axis=0) / dof
    additive, relative = _components(level, variance, dof)
    spread = np.nanmax(table, axis=0) - np.nanmin(table, axis=0)
    positive = level > 0.0
    difference = float(np.median(spread[positive] / level[positive])) if positive.any() else np.nan
    edges = np.unique(np.quantile(level, np.linspace(0.0, 1.0, LEVELS + 1)))
    power = np.square(level)
    views = np.degrees(theta_o[shared])
    bands = [
        *_bands("level", level, edges, (power, variance, dof)),
        *_bands("theta_o_deg", views, np.array(VIEW_EDGES_DEG), (power, variance, dof)),
    ]
    return Repeatability(
        len(cells), int(shared.sum()), additive, relative, int(dof.sum()), difference, tuple(bands)
    )


def _components(level: Array, variance: Array, dof: Array) -> tuple[float, float]:
    """Additive and relative standard deviation, by weighted non-negative least squares, repeated."""
    from scipy.optimize import nnls

    scale = max(float(np.max(np.abs(level))), np.finfo(float).tiny)
    design = np.stack([np.ones_like(level), np.square(level / scale)], axis=-1)
    wanted = variance / scale**2
    expected = np.full(level.shape, max(float(np.average(wanted, weights=dof)), np.finfo(float).tiny))
    parts = np.zeros(2)
    for _ in range(ROUNDS):
        weight = np.sqrt(dof / 2.0) / expected
        parts, _ = nnls(design * weight[:, None] * expected.max(), wanted * weight * expected.max())
        expected = np.maximum(design @ parts, 1e-6 * expected.max() + np.finfo(float).tiny)
    return float(np.sqrt(parts[0]) * scale), float(np.sqrt(parts[1]))


def _bands(quantity: str, of: Array, edges: Array, pooled: tuple[Array, Array, Array]) -> list[Band]:
    """Pool the cells' squared levels, variances and degrees of freedom between edges."""
    power, variance, dof = pooled
    found = []
    for low, high in pairwise(edges.tolist()):
        chosen = (of >= low) & ((of < high) | (high == edges[-1]))
        freedom = int(dof[chosen].sum())
        level = float(np.sum(dof[chosen] * power[chosen]))
        if freedom and level > 0.0:
            relative = float(np.sqrt(np.sum(dof[chosen] * variance[chosen]) / level))
            found.append(Band(quantity, low, high, relative, freedom))
    return found
