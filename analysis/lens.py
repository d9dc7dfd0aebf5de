"""Lens distortion: where in the picture a place of the sample lies, and what an error of that does to f_r.

A pixel's ray follows from the lens model of the rig file (`rig.pixels.camera_rays`; OpenCV's k1, k2, p1, p2,
k3: Brown 1971). White and sample are divided pixel by pixel, so the lens does not change f_r: it changes the
directions that belong to it. An error of the ray by so many pixels is the same as f_r taken that far
beside its place, and the picture itself tells how much f_r changes there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.pixels import camera_rays

if TYPE_CHECKING:
    from analysis.binning import Bins
    from rig.description import Rig

Float = NDArray[np.float64]


def is_bent(rig: Rig) -> bool:
    """Whether the rig file gives the lens a distortion."""
    return any(rig.camera.distortion)


def straight_lens(rig: Rig) -> Rig:
    """Return the rig with a lens that has no distortion."""
    camera = rig.camera.model_copy(update={"distortion": (0.0,) * 5})
    return rig.model_copy(update={"camera": camera})


def distortion_px(rig: Rig, bins: Bins) -> Float:
    """Where bins' centres would lie without distortion, less where they are: (2, B), rows and columns."""
    rows, cols = bins.centres_px()
    rays = camera_rays(rig, rows=rows, cols=cols)
    column, row = (
        rig.camera.focal_length_px * rays[..., axis] / rays[..., 2] + rig.camera.principal_point_px[axis]
        for axis in (0, 1)
    )
    here = np.meshgrid(rows, cols, indexing="ij")
    return np.stack([row - here[0], column - here[1]]).reshape(2, -1)


def u_distortion_of(rig: Rig, ratio: Float, bins: Bins, bin_px: int, *, corrected: bool) -> Float:
    """Uncertainty of f_r by the lens, 1/sr.

    Parameters
    ----------
    rig : Rig
        With the lens as it is.
    ratio : (B, C) float
        f_r of all bins in layout order; NaN where there is none.
    bins : Bins
    bin_px : int
        Their edge in pixels.
    corrected : bool
        Whether rays follow the lens model. If so its own uncertainty is left, in any direction of the
        picture; if not, the whole distortion.

    Returns
    -------
    (B, C) float
        NaN where f_r is. A bin without a neighbour takes the largest slope of its channel.
    """
    slopes = np.stack([_slope(ratio, bins.shape, axis) for axis in (0, 1)]) / bin_px
    if corrected:
        size = rig.camera.u_distortion_px * np.sqrt(np.sum(np.square(slopes), axis=0))
    else:
        size = np.abs(np.sum(slopes * distortion_px(rig, bins)[..., np.newaxis], axis=0))
    return np.where(np.isfinite(ratio), size, np.nan)


def _slope(ratio: Float, shape: tuple[int, int], axis: int) -> Float:
    """Change of f_r from bin to bin along an axis: of both neighbours, of the one, or the largest of all."""
    grid = ratio.reshape(*shape, -1)
    gap = np.full_like(np.take(grid, [0], axis=axis), np.nan)
    step = np.concatenate([gap, np.diff(grid, axis=axis), gap], axis=axis)
    before, after = (np.take(step, range(first, first + shape[axis]), axis=axis) for first in (0, 1))
    both = 0.5 * (before + after)
    slope = np.where(np.isfinite(both), both, np.where(np.isfinite(before), before, after))
    most = np.max(np.abs(np.nan_to_num(slope)), axis=(0, 1))
    return np.where(np.isfinite(slope), slope, most).reshape(ratio.shape)
