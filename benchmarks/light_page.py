"""Writes `docs/light.md` from what `gonio bench light --json --plots docs/light` printed.

    gonio bench light --json --plots docs/light > numbers.json
    python -m benchmarks.light_page docs numbers.json [MORE.json ...]

Results of parts that were run alone can be given side by side.
"""

from __future__ import annotations

import json
import sys
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulator.light.methods import METHODS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_HEAD = """# The twin's light: error against time

Written by `python -m benchmarks.light_page docs numbers.json` from what `gonio bench light --json --plots
docs/light` printed. Errors are RMS over the sample's pixels relative to their mean radiance. How methods are
chosen, and what they leave out, is in [decision 5](decisions/0005-light-methods.md); what is computed for a
scene of yours, and how much each kind of light is, is told by

    gonio sim --explain --material cook-torrance:kd=0.3,ks=0.5,m=0.2,ior=1.5 --housing-albedo 0.04
    gonio sim --stray --material lambert:kd=0.05 --housing-albedo 0.04

and what the twin itself computes is set by `gonio sim --housing-albedo A --tolerance T`. Times of the choice
and of the demo are processor times; the others are by the clock, on a machine that was busy: trust ratios.
"""

_FIGURES = {
    "light_chooser": (
        "light/light_chooser.png",
        "Scenes drawn from a seed: every way to compute each, and the chosen one in a ring",
    ),
    "light_direct": ("light/light_direct.png", "Direct light: quadrature and Mitsuba's direct"),
    "light_housing": ("light/light_housing.png", "Stray light: radiosity and path tracing"),
}

_TITLES = {
    "light_chooser": "The choice of methods",
    "light_demo": "The demo",
    "light_modes": "Both modes of Mitsuba",
    "light_direct": "Direct light",
    "light_housing": "Stray light of a housing",
    "light_mirror": "A mirror beside the sample",
    "light_bsdfs": "Models in single precision against their closed forms",
}


def page(results: Sequence[dict[str, Any]], folder: Path) -> str:
    """Set rows of `gonio bench` as a page."""
    return "\n".join([*_methods(), *_sections(results, folder), *_verdict(results)])


def _methods() -> Iterator[str]:
    yield _HEAD
    yield "| method | light paths that it can compute |"
    yield "| --- | --- |"
    for method in METHODS:
        expression = str(method.covers).replace("|", "\\|")
        yield f"| {method.name} | `{expression}` |"
    yield ""


def _sections(results: Sequence[dict[str, Any]], folder: Path) -> Iterator[str]:
    for part, rows in groupby(results, key=lambda row: row["name"].partition(": ")[0]):
        yield f"## {_TITLES.get(part, part)}\n"
        figure, caption = _FIGURES.get(part, ("", ""))
        if figure and (folder / figure).exists():
            yield f"![{caption}]({figure})\n"
        yield "| what | value | target | |"
        yield "| --- | --- | --- | --- |"
        for row in rows:
            yield _row(row)
        yield ""


def _row(row: dict[str, Any]) -> str:
    value = "-" if row["value"] is None else f"{row['value']:.4g}"
    if row["target"] is None:
        return f"| {_label(row)} | {value} {row['unit']} | | |"
    verdict = "met" if row["ok"] else "**missed**"
    return f"| {_label(row)} | {value} {row['unit']} | {row['target']:g} | {verdict} |"


def _label(row: dict[str, Any]) -> str:
    return str(row["name"].partition(": ")[2]).replace("|", "\\|")


def _verdict(results: Sequence[dict[str, Any]]) -> Iterator[str]:
    stated = [row for row in results if row["target"] is not None]
    yield f"{sum(row['ok'] for row in stated)} of {len(stated)} targets are met.\n"


def main() -> int:
    """Write the page into a folder."""
    if len(sys.argv) < 3:
        print(__doc__)
        return 2
    folder, given = Path(sys.argv[1]), [Path(path) for path in sys.argv[2:]]
    results = [
        _named(row, path.stem) for path in given for row in json.loads(path.read_text("utf-8"))["results"]
    ]
    (folder / "light.md").write_text(page(results, folder), "utf-8")
    return 0


def _named(row: dict[str, Any], part: str) -> dict[str, Any]:
    """Name rows of a part that was run alone as those of the whole run are."""
    return row if row["name"].partition(":")[0] in _TITLES else {**row, "name": f"{part}: {row['name']}"}


if __name__ == "__main__":
    sys.exit(main())
