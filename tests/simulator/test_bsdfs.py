"""The registered BSDFs are the models of `analysis.models`, in both variants, all over their parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from analysis.models import MODELS
from benchmarks.light_bsdfs import BOUND, BOUNDS, worst_error
from benchmarks.models_digits import directions
from rig.description import Camera, default_rig
from simulator import bsdfs
from simulator.bsdfs.catalogue import LOBES
from simulator.light.mitsuba_scene import sample_events
from simulator.light.path_tracer import PathLight
from simulator.light.pixel_centres import PixelCentreLight
from simulator.light.reflectance import mitsuba_reflectance
from simulator.light.scene import Scene
from simulator.materials import ClosedFormMaterial, closed_form_material, load_bsdf, parse_material
from simulator.variant import LLVM, SCALAR, choose_variant, load_mitsuba

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

pytestmark = pytest.mark.render

WI, WO = directions(40, seed=5)


def mitsuba(variant: str) -> Any:
    """Mitsuba in a variant, with our BSDFs."""
    if variant == LLVM and choose_variant().variant != LLVM:
        pytest.skip("no LLVM here")
    mi = load_mitsuba(variant)
    bsdfs.register(mi)
    return mi


def default(name: str, **changed: float) -> ClosedFormMaterial:
    """Return a model's material with default parameters but for some."""
    return closed_form_material(name, {p.name: p.default for p in MODELS[name].PARAMETERS} | changed)


def reflectance(mi: Any, material: ClosedFormMaterial, wi: Array, wo: Array) -> Array:
    """f_r by the registered BSDF, (N, 3)."""
    return np.asarray(mitsuba_reflectance(mi, material)(wi, wo))


def test_every_model_is_rendered() -> None:
    """Would catch a model that the twin cannot trace paths with, and a row that belongs to none."""
    assert LOBES.keys() == MODELS.keys()
    assert all(default(name).rendered for name in MODELS)


@pytest.mark.parametrize("name", MODELS)
def test_vectorised_values_are_those_of_the_closed_form(name: str) -> None:
    """Would catch a wrong factor, a cancelling difference, NaN or overflow at some corner of the box."""
    worst = worst_error(mitsuba(LLVM), name, draws=6, count=200)
    assert worst.error <= BOUNDS.get(name, BOUND), worst


@pytest.mark.parametrize("name", MODELS)
def test_scalar_values_are_those_of_the_closed_form(name: str) -> None:
    """Would catch lobes that mean something else when their numbers are Python's."""
    worst = worst_error(mitsuba(SCALAR), name, draws=2, count=4)
    assert worst.error <= BOUNDS.get(name, BOUND), worst


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize(("variant", "draws", "count"), [(LLVM, 60, 2000), (SCALAR, 6, 40)])
def test_values_over_the_whole_box(name: str, variant: str, draws: int, count: int) -> None:
    """Would catch what a few draws miss."""
    worst = worst_error(mitsuba(variant), name, draws, count)
    assert worst.error <= BOUNDS.get(name, BOUND), worst


@pytest.mark.parametrize("variant", [LLVM, SCALAR])
def test_channels_keep_their_own_parameters(variant: str) -> None:
    """Would catch channels exchanged, or one width used for all of them."""
    material = parse_material(
        "ggx-anisotropic:kd=0.1/0.2/0.3,ks=0.5/0.4/0.3,alpha_x=0.3/0.2/0.4,alpha_y=0.1/0.2/0.15,"
        "axis_rad=0.6,f0=0.04/0.9/0.5"
    )
    assert isinstance(material, ClosedFormMaterial)
    expected = material.closed_form().evaluate(WI, WO)
    np.testing.assert_allclose(reflectance(mitsuba(variant), material, WI, WO), expected, rtol=1e-4)


@pytest.mark.parametrize("name", [name for name, model in MODELS.items() if model.RECIPROCAL])
def test_light_and_camera_may_change_places(name: str) -> None:
    """Would catch a lobe that takes the camera for the light somewhere."""
    mi, material = mitsuba(LLVM), default(name)
    forth, back = reflectance(mi, material, WI, WO), reflectance(mi, material, WO, WI)
    np.testing.assert_allclose(forth, back, rtol=1e-5, atol=1e-30)


def test_phong_as_published_is_not_reciprocal() -> None:
    """Would catch the lecture's Phong being repaired in silence: f(L, E)/f(E, L) is the cosines' ratio."""
    mi, material = mitsuba(LLVM), default("phong", kd=0.0)
    forth, back = reflectance(mi, material, WI, WO), reflectance(mi, material, WO, WI)
    seen = back[:, 0] > 1e-6
    ratio = forth[seen, 0] / back[seen, 0]
    np.testing.assert_allclose(ratio, WO[seen, 2] / WI[seen, 2], rtol=1e-4)
    assert ratio.max() > 2.0


@pytest.mark.parametrize(
    "line",
    [
        "ggx-anisotropic:kd=0.1,ks=0.5,alpha_x=0.4,alpha_y=0.1,axis_rad=0.6,f0=0.5",
        "mitsuba:roughconductor,alpha_u=0.4,alpha_v=0.1",
    ],
)
def test_a_grain_runs_the_same_way_all_over_the_sample(line: str) -> None:
    """Would catch a grain that follows the disk's parametrisation, or a sample that is no disc for it."""
    mi, material = mitsuba(LLVM), parse_material(line)
    rig = default_rig(
        camera=Camera(width_px=32, height_px=24, focal_length_px=300.0, principal_point_px=(15.5, 11.5))
    )
    pose = (0.3, 0.2, -0.4, 0.1)
    scene = Scene(rig, material, sample_events(mi, material))
    traced = PathLight(mi, scene, samples_per_pixel=64).render(pose, 1e-2).radiance
    expected = PixelCentreLight(mi, rig, material).radiance(pose)
    assert traced.mean() == pytest.approx(expected.mean(), rel=3e-3)
    inside = (traced > 0.0) & (expected > 0.0)
    assert np.median(np.abs(traced[inside] / expected[inside] - 1.0)) < 3e-3


@pytest.mark.parametrize("name", ["ggx-conductor", "lafortune", "eon", "sgd"])
def test_changed_parameters_compile_nothing(name: str) -> None:
    """Would catch parameters baked into kernels, which makes every new material slow."""
    import drjit as dr

    mi = mitsuba(LLVM)
    bsdf = load_bsdf(mi, default(name))
    si, context = mi.SurfaceInteraction3f(), mi.BSDFContext()
    si.wi = mi.Vector3f(WO.T.astype(np.float32))
    light = mi.Vector3f(WI.T.astype(np.float32))
    dr.eval(bsdf.eval_pdf(context, si, light))
    parameters = mi.traverse(bsdf)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        for kd in (0.21, 0.37, 0.43):
            parameters["kd"] = mi.Color3f(kd, 0.1, kd)
            parameters.update()
            dr.eval(bsdf.eval_pdf(context, si, light))
        kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
    assert kernels
    assert all(entry["cache_hit"] for entry in kernels)
