"""Mid-infrared tables of another laboratory: what the checks say of the cosine in its published formula.

For each material the reciprocity of the published values and of those without their extra cosine, and the
emissivity measured apart from them against 1 - albedo, where the samples allow an albedo.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.checks import check
from analysis.checks.emissivity import emissivity, read_emissivity
from analysis.checks.finding import Verdict
from analysis.pairing import usable_samples
from analysis.samples import read
from benchmarks.rows import row
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr

    from analysis.checks.finding import Finding

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data" / "mwir"
RADIANCE, EMISSIVITY = FOLDER / "radiance.csv", FOLDER / "emissivity.csv"


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Check every material; see the module.

    Raises
    ------
    BadInput
        If the data are not at hand.
    """
    del plots
    if not RADIANCE.is_file():
        raise BadInput("the shared measurements are not at hand", where=str(FOLDER), todo="put them there")
    return [*reciprocity_rows(), *emissivity_rows()]


def reciprocity_rows() -> list[dict[str, Any]]:
    """Compare the published values with those without the cosine."""
    rows, caught, cured = [], [], []
    for material in materials():
        published = _reciprocity(read(RADIANCE, material=material, as_published=True))
        plain = _reciprocity(read(RADIANCE, material=material))
        caught.append(published.verdict is Verdict.FAIL and "cos" in published.meaning)
        cured.append(plain.verdict is not Verdict.FAIL)
        rows += [
            row(f"{material}: reciprocity as published, median", 100.0 * published.value, "%"),
            row(f"{material}: reciprocity without the cosine, median", 100.0 * plain.value, "%"),
        ]
    return [
        row(
            "published values that fail for their cosine", 100.0 * np.mean(caught), "%", 100.0, at_least=True
        ),
        row("values without it that do not fail", 100.0 * np.mean(cured), "%", 100.0, at_least=True),
        *rows,
    ]


def emissivity_rows() -> list[dict[str, Any]]:
    """Count the materials whose emissivity is compared with 1 - albedo, and those where that is refused."""
    compared, refused = 0, 0
    for material in materials():
        known = read_emissivity(str(EMISSIVITY), EMISSIVITY, material)
        found = emissivity(usable_samples(read(RADIANCE, material=material)), known)
        compared += found.verdict is not Verdict.NOT_TESTED
        refused += found.verdict is Verdict.NOT_TESTED and bool(found.meaning)
    return [
        row("materials whose emissivity is compared with 1 - albedo", compared),
        row("materials where coverage does not allow it, and why is told", refused),
        row("materials in all", compared + refused, "", len(materials()), at_least=True),
    ]


def materials() -> list[str]:
    """Names of the materials in the table, in their order."""
    with RADIANCE.open(encoding="utf-8", newline="") as stream:
        return list(dict.fromkeys(line["material"] for line in csv.DictReader(stream)))


def _reciprocity(samples: xr.Dataset) -> Finding:
    return next(finding for finding in check(samples) if finding.name == "reciprocity")
