"""Checks of single values: negative and missing ones, a floor or a ceiling that somebody put there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.checks.finding import Finding, judged, place

if TYPE_CHECKING:
    import xarray as xr

    from analysis.pairing import Array, Usable

FEWEST_EQUAL = 3


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


def missing(samples: xr.Dataset) -> Finding:
    """Count values that are no numbers, and that no flag explains."""
    values, flags = samples["f_r"].to_numpy(), samples["flags"].to_numpy()
    lost = ~np.isfinite(values) & (flags == 0)
    rows = np.flatnonzero(lost.any(axis=1))
    return judged(
        "missing values",
        "share of values that are no numbers, without a flag",
        float(lost.mean()) if lost.size else 0.0,
        (0.0, 0.5),
        int(lost.sum()),
        meaning="something went wrong before the file was written: they are left out of everything",
        where=f"sample {rows[0]}" if rows.size else "",
        samples=rows,
    )


def clipped(samples: xr.Dataset) -> Finding:
    """Count values, flagged ones too, that equal their channel's smallest or largest: a floor, a ceiling."""
    values = samples["f_r"].to_numpy()
    names = [str(name) for name in samples["channel"].to_numpy()]
    share, count, where, rows = 0.0, 0, "", np.zeros(0, dtype=np.intp)
    bound = ""
    for channel, column in enumerate(values.T):
        finite = column[np.isfinite(column)]
        for end, limit in (("floor", finite.min(initial=np.inf)), ("ceiling", finite.max(initial=-np.inf))):
            equal = np.flatnonzero(column == limit)
            if len(equal) / max(len(finite), 1) > share and _is_end(finite, limit, len(equal)):
                share, count, rows = len(equal) / len(finite), len(equal), equal
                bound, where = f"a {end} of {limit:g}", f"channel {names[channel]}, f_r = {limit:g}"
    return judged(
        "clipped values",
        "share of a channel's values that equal its smallest, or its largest",
        share,
        (0.01, 0.20),
        count,
        meaning=f"values were clipped at {bound}, or a model ends there: what lies beyond is lost",
        where=where,
        samples=rows,
    )


def _is_end(finite: Array, limit: float, count: int) -> bool:
    """Whether equal values are an end that somebody put there.

    One is the smallest or largest, two may be a pair. A constant is a model, not a clipped measurement; but
    nothing reflects nothing at all.
    """
    return count >= FEWEST_EQUAL and (bool(np.any(finite != limit)) or limit == 0.0)
