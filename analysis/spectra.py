"""Tables over wavelength: of lamps, cameras and materials."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

Array = NDArray[np.float64]

LIBRARY = "colour:"
"""What the names of colour-science's own data sets begin with."""
SUFFIXES = (".csv", ".json", ".txt")
"""How the names of files end that are tables."""
_SHORTEST_NM = 10.0
"""Less is no wavelength in nm but in micrometres."""


class Spectrum(NamedTuple):
    """A table over wavelength.

    Attributes
    ----------
    wavelength_nm : ndarray, shape (K,)
        Increasing.
    values : ndarray, shape (K, C)
    where : str
        Its file or name.
    """

    wavelength_nm: Array
    values: Array
    where: str

    def at(self, wavelength_nm: Array) -> Array:
        """Values (N, C), linear between nodes, the last ones beyond."""
        columns = [np.interp(wavelength_nm, self.wavelength_nm, column) for column in self.values.T]
        return np.stack(columns, axis=-1)


def read_spectrum(source: str) -> Spectrum:
    """Read a table over wavelength.

    Parameters
    ----------
    source : str
        A file, relative to the working folder: lines of wavelength in nm and values, separated by commas,
        after a heading or none; or JSON as rawtoaces (Academy Software Foundation) has it. Or `colour:` and
        the name of an illuminant or a camera of colour-science.

    Raises
    ------
    BadInput
        One that is not there or holds something else.
    """
    try:
        if source.startswith(LIBRARY):
            nodes, values = _library(source.removeprefix(LIBRARY))
        elif source.endswith(".json"):
            nodes, values = _rawtoaces(Path(source))
        else:
            nodes, values = _text(Path(source))
    except OSError as error:
        what = f"{error.strerror or 'unreadable'}: {source}"
        raise BadInput(what, where="spectrum", todo="give the path of a table") from None
    except (KeyError, ValueError, IndexError, TypeError, AttributeError):
        what = "no table of wavelengths in nm and values"
        raise BadInput(what, where=source, todo="see the page of samples") from None
    order = np.argsort(nodes)
    nodes, values = nodes[order], values[order]
    if (
        len(nodes) < 2
        or (np.diff(nodes) <= 0.0).any()
        or not np.isfinite(values).all()
        or nodes[0] < _SHORTEST_NM
    ):
        raise BadInput("wavelengths that repeat, are not in nm, or too few", where=source, todo="correct it")
    return Spectrum(nodes, values, source)


def _text(path: Path) -> tuple[Array, Array]:
    rows = [[cell.strip() for cell in row] for row in csv.reader(path.read_text().splitlines()) if row]
    rows = [row for row in rows if row and not row[0].startswith("#")]
    try:
        float(rows[0][0])
    except ValueError:
        rows = rows[1:]
    table = np.array(rows, dtype=np.float64)
    return table[:, 0], table[:, 1:].reshape(len(table), table.shape[1] - 1)


def _rawtoaces(path: Path) -> tuple[Array, Array]:
    table = json.loads(path.read_text(encoding="utf-8"))["spectral_data"]["data"]["main"]
    return np.array([float(node) for node in table]), np.array(list(table.values()), dtype=np.float64)


def _library(name: str) -> tuple[Array, Array]:
    import colour

    for data in (colour.SDS_ILLUMINANTS, colour.MSDS_CAMERA_SENSITIVITIES, colour.SDS_LIGHT_SOURCES):
        if name in data:
            values = np.asarray(data[name].values, dtype=np.float64)
            return np.asarray(data[name].wavelengths, dtype=np.float64), values.reshape(len(values), -1)
    raise BadInput(f"colour-science has no {name!r}", where="spectrum", todo="see its SDS_ILLUMINANTS")
