"""What the text formats share: decoding, numbers, and errors that name line and column."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

LARGEST_TEXT_BYTES = 64 * 1024**2

_LINE_END = re.compile(r"\r\n|\n|\r")


def looks_like_text(head: bytes) -> bool:
    """Whether the start of a file can be text: no zero bytes."""
    return b"\0" not in head


def read_lines(path: Path) -> list[str]:
    """Read the lines of a text file in UTF-8 (with or without mark) or Latin-1, with any line ends.

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
    content = path.read_bytes()
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    # Only what editors call a line end: `splitlines` also breaks at form feeds and Unicode separators.
    return _LINE_END.split(text.removesuffix("\n").removesuffix("\r")) if text else []


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
        value = float(text)
    except ValueError:
        comma = "," in text
        todo = "write decimals with a point" if comma else "correct or remove the row"
        raise BadInput(f"'{text[:40]}' is not a number", where=where, todo=todo) from None
    if not math.isfinite(value):
        raise BadInput(f"'{text}' is not a finite number", where=where, todo="correct or remove the row")
    return value
