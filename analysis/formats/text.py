"""What the text formats share: decoding, numbers, and errors that name line and column."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
UTF_16_MARKS = (b"\xff\xfe", b"\xfe\xff")
LARGEST_TEXT_BYTES = 16 * 1024**2
"""Lists of words take up to sixty times the space of the text."""

SEPARATORS = (";", "\t", ",")
"""What may stand between cells; where it is no comma, a comma may stand in numbers."""


def looks_like_text(head: bytes) -> bool:
    """Whether the start of a file can be text: no zero bytes."""
    return b"\0" not in head


def read_lines(path: Path) -> list[str]:
    """Read the lines of a text file as `decoded_lines` does.

    Raises
    ------
    BadInput
        If the file is larger than any table of samples.
    """
    size = path.stat().st_size
    if size > LARGEST_TEXT_BYTES:
        raise BadInput(
            f"is {size / 1024**2:.0f} MB of text, more than gonio reads",
            where=str(path),
            todo="store it as NetCDF",
        )
    return decoded_lines(path.read_bytes())


def decoded_lines(content: bytes) -> list[str]:
    """Split a text into lines, with any line ends: UTF-8, UTF-16 that has its mark, or else Latin-1."""
    try:
        text = content.decode("utf-16" if content.startswith(UTF_16_MARKS) else "utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    # Only what editors call a line end: `splitlines` also breaks at form feeds and Unicode separators.
    return text.replace("\r\n", "\n").replace("\r", "\n").removesuffix("\n").split("\n") if text else []


def separator_of(header: str) -> str:
    """Return what separates the cells of a table, told by the line that names its columns."""
    return next((separator for separator in SEPARATORS if separator in header), ",")


def number(text: str, *, where: str) -> float:
    """Convert a table's cell.

    Parameters
    ----------
    text : str
        The cell.
    where : str
        File, line and column, for the error.

    Returns
    -------
    float
        A finite number.

    Raises
    ------
    BadInput
        If it is no number, or not a finite one.
    """
    try:
        # Python alone would take 1_0 for ten, and the digits of other scripts.
        value = float(text) if text.isascii() and "_" not in text else None
    except ValueError:
        value = None
    if value is None:
        todo = "write decimals with a point" if "," in text else "correct or remove the row"
        raise BadInput(f"'{text[:40]}' is not a number", where=where, todo=todo)
    if not math.isfinite(value):
        raise BadInput(f"'{text[:40]}' is not a finite number", where=where, todo="correct or remove the row")
    return value
