"""Stray light at poses where the light trap was not: put together from its pictures at the nearest poses.

Inverse distances of the joints' angles, squared, are the weights (Shepard 1968): a pose with a picture of its
own keeps it, between two poses the picture is between theirs, and nothing is ever extrapolated. How far the
neighbours' mean levels differ from what comes out is how uncertain it is.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from analysis.measurement import Image

    Float = NDArray[np.float64]

NEIGHBOURS = 4
"""Pictures that one is put together from, at most."""


def neighbour_weights(at_rad: Float, poses_rad: Float) -> tuple[NDArray[np.intp], Float]:
    """Choose the nearest poses and their weights.

    Parameters
    ----------
    at_rad : ndarray, shape (J,)
        Joint angles where the stray light is wanted.
    poses_rad : ndarray, shape (N, J)
        Where it was seen.

    Returns
    -------
    chosen : ndarray of int, shape (K,)
        At most `NEIGHBOURS`, the nearest first; a pose that is the same stands alone.
    weights : ndarray, shape (K,)
        Their sum is 1.
    """
    squared = np.sum((poses_rad - at_rad) ** 2, axis=1)
    chosen = np.argsort(squared, kind="stable")[:NEIGHBOURS]
    if squared[chosen[0]] == 0.0:
        return chosen[:1], np.ones(1)
    weights = 1.0 / squared[chosen]
    return chosen, weights / weights.sum()


def put_together(images: Sequence[Image], weights: Float, at_rad: Float) -> tuple[Image, float]:
    """Put a picture of the stray light together.

    Parameters
    ----------
    images : sequence of Image
        The light trap at other poses; brought to the light of the first, where it was measured.
    weights : ndarray, shape (K,)
        Their sum is 1.
    at_rad : ndarray, shape (J,)
        Joint angles of the pose it is for.

    Returns
    -------
    image : Image
    u_relative : float
        Relative standard uncertainty of its level: the weighted scatter of the pictures' mean levels.
    """
    first = images[0]
    scales = [first.lamp_output / image.lamp_output for image in images]
    scales = [scale if math.isfinite(scale) else 1.0 for scale in scales]
    radiance = sum(w * s * image.radiance for w, s, image in zip(weights, scales, images, strict=True))
    variance = sum((w * s) ** 2 * image.variance for w, s, image in zip(weights, scales, images, strict=True))
    levels = np.array([s * np.nanmean(image.radiance) for s, image in zip(scales, images, strict=True)])
    level = float(np.sum(weights * levels))
    scatter = math.sqrt(float(np.sum(weights * (levels - level) ** 2)))
    together = replace(
        first,
        radiance=np.asarray(radiance),
        variance=np.asarray(variance),
        flags=np.bitwise_or.reduce([image.flags for image in images]),
        angles_rad=at_rad,
    )
    return together, scatter / abs(level) if level else 0.0
