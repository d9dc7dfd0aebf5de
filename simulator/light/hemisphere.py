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
"""Where rings begin: narrower lobes than that no model has."""


class Hemisphere(NamedTuple):
    """What f_r does over all directions of the light, for each of the camera's, (...); C channels.

    Attributes
    ----------
    least : ndarray, shape (..., C)
        Smallest f_r.
    rest : ndarray, shape (..., C)
        Integral of what f_r is above that, times the light's cosine. With pi times the smallest it makes the
        directional albedo.
    largest_cosine : ndarray, shape (..., C)
        Largest f_r times the light's cosine.
    directions : ndarray, shape (..., N, 3)
        Nodes of the rule.
    weights : ndarray, shape (..., N, C)
        What each adds to `rest`: nothing below the horizon.
    """

    least: Array
    rest: Array
    largest_cosine: Array
    directions: Array
    weights: Array


def hemisphere(
    reflectance: Callable[[Array, Array], Array], wo: Array, *, rings: int = _RINGS, turns: int = _TURNS
) -> Hemisphere:
    """Integrate f_r over the light's directions.

    The rule is a sum of two polar ones, around the mirror direction and around the camera's own, where
    retroreflection has its lobe; a smooth weight divides the hemisphere between them. Their rings are dense
    at the middle, in equal steps of the logarithm of the angle, so that broad lobes and narrow ones take the
    same nodes.

    Parameters
    ----------
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr.
    wo : ndarray, shape (..., 3)
        Towards the camera, above the horizon.
    rings, turns : int
        Nodes of each rule: along the angle from its middle, and around it.

    Returns
    -------
    Hemisphere
    """
    given = wo.reshape(-1, 3)
    ring, solid_angle = _rule(rings, turns)
    middles = given * [-1.0, -1.0, 1.0], given
    wi = np.concatenate([_about(ring, middle) for middle in middles], axis=1)
    weights = np.tile(solid_angle, 2) * _divided(wi, *middles)
    above = wi[..., 2] > 0.0
    f = np.zeros(wi.shape)
    f[above] = reflectance(wi[above], np.broadcast_to(given[:, None], wi.shape)[above])
    # Channels first: sums over nodes are along what lies together.
    by_node = np.ascontiguousarray(np.swapaxes(f, 1, 2))
    cosine = np.maximum(wi[..., 2], 0.0)[:, None]
    least = np.where(above[:, None], by_node, np.inf).min(axis=-1)
    kept = weights[:, None] * cosine * (by_node - least[..., None])
    shape = wo.shape[:-1]
    return Hemisphere(
        least.reshape(*shape, -1),
        kept.sum(axis=-1).reshape(*shape, -1),
        (by_node * cosine).max(axis=-1).reshape(*shape, -1),
        wi.reshape(*shape, *wi.shape[1:]),
        np.swapaxes(kept, 1, 2).reshape(*shape, *wi.shape[1:]),
    )


def _about(ring: Array, middles: Array) -> Array:
    """Turn directions (N, 3) about +z to be about others, (K, N, 3)."""
    across = unit(np.cross(np.eye(3)[np.argmin(np.abs(middles), axis=-1)], middles))
    return np.asarray(ring @ np.stack([across, np.cross(middles, across), middles], axis=1))


def _divided(wi: Array, first: Array, second: Array) -> Array:
    """Share (K, 2 N) of each node in its direction's light, N of either rule."""
    near, far = (1e-300 + np.sum(np.square(wi - middle[:, None]), axis=-1) for middle in (first, second))
    share = far / (near + far)
    count = wi.shape[1] // 2
    return np.concatenate([share[:, :count], 1.0 - share[:, count:]], axis=1)


@cache
def _rule(rings: int, turns: int) -> tuple[Array, Array]:
    """Directions (N, 3) around +z and their solid angles (N,)."""
    s, ds = np.polynomial.legendre.leggauss(rings)
    length = np.log(np.pi / _NARROWEST_RAD)
    gamma = _NARROWEST_RAD * np.exp(0.5 * (s + 1.0) * length)
    share = 0.5 * ds * length * gamma * np.sin(gamma)
    phi = 2.0 * np.pi * (np.arange(turns) + 0.5) / turns
    g, p = (axis.ravel() for axis in np.meshgrid(gamma, phi, indexing="ij"))
    directions = np.stack([np.sin(g) * np.cos(p), np.sin(g) * np.sin(p), np.cos(g)], axis=-1)
    return directions, np.repeat(share * 2.0 * np.pi / turns, turns)
