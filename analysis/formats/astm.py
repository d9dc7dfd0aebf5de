"""ASTM E1392 and E2387 scatter data as text: header lines `KEY value`, then a table separated by commas.

    NUM_POINTS 2
    VARS theta_i,phi_i,theta_s,phi_s,550nm
    0.5,0.0,0.6,3.14,0.25

Angles are radians, of directions away from the surface in the sample's frame; a table without `phi_i` has the
light at azimuth 0. Channels are `<wavelength>nm`, `R,G,B`, `X,Y,Z` or any name. Values are f_r without a
cosine. The format has no place for uncertainties and flags: both are lost.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from analysis.formats.loss import Loss, unchanged
from analysis.formats.tables import Layout, numbers_of_rows, rows_with_content
from analysis.formats.text import looks_like_text, number, read_lines, separator_of
from analysis.samples import make_samples
from rig.angles import direction_to_spherical, spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

NAME = "ASTM E1392/E2387"
SUFFIX = ".astm"
OPTIONS: tuple[str, ...] = ()
OPEN_END = True
ANGLES = ("theta_i", "phi_i", "theta_s", "phi_s")
REQUIRED = ("theta_i", "theta_s", "phi_s")
_VARS = re.compile(rb"^[ \t]*VARS[ \t]+[^\r\n]*theta_i", re.MULTILINE)
_ROW = re.compile(r"\s*[-+]?\d*[.,]?\d+(?:[eE][-+]?\d+)?\s*[,;\t]")
_WAVELENGTH = re.compile(r"\A(\d+(?:\.\d+)?) ?nm\Z")


def sniff(head: bytes) -> bool:
    """Whether a line names the variables of such a table."""
    return looks_like_text(head) and _VARS.search(head) is not None


def read(path: Path) -> xr.Dataset:
    """Read samples.

    Raises
    ------
    BadInput
        If a column is missing or double, the number of rows is not the one announced, or a cell is malformed
        or no angle in radians; names line and column.
    """
    lines = read_lines(path)
    start, vars_, announced = _header(lines, path)
    separator = separator_of(vars_)
    header = _columns(vars_, separator, f"{path}: line {start}")
    kept = rows_with_content(lines, start=start, comment="")
    layout = Layout(
        {len(header): header},
        separator,
        expected=f"VARS names {len(header)}",
        todo="complete the row, separate cells as VARS does, and write decimals with a point",
        decimal_comma=separator != ",",
        what="cells",
    )
    places = kept.places
    rows = numbers_of_rows(kept, layout, path)
    if not places or announced not in {None, len(places)}:
        raise BadInput(
            f"announces {announced or 'some'} points, {len(places)} follow",
            where=f"{path}: line {len(lines)}",
            todo="the file is cut short or the count is wrong: copy it again",
        )
    table = dict(zip(header, rows.table().T, strict=True))
    for name in ("theta_i", "theta_s"):
        wrong = np.flatnonzero((table[name] < 0.0) | (table[name] > np.pi))
        if wrong.size:
            raise BadInput(
                f"{table[name][wrong[0]]:g} is not a polar angle in radians",
                where=f"{path}: line {places[wrong[0]]}, column {name}",
                todo="this format holds radians, 0 to pi",
            )
    channels = [name for name in header if name not in ANGLES]
    matches = [_WAVELENGTH.match(name) for name in channels]
    return make_samples(
        spherical_to_direction(table["theta_i"], table.get("phi_i", np.zeros(len(places)))),
        spherical_to_direction(table["theta_s"], table["phi_s"]),
        np.stack([table[name] for name in channels], axis=1),
        channels=None if all(matches) else channels,
        wavelength_nm=[float(m.group(1)) for m in matches if m] if all(matches) else None,
        source=path.name,
    )


def _header(lines: list[str], path: Path) -> tuple[int, str, int | None]:
    """Return the index of the first row, what VARS says, and the announced number of rows."""
    announced: int | None = None
    for index, text in enumerate(lines):
        key, value = (*text.split(maxsplit=1), "", "")[:2]
        where = f"{path}: line {index + 1}"
        if key == "NUM_POINTS":
            stated = number(value.strip(), where=where)
            if announced is not None or stated != int(stated) or stated < 1.0:
                raise BadInput(
                    f"NUM_POINTS {value.strip()[:40]} is no count, or the second one",
                    where=where,
                    todo="state the number of rows once",
                )
            announced = int(stated)
        elif key == "VARS":
            return index + 1, value, announced
        elif _ROW.match(text):
            raise BadInput("a row stands before VARS", where=where, todo="put VARS before all rows")
    raise BadInput("has no line VARS", where=f"{path}: line {len(lines)}", todo="copy the file again")


def _columns(text: str, separator: str, where: str) -> list[str]:
    names = [name.strip() for name in text.split(separator)]
    double = sorted({name for name in names if names.count(name) > 1})
    missing = [name for name in REQUIRED if name not in names]
    last = max((place for place, name in enumerate(names) if name in ANGLES), default=0)
    early = [name for name in names[:last] if name not in ANGLES]
    if early and not missing:
        raise BadInput(
            f"names '{early[0][:40]}' between the angles",
            where=where,
            todo="is it an angle? Channels stand behind the angles",
        )
    if double or missing or "" in names or not set(names) - set(ANGLES):
        what = (
            f"names {double[0]} twice"
            if double
            else f"has no column {missing[0]}"
            if missing
            else "names no channel"
        )
        raise BadInput(what, where=where, todo=f"VARS {','.join(ANGLES)},<channel>,...")
    return names


def write(samples: xr.Dataset, path: Path) -> Loss:
    """Write angles and f_r; samples without a value or with a flag are left out."""
    values = samples["f_r"].to_numpy()
    usable = np.isfinite(values).all(axis=1) & (samples["flags"].to_numpy() == 0).all(axis=1)
    angles = [angle for name in ("wi", "wo") for angle in direction_to_spherical(samples[name].to_numpy())]
    names = [re.sub(r"[\s,]", "", str(name)) for name in samples["channel"].to_numpy()]
    table = np.stack([*angles, *values.T], axis=1)[usable]
    source = " ".join(str(samples.attrs.get("source", "")).split())
    lines = [f"SAMPLE_ID {source[:200]}", f"NUM_POINTS {len(table)}", f"VARS {','.join([*ANGLES, *names])}"]
    lines += [",".join(repr(float(cell)) for cell in row) for row in table]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return unchanged(samples, len(table), kept=("wavelength_nm",))
