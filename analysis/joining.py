"""Several files of one sample as one table: incidences, sheets or days that a laboratory keeps apart."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from analysis.formats.doubts import ATTRIBUTE
from analysis.rejection import LOG
from analysis.rejection_transfer import joined
from analysis.samples import UNITS, make_samples
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr

GROUPS = ("pose", "white_group")
"""Numbers that mean the same error only within one file."""

WITHIN_FILE = ("d_wi", "d_wo", "u_joint_rad", "joint_group")
"""What says how errors of one file hang together: joints of two files are two sets of joints."""

SOLID_ANGLES = ("source_solid_angle_sr", "receiver_solid_angle_sr")
SAME_NM = 1e-6


class Joined(NamedTuple):
    """One table, and the variables that could not come along."""

    samples: xr.Dataset
    dropped: tuple[str, ...]


def join(tables: Sequence[xr.Dataset], names: Sequence[str]) -> Joined:
    """Put tables of the same channels one after the other.

    Parameters
    ----------
    tables : sequence of xarray.Dataset
        At least one.
    names : sequence of str
        The files, for errors.

    Returns
    -------
    Joined
        A variable that one table lacks is dropped from all; `u_f_r` then stays what each table had. The logs
        of rejected samples follow each other, under the new numbers of entries and samples.

    Raises
    ------
    BadInput
        If channels or wavelengths differ, or a log is damaged.
    """
    first = tables[0]
    if len(tables) == 1:
        return Joined(first, ())
    for table, name in zip(tables[1:], names[1:], strict=True):
        _require_same_channels(first, table, name)
    known = [name for name in UNITS if any(name in table for table in tables)]
    kept = [name for name in known if all(name in table for table in tables) and name not in WITHIN_FILE]
    columns: dict[str, Any] = {name: np.concatenate(_apart(name, tables)) for name in kept}
    wi, wo, f_r = (columns.pop(name) for name in ("wi", "wo", "f_r"))
    samples = make_samples(
        wi,
        wo,
        f_r,
        channels=[str(name) for name in first["channel"].to_numpy()],
        wavelength_nm=first["wavelength_nm"].to_numpy() if "wavelength_nm" in first.coords else None,
        source="; ".join(str(table.attrs.get("source", "")) for table in tables),
        **{name: _shared(name, tables) for name in SOLID_ANGLES},
        **columns,
    )
    cosines = {str(table.attrs.get("cosine", samples.attrs["cosine"])) for table in tables}
    if len(cosines) > 1:
        raise BadInput("some hold a cosine, some do not", where=names[0], todo="read all in the same way")
    doubts = "; ".join(
        f"{name}: {table.attrs[ATTRIBUTE]}"
        for table, name in zip(tables, names, strict=True)
        if table.attrs.get(ATTRIBUTE)
    )
    attributes = {"cosine": cosines.pop()} | ({ATTRIBUTE: doubts} if doubts else {})
    others = sorted({str(n) for table in tables for n in table.data_vars if n not in UNITS and n != LOG})
    samples = joined(tables, samples.assign_attrs(attributes))
    return Joined(samples, tuple(name for name in known if name not in kept) + tuple(others))


def _apart(
    name: str, tables: Sequence[xr.Dataset]
) -> list[np.ndarray[tuple[int, ...], np.dtype[np.generic]]]:
    """Return a variable's tables; group numbers are shifted, so that no group spans two files."""
    values = [table[name].to_numpy() for table in tables]
    if name not in GROUPS:
        return values
    shifted, start = [], 0
    for value in values:
        shifted.append(value - (value.min() if value.size else 0) + start)
        start = int(shifted[-1].max()) + 1 if value.size else start
    return shifted


def _shared(name: str, tables: Sequence[xr.Dataset]) -> float:
    values = [float(table.attrs.get(name, np.nan)) for table in tables]
    return values[0] if np.ptp(values) == 0.0 else float("nan")


def _require_same_channels(first: xr.Dataset, table: xr.Dataset, where: str) -> None:
    ours, theirs = ([str(name) for name in t["channel"].to_numpy()] for t in (first, table))
    nm = [t["wavelength_nm"].to_numpy() if "wavelength_nm" in t.coords else None for t in (first, table)]
    same = ours == theirs and (nm[0] is None) == (nm[1] is None)
    if same and nm[0] is not None and nm[1] is not None:
        same = bool(np.allclose(nm[0], nm[1], rtol=0.0, atol=SAME_NM))
    if not same:
        raise BadInput(
            f"has the channels {', '.join(theirs[:4])}, the first file {', '.join(ours[:4])}",
            where=where,
            todo="choose channels that all files have with --wavelength-nm, or convert them apart",
        )
