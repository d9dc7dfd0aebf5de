"""Every number that other laboratories' data are held to, part by part.

The parts can be run alone: data_rt300s (published tables from raw files, reading time, repeatability),
data_mwir (what `gonio check` says of the published cosine), doctor (conventions corrupted on purpose).
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from gonio.output import say

if TYPE_CHECKING:
    from pathlib import Path

PARTS = ("data_rt300s", "data_mwir", "doctor")
"""Modules beside this one, quick ones first."""


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Run all parts; see the module."""
    rows: list[dict[str, Any]] = []
    for number, part in enumerate(PARTS, start=1):
        say(f"data, part {number} of {len(PARTS)}: {part}")
        found = importlib.import_module(f"benchmarks.{part}").run(plots)
        rows += [{**row, "name": f"{part}: {row['name']}"} for row in found]
    return rows
