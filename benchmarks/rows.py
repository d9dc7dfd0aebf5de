"""The rows that parts return to `gonio bench`."""

from __future__ import annotations

import json
import textwrap
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence
    from pathlib import Path

_COLUMNS = 110


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


def gathered(paths: Sequence[Path], parts: Container[str]) -> list[dict[str, Any]]:
    """Read results from JSON; a file named after a part takes that part's place.

    Parameters
    ----------
    paths : sequence of Path
        What `gonio bench ... --json` printed.
    parts : container of str
        The parts' names.
    """
    results: list[dict[str, Any]] = []
    for path in paths:
        rows = json.loads(path.read_text("utf-8"))["results"]
        if path.stem in parts:
            results = [each for each in results if not str(each["name"]).startswith(f"{path.stem}: ")]
            rows = [{**each, "name": f"{path.stem}: {each['name']}"} for each in rows]
        results += rows
    return results


def sections(
    results: Sequence[dict[str, Any]],
    titles: Mapping[str, tuple[str, str, tuple[str, str] | None]],
    folder: str,
) -> list[str]:
    """Set rows, named `part: name`, as a section of a page for each part that was run.

    Parameters
    ----------
    results : sequence of dict
        The rows.
    titles : mapping
        By part: its heading, what it does, and the file and caption of its figure.
    folder : str
        Where the figures lie, beside the page.
    """
    lines = [met(results), ""]
    for part, (title, text, picture) in titles.items():
        own = [
            {**each, "name": name}
            for each in results
            for of, _, name in [str(each["name"]).partition(": ")]
            if of == part
        ]
        if own:
            lines += [f"## {title}", "", *textwrap.wrap(f"`gonio bench {part}`. {text}", _COLUMNS), ""]
            lines += [f"![{picture[1]}]({folder}/{picture[0]})", ""] if picture else []
            lines += [*table(own), ""]
    return lines
