"""Ways from pose to pose on which no two solids come nearer than the margin.

The direct move comes first. Where it is blocked: the same line in pieces, if only the servos' own profiles
leave it; then the joints one after another or in groups, in every order; then a road map (Kavraki et al.
1996, "Probabilistic roadmaps for path planning in high-dimensional configuration spaces"): poses drawn from a
fixed seed, and the moves between them that are clear. Every leg of every way is proved by `rig.swept`.
"""

from __future__ import annotations

import itertools
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from rig.errors import Refused
from rig.motion import Moves
from rig.ticks import rad_to_ticks, ticks_to_rad

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy.typing as npt

    from rig.angles import FloatArray
    from rig.clearance import Clearance
    from rig.convex import BoolArray, IntArray

FEW_PIECES, MANY_PIECES = (2, 4), (8, 16, 32)
"""In how many pieces a straight line is tried, before other ways and after them."""

MOST_GROUPED = 4
"""Joints up to which every order of groups is tried; of more joints, every one alone before or after."""

NODES = 250
"""Poses on the road map."""

NEIGHBOURS = 12
"""Moves tried from each to the nearest others."""

LEG_S = 0.1
"""What a stop on the way costs, for choosing among ways."""


class Detours:
    """Ways on one machine.

    Parameters
    ----------
    clearance : Clearance
    """

    def __init__(self, clearance: Clearance) -> None:
        self._clearance = clearance
        self._moving = np.flatnonzero(clearance.pairs.moving_joints)
        self._limits = clearance.pairs.kinematics.limits_rad

    def ways(self, start: FloatArray, end: FloatArray) -> list[FloatArray | None]:
        """Find a way for each of M moves.

        Parameters
        ----------
        start, end : ndarray, shape (M, J)
            Radians, within the joints' limits.

        Returns
        -------
        list of (ndarray, shape (L, J), or None)
            The poses to go to one after another, the last of them `end`; None where no way was found.
        """
        ways: list[FloatArray | None] = [None] * len(start)
        clear = self._clearance.moves(start, end).clear
        for move in np.flatnonzero(clear):
            ways[move] = end[move : move + 1]
        left = np.flatnonzero(~clear)
        if not left.size:
            return ways
        poses = self._clearance.poses(np.concatenate([start[left], end[left]])).clear
        left = left[poses[: left.size] & poses[left.size :]]
        candidates = (
            partial(self._in_pieces, FEW_PIECES),
            self._in_groups,
            self._on_the_map,
            partial(self._in_pieces, MANY_PIECES),
        )
        for candidate in candidates:
            for place, way in candidate(start[left], end[left]):
                ways[left[place]] = way
            left = np.array([move for move in left if ways[move] is None], dtype=np.int64)
            if not left.size:
                break
        return ways

    def way(self, start: npt.ArrayLike, end: npt.ArrayLike, where: str = "move") -> FloatArray:
        """Find the way of one move.

        Parameters
        ----------
        start, end : array_like, shape (J,)
            Radians.
        where : str
            The move's name in the message.

        Returns
        -------
        ndarray, shape (L, J)
            The poses to go to one after another, the last of them `end`.

        Raises
        ------
        Refused
            There is none; the message names solids and angles.
        """
        starts, ends = (np.atleast_2d(np.asarray(pose, dtype=np.float64)) for pose in (start, end))
        found = self.ways(starts, ends)[0]
        if found is None and not self._clearance.poses(starts).clear[0]:
            leaving = Detours(self._clearance.leaving(starts[0]))
            found = leaving.ways(starts, ends)[0] if self._clearance.poses(ends).clear[0] else None
        if found is not None:
            return found
        raise Refused(self.why_not(starts[0], ends[0]), where=where, todo="'gonio rig show' draws both poses")

    def onward(self, here: npt.ArrayLike, way: FloatArray) -> FloatArray:
        """Go on with a way after a stop on it: the arms may stand a tolerance off.

        Parameters
        ----------
        here : array_like, shape (J,)
            Where the arms stand.
        way : ndarray, shape (L, J)
            What is left of the way.

        Returns
        -------
        ndarray, shape (L', J)
            The same, or another way to its end.

        Raises
        ------
        Refused
            There is none.
        """
        start = np.asarray(here, dtype=np.float64)[None]
        return way if self._all_clear(start, [way])[0] else self.way(start[0], way[-1])

    def why_not(self, start: FloatArray, end: FloatArray) -> str:
        """Say what is in the way of a move that has none."""
        both = self._clearance.poses(np.stack([start, end]))
        if not both.clear[1]:
            return self._clearance.describe(both, 1)
        if not both.clear[0]:
            return f"the arms stand too close already, part them by hand: {self._clearance.describe(both, 0)}"
        blocked = self._clearance.moves(start[None], end[None])
        return f"no way round was found: on the direct one {self._clearance.describe(blocked, 0)}"

    def duration_s(self, start: FloatArray, way: FloatArray) -> float:
        """Time of a way, with its stops."""
        legs = Moves(np.concatenate([start[None], way[:-1]]), way, self._clearance.profile)
        return float(legs.duration_s.sum()) + LEG_S * (len(way) - 1)

    def _in_pieces(
        self, counts: tuple[int, ...], start: FloatArray, end: FloatArray
    ) -> Iterator[tuple[int, FloatArray]]:
        """Follow the straight line where it is clear, in the fewest pieces that keep near enough to it."""
        left = np.flatnonzero(self._clearance.straight_moves(start, end).clear)
        for pieces in counts:
            share = np.linspace(0.0, 1.0, pieces + 1)[1:-1, None]
            ways = [
                np.concatenate([self._held(between), end[move : move + 1]])
                for move in left
                for between in ((1.0 - share) * start[move] + share * end[move],)
            ]
            clear = self._all_clear(start[left], ways)
            yield from ((int(left[i]), ways[i]) for i in np.flatnonzero(clear))
            left = left[~clear]

    def _in_groups(self, start: FloatArray, end: FloatArray) -> Iterator[tuple[int, FloatArray]]:
        """Turn the joints in groups; of the ways with the fewest stops take the fastest."""
        left = np.arange(len(start))
        others = np.setdiff1d(np.arange(start.shape[1]), self._moving)
        for _, orders in itertools.groupby(_ordered_groups(tuple(self._moving)), key=len):
            best: dict[int, tuple[float, FloatArray]] = {}
            for groups in orders:
                ways = [_grouped(start[move], end[move], groups, others) for move in left]
                for i in np.flatnonzero(self._all_clear(start[left], ways)):
                    move = int(left[i])
                    took_s = self.duration_s(start[move], ways[i])
                    if move not in best or took_s < best[move][0] - 1e-9:
                        best[move] = took_s, ways[i]
            yield from ((move, way) for move, (_, way) in best.items())
            left = np.array([move for move in left if move not in best], dtype=np.int64)
            if not left.size:
                return

    def _on_the_map(self, start: FloatArray, end: FloatArray) -> Iterator[tuple[int, FloatArray]]:
        """Go to the road map, on it, and from it to the end: first by way of near nodes, then of any."""
        left = np.arange(len(start))
        for most in (2 * NEIGHBOURS, len(self._map[0])):
            ways = self._map_ways(start[left], end[left], most)
            found = np.array([way is not None for way in ways], dtype=bool)
            kept = [way for way in ways if way is not None]
            shorter = self._shortened(start[left[found]], kept)
            yield from zip(left[found].tolist(), shorter, strict=True)
            left = left[~found]
            if not left.size:
                return

    def _map_ways(self, start: FloatArray, end: FloatArray, most: int) -> list[FloatArray | None]:
        """Ways of M moves by at most so many nodes near to their ends."""
        nodes, costs, before = self._map
        near_start, near_end = (_nearest(nodes, poses, self._moving, most) for poses in (start, end))
        # Joints that make no difference go where they must on the way to the map.
        entry, leave = self._with_others(nodes[near_start], end), self._with_others(nodes[near_end], end)
        into_s = self._clear_s(np.broadcast_to(start[:, None], entry.shape), entry)
        out_s = self._clear_s(leave, np.broadcast_to(end[:, None], leave.shape))
        ways: list[FloatArray | None] = []
        for move in range(len(start)):
            between = costs[np.ix_(near_start[move], near_end[move])]
            total = into_s[move][:, None] + between + out_s[move]
            if not np.isfinite(total).any():
                ways.append(None)
                continue
            first, last = np.unravel_index(int(np.argmin(total)), total.shape)
            source, node = int(near_start[move, first]), int(near_end[move, last])
            route = [node]
            while node != source:
                node = int(before[source, node])
                route.append(node)
            ways.append(
                np.vstack([self._with_others(nodes[None, route[::-1]], end[move, None])[0], end[move]])
            )
        return ways

    def _clear_s(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Time of moves (M, N, J), shape (M, N); infinite for those that are not clear."""
        joints = start.shape[-1]
        moves = Moves(start.reshape(-1, joints), end.reshape(-1, joints), self._clearance.profile)
        clear = self._clearance.moves(moves.start, moves.end).clear
        return np.where(clear, moves.duration_s, np.inf).reshape(start.shape[:2])

    @cached_property
    def _map(self) -> tuple[FloatArray, FloatArray, IntArray]:
        """Nodes (N, J), times between them (N, N), and the node before each on the way from another."""
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import dijkstra

        nodes = self._nodes()
        near = _nearest(nodes, nodes, self._moving, NEIGHBOURS + 1)[:, 1:]
        source, target = np.repeat(np.arange(len(nodes)), near.shape[1]), near.ravel()
        # A move and the move back are two: the servos' profiles make them take different ways.
        source, target = np.concatenate([source, target]), np.concatenate([target, source])
        source, target = np.unique(np.stack([source, target]), axis=1)
        moves = Moves(nodes[source], nodes[target], self._clearance.profile)
        clear = self._clearance.moves(moves.start, moves.end).clear
        costs = csr_array(
            (moves.duration_s[clear] + LEG_S, (source[clear], target[clear])), shape=(len(nodes),) * 2
        )
        times, before = dijkstra(costs, return_predecessors=True)
        return nodes, times, before

    def _nodes(self) -> FloatArray:
        """Draw clear poses: parked, all at zero, and random ones."""
        kinematics = self._clearance.pairs.kinematics
        low, high = self._limits.T
        random = np.random.default_rng(0).uniform(low, high, size=(4 * NODES, low.size))
        poses = np.vstack([kinematics.park_rad, np.zeros(low.size), random])
        poses[:, np.setdiff1d(np.arange(low.size), self._moving)] = 0.0
        poses = self._held(poses)
        return poses[self._clearance.poses(poses).clear][:NODES]

    def _held(self, poses: FloatArray) -> FloatArray:
        """Angles that the servos can hold nearest to those of poses."""
        joints = self._clearance.pairs.kinematics.joints
        columns = [ticks_to_rad(joint, rad_to_ticks(joint, poses[:, i])) for i, joint in enumerate(joints)]
        return np.stack(columns, axis=1)

    def _with_others(self, nodes: FloatArray, end: FloatArray) -> FloatArray:
        """Nodes (M, N, J) with the joints that make no difference where the M moves end."""
        poses = np.repeat(end[:, None], nodes.shape[1], axis=1)
        poses[..., self._moving] = nodes[..., self._moving]
        return poses

    def _shortened(self, start: FloatArray, ways: Sequence[FloatArray]) -> list[FloatArray]:
        """Leave out the stops of M ways that are not needed: of all clear legs between them, the fastest."""
        stops = [np.vstack([first, way]) for first, way in zip(start, ways, strict=True)]
        legs = [
            (way, begin, end)
            for way, poses in enumerate(stops)
            for begin, end in itertools.combinations(range(len(poses)), 2)
        ]
        if not legs:
            return []
        begins, ends = (np.stack([stops[leg[0]][leg[place]] for leg in legs]) for place in (1, 2))
        seconds = dict(zip(legs, self._clear_s(begins[:, None], ends[:, None])[:, 0], strict=True))
        return [
            poses[_fastest({leg[1:]: took_s for leg, took_s in seconds.items() if leg[0] == way}, len(poses))]
            for way, poses in enumerate(stops)
        ]

    def _all_clear(self, start: FloatArray, ways: Sequence[FloatArray]) -> BoolArray:
        """Whether every leg of each way is clear."""
        if not ways:
            return np.zeros(0, dtype=bool)
        begins = [np.concatenate([first[None], way[:-1]]) for first, way in zip(start, ways, strict=True)]
        lengths = [len(way) for way in ways]
        clear = self._clearance.moves(np.concatenate(begins), np.concatenate(ways)).clear
        return np.logical_and.reduceat(clear, np.cumsum([0, *lengths[:-1]]))


def _grouped(
    start: FloatArray, end: FloatArray, groups: Sequence[tuple[int, ...]], others: IntArray
) -> FloatArray:
    """Poses of a way on which groups of joints turn one after another, the others with the first."""
    here = start.copy()
    here[others] = end[others]
    way = []
    for group in groups:
        here = here.copy()
        here[list(group)] = end[list(group)]
        way.append(here)
    return np.stack(way)


def _ordered_groups(joints: tuple[int, ...]) -> list[tuple[tuple[int, ...], ...]]:
    """Every way to turn joints in two or more groups, fewest groups first."""
    if len(joints) > MOST_GROUPED:
        alone = [((joint,), tuple(other for other in joints if other != joint)) for joint in joints]
        return [*alone, *((second, first) for first, second in alone)]
    orders = []
    for count in range(2, len(joints) + 1):
        for places in itertools.product(range(count), repeat=len(joints)):
            groups = [
                tuple(itertools.compress(joints, (at == group for at in places))) for group in range(count)
            ]
            if all(groups):
                orders.append(tuple(groups))
    return sorted(orders, key=len)


def _nearest(nodes: FloatArray, poses: FloatArray, moving: IntArray, most: int) -> IntArray:
    """Places (M, most) of the nodes nearest to M poses, by the joint that turns farthest."""
    far = np.abs(nodes[None, :, moving] - poses[:, None, moving]).max(axis=2)
    return np.argsort(far, axis=1, kind="stable")[:, :most]


def _fastest(seconds: dict[tuple[int, int], float], count: int) -> list[int]:
    """Find the stops after stop 0 of the fastest way from it to the last, from the times of its legs."""
    best: list[tuple[float, list[int]]] = [(0.0, [])]
    for end in range(1, count):
        ways = [(best[begin][0] + seconds[begin, end] + LEG_S, best[begin][1]) for begin in range(end)]
        took_s, stops = min(ways, key=lambda way: way[0])
        best.append((took_s, [*stops, end]))
    return best[-1][1]
