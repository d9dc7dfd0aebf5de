"""Straight ways between surfaces: where they meet a mirror's plane, and whether the sample is in between."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from simulator.light.scene import PlanarMirror

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

TOUCHING = 1e-9
"""Part of a way, at either end, within which it touches what it starts from or goes to."""


def crosses_disc(start: Array, end: Array, radius_mm: float) -> Bools:
    """Tell which straight ways (..., 3) pass through the sample's disc.

    Parameters
    ----------
    start, end : ndarray, shape (..., 3)
    radius_mm : float
        The disc is about the origin in the plane z = 0.

    Returns
    -------
    ndarray of bool, shape (...)
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        share = start[..., 2] / (start[..., 2] - end[..., 2])
        met = start + share[..., None] * (end - start)
        inside = np.sum(np.square(met[..., :2]), axis=-1) < radius_mm**2
    return np.asarray(inside & (share > TOUCHING) & (share < 1.0 - TOUCHING))


def meet_mirror(mirror: PlanarMirror, start: Array, end: Array) -> tuple[Array, Array, Bools]:
    """Return where ways meet a mirror's plane.

    Parameters
    ----------
    mirror : PlanarMirror
    start, end : ndarray, shape (N, 3)

    Returns
    -------
    met : ndarray, shape (N, 3)
        Where; anything for a way along the plane.
    share : ndarray, shape (N,)
        Of the way's length, from its start.
    inside : ndarray of bool, shape (N,)
        Whether in the mirror's rectangle.
    """
    centre = np.asarray(mirror.centre_mm)
    way = end - start
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = ((centre - start) @ mirror.normal) / (way @ mirror.normal)
        met = start + share[:, None] * way
        inside = np.ones(len(start), dtype=bool)
        for side in (np.asarray(mirror.across_mm), np.asarray(mirror.up_mm)):
            inside &= np.abs((met - centre) @ side) <= side @ side
    return met, share, inside
