"""How far the registered BSDFs are from their closed forms: single precision against float64, by model.

Both are asked for the same directions and parameters, those that single precision holds, over random,
grazing, peak and degenerate pairs and over the inside and the corners of the box of shapes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from analysis.models import MODELS
from benchmarks.models_digits import directions, shapes
from benchmarks.rows import row
from rig.angles import unit
from simulator.light.reflectance import mitsuba_reflectance
from simulator.materials import closed_form_material

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from simulator.line_words import Value
    from simulator.materials import ClosedFormMaterial

    Array = NDArray[np.float64]

FAINTEST, SMALLEST = 1e-6, 1e-30
"""Values are not compared below this share of the light's peak, where an exponent's last digit counts for
more, nor below this, where single precision ends."""
BOUND = 1e-5
BOUNDS = {
    # Lobes of 0.003 across an axis multiply the last digit of the axis' sine.
    "ashikhmin-shirley": 2e-4,
    "beckmann-anisotropic": 1e-3,
    "ggx-anisotropic": 1e-3,
    # Values down to 1e-30 have logarithms down to -69, whose last digit is 4e-6.
    "lafortune": 2e-5,
    "lafortune-retro": 2e-5,
    # Its masking is a difference that ends in zero at some angle, of a power of up to 100.
    "sgd": 3e-2,
}
"""Largest relative error of a model, where `BOUND` is not it, and why."""


class Worst(NamedTuple):
    """The largest relative error of a model, and where.

    Attributes
    ----------
    error : float
        Relative; infinite where a value is not a number.
    parameters : dict of str to float
        The model's.
    wi, wo : ndarray, shape (3,)
        To the light and to the camera.
    """

    error: float
    parameters: dict[str, Value]
    wi: Array
    wo: Array


def materials(name: str, draws: int) -> Iterator[ClosedFormMaterial]:
    """Yield a model's materials over its box of shapes, those that Mitsuba can be given.

    With a specular term it is seen alone, so that the diffuse one hides no error of it.
    """
    model = MODELS[name]
    names = {parameter.name for parameter in model.PARAMETERS}
    specular = [{"kd": 0.0, "ks": 1.0}] if "ks" in names else []
    alone = [*specular, {"kd": 1.0} | ({"ks": 0.0} if specular else {})]
    for shape in shapes(model, draws):
        for scales in alone if not model.LAMBERT_TERM else alone[:1]:
            values: dict[str, Value] = {
                p.name: float(np.clip(np.float32((shape | scales)[p.name]), p.minimum, p.maximum))
                for p in model.PARAMETERS
            }
            material = closed_form_material(name, values)
            if material.rendered:
                yield material


def worst_error(mi: Any, name: str, draws: int, count: int) -> Worst:
    """Find the largest relative error of a registered BSDF.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set and `simulator.bsdfs` registered.
    name : str
        The model.
    draws : int
        Number of shapes besides the default one.
    count : int
        Number of directions of each kind of `directions`.
    """
    wi, wo = (given.astype(np.float32).astype(np.float64) for given in directions(count))
    worst = Worst(0.0, {}, wi[0], wo[0])
    for material in materials(name, draws):
        truth = material.closed_form().evaluate(unit(wi), unit(wo))[:, 0]
        found = mitsuba_reflectance(mi, material)(wi, wo)[:, 0]
        seen = truth > faintest(material, wi)
        error = np.where(seen, np.abs(found - truth) / np.where(seen, truth, 1.0), 0.0)
        error[~np.isfinite(found)] = np.inf
        at = int(np.argmax(error))
        if error[at] > worst.error:
            worst = Worst(float(error[at]), dict(material.parameters), wi[at], wo[at])
    return worst


def faintest(material: ClosedFormMaterial, wi: Array) -> Array:
    """Return the values (N,) below which single precision is not compared, by the light's direction."""
    model = material.closed_form()
    mirror, back = model.evaluate(wi, wi * [-1.0, -1.0, 1.0]), model.evaluate(wi, wi)
    return np.asarray(np.maximum(FAINTEST * np.maximum(mirror, back)[:, 0], SMALLEST))


def worst_errors(mi: Any, draws: int = 60, count: int = 2000) -> dict[str, Worst]:
    """Return `worst_error` of every model, by name."""
    return {name: worst_error(mi, name, draws, count) for name in MODELS}


def run(plots: Path | None) -> list[dict[str, Any]]:  # noqa: ARG001 - the interface of all parts
    """Measure in both variants; the scalar one, which is asked one pair at a time, over fewer."""
    from simulator import bsdfs
    from simulator.variant import LLVM, SCALAR, choose_variant, load_mitsuba

    rows = []
    for variant, draws, count in ((LLVM, 60, 2000), (SCALAR, 6, 40)):
        if variant == LLVM and choose_variant().variant != LLVM:
            continue
        mi = load_mitsuba(variant)
        bsdfs.register(mi)
        for name, worst in worst_errors(mi, draws, count).items():
            rows.append(row(f"{name}, {variant}", worst.error, "relative", BOUNDS.get(name, BOUND)))
    return rows
