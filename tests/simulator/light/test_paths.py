"""Sets of light paths: what is a path, which set holds which, and how a set is written."""

from __future__ import annotations

import re
from itertools import islice, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.errors import BadInput
from simulator.light.paths import LightPaths

ALL = LightPaths("L(D|S)*E")

EVENTS = st.recursive(
    st.sampled_from(["D", "S", "Dl", "Dg"]),
    lambda inner: st.one_of(
        st.tuples(inner, inner).map("".join),
        st.tuples(inner, inner).map(lambda pair: f"({pair[0]}|{pair[1]})"),
        st.tuples(inner, st.sampled_from("*+?")).map(lambda pair: f"({pair[0]}){pair[1]}"),
    ),
    max_leaves=4,
)
EXPRESSIONS = EVENTS.map(lambda events: f"L{events}E")
SHORT_WORDS = [
    "L" + "".join(events) + "E" for n in range(4) for events in product(("Dl", "Dg", "S"), repeat=n)
]


def by_matching(expression: str) -> set[str]:
    """Short words of an expression, by Python's own regular expressions."""
    pattern = re.compile(re.sub("D(?![lg])", "(?:Dl|Dg)", expression))
    return {word for word in SHORT_WORDS if pattern.fullmatch(word)}


class TestSets:
    @settings(max_examples=25, deadline=None)
    @given(EXPRESSIONS, EXPRESSIONS)
    def test_they_hold_what_matching_finds(self, first: str, second: str) -> None:
        """Would catch an operation on automata that loses or adds a path."""
        a, b = LightPaths(first), LightPaths(second)
        expected_a, expected_b = by_matching(first), by_matching(second)
        for paths, expected in [
            (a, expected_a),
            (a & b, expected_a & expected_b),
            (a | b, expected_a | expected_b),
            (a - b, expected_a - expected_b),
        ]:
            assert set(paths.with_events(0, 3).words()) == expected
        assert all(word in a for word in islice(a.words(), 3))
        assert (a <= b) == (not a - b)

    @settings(max_examples=25, deadline=None)
    @given(EXPRESSIONS)
    def test_what_is_written_is_read_as_the_same_set(self, expression: str) -> None:
        """Would catch a counted repetition or a class of letters that is written wrongly."""
        paths = LightPaths(expression)
        again = LightPaths(paths.expression)
        assert again == paths
        assert hash(again) == hash(paths)
        assert paths <= ALL

    def test_inclusion_is_decided_for_paths_of_every_length(self) -> None:
        """Would catch a comparison of words up to some length: these two part at the ninth event."""
        assert not LightPaths("LD*E") <= LightPaths("LD?D?D?D?D?D?D?D?E")
        assert LightPaths("L(DD)*E") <= LightPaths("LD*E")

    @pytest.mark.parametrize(
        ("left", "right", "difference"),
        [
            ("L(D|S)*E", "LE|LDE", "LSE|L(D|S)(D|S)+E"),
            ("LDE", "LDlE", "LDgE"),
            ("LDE", "LDE", ""),
            ("", "LDE", ""),
            ("L(D|S)E", "LSE", "LDE"),
        ],
    )
    def test_differences_are_those_of_the_textbook(self, left: str, right: str, difference: str) -> None:
        """Would catch a kind of D that is taken for another one."""
        assert LightPaths(left) - LightPaths(right) == LightPaths(difference)

    def test_a_set_without_paths_is_false_and_writes_nothing(self) -> None:
        """Would catch an empty scene for which a method is sought."""
        empty = LightPaths("LDE") & LightPaths("LSE")
        assert not empty
        assert str(empty) == ""
        assert empty == LightPaths("")
        assert empty <= LightPaths("LDE")

    def test_words_come_shortest_first(self) -> None:
        """Would catch a listing that never reaches the second word of an endless set."""
        assert list(islice(LightPaths("LSDl*E").words(), 3)) == ["LSE", "LSDlE", "LSDlDlE"]

    def test_events_are_counted(self) -> None:
        """Would catch a bounce more or less than asked for."""
        assert ALL.with_events(2, 2) == LightPaths("L(D|S)(D|S)E")
        assert ALL.with_events(1) == LightPaths("L(D|S)+E")
        assert ALL.with_events(0, 0) == LightPaths("LE")


class TestBadExpressions:
    @pytest.mark.parametrize(
        ("expression", "names"),
        [
            ("LXE", "'X' at place 2"),
            ("L D E", "' ' at place 2"),
            ("L(DE", "'(' at place 2"),
            ("LD)E", "')' at place 3"),
            ("LD**E", "'*' at place 4"),
            ("L()E", "')' at place 3"),
            ("LDE||LSE", "'|' at place 5"),
            ("+LE", "'+' at place 1"),
            ("LDE|", "the end"),
            ("DE", "'DgE' is no light path"),
            ("L(D|S)*", "'L' is no light path"),
            ("LDELDE", "is no light path"),
        ],
    )
    def test_the_place_is_named(self, expression: str, names: str) -> None:
        """Would catch an expression that is read as something else without a word."""
        with pytest.raises(BadInput, match=re.escape(names)):
            LightPaths(expression)
