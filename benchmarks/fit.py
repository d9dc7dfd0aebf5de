"""Every number that the fits and their models are held to, part by part; `docs/models.md` keeps them.

The parts can be run alone: fit_plain (loss and time beside scipy), fit_factored (tables beside GGX),
fit_files (real files, bootstrap), nist_strd (certified problems), models (what the models promise, and their
digits), fit_coverage (how often intervals hold the truth), fit_optimum (random starts against the optimum
found). The last three take most of the time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from benchmarks.parts import run_parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

PARTS = ("fit_plain", "fit_factored", "fit_files", "nist_strd", "models", "fit_coverage", "fit_optimum")
"""Modules beside this one, quick ones first."""


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Run all parts; see the module."""
    return run_parts("fit", PARTS, plots)
