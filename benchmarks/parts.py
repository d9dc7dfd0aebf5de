"""A benchmark made of parts that can also be run alone."""

from __future__ import annotations

import importlib
import time
from typing import TYPE_CHECKING, Any

from gonio.output import say

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path


def run_parts(
    title: str, parts: Sequence[str], plots: Path | None, expected_s: Mapping[str, float] | None = None
) -> Iterator[dict[str, Any]]:
    """Run modules of this folder, and give the rows of each as soon as it is done, named after it.

    Parameters
    ----------
    title : str
        What all of them measure.
    parts : sequence of str
        The modules, in their order.
    plots : Path or None
        Folder for figures.
    expected_s : mapping of str to float, optional
        By module, the seconds that it takes on a quiet machine: what is left is then told, at the pace of the
        parts that are done.
    """
    begin = time.monotonic()
    for number, part in enumerate(parts, start=1):
        passed = time.monotonic() - begin
        left = "" if expected_s is None else _left(parts, number - 1, passed, expected_s)
        say(f"{title}, part {number} of {len(parts)}: {part}, after {passed:.0f} s{left}")
        for row in importlib.import_module(f"benchmarks.{part}").run(plots):
            yield {**row, "name": f"{part}: {row['name']}"}


def _left(parts: Sequence[str], done: int, passed_s: float, expected_s: Mapping[str, float]) -> str:
    """Predict what is left, at the pace of the parts that are done."""
    before, after = (sum(expected_s[part] for part in some) for some in (parts[:done], parts[done:]))
    pace = passed_s / before if before > 0.0 else 1.0
    return f", about {max(after * pace / 60.0, 1.0):.0f} min left"
