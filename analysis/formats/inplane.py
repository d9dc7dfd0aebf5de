"""Tables in the plane of incidence with named columns, each laboratory's with its own convention.

Separated by commas (or semicolons, tabs), polar angles with their unit in the header, the light on one side
of the normal and a positive view on the other: columns `theta_i_deg`, `theta_o_deg` (or `theta_i [rad]`),
optionally `material`, and either `f_r` (or `brdf [1/sr]`) or `radiance_L_o`, in any order. The latter is the
radiance of the mid-infrared instrument of Noori and others (JSSS 2025):

    f_r = L_o / (L_i cos(theta_i) Omega_i),  Omega_i = pi 5^2 / 315^2 sr,  L_i = 3463.986

They published f_r cos(theta_o), which breaks reciprocity: `as_published` gives those values.

Separated by blanks, with the columns named in a comment: `phi_i theta_i phi_o theta_o brdf` in any order,
where the file's comments say which of the two is the zenith; signed zenith angles, as in the chassis of a
satellite by Fankhauser and others (2023). Directions at or below the horizon are dropped: no BRDF is defined
there.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.angle_table import AngleTable
from analysis.formats.bands import gathered
from analysis.formats.tables import Layout, Rows, numbers_of_rows, rows_with_content
from analysis.formats.text import looks_like_text, read_lines, separator_of
from analysis.samples import make_samples
from rig.angles import spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

NAME = "in-plane table"
OPTIONS = ("material", "as_published")
OPEN_END = True
POLAR = ("theta_i_deg", "theta_o_deg")
VALUES = ("f_r", "radiance_L_o")
WAVELENGTH = "wavelength_nm"
TO_NM = {"nm": 1.0, "um": 1e3, "µm": 1e3, "μm": 1e3}
ANGLES = ("phi_i", "theta_i", "phi_o", "theta_o")
SOURCE_SOLID_ANGLE_SR = float(np.pi * 5.0**2 / 315.0**2)
SOURCE_RADIANCE = 3463.986
HORIZON = 1e-6
SLACK_DEG = 1e-9
"""What radians may be beyond a right angle by rounding."""

# Nothing here can take what its neighbour takes: blanks without end would be tried in all ways.
_NAME = re.compile(
    r"(?P<name>[^\[(]*)[\[(](?P<unit>deg|degrees|rad|radians|1/sr|sr-1|sr\^-1|nm|um|[µμ]m)[\])]\Z",
    re.IGNORECASE,
)
_ZENITH = re.compile(r"\((phi|theta)_[io], *(?:phi|theta)_[io]\) are the zenith and azimuth")
SPECTRAL = ("wavelength", "lambda")
_WAVELENGTH = re.compile(r"lambda *= *(\d+(?:\.\d+)?) *nm")


def sniff(head: bytes) -> bool:
    """Whether the columns' names are those of an in-plane table."""
    if not looks_like_text(head):
        return False
    lines = head.decode("utf-8-sig", errors="replace").splitlines()
    return _comma_header(lines) is not None or _blank_header(lines) is not None


def _comma_header(lines: list[str]) -> int | None:
    """Return the index of the line that names comma-separated columns."""
    for index, line in enumerate(lines):
        if line.strip() and not line.lstrip().startswith("#"):
            names = list(_columns(line))
            known = set(POLAR) <= set(names) and not set(names) - {*POLAR, *VALUES, WAVELENGTH, "material"}
            return index if known else None
    return None


def _columns(line: str) -> dict[str, float]:
    """Return the columns that a line names, as this module calls them, and what turns them to degrees.

    Units stand behind a name as laboratories write them: `theta_i_deg`, `theta_i [rad]`, `f_r (1/sr)`. A name
    that stands twice makes the line no header.
    """
    columns = {}
    cells = [cell.strip() for cell in line.split(separator_of(line))]
    for cell in cells:
        named = _NAME.match(cell)
        name, unit = (named["name"].strip(), named["unit"].lower()) if named else (cell, "")
        stem = name.removesuffix("_deg").removesuffix("_rad")
        spectral, _, tail = name.lower().partition("_")
        if f"{stem}_deg" in POLAR and (unit or stem != name):
            radians = unit.startswith("rad") or name.endswith("_rad")
            columns[f"{stem}_deg"] = float(np.degrees(1.0)) if radians else 1.0
        elif spectral in SPECTRAL and (unit or tail) in TO_NM:
            columns[WAVELENGTH] = TO_NM[unit or tail]
        else:
            columns["f_r" if name.lower() in {"f_r", "brdf"} else name] = 1.0
    return columns if len(columns) == len(cells) else {}


def _blank_header(lines: list[str]) -> int | None:
    """Return the index of the comment that names blank-separated columns."""
    for index, line in enumerate(lines):
        if line.strip() and not line.startswith("#"):
            return None
        if sorted(line[1:].split()) == sorted([*ANGLES, "brdf"]):
            return index
    return None


def read(path: Path, *, material: str | None = None, as_published: bool = False) -> xr.Dataset:
    """Read samples.

    Parameters
    ----------
    path : Path
        The table.
    material : str, optional
        Which of several materials; needed where there are several.
    as_published : bool
        Leave the factor cos(theta_o) of the published formula inside (radiance tables only).

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    BadInput
        If a row has the wrong length, a cell is no finite number, an angle is none of its kind, or the
        material is not there; names line and column.
    """
    lines = read_lines(path)
    header = _comma_header(lines)
    if header is not None:
        return _read_commas(lines, header, path, material, as_published=as_published)
    if material is not None or as_published:
        raise BadInput(
            "names no materials and no published formula", where=str(path), todo="leave the option out"
        )
    return _read_blanks(lines, path)


def _read_commas(
    lines: list[str], header: int, path: Path, material: str | None, *, as_published: bool
) -> xr.Dataset:
    separator, columns = separator_of(lines[header]), _columns(lines[header])
    names = list(columns)
    values = [name for name in VALUES if name in names]
    if len(values) != 1:
        raise BadInput(
            "needs exactly one column f_r or radiance_L_o",
            where=f"{path}: line {header + 1}",
            todo="name the columns",
        )
    if as_published and values != ["radiance_L_o"]:
        raise BadInput("holds no radiance", where=str(path), todo="leave --as-published out")
    layout = Layout(
        {len(names): names},
        separator,
        expected=f"the header {len(names)}",
        todo="complete the row and write decimals with a point",
        decimal_comma=separator != ",",
        what="cells",
        label=names.index("material") if "material" in names else None,
    )
    rows = numbers_of_rows(rows_with_content(lines, start=header + 1), layout, path)
    chosen = _choose(rows, material, path)
    table = dict(zip((n for n in names if n != "material"), rows.table()[chosen].T, strict=True))
    places = rows.places[chosen]
    table = {name: column * columns[name] for name, column in table.items()}
    for name in POLAR:
        _check_polar(table[name], places, path, name)
    bands = (
        None
        if WAVELENGTH not in table
        else gathered(
            np.stack([table[name] for name in POLAR], axis=1),
            table[WAVELENGTH],
            table[values[0]],
            (places, path),
        )
    )
    if bands is not None:
        table |= dict(zip(POLAR, bands.keys.T, strict=True))
    value = table[values[0]][:, None] if bands is None else bands.values
    theta_i, theta_o = (np.radians(table[name]) for name in POLAR)
    above = (np.cos(theta_i) > HORIZON) & (np.cos(theta_o) > HORIZON)
    theta_i, theta_o, value = theta_i[above], theta_o[above], value[above]
    if values == ["radiance_L_o"]:
        value = value / (SOURCE_RADIANCE * np.cos(theta_i) * SOURCE_SOLID_ANGLE_SR)[:, None]
    samples = make_samples(
        spherical_to_direction(theta_i, np.pi),
        spherical_to_direction(theta_o, 0.0),
        value * np.cos(theta_o)[:, None] if as_published else value,
        channels=[values[0]] if bands is None else None,
        wavelength_nm=None if bands is None else bands.wavelength_nm,
        source_solid_angle_sr=SOURCE_SOLID_ANGLE_SR if values == ["radiance_L_o"] else np.nan,
        source=f"{path.name} {rows.labels[chosen[0]] if rows.labels else ''}".strip(),
    )
    if as_published:
        samples.attrs["cosine"] = "cos(theta_o) left inside, as published"
    return samples


def _choose(rows: Rows, material: str | None, path: Path) -> Indices:
    """Return the rows of the material that is asked for, or of the only one."""
    labels = rows.labels or [""] * len(rows.widths)
    known = list(dict.fromkeys(labels))
    if not known:
        raise BadInput("has a header but no rows", where=str(path), todo="add samples")
    wanted = known[0] if material is None and len(known) == 1 else material
    if wanted not in known:
        what = f"holds no '{material}'" if material else f"holds {len(known)} materials"
        raise BadInput(what, where=str(path), todo=f"choose with --material one of {', '.join(known)}")
    return np.flatnonzero(np.array(labels) == wanted)


def _check_polar(angles_deg: Array, places: Sequence[int] | Indices, path: Path, column: str) -> None:
    wrong = np.flatnonzero(np.abs(angles_deg) > 90.0 + SLACK_DEG)
    if wrong.size:
        raise BadInput(
            f"{angles_deg[wrong[0]]:g} is no polar angle in degrees",
            where=f"{path}: line {places[wrong[0]]}, column {column}",
            todo="zenith angles lie in -90 to 90; perhaps zenith and azimuth are exchanged",
        )


def declared(path: Path) -> AngleTable | None:
    """Return the columns of a table separated by blanks as they are, for the convention doctor; else None.

    Raises
    ------
    BadInput
        If a row has the wrong length or a cell is no finite number.
    """
    lines = read_lines(path)
    if _blank_header(lines) is None:
        return None
    table, facts = _blank_columns(lines, path, check=False)
    theta_i, phi_i, theta_o, phi_o, value = table
    return AngleTable(theta_i, phi_i, theta_o, phi_o, value[:, None], facts)


def _read_blanks(lines: list[str], path: Path) -> xr.Dataset:
    (theta_i, phi_i, theta_o, phi_o, value), facts = _blank_columns(lines, path, check=True)
    wi, wo = spherical_to_direction(theta_i, phi_i), spherical_to_direction(theta_o, phi_o)
    above = (wi[:, 2] > HORIZON) & (wo[:, 2] > HORIZON)
    return make_samples(wi[above], wo[above], value[above], **facts)


def _blank_columns(lines: list[str], path: Path, *, check: bool) -> tuple[Array, dict[str, Any]]:
    """Return polar angle and azimuth of the light, of the view, radians, the values (5, N), and the rest."""
    header = _blank_header(lines) or 0
    names = lines[header][1:].split()
    comments = "\n".join(line for line in lines if line.startswith("#"))
    stated = _ZENITH.search(comments)
    if stated is None and "zenith" in comments.lower():
        raise BadInput(
            "its comments speak of a zenith, but not as gonio understands it",
            where=f"{path}: line {header + 1}",
            todo="write # (theta_i, phi_i) are the zenith and azimuth angles, or the other way round",
        )
    zenith = stated.group(1) if stated else "theta"
    kept = rows_with_content(lines)
    if not kept.texts:
        raise BadInput("has a header but no rows", where=f"{path}: line {header + 1}", todo="add samples")
    layout = Layout({len(names): names}, None, expected=f"not {len(names)}")
    table = dict(zip(names, numbers_of_rows(kept, layout, path).table().T, strict=True))
    for name in (f"{zenith}_i", f"{zenith}_o") if check else ():
        _check_polar(table[name], kept.places, path, name)
    azimuth = "theta" if zenith == "phi" else "phi"
    angles = (f"{zenith}_i", f"{azimuth}_i", f"{zenith}_o", f"{azimuth}_o")
    wavelength = _WAVELENGTH.search(comments)
    facts: dict[str, Any] = {"source": path.name}
    if wavelength:
        facts["wavelength_nm"] = [float(wavelength.group(1))]
    else:
        facts["channels"] = ["brdf"]
    return np.stack([*(np.radians(table[name]) for name in angles), table["brdf"]]), facts
