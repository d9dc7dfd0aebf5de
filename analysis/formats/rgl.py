"""Measured BSDFs of the RGL database and of Mitsuba's `measured`: tensor files of f_r cos(theta_o).

Reading gives the value at the table's own nodes, divided by the cosine; negative values stay. Linear RGB of
unnamed primaries unless the file names wavelengths. The file itself stays with the samples: as long as nobody
changes them, writing gives its tensors bit for bit, and where somebody did, only the nodes around change.
Other samples are interpolated onto a table.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.formats.loss import Loss, compared, unchanged
from analysis.formats.rgl_anisotropic import is_anisotropic, resample_anisotropic
from analysis.formats.rgl_edited import edited_tensors
from analysis.formats.rgl_layout import LAYOUT, is_unchanged, kept_table, nodes_of, with_layout
from analysis.formats.rgl_resample import resample
from analysis.formats.rgl_table import Table
from analysis.formats.scattered import usable
from analysis.formats.tensor import MAGIC, read_tensors, write_tensors
from analysis.samples import make_samples

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

NAME = "RGL .bsdf"
OPTIONS = ("no_cosine",)
SUFFIX = ".bsdf"
RGB = ("R", "G", "B")
HELD = ("wavelength_nm", LAYOUT)
"""What a table holds beside directions and values."""


def sniff(head: bytes) -> bool:
    """Whether the file is a tensor file; Zemax and others use the suffix `.bsdf` for text."""
    return head.startswith(MAGIC)


def read(path: Path, *, no_cosine: bool = False) -> xr.Dataset:
    """Read the table's nodes as samples.

    Parameters
    ----------
    path : Path
        The file.
    no_cosine : bool
        The values are the BRDF itself, not times cos(theta_o), as some exporters write them.

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    BadInput
        If the file is damaged or lacks a field of a measured BSDF.
    """
    table = Table(read_tensors(path), str(path))
    nodes = nodes_of(table)
    samples = make_samples(
        nodes.wi,
        nodes.wo,
        nodes.value if no_cosine else nodes.value / nodes.wo[:, 2:],
        channels=RGB if table.wavelengths is None else None,
        wavelength_nm=table.wavelengths,
        source=path.name,
    )
    return with_layout(samples, path.read_bytes())


def write(samples: xr.Dataset, path: Path) -> Loss:
    """Write samples: those of a table as that table, others interpolated, one channel as grey.

    Samples whose values depend on the light's azimuth make an anisotropic table, if they are scans with the
    light at few azimuths; see `analysis.formats.rgl_anisotropic`.

    Of a table's samples some may have been changed, rejected or left out; see `analysis.formats.rgl_edited`.

    Parameters
    ----------
    samples : xarray.Dataset
        Samples of three channels, of one, or of known wavelengths; those with flags are left out.
    path : Path
        Where to.

    Returns
    -------
    Loss
        How far the table is from the samples.

    Raises
    ------
    BadInput
        If the samples are too few, lie in one plane, or have channels that the format cannot hold.
    Refused
        If they are anisotropic, no table of their own stands behind them, and they are no scans.
    """
    kept = kept_table(samples)
    if kept is None:
        tensors, loss = resample_anisotropic(samples) if is_anisotropic(samples) else resample(samples)
    elif is_unchanged(samples, kept):
        tensors, loss = kept.tensors, unchanged(samples, samples.sizes["sample"], kept=HELD)
    else:
        tensors, cells, filled = edited_tensors(samples, kept)
        given = usable(samples)
        back = Table(tensors, "samples").evaluate(given.wi, given.wo) / given.wo[:, 2:]
        loss = compared(samples, *given[:3], back, cells=cells, filled=filled, kept=HELD)
    write_tensors(path, tensors)
    return loss
