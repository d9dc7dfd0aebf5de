"""The page of other laboratories' numbers: catches rows lost, doubled, or under another part's heading."""

from __future__ import annotations

import json
from types import SimpleNamespace

from benchmarks import data, parts
from benchmarks.data_page import TITLES, gathered, page


def _row(name, value, target=None, *, ok=True):
    return {"name": name, "value": value, "unit": "%", "target": target, "ok": ok}


def test_every_part_has_a_section():
    """Catches a part whose rows the page leaves out."""
    assert set(TITLES) == set(data.PARTS)
    text = page([_row(f"{part}: number of it", 1.0, 2.0) for part in TITLES])
    assert text.count("| number of it | 1 % | 2 | met |") == len(TITLES)
    assert f"{len(TITLES)} of {len(TITLES)} targets are met." in text


def test_a_part_that_was_run_again_takes_its_place(tmp_path):
    """Catches old numbers beside new ones, and a miss that does not show."""
    whole, again = tmp_path / "numbers.json", tmp_path / "data_rgl.json"
    old = [_row("data_rgl: error", 5.0, 1.0, ok=False), _row("data_mwir: cosine", 40.0)]
    whole.write_text(json.dumps({"results": old}))
    again.write_text(json.dumps({"results": [_row("|error|", 3.0, 1.0, ok=False)]}))
    text = page(gathered([whole, again], TITLES))
    assert "| \\|error\\| | 3 % | 1 | **missed** |" in text
    assert "5 %" not in text
    assert "| cosine | 40 % |  |  |" in text
    assert "0 of 1 targets are met." in text


def test_what_is_left_is_told(monkeypatch, capsys):
    """Catches a benchmark of many minutes that does not say how many, or promises too few."""
    seconds = iter([0.0, 0.0, 120.0])
    monkeypatch.setattr(parts, "time", SimpleNamespace(monotonic=lambda: next(seconds)))
    module = SimpleNamespace(run=lambda _: [_row("number", 1.0)])
    monkeypatch.setattr(parts, "importlib", SimpleNamespace(import_module=lambda _: module))
    rows = list(parts.run_parts("data", ("quick", "slow"), None, {"quick": 60.0, "slow": 300.0}))
    assert [row["name"] for row in rows] == ["quick: number", "slow: number"]
    first, second = capsys.readouterr().err.splitlines()
    assert first.endswith("quick, after 0 s, about 6 min left")
    # The first took twice as long as expected: so will the second.
    assert second.endswith("slow, after 120 s, about 10 min left")
