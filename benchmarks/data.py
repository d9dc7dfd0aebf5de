"""Every number that other laboratories' data are held to, part by part.

The parts can be run alone: data_rt300s (published tables from raw files, reading time, repeatability),
data_mwir (what `gonio check` says of the published cosine), data_rgl (tables for renderers), doctor
(conventions corrupted on purpose).
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from gonio.output import say

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

PARTS = ("data_rt300s", "data_mwir", "data_rgl", "doctor")
"""Modules beside this one, quick ones first."""


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Run all parts, and give the rows of each as soon as it is done; see the module."""
    for number, part in enumerate(PARTS, start=1):
        say(f"data, part {number} of {len(PARTS)}: {part}")
        for row in importlib.import_module(f"benchmarks.{part}").run(plots):
            yield {**row, "name": f"{part}: {row['name']}"}
