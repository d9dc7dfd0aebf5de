"""XML of Berkeley Lab's WINDOW with a matrix of patches, such as the 145 of the Klems basis: read only.

A value is the average over a patch of incidence and one of exit, without cosine; it is given to the middle of
both, so no lobe narrower than a patch (about 10 deg) is in the file. A row of the matrix is a direction of
exit, a column one of incidence. Azimuths of incidence run half a turn ahead: a mirror sends a patch to the
patch of the same number. Of the two sides, the front is read unless it holds nothing but zeros; seen from the
front its azimuths run the other way.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree as ET
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from analysis.formats.tables import bulk
from analysis.formats.text import LARGEST_TEXT_BYTES, number
from analysis.samples import make_samples
from rig.angles import mirror, spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]

NAME = "WINDOW XML"
OPTIONS = ("side",)
MOST_ELEMENTS = 20_000
MOST_PATCHES = 2_000
SIDES = {"front": "Reflection Front", "back": "Reflection Back"}

_ROOT = re.compile(rb"<(?:\w+:)?WindowElement[\s>]")


class _Matrix(NamedTuple):
    """One wavelength band of one side."""

    band: str
    side: str
    incident: Array
    exitant: Array
    values: Array


def sniff(head: bytes) -> bool:
    """Whether an element of WINDOW opens near the start."""
    return _ROOT.search(head) is not None


def read(path: Path, *, side: str | None = None) -> xr.Dataset:
    """Read a side's reflection, a channel for each band of wavelengths.

    Parameters
    ----------
    path : Path
        The file.
    side : str, optional
        `front` or `back`; without it the front, or the back where the front holds only zeros.

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    BadInput
        If the file is no whole XML, defines entities, holds a tensor tree or no reflection, or a matrix does
        not have the size of its bases.
    """
    root = _parse(path)
    structure = _text(root, "IncidentDataStructure")
    if structure.lower() != "columns":
        raise BadInput(
            f"holds '{structure}', gonio reads Columns",
            where=f"{path}: IncidentDataStructure",
            todo="convert it with Radiance's bsdf2klems",
        )
    bases = _bases(root, path)
    matrices = [
        _matrix(block, _text(data, "Wavelength"), bases, path)
        for data in root.iter("WavelengthData")
        for block in data.iter("WavelengthDataBlock")
        if _text(block, "WavelengthDataDirection") in SIDES.values()
    ]
    wanted = _choose(matrices, side, path)
    first = wanted[0]
    same = all(
        np.array_equal(m.incident, first.incident) and np.array_equal(m.exitant, first.exitant)
        for m in wanted
    )
    bands = [matrix.band for matrix in wanted]
    if not same or len(set(bands)) < len(bands):
        raise BadInput("its bands have different directions, or one stands twice", where=str(path))
    turn = np.array([-1.0, 1.0, 1.0]) if first.side == SIDES["front"] else np.ones(3)
    wo = np.repeat(first.exitant * turn, len(first.incident), axis=0)
    wi = np.tile(mirror(first.incident) * turn, (len(first.exitant), 1))
    return make_samples(
        wi,
        wo,
        np.stack([matrix.values for matrix in wanted], axis=-1),
        channels=bands,
        source=f"{path.name}, {first.side}",
    )


def _parse(path: Path) -> ET.Element:
    """Parse what has no document type: without one there are no entities to expand or to fetch."""
    size = path.stat().st_size
    if size > LARGEST_TEXT_BYTES:
        raise BadInput(f"is {size / 1024**2:.0f} MB of XML, more than gonio reads", where=str(path))
    content = path.read_bytes()
    parser = expat.ParserCreate()
    elements = 0

    def refuse(*_: object) -> None:
        raise BadInput(
            "declares a document type",
            where=f"{path}: line {parser.CurrentLineNumber}",
            todo="remove the line: files of WINDOW have none",
        )

    def count(*_: object) -> None:
        nonlocal elements
        elements += 1
        if elements > MOST_ELEMENTS:
            raise BadInput(
                f"has more than {MOST_ELEMENTS} elements", where=f"{path}: line {parser.CurrentLineNumber}"
            )

    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler = count
    try:
        parser.Parse(content, True)
        root = ET.fromstring(content)  # noqa: S314 - checked above: no document type, no entities
    except (expat.ExpatError, ET.ParseError, ValueError, LookupError) as error:
        raise BadInput(
            f"is not whole XML ({error})", where=str(path), todo="copy it again from where it was made"
        ) from None
    for element in root.iter():
        element.tag = element.tag.rsplit("}", 1)[-1]
    return root


def _text(element: ET.Element, name: str) -> str:
    found = next(element.iter(name), None)
    return "" if found is None else (found.text or "").strip()


def _bases(root: ET.Element, path: Path) -> dict[str, Array]:
    """Directions (patches, 3) of the middles of each basis' patches."""
    bases = {}
    for basis in root.iter("AngleBasis"):
        name = _text(basis, "AngleBasisName")
        where = f"{path}: AngleBasis {name}"
        theta_deg: list[float] = []
        phi_deg: list[float] = []
        for block in basis.iter("AngleBasisBlock"):
            theta = number(_text(block, "Theta"), where=f"{where}, Theta")
            count = number(_text(block, "nPhis"), where=f"{where}, nPhis")
            if not (0.0 <= theta < 90.0 and 1 <= count <= MOST_PATCHES and count == int(count)):
                raise BadInput(f"has {count:g} patches at {theta:g} deg", where=where, todo="copy it again")
            theta_deg += [theta] * int(count)
            phi_deg += [360.0 * i / count for i in range(int(count))]
        if not 0 < len(theta_deg) <= MOST_PATCHES:
            raise BadInput(f"has {len(theta_deg)} patches", where=where, todo="copy the file again")
        bases[name] = spherical_to_direction(np.radians(theta_deg), np.radians(phi_deg))
    return bases


def _matrix(block: ET.Element, band: str, bases: dict[str, Array], path: Path) -> _Matrix:
    side = _text(block, "WavelengthDataDirection")
    where = f"{path}: {band}, {side}"
    names = [_text(block, "ColumnAngleBasis"), _text(block, "RowAngleBasis")]
    missing = [name for name in names if name not in bases]
    if missing:
        raise BadInput(f"its basis '{missing[0]}' is not in the file", where=where, todo="copy it again")
    incident, exitant = (bases[name] for name in names)
    words = _text(block, "ScatteringData").replace(",", " ").split()
    if len(words) != len(incident) * len(exitant):
        raise BadInput(
            f"has {len(words)} values, not {len(exitant)} x {len(incident)}",
            where=f"{where}, ScatteringData",
            todo="the file is damaged: copy it again",
        )
    values = bulk(words)
    if values is None:
        values = np.array(
            [number(word, where=f"{where}, value {i}") for i, word in enumerate(words, start=1)]
        )
    return _Matrix(band, side, incident, exitant, values)


def _choose(matrices: list[_Matrix], side: str | None, path: Path) -> list[_Matrix]:
    if side is not None and side not in SIDES:
        raise BadInput(f"'{side}' is no side", where=str(path), todo="choose front or back")
    for name in [side] if side else list(SIDES):
        wanted = [matrix for matrix in matrices if matrix.side == SIDES[name]]
        if any(matrix.values.any() for matrix in wanted):
            return wanted
    raise BadInput(
        f"holds no reflection{f' of the {side}' if side else ''}",
        where=str(path),
        todo="is it a transmission only?",
    )
