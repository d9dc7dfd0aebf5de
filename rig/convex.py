"""Distances of convex solids, many pairs at once, each with its proof.

Two bounds come with every pair. The lower one is proved by a plane: both solids lie on their sides of it, at
least so far apart. The upper one is proved by two points, one of each solid. Both hold whatever rounding does
to the search between them, which is that of Gilbert, Johnson and Keerthi (1988, "A fast procedure for
computing the distance between complex objects in three-dimensional space", IEEE J. Robot. Autom. 4, 193).
Rods with round ends need no search.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from rig.angles import FloatArray

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

TOLERANCE_MM = 1e-5
"""How close the two bounds come when nothing ends the search before."""

_ITERATIONS = 100
"""More than any pair takes; one that takes more keeps the bounds it has."""

_FLAT = 1e-12
"""A triangle or tetrahedron flatter than this, over the size of its edges, has no inside of its own."""


class Convex(Protocol):
    """A batch of convex solids, less the balls by which they are widened."""

    @property
    def ball_mm(self) -> FloatArray:
        """Radii (N,) of those balls."""
        ...

    @property
    def centre_mm(self) -> FloatArray:
        """A point (N, 3) of each."""
        ...

    def support(self, rows: IntArray, directions: FloatArray) -> FloatArray:
        """Return the farthest points (K, 3) of some solids along directions (K, 3) of any length."""
        ...


@dataclass(frozen=True, eq=False)
class Solids:
    """Boxes widened by discs, then by balls; see `rig.placement.Shape`.

    Attributes
    ----------
    half_mm : ndarray, shape (N, 3)
    disc_mm, ball_mm : ndarray, shape (N,)
    turn : ndarray, shape (N, 3, 3)
        Carries their own coordinates to the common ones.
    centre_mm : ndarray, shape (N, 3)
    """

    half_mm: FloatArray
    disc_mm: FloatArray
    ball_mm: FloatArray
    turn: FloatArray
    centre_mm: FloatArray

    def support(self, rows: IntArray, directions: FloatArray) -> FloatArray:
        """Return the farthest points (K, 3) of some solids along directions (K, 3) of any length."""
        turn = self.turn[rows]
        own = np.einsum("kij,ki->kj", turn, directions)
        points = np.copysign(self.half_mm[rows], own)
        points[:, :2] += _on_rim(self.disc_mm[rows], own[:, :2])
        return np.asarray(np.einsum("kij,kj->ki", turn, points) + self.centre_mm[rows])


@dataclass(frozen=True, eq=False)
class Beams:
    """All points between two discs: the light that reaches a sample, the rays by which a camera sees it.

    Attributes
    ----------
    ends_mm : ndarray, shape (N, 2, 3)
        Centres of the discs.
    normals : ndarray, shape (N, 2, 3)
        Unit vectors.
    radii_mm : ndarray, shape (2,)
    """

    ends_mm: FloatArray
    normals: FloatArray
    radii_mm: FloatArray

    @property
    def ball_mm(self) -> FloatArray:
        """No ball widens them."""
        return np.zeros(len(self.ends_mm))

    @property
    def centre_mm(self) -> FloatArray:
        """Point halfway, shape (N, 3)."""
        return np.asarray(self.ends_mm.mean(axis=1))

    def support(self, rows: IntArray, directions: FloatArray) -> FloatArray:
        """Return the farthest points (K, 3) of some beams along directions (K, 3) of any length."""
        along = directions[:, None, :]
        normals = self.normals[rows]
        sideways = along - np.sum(along * normals, axis=-1, keepdims=True) * normals
        # Along the normal only rounding is left, and that may point out of the disc's plane.
        size = np.linalg.norm(sideways, axis=-1, keepdims=True)
        sideways[size[..., 0] <= _FLAT * np.linalg.norm(along, axis=-1)] = 0.0
        points = self.ends_mm[rows] + _on_rim(self.radii_mm, sideways)
        farther = np.argmax(np.sum(points * along, axis=-1), axis=-1)
        return np.asarray(points[np.arange(len(points)), farther])


@dataclass(frozen=True, eq=False)
class Question:
    """When the search may stop, millimetres, shape (N,) each.

    It ends for a pair whose distance is known to be at least `clear`, or less than `near`, or to lie between
    both. The default asks for the distance itself.
    """

    near: FloatArray
    clear: FloatArray


@dataclass(frozen=True, eq=False)
class Answer:
    """What is known of each pair's distance.

    Attributes
    ----------
    lower_mm, upper_mm : ndarray, shape (N,)
        Bounds. Of solids that overlap neither is above 0, and they do not say how deep.
    points_mm : ndarray, shape (N, 2, 3)
        The points that prove the upper bound, one of each solid's core, before the balls widen it.
    """

    lower_mm: FloatArray
    upper_mm: FloatArray
    points_mm: FloatArray


def distances(a: Convex, b: Convex, question: Question | None = None) -> Answer:
    """Bound the distances between solids, pair by pair.

    Parameters
    ----------
    a, b : Convex
        Batches of N.
    question : Question, optional
        What is enough to know.

    Returns
    -------
    Answer
    """
    count = len(a.centre_mm)
    widened = a.ball_mm + b.ball_mm
    near = np.full(count, -np.inf) if question is None else question.near + widened
    clear = np.full(count, np.inf) if question is None else question.clear + widened
    rows = np.arange(count)
    lower, upper = np.zeros(count), np.zeros(count)
    points = np.zeros((count, 2, 3))
    towards = b.centre_mm - a.centre_mm
    on_a = a.support(rows, towards)
    v = on_a - b.support(rows, -towards)
    best = np.linalg.norm(v, axis=1)
    simplex = _Simplex.of(v, on_a)
    proved = np.zeros(count)
    for _ in range(_ITERATIONS):
        if not rows.size:
            break
        on_a = a.support(rows, -v)
        w = on_a - b.support(rows, v)
        # A point's length may be 0: then the solids overlap, and nothing is proved.
        proved = np.maximum(proved, np.einsum("ki,ki->k", v, w) / np.maximum(best, 1e-300))
        done = (best - proved <= TOLERANCE_MM) | (proved >= clear) | (best < near)
        done |= (proved >= near) & (best < clear) & np.isfinite(clear)
        following, weights = simplex.nearest(w)
        length = np.linalg.norm(following, axis=1)
        done |= length >= best  # rounding ends the search
        out = rows[done]
        lower[out], upper[out] = proved[done], best[done]
        points[out, 0] = simplex.point_on_a()[done]
        points[out, 1] = points[out, 0] - v[done]
        left = ~done
        simplex = simplex.grown(w, on_a, weights, left)
        rows, v, best = rows[left], following[left], length[left]
        near, clear, proved = near[left], clear[left], proved[left]
    lower[rows], upper[rows] = proved, best
    points[rows, 0] = simplex.point_on_a()
    points[rows, 1] = points[rows, 0] - v
    return Answer(lower - widened, upper - widened, points)


def rod_distances(
    centre_a: FloatArray, half_a: FloatArray, centre_b: FloatArray, half_b: FloatArray
) -> FloatArray:
    """Distances between straight lines of finite length, pair by pair.

    Parameters
    ----------
    centre_a, centre_b : ndarray, shape (N, 3)
    half_a, half_b : ndarray, shape (N, 3)
        From the centre to an end; may be zero.

    Returns
    -------
    ndarray, shape (N,)
        Exact but for rounding (Ericson 2005, "Real-Time Collision Detection", section 5.1.9).
    """
    apart = centre_a - centre_b
    aa, bb = (np.maximum(np.einsum("ki,ki->k", h, h), 1e-300) for h in (half_a, half_b))
    ab = np.einsum("ki,ki->k", half_a, half_b)
    ra, rb = np.einsum("ki,ki->k", half_a, apart), np.einsum("ki,ki->k", half_b, apart)
    cross = aa * bb - ab * ab
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(cross > _FLAT * aa * bb, (ab * rb - ra * bb) / cross, 0.0)
    s = np.clip(s, -1.0, 1.0)
    t = np.clip((ab * s + rb) / bb, -1.0, 1.0)
    s = np.clip((ab * t - ra) / aa, -1.0, 1.0)
    # Of nearly parallel lines the corner just found need not be the best one: all four ends are tried too.
    between = apart + s[:, None] * half_a - t[:, None] * half_b
    nearest = np.einsum("ki,ki->k", between, between)
    flat = np.flatnonzero(cross <= 1e-6 * aa * bb)
    if flat.size:
        nearest[flat] = np.minimum(nearest[flat], _from_ends(apart[flat], half_a[flat], half_b[flat]))
    return np.asarray(np.sqrt(nearest))


def _from_ends(apart: FloatArray, half_a: FloatArray, half_b: FloatArray) -> FloatArray:
    """Square of the least distance of any end of one line from the other line."""
    squares = []
    for offset, end, other in (
        (apart, half_a, half_b),
        (apart, -half_a, half_b),
        (-apart, half_b, half_a),
        (-apart, -half_b, half_a),
    ):
        to_end = offset + end
        length = np.maximum(np.einsum("ki,ki->k", other, other), 1e-300)
        along = np.clip(np.einsum("ki,ki->k", to_end, other) / length, -1.0, 1.0)
        between = to_end - along[:, None] * other
        squares.append(np.einsum("ki,ki->k", between, between))
    return np.asarray(np.min(squares, axis=0))


def _on_rim(radius: FloatArray, directions: FloatArray) -> FloatArray:
    """Farthest points of discs along directions in their planes; any point where there is no direction."""
    length = np.sqrt(np.sum(directions * directions, axis=-1))
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(length > 0.0, radius / length, 0.0)
    return np.asarray(scale[..., None] * directions)


@dataclass(frozen=True, eq=False)
class _Simplex:
    """Up to three points of each difference of solids, whose hull holds the point nearest to the origin.

    Attributes
    ----------
    points, on_a : ndarray, shape (K, 3, 3)
        The points, and the points of the first solid in them; slot by slot.
    weights : ndarray, shape (K, 3)
        Of each slot in the nearest point; 0 where a slot is empty.
    """

    points: FloatArray
    on_a: FloatArray
    weights: FloatArray

    @classmethod
    def of(cls, point: FloatArray, on_a: FloatArray) -> _Simplex:
        """Begin with one point."""
        shape = (len(point), 3, 3)
        weights = np.zeros(shape[:2])
        weights[:, 0] = 1.0
        points, firsts = np.zeros(shape), np.zeros(shape)
        points[:, 0], firsts[:, 0] = point, on_a
        return cls(points, firsts, weights)

    def point_on_a(self) -> FloatArray:
        """Point of the first solid in the nearest point."""
        return np.asarray(np.einsum("ks,ksi->ki", self.weights, self.on_a))

    def nearest(self, w: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find the point of the hull with a new point that is nearest to the origin.

        Every face that has the new point is tried: one of them holds it, unless nothing is gained.

        Returns
        -------
        point : ndarray, shape (K, 3)
        weights : ndarray, shape (K, 3)
            Of the old points; the new one has the rest.
        """
        edges = self.points - w[:, None, :]
        used = self.weights > 0.0
        b = -np.einsum("ksi,ki->sk", edges, w)
        gram = np.einsum("ksi,kti->stk", edges, edges)
        gain, weights = np.zeros(len(w)), np.zeros((len(w), 3))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for i in range(3):
                weight = b[i] / gram[i, i]
                better = used[:, i] & (weight > 0.0) & (weight <= 1.0)
                _take(gain, weights, better, weight * b[i], {i: weight})
            for i, j in ((0, 1), (0, 2), (1, 2)):
                det = gram[i, i] * gram[j, j] - gram[i, j] ** 2
                first = (b[i] * gram[j, j] - b[j] * gram[i, j]) / det
                second = (b[j] * gram[i, i] - b[i] * gram[i, j]) / det
                better = used[:, i] & used[:, j] & (det > _FLAT * gram[i, i] * gram[j, j])
                better &= (first > 0.0) & (second > 0.0) & (first + second <= 1.0)
                _take(gain, weights, better, first * b[i] + second * b[j], {i: first, j: second})
            full = np.flatnonzero(used.all(axis=1))
            if full.size:
                inside, inner = _inside(gram[:, :, full], b[:, full])
                weights[full[inside]] = inner[inside]
        return w + np.einsum("ks,ksi->ki", weights, edges), weights

    def grown(self, w: FloatArray, on_a: FloatArray, weights: FloatArray, kept: BoolArray) -> _Simplex:
        """Put a new point in a free slot of the pairs that are kept."""
        points, firsts, weights = self.points[kept], self.on_a[kept], weights[kept]
        rows = np.arange(len(points))
        slot = np.argmin(weights, axis=1)
        points[rows, slot], firsts[rows, slot] = w[kept], on_a[kept]
        weights[rows, slot] = np.maximum(1.0 - weights.sum(axis=1), 1e-300)
        return _Simplex(points, firsts, weights)


def _take(
    gain: FloatArray,
    weights: FloatArray,
    better: BoolArray,
    gains: FloatArray,
    values: dict[int, FloatArray],
) -> None:
    """Take a face, in place, where it is valid and nearer to the origin than those before."""
    better = better & (gains > gain)
    np.copyto(gain, gains, where=better)
    weights[better] = 0.0
    for slot, value in values.items():
        np.copyto(weights[:, slot], value, where=better)


def _inside(gram: FloatArray, b: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Tell which tetrahedra hold the origin, and the weights of their old points (K, 3)."""
    c00 = gram[1, 1] * gram[2, 2] - gram[1, 2] ** 2
    c01 = gram[0, 2] * gram[1, 2] - gram[0, 1] * gram[2, 2]
    c02 = gram[0, 1] * gram[1, 2] - gram[0, 2] * gram[1, 1]
    c11 = gram[0, 0] * gram[2, 2] - gram[0, 2] ** 2
    c12 = gram[0, 1] * gram[0, 2] - gram[0, 0] * gram[1, 2]
    c22 = gram[0, 0] * gram[1, 1] - gram[0, 1] ** 2
    det = gram[0, 0] * c00 + gram[0, 1] * c01 + gram[0, 2] * c02
    rows = ((c00, c01, c02), (c01, c11, c12), (c02, c12, c22))
    weights = np.stack([(row[0] * b[0] + row[1] * b[1] + row[2] * b[2]) / det for row in rows], axis=1)
    flat = det <= _FLAT * gram[0, 0] * gram[1, 1] * gram[2, 2]
    return ~flat & (weights > 0.0).all(axis=1) & (weights.sum(axis=1) <= 1.0), weights
