"""Which sample of one table is which of another: the same directions, whatever the order of the rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr

Indices = NDArray[np.intp]

SAME = 1e-9
"""Largest difference of two components of one direction, and of two values of one sample, relative."""


@dataclass(frozen=True, eq=False)
class Matching:
    """The samples of an old table found in a new one; N old samples.

    Attributes
    ----------
    place : ndarray of int, shape (N,)
        Number of each in the new table; -1 where it is not there.
    group : ndarray of int, shape (N,)
        Samples of one group share their directions, and their pose where that is known.
    sure : ndarray of bool, shape (N,)
        Whether it is this sample, or only one of its group: samples of a group are told apart by f_r.
    """

    place: Indices
    group: Indices
    sure: NDArray[np.bool_]


def match_samples(old: xr.Dataset, new: xr.Dataset) -> Matching:
    """Find the samples of one table in another.

    Directions decide. Where several samples share them, the pose does, if both tables know it. A group whose
    size has changed is not found.

    Parameters
    ----------
    old, new : xarray.Dataset
        Samples, in any order.

    Returns
    -------
    Matching
    """
    count = old.sizes["sample"]
    group = _by_pose(_by_directions(old, new), old, new)
    before, after = group[:count], group[count:]
    values_before, values_after = _common_values(old, new)
    groups = int(group.max(initial=-1)) + 1
    size_before, size_after = (np.bincount(part, minlength=groups) for part in (before, after))
    kept = size_before == size_after
    rows, others = _sorted(before, values_before), _sorted(after, values_after)
    rows, others = rows[kept[before[rows]]], others[kept[after[others]]]
    place = np.full(count, -1, dtype=np.intp)
    place[rows] = others
    same = np.isclose(values_before[rows], values_after[others], rtol=SAME, atol=0.0, equal_nan=True)
    sure = size_before[before] == 1
    sure[rows] |= same.all(axis=1)
    return Matching(place, before, sure & (place >= 0))


def _by_directions(old: xr.Dataset, new: xr.Dataset) -> Indices:
    """Give each pair of directions a number; rows of old, then of new."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    wi, wo = (np.concatenate([table[name].to_numpy() for table in (old, new)]) for name in ("wi", "wo"))
    # Equal ones first become one: many repeats would make a pair with each other.
    pairs, row = np.unique(np.concatenate([wi, wo], axis=1), axis=0, return_inverse=True)
    near = KDTree(pairs).query_pairs(SAME, p=np.inf, output_type="ndarray")
    graph = coo_array((np.ones(len(near), dtype=np.int8), (near[:, 0], near[:, 1])), shape=2 * (len(pairs),))
    number: Indices = connected_components(graph, directed=False)[1].astype(np.intp)
    return number[row.ravel()]


def _by_pose(group: Indices, old: xr.Dataset, new: xr.Dataset) -> Indices:
    """Divide the groups of several samples by pose; a sample alone is itself under any number of its pose."""
    if "pose" not in old or "pose" not in new:
        return group
    count, groups = old.sizes["sample"], int(group.max(initial=-1)) + 1
    several = np.zeros(groups, dtype=bool)
    for part in (group[:count], group[count:]):
        several |= np.bincount(part, minlength=groups) > 1
    pose = np.concatenate([table["pose"].to_numpy() for table in (old, new)])
    keys = np.stack([group, np.where(several[group], pose, 0)], axis=1)
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()


def _common_values(old: xr.Dataset, new: xr.Dataset) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return f_r of the channels that both have."""
    found = match_channels(old, new)
    return old["f_r"].to_numpy()[:, list(found)], new["f_r"].to_numpy()[:, list(found.values())]


def match_channels(old: xr.Dataset, new: xr.Dataset) -> dict[int, int]:
    """Find the channels of one table in another, by name; a name that stands twice names none.

    Returns
    -------
    dict of int to int
        From the old number to the new; all, as they are, where the names are the same.
    """
    ours, theirs = ([str(name) for name in table["channel"].to_numpy()] for table in (old, new))
    if ours == theirs:
        return {number: number for number in range(len(ours))}
    once = [name for name in ours if ours.count(name) == theirs.count(name) == 1]
    return {ours.index(name): theirs.index(name) for name in once}


def _sorted(group: Indices, values: NDArray[np.float64]) -> Indices:
    return np.lexsort((*values.T[::-1], group))
