"""Natural-neighbour interpolation between scattered points of a plane (Sibson 1981).

The weight of a sample at a place is the area that the place would take from the sample's Voronoi cell if it
were a sample too. Weights are not negative, sum to 1, reproduce linear functions, and do not depend on how
ties of the triangulation are broken.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]

SAME_PLACE = 1e-9
"""Points closer than this part of the extent are one point."""

ON_EDGE = 1e-10
"""A barycentric coordinate below this lies on the triangle's edge."""

COCIRCULAR = 1e-12
"""A place within this part of a circle's squared radius lies on it, and takes no area from its triangle."""

CHUNK = 128


def natural_weights(points: Array, places: Array) -> csr_array:
    """Return Sibson's weight of every point at every place.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        Places of the samples; equal ones share their weight evenly.
    places : ndarray, shape (Q, 2)
        Where the weights are wanted.

    Returns
    -------
    scipy.sparse.csr_array, shape (Q, N)
        Rows sum to 1 inside the points' convex hull and are empty outside of it.

    Raises
    ------
    BadInput
        If fewer than three points remain, or all lie on a line.
    """
    from scipy.sparse import csr_array, vstack
    from scipy.spatial import Delaunay, QhullError

    extent = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    tolerance = SAME_PLACE * max(extent, np.finfo(float).tiny / SAME_PLACE)
    distinct, member = _distinct(points, tolerance)
    try:
        mesh = Delaunay(distinct)
    except (QhullError, ValueError):
        raise BadInput(
            "lie on a line or are fewer than three", where="samples", todo="measure a grid of directions"
        ) from None
    rows = [
        csr_array(_weights(mesh, places[first : first + CHUNK], tolerance))
        for first in range(0, len(places), CHUNK)
    ]
    shares = csr_array(
        (1.0 / np.bincount(member)[member], (member, np.arange(len(points)))),
        shape=(len(distinct), len(points)),
    )
    return csr_array(vstack(rows) @ shares) if rows else csr_array((0, len(points)))


def _distinct(points: Array, tolerance: float) -> tuple[Array, NDArray[np.intp]]:
    """Return the different points, and for each of the given ones which it is."""
    _, first, member = np.unique(np.round(points / tolerance), axis=0, return_index=True, return_inverse=True)
    return points[first], member.ravel()


def _weights(mesh: Any, places: Array, tolerance: float) -> Array:
    """Weights of the mesh's points at a few places, shape (Q, N)."""
    points, corners = mesh.points, mesh.simplices
    weights = np.zeros((len(places), len(points)))
    triangle = mesh.find_simplex(places, tol=ON_EDGE)
    distance = np.linalg.norm(places[:, None] - points, axis=-1)
    nearest = distance.argmin(axis=1)
    hit = distance[np.arange(len(places)), nearest] <= tolerance
    weights[hit, nearest[hit]] = 1.0
    left = np.flatnonzero((triangle >= 0) & ~hit)
    on_hull = np.zeros(len(places), dtype=bool)
    for row in left:
        edge = _hull_edge(mesh, int(triangle[row]), places[row])
        if edge is not None:
            on_hull[row] = True
            weights[row, edge[0]] = edge[1]
    inside = left[~on_hull[left]]
    if inside.size:
        areas = _stolen(points, corners, mesh.neighbors, places[inside], triangle[inside])
        areas = np.maximum(areas, 0.0)
        weights[inside] = areas / areas.sum(axis=1, keepdims=True)
    return weights


def _hull_edge(mesh: Any, triangle: int, place: Array) -> tuple[NDArray[np.intp], Array] | None:
    """Return the ends of the hull's edge that a place lies on, and their linear weights, Sibson's limit."""
    transform = mesh.transform[triangle]
    first = transform[:2] @ (place - transform[2])
    shares = np.append(first, 1.0 - first.sum())
    if np.isnan(shares).any():
        return None
    for opposite in range(3):
        if mesh.neighbors[triangle, opposite] < 0 and shares[opposite] <= ON_EDGE:
            ends = [(opposite + 1) % 3, (opposite + 2) % 3]
            share = np.clip(shares[ends], 0.0, None)
            return mesh.simplices[triangle, ends], share / share.sum()
    return None


def _stolen(
    points: Array,
    corners: NDArray[np.intp],
    neighbors: NDArray[np.intp],
    places: Array,
    triangle: NDArray[np.intp],
) -> Array:
    """Area that each place takes from each point's Voronoi cell, shape (Q, N).

    The triangles whose circles hold a place are those that it would destroy. Around a point the taken area
    is a polygon through their circles' centres, closed by the centres of the circles through the place and
    the two edges of the destroyed region that meet in the point. (Watson 1992, without his circles through
    the place and inner edges, which degenerate when the three are in line.)
    """
    centre = _circumcentre(*np.moveaxis(points[corners], 1, 0))
    squared = np.sum((centre - points[corners[:, 0]]) ** 2, axis=-1)
    apart = np.sum((places[:, None] - centre) ** 2, axis=-1)
    destroyed = apart < squared * (1.0 - COCIRCULAR)
    destroyed[np.arange(len(places)), triangle] = True
    row, one = np.nonzero(destroyed)
    place = places[row]
    area = np.zeros((len(places), len(points)))
    start = np.zeros((len(places), len(points), 2))
    end = np.zeros((len(places), len(points), 2))
    touched = np.zeros(area.shape, dtype=bool)
    here = centre[one] - place
    for opposite in range(3):
        # Counter-clockwise edge a to b; leaving the triangle over it goes on around b, coming in around a.
        a, b = corners[one, (opposite + 1) % 3], corners[one, (opposite + 2) % 3]
        beyond = neighbors[one, opposite]
        inner = (beyond >= 0) & destroyed[row, beyond]
        there = np.where(
            inner[:, None],
            centre[beyond] - place,
            _circumcentre_at_origin(points[a] - place, points[b] - place),
        )
        np.add.at(area, (row, b), _cross(here, there))
        rim = ~inner
        np.add.at(area, (row[rim], a[rim]), _cross(there[rim], here[rim]))
        start[row[rim], a[rim]] = there[rim]
        end[row[rim], b[rim]] = there[rim]
        touched[row[rim], a[rim]] = True
    area[touched] += _cross(end[touched], start[touched])
    return area


def _cross(u: Array, v: Array) -> Array:
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def _circumcentre(a: Array, b: Array, c: Array) -> Array:
    return a + _circumcentre_at_origin(b - a, c - a)


def _circumcentre_at_origin(b: Array, c: Array) -> Array:
    """Centre of the circle through the origin, b and c; infinite values where they are in line."""
    twice = 2.0 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    twice = np.where(twice == 0.0, np.finfo(float).tiny, twice)
    bb, cc = np.sum(b * b, axis=-1), np.sum(c * c, axis=-1)
    with np.errstate(over="ignore"):
        x = (c[:, 1] * bb - b[:, 1] * cc) / twice
        y = (b[:, 0] * cc - c[:, 0] * bb) / twice
    return np.stack([x, y], axis=-1)
