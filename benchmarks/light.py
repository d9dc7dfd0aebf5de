"""Error against time of the twin's light, method by method.

The parts can be run alone: light_mirror (light thrown by a mirror), light_bsdfs (every model in single
precision), light_housing (stray light), light_direct (lamps, pixels and a pupil with sizes).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from benchmarks.parts import run_parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

PARTS = ("light_mirror", "light_bsdfs", "light_housing", "light_direct")
"""Modules beside this one, quick ones first."""


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Run all parts; see the module."""
    return run_parts("light", PARTS, plots)
