"""Both modes of Mitsuba agree: exact methods to single precision, random ones as two draws of one thing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.stats import t

from analysis.models import MODELS
from benchmarks.light_stability_light import scenes, served
from benchmarks.light_stability_points import POSES, RIG, lobe
from benchmarks.models_digits import directions
from simulator import bsdfs
from simulator.light.methods import METHODS
from simulator.light.path_tracer import PathLight, PathTracing
from simulator.light.reflectance import mitsuba_reflectance
from simulator.materials import closed_form_material, parse_material
from simulator.variant import LLVM, SCALAR, choose_variant, load_mitsuba

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from simulator.light.evaluator import Method
    from simulator.light.path_tracer import Estimate
    from simulator.materials import Material

    Array = NDArray[np.float64]

pytestmark = [
    pytest.mark.render,
    pytest.mark.skipif(choose_variant().variant != LLVM, reason="no LLVM >= 19 on this machine"),
]

AGREEMENT = 1e-6
SIGNIFICANCE, PIXELS = 0.01, 0.9975
"""As Mitsuba's own tests of renders have it."""
RENDERS = 6
POSE = POSES["oblique"]
MATERIALS = [
    lobe(0.3),
    closed_form_material("lambert", {"kd": 0.7}),
    parse_material("mitsuba:roughconductor,alpha=0.6,material=none"),
]
QUICK = {"one BSDF value per pixel", "direct light by quadrature in float64", "virtual lights"}
"""Methods that do not take seconds."""
EXACT = [method for method in METHODS if not isinstance(method, PathTracing)]


def mode(variant: str) -> Any:
    """Return Mitsuba in a mode, our BSDFs registered."""
    mi = load_mitsuba(variant)
    bsdfs.register(mi)
    return mi


def pictures(variant: str, method: Method, material: Material) -> dict[str, Array]:
    """Return pictures of every scene that a method serves in a mode."""
    mi = mode(variant)
    at_work = served(mi, method, scenes(mi, RIG, material))
    return {name: evaluator.render(POSE, 1e-2).radiance for name, evaluator in at_work.items()}


@pytest.mark.parametrize("material", MATERIALS, ids=lambda material: material.spec.partition(",")[0])
@pytest.mark.parametrize(
    "method",
    [pytest.param(m, marks=[] if m.name in QUICK else pytest.mark.slow, id=m.name) for m in EXACT],
)
def test_exact_methods_agree(method: Method, material: Material) -> None:
    """Would catch a method that means something else where numbers come one by one."""
    vectorised, scalar = (pictures(variant, method, material) for variant in (LLVM, SCALAR))
    for name, picture in scalar.items():
        difference = np.sqrt(np.mean(np.square(picture - vectorised[name])))
        assert difference <= AGREEMENT * picture.mean(), name


def test_vectorised_methods_agree_with_their_like() -> None:
    """Would catch a method without a scalar form that differs from the one that takes its place."""
    points = [method for method in METHODS if method.name.startswith(("pixel centres", "one BSDF"))]
    sizes = [method for method in METHODS if method.name.startswith("direct light by quadrature")]
    for pair in (points, sizes):
        assert len(pair) == 2
        found = []
        for method in pair:
            both = [pictures(variant, method, MATERIALS[0]) for variant in (LLVM, SCALAR)]
            found += [each["plain"] for each in both if each]
        for picture in found[1:]:
            assert np.sqrt(np.mean(np.square(picture - found[0]))) <= AGREEMENT * picture.mean()


@pytest.mark.parametrize("name", MODELS)
def test_bsdfs_agree(name: str) -> None:
    """Would catch a formula whose rounding differs by more than a few last digits between the modes."""
    wi, wo = directions(12, seed=8)
    material = closed_form_material(name, {p.name: p.default for p in MODELS[name].PARAMETERS})
    vectorised, scalar = (mitsuba_reflectance(mode(variant), material)(wi, wo) for variant in (LLVM, SCALAR))
    difference = np.sqrt(np.mean(np.square(vectorised - scalar)))
    assert difference <= AGREEMENT * np.sqrt(np.mean(np.square(scalar)))


def accepted(found: Estimate, wanted: Estimate) -> float:
    """Share of lit pixels that a t-test with Sidak's correction accepts."""
    lit = (found.mean > 0.0) & (wanted.mean > 0.0)
    variance = (np.square(found.standard_error) + np.square(wanted.standard_error))[lit]
    # Light that hardly varies is known to its rounding only.
    spread = np.sqrt(variance + np.square(AGREEMENT * wanted.mean.mean()))
    error = np.abs(found.mean - wanted.mean)[lit] / spread
    bound = t.isf(0.5 * (1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / error.size)), 2 * (RENDERS - 1))
    return float(np.mean(error < bound))


@pytest.mark.parametrize("place", ["plain", "tilted", "housing"])
def test_random_methods_agree(place: str) -> None:
    """Would catch paths that carry other light where they are followed one by one."""
    found = []
    for variant in (LLVM, SCALAR):
        mi = mode(variant)
        scene = scenes(mi, RIG, MATERIALS[1])[place]
        found.append(PathLight(mi, scene, last=3, samples_per_pixel=64).estimate(POSE, RENDERS))
    assert accepted(*found) >= PIXELS
    brighter = found[1]._replace(mean=1.1 * found[1].mean)
    assert accepted(found[0], brighter) < PIXELS
