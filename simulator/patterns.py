"""What a pattern and a relief are at points of a sample, in float64; `bsdfs.placed` says it again."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from simulator.line_words import CHANNELS
from simulator.mounting import PatternKind

if TYPE_CHECKING:
    from simulator.mounting import Pattern, Relief

Array = NDArray[np.float64]

WAVES = 32
"""Of a relief."""
_SHORTEST, _LONGEST = 0.7, 1.4
"""Wavelengths of a relief's waves, in units of the typical one."""


def relief_waves(relief: Relief) -> Array:
    """Draw the waves of a relief.

    Returns
    -------
    ndarray, shape (WAVES, 5)
        Each wave's slope along x and y at its steepest, its wave vector in rad/mm, and its phase in rad: the
        slope at (x, y) is the sum of slope times cos(wave vector . (x, y) + phase).
    """
    rng = np.random.default_rng(relief.seed)
    angle, phase = rng.uniform(0.0, 2.0 * np.pi, (2, WAVES))
    length_mm = relief.wavelength_mm * rng.uniform(_SHORTEST, _LONGEST, WAVES)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    # The mean of cos^2 is 1/2.
    steepest = relief.slope_rms * np.sqrt(2.0 / WAVES)
    return np.column_stack([steepest * way, (2.0 * np.pi / length_mm)[:, None] * way, phase])


def relief_slopes(waves: Array, places_mm: Array) -> Array:
    """Slopes (N, 2) of a relief along x and y at places (N, 2)."""
    return np.asarray(np.cos(places_mm @ waves[:, 2:4].T + waves[:, 4]) @ waves[:, :2])


def pattern_weight(pattern: Pattern, radius_mm: float, places_mm: Array) -> Array:
    """Share of a pattern's second material.

    Parameters
    ----------
    pattern : Pattern
    radius_mm : float
        Of the sample's disc.
    places_mm : ndarray, shape (N, 2)

    Returns
    -------
    ndarray, shape (N, 3)
        0 to 1, by channel.
    """
    if pattern.kind is PatternKind.IMAGE:
        return _bilinear(read_picture(pattern.file), _texels(pattern, radius_mm, places_mm))
    if pattern.kind is PatternKind.CHECKER:
        weight = pattern_cells(pattern, radius_mm, places_mm).sum(axis=-1) % 2.0
    else:
        along = places_mm @ [np.cos(pattern.along_rad), np.sin(pattern.along_rad)]
        weight = np.clip(0.5 + 0.5 * along / radius_mm, 0.0, 1.0)
    return np.repeat(weight[:, None], CHANNELS, axis=1)


def pattern_cells(pattern: Pattern, radius_mm: float, places_mm: Array) -> Array:
    """Return which cell of a pattern places (N, 2) lie in, (N, 2): within one, it is smooth."""
    if pattern.kind is PatternKind.CHECKER:
        return np.floor(places_mm / pattern.side_mm)
    if pattern.kind is PatternKind.IMAGE:
        return np.floor(_texels(pattern, radius_mm, places_mm))
    return np.zeros(places_mm.shape)


def read_picture(file: str) -> Array:
    """Read a picture.

    Returns
    -------
    ndarray, shape (H, W, 1 or 3)
        Single precision's numbers from 0 to 1.

    Raises
    ------
    BadInput
        No picture, or values that no share has.
    """
    return _read_picture(file, Path(file).stat().st_mtime_ns)


@lru_cache(maxsize=8)
def _read_picture(file: str, _modified_ns: int) -> Array:
    import cv2

    stored = cv2.imread(file, cv2.IMREAD_UNCHANGED)
    if stored is None:
        raise BadInput("no picture that can be read", where=file, todo="give a PNG or TIFF file")
    scale = {"uint8": 255.0, "uint16": 65535.0}.get(stored.dtype.name, 1.0)
    stored = stored[..., None] if stored.ndim == 2 else stored[..., CHANNELS - 1 :: -1]
    picture = (stored / scale).astype(np.float32).astype(np.float64)
    if not ((picture >= 0.0) & (picture <= 1.0)).all():
        raise BadInput("values that are not from 0 to 1", where=file, todo="scale the picture")
    return np.asarray(picture)


def _texels(pattern: Pattern, radius_mm: float, places_mm: Array) -> Array:
    """Column and row (N, 2) of places, the first texel's centre at 0."""
    height, width = read_picture(pattern.file).shape[:2]
    across, up = 0.5 + 0.5 * places_mm.T / radius_mm
    return np.stack([across * width - 0.5, (1.0 - up) * height - 0.5], axis=-1)


def _bilinear(picture: Array, at: Array) -> Array:
    height, width = picture.shape[:2]
    column, row = np.clip(at, 0.0, [width - 1.0, height - 1.0]).T
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    u, v = (column - left)[:, None], (row - top)[:, None]
    above = (1.0 - u) * picture[top, left] + u * picture[top, right]
    below = (1.0 - u) * picture[bottom, left] + u * picture[bottom, right]
    return np.asarray(np.broadcast_to((1.0 - v) * above + v * below, (len(at), CHANNELS)))
