"""Every reader against damaged files: how many answers are wrong, and how long the slowest takes.

The damages and what may be answered to them are those of the tests (`tests/analysis/damages.py`): one line
that names the file, or a correct read. The reader is a process of its own, with 1 GB of memory. Large files,
a MERL table and a raw `.xls`, get fewer.
"""

from __future__ import annotations

import tempfile
import zlib
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

from benchmarks.rows import row
from gonio.output import say
from tests.analysis.damages import BINARY_DAMAGES, text_damages
from tests.analysis.test_damaged import Reader, complaint_of
from tests.analysis.whole_files import Whole, make_merl, make_whole_files

if TYPE_CHECKING:
    from collections.abc import Iterator

RAW = Path(__file__).resolve().parents[2] / "shared" / "data" / "rt300s" / "raw" / "blank_20250829.xls"
DAMAGES, OF_LARGE = 1000, 60
LARGE_BYTES = 1_000_000
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
    count = OF_LARGE if file.path.stat().st_size > LARGE_BYTES else DAMAGES
    say(f"  {label}: {count} damages")
    intact, whole = file.path.read_bytes(), reader(file.path)
    damages = BINARY_DAMAGES if file.binary else text_damages(file.separator)
    random = Random(zlib.crc32(file.path.name.encode()))  # noqa: S311 - seeded on purpose
    wrong, made, slowest = 0, 0, 0.0
    for index in range(count):
        damage = damages[index % len(damages)]
        content = damage.change(intact, random)
        if content == intact:
            continue
        path.write_bytes(content)
        answer = reader(path)
        made += 1
        slowest = max(slowest, answer[3])
        complaint = complaint_of(file, damage, content, whole, answer)
        wrong += bool(complaint)
        if complaint:
            say(f"    {index} {damage.name}: {complaint}")
    return [
        row(f"{label}: wrong answers to {made} damages", wrong, "", 0.0),
        row(f"{label}: slowest answer, processor time", slowest, "s", SLOWEST_S),
    ]
