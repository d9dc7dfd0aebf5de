"""Files are told by their content: exactly one format may claim each."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from analysis.formats import HEAD_BYTES, NAMES, clean_head, recognise
from benchmarks.data_exchange import AT_HAND
from tests.analysis.whole_files import make_merl, make_whole_files

PAGE = Path(__file__).parents[2] / "docs" / "formats.md"
MODULES = {name: importlib.import_module(f"analysis.formats.{name}") for name in NAMES}


def test_commands_offer_every_option():
    """Catches an option of a format that no command knows, and one that no format understands."""
    from gonio.format_options import NAMES as OFFERED

    assert sorted(OFFERED) == sorted({option for module in MODULES.values() for option in module.OPTIONS})


def _claimed_by(path):
    with path.open("rb") as stream:
        head = clean_head(stream.read(HEAD_BYTES))
    return [name for name, module in MODULES.items() if module.sniff(head)]


def test_one_format_claims_each_file(tmp_path):
    """Catches a format that takes another's files, which the order of asking would hide."""
    files = {**make_whole_files(tmp_path), "merl": make_merl(tmp_path)}
    assert {name: _claimed_by(file.path) for name, file in files.items()} == {
        name: [file.module] for name, file in files.items()
    }


@pytest.mark.realdata
def test_one_format_claims_each_real_file(shared_data):
    """Catches the same on what laboratories wrote."""
    found = {pattern: sorted(shared_data.glob(pattern)) for pattern in AT_HAND}
    assert all(found.values())
    claims = {path: _claimed_by(path) for files in found.values() for path in files}
    assert claims == {path: [AT_HAND[pattern]] for pattern, files in found.items() for path in files}


@pytest.mark.parametrize(
    "text", ["", "hello\n", "theta,phi\n1,2\n", "1\n", "<html><body/></html>", "%PDF-1.7\n", "{}", "#\n" * 9]
)
def test_other_texts_are_claimed_by_few(tmp_path, text):
    """Catches a format that takes whatever it is given."""
    path = tmp_path / "file"
    path.write_text(text)
    assert len(_claimed_by(path)) <= (text == "1\n")


def test_the_page_tells_every_format():
    """Catches a format without a section, and a `written` that is not true any more."""
    page = PAGE.read_text(encoding="utf-8")
    rows = {
        cells[1].strip().strip("`"): cells
        for line in page.splitlines()
        if len(cells := line.split("|")) == 7 and cells[1].strip().startswith("`")
    }
    assert set(rows) == set(NAMES)
    for name, cells in rows.items():
        module = MODULES[name]
        assert cells[2].strip() == module.NAME
        assert cells[3].strip().strip("`") == getattr(module, "SUFFIX", "")
        assert cells[4].strip() == ", ".join(f"`{option}`" for option in module.OPTIONS)
    sections = [line.lower() for line in page.splitlines() if line.startswith("## ")]
    for module in MODULES.values():
        assert any(module.NAME.lower().split()[0] in section for section in sections), module.NAME


def test_recognise_is_the_same_door(tmp_path):
    """Catches a file that is read by another format than the one that is named."""
    for file in make_whole_files(tmp_path).values():
        assert recognise(file.path) is MODULES[file.module]
