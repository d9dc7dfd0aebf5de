"""A table's own file beside its samples, so that samples nobody changed are written as the table they are.

Nodes alone do not make the table again: those below the horizon are no samples, and the warps that place the
nodes stand in no sample. The variable `rgl_table` holds the file's bytes; it is believed only as long as the
samples still stand on its nodes. Values that somebody changed or rejected there are put into it by
`analysis.formats.rgl_edited`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.formats.rgl_table import Table
from analysis.formats.tensor import unpack_tensors
from rig.angles import spherical_to_direction, unit

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Tensors = dict[str, NDArray[Any]]

LAYOUT = "rgl_table"
"""Variable of samples: the file that they were read from, byte by byte."""

LOWEST_COSINE = 0.02
"""Nodes nearer to grazing (88.9 deg) are left out: dividing by the cosine would only show rounding."""

SAME = 1e-9
"""Relative difference of values, and distance of directions, that storing them may make."""

SAME_NM = 0.01


class Nodes(NamedTuple):
    """A table's nodes above the surface: directions (N, 3), f_r cos(theta_o) (N, C), and their numbers (N,).

    Numbers count all half vectors of `Table.half_vectors`, those below the surface too.
    """

    wi: Array
    wo: Array
    value: Array
    number: Indices


class Kept(NamedTuple):
    """A table and the samples that stand on its nodes.

    Attributes
    ----------
    tensors : dict of str to ndarray
        The file, narrowed to the samples' channels.
    table : Table
        The same, checked.
    nodes : Nodes
        Its nodes above the surface.
    row : ndarray of int, shape (nodes,)
        Number of the sample of each node; -1 where it is gone.
    """

    tensors: Tensors
    table: Table
    nodes: Nodes
    row: Indices


def nodes_of(table: Table) -> Nodes:
    """Return the nodes that samples are made of."""
    theta_i, phi_i, theta_h, phi_h = table.half_vectors()
    wi = spherical_to_direction(theta_i, phi_i)
    half = spherical_to_direction(theta_h, phi_h)
    wo = unit(2.0 * (wi * half).sum(-1, keepdims=True) * half - wi)
    seen = np.flatnonzero((wo[:, 2] > LOWEST_COSINE) & (wi[:, 2] > LOWEST_COSINE))
    wi, wo = wi[seen], wo[seen]
    return Nodes(wi, wo, table.evaluate(wi, wo), seen)


def with_layout(samples: xr.Dataset, content: bytes) -> xr.Dataset:
    """Keep a file's bytes with the samples that were read from it."""
    return samples.assign({LAYOUT: ("rgl_byte", np.frombuffer(content, np.uint8))})


def kept_table(samples: xr.Dataset) -> Kept | None:
    """Return the table that samples were read from, if they still stand on its nodes.

    Wavelengths and samples may have been left out, values may have changed.

    Returns
    -------
    Kept or None
        None where samples come from elsewhere, are no nodes, or have other channels.

    Raises
    ------
    BadInput
        If the kept file is damaged.
    """
    if LAYOUT not in samples:
        return None
    where = f"samples: {LAYOUT}"
    tensors = unpack_tensors(samples[LAYOUT].to_numpy().tobytes(), where)
    channels = _channels(samples, Table(tensors, where))
    if channels is None:
        return None
    if "spectra" in tensors:
        tensors["spectra"] = tensors["spectra"][:, :, channels]
        tensors["wavelengths"] = tensors["wavelengths"][channels]
    table = Table(tensors, where)
    nodes = nodes_of(table)
    row = _rows_of(nodes, samples["wi"].to_numpy(), samples["wo"].to_numpy())
    return None if row is None else Kept(tensors, table, nodes, row)


def is_unchanged(samples: xr.Dataset, kept: Kept) -> bool:
    """Whether samples are all there, none flagged, and as reading the table gives them."""
    if (kept.row < 0).any() or ("flags" in samples and bool((samples["flags"] != 0).any())):
        return False
    f_r = kept.nodes.value / kept.nodes.wo[:, 2:]
    return bool((np.abs(samples["f_r"].to_numpy()[kept.row] - f_r) <= SAME * np.abs(f_r)).all())


def _rows_of(nodes: Nodes, wi: Array, wo: Array) -> Indices | None:
    """Find the sample of each node, -1 for none; None where a sample is no node, or two are one."""
    from scipy.spatial import KDTree

    known, given = np.hstack([nodes.wi, nodes.wo]), np.hstack([wi, wo])
    if len(known) == len(given) and np.abs(known - given).max(initial=0.0) <= SAME:
        return np.arange(len(known))
    if not np.isfinite(given).all() or len(given) > len(known):
        return None
    away, node = KDTree(known).query(given)
    if (away > 3.0 * SAME).any() or np.unique(node).size < len(node):
        return None
    row = np.full(len(known), -1, dtype=np.intp)
    row[node] = np.arange(len(given))
    return row


def _channels(samples: xr.Dataset, table: Table) -> Indices | None:
    """Numbers of the table's channels that the samples hold; None if they hold others."""
    if table.wavelength_nm is None:
        count = table.values.shape[1]
        return np.arange(count) if samples.sizes["channel"] == count else None
    if "wavelength_nm" not in samples.coords:
        return None
    away = np.abs(samples["wavelength_nm"].to_numpy()[:, None] - table.wavelength_nm)
    return np.argmin(away, axis=1) if (away.min(axis=1) <= SAME_NM).all() else None
