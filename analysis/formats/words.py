"""Reading a text word by word, for formats whose line ends mean nothing; errors name line and word."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis.formats.text import number, read_lines
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


class Word(NamedTuple):
    """A word, the line it stands on and its place there, both counted from 1."""

    text: str
    line: int
    column: int


class Words:
    """The words of a text file in order.

    Parameters
    ----------
    path : Path
        The file.
    comment : str
        What starts a comment, which lasts to the line's end.

    Raises
    ------
    BadInput
        If the file is too large.
    """

    def __init__(self, path: Path, *, comment: str = "#") -> None:
        self._path = path
        self._words = [
            Word(text, line, column)
            for line, content in enumerate(read_lines(path), start=1)
            for column, text in enumerate(content.split(comment, 1)[0].split(), start=1)
        ]
        self._at = 0

    @property
    def left(self) -> int:
        """How many words remain."""
        return len(self._words) - self._at

    def where(self, word: Word) -> str:
        """Name a word's place."""
        return f"{self._path}: line {word.line}, column {word.column}"

    def peek(self) -> str:
        """Return the next word without taking it; empty at the end."""
        return self._words[self._at].text if self.left else ""

    def take(self, what: str) -> Word:
        """Take the next word.

        Raises
        ------
        BadInput
            If the file ends before `what`.
        """
        if not self.left:
            raise self._ends_before(what)
        self._at += 1
        return self._words[self._at - 1]

    def expect(self, *known: str) -> Word:
        """Take the next word, which must be one of these.

        Raises
        ------
        BadInput
            If it is not.
        """
        word = self.take(known[0])
        if word.text not in known:
            raise BadInput(
                f"'{word.text[:40]}' stands where {' or '.join(known)} should",
                where=self.where(word),
                todo="the file is damaged or counts its numbers wrongly: copy it again",
            )
        return word

    def count(self, what: str, most: int) -> int:
        """Take a whole number from 1 to `most`.

        Raises
        ------
        BadInput
            If it is none.
        """
        word = self.take(what)
        if not (word.text.isascii() and word.text.isdigit() and 1 <= int(word.text[:10]) <= most):
            raise BadInput(
                f"'{word.text[:40]}' is no number of {what}",
                where=self.where(word),
                todo=f"write a whole number from 1 to {most}",
            )
        return int(word.text)

    def numbers(self, count: int, what: str) -> NDArray[np.float64]:
        """Take finite numbers.

        Raises
        ------
        BadInput
            If one is malformed or not finite, or the file ends first.
        """
        if self.left < count:
            self._at = len(self._words)
            raise self._ends_before(what)
        chosen = self._words[self._at : self._at + count]
        self._at += count
        return np.array([number(word.text, where=self.where(word)) for word in chosen])

    def _ends_before(self, what: str) -> BadInput:
        last = self._words[-1].line if self._words else 1
        return BadInput(
            f"the file ends before {what}",
            where=f"{self._path}: line {last}",
            todo="it is cut short or counts its numbers wrongly: copy it again",
        )
