"""Where formulas break: pairs of directions and parameters at the ends of what has a meaning, in all digits.

Grazing up to 89.999 degrees, widths (RMS slopes) from 1e-4 to 10, indices of refraction from 1.0001 to 5 and
complex ones, albedos of 0 and 1, directions that coincide, oppose each other or lie in the surface. Numbers
are those that single precision holds, so that one reference in 50 digits serves both precisions; only
directions are made as long as 1 in each.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import islice
from types import SimpleNamespace
from typing import TYPE_CHECKING, NamedTuple

import mpmath as mp
import numpy as np

from analysis.models import MODELS
from analysis.models.base import Kind
from benchmarks.models_digits import STEEPEST_DEG, cancels
from benchmarks.models_exact import DIGITS, FORMULAS, geometry
from rig.angles import spherical_to_direction, unit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from analysis.models.base import Model

    Array = NDArray[np.float64]

THETAS_DEG = (0.0, 1e-4, 0.1, 10.0, 45.0, 80.0, 89.0, 89.9, 89.99, STEEPEST_DEG)
ASIDE = (0.0, 3e-5, 1e-4, 1e-3, 0.03)
"""Steps away from the mirror direction and from the light: within lobes of all widths."""
AZIMUTH = 0.4
APART = (0.0, 1.0, 0.5 * np.pi, 3.14159, np.pi)
"""Azimuths between light and camera."""

_WIDTHS = (1e-4, 1e-2, 0.3, 10.0)
_POWERS = tuple(2.0 / m**2 for m in _WIDTHS)
EXTREMES: dict[str, tuple[float, ...]] = {
    **dict.fromkeys(("m", "m_x", "m_y", "alpha_x", "alpha_y", "alpha_retro"), _WIDTHS),
    **dict.fromkeys(("exponent_x", "exponent_y"), _POWERS),
    **dict.fromkeys(("share", "roughness", "facet_albedo"), (0.0, 0.5, 1.0)),
    "half_width_rad": (1e-4, 1e-2, 0.3, 1.5),
    "ior": (1.0001, 1.5, 5.0),
    "eta": (0.05, 1.0001, 5.0),
    "k": (0.0, 1e-4, 2.0, 10.0),
    "f0": (0.0, 0.04, 1.0),
    "widening": (1.0, 2.0, 100.0),
    "sigma_rad": (0.0, 1e-4, 0.5 * np.pi),
    "axis_rad": (0.0, 0.25 * np.pi, -1.1),
}
"""Values by name of a parameter; of others the default and the bounds of a fit."""
_OWN = {
    # Its alpha is a square of a width, k and alpha mean something else, and so do Lafortune's powers.
    **dict.fromkeys(("sgd", "lafortune", "lafortune-retro"), ()),
    **dict.fromkeys(("ward", "ward-duer", "ward-bounded"), ("alpha",)),
    **dict.fromkeys(("phong", "modified-phong", "blinn-phong"), ("exponent",)),
}
COMBINATIONS = 8
"""Of extremes of all parameters at once, besides one at a time."""


class Pairs(NamedTuple):
    """Directions to light and camera, each (N, 3)."""

    wi: Array
    wo: Array


def _single(vectors: Array) -> Array:
    return vectors.astype(np.float32).astype(np.float64)


def extreme_pairs() -> Pairs:
    """Return `single_pairs`, each direction made as long as 1 in double precision."""
    return Pairs(*(unit(side) for side in single_pairs()))


@cache
def single_pairs() -> Pairs:
    """Return pairs above the horizon: about the mirror direction, about the light, and any."""
    thetas = np.radians(THETAS_DEG)
    light = spherical_to_direction(thetas, np.full(len(thetas), AZIMUTH))
    random = np.random.default_rng(0)
    wi, wo = [], []
    for about in (light * [-1.0, -1.0, 1.0], light):
        for step in ASIDE:
            moved = about + step * random.standard_normal(about.shape) * (1.0, 1.0, 0.3)
            moved[:, 2] = np.maximum(np.abs(moved[:, 2]), 1e-5)
            wi.append(light)
            wo.append(moved / np.linalg.norm(moved, axis=1, keepdims=True))
    one, other, apart = (axis.ravel() for axis in np.meshgrid(thetas[::3], thetas[::3], APART))
    wi.append(spherical_to_direction(one, np.full(len(one), AZIMUTH)))
    wo.append(spherical_to_direction(other, AZIMUTH + apart))
    return Pairs(*(_single(np.concatenate(side)) for side in (wi, wo)))


@cache
def degenerate_pairs() -> Pairs:
    """Return pairs that have no half vector, or of which a direction lies in the surface or below it."""
    up, along, across = np.eye(3)[[2, 0, 1]]
    slanted = _single(spherical_to_direction(np.radians(50.0), np.asarray(AZIMUTH)).ravel())
    level = np.array([0.6, 0.8, 0.0])
    tiny = np.array([1.0, 0.0, 1e-30])
    pairs = [
        *((v, -v) for v in (up, along, slanted, level)),
        *((-v, v) for v in (up, slanted)),
        *((v, v) for v in (up, along, slanted, level, tiny, -up, -slanted)),
        *((v, w) for v in (along, level, tiny) for w in (up, slanted, across)),
        *((w, v) for v in (along, level, tiny) for w in (up, slanted, across)),
        (tiny, tiny * [-1.0, 1.0, 1.0]),
        (along, -along + [0.0, 0.0, 1e-30]),
    ]
    wi, wo = (np.array(side) for side in zip(*pairs, strict=True))
    return Pairs(wi, wo)


def values_of(model: type[Model], name: str) -> tuple[float, ...]:
    """Return the values that a shape parameter takes, its default first."""
    parameter = next(p for p in model.PARAMETERS if p.name == name)
    own = _OWN.get(model.NAME)
    if name in EXTREMES and own is None:
        values = EXTREMES[name]
    elif name == "alpha" and (own is None or name in own):
        values = _WIDTHS
    elif name == "exponent" and own and name in own:
        values = _POWERS
    else:
        values = parameter.bounds
    return (parameter.default, *values)


def extreme_shapes(model: type[Model]) -> Iterator[dict[str, float]]:
    """Yield shapes: the default, each parameter's extremes by itself, and combinations of all."""
    choices = {p.name: values_of(model, p.name) for p in model.PARAMETERS if p.kind is Kind.SHAPE}
    default = {name: values[0] for name, values in choices.items()}
    yield default
    for name, values in choices.items():
        for value in values[1:]:
            yield {**default, name: value}
    if len(choices) > 1:
        random = np.random.default_rng(1)
        for _ in range(COMBINATIONS):
            yield {name: float(random.choice(values[1:])) for name, values in choices.items()}


def extreme_parameters(model: type[Model], every: int = 1) -> Iterator[dict[str, float]]:
    """Yield all parameters as single precision has them: every so many-th shape, each scale at 1 alone."""
    scales = [p.name for p in model.PARAMETERS if p.kind is not Kind.SHAPE]
    alone = [s for s in scales if s != "kd" or not model.LAMBERT_TERM or len(scales) == 1]
    limits = {p.name: (p.minimum, p.maximum) for p in model.PARAMETERS}
    for shape in islice(extreme_shapes(model), 0, None, every):
        for scale in alone:
            values = {**dict.fromkeys(scales, 0.0), scale: 1.0, **shape}
            yield {key: float(np.clip(np.float32(value), *limits[key])) for key, value in values.items()}


@dataclass(frozen=True, eq=False)
class Reference:
    """A model's formula in 50 digits at one set of parameters, over `extreme_pairs`.

    Attributes
    ----------
    parameters : dict of str to float
    values : ndarray, shape (N,)
        f_r, rounded to double precision: infinite where it is beyond that.
    cancels : ndarray of bool, shape (N,)
        Whether the formula itself holds a difference of nearly equal terms (`models_digits.cancels`).
    """

    parameters: dict[str, float]
    values: Array
    cancels: NDArray[np.bool_]


@cache
def _geometries() -> list[SimpleNamespace]:
    with mp.workdps(DIGITS):
        return [geometry(wi, wo) for wi, wo in zip(*extreme_pairs(), strict=True)]


@cache
def references(name: str, every: int = 1) -> tuple[Reference, ...]:
    """Return a model's references for its `extreme_parameters`."""
    found = []
    with mp.workdps(DIGITS):
        for parameters in extreme_parameters(MODELS[name], every):
            exact = SimpleNamespace(**{key: mp.mpf(value) for key, value in parameters.items()})
            values = np.array([float(FORMULAS[name](g, exact)) for g in _geometries()])
            lost = np.array([cancels(name, g, exact) for g in _geometries()])
            found.append(Reference(parameters, values, lost))
    return tuple(found)


class Worst(NamedTuple):
    """Largest relative errors of f_r.

    Attributes
    ----------
    error : float
        Infinite where a value is not a number.
    excepted : float
        The same where the formula itself cancels.
    where : str
        Parameters and directions of `error`.
    """

    error: float = 0.0
    excepted: float = 0.0
    where: str = ""


def worst_error(
    name: str,
    pairs: Pairs,
    evaluate: Callable[[dict[str, float], Array, Array], Array | None],
    faintest: Callable[[Reference], Array],
    every: int = 1,
) -> Worst:
    """Compare what evaluates a model with its references.

    Parameters
    ----------
    name : str
        The model.
    pairs : Pairs
        `extreme_pairs`, or for single precision `single_pairs`.
    evaluate : callable
        (parameters, wi (N, 3), wo (N, 3)) -> f_r (N,), or None where it does not serve the parameters.
    faintest : callable
        Of a reference: values (N,) below which it is not compared.
    every : int
        Every which shape is compared.
    """
    worst = Worst()
    for reference in references(name, every):
        found = evaluate(reference.parameters, *pairs)
        if found is None:
            continue
        seen = reference.values > faintest(reference)
        error = np.abs(found - reference.values) / np.where(seen, reference.values, 1.0)
        error = np.where(np.isfinite(found), np.where(seen, error, 0.0), np.inf)
        excepted = float(np.max(error, where=reference.cancels, initial=0.0))
        counted = np.where(reference.cancels, 0.0, error)
        at = int(np.argmax(counted))
        where = worst.where
        if counted[at] > worst.error:
            where = f"{reference.parameters} wi {pairs.wi[at].tolist()} wo {pairs.wo[at].tolist()}"
        worst = Worst(max(worst.error, float(counted[at])), max(worst.excepted, excepted), where)
    return worst
