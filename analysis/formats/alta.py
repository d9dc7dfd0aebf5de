"""ALTA's text files: a header of `#KEY value`, then rows of coordinates and values.

    #DIM 4 3
    #PARAM_IN  SPHERICAL_TL_PL_TV_PV
    #PARAM_OUT RGB_COLOR

What the coordinates are and whether the cosine of view is inside is part of the file; the cosine is divided
out.
Coordinates that do not determine both directions (`COS_TH`, `RUSIN_TH_TD`, ...) are refused, and so is the
four-angle half-vector form, whose azimuth ALTA's own code turns both ways. Confidence intervals (`#VS`) are
checked for but not kept: they are no standard uncertainties. Angles are radians.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.formats.tables import Layout, numbers_of_rows, rows_with_content
from analysis.formats.text import looks_like_text, number, read_lines
from analysis.samples import make_samples
from rig.angles import from_half_difference, spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]

NAME = "ALTA text"
OPTIONS: tuple[str, ...] = ()
OPEN_END = True
COORDINATES = {
    "CARTESIAN": 6,
    "SPHERICAL_TL_PL_TV_PV": 4,
    "ISOTROPIC_TV_TL_DPHI": 3,
    "ISOTROPIC_TL_TV_PROJ_DPHI": 3,
    "RUSIN_TH_TD_PD": 3,
}
VALUES = ("INV_STERADIAN", "INV_STERADIAN_COSINE_FACTOR", "RGB_COLOR", "XYZ_COLOR")
CHANNELS = {"RGB_COLOR": ("R", "G", "B"), "XYZ_COLOR": ("X", "Y", "Z")}
_DIM = re.compile(rb"^#DIM[ \t]+\d", re.MULTILINE)
KEYS = ("DIM", "PARAM_IN", "PARAM_OUT", "FORMAT", "VS")
HORIZON = 1e-6


def sniff(head: bytes) -> bool:
    """Whether the header states dimensions as ALTA does."""
    return head.lstrip(b"\xef\xbb\xbf").startswith(b"#") and looks_like_text(head) and bool(_DIM.search(head))


def read(path: Path) -> xr.Dataset:
    """Read samples; those with a direction at or below the horizon are dropped.

    Raises
    ------
    BadInput
        If the header is incomplete or asks for what is not read, or a row is malformed; names line and
        column.
    """
    lines = read_lines(path)
    header = _header(lines, path)
    coordinates, kind, count, extra = _layout(header, path)
    inputs = COORDINATES[coordinates]
    width = inputs + count + extra
    kept = rows_with_content(lines)
    if not kept.texts:
        raise BadInput("holds no samples", where=f"{path}: line {len(lines)}", todo="copy the file again")
    columns = [str(column) for column in range(1, width + 1)]
    layout = Layout({width: columns}, None, expected=f"the header announces {width}")
    table = numbers_of_rows(kept, layout, path).table()
    wi, wo = _directions(table[:, :inputs], coordinates, kept.places, path)
    values = table[:, inputs : inputs + count]
    above = (wi[:, 2] > HORIZON) & (wo[:, 2] > HORIZON)
    if kind == "INV_STERADIAN_COSINE_FACTOR":
        values = values / np.where(above, wo[:, 2], 1.0)[:, None]
    return make_samples(wi[above], wo[above], values[above], channels=CHANNELS.get(kind), source=path.name)


def _header(lines: list[str], path: Path) -> dict[str, tuple[str, int]]:
    """Return each key's value and line; what is stated twice in different words is refused."""
    entries: dict[str, tuple[str, int]] = {}
    for line, text in enumerate(lines, start=1):
        if not text.startswith("#"):
            continue
        key, value = (*text[1:].split(maxsplit=1), "", "")[:2]
        stated, earlier = entries.get(key, (value.strip(), line))
        if key in KEYS and stated != value.strip():
            raise BadInput(
                f"#{key} is not what line {earlier} says",
                where=f"{path}: line {line}",
                todo="remove one of them; two files in one are read one by one",
            )
        entries[key] = (value.strip(), line)
    return entries


def _layout(header: dict[str, tuple[str, int]], path: Path) -> tuple[str, str, int, int]:
    """Return the coordinates' name, the values' kind, the number of values and of further columns."""
    for key in ("DIM", "PARAM_IN", "PARAM_OUT"):
        if key not in header:
            raise BadInput(f"has no #{key}", where=f"{path}: line 1", todo="state it in the header")
    if header.get("FORMAT", ("text", 0))[0] != "text":
        raise BadInput(
            "is ALTA's binary form",
            where=f"{path}: line {header['FORMAT'][1]}",
            todo="convert it to text with ALTA",
        )
    coordinates, kind = header["PARAM_IN"][0], header["PARAM_OUT"][0]
    for key, value, known in (("PARAM_IN", coordinates, tuple(COORDINATES)), ("PARAM_OUT", kind, VALUES)):
        if value not in known:
            raise BadInput(
                f"{key} {value[:40]} is not read",
                where=f"{path}: line {header[key][1]}",
                todo=f"convert it to one of {', '.join(known)}",
            )
    where = f"{path}: line {header['DIM'][1]}"
    sizes = [number(word, where=where) for word in header["DIM"][0].split()]
    if len(sizes) != 2 or sizes[0] != COORDINATES[coordinates] or not 1 <= sizes[1] <= 100_000:
        raise BadInput(
            f"DIM {header['DIM'][0][:40]} does not agree with {coordinates}",
            where=where,
            todo=f"write DIM {COORDINATES[coordinates]} and the number of values",
        )
    if kind in CHANNELS and sizes[1] != 3:
        raise BadInput(f"{kind} has 3 values, not {sizes[1]:g}", where=where, todo="correct DIM")
    vertical, line = header.get("VS", ("0", 0))
    if vertical not in {"0", "1", "2"}:
        raise BadInput(
            f"VS {vertical[:20]} is not 0, 1 or 2", where=f"{path}: line {line}", todo="correct it"
        )
    return coordinates, kind, int(sizes[1]), int(vertical)


def _directions(x: Array, coordinates: str, places: Sequence[int], path: Path) -> tuple[Array, Array]:
    """Return wi and wo; ALTA packs the view before the light, except where a name says otherwise."""
    zero = np.zeros(len(x))
    if coordinates == "CARTESIAN":
        length = np.linalg.norm(x.reshape(-1, 2, 3), axis=-1)
        wrong = np.flatnonzero((np.abs(length - 1.0) > 1e-4).any(axis=1))
        if wrong.size:
            raise BadInput(
                "a direction is not of length 1",
                where=f"{path}: line {places[wrong[0]]}",
                todo="write unit vectors: view, then light",
            )
        return x[:, 3:] / length[:, 1:], x[:, :3] / length[:, :1]
    if coordinates == "SPHERICAL_TL_PL_TV_PV":
        return spherical_to_direction(x[:, 0], x[:, 1]), spherical_to_direction(x[:, 2], x[:, 3])
    if coordinates == "ISOTROPIC_TV_TL_DPHI":
        return spherical_to_direction(x[:, 1], x[:, 2]), spherical_to_direction(x[:, 0], zero)
    if coordinates == "ISOTROPIC_TL_TV_PROJ_DPHI":
        theta, phi = np.hypot(x[:, 1], x[:, 2]), np.arctan2(x[:, 2], x[:, 1])
        return spherical_to_direction(x[:, 0], zero), spherical_to_direction(theta, phi)
    view, light = from_half_difference(x[:, 0], zero, x[:, 1], x[:, 2])
    return light, view
