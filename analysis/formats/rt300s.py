"""Raw exports of the RT-300S gonioreflectometer: an `.xls` of several sheets, one column a reading.

Column A names the rows. Of each further column, `Incidence` is the light's polar angle, `Azimuth` the laser's
azimuth, `Receive` the signed angle of the detector in its fixed plane, all in degrees, and `RT` the reading,
a reflectance relative to the perfect diffuser times the cosine of view: f_r = (RT - RT_blank) / (pi
cos(theta_r)).

Directions: +x of the sample frame is the detector's side of positive angles; the mirror direction lies at
azimuth
-90 and receive > 0. In which sense the laser's azimuth runs is not in the file and does not matter to an
isotropic sample: it is taken as counter-clockwise.
"""

from __future__ import annotations

import io
import struct
from enum import IntFlag
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples import make_samples
from rig.angles import spherical_to_direction, wrap
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

NAME = "RT-300S .xls"
OPTIONS = ("blank", "floor_shift")
MAGIC = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
ROWS = ("Incidence", "Azimuth", "Receive", "RT")
LARGEST_BYTES = 128 * 1024**2
LABELS_WITHIN = 64
SHADOW_RECEIVE_DEG = 10.0
SHADOW_AZIMUTH_DEG = 30.0
# What xlrd raises for files that are cut or changed; its own classes are added when it is imported.
_DAMAGE = (
    struct.error, IndexError, KeyError, ValueError, AssertionError, OSError, TypeError, AttributeError,
    NotImplementedError, MemoryError, OverflowError, RecursionError,
)  # fmt: skip


class Flag(IntFlag):
    """Why a reading may not be used."""

    SELF_SHADOW = 1
    """The detector's arm stands in the laser's beam, or so near that the laboratory drops the reading."""


class Readings(NamedTuple):
    """One file's readings: angles in degrees, shape (N, 3) in the order of `ROWS`, and RT, shape (N,)."""

    angles_deg: Array
    value: Array


def sniff(head: bytes) -> bool:
    """Whether the file is a compound document, which `.xls` is."""
    return head.startswith(MAGIC)


def read(path: Path, *, blank: str | Path | None = None, floor_shift: bool = False) -> xr.Dataset:
    """Read one channel of samples.

    Parameters
    ----------
    path : Path
        The sample's file.
    blank : str or Path, optional
        File of the blank (no sample), subtracted reading by reading.
    floor_shift : bool
        Shift the smallest difference to zero, as some published tables did. It raises every dark sample: only
        for comparison with such tables.

    Returns
    -------
    xarray.Dataset
        Readings shadowed by the detector's arm have a flag.

    Raises
    ------
    BadInput
        If a file is damaged or no such export, or the blank lacks an angle.
    """
    readings = read_readings(path)
    value = readings.value
    if blank is not None:
        value = value - _at_the_same_angles(readings, read_readings(Path(blank)), path, Path(blank))
    if floor_shift:
        value = value - value.min()
    incidence, azimuth, receive = readings.angles_deg.T
    return make_samples(
        spherical_to_direction(np.radians(incidence), np.radians(wrap_deg(azimuth - 90.0))),
        spherical_to_direction(np.radians(np.abs(receive)), np.where(receive < 0.0, np.pi, 0.0)),
        value / (np.pi * np.cos(np.radians(receive))),
        channels=["RT"],
        flags=np.where(shadowed(readings.angles_deg), int(Flag.SELF_SHADOW), 0),
        source=path.name if blank is None else f"{path.name} less {Path(blank).name}",
    )


def wrap_deg(angle_deg: Array) -> Array:
    """Bring angles into (-180, 180] degrees."""
    return np.asarray(np.degrees(wrap(np.radians(angle_deg))))


def shadowed(angles_deg: Array) -> NDArray[np.bool_]:
    """Whether the detector's arm shadows the laser.

    The zone that the laboratory leaves out of its published tables: receive within 10 deg of the light's
    polar angle on the light's side, azimuth within 30 deg of the plane of incidence.

    Parameters
    ----------
    angles_deg : ndarray, shape (N, 3)
        Incidence, azimuth, receive.

    Returns
    -------
    ndarray of bool, shape (N,)
    """
    incidence, azimuth, receive = angles_deg.T
    # The light's own direction is azimuth +90 for receive > 0 and -90 for receive < 0; at 0 it is on either
    # side.
    from_light = np.where(receive > 0.0, 90.0 - azimuth, 90.0 + azimuth)
    from_light = np.where(receive == 0.0, 90.0 - np.abs(azimuth), from_light)
    near = np.abs(np.abs(receive) - incidence) <= SHADOW_RECEIVE_DEG + 1e-6
    return np.asarray(near & (from_light <= SHADOW_AZIMUTH_DEG + 1e-6))


def read_readings(path: Path) -> Readings:
    """Read the angles and values of a file, in the order of its sheets and columns.

    Raises
    ------
    BadInput
        If the file is damaged, no RT-300S export, or a cell is not a number; names sheet and column.
    """
    import xlrd
    from xlrd.compdoc import CompDocError

    size = path.stat().st_size if path.is_file() else 0
    if not 0 < size <= LARGEST_BYTES:
        raise BadInput(
            f"is missing, empty or too large ({size} bytes)", where=str(path), todo="check the path"
        )
    try:
        book = xlrd.open_workbook(str(path), logfile=io.StringIO())
        blocks = [_sheet(sheet, path) for sheet in book.sheets() if sheet.ncols > 1]
    except BadInput:
        raise
    except (*_DAMAGE, xlrd.XLRDError, CompDocError) as error:
        raise BadInput(
            f"is not a whole .xls file ({type(error).__name__})",
            where=str(path),
            todo="export or copy it again",
        ) from error
    if not blocks:
        raise BadInput("holds no readings", where=str(path), todo="export the measurement again")
    table = np.concatenate(blocks)
    return Readings(table[:, :3], table[:, 3])


def _sheet(sheet: Any, path: Path) -> Array:
    """Return a sheet's readings, shape (columns, 4)."""
    rows, columns = sheet.nrows, sheet.ncols
    cell = sheet.cell_value
    labels = {str(cell(row, 0)).strip(): row for row in range(min(rows, LABELS_WITHIN))}
    missing = [name for name in ROWS if name not in labels]
    where = f"{path}: sheet {sheet.name}"
    if missing:
        raise BadInput(f"has no row '{missing[0]}'", where=where, todo="is this an RT-300S raw export?")
    block = np.empty((columns - 1, len(ROWS)))
    for index, name in enumerate(ROWS):
        for column in range(1, columns):
            value = cell(labels[name], column)
            if not isinstance(value, float) or not np.isfinite(value):
                raise BadInput(
                    f"'{value}' is not a number",
                    where=f"{where}, row {name}, column {column + 1}",
                    todo="export again",
                )
            block[column - 1, index] = value
    if np.any(np.abs(block[:, [0, 2]]) >= 90.0):
        raise BadInput(
            "an incidence or receive angle is 90 deg or more", where=where, todo="remove the reading"
        )
    return block


def _at_the_same_angles(sample: Readings, blank: Readings, path: Path, blank_path: Path) -> Array:
    """Return the blank's readings at the sample's angles."""
    known = {
        tuple(angles): value for angles, value in zip(blank.angles_deg.tolist(), blank.value, strict=True)
    }
    wanted = [tuple(angles) for angles in sample.angles_deg.tolist()]
    missing = [angles for angles in wanted if angles not in known]
    if missing:
        incidence, azimuth, receive = missing[0]
        raise BadInput(
            f"lacks {len(missing)} of the {len(wanted)} angles of {path.name}, first incidence {incidence:g},"
            f" azimuth {azimuth:g}, receive {receive:g} deg",
            where=str(blank_path),
            todo="choose the blank that was taken on the same grid",
        )
    return np.array([known[angles] for angles in wanted])
