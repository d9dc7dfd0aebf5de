"""Reading a text word by word, for formats whose line ends mean nothing; errors name line and word."""

from __future__ import annotations

import re
from bisect import bisect_right
from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis.formats.tables import bulk
from analysis.formats.text import number, read_lines
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray


CHUNK = 65536
"""Numbers that are converted at a time."""
BLOCK = 4096
"""Lines whose words are counted at a time: thrice as fast as each alone."""


class Word(NamedTuple):
    """A word, and how many stand before it in its file."""

    text: str
    place: int


class Words:
    """The words of a text file in order.

    Parameters
    ----------
    path : Path
        The file.
    comment : str
        What starts a comment at the begin of a word; it lasts to the line's end.

    Raises
    ------
    BadInput
        If the file is too large.
    """

    def __init__(self, path: Path, *, comment: str = "#") -> None:
        self._path = path
        self._text = "\n".join(read_lines(path))
        if comment in self._text:
            # Within a word the sign is damage, and no number.
            self._text = re.sub(rf"(?<!\S){re.escape(comment)}[^\n]*", "", self._text)
        self._words = self._text.split()
        self._at = 0

    @cached_property
    def _lines(self) -> list[str]:
        return self._text.split("\n")

    @cached_property
    def _ends(self) -> list[int]:
        """How many words there are up to the end of each block of lines; only who asks for lines needs it."""
        blocks = (self._lines[at : at + BLOCK] for at in range(0, len(self._lines), BLOCK))
        return list(accumulate(len(" ".join(block).split()) for block in blocks))

    @property
    def left(self) -> int:
        """How many words remain."""
        return len(self._words) - self._at

    @property
    def taken(self) -> int:
        """How many words were taken."""
        return self._at

    def where(self, word: Word) -> str:
        """Name the line on which a word stands and its place there."""
        line, before = self._line_and_before(word.place)
        return f"{self._path}: line {line}, column {word.place - before + 1}"

    def peek(self) -> str:
        """Return the next word without taking it; empty at the end."""
        return self._words[self._at] if self.left else ""

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
        return Word(self._words[self._at - 1], self._at - 1)

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

    def numbers(self, count: int, what: str, *, columns: Sequence[str] = ()) -> NDArray[np.float64]:
        """Take finite numbers.

        Parameters
        ----------
        count : int
            How many.
        what : str
            What they are, for the error that there are fewer.
        columns : sequence of str
            What errors call them, over and over; by default their place on the line.

        Raises
        ------
        BadInput
            If one is malformed or not finite, or the file ends first.
        """
        if self.left < count:
            self._at = len(self._words)
            raise self._ends_before(what)
        first, self._at = self._at, self._at + count
        found = np.empty(count)
        for start in range(first, self._at, CHUNK):
            chosen = self._words[start : min(start + CHUNK, self._at)]
            values = bulk(chosen)
            if values is None:
                values = self._one_by_one(chosen, start, first, columns)
            found[start - first : start - first + len(chosen)] = values
        return found

    def _one_by_one(
        self, words: list[str], start: int, first: int, columns: Sequence[str]
    ) -> NDArray[np.float64]:
        """Convert words with the care that names the place of an error, once it is found."""
        found = np.empty(len(words))
        for i, text in enumerate(words):
            try:
                found[i] = number(text, where="")
            except BadInput:
                number(text, where=self._where_number(start + i, first, columns))
        return found

    def line(self, place: int) -> int:
        """Return the line of a word, both counted from its file's begin: words from 0, lines from 1."""
        return self._line_and_before(place)[0]

    def _line_and_before(self, place: int) -> tuple[int, int]:
        """Return the line of a word, and how many words stand on the lines before it."""
        block = bisect_right(self._ends, place)
        before, line = self._ends[block - 1] if block else 0, block * BLOCK
        for text in self._lines[line : line + BLOCK]:
            line += 1
            count = len(text.split())
            if before + count > place:
                break
            before += count
        return line, before

    def _where_number(self, place: int, first: int, columns: Sequence[str]) -> str:
        if not columns:
            return self.where(Word(self._words[place], place))
        return f"{self._path}: line {self.line(place)}, column {columns[(place - first) % len(columns)]}"

    def _ends_before(self, what: str) -> BadInput:
        last = self.line(len(self._words) - 1) if self._words else 1
        return BadInput(
            f"the file ends before {what}",
            where=f"{self._path}: line {last}",
            todo="it is cut short or counts its numbers wrongly: copy it again",
        )
