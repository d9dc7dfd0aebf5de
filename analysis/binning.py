"""Pixels of a mosaic to bins: ratios of sums, one direction pair per bin for all colour channels.

A bin is a square block of pixels. Its value is a ratio of weighted sums, sum(w S) / sum(w X), where S is the
sample's signal and X what the same pixel would read from a surface of f = 1/sr: a ratio of sums has no bias
from a noisy denominator, a mean of ratios has. The colour filters of a mosaic sit on different pixels of the
block, so plain sums would give each channel its own centre, half a pixel apart, and a lobe's flank would turn
that into a coloured error. The weights are therefore tilted, w = 1 + a dx + b dy, so that the channels of a
bin share one centroid: the value of a locally linear regression at that point (Fan and Gijbels 1996, section
3). A full 8 x 8 bin pays 5 % of its uncertainty per axis for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from typing import TYPE_CHECKING

import numpy as np

from rig.angles import unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float = NDArray[np.float64]
    Bool = NDArray[np.bool_]
    Int = NDArray[np.intp]

MIN_WEIGHT = 0.0
"""Smallest tilted weight: below it the remaining pixels lie too far to one side of the common centroid."""

MEAN_OF_CENTRAL_CURVATURE = 1.0 / 24.0
"""Mean minus centre value of a parabola over a bin, in units of its second difference between neighbouring
bins."""


class Dropped(IntFlag):
    """Why a channel of a bin has no value; zero where it has one."""

    FEW_PIXELS = 1
    """Too few usable pixels: off the sample, hot, inconsistent or at grazing angles."""
    OVER_RANGE = 2
    """A pixel clipped even in the shortest exposure: the others alone would be a selection by noise."""
    LOPSIDED = 4
    """The usable pixels do not surround the bin's centroid."""
    NO_REFERENCE = 8
    """The white reference gave no positive signal."""


@dataclass(frozen=True)
class Bins:
    """Square bins over an image; pixels beyond the last whole bin belong to none.

    Attributes
    ----------
    index : (H, W) int
        Each pixel's bin, row by row; -1 outside every bin.
    shape : (int, int)
        Rows and columns of bins.
    size_px : int
        Edge of a bin.
    """

    index: Int
    shape: tuple[int, int]
    size_px: int

    @property
    def count(self) -> int:
        """Number of bins."""
        return self.shape[0] * self.shape[1]

    def centres_px(self) -> tuple[Float, Float]:
        """Give the bins' centres: rows (R,) and columns (C,), pixels; the first pixel's centre is 0."""
        rows, cols = (
            np.arange(n, dtype=np.float64) * self.size_px + (self.size_px - 1) / 2 for n in self.shape
        )
        return rows, cols


def make_bins(height: int, width: int, size_px: int) -> Bins:
    """Lay square bins of `size_px` over an image of `height` x `width` pixels, from its first corner."""
    rows, cols = height // size_px, width // size_px
    row, col = np.arange(height) // size_px, np.arange(width) // size_px
    index = row[:, None] * cols + col[None, :]
    index[(row >= rows)[:, None] | (col >= cols)[None, :]] = -1
    return Bins(index, (rows, cols), size_px)


@dataclass(frozen=True)
class PixelSignals:
    """What the pixels of one pose bring to the ratio.

    Attributes
    ----------
    signal, signal_variance : (H, W) float
        The sample's radiance in any linear unit, and its variance.
    reference, reference_variance : (H, W) float
        What the same pixel would read, in the same unit, from a surface of f = 1/sr under the sample's
        irradiance.
    weight : (H, W) float
        Noise-free weight of the pixel's directions: the irradiance.
    usable : (H, W) bool
        Pixels that may enter a sum.
    clipped : (H, W) bool
        Pixels that clipped in every exposure; each empties its bin's channel.
    wi, wo : (H, W, 3) float
        Unit directions to light and camera.
    """

    signal: Float
    signal_variance: Float
    reference: Float
    reference_variance: Float
    weight: Float
    usable: Bool
    clipped: Bool
    wi: Float
    wo: Float


@dataclass(frozen=True)
class BinnedRatio:
    """One ratio per bin and channel; B bins, C channels.

    Attributes
    ----------
    wi, wo : (B, 3) float
        Unit mean directions, common to the channels; NaN where no channel has a value.
    ratio : (B, C) float
        sum(w S) / sum(w X); NaN where dropped. Negative values stay.
    u_signal, u_reference : (B, C) float
        Standard uncertainty of the ratio from the noise of S and of X.
    pixels : (B, C) int
        Usable pixels.
    dropped : (B, C) int
        Bits of `Dropped`; 0 where there is a value.
    """

    wi: Float
    wo: Float
    ratio: Float
    u_signal: Float
    u_reference: Float
    pixels: Int
    dropped: Int


def bin_ratio(
    pixels: PixelSignals, bins: Bins, channel: Int, channels: int, *, min_fill: float
) -> BinnedRatio:
    """Reduce the pixels of one pose to one ratio per bin and channel.

    Parameters
    ----------
    pixels : PixelSignals
        The pose.
    bins : Bins
        The layout.
    channel : (H, W) int
        Each pixel's colour channel.
    channels : int
        Number of colour channels, C.
    min_fill : float
        Fraction of a channel's pixels in a bin that must be usable.

    Returns
    -------
    BinnedRatio
        Values, directions and reasons for the dropped.
    """
    row, col = np.indices(bins.index.shape, dtype=float)
    usable = pixels.usable & (bins.index >= 0)
    target = _centroid(bins, usable, pixels.weight, row, col)
    parts = [
        _bin_channel(
            pixels, bins, usable, channel == index, position=(row, col), target=target, min_fill=min_fill
        )
        for index in range(channels)
    ]
    valid = np.stack([part.dropped == 0 for part in parts], axis=1)
    return BinnedRatio(
        wi=_common_direction([part.wi for part in parts], valid),
        wo=_common_direction([part.wo for part in parts], valid),
        ratio=np.stack([part.ratio for part in parts], axis=1),
        u_signal=np.stack([part.u_signal for part in parts], axis=1),
        u_reference=np.stack([part.u_reference for part in parts], axis=1),
        pixels=np.stack([part.pixels for part in parts], axis=1),
        dropped=np.stack([part.dropped for part in parts], axis=1),
    )


def curvature(ratio: Float, variance: Float, shape: tuple[int, int]) -> Float:
    """Bound the difference between a bin's mean and the value at its mean direction, from its neighbours.

    For a function that is a parabola over three bins, mean minus central value is 1/24 of the second
    difference along each axis. The part of the squared second difference that noise explains (6 variances) is
    taken off. At an edge the nearest inner second difference serves.

    Parameters
    ----------
    ratio, variance : (B, C) float
        Values, and their variances, of all bins in layout order; NaN where there is none.
    shape : (int, int)
        Rows and columns of bins, R * C = B.

    Returns
    -------
    (B, C) float
        Standard uncertainty; zero where no three neighbours exist.
    """
    grid, noise = ratio.reshape(*shape, -1), variance.reshape(*shape, -1)
    total = np.zeros_like(grid)
    for axis in (0, 1):
        if grid.shape[axis] >= 3:
            squared = np.diff(grid, 2, axis=axis) ** 2
            explained = np.apply_along_axis(np.convolve, axis, noise, [1.0, 4.0, 1.0], mode="valid")
            excess = np.maximum(np.nan_to_num(squared - explained, nan=0.0), 0.0)
            padding = [(1, 1) if a == axis else (0, 0) for a in range(3)]
            total += np.pad(excess, padding, mode="edge")
    bound: Float = (np.sqrt(total) * MEAN_OF_CENTRAL_CURVATURE).reshape(ratio.shape)
    return bound


@dataclass(frozen=True)
class _Channel:
    """One channel's share of a `BinnedRatio`; wi and wo are weighted sums of directions, not yet unit."""

    wi: Float
    wo: Float
    ratio: Float
    u_signal: Float
    u_reference: Float
    pixels: Int
    dropped: Int


def _sums(bins: Bins, mask: Bool, *values: Float) -> tuple[Float, ...]:
    """Sum each (H, W) array of `values` over the masked pixels of each bin; returns (B,) arrays."""
    index = bins.index[mask]
    sums = (np.bincount(index, weights=value[mask], minlength=bins.count) for value in values)
    return tuple(np.asarray(total, dtype=np.float64) for total in sums)


def _centroid(bins: Bins, usable: Bool, weight: Float, row: Float, col: Float) -> tuple[Float, Float]:
    """Weighted mean row and column of each bin's usable pixels of all channels; NaN in empty bins."""
    total, rows, cols = _sums(bins, usable, weight, weight * row, weight * col)
    with np.errstate(invalid="ignore", divide="ignore"):
        return rows / total, cols / total


def _bin_channel(
    pixels: PixelSignals,
    bins: Bins,
    usable: Bool,
    is_channel: Bool,
    *,
    position: tuple[Float, Float],
    target: tuple[Float, Float],
    min_fill: float,
) -> _Channel:
    inside = is_channel & (bins.index >= 0)
    mask = usable & is_channel
    tilted, lopsided = _tilted_weights(bins, mask, pixels.weight, position, target)
    share = tilted * pixels.weight
    (signal, signal_variance, reference, reference_variance, clipped, total) = (
        *_sums(bins, mask, tilted * pixels.signal, tilted**2 * pixels.signal_variance),
        *_sums(bins, mask, tilted * pixels.reference, tilted**2 * pixels.reference_variance),
        *_sums(bins, inside, pixels.clipped.astype(float)),
        *_sums(bins, mask, share),
    )
    count = np.bincount(bins.index[mask], minlength=bins.count)
    available = np.bincount(bins.index[inside], minlength=bins.count)
    few = count < np.maximum(min_fill * available, 1)
    dropped = (
        Dropped.FEW_PIXELS * few
        + Dropped.OVER_RANGE * (clipped > 0)
        + Dropped.LOPSIDED * (lopsided & ~few)
        + Dropped.NO_REFERENCE * (~few & ~(reference > 0))
    ).astype(np.intp)
    keep = dropped == 0
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(keep, signal / reference, np.nan)
        u_signal = np.where(keep, np.sqrt(signal_variance) / reference, np.nan)
        u_reference = np.abs(ratio) * np.sqrt(reference_variance) / reference
        wi, wo = (
            np.stack(_sums(bins, mask, *(share * vector[..., axis] for axis in range(3))), axis=-1)
            / total[:, None]
            for vector in (pixels.wi, pixels.wo)
        )
    return _Channel(wi, wo, ratio, u_signal, u_reference, count, dropped)


def _tilted_weights(
    bins: Bins, mask: Bool, weight: Float, position: tuple[Float, Float], target: tuple[Float, Float]
) -> tuple[Float, Bool]:
    """Weights 1 + a dx + b dy that move the masked pixels' weighted centroid onto each bin's target.

    Returns the weights (H, W), one outside the mask, and which bins (B,) would need one below `MIN_WEIGHT`.
    """
    row, col = position
    total, rows, cols = _sums(bins, mask, weight, weight * row, weight * col)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_row, mean_col = rows / total, cols / total
    safe = np.where(bins.index >= 0, bins.index, 0)
    d_row, d_col = row - mean_row[safe], col - mean_col[safe]
    rr, cc, rc = _sums(bins, mask, weight * d_row**2, weight * d_col**2, weight * d_row * d_col)
    shift_row, shift_col = total * (target[0] - mean_row), total * (target[1] - mean_col)
    determinant = rr * cc - rc**2
    with np.errstate(invalid="ignore", divide="ignore"):
        a = (shift_row * cc - shift_col * rc) / determinant
        b = (shift_col * rr - shift_row * rc) / determinant
    solvable = np.isfinite(a) & np.isfinite(b)
    a, b = np.where(solvable, a, 0.0), np.where(solvable, b, 0.0)
    tilted = np.where(mask, 1.0 + a[safe] * d_row + b[safe] * d_col, 1.0)
    lowest = np.full(bins.count, np.inf)
    np.minimum.at(lowest, bins.index[mask], tilted[mask])
    return tilted, ~solvable | (lowest < MIN_WEIGHT)


def _common_direction(sums: list[Float], valid: Bool) -> Float:
    """Average each bin's directions over its valid channels, to unit length; NaN where none is valid."""
    stacked = np.stack(sums, axis=1)
    total = np.where(valid[..., None], stacked, 0.0).sum(axis=1)
    seen = valid.any(axis=1)
    total[~seen] = (0.0, 0.0, 1.0)
    direction: Float = unit(total)
    direction[~seen] = np.nan
    return direction
