"""A housing's walls in patches: how they light each other, solved once for all poses.

The walls of the cube are cut into equal squares, so that edges lie in the sample's plane and no patch is half
below its horizon. The share of a patch's light that comes from another is averaged over points of the first
of the exact form factor of a polygon seen from a point, so that each point's shares add up to 1;
they are then made reciprocal, so that many bounces neither lose light nor make it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_POINTS = 2
"""Points of a patch, along each side, at which its form factors are averaged."""
_SCALINGS = 40
_NEAR = 0.5
"""Half side of a square over its distance from the lamp above which the rule on it is refined."""
_DEEPEST = 12


class WallRule(NamedTuple):
    """Nodes on the walls.

    Attributes
    ----------
    points : ndarray, shape (N, 3)
        In millimetres.
    normals : ndarray, shape (N, 3)
        Inwards.
    areas : ndarray, shape (N,)
        In square millimetres.
    patches : ndarray of int, shape (N,)
        The patch that each lies on.
    """

    points: Array
    normals: Array
    areas: Array
    patches: Indices


@dataclass(frozen=True, eq=False)
class _Squares:
    """Squares on the walls: middles (N, 3), walls (N,), half sides (N,) and patches (N,)."""

    centres: Array
    walls: Indices
    halves: Array
    patches: Indices

    def halved(self, which: NDArray[np.bool_]) -> _Squares:
        """Cut some of them into four each."""
        parts = [
            _Squares(self.centres[~which], self.walls[~which], self.halves[~which], self.patches[~which])
        ]
        walls, halves, patches = self.walls[which], self.halves[which] / 2.0, self.patches[which]
        for u in (-1.0, 1.0):
            for v in (-1.0, 1.0):
                step = halves[:, None] * (u * _ACROSS[walls] + v * _UP[walls])
                parts.append(_Squares(self.centres[which] + step, walls, halves, patches))
        return _Squares(
            np.concatenate([part.centres for part in parts]),
            np.concatenate([part.walls for part in parts]),
            np.concatenate([part.halves for part in parts]),
            np.concatenate([part.patches for part in parts]),
        )


_NORMALS = np.array([-sign * axis for axis in np.eye(3) for sign in (-1.0, 1.0)])
_ACROSS = np.array([np.roll(axis, 1) for axis in np.eye(3) for _ in range(2)])
_UP = np.array([np.roll(axis, 2) for axis in np.eye(3) for _ in range(2)])


class Walls:
    """A cube about the origin, in equal square patches.

    Parameters
    ----------
    half_size_mm : float
        Half its side.
    side : int
        Patches along each side; even.
    """

    def __init__(self, half_size_mm: float, side: int) -> None:
        self._half_mm, self.side = half_size_mm, side
        self._patch_half_mm = half_size_mm / side
        steps = (np.arange(side) - (side - 1) / 2.0) * 2.0 * self._patch_half_mm
        wall, u, v = (index.ravel() for index in np.indices((6, side, side)))
        centres = -half_size_mm * _NORMALS[wall] + steps[u, None] * _ACROSS[wall] + steps[v, None] * _UP[wall]
        halves = np.full(len(wall), self._patch_half_mm)
        self._squares = _Squares(centres, wall, halves, np.arange(len(wall)))
        self.centres, self.normals = centres, _NORMALS[wall]
        self.patch_area = 4.0 * self._patch_half_mm**2

    def __len__(self) -> int:
        """Return the number of patches."""
        return len(self.centres)

    def form_factors(self) -> Array:
        """Return the share (P, P) of what a patch (row) receives that comes from each patch (column)."""
        squares, nodes = self._squares, np.polynomial.legendre.leggauss(_POINTS)[0]
        half, wall = self._patch_half_mm, squares.walls
        corners = np.stack(
            [
                squares.centres + half * (u * _ACROSS[wall] + v * _UP[wall])
                for u, v in ((1, 1), (-1, 1), (-1, -1), (1, -1))
            ],
            axis=1,
        )
        shares = np.zeros((len(wall), len(wall)))
        for u in nodes:
            for v in nodes:
                points = squares.centres + half * (u * _ACROSS[wall] + v * _UP[wall])
                shares += polygon_form_factors(points, self.normals, corners)
        shares[wall[:, None] == wall] = 0.0
        return _reciprocal(shares)

    def opposite(self) -> Indices:
        """Return the number of the patch that each sees behind the middle of the cube."""
        wall, u, v = np.indices((6, self.side, self.side))
        last = self.side - 1
        return np.asarray((((wall ^ 1) * self.side + last - u) * self.side + last - v).ravel())

    def coarser(self) -> Indices:
        """Return the number, among the patches of half as many along each side, that each lies in."""
        wall, u, v = np.indices((6, self.side, self.side))
        few = self.side // 2
        return np.asarray(((wall * few + u // 2) * few + v // 2).ravel())

    def rule(self, lamp_mm: Array, nodes: int) -> WallRule:
        """Gauss-Legendre nodes on every patch, on smaller squares where the lamp is near.

        Parameters
        ----------
        lamp_mm : ndarray, shape (3,)
            Where the lamp is.
        nodes : int
            Along each side of a square.
        """
        squares = self._squares
        for _ in range(_DEEPEST):
            beside = np.abs(lamp_mm - squares.centres) - squares.halves[:, None] * np.abs(
                _ACROSS[squares.walls] + _UP[squares.walls]
            )
            near = squares.halves > _NEAR * np.linalg.norm(np.maximum(beside, 0.0), axis=1)
            if not near.any():
                break
            squares = squares.halved(near)
        s, ds = np.polynomial.legendre.leggauss(nodes)
        u, v = (axis.ravel() for axis in np.meshgrid(s, s, indexing="ij"))
        weights = np.outer(ds, ds).ravel()
        offsets = u[:, None] * _ACROSS[squares.walls][:, None] + v[:, None] * _UP[squares.walls][:, None]
        points = squares.centres[:, None] + squares.halves[:, None, None] * offsets
        return WallRule(
            points.reshape(-1, 3),
            np.repeat(_NORMALS[squares.walls], len(weights), axis=0),
            (np.square(squares.halves)[:, None] * weights).ravel(),
            np.repeat(squares.patches, len(weights)),
        )

    def hit(self, starts: Array, directions: Array) -> WallRule:
        """Find where rays from inside meet the walls; areas are those of the unit sphere about each start.

        Parameters
        ----------
        starts, directions : ndarray, shape (N, 3)
            The directions of length 1.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            ways = (self._half_mm * np.sign(directions) - starts) / directions
        ways = np.where(directions == 0.0, np.inf, ways)
        axis = np.argmin(ways, axis=1)
        rows = np.arange(len(starts))
        wall = 2 * axis + (directions[rows, axis] < 0.0)
        wall = _WALL_OF[wall]
        points = starts + ways[rows, axis, None] * directions
        u, v = (
            np.clip(
                (np.sum(points * along[wall], axis=1) + self._half_mm) // (2.0 * self._patch_half_mm),
                0,
                self.side - 1,
            ).astype(np.intp)
            for along in (_ACROSS, _UP)
        )
        return WallRule(points, _NORMALS[wall], np.ones(len(rows)), (wall * self.side + u) * self.side + v)


# Rows are ordered by axis, then by the sign of the normal's opposite: -1 first, where rays go to the minus.
_WALL_OF = np.array([1, 0, 3, 2, 5, 4])


def _reciprocal(shares: Array) -> Array:
    """Make the shares between equal patches symmetric, rows still adding up to 1: no light is lost or made.

    Rows and columns are scaled alike until they do (Sinkhorn 1964).
    """
    shares = shares + shares.T
    for _ in range(_SCALINGS):
        root = np.sqrt(shares.sum(axis=1))
        shares = shares / np.outer(root, root)
    return np.asarray(shares)


def polygon_form_factors(points: Array, normals: Array, corners: Array) -> Array:
    """Form factors of polygons seen from points, exact where a polygon is wholly above the point's horizon.

    A sum over directed edges (Baum, Rushmeier and Winget 1989, "Improving radiosity solutions through the
    use of analytically determined form-factors", eq. 8, after Lambert 1760); either side of a polygon counts.

    Parameters
    ----------
    points, normals : ndarray, shape (M, 3)
    corners : ndarray, shape (P, C, 3)
        In order.

    Returns
    -------
    ndarray, shape (M, P)
    """
    total = np.zeros((len(points), len(corners)))
    count = corners.shape[1]
    for place in range(count):
        first = corners[None, :, place] - points[:, None]
        second = corners[None, :, (place + 1) % count] - points[:, None]
        turn = np.cross(first, second)
        sine = np.linalg.norm(turn, axis=-1)
        angle = np.arctan2(sine, np.sum(first * second, axis=-1))
        along = np.einsum("mpk,mk->mp", turn, normals)
        total += angle * along / np.where(sine > 0.0, sine, 1.0)
    return np.asarray(np.abs(total) / (2.0 * np.pi))
