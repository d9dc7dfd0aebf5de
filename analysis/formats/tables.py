"""Rows of numbers, converted many at a time; where one is malformed, the error names its line and column."""

from __future__ import annotations

import csv
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.formats.text import number
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

CHUNK = 512
"""Rows that are taken apart at a time. Words take sixty times the space of the text; and more lists than
this at once would have Python look through all of them for garbage, over and over."""


class Lines(NamedTuple):
    """Lines of a text that matter, and the number of each, counted from 1."""

    texts: list[str]
    places: Sequence[int]

    def numbers(self) -> Indices:
        """Return the places as an array."""
        if isinstance(self.places, range):  # an array of a range takes a hundred times as long
            return np.arange(self.places.start, self.places.stop, dtype=np.intp)
        return np.array(self.places, dtype=np.intp)


class Rows(NamedTuple):
    """The numbers of rows one after the other; of each row how many, its line, and its label if any."""

    numbers: Array
    widths: Indices
    places: Indices
    labels: list[str]

    def starts(self) -> Indices:
        """Return the place of each row's first number."""
        return np.cumsum(self.widths) - self.widths

    def table(self) -> Array:
        """Return rows of one width as a table (rows, columns)."""
        return self.numbers.reshape(len(self.widths), -1)


class Layout(NamedTuple):
    """What a row may look like.

    Attributes
    ----------
    columns : mapping of int to sequence of str
        By the number of cells that a row may have, what its columns are called in errors.
    separator : str or None
        What separates cells; None for blanks.
    expected : str
        How many cells there should be: the end of the error about a row that has not.
    todo : str
        What to do about it.
    decimal_comma : bool
        Whether decimals may follow a comma. All of a table's do, or none.
    label : int, optional
        Index of a column that holds words, not numbers.
    what : str
        What stands in a row.
    """

    columns: Mapping[int, Sequence[str]]
    separator: str | None
    expected: str
    todo: str = "complete the row or copy the file again"
    decimal_comma: bool = False
    label: int | None = None
    what: str = "numbers"


def rows_with_content(lines: Sequence[str], *, start: int = 0, comment: str = "#") -> Lines:
    """Return the lines from an index on that are neither empty nor begin with a comment's sign."""
    texts = list(lines[start:])
    if all(map(str.strip, texts)) and not (comment and comment in "".join(texts)):  # the same, much faster
        return Lines(texts, range(start + 1, start + 1 + len(texts)))
    places = [
        line
        for line, text in enumerate(texts, start=start + 1)
        if (bare := text.strip()) and not (comment and bare.startswith(comment))
    ]
    return Lines([lines[line - 1] for line in places], places)


def cells_of(separator: str | None, path: Path) -> Callable[[str, int], list[str]]:
    """Return what splits a row: at blanks, or at a separator with cells in quotes as spreadsheets do."""

    def split(text: str, line: int) -> list[str]:
        if separator is None or '"' not in text:  # the same, and much faster
            return text.split(separator)
        try:
            return next(csv.reader([text], delimiter=separator))
        except csv.Error as error:
            raise BadInput(
                f"is no row of a table ({error})", where=f"{path}: line {line}", todo="correct the line"
            ) from None

    return split


def bulk(words: Sequence[str]) -> Array | None:
    """Convert words to finite numbers; None where `analysis.formats.text.number` would refuse one."""
    text = "".join(words)
    # Python alone would take 1_0 for ten, and the digits of other scripts.
    if not text.isascii() or "_" in text:
        return None
    try:
        values = np.fromiter(map(float, words), np.float64, len(words))
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None


def plain_table(texts: list[str], separator: str | None, width: int) -> Array | None:
    """Convert rows of one width at once, ten times as fast; None where it takes more care to read them.

    Parameters
    ----------
    texts : list of str
        Rows, none of them empty.
    separator : str or None
        What separates cells; None for blanks.
    width : int
        How many cells each row should have.
    """
    if not texts:
        return None
    try:
        table = np.loadtxt(texts, delimiter=separator, comments=None, ndmin=2)
    except ValueError:
        return None
    return table if table.shape == (len(texts), width) and np.isfinite(table).all() else None


def numbers_of_rows(lines: Lines, layout: Layout, path: Path) -> Rows:
    """Convert rows of numbers.

    Parameters
    ----------
    lines : Lines
        The rows.
    layout : Layout
        What they may look like.
    path : Path
        The file, for errors.

    Returns
    -------
    Rows

    Raises
    ------
    BadInput
        If a row has another number of cells, a cell is no finite number, or decimals follow points in some
        and commas in other rows; names line and column.
    """
    if len(layout.columns) == 1 and layout.label is None:
        (width,) = layout.columns
        table = plain_table(lines.texts, layout.separator, width)
        if table is not None:
            return Rows(table.ravel(), np.full(len(table), width, dtype=np.intp), lines.numbers(), [])
    return _by_chunks(lines, layout, path)


def _by_chunks(lines: Lines, layout: Layout, path: Path) -> Rows:
    split = cells_of(layout.separator, path)
    numbers: list[Array] = []
    widths: list[int] = []
    labels: list[str] = []
    mark = ""
    for start in range(0, len(lines.texts), CHUNK):
        texts, places = lines.texts[start : start + CHUNK], lines.places[start : start + CHUNK]
        rows = [split(text, line) for text, line in zip(texts, places, strict=True)]
        wrong = next((place for place, row in enumerate(rows) if len(row) not in layout.columns), None)
        cells = 0 if wrong is None else len(rows[wrong])
        rows = rows[:wrong]
        if layout.label is not None:
            labels += [row.pop(layout.label).strip() for row in rows]
        if layout.decimal_comma:
            rows, mark = _with_points(rows, places, mark, path)
        values = bulk(list(chain.from_iterable(rows)))
        numbers.append(_one_by_one(rows, places, layout, path) if values is None else values)
        if wrong is not None:
            raise BadInput(
                f"has {cells} {layout.what}, {layout.expected}",
                where=f"{path}: line {places[wrong]}",
                todo=layout.todo,
            )
        widths += map(len, rows)
    return Rows(
        np.concatenate(numbers) if numbers else np.empty(0),
        np.array(widths, dtype=np.intp),
        lines.numbers(),
        labels,
    )


def require_once(directions: Array, places: Indices, path: Path) -> None:
    """Refuse a table that gives a pair of directions twice, where its format has each once.

    Parameters
    ----------
    directions : ndarray, shape (rows, angles)
        The angles as they are written.
    places : ndarray of int, shape (rows,)
        Line of each row.
    path : Path
        The file, for the error.

    Raises
    ------
    BadInput
        If two rows have the same angles; names both lines.
    """
    order = np.lexsort((places, *directions.T))
    same = (np.diff(directions[order], axis=0) == 0.0).all(axis=1)
    if same.any():
        later = places[order[1:][same]].argmin()
        raise BadInput(
            f"gives the directions of line {places[order[:-1][same]][later]} again",
            where=f"{path}: line {places[order[1:][same]][later]}",
            todo="a line is doubled, or the one that begins another incidence is missing: copy it again",
        )


def _one_by_one(rows: list[list[str]], places: Sequence[int], layout: Layout, path: Path) -> Array:
    """Convert rows with the care that names the place of an error."""
    names = {size: list(columns) for size, columns in layout.columns.items()}
    if layout.label is not None:
        names = {size - 1: columns for size, columns in names.items() if columns.pop(layout.label)}
    found = [
        number(cell.strip(), where=f"{path}: line {line}, column {name}")
        for cells, line in zip(rows, places, strict=False)
        for cell, name in zip(cells, names[len(cells)], strict=True)
    ]
    return np.array(found)


def _with_points(
    rows: list[list[str]], places: Sequence[int], mark: str, path: Path
) -> tuple[list[list[str]], str]:
    """Write decimals with points; `mark` is what separated decimals so far, empty where nothing did."""
    text = "".join(chain.from_iterable(rows))
    marks = {mark, *(sign for sign in ",." if sign in text)} - {""}
    if "," not in marks:
        return rows, "".join(marks)
    bare = next((line for row, line in zip(rows, places, strict=False) if _comma_at_an_end(row)), None)
    if bare is not None:
        raise BadInput(
            "a comma without digits on both sides", where=f"{path}: line {bare}", todo="complete the number"
        )
    if len(marks) > 1:
        line = _first_other(rows, places, mark)
        raise BadInput(
            "decimals follow commas here and points elsewhere",
            where=f"{path}: line {line}",
            todo="write all with points, and thousands without a separator",
        )
    return [[cell.replace(",", ".") for cell in row] for row in rows], ","


def _comma_at_an_end(cells: list[str]) -> bool:
    """Whether a number lost the digits before or behind its comma; Fortran does so with points only."""
    return any(bare[:1] == "," or bare[-1:] == "," for cell in cells if (bare := cell.strip()))


def _first_other(rows: list[list[str]], places: Sequence[int], mark: str) -> int:
    """Return the first line whose decimals are marked otherwise than in what stands before it."""
    for cells, line in zip(rows, places, strict=False):
        signs = {sign for sign in ",." if any(sign in cell for cell in cells)}
        if len(signs | {mark} - {""}) > 1:
            return line
        mark = mark or "".join(signs)
    return places[-1]
