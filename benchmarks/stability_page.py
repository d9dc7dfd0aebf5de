"""Sets what `gonio bench stability --json` printed as `docs/stability.md`.

    gonio bench stability --json > numbers.json
    python -m benchmarks.stability_page docs numbers.json [MORE.json ...]

Results of parts that were run alone can be given side by side; a later one replaces an earlier of its name.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from analysis.models import MODELS
from analysis.models.base import Kind
from benchmarks.light_stability import (
    ASIDE,
    COMBINATIONS,
    EXTREMES,
    degenerate_pairs,
    extreme_pairs,
    extreme_parameters,
)
from benchmarks.light_stability_points import FAINT, POSES, WIDTHS
from benchmarks.models_digits import STEEPEST_DEG
from benchmarks.models_energy import albedo, reciprocity
from simulator.variant import LLVM, SCALAR

ARITHMETICS = ("float64", LLVM, SCALAR)
EXACT = "relative"
STEEPEST_REPORTED_DEG, GRAZING_REPORTED_DEG = 85.0, 89.0

_PARAMETERS = sum(1 for model in MODELS.values() for _ in extreme_parameters(model))

_HEAD = f"""# Numerical stability

Written by `python -m benchmarks.stability_page docs numbers.json` from what `gonio bench stability --json`
printed. Numbers are the largest relative errors that were met; each has a bound, which the tests assert.

## Models and BSDFs

Every model of `analysis/models` in double precision, and the same models as BSDFs of Mitsuba in single
precision, vectorised (`{LLVM}`) and one by one (`{SCALAR}`), against the formulas as their sources print
them in 50 digits (`benchmarks/models_exact.py`). {len(extreme_pairs().wi)} pairs of directions (about the
mirror direction and about the light by {ASIDE[1]:g} to {ASIDE[-1]:g}, any others, each up to
{STEEPEST_DEG} degrees) times {_PARAMETERS} sets of parameters: widths from {min(WIDTHS):g} to
{max(WIDTHS):g}, exponents that belong to them, indices from {min(EXTREMES["ior"])} to
{max(EXTREMES["ior"])} and complex ones, shares and F0 from 0 to 1, other parameters at the bounds of a fit;
one at a time and in {COMBINATIONS} combinations for each model; each scale 0 or 1. In double precision all
values above 1e-290 count, in single precision those above 1e-6 of the light's peak.

*Excepted*: where a difference in the formula itself comes out below a tenth of its terms (see
[models](models.md#digits)), in double precision. *Wrong*: of {len(degenerate_pairs().wi)} degenerate pairs
(wi = -wo, wi = wo = n, directions in the surface, 1e-30 above it, and below it) and of all pairs with every
scale 0, how many values are no number, or not 0 where nothing can be reflected; all arithmetics together.
"""

_LIGHT = f"""
## Light

The upper rows: evaluators at pixels' centres (point lamp, pinhole) against the radiance in 50 digits, facets
of width m on a diffuse base, through a lens so long that a lobe spreads over the frame; pixels above
{FAINT:g} of the brightest, the worst of {len(POSES)} poses, named: grazing, mirrored, with wi = wo. The
bounds of narrow lobes are those that the last digit of a direction causes. The lower rows: every method of
the table in scenes that need it (flat, tilted, a mirror, a housing), with all lengths multiplied, which must
change nothing; and values that are no numbers, negative, or not 0 where no light can be.

| what | measured | bound |
| --- | --- | --- |
"""


_FAILURES = """
## What no arithmetic mends

Models that are not reciprocal as published, or create light: largest difference of f(L, E) and f(E, L) over
the larger of both, default shape, up to {steepest:.0f} degrees; and the directional albedo of their specular
term at {grazing:.0f} degrees of incidence where it is 1/2 at the normal. The BSDFs show the same
(`tests/simulator/test_bsdfs.py`); of all other models see [models](models.md).

| model | not reciprocal by | albedo at {grazing:.0f} degrees |
| --- | --- | --- |"""


def failures() -> str:
    """Set the section of models that break the laws of light, measured now."""
    lines = [_FAILURES.format(steepest=STEEPEST_REPORTED_DEG, grazing=GRAZING_REPORTED_DEG)]
    for name, model in MODELS.items():
        if model.RECIPROCAL:
            continue
        shape = {p.name: p.default for p in model.PARAMETERS if p.kind is Kind.SHAPE}
        half = 0.5 / albedo(model(kd=0.0, ks=1.0, **shape), 0.0)
        grazing = albedo(model(kd=0.0, ks=half, **shape), GRAZING_REPORTED_DEG)
        lines.append(f"| {name} | {reciprocity(model, 0, STEEPEST_REPORTED_DEG):.3g} | {grazing:.3g} |")
    return "\n".join([*lines, ""])


def page(results: list[dict[str, Any]]) -> str:
    """Set rows of `gonio bench`, whose names begin with their part's or do not, as the page."""
    rows = {_plain(result["name"]): result for result in results}
    lines = [_HEAD, _head_of_models()]
    lines += [_line_of(name, rows) for name in MODELS]
    light = [name for name in rows if name.split(", ")[0] not in MODELS]
    lines.append(
        _LIGHT + "\n".join(f"| {name} | {_number(rows[name])} | {_bound(rows[name])} |" for name in light)
    )
    lines.append(failures())
    held = sum(result["ok"] for result in rows.values())
    lines.append(f"{held} of {len(rows)} bounds hold.\n")
    return "\n".join(lines)


def _plain(name: str) -> str:
    """Return a row's name without its part's."""
    return name.split(": ", 1)[1] if name.startswith("light_stability") else name


def _head_of_models() -> str:
    heads = "".join(f" {arithmetic} | bound |" for arithmetic in ARITHMETICS)
    return f"| model |{heads} excepted | wrong |\n" + "| --- " * (2 * len(ARITHMETICS) + 3) + "|"


def _line_of(name: str, rows: dict[str, dict[str, Any]]) -> str:
    found = [rows.get(f"{name}, {arithmetic}") for arithmetic in ARITHMETICS]
    cells = "".join(f" {_number(each)} | {_bound(each)} |" for each in found)
    excepted = rows.get(f"{name}, {ARITHMETICS[0]}, excepted")
    wrong = sum(
        int(result["value"])
        for title, result in rows.items()
        if title.startswith(f"{name}, ") and result["unit"] != EXACT
    )
    return f"| {name} |{cells} {_number(excepted)} | {wrong} |"


def _number(result: dict[str, Any] | None) -> str:
    if result is None:
        return "-"
    text = f"{result['value']:.1e}" if result["unit"] == EXACT else f"{result['value']:.0f} wrong"
    return text if result["ok"] else f"**{text}**"


def _bound(result: dict[str, Any] | None) -> str:
    return "-" if result is None else f"{result['target']:.1e}"


def main() -> int:
    """Write the page into the folder named on the command line."""
    if len(sys.argv) < 3:
        print(__doc__)
        return 2
    results = [row for path in sys.argv[2:] for row in json.loads(Path(path).read_text("utf-8"))["results"]]
    (Path(sys.argv[1]) / "stability.md").write_text(page(results), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
