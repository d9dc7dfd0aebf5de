"""Whether samples are those of an isotropic surface, before anything is interpolated as if they were."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.angles import direction_to_spherical, wrap
from rig.errors import Refused

Array = NDArray[np.float64]

NEIGHBOURS = 24
TESTS = 2000
ALIKE_RAD, OTHER_RAD = np.radians(5.0), np.radians(15.0)
"""Azimuths of two lights, half a turn more or less, that are one, and that are two."""
FEWEST = 50
MOST, LEAST = 3.0, 0.1
"""Ratio of differences, and relative difference, from which on the azimuth of the light matters more than the
place: a sample that lies tilted reaches a ratio of 2.2."""


def azimuth_matters(place: Array, wi: Array, f_r: Array) -> float:
    """Compare neighbours whose lights have one azimuth with neighbours whose lights have two.

    Parameters
    ----------
    place : ndarray, shape (N, K)
        Coordinates in which an isotropic surface has one value.
    wi : ndarray, shape (N, 3)
        Directions to the light.
    f_r : ndarray, shape (N, C)
        Values.

    Returns
    -------
    float
        Median relative difference of the latter over that of the former; 1 where the samples do not tell, or
        where the latter is small.
    """
    from scipy.spatial import KDTree

    count = min(NEIGHBOURS + 1, len(place))
    tests = np.random.default_rng(0).permutation(len(place))[:TESTS]
    _, found = KDTree(place).query(place[tests], k=np.arange(2, count + 1))
    phi = direction_to_spherical(wi)[1]
    # A surface that was turned by half a turn is taken as the same.
    apart = 0.5 * np.abs(wrap(2.0 * (phi[found] - phi[tests][:, None])))
    size = np.maximum(np.abs(f_r[found]), np.abs(f_r[tests][:, None]))
    step = np.abs(f_r[found] - f_r[tests][:, None])
    difference = np.median(step / np.where(size > 0.0, size, 1.0), axis=-1)
    alike, other = apart <= ALIKE_RAD, apart >= OTHER_RAD
    both = alike.any(axis=1) & other.any(axis=1)
    if both.sum() < FEWEST:
        return 1.0
    same, turned = (
        float(np.median(np.nanmedian(np.where(kind, difference, np.nan)[both], axis=1)))
        for kind in (alike, other)
    )
    return float(turned / max(same, np.finfo(float).eps)) if turned > LEAST else 1.0


def require_isotropic(place: Array, wi: Array, f_r: Array) -> None:
    """Refuse samples whose value depends on the light's azimuth; see `azimuth_matters`.

    Raises
    ------
    Refused
        With what would do instead.
    """
    ratio = azimuth_matters(place, wi, f_r)
    if ratio > MOST:
        raise Refused(
            f"are anisotropic: neighbours under lights of two azimuths differ {ratio:.1f} times as much as "
            "under one, and only isotropic surfaces are interpolated",
            where="samples",
            todo="write a format of samples: .nc, .csv, .astm or .ssdd",
        )
