"""The rows that parts return to `gonio bench`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


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


def table(results: Iterable[dict[str, Any]]) -> list[str]:
    """Set rows as a table of a Markdown page, a line each."""
    lines = ["| what | value | target | |", "| --- | --- | --- | --- |"]
    for each in results:
        value = "-" if each["value"] is None else f"{each['value']:.4g}"
        target = "" if each["target"] is None else f"{each['target']:g}"
        verdict = "" if each["target"] is None else "met" if each["ok"] else "**missed**"
        name = str(each["name"]).replace("|", "\\|")
        lines.append(f"| {name} | {value} {each['unit']} | {target} | {verdict} |")
    return lines


def met(results: Sequence[dict[str, Any]]) -> str:
    """Say how many targets are met."""
    targets = [each for each in results if each["target"] is not None]
    return f"{sum(each['ok'] for each in targets)} of {len(targets)} targets are met."
