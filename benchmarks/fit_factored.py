"""The factored model on 20 measured materials: how much better than GGX it fits, and how often it predicts.

A model with tens of parameters fits better than its start; whether it predicts incidences that it has not
seen better is another question, and the answer is not always yes. The loss is that of ln(1 + f cos theta_i).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.ranking import rank
from benchmarks.fit_plain import materials
from benchmarks.rows import row
from gonio.output import Progress

if TYPE_CHECKING:
    from pathlib import Path

RATIO_BAR = 0.55


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Fit both to every material; see the module."""
    del plots
    sets = materials()
    progress = Progress("materials", len(sets))
    fitted, left_out = [], []
    for name, samples in sets.items():
        found = {each.name: each for each in rank(samples, ["ggx", "factored"], loss="log")}
        pair = found["ggx"], found["factored"]
        fitted.append([each.result.metrics["rms_log"] for each in pair])
        left_out.append([each.cross_validation for each in pair])
        progress(note=name)
    ggx, factored = np.transpose(fitted)
    ratio = np.divide(*np.transpose(left_out)[::-1])
    better = float(np.sum(ratio < 1.0))
    return [
        row("factored: median RMS of ln(1 + f cos)", float(np.median(factored))),
        row("factored: median RMS over GGX's", float(np.median(factored) / np.median(ggx)), "x", RATIO_BAR),
        row("factored: RMS over GGX's, worst material", float(np.max(factored / ggx)), "x", 1.0),
        row("factored: RMS over GGX's at incidences left out, median material", float(np.median(ratio)), "x"),
        row("factored: RMS over GGX's at incidences left out, worst material", float(np.max(ratio)), "x"),
        row("factored: materials it predicts better than GGX", better, f"of {len(sets)}"),
    ]
