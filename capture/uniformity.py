"""How unequal pixels are: of response (PRNU) and in the dark (DSNU), without the noise over time.

Two frames of the same scene share the pixels' inequality and nothing of their noise, so the mean product of
their deviations is its variance, unbiased however noisy they are. What varies smoothly (lamp, lens, white
plate) is taken out first, by a quadratic surface over each tile (EMVA 1288 release 4, section 8.1, takes a
high pass for that).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

TILE = 16
"""Pixels of one position of the CFA cell along a tile's edge."""

_MOST_BAD = 0.1
_BRIGHT = 0.5
"""Tiles below this part of the brightest do not count, nor those whose own pixels differ by more."""


def _surface() -> NDArray[np.float64]:
    """Orthonormal basis of the quadratic surfaces over a tile, shape (TILE^2, 6)."""
    x, y = (part.ravel() for part in np.meshgrid(*(np.linspace(-1.0, 1.0, TILE),) * 2))
    design = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    return np.asarray(np.linalg.qr(design)[0], dtype=np.float64)


_SURFACE = _surface()


def relative_unevenness(first: Any, second: Any, usable: NDArray[np.bool_]) -> float:
    """Return the relative standard deviation of the pixels' responses (PRNU), from two flat frames.

    Parameters
    ----------
    first, second : ndarray, shape (H, W)
        Light signal, dark level taken off, DN.
    usable : ndarray of bool, shape (H, W)
        False for hot pixels.

    Returns
    -------
    float
        Median over the tiles that are at least half as bright as the brightest and hold no edge of the
        scene, over all positions of the cell. NaN where no tile can be used.
    """
    return float(np.sqrt(max(_typical_product(first, second, usable, relative=True), 0.0)))


def dark_unevenness_dn(first: Any, second: Any, usable: NDArray[np.bool_]) -> float:
    """Return the standard deviation of the pixels' dark levels (DSNU), from two means of dark frames.

    Parameters
    ----------
    first, second : ndarray, shape (H, W)
        Means over different frames of one exposure, DN.
    usable : ndarray of bool, shape (H, W)
        False for hot pixels.

    Returns
    -------
    float
        In DN, median over tiles; NaN where no tile can be used.
    """
    return float(np.sqrt(max(_typical_product(first, second, usable, relative=False), 0.0)))


def _typical_product(first: Any, second: Any, usable: NDArray[np.bool_], *, relative: bool) -> float:
    products, levels = [], []
    for row in (0, 1):
        for col in (0, 1):
            cut = np.s_[row::2, col::2]
            product, level = _products(
                _tiles(np.asarray(first)[cut]), _tiles(np.asarray(second)[cut]), _tiles(usable[cut]), relative
            )
            products.append(product)
            levels.append(level)
    product, level = np.concatenate(products), np.concatenate(levels)
    chosen = np.isfinite(product)
    if relative and chosen.any():
        chosen &= level > _BRIGHT * level[chosen].max()
    return float(np.median(product[chosen])) if chosen.any() else float("nan")


def _tiles(values: NDArray[Any]) -> NDArray[Any]:
    """Cut whole tiles: shape (tiles, TILE^2)."""
    rows, cols = values.shape[0] // TILE, values.shape[1] // TILE
    whole = values[: rows * TILE, : cols * TILE].reshape(rows, TILE, cols, TILE)
    return whole.transpose(0, 2, 1, 3).reshape(rows * cols, TILE * TILE)


def _products(a: Any, b: Any, good: NDArray[np.bool_], relative: bool) -> tuple[Any, Any]:
    """Mean product of the deviations of each tile, and the tile's level; NaN where too few pixels count."""
    numbers = good.sum(axis=1)
    fine = numbers >= (1.0 - _MOST_BAD) * TILE * TILE
    residuals, means = [], []
    for values in (a, b):
        mean = np.where(good, values, 0.0).sum(axis=1) / np.maximum(numbers, 1)
        filled = np.where(good, values, mean[:, np.newaxis])
        rest = filled - (filled @ _SURFACE) @ _SURFACE.T
        residuals.append(np.where(good, rest, 0.0))
        means.append(mean)
    product = (residuals[0] * residuals[1]).sum(axis=1) / (numbers - _SURFACE.shape[1])
    level = np.sqrt(np.maximum(means[0] * means[1], 0.0))
    if relative:
        lowest, highest = (
            bound(np.where(good, a + b, fill), axis=1)
            for bound, fill in ((np.min, np.inf), (np.max, -np.inf))
        )
        fine &= (level > 0.0) & (lowest > _BRIGHT * highest)
        product = product / np.where(fine, level**2, 1.0)
    return np.where(fine, product, np.nan), level
