"""A table's own file beside its samples, so that samples nobody changed are written as the table they are.

Nodes alone do not make the table again: those below the horizon are no samples, and the warps that place the
nodes stand in no sample. The variable `rgl_table` holds the file's bytes; it is believed only as long as the
samples are still those that reading it gives.
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
Tensors = dict[str, NDArray[Any]]

LAYOUT = "rgl_table"
"""Variable of samples: the file that they were read from, byte by byte."""

LOWEST_COSINE = 0.02
"""Nodes nearer to grazing (88.9 deg) are left out: dividing by the cosine would only show rounding."""

SAME = 1e-9
"""Relative difference of values, and distance of directions, that storing them may make."""

SAME_NM = 0.01


class Nodes(NamedTuple):
    """A table's nodes above the surface: directions (N, 3) and f_r cos(theta_o) (N, C)."""

    wi: Array
    wo: Array
    value: Array


def nodes_of(table: Table) -> Nodes:
    """Return the nodes that samples are made of."""
    theta_i, phi_i, theta_h, phi_h = table.half_vectors()
    wi = spherical_to_direction(theta_i, phi_i)
    half = spherical_to_direction(theta_h, phi_h)
    wo = unit(2.0 * (wi * half).sum(-1, keepdims=True) * half - wi)
    seen = (wo[:, 2] > LOWEST_COSINE) & (wi[:, 2] > LOWEST_COSINE)
    wi, wo = wi[seen], wo[seen]
    return Nodes(wi, wo, table.evaluate(wi, wo))


def with_layout(samples: xr.Dataset, content: bytes) -> xr.Dataset:
    """Keep a file's bytes with the samples that were read from it."""
    return samples.assign({LAYOUT: ("rgl_byte", np.frombuffer(content, np.uint8))})


def own_tensors(samples: xr.Dataset) -> Tensors | None:
    """Return the table that samples were read from, if they still are what it says.

    Wavelengths may have been left out, samples not.

    Returns
    -------
    dict of str to ndarray, or None
        None where samples come from elsewhere, some are gone, flagged or changed.

    Raises
    ------
    BadInput
        If the kept file is damaged.
    """
    if LAYOUT not in samples or ("flags" in samples and bool((samples["flags"] != 0).any())):
        return None
    where = f"samples: {LAYOUT}"
    tensors = unpack_tensors(samples[LAYOUT].to_numpy().tobytes(), where)
    table = Table(tensors, where)
    channels = _channels(samples, table)
    nodes = nodes_of(table)
    if channels is None or len(nodes.wi) != samples.sizes["sample"]:
        return None
    f_r = (nodes.value / nodes.wo[:, 2:])[:, channels]
    for name, expected, slack in (("wi", nodes.wi, 1.0), ("wo", nodes.wo, 1.0), ("f_r", f_r, np.abs(f_r))):
        if not (np.abs(samples[name].to_numpy() - expected) <= SAME * slack).all():
            return None
    if "spectra" in tensors:
        tensors["spectra"] = tensors["spectra"][:, :, channels]
        tensors["wavelengths"] = tensors["wavelengths"][channels]
    return tensors


def _channels(samples: xr.Dataset, table: Table) -> NDArray[np.intp] | None:
    """Numbers of the table's channels that the samples hold; None if they hold others."""
    if table.wavelength_nm is None:
        count = table.values.shape[1]
        return np.arange(count) if samples.sizes["channel"] == count else None
    if "wavelength_nm" not in samples.coords:
        return None
    away = np.abs(samples["wavelength_nm"].to_numpy()[:, None] - table.wavelength_nm)
    return np.argmin(away, axis=1) if (away.min(axis=1) <= SAME_NM).all() else None
