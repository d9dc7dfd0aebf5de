"""Every model in double and in single precision against its formula in 50 digits, where formulas break.

What is asked is in `benchmarks.light_stability`. Pairs without a half vector, in the surface or below it have
no reference: there every value has to be a number, and below the horizon 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from analysis.models import MODELS
from benchmarks.light_bsdfs import faintest
from benchmarks.light_stability import (
    Worst,
    degenerate_pairs,
    extreme_pairs,
    extreme_parameters,
    references,
    single_pairs,
    worst_error,
)
from benchmarks.models_digits import EXCEPTED_TARGET, FAINTEST, VALUE_TARGET
from benchmarks.rows import row
from simulator.light.reflectance import mitsuba_reflectance
from simulator.materials import closed_form_material

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from benchmarks.light_stability import Reference

    Array = NDArray[np.float64]
    Evaluate = Callable[[dict[str, float], Array, Array], Array | None]

EXCEPTED_TARGETS = {
    # Where light and camera are at right angles at grazing angles the base is 1e-6 of its terms, to a power.
    "lafortune": 1e-8,
    "lafortune-retro": 1e-8,
}
"""Bound of the relative error in double precision where the formula cancels, if it is not the usual one."""
SINGLE_TARGET = 1e-5
"""Relative error in single precision; of values above 1e-6 of the light's peak (`light_bsdfs.faintest`)."""


class Arithmetic(NamedTuple):
    """How a model is evaluated.

    Attributes
    ----------
    name : str
        For people.
    evaluate : callable
        (parameters, wi (N, 3), wo (N, 3)) -> f_r (N,); None where it does not serve the parameters.
    target, excepted : float
        Bound of the relative error, and the one where the formula itself cancels.
    """

    name: str
    evaluate: Evaluate
    target: float
    excepted: float


def double_precision(name: str) -> Arithmetic:
    """Return the closed form; any warning of numpy is an error."""

    def evaluate(parameters: dict[str, float], wi: Array, wo: Array) -> Array:
        with np.errstate(all="raise"):
            return np.asarray(MODELS[name](**parameters).evaluate(wi, wo)[:, 0])

    return Arithmetic("float64", evaluate, VALUE_TARGET, EXCEPTED_TARGETS.get(name, EXCEPTED_TARGET))


def single_precision(mi: Any, name: str) -> Arithmetic:
    """Return the BSDF in Mitsuba's current variant."""

    def evaluate(parameters: dict[str, float], wi: Array, wo: Array) -> Array | None:
        material = closed_form_material(name, parameters)
        return mitsuba_reflectance(mi, material)(wi, wo)[:, 0] if material.rendered else None

    return Arithmetic(mi.variant(), evaluate, SINGLE_TARGET, SINGLE_TARGET)


def worst(name: str, arithmetic: Arithmetic, every: int = 1) -> Worst:
    """Return the largest errors of a model."""
    single = arithmetic.target > VALUE_TARGET
    pairs = single_pairs() if single else extreme_pairs()

    def least(reference: Reference) -> Array:
        if not single:
            return np.full(len(pairs.wi), FAINTEST)
        return faintest(closed_form_material(name, reference.parameters), pairs.wi)

    return worst_error(name, pairs, arithmetic.evaluate, least, every)


def wrong_at_degenerate_pairs(name: str, arithmetic: Arithmetic, every: int = 1) -> int:
    """Count values that are no numbers, or not 0 in the surface or below it, over all extreme parameters."""
    pairs, count = degenerate_pairs(), 0
    dark = (pairs.wi[:, 2] <= 0.0) | (pairs.wo[:, 2] <= 0.0)
    for parameters in extreme_parameters(MODELS[name], every):
        values = arithmetic.evaluate(parameters, *pairs)
        if values is not None:
            count += int(np.count_nonzero(~np.isfinite(values) | (dark & (values != 0.0))))
    return count


def wrong_without_albedo(name: str, arithmetic: Arithmetic, every: int = 1) -> int:
    """Count values that are not 0 where every scale is, over all extreme parameters."""
    scales = {p.name: 0.0 for p in MODELS[name].PARAMETERS if p.name in {"kd", "ks"}}
    found = [
        arithmetic.evaluate({**parameters, **scales}, *pairs)
        for parameters in extreme_parameters(MODELS[name], every)
        for pairs in (single_pairs(), degenerate_pairs())
    ]
    return sum(int(np.count_nonzero(values)) for values in found if values is not None)


def rows_of(name: str, arithmetic: Arithmetic, every: int = 1) -> Iterator[dict[str, Any]]:
    """Measure a model in one arithmetic, over every so many-th shape."""
    met, title = worst(name, arithmetic, every), f"{name}, {arithmetic.name}"
    yield row(title, met.error, "relative", arithmetic.target)
    if any(reference.cancels.any() for reference in references(name, every)):
        yield row(f"{title}, excepted", met.excepted, "relative", arithmetic.excepted)
    yield row(f"{title}, degenerate pairs", wrong_at_degenerate_pairs(name, arithmetic, every), "wrong", 0.0)
    yield row(f"{title}, no albedo", wrong_without_albedo(name, arithmetic, every), "wrong", 0.0)


def run(plots: Path | None) -> Iterator[dict[str, Any]]:  # noqa: ARG001 - the interface of all parts
    """Measure all models in double precision, and in every variant of Mitsuba that runs here."""
    from simulator import bsdfs
    from simulator.variant import LLVM, SCALAR, choose_variant, load_mitsuba

    for name in MODELS:
        yield from rows_of(name, double_precision(name))
    for variant in (LLVM, SCALAR) if choose_variant().variant == LLVM else (SCALAR,):
        mi = load_mitsuba(variant)
        bsdfs.register(mi)
        for name in MODELS:
            yield from rows_of(name, single_precision(mi, name))
