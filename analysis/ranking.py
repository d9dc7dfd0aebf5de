"""Models of every kind side by side: those with parameters, and the factored one."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

import numpy as np

from analysis.comparison import Candidate, criterion, judge, ranked
from analysis.factored_fit import FactoredFit, fit_factored
from analysis.fit import FitResult, fit
from analysis.models import MODELS
from analysis.models.factored import Factored
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Any

    import xarray as xr

    from analysis.losses import Loss
    from analysis.models.base import Geometry

FITTED = (*MODELS, Factored.NAME)
"""Names of all that can be fitted."""

AnyFit = FitResult | FactoredFit


def check_names(names: Sequence[str]) -> None:
    """Refuse a name that no model has, with those nearest to it; BadInput."""
    for name in names:
        if name not in FITTED:
            near = difflib.get_close_matches(name, FITTED, n=3, cutoff=0.5)
            todo = f"did you mean {' or '.join(near)}? " if near else ""
            raise BadInput(f"unknown model '{name}'", todo=f"{todo}there are {', '.join(FITTED)}")


def rank(
    samples: xr.Dataset,
    names: Sequence[str],
    *,
    told: Callable[[str], None] | None = None,
    left_out: dict[str, str] | None = None,
    **options: Any,
) -> list[Candidate]:
    """Fit and judge models, best first.

    Parameters
    ----------
    samples : xarray.Dataset
        See `analysis.samples`.
    names : sequence of str
        Of `FITTED`.
    told : callable, optional
        Called with each model's name when it is done.
    left_out : dict, optional
        Where given, a model that the samples cannot determine is left out, and why is put here by its name.
    **options
        Of `analysis.fit.fit`.

    Returns
    -------
    list of Candidate

    Raises
    ------
    BadInput
        As `analysis.fit.fit`; with `left_out` only if no model is left.
    """
    check_names(names)
    found = []
    for name in names:
        try:
            found.append(_judged(samples, name, options))
        except BadInput as error:
            if left_out is None:
                raise
            left_out[name] = str(error)
            reason = error
        if told is not None:
            told(name)
    if not found:
        raise reason
    return ranked(found)


def _judged(samples: xr.Dataset, name: str, options: dict[str, Any]) -> Candidate:
    if name != Factored.NAME:
        return judge(fit(samples, name, **options))
    # The tables correct one lobe for all channels, and are of what the instrument saw.
    given = {key: value for key, value in options.items() if key != "shape"}
    result = fit_factored(samples, **given, instrument=False)
    score = (
        float(np.sqrt(np.average(result.squares, weights=result.weights))) if result.weights.size else np.nan
    )
    bic = criterion(result.loss, result.cost, result.count, result.freedom)
    return Candidate(result, score, result.squares, bic)


def data_of(result: AnyFit) -> tuple[Geometry, Loss]:
    """Return the directions and the data that a fit was made of."""
    state = result.start.state if isinstance(result, FactoredFit) else result.state
    return state.problem.geometry, state.loss
