"""Files of others that describe a white: certificates, and tables of reflectance factors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from analysis.white_calibration import Certificate, Points, checked_certificate, checked_points, read_text
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Float = NDArray[np.float64]


def read_certificate(path: Path) -> Certificate:
    """Read a certificate: lines of nm, reflectance and standard uncertainty, by blanks, tabs or commas.

    Raises
    ------
    BadInput
        No such file, or no such lines.
    """
    rows = [row for row in _rows(path) if len(row) == 3]
    if not rows:
        raise BadInput("no lines of three numbers", where=str(path), todo="give nm, reflectance, uncertainty")
    table = np.array(rows, dtype=np.float64)
    try:
        return checked_certificate(table[:, 0], table[:, 1], table[:, 2])
    except BadInput as error:
        raise BadInput(error.what, where=str(path), todo=error.todo) from None


def read_points(path: Path, nm: float | None = None) -> Points:
    """Read reflectance factors: lines of source zenith and azimuth, view zenith and azimuth, then bands.

    Azimuths are those of the directions to source and detector, so that 0 and 180 face each other. The
    heading names the bands by their wavelength, such as 550nm.

    Parameters
    ----------
    path : Path
    nm : float, optional
        The nearest band is taken; by default the mean of all.

    Raises
    ------
    BadInput
        No such file or lines, or impossible values.
    """
    rows = [row for row in _rows(path) if len(row) >= 5]
    if not rows or len({len(row) for row in rows}) != 1:
        todo = "give source zenith, azimuth, view zenith, azimuth in degrees, then factors"
        raise BadInput("no lines of four angles and factors", where=str(path), todo=todo)
    table = np.array(rows, dtype=np.float64)
    factor = table[:, 4:].mean(axis=1)
    if nm is not None:
        bands = _bands(path, table.shape[1] - 4)
        factor = table[:, 4 + int(np.argmin(np.abs(bands - nm)))]
    try:
        return checked_points(Points(table[:, 0], table[:, 1], table[:, 2], table[:, 3], factor))
    except BadInput as error:
        raise BadInput(error.what, where=str(path), todo=error.todo) from None


def _bands(path: Path, number: int) -> Float:
    """Read the wavelengths that the heading names."""
    for line in read_text(path, "give a text table").splitlines():
        words = [word[:-2] for word in line.split() if word.endswith("nm")]
        if len(words) == number:
            return np.array(words, dtype=np.float64)
    raise BadInput("its heading names no wavelengths", where=str(path), todo="name bands such as 550nm")


def _rows(path: Path) -> list[list[float]]:
    """Collect the lines that hold numbers and nothing else."""
    text = read_text(path, "give a text table")
    found = []
    for line in text.splitlines():
        try:
            row = [float(word) for word in line.replace(",", " ").replace(";", " ").split()]
        except ValueError:
            continue
        if row and all(map(math.isfinite, row)):
            found.append(row)
    return found
