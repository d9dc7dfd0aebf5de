"""Gonio's own store: the Dataset as NetCDF-4, with units as attributes and every uncertainty column.

The file ends in a checksum of its content, see `analysis.formats.hdf5`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.formats import hdf5
from analysis.formats.loss import Loss
from analysis.samples import DIMENSIONS, PER_CHANNEL, UNITS, make_samples
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

NAME = "NetCDF"
SUFFIX = ".nc"
OPTIONS: tuple[str, ...] = ()
MAGIC = b"\x89HDF\r\n\x1a\n"
MOST_VALUES = 500_000_000
# What h5netcdf and h5py raise for files that are cut, changed or not NetCDF at all.
_DAMAGE = (
    OSError,
    KeyError,
    ValueError,
    TypeError,
    RuntimeError,
    AttributeError,
    UnicodeDecodeError,
    IndexError,
    MemoryError,
)


def sniff(head: bytes) -> bool:
    """Whether the file is HDF5, which NetCDF-4 is."""
    return head.startswith(MAGIC)


def read(path: Path) -> xr.Dataset:
    """Read samples.

    Raises
    ------
    BadInput
        If the file is damaged, lacks wi, wo or f_r, declares more than fits, or its values make no sense.
    """
    import xarray as xr

    hdf5.require_harmless(path)
    try:
        store = xr.backends.H5NetCDFStore(_whole_file(path))
        with xr.open_dataset(store, cache=False) as opened:
            _check(opened, path)
            stored = opened.load()
    except BadInput:
        raise
    except _DAMAGE as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise BadInput(
            f"is not a whole NetCDF file ({reason})", where=str(path), todo="copy or reduce it again"
        ) from error
    variables: dict[str, Any] = {name: stored[name].to_numpy() for name in UNITS if name in stored}
    attributes = dict(stored.attrs)
    try:
        made = make_samples(
            variables.pop("wi"),
            variables.pop("wo"),
            variables.pop("f_r"),
            channels=[str(name) for name in stored["channel"].to_numpy()]
            if "channel" in stored.coords
            else None,
            wavelength_nm=stored["wavelength_nm"].to_numpy() if "wavelength_nm" in stored.coords else None,
            **variables,
        )
    except BadInput as error:
        raise BadInput(str(error), where=str(path)) from None
    extra = {name: stored[name] for name in stored.data_vars if name not in UNITS}
    extra_coordinates = {name: stored[name] for name in stored.coords if name not in made.coords}
    return made.assign(extra).assign_coords(extra_coordinates).assign_attrs(attributes)


def write(samples: xr.Dataset, path: Path) -> Loss:
    """Write samples, compressed; what the Dataset holds beyond the known variables is kept too."""
    content = samples.to_netcdf(
        engine="h5netcdf",
        encoding={
            str(name): {"zlib": True, "complevel": 1} for name in samples.data_vars if samples[name].ndim
        },
    )
    # Made in memory: where the disk is full, HDF5 cannot even close its file, and ends the process.
    path.write_bytes(hdf5.sealed(bytes(content)))
    return Loss(samples.sizes["sample"])


def _whole_file(path: Path) -> Any:
    """Open for reading; a file too damaged for it leaves nothing behind that complains when collected."""
    import h5netcdf

    class WholeFile(h5netcdf.File):  # type: ignore[misc] # the library is untyped
        # The library's finaliser asks for it, also where its constructor gave up before setting it.
        _writable = False

    return WholeFile(path, "r", phony_dims="access")


def _check(opened: xr.Dataset, path: Path) -> None:
    """Refuse what is not a table of samples before any of it is loaded."""
    for name in ("wi", "wo", "f_r"):
        if name not in opened:
            raise BadInput(
                f"has no variable {name}",
                where=str(path),
                todo="reduce the session again, or name the variables wi, wo, f_r",
            )
    total = sum(variable.size for variable in opened.variables.values())
    size = sum(variable.size * variable.dtype.itemsize for variable in opened.variables.values())
    if total > MOST_VALUES or size > path.stat().st_size * hdf5.MOST_COMPRESSION:
        raise BadInput(f"declares {total} values, more than it can hold", where=str(path))
    for name in UNITS:
        expected = DIMENSIONS.get(name, PER_CHANNEL)
        if name in opened and opened[name].dims != expected:
            raise BadInput(
                f"{name} has dimensions {opened[name].dims}, not {expected}",
                where=str(path),
                todo="transpose it",
            )
