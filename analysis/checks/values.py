"""Checks of single values: negative ones, and a floor that somebody put there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.checks.finding import Finding, judged, place

if TYPE_CHECKING:
    import xarray as xr

    from analysis.pairing import Usable


def negatives(usable: Usable) -> Finding:
    """Count values below zero."""
    negative = usable.f_r < 0.0
    share = float(negative.mean()) if negative.size else 0.0
    lowest = int(np.argmin(usable.f_r.min(axis=1))) if negative.any() else 0
    return judged(
        "negatives",
        "share of negative values",
        share,
        (0.001, 0.10),
        int(np.count_nonzero(negative)),
        meaning="noise about a dark sample, or too much was subtracted: keep them, with their uncertainty",
        where=place(usable, lowest) if negative.any() else "",
        samples=usable.row[negative.any(axis=1)],
    )


def clipped(samples: xr.Dataset) -> Finding:
    """Count values that all equal the smallest: a floor that somebody put there. Flagged ones count."""
    values = samples["f_r"].to_numpy()
    finite = values[np.isfinite(values)]
    floor = float(finite.min()) if finite.size else 0.0
    count = int(np.count_nonzero(finite == floor))
    # One smallest value is no floor, and a constant is a model, not a clipped measurement.
    clipped_count = count if count >= 3 and np.any(finite != floor) else 0
    return judged(
        "clipped values",
        "share of values that equal the smallest",
        clipped_count / max(finite.size, 1),
        (0.01, 0.20),
        clipped_count,
        meaning=f"values were clipped at {floor:g}, or a model ends there: dark samples may be biased",
        where=f"f_r = {floor:g}",
        samples=np.flatnonzero((values == floor).any(axis=1)) if clipped_count else None,
    )
