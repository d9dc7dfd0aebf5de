"""Where radiosity looks from a sample: how finely, in rings about the mirror direction, at points between.

Near the mirror direction a lobe may be narrow: there nodes are in rings about that direction, dense at it;
elsewhere they are on the walls. A smooth weight divides the hemisphere between the two.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LOBE_RAD = (0.15, 0.75)
"""Angles from the mirror direction up to which, and from which on, nodes are in rings, and on walls."""
_NARROWEST_RAD = 1e-4


class Level(NamedTuple):
    """How fine a pose is computed.

    Attributes
    ----------
    wall : int
        Nodes along each side of a patch.
    rings, turns : int
        Nodes about the mirror direction.
    points : int
        Points of the sample along each of its axes.
    """

    wall: int
    rings: int
    turns: int
    points: int


LEVELS = (
    Level(1, 8, 10, 2),
    Level(2, 12, 16, 2),
    Level(3, 18, 24, 3),
    Level(4, 28, 36, 5),
    Level(6, 40, 56, 7),
    Level(8, 60, 80, 9),
)


def rings(level: Level) -> tuple[Array, Array]:
    """Return directions (N, 3) about +z, dense at it, and their solid angles (N,)."""
    s, ds = np.polynomial.legendre.leggauss(level.rings)
    length = np.log(_LOBE_RAD[1] / _NARROWEST_RAD)
    gamma = _NARROWEST_RAD * np.exp(0.5 * (s + 1.0) * length)
    share = 0.5 * ds * length * gamma * np.sin(gamma) * 2.0 * np.pi / level.turns
    phi = 2.0 * np.pi * (np.arange(level.turns) + 0.5) / level.turns
    g, p = (axis.ravel() for axis in np.meshgrid(gamma, phi, indexing="ij"))
    return np.stack([np.sin(g) * np.cos(p), np.sin(g) * np.sin(p), np.cos(g)], axis=-1), np.repeat(
        share, level.turns
    )


def in_rings(wi: Array, wo: Array) -> Array:
    """Return which part of directions is left to the nodes about the mirror direction.

    Parameters
    ----------
    wi : ndarray, shape (K, N, 3)
        Directions of the light.
    wo : ndarray, shape (K, 3)
        Towards the camera.

    Returns
    -------
    ndarray, shape (K, N)
        1 near the mirror direction, 0 far from it, smooth between.
    """
    mirror = wo * [-1.0, -1.0, 1.0]
    chord = np.linalg.norm(wi - mirror[:, None], axis=-1)
    gamma = 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))
    t = np.clip((gamma - _LOBE_RAD[0]) / (_LOBE_RAD[1] - _LOBE_RAD[0]), 0.0, 1.0)
    return np.asarray(1.0 - t**3 * (10.0 - 15.0 * t + 6.0 * t * t))


def interpolation(nodes: Array, places: Array) -> Array:
    """Return the matrix (N, K) that takes values at Chebyshev nodes (K,) to places (N,) between -1 and 1."""
    degree = len(nodes) - 1
    basis, at = (np.polynomial.chebyshev.chebvander(x, degree) for x in (nodes, places))
    return np.asarray(at @ np.linalg.inv(basis))
