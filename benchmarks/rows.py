"""The rows that parts return to `gonio bench`."""

from __future__ import annotations

from typing import Any


def row(
    name: str, value: float, unit: str = "", target: float | None = None, *, at_least: bool = False
) -> dict[str, Any]:
    """Make a row.

    Parameters
    ----------
    name : str
        What was measured.
    value : float
        The number; NaN misses any target.
    unit : str
        Its unit; empty for a ratio.
    target : float, optional
        The bound; None for information only.
    at_least : bool
        Whether the target is the least allowed, not the most.
    """
    met = target is None or (value >= target if at_least else value <= target)
    return {"name": name, "value": float(value), "unit": unit, "target": target, "ok": bool(met)}
