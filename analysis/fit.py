"""Fit a reflectance model to samples: parameters, their covariance, and what the data could not say."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis import uncertainty
from analysis.appearance import appearance
from analysis.covariance import NormalEquations, assemble, derived, transform
from analysis.goal import Goal
from analysis.identifiability import (
    Caution,
    Kind,
    about_misfit,
    about_outliers,
    about_scales,
    about_shapes,
    about_the_lobe,
    correlation_matrix,
    half_width,
    one_each,
)
from analysis.instrument import Seen, Spread, instrument_of
from analysis.layout import layout_of
from analysis.metrics import goodness
from analysis.models import MODELS
from analysis.observations import check_enough, observe
from analysis.plausibility import require_plausible
from analysis.samples import select
from analysis.state import Block, State
from analysis.unstated import bend, from_residuals
from analysis.wide_lobes import about_wide_lobes
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr

    from analysis.layout import Layout
    from analysis.models.base import Model

Array = NDArray[np.float64]

AT_BOUND = 1e-4
"""Distance to a bound, as a share of its range in search coordinates, at which a shape counts as on it."""


class Shape(StrEnum):
    """Whether channels have one shape."""

    SHARED = "shared"
    PER_CHANNEL = "per-channel"


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
    goodness : dict of str to float
        See `analysis.metrics.goodness`.
    loss : str
        What was made small.
    count : int
        Number of data that counted, over all channels.
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
    goodness: dict[str, float]
    loss: str
    count: int
    condition: float
    cautions: tuple[Caution, ...]
    state: State = field(repr=False)

    @cached_property
    def metrics(self) -> dict[str, float]:
        """`goodness`, and what the difference looks like: see `analysis.appearance.appearance`.

        The sphere takes as long as the fit, and is shaded when first asked for.
        """
        loss, geometry = self.state.loss, self.state.problem.geometry
        f_r = np.where(loss.counted, loss.data, np.nan)
        return self.goodness | appearance(self.model.evaluate, geometry.wi, geometry.wo, f_r)

    @property
    def message(self) -> str:
        """The cautions in one line; empty when there is nothing to say."""
        return "; ".join(caution.text for caution in self.cautions)

    @property
    def correlation(self) -> Array:
        """Correlation matrix (P, P) of the parameters; NaN for what is not determined."""
        return correlation_matrix(self.covariance)


def fit(
    samples: xr.Dataset,
    name: str,
    *,
    loss: str | None = None,
    channels: Sequence[int] | None = None,
    shape: str = Shape.SHARED,
    max_theta_deg: float | None = None,
    instrument: bool = True,
) -> FitResult:
    """Fit a model; each channel has scales of its own, and on request shapes of its own.

    Samples with a flag, without a value, or below the horizon are not used; values at or below zero are.
    Where samples carry uncertainties, the weights take what is independent from sample to sample, the white's
    noise, and the pose's uncertainty through the gradient of a first fit; the covariance counts every error
    as shared by all whom it moves. Without uncertainties the residuals tell how the noise goes with the
    brightness (see `analysis.unstated`); errors are taken as independent, and u tells nothing of a model that
    does not describe the surface.

    Parameters
    ----------
    samples : xarray.Dataset
        See `analysis.samples`.
    name : str
        Key of `analysis.models.MODELS`.
    loss : str, optional
        One of `analysis.losses.LOSSES`, or robust: chi2 or log without what gross errors say (see
        `analysis.robust`). By default chi2 where there are uncertainties, else log.
    channels : sequence of int, optional
        Indices of the channels to fit; by default all.
    shape : str
        One of `Shape`. Per channel, shape parameters have shape (C,), and the covariance still knows the
        errors that channels share.
    max_theta_deg : float, optional
        Leave out samples whose light or camera lies further than this from the normal.
    instrument : bool
        Whether the model is averaged over source and receiver, where their solid angles are stated and it
        matters: the parameters are then those of the surface, not of what the instrument makes of it.

    Returns
    -------
    FitResult

    Raises
    ------
    BadInput
        If model, loss or shape is unknown, the samples cannot determine the model, or their numbers cannot be
        what their units say (see `analysis.plausibility`).
    """
    if name not in MODELS:
        raise BadInput(f"unknown model '{name}'", todo=f"choose from {', '.join(MODELS)}")
    if shape not in list(Shape):
        raise BadInput(f"unknown shape '{shape}'", todo=f"choose from {', '.join(Shape)}")
    if channels is not None:
        samples = samples.isel(channel=list(channels))
    data = observe(select(samples, max_theta_deg=max_theta_deg, where=name))
    check_enough(data, MODELS[name], shared=shape == Shape.SHARED)
    require_plausible(data)
    discs = instrument_of(samples) if instrument else None
    goal = Goal(loss, data, shared=shape == Shape.SHARED, instrument=discs)
    blocks = goal.blocks(MODELS[name], data.total([]))
    poses = uncertainty.shared_by_pose(data.samples, _seen(goal, blocks)) if data.stated else []
    if poses and goal.base == "chi2":
        # The pose's part needs the model's gradient: weigh once more with that of the first solution.
        blocks = goal.blocks(MODELS[name], data.total(poses), blocks)
        poses = uncertainty.shared_by_pose(data.samples, _seen(goal, blocks))
    return _result(goal, blocks, poses)


def _model(goal: Goal, blocks: tuple[Block, ...]) -> Model:
    return blocks[0].problem.model(**_values(goal, blocks))


def _seen(goal: Goal, blocks: tuple[Block, ...]) -> Model | Seen:
    """Return the model as the instrument sees it: where any channel is averaged, all are.

    A gain is too small to change a gradient.
    """
    model = _model(goal, blocks)
    spreads = [b.problem.spread for b in blocks if isinstance(b.problem.spread, Spread)]
    if not spreads:
        return model
    rows = np.any([spread.rows for spread in spreads], axis=0)
    return Seen(model, replace(spreads[0], rows=rows, order=max(spread.order for spread in spreads)))


def _values(goal: Goal, blocks: tuple[Block, ...]) -> dict[str, Array]:
    """Parameters of all channels by name: shapes () where channels share them, else (C,)."""
    each = [block.natural() for block in blocks]
    if goal.shared:
        return each[0]
    return {name: np.concatenate([np.atleast_1d(values[name]) for values in each]) for name in each[0]}


def _result(goal: Goal, blocks: tuple[Block, ...], poses: list[uncertainty.SharedError]) -> FitResult:
    data, values = goal.data, _values(goal, blocks)
    layout = layout_of(blocks[0].problem, data.f_r.shape[1], shared=goal.shared)
    u = data.total(poses)
    loss, whole = goal.whole(blocks, u), assemble(layout, blocks)
    on_bound = _rows(layout, blocks, [_on_bound(block) for block in blocks])
    widths = [half_width(block.problem, block.solution.shapes) for block in blocks]
    lobes = [
        caution
        for block, width in zip(blocks, widths, strict=True)
        for caution in about_the_lobe(block, width, goal.labels(block))
    ]
    narrow = {(name, c.channel) for c in lobes if c.kind is Kind.NARROW_LOBE for name in c.parameters}
    undetermined = on_bound | np.array([name in narrow for name in layout.names])
    shared = [*uncertainty.shared_in_f(data.samples), *poses] if data.stated else []
    normal = NormalEquations(whole, loss, undetermined)
    if data.stated:
        own = data.used * uncertainty.independent(data.samples)
        search, freedom = normal.covariance(own, shared), np.full(len(layout.names), np.inf)
    else:
        told = from_residuals(normal, loss, whole.f, _scatter(blocks))
        own, search, freedom = told.own, told.covariance, told.freedom
    bias = normal.moved(bend(loss, whole.f, own))
    covariance = transform(whole.natural, search + np.outer(bias, bias))
    u_flat = np.sqrt(np.diag(covariance))
    plain = np.sqrt(np.diag(transform(whole.natural, normal.inverse())))
    metrics = goodness(
        whole.f, data.f_r, loss.counted, wi=data.wi, wo=data.wo, uncertainty=u, parameters=len(layout.names)
    )
    u_values = {
        name: u_flat[[i for i, (n, _) in enumerate(layout.names) if n == name]].reshape(
            np.shape(values[name])
        )
        for name in values
    }
    shapes = about_shapes(
        layout, blocks[0].problem.shapes, values, u_values, on_bound=on_bound, channels=data.channels
    )
    scales = about_scales(layout, search, covariance)
    if not any(caution.kind is Kind.KD_KS for caution in scales):
        for block, width in zip(blocks, widths, strict=True):
            scales += about_wide_lobes(layout, block, width, normal, covariance)
    return FitResult(
        model=_model(goal, blocks),
        parameters=values,
        u=u_values,
        covariance=covariance,
        names=layout.names,
        derived=derived(layout, values, whole.natural, search + np.outer(bias, bias)),
        goodness=metrics,
        loss=loss.name,
        count=int(loss.counted.sum()),
        condition=normal.condition,
        cautions=(
            *one_each(shapes, lobes),
            *scales,
            *about_outliers(loss),
            *about_misfit(metrics),
        ),
        state=State(blocks, layout, loss, _ratio(u_flat, plain), freedom),
    )


def _rows(layout: Layout, blocks: tuple[Block, ...], shapes: list[NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Put what is known of each block's shapes into rows (P,)."""
    rows = np.zeros(len(layout.names), dtype=bool)
    for block, known in zip(blocks, shapes, strict=True):
        rows[layout.rows_of(block.channels)[: len(known)]] = known
    return rows


def _on_bound(block: Block) -> NDArray[np.bool_]:
    low, high = block.problem.bounds()
    near, shapes = AT_BOUND * (high - low), block.solution.shapes
    return np.asarray((shapes - low < near) | (high - shapes < near))


def _scatter(blocks: tuple[Block, ...]) -> Array | None:
    """Return the scatter of all channels' residuals, where gross errors were told from it."""
    parts = [block.scatter for block in blocks if block.scatter is not None]
    return np.hstack(parts) if parts else None


def _ratio(whole: Array, part: Array) -> Array:
    known = np.isfinite(whole) & (part > 0.0)
    return np.where(known, np.where(known, whole, 1.0) / np.where(known, part, 1.0), np.nan)
