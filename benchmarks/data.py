"""Every number that other laboratories' data are held to, part by part.

The parts can be run alone: data_rt300s (published tables from raw files, reading time, repeatability),
data_mwir (what `gonio check` says of the published cosine, emissivity), data_exchange (which format claims
which file, Radiance's own tools), data_rgl (tables for renderers), data_readers (texts at their size limit),
data_damaged (damaged files), doctor (conventions corrupted on purpose). All of them take about half an hour;
`benchmarks/data_page.py` sets what they print into docs/data.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from benchmarks.parts import run_parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

EXPECTED_S = {
    "data_rt300s": 15.0,
    "data_mwir": 60.0,
    "data_exchange": 10.0,
    "data_rgl": 200.0,
    "data_readers": 120.0,
    "data_damaged": 600.0,
    "doctor": 300.0,
}
"""Modules beside this one, quick ones first, and the seconds that each takes on a quiet machine."""

PARTS = tuple(EXPECTED_S)


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Run all parts; see the module."""
    return run_parts("data", PARTS, plots, EXPECTED_S)
