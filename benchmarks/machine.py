"""What the machine is held to, part by part, on the twin.

The parts can be run alone: machine_overheads (time beyond motion and exposure), machine_stops (every cause of
a stop, to the last byte on the wire), soak (a night with every fault), machine_clearance (moves past the
solids, checked by other code; a dry run). All of them take about three quarters of an hour.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from benchmarks.parts import run_parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

EXPECTED_S = {
    "machine_overheads": 15.0,
    "machine_stops": 420.0,
    "soak": 600.0,
    "machine_clearance": 900.0,
}
"""Modules beside this one, quick ones first, and the seconds that each takes on a quiet machine."""

PARTS = tuple(EXPECTED_S)


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Run all parts; see the module."""
    return run_parts("machine", PARTS, plots, EXPECTED_S)
