"""Every reader against damaged files: how many answers are wrong, and how long the slowest takes.

The damages and what may be answered to them are those of the tests (`tests/analysis/damages.py`): one line
that names the file, or a correct read. The reader is a process of its own, with 1 GB of memory.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.rows import row
from gonio.output import say
from tests.analysis.test_damaged import Reader, answers
from tests.analysis.whole_files import Whole, make_merl, make_whole_files

if TYPE_CHECKING:
    from collections.abc import Iterator

RAW = Path(__file__).resolve().parents[2] / "shared" / "data" / "rt300s" / "raw" / "blank_20250829.xls"
DAMAGES = 1000
SLOWEST_S = 2.0


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Damage each format's file; see the module."""
    del plots
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = {**make_whole_files(folder), "merl": make_merl(folder)}
        if RAW.is_file():
            files["xls"] = Whole(RAW, "rt300s", binary=True)
        reader = Reader()
        try:
            for label, file in files.items():
                yield from _file_rows(reader, label, file, folder / "damaged")
        finally:
            reader.stop()


def _file_rows(reader: Reader, label: str, file: Whole, path: Path) -> list[dict[str, Any]]:
    say(f"  {label}: {DAMAGES} damages")
    found = list(answers(reader, file, path, DAMAGES))
    for _, complaint in found:
        if complaint:
            say(f"    {complaint}")
    wrong, slowest = sum(bool(complaint) for _, complaint in found), max(seconds for seconds, _ in found)
    return [
        row(f"{label}: wrong answers to {len(found)} damages", wrong, "", 0.0),
        row(f"{label}: slowest answer, processor time", slowest, "s", SLOWEST_S),
    ]
