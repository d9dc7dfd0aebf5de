"""Fit a reflectance model to samples: parameters, their covariance, and what the data could not say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis import uncertainty
from analysis.equations import Problem
from analysis.losses import Loss, make_loss
from analysis.metrics import goodness
from analysis.models import MODELS
from analysis.models.base import Geometry
from analysis.models.fresnel import normal_reflectance, normal_reflectance_slope
from analysis.solver import SearchJacobian, Solution, minimise, search_jacobian
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr

    from analysis.models.base import Model

Array = NDArray[np.float64]

UNDETERMINED = 0.5
"""Relative standard uncertainty of a shape (of ior - 1) from which on the samples do not determine it."""
AT_BOUND = 1e-4
"""Distance to a bound, as a share of its range in search coordinates, at which a shape counts as on it."""
FEWEST_LEVELS = 4
"""Distinct points of a lobe that samples must lie on before its width means anything."""
SAME_DIRECTION = 1e-9
"""Difference of components below which two directions are one."""
MISFIT = 2.0
"""Chi-square per degree of freedom from which on model or uncertainties do not describe the samples."""


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
    message : str
        What a person should know before using the numbers; empty when there is nothing.
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
    message: str


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
    own = data.used * _own_uncertainty(data, goal, derivative)
    shared = [*uncertainty.shared_in_f(data.samples), *poses] if data.stated else []
    search, condition = _covariance(derivative, goal, own, shared, on_bound)
    to_natural = _to_natural(problem, solution, derivative)
    names = _names(problem)
    covariance = _transform(to_natural, search)
    u_flat = np.sqrt(np.diag(covariance))
    count = int(data.used.sum())
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
        derived=_derived(values, names, to_natural, search),
        metrics=metrics,
        loss=goal.name,
        count=count,
        condition=condition,
        message="; ".join(
            [
                *_on_shapes(problem, values, u_values, on_bound),
                *_on_the_lobe(problem, goal, solution),
                *_on_misfit(metrics),
            ]
        ),
    )


def _own_uncertainty(data: _Data, goal: Loss, derivative: SearchJacobian) -> Array:
    """Independent uncertainty of the data (N, C): stated, or what the scatter of the residuals says it is."""
    if data.stated:
        return uncertainty.independent(data.samples)
    residual, slope = goal.residual(derivative.f), goal.weight()
    free = max(int(data.used.sum()) - derivative.columns.shape[-1], 1)
    scatter = np.sqrt(np.sum(np.square(residual)) / free)
    return np.asarray(scatter / np.where(slope > 0.0, slope, np.inf))


def _on_bound(problem: Problem, solution: Solution) -> NDArray[np.bool_]:
    low, high = problem.bounds()
    near = AT_BOUND * (high - low)
    return np.asarray((solution.shapes - low < near) | (high - solution.shapes < near))


def _covariance(
    derivative: SearchJacobian,
    goal: Loss,
    own: Array,
    shared: list[uncertainty.SharedError],
    on_bound: NDArray[np.bool_],
) -> tuple[Array, float]:
    """Sandwich covariance of the search coordinates (infinite: no information), and the condition."""
    slope = goal.slope(derivative.f)[..., None]
    columns = slope * derivative.columns
    flat = columns.reshape(-1, columns.shape[-1])
    length = np.sqrt(np.einsum("np,np->p", flat, flat))
    free = length > 0.0
    free[: len(on_bound)] &= ~on_bound
    scaled = columns[..., free] / length[free]
    normal = np.einsum("ncp,ncq->pq", scaled, scaled)
    condition = float(np.linalg.cond(normal))
    scores = scaled * goal.weight()[..., None]
    filling = uncertainty.meat(scores, own, shared)
    # Not the inverse: a direction without information must come out large, not fail.
    inverse = np.linalg.pinv(normal, rcond=1e-14, hermitian=True)
    covariance = inverse @ filling @ inverse / np.outer(length[free], length[free])
    full = np.zeros((len(length), len(length)))
    full[np.ix_(free, free)] = covariance
    full[~free, ~free] = np.inf
    return full, condition


def _to_natural(problem: Problem, solution: Solution, derivative: SearchJacobian) -> Array:
    """Jacobian of the natural parameters (shapes, kd, ks) by the search coordinates (shapes, kd, s)."""
    shapes, channels = len(solution.shapes), problem.channels
    count = derivative.columns.shape[-1]
    jacobian = np.eye(count)
    for i, parameter in enumerate(problem.shapes):
        jacobian[i, i] = parameter.coordinate.slope(parameter.coordinate.inverse(solution.shapes[i]))
    for c in range(channels if problem.has_lobe else 0):
        row = shapes + channels + c
        jacobian[row, :shapes] = -solution.ks[c] * derivative.size_slopes[:, c]
        jacobian[row, row] = 1.0 / derivative.size[c]
    return jacobian


def _names(problem: Problem) -> tuple[tuple[str, int | None], ...]:
    scales = ["kd", "ks"] if problem.has_lobe else ["kd"]
    shared: list[tuple[str, int | None]] = [(p.name, None) for p in problem.shapes]
    return (*shared, *((name, c) for name in scales for c in range(problem.channels)))


def _transform(jacobian: Array, covariance: Array) -> Array:
    """J V J^T; the variance of all that hangs on something undetermined is infinite."""
    undetermined = np.isinf(np.diag(covariance))
    result = jacobian @ np.where(np.isinf(covariance), 0.0, covariance) @ jacobian.T
    hanging = np.any(jacobian[:, undetermined] != 0.0, axis=1)
    result[hanging, hanging] = np.inf
    return np.asarray(result)


def _derived(
    values: dict[str, Array], names: tuple[tuple[str, int | None], ...], to_natural: Array, search: Array
) -> dict[str, tuple[Array, Array]]:
    """Derive ks F0 for models with an index of refraction, with its uncertainty."""
    if "ior" not in values:
        return {}
    reflectance, slope = normal_reflectance(values["ior"]), normal_reflectance_slope(values["ior"])
    ior = names.index(("ior", None))
    rows = []
    for c, ks in enumerate(values["ks"]):
        # Along the search coordinates: ks and ior each vary widely, their product hardly.
        gradient = reflectance * to_natural[names.index(("ks", c))]
        rows.append(gradient + ks * slope * to_natural[ior])
    gradients = np.array(rows)
    # An ior held on its bound is taken as it is: ks F0 hardly depends on it.
    known = np.where(np.isinf(search), 0.0, search)
    variance = np.einsum("cp,pq,cq->c", gradients, known, gradients)
    return {"ks_F0": (values["ks"] * reflectance, np.sqrt(np.maximum(variance, 0.0)))}


def _on_shapes(
    problem: Problem, values: dict[str, Array], u: dict[str, Array], on_bound: NDArray[np.bool_]
) -> list[str]:
    """Say which shapes the samples leave open."""
    notes = []
    for parameter, bound in zip(problem.shapes, on_bound, strict=True):
        value, spread = float(values[parameter.name]), float(u[parameter.name])
        only = ": of ior and ks only ks_F0 is meaningful" if parameter.name == "ior" else ""
        if bound:
            notes.append(f"{parameter.name} ended on the bound {value:.4g} and is not determined{only}")
        elif not spread / abs(parameter.coordinate.slope(value)) < UNDETERMINED:
            notes.append(f"{parameter.name} is not identifiable from these samples{only}")
    return notes


def _on_the_lobe(problem: Problem, goal: Loss, solution: Solution) -> list[str]:
    """Say whether there is a lobe, and whether samples lie on enough of it.

    A lobe narrower than the samples' grid is seen at its top alone. Its width then comes from nowhere, with a
    small u. How many values the logarithmic slope d ln(lobe) / d shape takes on the lobe tells which it is.
    """
    if not problem.has_lobe:
        return []
    if not np.any(solution.ks > 0.0):
        return ["the samples show no specular lobe"]
    lobe, slopes = problem.lobe(solution.shapes)
    on_lobe = np.any(goal.used & (solution.ks * lobe > solution.kd / np.pi), axis=1) & (lobe[:, 0] > 0.0)
    levels = np.unique(np.round(slopes[0][on_lobe] / lobe[on_lobe], 1)).size
    if levels >= FEWEST_LEVELS:
        return []
    name = problem.shapes[0].name
    return [f"the samples lie on {levels} distinct points of the lobe: {name} is not to be trusted"]


def _on_misfit(metrics: dict[str, float]) -> list[str]:
    """Say whether the residuals are what the uncertainties promise."""
    chi2 = metrics.get("chi2_dof", 0.0)
    if not chi2 > MISFIT:
        return []
    return [f"residuals exceed the stated uncertainties {np.sqrt(chi2):.1f} times: u does not cover this"]
