"""Fit of the factored model: GGX, tables over it, and how stiff they are by cross-validation.

Incidences are left out in turn, GGX is fitted to the rest and tables of each stiffness over it, and the
stiffness is taken that predicts best what was left out. The score reported for a fold is that of the
stiffness that is best on the other folds, so that no fold chooses for itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.appearance import appearance
from analysis.comparison import folds_of, mean_square
from analysis.fit import fit
from analysis.identifiability import Caution, Kind
from analysis.metrics import goodness
from analysis.models.base import Geometry
from analysis.models.factored import STIFFNESS, Factored, Table, estimate_under, require_enough, tables
from analysis.solver import minimise

if TYPE_CHECKING:
    from typing import Any

    import xarray as xr

    from analysis.fit import FitResult
    from analysis.losses import Loss
    from analysis.models.base import Model
    from analysis.models.factored import Estimate

Array = NDArray[np.float64]

START = "ggx"
LADDER = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Stiffnesses tried: from tables that follow everything to nearly the model they started from."""


@dataclass(frozen=True, eq=False)
class FactoredFit:
    """Tables over a GGX fit; what it shares with `analysis.fit.FitResult` has the same name.

    Attributes
    ----------
    model : Factored
        `.evaluate(wi, wo)`, `.NAME`.
    parameters, u : dict of str to ndarray, shape (C,)
        kd, and its standard uncertainty. All else is in the tables.
    tables : dict of str to Table
        D, F and G with their relative uncertainty: see `analysis.models.factored.tables`.
    stiffness : float
        Of the tables, chosen by cross-validation.
    freedom : float
        Number of parameters that the data decide.
    metrics, loss, count, cautions
        As of `analysis.fit.FitResult`.
    start : FitResult
        The fit that the tables correct.
    squares, weights : ndarray, shape (F,)
        Mean squared residual of each fold of incidences left out, and its number of data; empty where there
        is one incidence.
    cost : float
        Half the sum of squared residuals.
    """

    model: Factored
    parameters: dict[str, Array]
    u: dict[str, Array]
    tables: dict[str, Table]
    stiffness: float
    freedom: float
    metrics: dict[str, float]
    loss: str
    count: int
    cautions: tuple[Caution, ...]
    start: FitResult
    squares: Array
    weights: Array
    cost: float

    @property
    def derived(self) -> dict[str, tuple[Array, Array]]:
        """Nothing: for the same use as `FitResult`."""
        return {}

    @property
    def message(self) -> str:
        """The cautions in one line; empty when there is nothing to say."""
        return "; ".join(caution.text for caution in self.cautions)


def fit_factored(samples: xr.Dataset, *, loss: str | None = None, **options: Any) -> FactoredFit:
    """Fit GGX, and tables over it.

    Parameters
    ----------
    samples : xarray.Dataset
        See `analysis.samples`.
    loss : str, optional
        As in `analysis.fit.fit`.
    **options
        Further ones of `analysis.fit.fit`, for GGX.

    Returns
    -------
    FactoredFit

    Raises
    ------
    BadInput
        As `analysis.fit.fit`, and where there are fewer samples than table entries.
    """
    return factored_over(fit(samples, START, loss=loss, **options))


def factored_over(start: FitResult) -> FactoredFit:
    """Fit tables over a fit of GGX; as `fit_factored`."""
    goal, geometry = start.state.loss, start.state.problem.geometry
    require_enough(goal)
    scores, weights = _scores(start)
    cautions: tuple[Caution, ...] = ()
    if len(weights):
        best = int(np.argmin(weights @ scores))
        squares = np.array([scores[i, _best_but(scores, weights, i)] for i in range(len(weights))])
        stiffness = LADDER[best]
    else:
        squares, stiffness = np.zeros(0), STIFFNESS
        text = "one incidence tells nothing of others: the tables' stiffness is a guess"
        cautions = (Caution(Kind.NOT_DETERMINED, ("D", "F", "G"), text),)
    found = estimate_under(goal, geometry, start.model, stiffness=stiffness)
    f = found.model.evaluate(geometry.wi, geometry.wo)
    channels = goal.data.shape[1]
    variance = np.diag(found.covariance)[-2 * channels : -channels]
    return FactoredFit(
        model=found.model,
        parameters={"kd": found.model.kd},
        u={"kd": np.sqrt(np.maximum(variance, 0.0))},
        tables=tables(found),
        stiffness=stiffness,
        freedom=found.freedom,
        metrics=_metrics(found, goal, geometry),
        loss=start.loss,
        count=start.count,
        cautions=cautions,
        start=start,
        squares=squares,
        weights=weights,
        cost=0.5 * float(np.sum(np.square(goal.residual(f)))),
    )


def _best_but(scores: Array, weights: Array, fold: int) -> int:
    """Which stiffness is best on all folds but one; on that one where it is alone."""
    others = np.arange(len(weights)) != fold
    return int(np.argmin(weights[others] @ scores[others]))


def _scores(start: FitResult) -> tuple[Array, Array]:
    """Mean squared residual by fold left out and stiffness (F, L), and the number of data left out (F,)."""
    state = start.state
    wi, wo = state.problem.geometry.wi, state.problem.geometry.wo
    fold = folds_of(np.arctan2(np.hypot(wi[:, 0], wi[:, 1]), wi[:, 2]))
    scores, weights = [], []
    for number in np.unique(fold):
        kept, left = np.flatnonzero(fold != number), np.flatnonzero(fold == number)
        if not len(kept):
            break
        # Channels first twice is channels last again.
        if not state.loss.counted[left].any() or not state.loss.counted[kept].any(axis=0).all():
            continue
        rest = state.loss.by_channel(kept).by_channel()
        held = state.loss.reweighted(None).by_channel(left).by_channel()
        model, geometry = _refitted(start, kept, rest), Geometry(wi[kept], wo[kept])
        row = []
        for stiffness in LADDER:
            found = estimate_under(rest, geometry, model, stiffness=stiffness).model
            f = found.evaluate(wi[left], wo[left])
            row.append(mean_square(held.residual(f)[held.used], start.loss))
        scores.append(row)
        weights.append(int(held.used.sum()))
    return np.reshape(scores, (-1, len(LADDER))), np.array(weights, dtype=np.float64)


def _refitted(start: FitResult, kept: NDArray[np.intp], rest: Loss) -> Model:
    """Fit the start's model to some of the samples."""
    problem = start.state.problem
    solution = minimise(problem.some(kept), rest, start.state.solution)
    values = {"kd": solution.kd, "ks": solution.ks}
    values |= {
        p.name: np.clip(p.coordinate.inverse(float(x)), *p.bounds)
        for p, x in zip(problem.shapes, solution.shapes, strict=True)
    }
    return problem.model(**values)


def _metrics(found: Estimate, goal: Loss, geometry: Geometry) -> dict[str, float]:
    # Under chi2 the slope is the datum's own weight.
    weight = goal.reweighted(None).weight()
    u = np.where(weight > 0.0, 1.0 / np.where(weight > 0.0, weight, 1.0), np.inf)
    compared = goodness(
        found.model.evaluate(geometry.wi, geometry.wo),
        goal.data,
        goal.counted,
        wi=geometry.wi,
        wo=geometry.wo,
        uncertainty=u if goal.name == "chi2" else None,
        parameters=round(found.freedom),
    )
    f_r = np.where(goal.counted, goal.data, np.nan)
    return compared | appearance(found.model.evaluate, geometry.wi, geometry.wo, f_r)
