"""Sets of light paths as regular expressions, compared exactly.

Heckbert (1990, "Adaptive radiosity textures for bidirectional ray tracing", section 4) writes a light path as
a word over four letters:

    L   the lamp, where every path begins
    D   a scattering event: any that is not S
    S   a mirror-like event (a delta function)
    E   the camera ("eye"), where every path ends

and a set of paths as a regular expression, with ``( ) | * + ?``. Two letters tell kinds of D apart: ``Dl`` is
a Lambertian event, ``Dg`` (glossy) any other; ``D`` is ``(Dl|Dg)``. What paths a scene can have, and what
paths a method computes, are both such sets. Sets are compiled to finite automata, so that inclusion,
intersection and difference are decided for paths of every length, not tried up to one.
"""

from __future__ import annotations

import re
from functools import cached_property, lru_cache
from itertools import islice
from typing import TYPE_CHECKING

from greenery import Fsm, Pattern, parse
from greenery.rxelems import from_fsm

from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Iterator

    from greenery import Charclass, Multiplier

EXAMPLES = "LDE, L(D|S)*E, LS?Dl+E"

# One letter for each event inside the automaton.
_TO_LETTERS = {"D": "[lg]", "Dl": "l", "Dg": "g"}
_TO_WORDS = {"l": "Dl", "g": "Dg"}
_EVENTS = {
    **{letter: _TO_WORDS.get(letter, letter) for letter in "LESlg"},
    "gl": "D",
    "Sl": "(Dl|S)",
    "Sg": "(Dg|S)",
    "Sgl": "(D|S)",
}
_TOKEN = re.compile(r"D[lg]|[LDSE()|*+?]")
_QUANTIFIERS = frozenset("*+?")
_HASHED_WORDS = 8
_WHOLE = parse("L[lgS]*E").to_fsm()


class LightPaths:
    """A set of light paths.

    Equal sets are equal however they are written. ``a <= b`` tells whether every path of a is one of b;
    ``a & b``, ``a | b`` and ``a - b`` are the sets' intersection, union and difference; ``"LDlE" in a`` asks
    for one path; a set without paths is false.

    Parameters
    ----------
    expression : str
        See the module; the empty string is the empty set.

    Raises
    ------
    BadInput
        The expression is not one, or some of its words do not begin at L, end at E and scatter in between.
    """

    def __init__(self, expression: str) -> None:
        self._automaton = _compile(expression)

    @classmethod
    def _of(cls, automaton: Fsm) -> LightPaths:
        paths = cls.__new__(cls)
        paths._automaton = automaton.reduce()  # noqa: SLF001 - its own class
        return paths

    def __and__(self, other: LightPaths) -> LightPaths:
        return self._of(self._automaton & other._automaton)

    def __or__(self, other: LightPaths) -> LightPaths:
        return self._of(self._automaton | other._automaton)

    def __sub__(self, other: LightPaths) -> LightPaths:
        return self._of(self._automaton - other._automaton)

    def __le__(self, other: LightPaths) -> bool:
        return bool(self._automaton.issubset(other._automaton))

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return isinstance(other, LightPaths) and bool(self._automaton.equivalent(other._automaton))

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        # Equal sets may be written differently; what comes first of their words is the same.
        return hash(tuple(islice(self.words(), _HASHED_WORDS)))

    def __bool__(self) -> bool:
        return not self._automaton.empty()

    def __contains__(self, word: str) -> bool:
        return LightPaths(word) <= self

    def __repr__(self) -> str:
        return f"LightPaths({self.expression!r})"

    def __str__(self) -> str:
        return self.expression

    @cached_property
    def expression(self) -> str:
        """One expression of the set, in the module's notation; empty for the empty set."""
        return _written(from_fsm(self._automaton).reduce()) if self else ""

    def words(self) -> Iterator[str]:
        """Every path, shortest first, with Dl and Dg told apart; endless where the set is infinite."""
        for word in self._automaton.strings([]):
            yield _word(word)

    def with_events(self, least: int, most: int | None = None) -> LightPaths:
        """Return the paths with `least` to `most` events between lamp and camera.

        Parameters
        ----------
        least : int
        most : int, optional
            By default as many as there are.
        """
        return self._of(self._automaton & _of_length(least, most))


@lru_cache(maxsize=256)
def _of_length(least: int, most: int | None) -> Fsm:
    upper = "" if most is None else str(most)
    return parse(f"L[lgS]{{{least},{upper}}}E").to_fsm().reduce()


@lru_cache(maxsize=256)
def _compile(expression: str) -> Fsm:
    if not expression:
        return parse("[]").to_fsm()
    tokens = _tokens(expression)
    _check_grammar(expression, tokens)
    automaton = parse("".join(_TO_LETTERS.get(sign, sign) for sign, _ in tokens)).to_fsm()
    strange = automaton - _WHOLE
    if not strange.empty():
        example = _word(next(strange.strings([])))
        raise BadInput(
            f"'{example}' is no light path: one begins at L, ends at E, and has D and S in between",
            where=expression,
            todo=f"write it as in {EXAMPLES}",
        )
    return automaton.reduce()


def _tokens(expression: str) -> list[tuple[str, int]]:
    """Letters and signs with their places, counted from 1."""
    tokens, place = [], 0
    while place < len(expression):
        match = _TOKEN.match(expression, place)
        if match is None:
            raise _not_here(expression, expression[place], place + 1)
        tokens.append((match.group(), place + 1))
        place = match.end()
    return tokens


def _check_grammar(expression: str, tokens: list[tuple[str, int]]) -> None:
    """Refuse empty alternatives, signs that repeat nothing, and parentheses that do not match."""
    opened: list[int] = []
    before = "("
    for sign, place in [*tokens, (")", len(expression) + 1)]:
        begins = before in {"(", "|"}
        last = place > len(expression)
        if begins and sign in {")", "|", *_QUANTIFIERS}:
            raise _not_here(expression, "the end" if last else sign, place)
        if before in _QUANTIFIERS and sign in _QUANTIFIERS:
            raise _not_here(expression, sign, place)
        if sign == "(":
            opened.append(place)
        elif sign == ")" and not last:
            if not opened:
                raise _not_here(expression, sign, place)
            opened.pop()
        before = sign
    if opened:
        raise BadInput(f"the '(' at place {opened[-1]} is not closed", where=expression, todo="add a ')'")


def _not_here(expression: str, found: str, place: int) -> BadInput:
    what = found if found == "the end" else f"'{found}'"
    return BadInput(
        f"{what} at place {place} is not expected there",
        where=expression,
        todo=f"use the letters L D S E, Dl and Dg, and the signs ( ) | * + ?, as in {EXAMPLES}",
    )


def _word(letters: str) -> str:
    return "".join(_TO_WORDS.get(letter, letter) for letter in letters)


def _written(pattern: Pattern) -> str:
    """Write a pattern of the automaton's letters in the module's notation."""
    return "|".join(
        "".join(_repeated(_multiplicand(mult.multiplicand), mult.multiplier) for mult in conc.mults)
        for conc in sorted(pattern.concs, key=str)
    )


def _multiplicand(multiplicand: Pattern | Charclass) -> str:
    if isinstance(multiplicand, Pattern):
        return f"({_written(multiplicand)})"
    return _EVENTS["".join(sorted(multiplicand.get_chars()))]


def _repeated(text: str, multiplier: Multiplier) -> str:
    """Repeat by copies and ``* + ?``, where the automaton's library counts."""
    least: int = multiplier.min.v
    most: int | None = multiplier.max.v
    if (least, most) == (0, None):
        return f"{text}*"
    if most is None:
        return text * (least - 1) + f"{text}+"
    optional = ""
    for _ in range(most - least):
        optional = f"({text}{optional})?" if optional else f"{text}?"
    return text * least + optional
