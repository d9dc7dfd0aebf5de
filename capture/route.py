"""The order in which poses are visited: by travel time, not by distance.

All joints move at once, each with a trapezoid of speed, so a move takes as long as its slowest joint. The
order is greedy (always the nearest next), then improved by turning pieces of the way round (2-opt; Croes
1958, "A method for solving traveling-salesman problems") and by moving short pieces elsewhere (Or 1976),
until neither gains. It is deterministic, and never slower than the order given.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rig.motion import travel_s

if TYPE_CHECKING:
    import numpy.typing as npt

    from rig.angles import FloatArray
    from rig.motion import ServoProfile

    Order = npt.NDArray[np.int64]

LARGEST_GREEDY = 10_000
"""Poses up to which the nearest next is looked for among all; beyond, the given order is improved."""

PIECE = 400
"""Poses that are improved at once: a table of all times between them is kept."""

LONGEST_MOVED = 3
"""Poses in a piece that is moved elsewhere as it is."""

_SWEEPS = 60
_GAIN_S = 1e-9


def path_s(angles: FloatArray, profile: ServoProfile, start: npt.ArrayLike | None = None) -> float:
    """Time to visit poses in the order given.

    Parameters
    ----------
    angles : ndarray, shape (N, J)
    profile : ServoProfile
    start : array_like, shape (J,), optional
        Where the arms stand before.

    Returns
    -------
    float
        Seconds.
    """
    if start is not None:
        angles = np.concatenate([np.asarray(start, dtype=np.float64)[None], angles])
    return math.fsum(travel_s(angles[:-1], angles[1:], profile))


def order_by_travel(angles: FloatArray, profile: ServoProfile, start: npt.ArrayLike) -> Order:
    """Find a fast order of poses.

    Parameters
    ----------
    angles : ndarray, shape (N, J)
    profile : ServoProfile
    start : array_like, shape (J,)
        Where the arms stand before.

    Returns
    -------
    ndarray of int, shape (N,)
        The order; the way ends where it ends.
    """
    given = np.arange(len(angles), dtype=np.int64)
    if len(angles) < 2:
        return given
    first = np.asarray(start, dtype=np.float64)
    ways = [given]
    if len(angles) <= LARGEST_GREEDY:
        ways.append(_improve(_greedy(angles, profile, first), angles, profile, first))
    if len(angles) <= PIECE or len(angles) > LARGEST_GREEDY:
        ways.append(_improve(given, angles, profile, first))
    return min(ways, key=lambda order: path_s(angles[order], profile, first))


def _greedy(angles: FloatArray, profile: ServoProfile, start: FloatArray) -> Order:
    """Go to the nearest of the poses left, the earliest of equals."""
    left = np.arange(len(angles), dtype=np.int64)
    order = np.empty(len(angles), dtype=np.int64)
    here = start
    for step in range(len(angles)):
        nearest = int(np.argmin(travel_s(here, angles[left], profile)))
        order[step] = left[nearest]
        here = angles[left[nearest]]
        left = np.delete(left, nearest)
    return order


def _improve(order: Order, angles: FloatArray, profile: ServoProfile, start: FloatArray) -> Order:
    """Improve an order piece by piece; each piece begins where the one before ends."""
    order = order.copy()
    before = start
    for begin in range(0, len(order), PIECE):
        piece = order[begin : begin + PIECE]
        after = angles[order[begin + PIECE]] if begin + PIECE < len(order) else None
        places = np.concatenate([before[None], angles[piece]] + ([] if after is None else [after[None]]))
        table = travel_s(places[:, None, :], places[None, :, :], profile)
        way = _improve_piece(table, open_end=after is None)
        order[begin : begin + PIECE] = piece[way - 1]
        before = angles[order[min(begin + PIECE, len(order)) - 1]]
    return order


def _improve_piece(table: FloatArray, *, open_end: bool) -> Order:
    """Improve the way 0, 1, ..., n whose first place (and last, unless its end is open) is fixed.

    Returns the order of the places in between.
    """
    if open_end:
        # A place that is nowhere: no time away from any other. An open way is one that ends there.
        table = np.pad(table, ((0, 1), (0, 1)))
    way = np.arange(len(table))
    for _ in range(_SWEEPS):
        gained = _turn_pieces(way, table)
        gained |= _move_pieces(way, table)
        if not gained:
            break
    return way[1:-1]


def _turn_pieces(way: Order, table: FloatArray) -> bool:
    """One sweep of 2-opt, in place: for each place the best piece that begins there, turned round."""
    gained = False
    for begin in range(1, len(way) - 1):
        before, first = way[begin - 1], way[begin]
        lasts, afters = way[begin:-1], way[begin + 1 :]
        change = table[before, lasts] + table[first, afters] - table[before, first] - table[lasts, afters]
        best = int(np.argmin(change))
        if change[best] < -_GAIN_S:
            way[begin : begin + best + 1] = way[begin : begin + best + 1][::-1].copy()
            gained = True
    return gained


def _move_pieces(way: Order, table: FloatArray) -> bool:
    """One sweep of Or's moves, in place: short pieces to where they cost least, either way round."""
    gained = False
    for length in range(1, LONGEST_MOVED + 1):
        for begin in range(1, len(way) - length):
            piece = way[begin : begin + length]
            rest = np.concatenate([way[:begin], way[begin + length :]])
            saved = (
                table[way[begin - 1], piece[0]]
                + table[piece[-1], way[begin + length]]
                - table[way[begin - 1], way[begin + length]]
            )
            if saved <= _GAIN_S:
                continue
            gap = table[rest[:-1], rest[1:]]
            forward = table[rest[:-1], piece[0]] + table[piece[-1], rest[1:]] - gap
            backward = table[rest[:-1], piece[-1]] + table[piece[0], rest[1:]] - gap
            turned = bool(backward.min() < forward.min())
            costs = backward if turned else forward
            at = int(np.argmin(costs))
            if costs[at] < saved - _GAIN_S:
                way[:] = np.concatenate([rest[: at + 1], piece[::-1] if turned else piece, rest[at + 1 :]])
                gained = True
    return gained
