"""Whether solids keep apart along a whole move, not only at some points of it.

Between two poses no point of a solid moves farther against another than the joints turn, times their levers.
So a pair whose distance is known at one pose stays clear for as long as that sum is less than what it has to
spare. Moves are halved until every piece is proved clear, or a pose is found where two solids are too near.
What is accepted is proved; what is refused has a witness.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rig.clearance_pairs import RESOLUTION_MM
from rig.convex import Question

if TYPE_CHECKING:
    from rig.angles import FloatArray
    from rig.clearance_pairs import SolidPairs
    from rig.convex import BoolArray, IntArray
    from rig.motion import Moves

_ENTRIES = 200_000
"""Pairs at poses that are looked at together; it bounds the memory."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """What is known of M moves.

    Attributes
    ----------
    clear : ndarray of bool, shape (M,)
        Proved: no two solids come nearer than the margin.
    pair : ndarray of int, shape (M,)
        Which pair came too near; -1 where none did.
    angles_rad : ndarray, shape (M, J)
        Where it did; NaN where none did.
    """

    clear: BoolArray
    pair: IntArray
    angles_rad: FloatArray


def sweep(pairs: SolidPairs, moves: Moves) -> Sweep:
    """Check whole moves.

    Parameters
    ----------
    pairs : SolidPairs
    moves : Moves
        M of them.

    Returns
    -------
    Sweep
    """
    count, joints = moves.start.shape
    pair = np.full(count, -1, dtype=np.int64)
    where = np.full((count, joints), np.nan)
    batch = _batch(pairs)
    for first in range(0, count, batch):
        move = np.arange(first, min(first + batch, count))
        asked = np.ones((len(move), len(pairs.pairs)), dtype=bool)
        stack = [_Pieces(move, np.zeros(len(move)), np.ones(len(move)), asked)]
        while stack:
            pieces = stack.pop()
            pieces = pieces.some(pair[pieces.move] < 0)
            if len(pieces.move) > batch:
                half = len(pieces.move) // 2
                stack += [pieces.some(slice(half, None)), pieces.some(slice(half))]
            elif pieces.move.size:
                stack.append(_halve(pairs, moves, pieces, pair, where))
    return Sweep(pair < 0, pair, where)


def near_poses(pairs: SolidPairs, angles_rad: FloatArray) -> Sweep:
    """Check poses as `sweep` checks moves: those where solids are nearer than the margin are not clear.

    Parameters
    ----------
    pairs : SolidPairs
    angles_rad : ndarray, shape (M, J)
    """
    count = len(angles_rad)
    pair = np.full(count, -1, dtype=np.int64)
    batch = _batch(pairs)
    for begin in range(0, count, batch):
        part = angles_rad[begin : begin + batch]
        asked = np.ones((len(part), len(pairs.pairs)), dtype=bool)
        _undecided(pairs, part, asked, np.zeros_like(asked, dtype=float), pair[begin : begin + batch])
    where = np.where((pair < 0)[:, None], np.nan, angles_rad)
    return Sweep(pair < 0, pair, where)


def _batch(pairs: SolidPairs) -> int:
    """Poses that are looked at together."""
    return max(_ENTRIES // max(len(pairs.pairs), 1), 1)


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of moves, K of them, and which pairs (K, P) are not proved clear there yet."""

    move: IntArray
    begin: FloatArray
    end: FloatArray
    asked: BoolArray

    def some(self, which: BoolArray | slice) -> _Pieces:
        return _Pieces(self.move[which], self.begin[which], self.end[which], self.asked[which])


def _halve(pairs: SolidPairs, moves: Moves, pieces: _Pieces, pair: IntArray, where: FloatArray) -> _Pieces:
    """Check pieces from their middles; return the halves of those that are not proved.

    Pairs that are too near are entered in `pair`, and the angles in `where`.
    """
    middle = (pieces.begin + pieces.end) / 2.0
    angles = moves.at(pieces.move, middle)
    before, after = moves.at(pieces.move, pieces.begin), moves.at(pieces.move, pieces.end)
    turned = np.maximum(np.abs(angles - before), np.abs(after - angles))
    found = np.full(len(middle), -1, dtype=np.int64)
    asked = _undecided(pairs, angles, pieces.asked, turned @ pairs.levers_mm.T, found)
    hit = found >= 0
    pair[pieces.move[hit]], where[pieces.move[hit]] = found[hit], angles[hit]
    left = asked.any(axis=1) & (pair[pieces.move] < 0)
    move, asked, middle = pieces.move[left], asked[left], middle[left]
    return _Pieces(
        np.concatenate([move, move]),
        np.concatenate([pieces.begin[left], middle]),
        np.concatenate([middle, pieces.end[left]]),
        np.concatenate([asked, asked]),
    )


def _undecided(
    pairs: SolidPairs, angles: FloatArray, asked: BoolArray, reach_mm: FloatArray, found: IntArray
) -> BoolArray:
    """Tell which pairs (K, P) might come nearer than the margin within a reach (K, P) of K poses.

    Poses where two solids are too near are entered in `found`.
    """
    poses = pairs.poses(angles)
    row, pair = np.nonzero(asked)
    margin = pairs.margins_mm[pair]
    near_mm = margin + RESOLUTION_MM
    reach = reach_mm[row, pair]
    lower = pairs.at_least(poses, row, pair)
    open_ = lower < margin + reach
    exact = pairs.are_rods(pair)
    near = exact & (lower < near_mm)
    found[row[near]] = pair[near]
    search = np.flatnonzero(open_ & ~exact & (found[row] < 0))
    if search.size:
        near_mm = near_mm[search]
        clear_mm = np.maximum(margin[search] + reach[search], near_mm)
        answer = pairs.bounds(poses, row[search], pair[search], Question(near_mm, clear_mm))
        hit = search[answer.lower_mm < near_mm]
        found[row[hit]] = pair[hit]
        open_[search] = answer.lower_mm < clear_mm
    undecided = np.zeros_like(asked)
    undecided[row[open_], pair[open_]] = True
    return undecided
