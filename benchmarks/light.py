"""Error against time of the twin's light, method by method.

The parts can be run alone: light_mirror (light thrown by a mirror), light_caustics (by a hollow one),
light_bsdfs (every model in single precision), light_housing (stray light), light_demo (the demo's light
against path tracing), light_modes (scalar and LLVM alike), light_direct (lamps, pixels and a pupil with
sizes), light_methods (every method in scenes that need different ones), light_chooser (the choice of methods
over scenes drawn from a seed).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from benchmarks.parts import run_parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

PARTS = (
    "light_mirror",
    "light_caustics",
    "light_bsdfs",
    "light_housing",
    "light_demo",
    "light_modes",
    "light_direct",
    "light_methods",
    "light_chooser",
)
"""Modules beside this one, quick ones first."""


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Run all parts; see the module."""
    return run_parts("light", PARTS, plots)
