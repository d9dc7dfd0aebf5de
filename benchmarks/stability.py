"""Numerical stability of models, BSDFs and light: worst errors where formulas break.

The parts can be run alone: light_stability_precision (every model in double and single precision against 50
digits), light_stability_points (evaluators of light at pixels' centres against 50 digits) and
light_stability_light (every method of light in other units, at degenerate poses, far from the origin).
`python -m benchmarks.stability_page` sets what they print as `docs/stability.md`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from benchmarks.parts import run_parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

PARTS = ("light_stability_precision", "light_stability_points", "light_stability_light")
"""Modules beside this one."""


def run(plots: Path | None) -> Iterator[dict[str, Any]]:
    """Run all parts; see the module."""
    return run_parts("stability", PARTS, plots)
