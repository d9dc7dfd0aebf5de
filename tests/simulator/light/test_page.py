"""The page of the light hides nothing: what is missed, and what is nearest to its target, is named."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

from benchmarks.light import PARTS
from benchmarks.light_page import main, page
from benchmarks.rows import row
from simulator.light.methods import METHODS

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def rows() -> list[dict[str, Any]]:
    """Return rows of two parts: one missed, one of which more is better."""
    return [
        row("light_direct: error a|b", 3.0, "", 2.0),
        *(row(f"light_direct: error {n}", 0.1 * n, "", 1.0) for n in range(1, 9)),
        row("light_housing: speed", 40.0, "x", 20.0, at_least=True),
        row("light_housing: told", 7.0, "ms"),
    ]


def test_what_is_missed_comes_first_among_worst_cases() -> None:
    """Would catch a page on which a missed target is one row among hundreds."""
    text = page(rows())
    worst = text.split("## Worst cases")[1].split("\n## ")[0]
    assert "| light_direct: error a\\|b | 3  | 2 | 150 %, **missed** |" in worst
    assert "| light_direct: error 8 |" in worst
    assert "| light_direct: error 1 |" not in worst
    assert "| light_housing: speed | 40 x | 20 | 50 % |" in worst
    assert "told |" not in worst
    assert "9 of 10 targets are met." in text


def test_every_method_and_every_part_has_its_place() -> None:
    """Would catch a method that the table forgot, and a part that is measured but never shown."""
    text = page([row(f"{part}: value", 1.0, "", 2.0) for part in PARTS])
    assert all(f"\n| {method.name} | `" in text for method in METHODS)
    assert all(f"`gonio bench {part}`" in text for part in PARTS)


def test_a_part_that_was_run_alone_takes_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch old rows beside new ones."""
    whole, alone = tmp_path / "numbers.json", tmp_path / "light_housing.json"
    whole.write_text(json.dumps({"results": rows()}), "utf-8")
    alone.write_text(json.dumps({"results": [row("speed", 99.0, "x", 20.0, at_least=True)]}), "utf-8")
    monkeypatch.setattr(sys, "argv", ["light_page", str(tmp_path), str(whole), str(alone)])
    assert main() == 0
    text = (tmp_path / "light.md").read_text("utf-8")
    assert "| speed | 99 x | 20 | met |" in text
    assert "| speed | 40 x |" not in text
