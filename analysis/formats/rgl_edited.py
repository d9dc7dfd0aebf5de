"""A table in which somebody changed, rejected or left out samples: only the nodes concerned change.

Of a changed sample the node gets the new value; nodes that no sample shows (below the horizon, at grazing)
move by as much as the nearest one that changed with them, so that what lies between stays even. Rejected
and missing samples leave gaps in the table's own square, in which its values are smooth; they are closed by
the harmonic function that meets the nodes around (Laplace's equation).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.formats.rgl_layout import SAME, Kept, Tensors

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACH = 3
"""Steps of the table to the next node with a sample, from which on a closed gap is a guess."""


class Edited(NamedTuple):
    """A table with changed nodes.

    Attributes
    ----------
    tensors : dict of str to ndarray
        The new file.
    cells, filled : int
        Nodes above the surface, and those in gaps so wide that their values are guesses.
    """

    tensors: Tensors
    cells: int
    filled: int


def edited_tensors(samples: xr.Dataset, kept: Kept) -> Edited:
    """Put the samples' values into the table that they were read from.

    Parameters
    ----------
    samples : xarray.Dataset
        Samples on the table's nodes; values with flags and those that are no numbers are gaps.
    kept : Kept
        The table, see `analysis.formats.rgl_layout.kept_table`.
    """
    name = "rgb" if "rgb" in kept.tensors else "spectra"
    stored, before = kept.tensors[name], kept.table.values
    change, gap = _changes(samples, kept)
    shown = np.isfinite(change[:, 0])
    after = before + _spread(change, shown)
    filled = sum(_close(*slice_) for slice_ in zip(after, gap, shown, strict=True))
    changed = np.where(after == before, stored.reshape(before.shape), after)
    tensors = {**kept.tensors, name: changed.reshape(stored.shape).astype(stored.dtype)}
    return Edited(tensors, len(kept.nodes.wi), filled)


def _changes(samples: xr.Dataset, kept: Kept) -> tuple[Array, Mask]:
    """Change of each node's value and whether it is a gap, both (slices, C, rows, columns).

    NaN where no sample shows the node.
    """
    weight = kept.table.weight(kept.nodes.wi, kept.nodes.wo)[:, None]
    cosine = kept.nodes.wo[:, 2:]
    f_r, flags = (samples[name].to_numpy()[kept.row] for name in ("f_r", "flags"))
    missing = (kept.row < 0)[:, None] | (flags != 0) | ~np.isfinite(f_r)
    before = kept.nodes.value / cosine
    same = np.abs(f_r - before) <= SAME * np.abs(before)
    with np.errstate(invalid="ignore", divide="ignore"):
        change = np.where(missing | same | (weight == 0.0), 0.0, (f_r - before) * cosine / weight)
    shape = kept.table.values.shape
    return (
        _on_grid(kept.nodes.number, change, shape, np.nan),
        _on_grid(kept.nodes.number, missing, shape, fill=False),
    )


def _on_grid(number: NDArray[np.intp], column: Any, shape: tuple[int, ...], fill: Any) -> Any:
    """Spread what nodes have (N, C) over the table (slices, C, rows, columns): seam and pole twice."""
    slices, channels, rows, columns = shape
    inner = (rows - 1) * (columns - 1)
    table = np.full((slices, inner + 1, channels), fill, dtype=column.dtype)
    table.reshape(-1, channels)[number] = column
    grid = np.empty((slices, rows, columns, channels), dtype=column.dtype)
    grid[:, :-1, 1:] = table[:, :-1].reshape(slices, rows - 1, columns - 1, channels)
    grid[:, -1, 1:] = grid[:, 0, 1:]
    grid[:, :, 0] = table[:, -1:]
    return np.moveaxis(grid, -1, 1)


def _spread(change: Array, shown: Mask) -> Array:
    """Give nodes that no sample shows the change of the nearest one, first in their own slice."""
    from scipy.ndimage import distance_transform_edt

    if not np.nan_to_num(change).any():
        return np.zeros(change.shape)
    another_slice = float(sum(shown.shape))
    nearest = distance_transform_edt(
        ~shown, sampling=(another_slice, 1.0, 1.0), return_distances=False, return_indices=True
    )
    return np.asarray(np.moveaxis(np.moveaxis(change, 1, -1)[tuple(nearest)], -1, 1))


def _close(values: Array, gap: Mask, shown: Mask) -> int:
    """Close one slice's gaps (C, rows, columns) in place; returns how many nodes are guesses.

    A slice of which no sample is left keeps the file's values: all of them are guesses.
    """
    from scipy.ndimage import distance_transform_cdt

    guesses = 0
    masks, which = np.unique(gap.reshape(len(gap), -1), axis=0, return_inverse=True)
    for number, flat in enumerate(masks):
        mask = flat.reshape(shown.shape)
        chosen = which.ravel() == number
        known = shown & ~mask
        if not known.any():
            guesses = max(guesses, _count(mask))
        elif mask.any():
            values[chosen] = _harmonic(values[chosen], mask)
            around = np.pad(~known, ((REACH, REACH), (0, 0)), mode="wrap")
            far = distance_transform_cdt(around, "chessboard")[REACH:-REACH] > REACH
            guesses = max(guesses, _count(far & mask))
    return guesses


def _count(mask: Mask) -> int:
    """Count nodes (rows, columns), the seam and the pole once."""
    return int(np.count_nonzero(mask[:-1, 1:])) + int(mask[0, 0])


def _harmonic(values: Array, mask: Mask) -> Array:
    """Replace masked nodes (C, rows, columns) by the mean of their neighbours, all at once."""
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import spsolve

    number = np.full(mask.shape, -1, dtype=np.intp)
    number[mask] = np.arange(mask.sum())
    place = np.argwhere(mask)
    rows, columns = mask.shape
    count = np.zeros(len(place))
    known = np.zeros((len(place), len(values)))
    entries: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []
    for step in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        # Rows go around the circle; the first and the last one are the same.
        j, i = (place[:, 0] + step[0]) % (rows - 1), place[:, 1] + step[1]
        inside = np.flatnonzero((i >= 0) & (i < columns))
        j, i = j[inside], i[inside]
        count[inside] += 1.0
        unknown = number[j, i] >= 0
        known[inside[~unknown]] += values[:, j[~unknown], i[~unknown]].T
        entries.append((inside[unknown], number[j[unknown], i[unknown]]))
    first, second = (np.concatenate(part) for part in zip(*entries, strict=True))
    diagonal = np.arange(len(place))
    matrix = csr_array(
        (
            np.concatenate([count, -np.ones(len(first))]),
            (np.concatenate([diagonal, first]), np.concatenate([diagonal, second])),
        ),
        shape=(len(place), len(place)),
    )
    closed = values.copy()
    closed[:, mask] = np.asarray(spsolve(matrix.tocsc(), known)).reshape(len(place), -1).T
    return closed
