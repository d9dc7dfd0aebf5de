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
from numpy.typing import NDArray

from analysis.angle_table import AngleTable
from analysis.formats.tables import bulk, plain_table, rows_with_content
from analysis.formats.text import looks_like_text, read_lines
from analysis.formats.words import Words
from analysis.samples import make_samples
from rig.angles import spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import xarray as xr

Array = NDArray[np.float64]
_Rows = tuple[Array, "Callable[[int], int]", list[float]]

NAME = "Cornell .brdf"
OPTIONS: tuple[str, ...] = ()
OPEN_END = True
ANGLES = ("theta i", "phi i", "theta s", "phi s")
MOST_WAVELENGTHS = 100_000
SHORTEST_NM = 10.0
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
    table, line_of, wavelengths = _rows(path)
    _check_angles(table, line_of, path)
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


def _rows(path: Path) -> _Rows:
    """Return the rows, what tells the line where a row begins, and the wavelengths."""
    return _one_row_a_line(path) or _rows_of_words(path)


def _one_row_a_line(path: Path) -> _Rows | None:
    """Read a file of the usual layout, much faster; None of any other, and of a damaged one."""
    kept = rows_with_content(read_lines(path))
    words = [text.split() for text in kept.texts[:2]]
    if len(words) < 2 or words[0] != [str(len(words[1]))]:
        return None
    wavelengths = bulk(words[1])
    table = plain_table(kept.texts[2:], None, len(ANGLES) + len(words[1]))
    if wavelengths is None or table is None:
        return None
    _check_wavelengths(wavelengths, path)
    return table, lambda row: kept.places[2 + row], wavelengths.tolist()


def _rows_of_words(path: Path) -> _Rows:
    words = Words(path)
    count = words.count("wavelengths", MOST_WAVELENGTHS)
    width = len(ANGLES) + count
    wavelengths = words.numbers(count, "all wavelengths")
    _check_wavelengths(wavelengths, path)
    body, first = words.left, words.taken
    if not body:
        raise BadInput("holds no rows", where=f"{path}: line {words.line(0)}", todo="copy the file again")
    if body % width:
        raise BadInput(
            f"the last row has {body % width} of {width} numbers",
            where=f"{path}: line {words.line(first + body - 1)}",
            todo="the file is cut short or a number is missing: copy it again",
        )
    columns = [*ANGLES, *(f"{w:g} nm" for w in wavelengths)]
    table = words.numbers(body, "the end of its rows", columns=columns).reshape(-1, width)
    return table, lambda row: words.line(first + row * width), wavelengths.tolist()


def _check_wavelengths(wavelengths: Array, path: Path) -> None:
    """Refuse what shows that numbers are missing or doubled before the rows."""
    if wavelengths[0] < SHORTEST_NM or (np.diff(wavelengths) <= 0.0).any():
        raise BadInput(
            f"its wavelengths do not ascend from {SHORTEST_NM:g} nm or more",
            where=f"{path}: the wavelengths",
            todo="the file is damaged or counts its numbers wrongly: copy it again",
        )


def _check_angles(table: Array, line_of: Callable[[int], int], path: Path) -> None:
    polar = table[:, [0, 2]]
    wrong = np.argwhere((polar < 0.0) | (polar > np.pi))
    if wrong.size:
        row, column = wrong[0]
        raise BadInput(
            f"{polar[row, column]:g} is not a polar angle in radians",
            where=f"{path}: line {line_of(row)}, column {ANGLES[2 * column]}",
            todo="this format holds radians, 0 to pi",
        )
