"""A fit as scripts get it: one plain object with everything; its keys are documented in docs/fit.md."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.factored_fit import FactoredFit
from analysis.intervals import profile_intervals
from analysis.ranking import data_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import xarray as xr

    from analysis.comparison import Candidate
    from analysis.differences import Difference
    from analysis.fit import FitResult
    from analysis.ranking import AnyFit

MOST_CHANNELS = 4
"""Channels up to which kd and ks have profile intervals: with dozens they take minutes."""


def masked(whole: xr.Dataset, chosen: xr.Dataset, result: AnyFit) -> dict[str, int]:
    """Count the data that do not count in a fit, by reason.

    Parameters
    ----------
    whole, chosen : xarray.Dataset
        Samples of the chosen channels, and those of them within the largest angle.
    result : FitResult or FactoredFit
        A fit of the chosen samples.
    """
    f_r = chosen["f_r"].to_numpy()
    lowest = np.minimum(chosen["wi"].to_numpy()[:, 2], chosen["wo"].to_numpy()[:, 2])
    reasons = {
        "flagged": chosen["flags"].to_numpy() != 0 if "flags" in chosen else np.zeros(f_r.shape, dtype=bool),
        "below_horizon": np.broadcast_to(lowest[:, None] <= 0.0, f_r.shape),
        "without_value": ~np.isfinite(f_r),
    }
    counts = {"beyond_max_theta": (whole.sizes["sample"] - chosen.sizes["sample"]) * f_r.shape[1]}
    told = np.zeros(f_r.shape, dtype=bool)
    for reason, data in reasons.items():
        counts[reason] = int((data & ~told).sum())
        told |= data
    used = int(data_of(result)[1].used.sum())
    counts["without_uncertainty"] = int((~told).sum()) - used
    counts["gross_error"] = used - result.count
    return counts


def entry(
    file: str, channels: Sequence[str], candidate: Candidate, left: Mapping[str, int]
) -> dict[str, Any]:
    """Describe one fit; a parameter that channels do not share is a list by channel."""
    result = candidate.result
    own = _of_tables(result) if isinstance(result, FactoredFit) else _of_parameters(result, channels)
    return {
        "file": file,
        "model": result.model.NAME,
        "loss": result.loss,
        "channels": list(channels),
        "count": result.count,
        "masked": dict(left),
        **own,
        "metrics": result.metrics,
        "cross_validation": candidate.cross_validation,
        "cross_validation_folds": np.sqrt(candidate.squares),
        "bic": candidate.bic,
        "cautions": [
            {"kind": each.kind.value, "parameters": each.parameters, "text": each.text}
            for each in result.cautions
        ],
        "message": result.message,
    }


def _of_parameters(result: FitResult, channels: Sequence[str]) -> dict[str, Any]:
    intervals = profile_intervals(result, scales=len(channels) <= MOST_CHANNELS)
    of = [name if c is None else f"{name} {channels[c]}" for name, c in result.names]
    return {
        "parameters": {
            name: {"value": value, "u": result.u[name], "interval_95": intervals.get(name)}
            for name, value in result.parameters.items()
        },
        "derived": {name: {"value": value, "u": u} for name, (value, u) in result.derived.items()},
        "condition": result.condition,
        "covariance": {"of": of, "matrix": result.covariance},
        "correlation": {"of": of, "matrix": result.correlation},
    }


def _of_tables(result: FactoredFit) -> dict[str, Any]:
    return {
        "parameters": {
            name: {"value": value, "u": result.u[name], "interval_95": None}
            for name, value in result.parameters.items()
        },
        "derived": {},
        "tables": {name: table._asdict() for name, table in result.tables.items()},
        "stiffness": result.stiffness,
        "freedom": result.freedom,
        "start": dict(result.start.parameters),
    }


def comparison(model: str, rows: Sequence[Difference]) -> list[dict[str, Any]]:
    """Describe parameters side by side."""
    return [
        {
            "model": model,
            "parameter": row.parameter,
            "channel": row.channel,
            "values": row.values,
            "u": row.u,
            "mean": row.mean,
            "mean_u": row.mean_u,
            "largest_difference_in_u": row.largest,
            "p_value": row.p_value,
            "differs": row.differs,
        }
        for row in rows
    ]
