"""The page of faults: every kind of the twin's has a row, and every row a test that is there."""

from __future__ import annotations

import re
from pathlib import Path

from simulator.faults import _DEFAULTS, FaultKind

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| (.+) \|$", re.MULTILINE)


def rows(heading: str) -> list[list[str]]:
    """Read the cells of a table, without its head: that of the section with this heading."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    return [line.split(" | ") for line in ROW.findall(section)][2:]


def test_every_kind_of_fault_has_one_row_with_its_fields() -> None:
    """Catches a kind that nobody can look up, or a field that the page does not name."""
    named = [(re.findall(r"`([\w-]+)`", cells[0]), cells) for cells in rows("Faults on the twin")]
    table = {kind: cells for kinds, cells in named for kind in kinds}
    assert table.keys() == set(FaultKind)
    assert sum(len(kinds) for kinds, _ in named) == len(table)
    shared = {"line", "direction", "count"}  # a row may say "the same" of them
    for kind, fields in _DEFAULTS.items():
        said = table[kind][1]
        for name in fields.keys() - (shared if "the same" in said else set()):
            assert f"`{name}" in said, f"{kind}: {name}"


def test_every_row_names_a_test_that_is_there() -> None:
    """Catches a promise that nothing holds the program to, or a proof that was renamed."""
    for heading in ("What the program does", "Stops", "The servo bus", "Faults on the twin"):
        for cells in rows(heading):
            proofs = re.findall(r"`(test_\w+\.py)::(test_\w+)`", cells[-1])
            assert proofs, cells[0]
            for file, name in proofs:
                texts = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob(file)]
                assert any(f"def {name}(" in text for text in texts), f"{file}::{name}"
