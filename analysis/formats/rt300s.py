"""Raw exports of the RT-300S gonioreflectometer: an `.xls` of several sheets, one column a reading.

Column A names the rows. Of each further column, `Incidence` is the light's polar angle, `Azimuth` the laser's
azimuth, `Receive` the signed angle of the detector in its fixed plane, all in degrees, and `RT` the reading,
a reflectance relative to the perfect diffuser times the cosine of view: f_r = (RT - RT_blank) / (pi
cos(theta_r)).

Directions: +x of the sample frame is the detector's side of positive angles; the mirror direction lies at
azimuth -90 and receive > 0. In which sense the laser's azimuth runs is not in the file and does not matter to
an isotropic sample: it is taken as counter-clockwise.
"""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.formats.doubts import ATTRIBUTE
from analysis.samples import UNITS
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr

    from analysis.recipes.readings import Readings

Array = NDArray[np.float64]

NAME = "RT-300S .xls"
OPTIONS = ("blank", "floor_shift")
MAGIC = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
ROWS = ("Incidence", "Azimuth", "Receive", "RT")
LARGEST_BYTES = 128 * 1024**2
LABELS_WITHIN = 64
SHIFTED = "the smallest reading was shifted to 0: all dark values are too high"
RECIPE = "rt300s"
"""The chain that readings go through, but for the average of files."""
# What xlrd raises for files that are cut or changed; its own classes are added when it is imported.
_DAMAGE = (
    struct.error, LookupError, ValueError, AssertionError, OSError, TypeError, AttributeError,
    NotImplementedError, MemoryError, OverflowError, RecursionError,
)  # fmt: skip


class Export(NamedTuple):
    """One file's readings: angles in degrees, shape (N, 3) in the order of `ROWS`, and RT, shape (N,)."""

    angles_deg: Array
    value: Array


def sniff(head: bytes) -> bool:
    """Whether the file is a compound document, which `.xls` is."""
    return head.startswith(MAGIC)


def read(path: Path, *, blank: str | Path | None = None, floor_shift: bool = False) -> xr.Dataset:
    """Read one channel of samples, each reading by itself.

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
        Readings shadowed by the detector's arm, and those along the surface, have a flag. `u_repeatability`
        is the blank's noise and at least what the recipe `rt300s` states of one file: errors of mount and
        alignment, which neighbours share, so that it is no weight for a fit. Several files of one sample
        are compared by `analysis.recipes`.

    Raises
    ------
    BadInput
        If a file is damaged or no such export, or the blank lacks an angle.
    """
    source = path.name if blank is None else f"{path.name} less {Path(blank).name}"
    empty = None if blank is None else as_readings(Path(blank))
    samples = reduced(as_readings(path), source, blank=empty, floor_shift=floor_shift)
    return samples.assign_attrs({ATTRIBUTE: SHIFTED}) if floor_shift else samples


def reduced(
    readings: Readings, source: str, *, blank: Readings | None = None, floor_shift: bool = False
) -> xr.Dataset:
    """Bring readings to samples by the recipe that ships, each reading by itself; see `read`."""
    from analysis.recipes.readings import to_samples
    from analysis.recipes.recipe import load
    from analysis.recipes.steps import FloorShift, Given

    left_out = {"average"} | ({"blank"} if blank is None else set())
    steps = [step for step in load(RECIPE).step if step.name not in left_out]
    if floor_shift:
        steps.insert(0 if blank is None else 1, FloorShift(name="floor_shift"))
    for step in steps:
        readings = step.apply(readings, Given(blank=blank))
    samples = to_samples(readings, source=source)
    stated = samples["u_f_r"].assign_attrs(units=UNITS["u_repeatability"])
    columns = [name for name in samples.data_vars if str(name).startswith("u_")]
    return samples.drop_vars(columns).assign(u_repeatability=stated)


def as_readings(path: Path) -> Readings:
    """Read a file for a recipe: nominal angles of light and detector, and RT.

    Raises
    ------
    BadInput
        As `read_readings`.
    """
    return readings_of(read_readings(path), path.name)


def readings_of(export: Export, name: str) -> Readings:
    """Bring the instrument's angles to those of light and detector."""
    from analysis.recipes.readings import make_readings

    incidence, azimuth, receive = np.radians(export.angles_deg).T
    angles = (
        np.abs(incidence),
        azimuth - np.pi / 2 + np.where(incidence < 0.0, np.pi, 0.0),
        np.abs(receive),
        np.where(receive < 0.0, np.pi, 0.0),
    )
    return make_readings(angles, export.value[:, None], channels=["RT"], name=name)


def read_readings(path: Path) -> Export:
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
    return Export(table[:, :3], table[:, 3])


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
    if np.any(np.abs(block[:, [0, 2]]) > 180.0):
        raise BadInput("an incidence or receive angle is beyond 180 deg", where=where, todo="export again")
    return block
