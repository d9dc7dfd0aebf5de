"""Fit a reflectance model to samples: parameters, their covariance, and what the data could not say."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis import uncertainty
from analysis.covariance import NormalEquations, row_names, to_natural, transform
from analysis.equations import Problem
from analysis.identifiability import (
    Caution,
    Kind,
    about_misfit,
    about_scales,
    about_shapes,
    about_the_lobe,
    correlation_matrix,
)
from analysis.jacobian import SearchJacobian, search_jacobian
from analysis.losses import Loss, make_loss
from analysis.metrics import goodness
from analysis.models import MODELS
from analysis.models.base import Geometry
from analysis.models.fresnel import normal_reflectance, normal_reflectance_slope
from analysis.solver import Solution, minimise
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr

    from analysis.models.base import Model

Array = NDArray[np.float64]

AT_BOUND = 1e-4
"""Distance to a bound, as a share of its range in search coordinates, at which a shape counts as on it."""
SAME_DIRECTION = 1e-9
"""Difference of components below which two directions are one."""


@dataclass(frozen=True, eq=False)
class State:
    """A fit as its solver knows it.

    Attributes
    ----------
    problem : Problem
        Directions and model.
    loss : Loss
        Data and weights, arrays (N, C).
    solution : Solution
        The minimum.
    scatter : float
        Standard deviation of a residual: 1 where uncertainties are stated, else from the residuals.
    inflation : ndarray, shape (P,)
        By how much the standard uncertainty of each parameter exceeds that of independent residuals of one
        size; NaN where the samples do not determine it.
    """

    problem: Problem
    loss: Loss
    solution: Solution
    scatter: float
    inflation: Array


@dataclass(frozen=True, eq=False)
class FitResult:
    """A fitted model.

    Attributes
    ----------
    model : Model
        The model with the fitted parameters: `.evaluate(wi, wo)`, `.NAME`.
    parameters : dict of str to ndarray
        By name; shape () where all channels share the parameter, else (C,).
    u : dict of str to ndarray
        Standard uncertainty (k = 1), of the same shapes; infinite where the samples do not determine it.
    covariance : ndarray, shape (P, P)
        Of the parameters in the order of `names`.
    names : tuple of (str, int or None)
        Parameter and channel (None where shared) of each row of the covariance.
    derived : dict of str to (ndarray, ndarray)
        Further quantities with their uncertainty: `ks_F0`, the specular scale times the reflectance at normal
        incidence, which is well determined where ks and ior alone are not.
    metrics : dict of str to float
        See `analysis.metrics.goodness`.
    loss : str
        What was made small.
    count : int
        Number of data used, over all channels.
    condition : float
        Condition number of the scaled normal equations in search coordinates.
    cautions : tuple of Caution
        What a person should know before using the numbers: see `analysis.identifiability`.
    state : State
        What the fit was made of, for intervals, replicas and comparisons.
    """

    model: Model
    parameters: dict[str, Array]
    u: dict[str, Array]
    covariance: Array
    names: tuple[tuple[str, int | None], ...]
    derived: dict[str, tuple[Array, Array]]
    metrics: dict[str, float]
    loss: str
    count: int
    condition: float
    cautions: tuple[Caution, ...]
    state: State = field(repr=False)

    @property
    def message(self) -> str:
        """The cautions in one line; empty when there is nothing to say."""
        return "; ".join(caution.text for caution in self.cautions)

    @property
    def correlation(self) -> Array:
        """Correlation matrix (P, P) of the parameters; NaN for what is not determined."""
        return correlation_matrix(self.covariance)


@dataclass(frozen=True)
class _Data:
    """What a fit uses of the samples: f_r (N, C), which of it, and its uncertainties."""

    samples: xr.Dataset
    wi: Array
    wo: Array
    f_r: Array
    used: NDArray[np.bool_]
    stated: bool

    @property
    def cos_i(self) -> Array:
        return self.wi[:, 2:]


def fit(
    samples: xr.Dataset, name: str, *, loss: str | None = None, channels: Sequence[int] | None = None
) -> FitResult:
    """Fit a model; all channels share its shape parameters, each has scales of its own.

    Samples with a flag, without a value, or below the horizon are not used. Where samples carry
    uncertainties, the weights take what is independent from sample to sample, the white's noise, and the
    pose's uncertainty through the gradient of a first fit; the covariance counts every error as shared by all
    whom it moves. Without uncertainties it comes from the scatter of the residuals, taken as independent, and
    so tells nothing of a model that does not describe the surface.

    Parameters
    ----------
    samples : xarray.Dataset
        See `analysis.samples`.
    name : str
        Key of `analysis.models.MODELS`.
    loss : str, optional
        One of `analysis.losses.LOSSES`; by default chi2 where there are uncertainties, else log.
    channels : sequence of int, optional
        Indices of the channels to fit together; by default all.

    Returns
    -------
    FitResult

    Raises
    ------
    BadInput
        If model or loss is unknown, or the samples cannot determine the model.
    """
    if name not in MODELS:
        raise BadInput(f"unknown model '{name}'", todo=f"choose from {', '.join(MODELS)}")
    if channels is not None:
        samples = samples.isel(channel=list(channels))
    data = _prepare(samples)
    loss = loss or ("chi2" if data.stated else "log")
    problem = Problem(MODELS[name], Geometry(data.wi, data.wo), data.f_r.shape[1])
    _check_enough(data, problem)
    u = _total(data, []) if data.stated else None
    goal = make_loss(loss, data.f_r, data.used, data.cos_i, u)
    solution = minimise(problem, goal)
    poses = uncertainty.shared_by_pose(data.samples, _model(problem, solution)) if data.stated else []
    if poses:
        # The pose's part needs the model's gradient: weigh once more with that of the first solution.
        u = _total(data, poses)
        if loss == "chi2":
            goal = make_loss(loss, data.f_r, data.used, data.cos_i, u)
            solution = minimise(problem, goal, solution)
            poses = uncertainty.shared_by_pose(data.samples, _model(problem, solution))
    return _result(data, problem, goal, solution, u=u, poses=poses)


def _prepare(samples: xr.Dataset) -> _Data:
    wi, wo = samples["wi"].to_numpy(), samples["wo"].to_numpy()
    f_r = np.asarray(samples["f_r"].to_numpy(), dtype=np.float64)
    geometry = Geometry(wi, wo)
    used = np.isfinite(f_r) & geometry.visible[:, None]
    if "flags" in samples:
        used &= samples["flags"].to_numpy() == 0
    stated = uncertainty.has_uncertainty(samples)
    if stated:
        for column in (
            uncertainty.independent(samples),
            *(e.column for e in uncertainty.shared_in_f(samples)),
        ):
            used &= np.isfinite(column)
    # Rows that no channel uses carry nothing but time.
    rows = used.any(axis=1)
    if not rows.all():
        samples, wi, wo, f_r, used = samples.isel(sample=rows), wi[rows], wo[rows], f_r[rows], used[rows]
    return _Data(samples, wi, wo, f_r, used, stated)


def _check_enough(data: _Data, problem: Problem) -> None:
    """Refuse what no model, or not this one, can be fitted to."""
    name = problem.model.NAME
    if not data.used.any():
        raise BadInput(
            "no usable sample: all are flagged, without a value, or below the horizon",
            where=name,
            todo="see flags",
        )
    empty = np.flatnonzero(~data.used.any(axis=0))
    if empty.size:
        channel = data.samples["channel"].to_numpy()[empty[0]]
        raise BadInput(f"channel {channel} has no usable sample", where=name, todo="leave the channel out")
    if not np.any(data.f_r[data.used]):
        raise BadInput("every f_r is zero", where=name, todo="check the reduction and the channel")
    needed = len(problem.model.PARAMETERS)
    directions = _different_pairs(data.wi, data.wo, needed)
    if directions < needed:
        raise BadInput(
            f"{directions} different pairs of directions for {needed} parameters",
            where=name,
            todo=f"measure at least {needed} pairs, or fit a model with fewer parameters",
        )


def _different_pairs(wi: Array, wo: Array, most: int) -> int:
    """Count the different pairs of directions, as far as `most`."""
    # The first hundred samples nearly always tell.
    for count in (100, len(wi)):
        rest, found = np.hstack([wi[:count], wo[:count]]), 0
        while len(rest) and found < most:
            rest = rest[np.max(np.abs(rest - rest[0]), axis=1) > SAME_DIRECTION]
            found += 1
        if found == most:
            break
    return found


def _total(data: _Data, poses: list[uncertainty.SharedError]) -> Array:
    """Return each datum's uncertainty for the weights: all of it but the one error that all data share."""
    shared = [e.column for e in uncertainty.shared_in_f(data.samples) if e.name != "reference"]
    columns = [uncertainty.independent(data.samples), *shared, *(e.column for e in poses)]
    return uncertainty.quadrature(*columns) + np.zeros_like(data.f_r)


def _natural(problem: Problem, solution: Solution) -> dict[str, Array]:
    values: dict[str, Array] = {"kd": solution.kd}
    if problem.has_lobe:
        values["ks"] = solution.ks
    for parameter, coordinate in zip(problem.shapes, solution.shapes, strict=True):
        values[parameter.name] = np.asarray(
            np.clip(parameter.coordinate.inverse(coordinate), *parameter.bounds)
        )
    return values


def _model(problem: Problem, solution: Solution) -> Model:
    return problem.model(**_natural(problem, solution))


def _result(
    data: _Data,
    problem: Problem,
    goal: Loss,
    solution: Solution,
    *,
    u: Array | None,
    poses: list[uncertainty.SharedError],
) -> FitResult:
    model, values = _model(problem, solution), _natural(problem, solution)
    derivative = search_jacobian(problem, goal.weight(), solution.shapes, solution.kd, solution.ks)
    on_bound = _on_bound(problem, solution)
    lobe = about_the_lobe(problem, goal, solution)
    undetermined = on_bound | np.array(
        [any(c.kind is Kind.NARROW_LOBE and p.name in c.parameters for c in lobe) for p in problem.shapes],
        dtype=bool,
    )
    scatter = 1.0 if data.stated else _scatter(data, goal, derivative)
    own = data.used * _own_uncertainty(data, goal, scatter)
    shared = [*uncertainty.shared_in_f(data.samples), *poses] if data.stated else []
    normal = NormalEquations(derivative, goal, undetermined)
    search = normal.covariance(own, shared)
    natural_slopes = to_natural(problem, solution, derivative)
    names = row_names(problem)
    covariance = transform(natural_slopes, search)
    plain = np.square(scatter) * transform(natural_slopes, normal.inverse())
    u_flat = np.sqrt(np.diag(covariance))
    metrics = goodness(
        derivative.f, data.f_r, data.used, wi=data.wi, wo=data.wo, uncertainty=u, parameters=len(names)
    )
    u_values = {
        name: u_flat[[i for i, (n, _) in enumerate(names) if n == name]].reshape(np.shape(values[name]))
        for name in values
    }
    return FitResult(
        model=model,
        parameters=values,
        u=u_values,
        covariance=covariance,
        names=names,
        derived=_derived(values, names, natural_slopes, search),
        metrics=metrics,
        loss=goal.name,
        count=int(data.used.sum()),
        condition=normal.condition,
        cautions=(
            *_one_each(about_shapes(problem, values, u_values, on_bound), lobe),
            *about_scales(names, search, covariance),
            *about_misfit(metrics),
        ),
        state=State(problem, goal, solution, scatter, _ratio(u_flat, np.sqrt(np.diag(plain)))),
    )


def _one_each(shapes: list[Caution], lobe: list[Caution]) -> list[Caution]:
    """Of two cautions about one parameter keep the one that says why: the bound, then the lobe."""
    bound = {c.parameters for c in shapes if c.kind is Kind.AT_BOUND}
    lobe = [c for c in lobe if c.parameters not in bound]
    told = {c.parameters for c in lobe}
    return [*(c for c in shapes if c.parameters not in told), *lobe]


def _ratio(whole: Array, part: Array) -> Array:
    known = np.isfinite(whole) & (part > 0.0)
    return np.where(known, np.where(known, whole, 1.0) / np.where(known, part, 1.0), np.nan)


def _scatter(data: _Data, goal: Loss, derivative: SearchJacobian) -> float:
    """Return the standard deviation of the residuals."""
    free = max(int(data.used.sum()) - derivative.columns.shape[-1], 1)
    return float(np.sqrt(np.sum(np.square(goal.residual(derivative.f))) / free))


def _own_uncertainty(data: _Data, goal: Loss, scatter: float) -> Array:
    """Independent uncertainty of the data (N, C): stated, or what the scatter of the residuals says it is."""
    if data.stated:
        return uncertainty.independent(data.samples)
    slope = goal.weight()
    return np.asarray(scatter / np.where(slope > 0.0, slope, np.inf))


def _on_bound(problem: Problem, solution: Solution) -> NDArray[np.bool_]:
    low, high = problem.bounds()
    near = AT_BOUND * (high - low)
    return np.asarray((solution.shapes - low < near) | (high - solution.shapes < near))


def _derived(
    values: dict[str, Array], names: tuple[tuple[str, int | None], ...], natural_slopes: Array, search: Array
) -> dict[str, tuple[Array, Array]]:
    """Derive ks F0 for models with a reflectance of facets, with its uncertainty."""
    if "ior" in values:
        name, reflectance = "ior", normal_reflectance(values["ior"])
        slope = normal_reflectance_slope(values["ior"])
    elif "f0" in values:
        name, reflectance, slope = "f0", values["f0"], np.ones(())
    else:
        return {}
    rows = []
    for c, ks in enumerate(values["ks"]):
        # Along the search coordinates: ks and ior each vary widely, their product hardly.
        gradient = reflectance * natural_slopes[names.index(("ks", c))]
        rows.append(gradient + ks * slope * natural_slopes[names.index((name, None))])
    gradients = np.array(rows)
    # An ior held on its bound is taken as it is: ks F0 hardly depends on it.
    known = np.where(np.isinf(search), 0.0, search)
    variance = np.einsum("cp,pq,cq->c", gradients, known, gradients)
    return {"ks_F0": (values["ks"] * reflectance, np.sqrt(np.maximum(variance, 0.0)))}
