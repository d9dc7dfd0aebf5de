"""A benchmark made of parts that can also be run alone."""

from __future__ import annotations

import importlib
import time
from typing import TYPE_CHECKING, Any

from gonio.output import say

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path


def run_parts(title: str, parts: Sequence[str], plots: Path | None) -> Iterator[dict[str, Any]]:
    """Run modules of this folder, and give the rows of each as soon as it is done, named after it."""
    begin = time.monotonic()
    for number, part in enumerate(parts, start=1):
        say(f"{title}, part {number} of {len(parts)}: {part}, after {time.monotonic() - begin:.0f} s")
        for row in importlib.import_module(f"benchmarks.{part}").run(plots):
            yield {**row, "name": f"{part}: {row['name']}"}
