"""Whether two readings of a file give the same f_r in the same directions, within noise.

Two readings place the same rows at different directions or give them different values. They are the same
where the one's values are found by the other's at the same place: light and view exchanged, mirrored and
turned directions count as one. How far values may be apart is the stated uncertainty, or where there is none,
how far neighbours are apart. Each share of the samples is held to its own bound, so that a narrow peak in
another place is not lost among many samples without one; a common factor is a difference.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.doctor_exchange import half_angle_features
from analysis.pairing import isotropic_key
from rig.angles import wrap

if TYPE_CHECKING:
    from collections.abc import Sequence

    from analysis.angle_table import AngleTable
    from analysis.doctor_readings import Reading

Array = NDArray[np.float64]

EXACTLY = 1e-6
"""Difference of signatures up to which two readings give the same samples, noise or not."""
NEIGHBOURS = 3
SHARES = (0.5, 0.75, 0.9, 0.97)
"""Shares of the samples, nearest first, whose differences are compared with those between neighbours."""
MARGIN = 1.25
"""How much larger than noise the differences of the same values may be: quantiles have noise of their own."""
SAME_PLACE = 1e-6
REACH = 2.0
"""A place is known where a sample lies as near as this many times the usual distance of neighbours."""
LEAST_OVERLAP = 0.7
FEWEST = 20
_MEDIAN = 0.6745
"""Median size of a normal deviate, over its standard deviation."""
NOISE_FLOOR = 0.005
"""Relative difference that no instrument tells."""


class _Values(NamedTuple):
    """Values of one reading where they are comparable: ln f at places, and what is stated of their noise."""

    places: Array
    log_f: Array
    u: Array | None


def grouped(table: AngleTable, readings: Sequence[Reading]) -> list[list[Reading]]:
    """Put readings together that give the same samples, simplest first."""
    groups: list[tuple[Array, list[Reading]]] = []
    for reading in readings:
        signature = signature_of(reading.apply(table))
        for known, members in groups:
            if np.max(np.abs(known - signature), initial=0.0) < EXACTLY:
                members.append(reading)
                break
        else:
            groups.append((signature, [reading]))
    return [members for _, members in groups]


def signature_of(table: AngleTable) -> Array:
    """Return samples (N, 4 + C) up to exchange of light and view, mirroring, and turning of the surface.

    Samples below the horizon are all alike.
    """
    # The sign of a polar angle is half a turn of the azimuth.
    back = (table.theta_i < 0.0).astype(np.float64) - (table.theta_o < 0.0)
    turn = np.abs(wrap(table.phi_o - table.phi_i + np.pi * back))
    polar = np.sort(np.abs(np.stack([table.theta_i, table.theta_o])), axis=0)
    # Values of files span many decades: the logarithm, with a sign.
    values = np.sign(table.f_r) * np.log1p(np.abs(table.f_r) * 1e9)
    signature = np.concatenate([isotropic_key(polar[0], polar[1], turn), values], axis=1)
    return np.where(table.possible()[:, None], signature, 0.0)


def alike(a: AngleTable, b: AngleTable) -> bool:
    """Whether two readings of the same rows give the same values in the same directions.

    Parameters
    ----------
    a, b : AngleTable
        One channel; the same rows under either reading. What noise is, their fact `u_f_r` says, if any.

    Returns
    -------
    bool
        False also where they share too few directions to tell.
    """
    one, other = _values(a), _values(b)
    if min(len(one.log_f), len(other.log_f)) < FEWEST:
        return False
    return _found_in(one, other) and _found_in(other, one)


def _values(table: AngleTable) -> _Values:
    rows = table.rows(table.possible() & (table.f_r[:, 0] > 0.0))
    f_r = rows.f_r[:, 0]
    u = rows.facts["u_f_r"][:, 0] / f_r if "u_f_r" in rows.facts else None
    return _Values(half_angle_features(rows.wi, rows.wo), np.log(f_r), u)


def _found_in(one: _Values, other: _Values) -> bool:
    """Whether the values of the one are those of the other, where this has neighbours."""
    from scipy.spatial import cKDTree
    from scipy.special import ndtri

    tree = cKDTree(other.places)
    spacing, index = tree.query(other.places, k=NEIGHBOURS + 1)
    apart = np.abs(other.log_f - _mean(spacing[:, 1:], other.log_f[index[:, 1:]]))
    distance, near = tree.query(one.places, k=NEIGHBOURS)
    known = distance[:, 0] <= REACH * np.quantile(spacing[:, -1], 0.75)
    if np.count_nonzero(known) < max(FEWEST, LEAST_OVERLAP * len(known)):
        return False
    difference = np.abs(one.log_f - _mean(distance, other.log_f[near]))
    if one.u is None or other.u is None:
        nugget = float(np.median(apart)) / _MEDIAN / np.sqrt(1.0 + 1.0 / NEIGHBOURS)
        noise, noise_apart = np.full(len(known), nugget), np.full(len(apart), nugget)
    else:
        noise, noise_apart = np.hypot(one.u, other.u[near[:, 0]]), np.hypot(other.u, other.u[index[:, 1]])
    shares = np.array(SHARES)
    bound = ndtri(0.5 + 0.5 * shares)
    if distance[:, 0].max() > SAME_PLACE:  # else nothing is interpolated, and steep places are no excuse
        bound = np.maximum(bound, np.quantile(apart / np.hypot(noise_apart, NOISE_FLOOR), shares))
    found = np.quantile((difference / np.hypot(noise, NOISE_FLOOR))[known], shares)
    return bool((found <= MARGIN * bound).all())


def _mean(distance: Array, log_f: Array) -> Array:
    """Return the mean of neighbours (N, K), the nearer the heavier; of one at the same place its value."""
    weight = 1.0 / np.maximum(distance, SAME_PLACE) ** 2
    return np.asarray((weight * log_f).sum(axis=1) / weight.sum(axis=1))
