"""Cornell's `.brdf` text: wavelengths, then rows of two directions in radians and one value per wavelength.

    31                                      number of wavelengths
    400 410 ... 700                         wavelengths in nm
    theta_i phi_i theta_s phi_s f f f ...   one sample a row; `#` starts a comment, line ends mean nothing

Their negatives were clipped to zero by the authors.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from analysis.angle_table import AngleTable
from analysis.formats.text import looks_like_text, number, read_lines
from analysis.samples import make_samples
from rig.angles import spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

NAME = "Cornell .brdf"
OPTIONS: tuple[str, ...] = ()
OPEN_END = True
ANGLES = ("theta i", "phi i", "theta s", "phi s")
MOST_WAVELENGTHS = 100_000
# No alternative takes what another can: two ways to take the same blanks would try all their mixtures.
_START = re.compile(rb"\A(?:\xef\xbb\xbf)?(?:\s|#[^\r\n]*[\r\n])*+\d{1,9}[^\S\r\n]*(?:#[^\r\n]*)?[\r\n]")


def sniff(head: bytes) -> bool:
    """Whether the first thing that is not a comment is a whole number alone on its line."""
    return looks_like_text(head) and _START.match(head) is not None


def read(path: Path) -> xr.Dataset:
    """Read samples.

    Raises
    ------
    BadInput
        If a number is missing, malformed or not finite, or an angle is not in radians; names line and column.
    """
    table, lines, wavelengths = _rows(path)
    _check_angles(table, lines, path)
    theta_i, phi_i, theta_o, phi_o = table[:, :4].T
    return make_samples(
        spherical_to_direction(theta_i, phi_i),
        spherical_to_direction(theta_o, phi_o),
        table[:, 4:],
        wavelength_nm=wavelengths,
        source=path.name,
    )


def declared(path: Path) -> AngleTable:
    """Return the columns as they are, whatever the angles, for the convention doctor.

    Raises
    ------
    BadInput
        If a number is missing, malformed or not finite.
    """
    table, _, wavelengths = _rows(path)
    theta_i, phi_i, theta_o, phi_o = table[:, :4].T
    facts = {"wavelength_nm": wavelengths, "source": path.name}
    return AngleTable(theta_i, phi_i, theta_o, phi_o, table[:, 4:], facts)


def _rows(path: Path) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.float64]], list[int], list[float]]:
    """Return the rows, the line where each begins, and the wavelengths."""
    words = [
        (word, line)
        for line, text in enumerate(read_lines(path), start=1)
        for word in text.split("#", 1)[0].split()
    ]
    count = int(number(words[0][0], where=f"{path}: line {words[0][1]}")) if words else 0
    width = len(ANGLES) + count
    body = len(words) - 1 - count
    if not 1 <= count <= MOST_WAVELENGTHS or body < width:
        raise BadInput(
            f"announces {count} wavelengths, but {max(len(words) - 1, 0)} numbers follow",
            where=f"{path}: line {words[0][1] if words else 1}",
            todo="copy the file again",
        )
    wavelengths = [number(word, where=f"{path}: line {line}") for word, line in words[1 : 1 + count]]
    if body % width:
        raise BadInput(
            f"the last row has {body % width} of {width} numbers",
            where=f"{path}: line {words[-1][1]}",
            todo="the file is cut short or a number is missing: copy it again",
        )
    columns = [*ANGLES, *(f"{w:g} nm" for w in wavelengths)]
    table = np.array(
        [
            number(word, where=f"{path}: line {line}, column {columns[index % width]}")
            for index, (word, line) in enumerate(words[1 + count :])
        ]
    ).reshape(-1, width)
    return table, [line for _, line in words[1 + count :: width]], wavelengths


def _check_angles(
    table: np.ndarray[tuple[int, ...], np.dtype[np.float64]], lines: list[int], path: Path
) -> None:
    polar = table[:, [0, 2]]
    wrong = np.argwhere((polar < 0.0) | (polar > np.pi))
    if wrong.size:
        row, column = wrong[0]
        raise BadInput(
            f"{polar[row, column]:g} is not a polar angle in radians",
            where=f"{path}: line {lines[row]}, column {ANGLES[2 * column]}",
            todo="this format holds radians, 0 to pi",
        )
