"""A table for people: named columns, angles in degrees, one row a sample.

Required columns: `theta_i_deg`, `phi_i_deg`, `theta_o_deg`, `phi_o_deg` and the BRDF, either `f_r` or one
`f_r_NAME` a channel; optional `u_f_r` or `u_f_r_NAME`. A NAME like `550nm` is a wavelength. Lines that start
with `#` are comments; the first may say `# 48 samples`, which must hold then. A spreadsheet's semicolons or
tabs between cells are read too, with commas in numbers. Correlated uncertainty columns do not fit in a table:
NetCDF keeps them.
"""

from __future__ import annotations

import csv
import re
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.angle_table import AngleTable
from analysis.formats.loss import Loss, unchanged
from analysis.formats.tables import Layout, Lines, cells_of, numbers_of_rows, rows_with_content
from analysis.formats.text import looks_like_text, read_lines, separator_of
from analysis.samples import make_samples
from rig.angles import direction_to_spherical
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]

NAME = "gonio CSV"
SUFFIX = ".csv"
OPTIONS: tuple[str, ...] = ()
OPEN_END = True
ANGLES = ("theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg")
_WAVELENGTH = re.compile(r"\A(\d+(?:\.\d+)?) ?nm\Z")
_COUNT = re.compile(r"\A# ?(\d{1,12}) samples\Z")
LARGEST_POLAR_DEG = 180.0


def sniff(head: bytes) -> bool:
    """Whether the first line that is not a comment names the columns."""
    if not looks_like_text(head):
        return False
    for line in head.decode("utf-8-sig", errors="replace").splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            return ANGLES[0] in line and ANGLES[1] in line  # in the plane there are no azimuths
    return False


def read(path: Path) -> xr.Dataset:
    """Read samples.

    Raises
    ------
    BadInput
        If a column is missing, unknown or double, a row has the wrong length, or a cell is no finite number;
        names line and column.
    """
    table = declared(path)
    try:
        return make_samples(table.wi, table.wo, table.f_r, **table.facts)
    except BadInput as error:
        raise BadInput(str(error), where=str(path)) from None


def declared(path: Path) -> AngleTable:
    """Return the columns as they are, whatever the angles, for the convention doctor; raises as `read`."""
    content = read_lines(path)
    kept = rows_with_content(content)
    header_text, header_line = kept.texts[0], kept.places[0]
    texts, places = kept.texts[1:], kept.places[1:]
    separator = separator_of(header_text)
    header = [cell.strip() for cell in cells_of(separator, path)(header_text, header_line)]
    values, uncertainties = _columns(header, where=f"{path}: line {header_line}")
    layout = Layout(
        {len(header): header},
        separator,
        expected=f"the header {len(header)}",
        todo="complete the row, separate cells by commas and write decimals with a point",
        decimal_comma=separator != ",",
        what="cells",
    )
    rows = numbers_of_rows(Lines(texts, places), layout, path)
    if not texts:
        raise BadInput("has a header but no rows", where=str(path), todo="add samples")
    _check_count(content[0], len(texts), f"{path}: line 1")
    table = dict(zip(header, rows.table().T, strict=True))
    _check_polar(table, places, path)
    theta_i, phi_i, theta_o, phi_o = (np.radians(table[name]) for name in ANGLES)
    names = [name.removeprefix("f_r").removeprefix("_") for name in values]
    matches = [_WAVELENGTH.match(name) for name in names]
    facts: dict[str, Any] = {"source": path.name}
    if names != [""]:
        facts["channels"] = names
    if all(matches):
        facts["wavelength_nm"] = [float(m.group(1)) for m in matches if m]
    if uncertainties:
        facts["u_f_r"] = np.stack([table[name] for name in uncertainties], axis=1)
    f_r = np.stack([table[name] for name in values], axis=1)
    return AngleTable(theta_i, phi_i, theta_o, phi_o, f_r, facts)


def write(samples: xr.Dataset, path: Path) -> Loss:
    """Write angles, f_r and u_f_r; samples without a value or with a flag are left out."""
    names = [str(name).replace(" ", "") for name in samples["channel"].to_numpy()]
    suffixes = [""] if len(names) == 1 and "wavelength_nm" not in samples.coords else [f"_{n}" for n in names]
    header = [*ANGLES, *(f"f_r{s}" for s in suffixes)]
    angles = [angle for name in ("wi", "wo") for angle in direction_to_spherical(samples[name].to_numpy())]
    columns = [*np.degrees(np.stack(angles)), *samples["f_r"].to_numpy().T]
    if "u_f_r" in samples:
        header += [f"u_f_r{s}" for s in suffixes]
        columns += [*samples["u_f_r"].to_numpy().T]
    usable = np.isfinite(np.stack(columns)).all(axis=0) & (samples["flags"].to_numpy() == 0).all(axis=1)
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(f"# {np.count_nonzero(usable)} samples\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([repr(float(cell)) for cell in row] for row in np.stack(columns, axis=1)[usable])
    return unchanged(samples, int(np.count_nonzero(usable)), kept=("u_f_r", "wavelength_nm"))


def _check_polar(table: Mapping[str, Array], places: Sequence[int], path: Path) -> None:
    for name in ("theta_i_deg", "theta_o_deg"):
        wrong = np.flatnonzero(np.abs(table[name]) > LARGEST_POLAR_DEG)
        if wrong.size:
            raise BadInput(
                f"{table[name][wrong[0]]:g} is no polar angle in degrees",
                where=f"{path}: line {places[wrong[0]]}, column {name}",
                todo="polar angles are counted from the normal; perhaps columns are exchanged",
            )


def _check_count(first: str, count: int, where: str) -> None:
    announced = _COUNT.match(first.strip().strip(";,\t"))
    if announced and int(announced[1]) != count:
        raise BadInput(
            f"announces {announced[1]} samples, {count} follow",
            where=where,
            todo="the file was cut short: copy it again; if you changed its rows, remove the line",
        )


def _columns(header: list[str], *, where: str) -> tuple[list[str], list[str]]:
    """Return the names of the value columns, and of the uncertainty columns in the same order."""
    double = sorted({name for name in header if header.count(name) > 1})
    if double:
        raise BadInput(f"column {double[0]} appears twice", where=where, todo="name each column once")
    missing = [name for name in ANGLES if name not in header]
    if missing:
        raise BadInput(
            f"has no column {missing[0]}", where=where, todo=f"name the columns {', '.join(ANGLES)}, f_r"
        )
    values = [name for name in header if name == "f_r" or name.startswith("f_r_")]
    uncertainties = [name for name in header if name == "u_f_r" or name.startswith("u_f_r_")]
    unknown = [name for name in header if name not in {*ANGLES, *values, *uncertainties}]
    if unknown:
        raise BadInput(
            f"unknown column '{unknown[0]}'", where=where, todo=f"known: {', '.join(ANGLES)}, f_r, u_f_r"
        )
    if not values:
        raise BadInput(
            "has no column f_r", where=where, todo="name the BRDF f_r, or f_r_NAME for each channel"
        )
    if uncertainties and sorted(uncertainties) != sorted(f"u_{name}" for name in values):
        raise BadInput(
            "needs a column u_f_r for each f_r or for none", where=where, todo="complete the uncertainties"
        )
    return values, [f"u_{name}" for name in values] if uncertainties else []
