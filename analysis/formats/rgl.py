"""Measured BSDFs of the RGL database and of Mitsuba's `measured`: tensor files of f_r cos(theta_o).

Reading gives the value at the table's own nodes, divided by the cosine; negative values stay. Linear RGB of
unnamed primaries unless the file names wavelengths. Writing makes an isotropic table that the samples are
interpolated onto. To keep a file's tensors as they are, use `analysis.formats.tensor`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.formats.loss import Loss, compared
from analysis.formats.rgl_table import Table
from analysis.formats.scattered import Scattered, usable
from analysis.formats.tensor import MAGIC, read_tensors, write_tensors
from analysis.samples import make_samples
from rig.angles import spherical_to_direction, unit
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr
    from numpy.typing import NDArray

NAME = "RGL .bsdf"
OPTIONS = ("no_cosine",)
SUFFIX = ".bsdf"
RGB = ("R", "G", "B")

LOWEST_COSINE = 0.02
"""Nodes nearer to grazing view (88.9 deg) are left out: dividing by the cosine would only show rounding."""

SIDE = 97
"""Nodes of a written table along the half vector's azimuth and polar angle: Mitsuba wants a square."""

PROFILE_COLUMNS = 513


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
    theta_i, phi_i, theta_h, phi_h = table.half_vectors()
    wi = spherical_to_direction(theta_i, phi_i)
    half = spherical_to_direction(theta_h, phi_h)
    wo = unit(2.0 * (wi * half).sum(-1, keepdims=True) * half - wi)
    seen = (wo[:, 2] > LOWEST_COSINE) & (wi[:, 2] > LOWEST_COSINE)
    wi, wo = wi[seen], wo[seen]
    value = table.evaluate(wi, wo)
    wavelengths = table.wavelengths
    return make_samples(
        wi,
        wo,
        value if no_cosine else value / wo[:, 2:],
        channels=RGB if wavelengths is None else None,
        wavelength_nm=wavelengths,
        source=path.name,
    )


def write(samples: xr.Dataset, path: Path) -> Loss:
    """Write samples as an isotropic table, one channel as grey.

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
    """
    tensors, loss = resample(samples)
    write_tensors(path, tensors)
    return loss


def resample(samples: xr.Dataset) -> tuple[dict[str, NDArray[Any]], Loss]:
    """Interpolate samples onto the nodes of a table; see `write`.

    Returns
    -------
    tensors : dict of str to ndarray
        What a tensor file of a measured BSDF holds.
    loss : Loss
        How far the table is from the samples.
    """
    given = usable(samples)
    wavelengths = samples["wavelength_nm"].to_numpy() if "wavelength_nm" in samples.coords else None
    if wavelengths is None and given.f_r.shape[1] == 1:
        given = given._replace(f_r=np.repeat(given.f_r, 3, axis=1))
    if wavelengths is None and given.f_r.shape[1] != 3:
        raise BadInput(
            f"{given.f_r.shape[1]} channels without wavelengths",
            where="samples",
            todo="this format holds one channel, three, or known wavelengths",
        )
    scattered = Scattered(given)
    theta_i = scattered.theta_i
    values, cells, filled = _nodes(scattered, given.f_r.shape[1])
    tensors: dict[str, NDArray[Any]] = {
        "theta_i": theta_i.astype(np.float32),
        "phi_i": np.zeros(1, np.float32),
        "sigma": np.full((2, 2), 0.25, np.float32),
        "ndf": np.tile(scattered.profile(np.linspace(0.0, 1.0, PROFILE_COLUMNS)), (2, 1)).astype(np.float32),
        "vndf": np.ones((1, theta_i.size, 2, 2), np.float32),
        "luminance": _sampling_density(scattered, values)[None].astype(np.float32),
        "rgb" if wavelengths is None else "spectra": values[None].astype(np.float32),
        "jacobian": np.ones(1, np.uint8),
        "description": np.frombuffer(f"gonio: {samples.attrs.get('source', '')}".encode(), np.uint8),
    }
    if wavelengths is not None:
        tensors["wavelengths"] = wavelengths.astype(np.float32)
    table = Table(tensors, "samples")
    back = table.evaluate(given.wi, given.wo) / given.wo[:, 2:]
    loss = compared(samples, *given, back, cells=cells, filled=filled, kept=("wavelength_nm",))
    return tensors, loss


def _nodes(scattered: Scattered, channels: int) -> tuple[NDArray[np.float64], int, int]:
    """Values (theta_i, channels, rows, columns) over the profile; cells seen, and those without samples.

    Below the horizon the value keeps its f_r and the cosine its negative sign, so that what lies between a
    node above and one below runs through zero where it should.
    """
    radius, phi = np.linspace(0.0, 1.0, SIDE), np.linspace(-np.pi, np.pi, SIDE)
    half = spherical_to_direction(*np.meshgrid(radius**2 * (np.pi / 2.0), phi)).reshape(-1, 3)
    values, outside, seen = [], 0, 0
    for theta in scattered.theta_i:
        wi = np.broadcast_to(spherical_to_direction(theta, 0.0), half.shape)
        wo = unit(2.0 * (wi * half).sum(-1, keepdims=True) * half - wi)
        f_r, beyond = scattered(wi, wo)
        profile = np.tile(scattered.profile(radius), SIDE)[:, None]
        values.append((f_r * wo[:, 2:] / profile).T.reshape(channels, SIDE, SIDE))
        outside += int((beyond & (wo[:, 2] > 0.0)).sum())
        seen += int((wo[:, 2] > 0.0).sum())
    return np.stack(values), seen, outside


def _sampling_density(scattered: Scattered, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Density (theta_i, rows, columns) that renderers draw directions from: positive everywhere."""
    brightness = values.mean(axis=1) * scattered.profile(np.linspace(0.0, 1.0, SIDE))
    floored: NDArray[np.float64] = np.maximum(
        brightness, 1e-3 * np.abs(brightness).max(axis=(1, 2), keepdims=True) + 1e-30
    )
    return floored
