"""FRED's tabulated scatter: text, one block of rows for each incidence.

    type bsdf_data
    format angles=deg bsdf=value scale=1
    10	0                   theta_i phi_i
    0	0	0.031984            theta_s phi_s f
    5	0	0.034271

Azimuths of light and scatter are such that phi_s = phi_i is the mirror direction's side: the light itself
stands at phi_i + 180. At theta_s = 0 one row is enough, whatever phi_s. Values are f_r, without a cosine.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.formats.doubts import ATTRIBUTE
from analysis.formats.loss import Loss, unchanged
from analysis.formats.tables import Layout, Rows, numbers_of_rows, require_once, rows_with_content
from analysis.formats.text import looks_like_text, number, read_lines
from analysis.samples import make_samples
from rig.angles import direction_to_spherical, spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]

NAME = "FRED text"
SUFFIX = ".fred.txt"
OPTIONS: tuple[str, ...] = ()
OPEN_END = True
DECIMALS = 9
COLUMNS = ("theta_s", "phi_s", "f")
INCIDENCE = ("theta_i", "phi_i")
_START = re.compile(rb"\A(?:\xef\xbb\xbf)?type[ \t]+bsdf_data\b", re.IGNORECASE)


def sniff(head: bytes) -> bool:
    """Whether the file says that it is FRED's."""
    return looks_like_text(head) and _START.match(head) is not None


def read(path: Path) -> xr.Dataset:
    """Read samples of reflection.

    Raises
    ------
    BadInput
        If the header asks for what is not read, or a row is malformed; names line and column.
    """
    lines = read_lines(path)
    to_radians, scale = _header(lines[1] if len(lines) > 1 else "", f"{path}: line 2")
    layout = Layout(
        {len(names): names for names in (INCIDENCE, COLUMNS)},
        None,
        expected="not 2 (incidence) or 3 (scatter)",
        todo="correct or remove the line",
    )
    rows = numbers_of_rows(rows_with_content(lines, start=2, comment=""), layout, path)
    _check_polar(rows, to_radians, path)
    if not (rows.widths == len(COLUMNS)).any():
        raise BadInput("holds no samples", where=f"{path}: line {len(lines)}", todo="copy the file again")
    table = _scatter(rows, path)
    theta_i, phi_i, theta_s, phi_s, value = table.T
    samples = make_samples(
        spherical_to_direction(theta_i * to_radians, phi_i * to_radians + np.pi),
        spherical_to_direction(theta_s * to_radians, phi_s * to_radians),
        value * scale,
        channels=["BRDF"],
        source=path.name,
    )
    doubt = _out_of_order(rows, table)
    return samples.assign_attrs({ATTRIBUTE: doubt}) if doubt else samples


def _check_polar(rows: Rows, to_radians: float, path: Path) -> None:
    polar = rows.numbers[rows.starts()]
    wrong = np.flatnonzero(~((polar >= 0.0) & (polar * to_radians <= np.pi / 2 + 1e-9)))
    if wrong.size:
        column = (INCIDENCE if rows.widths[wrong[0]] == len(INCIDENCE) else COLUMNS)[0]
        raise BadInput(
            f"{polar[wrong[0]]:g} is no polar angle of reflection",
            where=f"{path}: line {rows.places[wrong[0]]}, column {column}",
            todo="only the half space of reflection, 0 to 90 deg, is read",
        )


def _scatter(rows: Rows, path: Path) -> Array:
    """Return a row (theta_i, phi_i, theta_s, phi_s, f) for each row of scatter."""
    start, scatter = rows.starts(), rows.widths == len(COLUMNS)
    if scatter[0]:
        raise BadInput(
            "scatter without an incidence before it",
            where=f"{path}: line {rows.places[0]}",
            todo="write theta_i and phi_i on a line of their own first",
        )
    latest = np.maximum.accumulate(np.where(scatter, 0, np.arange(len(scatter))))
    incidence = rows.numbers[start[latest[scatter]][:, None] + np.arange(len(INCIDENCE))]
    table = np.hstack([incidence, rows.numbers[start[scatter][:, None] + np.arange(len(COLUMNS))]])
    _check_blocks(rows, table, path)
    require_once(table[:, :-1], rows.places[scatter], path)
    return table


def _out_of_order(rows: Rows, table: Array) -> str:
    """Say where directions begin anew without an incidence, or run on across one; elsewhere they ascend."""
    scatter = rows.widths == len(COLUMNS)
    place, block = rows.places[scatter], np.cumsum(~scatter)[scatter]
    same = np.diff(block) == 0
    for slow, fast in ((2, 3), (3, 2)):
        step, within = np.diff(table[:, slow]), np.diff(table[:, fast])
        ascends = (step > 0.0) | ((step == 0.0) & (within > 0.0))
        anew, on = np.flatnonzero(same & ~ascends), np.flatnonzero(~same & ascends)
        if len(anew) == 1 and block[-1] > 1:
            return f"directions begin anew at line {place[anew[0] + 1]} without an incidence"
        if same.any() and not len(anew) and len(on) == 1:
            return f"the incidence before line {place[on[0] + 1]} does not begin its directions anew"
    return ""


def _check_blocks(rows: Rows, table: Array, path: Path) -> None:
    """Refuse what a row of scatter that lost a number looks like: an incidence where there is none."""
    begins = np.flatnonzero(rows.widths == len(INCIDENCE))
    counts = np.diff([*begins, len(rows.widths)]) - 1
    wrong = begins[counts == 0]
    if not wrong.size:
        first = np.concatenate([[0], np.cumsum(counts)])
        full = int(counts.argmax())
        model = table[first[full] : first[full + 1], 2:4]
        for block in np.flatnonzero(counts[:-1] + counts[1:] + 1 == counts[full]):
            before, after = (table[first[b] : first[b + 1], 2:4] for b in (block, block + 1))
            if np.array_equal(before, model[: len(before)]) and np.array_equal(after, model[-len(after) :]):
                wrong = begins[[block + 1]]
                break
    if wrong.size:
        raise BadInput(
            "two numbers where an incidence does not begin",
            where=f"{path}: line {rows.places[wrong[0]]}",
            todo="complete the row, or remove the incidence that has no rows",
        )


def write(samples: xr.Dataset, path: Path) -> Loss:
    """Write one channel's samples as they are; those without a value or with a flag are left out.

    Raises
    ------
    BadInput
        If there is more than one channel, or no sample to write.
    """
    if samples.sizes["channel"] != 1:
        raise BadInput(
            f"FRED holds one channel, here are {samples.sizes['channel']}",
            where="samples",
            todo="choose one, by its wavelength or its name",
        )
    value = samples["f_r"].to_numpy()[:, 0]
    usable = np.isfinite(value) & (samples["flags"].to_numpy()[:, 0] == 0)
    if not usable.any():
        raise BadInput("none can be written", where="samples", todo="check the flags")
    theta_i, phi_i = direction_to_spherical(samples["wi"].to_numpy()[usable])
    theta_s, phi_s = direction_to_spherical(samples["wo"].to_numpy()[usable])
    table = np.stack(
        [
            np.round(np.degrees(theta_i), DECIMALS),
            _turn_deg(phi_i + np.pi),
            np.round(np.degrees(theta_s), DECIMALS),
            np.where(theta_s == 0.0, 0.0, _turn_deg(phi_s)),
            value[usable],
        ],
        axis=-1,
    )
    lines = ["type bsdf_data", "format angles=deg bsdf=value scale=1"]
    incidence: tuple[float, ...] = ()
    for row in table[np.lexsort(table[:, 3::-1].T)].tolist():
        if tuple(row[:2]) != incidence:
            incidence = tuple(row[:2])
            lines.append("\t".join(f"{angle:.12g}" for angle in incidence))
        lines.append("\t".join([f"{row[2]:.12g}", f"{row[3]:.12g}", repr(row[4])]))
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return unchanged(samples, len(table))


def _turn_deg(angle: Array) -> Array:
    """Bring azimuths into [0, 360) degrees."""
    return np.mod(np.round(np.degrees(angle), DECIMALS), 360.0)


def _header(text: str, where: str) -> tuple[float, float]:
    """Return the angles' unit in radians and the scale of the values."""
    words = text.split()
    entries = {name: value for name, _, value in (word.partition("=") for word in words[1:])}
    known = {"angles", "bsdf"} <= entries.keys() <= {"angles", "bsdf", "scale"}
    if not known or words[0].lower() != "format" or len(entries) < len(words) - 1:
        raise BadInput(
            "is not the line that states the format", where=where, todo="format angles=deg bsdf=value scale=1"
        )
    units = {"deg": float(np.pi / 180.0), "rad": 1.0}
    if entries["angles"] not in units or entries["bsdf"] != "value":
        raise BadInput(
            f"angles={entries['angles'][:20]} bsdf={entries['bsdf'][:20]} is not read",
            where=where,
            todo="export angles=deg bsdf=value",
        )
    scale = number(entries.get("scale", "1"), where=f"{where}, scale")
    if scale <= 0.0:
        raise BadInput(f"a scale of {scale:g}", where=where, todo="write a positive scale")
    return units[entries["angles"]], scale
