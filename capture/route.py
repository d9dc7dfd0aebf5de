"""The order in which poses are visited: by travel time, not by distance.

All joints move at once, each with a trapezoid of speed, so a move takes as long as its slowest joint. The
order is greedy (always the nearest next), then improved by turning pieces of the way round (2-opt; Croes
1958, "A method for solving traveling-salesman problems") and by moving short pieces elsewhere (Or 1976),
until neither gains. It is deterministic, and never slower than the order given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    from rig.angles import FloatArray
    from rig.description import Rig

    Order = npt.NDArray[np.int64]

LARGEST_GREEDY = 10_000
"""Poses up to which the nearest next is looked for among all; beyond, the given order is improved."""

PIECE = 400
"""Poses that are improved at once: a table of all times between them is kept."""

LONGEST_MOVED = 3
"""Poses in a piece that is moved elsewhere as it is."""

_SWEEPS = 60
_GAIN_S = 1e-9


@dataclass(frozen=True, eq=False)
class Profile:
    """Top speed and acceleration of each joint.

    Attributes
    ----------
    speed_rad_s, acceleration_rad_s2 : ndarray, shape (J,)
    """

    speed_rad_s: FloatArray
    acceleration_rad_s2: FloatArray

    @classmethod
    def of(cls, rig: Rig) -> Profile:
        """Profile of a machine's arm joints."""
        joints = rig.arm_joints
        return cls(
            np.radians([joint.speed_deg_s for joint in joints]),
            np.radians([joint.acceleration_deg_s2 for joint in joints]),
        )


def travel_s(start: npt.ArrayLike, end: npt.ArrayLike, profile: Profile) -> FloatArray:
    """Time of moves, from standing to standing.

    Over a distance d at top speed v and acceleration a it is d/v + v/a, or 2 sqrt(d/a) where the way is too
    short to reach v.

    Parameters
    ----------
    start, end : array_like, shape (..., J)
        Joint angles, radians.
    profile : Profile

    Returns
    -------
    ndarray, shape (...)
        Seconds, of the slowest joint.
    """
    way = np.abs(np.asarray(end, dtype=np.float64) - np.asarray(start, dtype=np.float64))
    speed, acceleration = profile.speed_rad_s, profile.acceleration_rad_s2
    short = way < speed**2 / acceleration
    times = np.where(short, 2.0 * np.sqrt(way / acceleration), way / speed + speed / acceleration)
    return np.asarray(np.max(times, axis=-1))


def path_s(angles: FloatArray, profile: Profile, start: npt.ArrayLike | None = None) -> float:
    """Time to visit poses in the order given.

    Parameters
    ----------
    angles : ndarray, shape (N, J)
    profile : Profile
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


def order_by_travel(angles: FloatArray, profile: Profile, start: npt.ArrayLike) -> Order:
    """Find a fast order of poses.

    Parameters
    ----------
    angles : ndarray, shape (N, J)
    profile : Profile
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


def _greedy(angles: FloatArray, profile: Profile, start: FloatArray) -> Order:
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


def _improve(order: Order, angles: FloatArray, profile: Profile, start: FloatArray) -> Order:
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
