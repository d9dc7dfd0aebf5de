"""How many digits of the models are right: against 50-digit arithmetic, over the whole box of shapes.

Derivatives are compared with central differences in the same arithmetic, steps of 1e-16, which are right to
more than 30 digits: as good as a complex step, and without a second, complex, copy of the code.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import mpmath as mp
import numpy as np

from analysis.models import MODELS
from analysis.models.base import Kind
from benchmarks.models_exact import (
    DIGITS,
    FORMULAS,
    geometry,
    lafortune_base,
    sgd_masking,
    sgd_reflectance,
    turned,
)
from rig.angles import spherical_to_direction

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from analysis.models.base import Model

    Array = NDArray[np.float64]

VALUE_TARGET, SLOPE_TARGET, EXCEPTED_TARGET = 1e-12, 1e-10, 1e-10
STEEPEST_DEG = 89.999
FAINTEST = 1e-290
"""Numbers below this are near the end of the doubles, or beyond, and have no twelve digits."""
CANCELLED = 0.1
"""A difference smaller than this share of its terms is an exception; see `cancels`."""
STEP = mp.mpf(10) ** -16
AXES_DEG = (0.0, 45.0, 90.0)


@dataclass
class Worst:
    """Largest relative errors of one model.

    Attributes
    ----------
    value : float
        Of f_r.
    slopes : dict of str to float
        Of the derivative by each shape, over its own size or, where it passes through zero, 1 % of f over the
        parameter's value.
    excepted : float
        Of f_r where a difference in the formula itself cancels (`cancels`); counts in none of the others.
    where : dict of str to str
        Shapes and directions of each of these.
    """

    value: float = 0.0
    slopes: dict[str, float] = field(default_factory=dict)
    excepted: float = 0.0
    where: dict[str, str] = field(default_factory=dict)

    def meet(self, what: str, error: float, where: str) -> None:
        """Take an error into account: of the value, of a derivative by name, or excepted."""
        before = getattr(self, what) if what in {"value", "excepted"} else self.slopes.get(what, 0.0)
        if error < before:
            return
        if what in {"value", "excepted"}:
            setattr(self, what, error)
        else:
            self.slopes[what] = error
        self.where[what] = where


class Where(NamedTuple):
    """Pairs of directions, their exact geometry, and every which of them derivatives are compared at."""

    wi: Array
    wo: Array
    exact: list[SimpleNamespace]
    every: int


def directions(count: int, seed: int = 0) -> tuple[Array, Array]:
    """Return pairs of directions wi, wo (N, 3): at random, and structured ones at which formulas break.

    Random ones anywhere; at the mirror direction, beside it by 1e-6 to 0.3 and back to the light, `count` of
    each; normal incidence and `STEEPEST_DEG` on either side and on both, in several azimuths.
    """
    random = np.random.default_rng(seed)
    theta_i, theta_o = np.radians(random.uniform(0.0, STEEPEST_DEG, (2, count)))
    phi_i, phi_o = random.uniform(-np.pi, np.pi, (2, count))
    wi, anywhere = spherical_to_direction(theta_i, phi_i), spherical_to_direction(theta_o, phi_o)
    mirror = wi * np.array([-1.0, -1.0, 1.0])
    apart = 10.0 ** random.uniform(-6.0, -0.5, (count, 1)) * random.standard_normal((2, count, 3))
    beside, back = (_above(v + a) for v, a in zip((mirror, wi), apart, strict=True))
    edge_i, edge_o = _edges()
    return (
        np.concatenate([wi, wi, wi, wi, wi, edge_i]),
        np.concatenate([anywhere, mirror, beside, wi, back, edge_o]),
    )


def _above(vectors: Array) -> Array:
    """Make vectors unit directions above the horizon."""
    raised = np.concatenate([vectors[:, :2], np.maximum(np.abs(vectors[:, 2:]), 1e-6)], axis=1)
    return np.asarray(raised / np.linalg.norm(raised, axis=-1, keepdims=True))


def _edges() -> tuple[Array, Array]:
    g = STEEPEST_DEG
    pairs_deg = [(0, 0), (1e-6, 0), (0, 1e-5), (0, 45), (0, g), (g, 0), (40, 40), (30, g), (g, 20), (89, 89)]
    pairs_deg += [(g, g), (g, g - 1e-3)]
    apart = (0.0, 1.0, 0.5 * np.pi, 3.14159, np.pi)
    theta_i, theta_o, phi, dphi = np.array(
        [
            (np.radians(i), np.radians(o), np.radians(AXES_DEG[k % len(AXES_DEG)]), d)
            for i, o in pairs_deg
            for k, d in enumerate(apart)
        ]
    ).T
    return spherical_to_direction(theta_i, phi), spherical_to_direction(theta_o, phi + dphi)


def shapes(model: type[Model], draws: int, seed: int = 0) -> Iterator[dict[str, float]]:
    """Yield the default shape, then inside and corners of a fit's box by turns, in search coordinates."""
    searched = [p for p in model.PARAMETERS if p.kind is Kind.SHAPE]
    yield {p.name: p.default for p in searched}
    if not searched:
        return
    random = np.random.default_rng(seed)
    for draw in range(draws):
        shares = random.integers(0, 2, len(searched)) if draw % 2 else random.random(len(searched))
        point = {}
        for p, share in zip(searched, shares, strict=True):
            low, high = (p.coordinate.forward(bound) for bound in p.bounds)
            point[p.name] = float(np.clip(p.coordinate.inverse(low + share * (high - low)), *p.bounds))
        yield point


def cancels(name: str, g: SimpleNamespace, p: SimpleNamespace) -> bool:
    """Return whether the model's formula holds a difference of nearly equal terms there.

    Lafortune's base, and SGD's reflectance and masking, change sign. Where H lies near an axis, its component
    across that is a difference, of which the exponentials of Ashikhmin-Shirley and of Beckmann's anisotropic
    distribution take the square times up to 700. The digits lost are in the formula, whatever the program.
    """
    if name in {"lafortune", "lafortune-retro"}:
        base = lafortune_base(g, p, -1 if name == "lafortune" else 1)
        terms = sum(abs(g.light[axis] * g.eye[axis]) for axis in (0, 1)) + p.ratio * g.cos_i * g.cos_o
        return bool(abs(base) < CANCELLED * terms)
    if name == "sgd":
        if min(sgd_masking(cosine, p) for cosine in (g.cos_i, g.cos_o)) < CANCELLED:
            return True
        terms = abs(p.f0 - p.f1) + abs(p.f1) * (1 - g.cos_d) + (1 - p.f0) * (1 - g.cos_d) ** 5
        return bool(abs(sgd_reflectance(g, p)) < CANCELLED * terms)
    if name in {"ashikhmin-shirley", "beckmann-anisotropic"}:
        smaller, larger = sorted(abs(x) for x in turned(g.half, p.axis_rad))
        return bool(smaller < CANCELLED * larger)
    return False


def worst(name: str, pairs: tuple[Array, Array], draws: int, *, every: int = 1, seed: int = 0) -> Worst:
    """Compare a model with its formula in 50 digits.

    Parameters
    ----------
    name : str
        Name of the model.
    pairs : tuple of ndarray
        Directions wi, wo, (N, 3).
    draws : int
        Number of shapes, beside the default.
    every : int
        Every which pair's derivatives are compared.
    seed : int
        Of the shapes.
    """
    model, found = MODELS[name], Worst()
    scales = [p.name for p in model.PARAMETERS if p.kind is not Kind.SHAPE]
    with mp.workdps(DIGITS):
        exact = [geometry(wi, wo) for wi, wo in zip(*pairs, strict=True)]
        for shape in shapes(model, draws, seed):
            for scale in scales:
                if scale == "kd" and model.LAMBERT_TERM and len(scales) > 1:
                    continue
                values = {**dict.fromkeys(scales, 0.0), scale: 0.7, **shape}
                _compare(found, name, values, Where(*pairs, exact, every))
    return found


def _compare(found: Worst, name: str, values: dict[str, float], at: Where) -> None:
    """Meet the errors at one set of parameters; any warning of numpy is an error here."""
    model = MODELS[name](**values)
    with np.errstate(all="raise"):
        ours, slopes = model.evaluate(at.wi, at.wo), model.derivatives(at.wi, at.wo)
    if set(slopes) != set(values):
        raise AssertionError(f"{name} has derivatives by {sorted(slopes)}")
    parameters = {key: mp.mpf(value) for key, value in values.items()}
    for row, g in enumerate(at.exact):
        reference = FORMULAS[name](g, SimpleNamespace(**parameters))
        if 0 < abs(reference) < FAINTEST:
            continue
        where = f"{values} wi {at.wi[row].tolist()} wo {at.wo[row].tolist()}"
        error = _relative(ours[row, 0], reference, abs(reference))
        if cancels(name, g, SimpleNamespace(**parameters)):
            found.meet("excepted", error, where)
            continue
        found.meet("value", error, where)
        if row % at.every:
            continue
        for key, value in parameters.items():
            slope = _slope(name, g, parameters, key)
            size = abs(slope) + abs(reference / (value or 1)) / 100
            if key in slopes and size > FAINTEST:
                found.meet(key, _relative(slopes[key][row, 0], slope, size), where)


def _slope(name: str, g: SimpleNamespace, parameters: dict[str, Any], key: str) -> Any:
    """Central difference of the formula by one parameter."""
    step = STEP * (parameters[key] or 1)
    sides = [
        FORMULAS[name](g, SimpleNamespace(**{**parameters, key: parameters[key] + sign * step}))
        for sign in (1, -1)
    ]
    return (sides[0] - sides[1]) / (2 * step)


def _relative(ours: float, reference: Any, size: Any) -> float:
    difference = abs(mp.mpf(float(ours)) - reference)
    return float(difference / size) if size else float("inf" if difference else 0.0)
