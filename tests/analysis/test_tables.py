"""Rows of numbers in bulk: the same numbers as one by one, and the place of the first that is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.formats import require_writer
from analysis.formats.fred import read as read_fred
from analysis.formats.tables import CHUNK, Layout, Lines, bulk, cells_of, numbers_of_rows, plain_table
from analysis.formats.text import number
from analysis.formats.values import LARGEST
from analysis.samples import make_samples, read, write
from rig.angles import spherical_to_direction
from rig.errors import BadInput

PATH = Path("table.txt")
COLUMNS = ("a", "b", "c")


def _lines(texts):
    return Lines(texts, [10 + 2 * index for index in range(len(texts))])


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.text(alphabet="0123456789.,-+eEn_ainfx٣ \t", min_size=1, max_size=6), min_size=1, max_size=4)
)
def test_bulk_takes_what_one_by_one_takes(words):
    """Catches a number that the fast way reads and the careful one refuses, or reads otherwise."""
    expected = []
    for word in words:
        try:
            expected.append(number(word, where=""))
        except BadInput:
            expected = None
            break
    found = bulk(words)
    assert (found is None) == (expected is None)
    if expected is not None:
        assert found.tolist() == expected


@settings(max_examples=300, deadline=None)
@given(
    st.lists(
        st.text(alphabet='0123456789.,-+eEn_ainfx٣ \t"\x0b\x1c\x85\xa0', min_size=1, max_size=12),
        min_size=1,
        max_size=3,
    ),
    st.sampled_from([None, ",", ";", "\t"]),
)
def test_a_plain_table_is_what_one_by_one_gives(texts, separator):
    """Catches a row that the fast way reads and the careful one refuses, or reads otherwise."""
    split = cells_of(separator, PATH)
    expected = []
    try:
        rows = [split(text, 1) for text in texts]
        expected = [[number(cell.strip(), where="") for cell in row] for row in rows]
    except BadInput:
        expected = None
    width = len(split(texts[0], 1))
    found = plain_table(texts, separator, width) if all(text.strip() for text in texts) else None
    if found is not None:
        assert found.tolist() == expected


def test_plain_tables_are_read_at_once():
    """Catches a fast way that nothing takes."""
    assert plain_table(["1,2.5e-1", "3, 4"], ",", 2).tolist() == [[1.0, 0.25], [3.0, 4.0]]
    assert plain_table(["1 2", "3"], None, 2) is None
    assert plain_table(["1 nan"], None, 2) is None


@pytest.mark.parametrize("wrong", [0, CHUNK - 1, CHUNK, 3 * CHUNK + 5])
@pytest.mark.parametrize(
    ("row", "complaint"),
    [
        ("1 x 3", "column b: 'x'"),
        ("1 2", "has 2 numbers, not 3"),
        ("1 2 3 4", "has 4"),
        ("1 2 1e999", "column c"),
    ],
)
def test_the_first_wrong_row_is_named(wrong, row, complaint):
    """Catches lines that are counted from the begin of a chunk, and widths that make up for each other."""
    texts = ["1 2 3"] * (4 * CHUNK)
    texts[wrong] = row
    texts[wrong + 1] = "5" if row.count(" ") == 3 else "1 2 3 4"
    with pytest.raises(BadInput, match=f"line {10 + 2 * wrong}[:,].*{complaint}"):
        numbers_of_rows(_lines(texts), Layout({3: COLUMNS}, None, "not 3"), PATH)


def test_labels_and_commas_are_kept_apart():
    """Catches a name with a point that is taken for a decimal."""
    layout = Layout({3: COLUMNS}, ";", "not 3", todo="", decimal_comma=True, label=1, what="cells")
    rows = numbers_of_rows(_lines(["0,5;steel 1.4301;1", '"2";"a;b";-3,25e1']), layout, PATH)
    np.testing.assert_array_equal(rows.table(), [[0.5, 1.0], [2.0, -32.5]])
    assert rows.labels == ["steel 1.4301", "a;b"]
    with pytest.raises(BadInput, match="line 12: decimals follow commas here and points elsewhere"):
        numbers_of_rows(_lines(["0,5;x;1", "0.5;x;1"]), layout, PATH)
    with pytest.raises(BadInput, match="line 10: a comma without digits"):
        numbers_of_rows(_lines(["0,;x;1"]), layout, PATH)


def _samples():
    theta, phi = (axis.ravel() for axis in np.meshgrid([0.1, 0.4, 0.9], np.arange(8) * 0.7))
    return make_samples(
        spherical_to_direction(np.full(24, 0.5), np.zeros(24)),
        spherical_to_direction(theta, phi),
        0.1 + theta,
    )


@pytest.mark.parametrize("name", ["csv", "astm", "fred", "ssdd", "pab", "zemax"])
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-16-le"])
def test_utf_16(tmp_path, name, encoding):
    """Catches what spreadsheets write as Unicode text, and a text full of zero bytes without a place."""
    path = tmp_path / "a"
    require_writer(path, name).write(_samples(), path)
    before, text = read(path), path.read_bytes().decode()
    mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
    path.write_bytes(mark + text.encode(encoding))
    if encoding == "utf-16-le":
        with pytest.raises(BadInput, match="a: byte 1: a zero byte stands in the text"):
            read(path)
        return
    assert read(path).drop_attrs().equals(before.drop_attrs())
    assert read(path).attrs.get("doubts") == before.attrs.get("doubts")


def test_values_of_no_surface_are_refused(tmp_path):
    """Catches bytes in the other order that pass for values, and darkness that is taken for them."""
    samples = _samples()
    dark = samples["f_r"].to_numpy() * 1e-12
    write(samples.assign(f_r=(samples["f_r"].dims, dark)), tmp_path / "dark.csv")
    assert read(tmp_path / "dark.csv").sizes["sample"] == 24
    swapped = samples["f_r"].to_numpy().byteswap()
    wi, wo = (samples[name].to_numpy() for name in ("wi", "wo"))
    for values in (swapped, np.where(np.arange(24) == 7, 2 * LARGEST, 1.0), dark * 1e-6):
        np.savez(tmp_path / "a.npz", wi=wi, wo=wo, f_r=values)
        with pytest.raises(BadInput, match=r"a.npz(: sample \d+, channel 0)?: .*1/sr"):
            read(tmp_path / "a.npz")


def test_an_incidence_that_is_missing_or_invented(tmp_path):
    """Catches rows that go to another incidence: one whose line is lost, and one that a short row begins."""
    path = tmp_path / "a.txt"
    blocks = {i: [f"{s} {p} 0.1{i}{s}" for s in (5, 20, 60) for p in (0, 90)] for i in (10, 40)}
    head = ["type bsdf_data", "format angles=deg bsdf=value scale=1"]
    lines = head + [line for i, rows in blocks.items() for line in (f"{i} 0", *rows)]
    path.write_text("\n".join([*lines, ""]))
    assert read_fred(path).sizes["sample"] == 12
    path.write_text("\n".join([*(line for line in lines if line != "40 0"), ""]))
    with pytest.raises(BadInput, match="line 10: gives the directions of line 4 again"):
        read_fred(path)
    path.write_text("\n".join([*lines, ""]).replace("20 90 0.11020", "20 90"))
    with pytest.raises(BadInput, match="line 7: two numbers where an incidence does not begin"):
        read_fred(path)
    scattered = [*lines[:9], "40 0", "7 0 0.3", "30 0 0.2", "30 10 0.2", "9 0 0.5", "50 0 0.6", ""]
    path.write_text("\n".join(scattered))
    assert "begin anew at line 14 without an incidence" in read(path).attrs["doubts"]
