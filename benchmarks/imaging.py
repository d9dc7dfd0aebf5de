"""Every number that images are held to, part by part.

The parts can be run alone: imaging_merge (error against light, beside the Cramer-Rao bound), imaging_ratios
(exposure times that are wrong), imaging_flea3 (a real camera), imaging_peers (other programs' merges),
imaging_speed (time and memory), imaging_sensor (a sensor from its own frames), imaging_exposure (brackets),
imaging_coverage (intervals of drawn sessions), imaging_sessions (of rendered ones), imaging_corrections
(drift, stray light, flat field, bend).
`benchmarks/imaging_page.py` sets what they print into docs/accuracy.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from benchmarks.parts import run_parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

EXPECTED_S = {
    "imaging_merge": 15.0,
    "imaging_ratios": 10.0,
    "imaging_flea3": 5.0,
    "imaging_peers": 12.0,
    "imaging_speed": 90.0,
    "imaging_sensor": 120.0,
    "imaging_exposure": 60.0,
    "imaging_coverage": 300.0,
    "imaging_sessions": 40.0,
    "imaging_corrections": 60.0,
}
"""Modules beside this one, and the seconds that each takes on a quiet machine."""

PARTS = tuple(EXPECTED_S)


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Run all parts; see the module."""
    return run_parts("imaging", PARTS, plots, EXPECTED_S)
