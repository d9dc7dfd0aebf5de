"""Integrals of f_r over the hemisphere, for one direction of the camera."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit

if TYPE_CHECKING:
    from collections.abc import Callable

Array = NDArray[np.float64]

_RINGS, _TURNS = 40, 24
_NARROWEST_RAD = 1e-5
"""Where rings around the mirror direction begin: narrower lobes than that no model has."""


class Hemisphere(NamedTuple):
    """What f_r does over all directions of the light; (channels,) but for the nodes.

    Attributes
    ----------
    least : ndarray
        Smallest f_r.
    rest : ndarray
        Integral of what f_r is above that, times the light's cosine. With pi times the smallest it makes the
        directional albedo.
    largest_cosine : ndarray
        Largest f_r times the light's cosine.
    directions : ndarray, shape (N, 3)
        Nodes of the rule, above the horizon.
    weights : ndarray, shape (N, channels)
        What each adds to `rest`.
    """

    least: Array
    rest: Array
    largest_cosine: Array
    directions: Array
    weights: Array


def hemisphere(reflectance: Callable[[Array, Array], Array], wo: Array) -> Hemisphere:
    """Integrate f_r over the light's directions.

    The rule is a polar one around the mirror direction, its rings dense there in equal steps of the
    logarithm of the angle, so that broad lobes and narrow ones take the same nodes.

    Parameters
    ----------
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr.
    wo : ndarray, shape (3,)
        Towards the camera, above the horizon.

    Returns
    -------
    Hemisphere
    """
    ring, solid_angle = _rule()
    mirror = wo * [-1.0, -1.0, 1.0]
    across = unit(np.cross(np.eye(3)[np.argmin(np.abs(mirror))], mirror))
    wi = ring @ np.stack([across, np.cross(mirror, across), mirror])
    above = wi[:, 2] > 0.0
    wi = wi[above]
    f = reflectance(wi, np.broadcast_to(wo, wi.shape))
    least = f.min(axis=0)
    weights = solid_angle[above, None] * (f - least) * wi[:, 2:]
    return Hemisphere(least, weights.sum(axis=0), (f * wi[:, 2:]).max(axis=0), wi, weights)


@cache
def _rule() -> tuple[Array, Array]:
    """Directions (N, 3) around +z and their solid angles (N,)."""
    s, ds = np.polynomial.legendre.leggauss(_RINGS)
    length = np.log(np.pi / _NARROWEST_RAD)
    gamma = _NARROWEST_RAD * np.exp(0.5 * (s + 1.0) * length)
    share = 0.5 * ds * length * gamma * np.sin(gamma)
    phi = 2.0 * np.pi * (np.arange(_TURNS) + 0.5) / _TURNS
    g, p = (axis.ravel() for axis in np.meshgrid(gamma, phi, indexing="ij"))
    directions = np.stack([np.sin(g) * np.cos(p), np.sin(g) * np.sin(p), np.cos(g)], axis=-1)
    return directions, np.repeat(share * 2.0 * np.pi / _TURNS, _TURNS)
