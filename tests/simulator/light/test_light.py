"""Every method of lighting agrees with the others: closed form, Mitsuba at pixel centres, path tracing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from rig.description import Camera, Rig, default_rig
from rig.errors import BadInput, Refused
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.mitsuba_scene import sample_events
from simulator.light.path_tracer import PathLight
from simulator.light.pixel_centres import PixelCentreLight
from simulator.light.pixelwise import PixelwiseLight
from simulator.light.reflectance import closed_form_reflectance, mitsuba_reflectance
from simulator.light.renderer import Renderer
from simulator.light.scene import Scene
from simulator.materials import ClosedFormMaterial, parse_material
from simulator.variant import LLVM, choose_variant

if TYPE_CHECKING:
    from numpy.typing import NDArray

CLOSED_FORMS = {
    "lambert": "lambert:kd=0.2/0.4/0.6",
    "phong": "phong:kd=0.1,ks=0.3/0.4/0.5,exponent=30",
    "modified-phong": "modified-phong:kd=0.1,ks=0.5,exponent=10/20/30",
    "blinn-phong": "blinn-phong:kd=0.1,ks=0.5,exponent=60",
    "cook-torrance": "cook-torrance:kd=0.1,ks=0.5,m=0.2/0.3/0.4,ior=1.5",
    "cook-torrance-1982": "cook-torrance-1982:kd=0.1,ks=0.5,m=0.3,ior=1.3/1.5/2.5",
}
POSES = [(0.4, 0.3, -0.5, 0.2), (1.1, 2.0, 1.0, -1.0), (-1.3, 0.0, 1.2, 3.0)]
OFF_CENTRE = Camera(width_px=64, height_px=48, focal_length_px=600.0, principal_point_px=(29.5, 25.5))
RIG = default_rig(camera=OFF_CENTRE)
DISTORTED = default_rig(camera=OFF_CENTRE.model_copy(update={"distortion": (-0.3, 0.1, 0.002, -0.001, 0.0)}))


def closed_form(spec: str) -> ClosedFormMaterial:
    """Read the line of a closed form."""
    material = parse_material(spec)
    assert isinstance(material, ClosedFormMaterial)
    return material


def exact(rig: Rig, spec: str) -> PixelwiseLight:
    """Light by the float64 closed form."""
    return PixelwiseLight(rig, closed_form_reflectance(closed_form(spec)))


def path_traced(mi: Any, spec: str, *, lamp_cosine: bool = False) -> PathLight:
    """Light by the path tracer in black surroundings, of a point lamp or a disc."""
    material = parse_material(spec)
    scene = Scene(RIG, material, sample_events(mi, material), lamp_cosine=lamp_cosine)
    return PathLight(mi, scene, samples_per_pixel=64)


def inside(rig: Rig, pose: tuple[float, ...]) -> NDArray[np.bool_]:
    """Pixels whose neighbours are on the sample too."""
    on = np.pad(pixel_geometry(rig, pose).on_sample, 1, mode="edge")
    return np.logical_and.reduce([on[1:-1, 1:-1], on[:-2, 1:-1], on[2:, 1:-1], on[1:-1, :-2], on[1:-1, 2:]])


def directions(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pairs of directions up to 80 degrees, half of them around each other's mirror direction."""
    rng = np.random.default_rng(7)
    theta, phi = np.radians(rng.uniform(0.0, 80.0, (2, count))), rng.uniform(-np.pi, np.pi, (2, count))
    wi, wo = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    near = wi[::2] * [-1.0, -1.0, 1.0] + rng.normal(0.0, 0.2, (count // 2, 3))
    near[:, 2] = np.abs(near[:, 2]) + 0.15
    wo[::2] = near / np.linalg.norm(near, axis=1, keepdims=True)
    return wi, wo


@pytest.mark.render
class TestReflectance:
    @pytest.mark.parametrize("model", CLOSED_FORMS)
    def test_mitsubas_models_are_the_closed_forms(self, vector: Any, model: str) -> None:
        """Would catch a formula, a normalisation or a channel that differs between the implementations."""
        material, (wi, wo) = closed_form(CLOSED_FORMS[model]), directions(20000)
        expected = closed_form_reflectance(material)(wi, wo)
        np.testing.assert_allclose(mitsuba_reflectance(vector, material)(wi, wo), expected, rtol=5e-6)

    @pytest.mark.parametrize("model", CLOSED_FORMS)
    def test_and_so_they_are_in_the_scalar_variant(self, scalar: Any, model: str) -> None:
        """Would catch a BSDF that only works vectorised."""
        material, (wi, wo) = closed_form(CLOSED_FORMS[model]), directions(300)
        expected = closed_form_reflectance(material)(wi, wo)
        np.testing.assert_allclose(mitsuba_reflectance(scalar, material)(wi, wo), expected, rtol=5e-6)

    def test_nothing_is_reflected_below_the_horizon(self, vector: Any) -> None:
        """Would catch light that comes through the sample."""
        material = closed_form(CLOSED_FORMS["cook-torrance"])
        wi, wo = directions(10)
        assert not mitsuba_reflectance(vector, material)(wi * [1, 1, -1], wo).any()
        assert not mitsuba_reflectance(vector, material)(wi, wo * [1, 1, -1]).any()

    @pytest.mark.parametrize("model", ["modified-phong", "cook-torrance"])
    def test_sampling_and_evaluation_are_of_one_mind(self, vector: Any, model: str) -> None:
        """Would catch a density that does not belong to the samples: every path would be weighted wrongly."""
        import drjit as dr

        from simulator.materials import load_bsdf

        mi = vector
        material = closed_form(CLOSED_FORMS[model])
        bsdf, count = load_bsdf(mi, material), 1 << 18
        si = dr.zeros(mi.SurfaceInteraction3f, count)
        si.wi = mi.Vector3f(0.6, 0.0, 0.8)
        rng = mi.PCG32(count)
        uniform = mi.Point2f(rng.next_float32(), rng.next_float32())
        which = rng.next_float32()
        weight = np.asarray(bsdf.sample(mi.BSDFContext(), si, which, uniform)[1], dtype=np.float64)
        albedo, error = weight.mean(axis=1), weight.std(axis=1) / np.sqrt(count)
        # The same integral as a sum over a grid, from the closed form.
        cosine, phi = (np.arange(400) + 0.5) / 400, (np.arange(800) + 0.5) / 800 * 2.0 * np.pi
        c, p = np.meshgrid(cosine, phi)
        light = np.stack([np.sqrt(1 - c**2) * np.cos(p), np.sqrt(1 - c**2) * np.sin(p), c], axis=-1)
        f = closed_form_reflectance(material)(light.reshape(-1, 3), np.array([[0.6, 0.0, 0.8]]))
        expected = np.mean(f * c.reshape(-1, 1), axis=0) * 2.0 * np.pi
        assert np.all(np.abs(albedo - expected) < 4.0 * error + 1e-4)


@pytest.mark.render
class TestMethods:
    @pytest.mark.parametrize("rig", [RIG, DISTORTED], ids=["pinhole", "distorted"])
    @pytest.mark.parametrize("model", CLOSED_FORMS)
    def test_mitsuba_at_pixel_centres_is_the_closed_form(self, vector: Any, rig: Rig, model: str) -> None:
        """Would catch a ray beside its pixel's centre, a lamp off its place, or a lens without distortion."""
        traced = PixelCentreLight(vector, rig, closed_form(CLOSED_FORMS[model]))
        for pose in POSES:
            expected, found = exact(rig, CLOSED_FORMS[model]).radiance(pose), traced.radiance(pose)
            both = (expected > 0.0) & (found > 0.0)
            # On the edge of the sample single precision may see one pixel more or less.
            assert np.mean((expected > 0.0) != (found > 0.0)) < 1e-3
            error = found[both] / expected[both] - 1.0
            assert np.sqrt(np.mean(error**2)) < 1e-6
            assert np.max(np.abs(error)) < 1e-5

    def test_the_lamps_cosine_is_the_same_through_mitsuba(self, vector: Any) -> None:
        """Would catch an axis that does not turn with the lamp, or a cosine taken at the sample."""
        material = closed_form("lambert:kd=0.5")
        traced = PixelCentreLight(vector, RIG, material, lamp_cosine=True)
        wanted = PixelwiseLight(RIG, closed_form_reflectance(material), lamp_cosine=True)
        for pose in POSES:
            expected, found = wanted.radiance(pose), traced.radiance(pose)
            both = (expected > 0.0) & (found > 0.0)
            np.testing.assert_allclose(found[both], expected[both], rtol=2e-6)
            alike = exact(RIG, "lambert:kd=0.5").radiance(pose)
            assert np.max(alike[both] / expected[both] - 1.0) > 1e-4

    @pytest.mark.parametrize("model", ["lambert", "phong", "cook-torrance"])
    def test_the_path_tracer_finds_the_same_within_its_noise(self, vector: Any, model: str) -> None:
        """Would catch light paths left out, and wrong geometry that all pixel-centre methods share."""
        reference = path_traced(vector, CLOSED_FORMS[model])
        for pose in POSES[:2]:
            estimate, expected = reference.estimate(pose, 16), exact(RIG, CLOSED_FORMS[model]).radiance(pose)
            seen = inside(RIG, pose)
            assert seen.sum() > 500
            # A pixel's mean differs from its centre by the second derivative of the lobe: below 2e-5 here.
            error = np.hypot(estimate.standard_error, 2e-5 * expected)[seen]
            z = (estimate.mean - expected)[seen] / error
            assert np.sqrt(np.mean(z**2)) < 1.3
            # 64 x 48 pixels with 15 degrees of freedom: beyond 7 nothing is chance.
            assert np.max(np.abs(z)) < 7.0

    @pytest.mark.parametrize("spec", ["lambert:kd=0.5", "cook-torrance:kd=0.1,ks=0.5,m=0.2,ior=1.5"])
    def test_a_lamp_taken_for_a_point_is_within_the_stated_tolerance(self, vector: Any, spec: str) -> None:
        """Would catch the skipped part of the light, the lamp's size, growing beyond what is stated."""
        pose = (0.5, 0.0, -0.5, 0.2)
        disc = path_traced(vector, spec, lamp_cosine=True)
        seen = inside(RIG, pose)
        # A disc that faces the centre shines by its cosine on what lies beside it; the rig's lamp is even.
        towards = Kinematics(RIG).frames(pose).light_mm / RIG.lamp.distance_mm
        cosine = pixel_geometry(RIG, pose).wi[seen] @ towards
        ratio = disc.estimate(pose, 4).mean[seen] / (exact(RIG, spec).radiance(pose)[seen] * cosine[:, None])
        assert np.mean(ratio) == pytest.approx(1.0, abs=5e-4)
        assert np.mean(ratio) != 1.0

    def test_a_measured_file_looks_the_same_in_both_variants(self, shared_data: Any) -> None:
        """Would catch a measured BSDF read, scaled or turned differently by the two variants."""
        if choose_variant().variant != LLVM:
            pytest.skip("no LLVM >= 19 on this machine")
        spec = f"bsdf:{shared_data / 'rgl' / 'vch_golden_yellow_rgb.bsdf'}"
        pictures = [
            Renderer(RIG, {"sample1": spec}, variant=name, tolerance=1e-2).radiance("sample1", POSES[0])
            for name in ("llvm", "scalar")
        ]
        assert pictures[0][24, 32, 0] > 2.0 * pictures[0][24, 32, 2] > 0.0  # yellow
        both = np.logical_and(*(picture > 0.0 for picture in pictures))
        np.testing.assert_allclose(pictures[0][both], pictures[1][both], rtol=1e-4, atol=1e-6)

    def test_a_grain_lies_along_the_samples_axes(self, vector: Any) -> None:
        """Would catch a brushed metal whose grain turns around the centre, as the tangents of a disk do."""
        brushed = parse_material("mitsuba:roughconductor,alpha_u=0.05,alpha_v=0.4")
        up = PixelCentreLight(vector, RIG, brushed)
        across = up.radiance((0.3, 0.0, 0.0, 0.0))[24, 30]
        along = up.radiance((0.3, 0.0, 0.0, np.pi / 2))[24, 30]
        assert np.all(along > 3.0 * across)
        by_value = PixelwiseLight(RIG, mitsuba_reflectance(vector, brushed)).radiance(POSES[0])
        both = (by_value > 0.0) & (up.radiance(POSES[0]) > 0.0)
        np.testing.assert_allclose(up.radiance(POSES[0])[both], by_value[both], rtol=2e-4)

    def test_poses_and_materials_of_one_kind_share_their_kernels(self, vector: Any) -> None:
        """Would catch a number compiled into a kernel: 75 ms more for each pose of a session."""
        import drjit as dr

        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            shapes = ("kd=0.1,ks=0.5,m=0.2,ior=1.5", "kd=0.3,ks=0.1,m=0.31,ior=1.7")
            specs = (f"cook-torrance:{shape}" for shape in shapes)
            lights = [PixelCentreLight(vector, RIG, closed_form(spec)) for spec in specs]
            lights[0].radiance(POSES[0])
            dr.kernel_history_clear()
            for light in lights:
                for pose in np.random.default_rng(0).uniform(-1.0, 1.0, (5, 4)):
                    light.radiance(tuple(pose))
            history = dr.kernel_history()
        assert len(history) > 10
        assert not [kernel for kernel in history if not kernel.get("cache_hit", True)]


@pytest.mark.render
class TestRenderer:
    @pytest.mark.parametrize("variant", ["scalar", "llvm"])
    def test_white_has_the_radiance_that_defines_the_unit(self, variant: str) -> None:
        """Would catch a scale that every ratio to the white would hide."""
        renderer = Renderer(default_rig(), {}, variant=variant, white_rho=0.98)
        centre = renderer.radiance("white", (0.0, 0.0, 0.5, 0.0))[47:49, 63:65]
        np.testing.assert_allclose(centre, 0.98 / np.pi, rtol=1e-5)

    def test_level_scales_and_what_is_not_there_is_black(self) -> None:
        """Would catch a lamp level that is ignored, and a picture of an empty station."""
        renderer = Renderer(RIG, {"sample1": "lambert:kd=0.5"}, variant="scalar")
        full = renderer.radiance("sample1", POSES[0])
        np.testing.assert_allclose(renderer.radiance("sample1", POSES[0], 0.25), 0.25 * full, rtol=1e-15)
        for station in (None, "sample2", "trap"):
            assert not renderer.radiance(station, POSES[0]).any()

    def test_a_bracket_is_rendered_once(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Would catch each exposure of a bracket paying for its light, or a pose shown in another's light."""
        calls: list[tuple[float, ...]] = []
        render = PixelwiseLight.radiance

        def counting(self: PixelwiseLight, angles_rad: Any) -> Any:
            calls.append(tuple(angles_rad))
            return render(self, angles_rad)

        monkeypatch.setattr(PixelwiseLight, "radiance", counting)
        renderer = Renderer(RIG, {"sample1": "lambert:kd=0.5"}, variant="scalar", tolerance=1e-2)
        pictures = [renderer.radiance("sample1", pose) for pose in (*POSES[:1] * 3, POSES[1], POSES[0])]
        assert calls == [POSES[0], POSES[1], POSES[0]]
        assert np.array_equal(pictures[0], pictures[4])
        assert not np.array_equal(pictures[0], pictures[3])

    @pytest.mark.parametrize(
        "spec", ["mitsuba:no_such_bsdf", "mitsuba:roughconductor,alfa=0.2", "mitsuba:sphere"]
    )
    def test_what_mitsuba_refuses_is_refused_before_the_first_frame(self, spec: str) -> None:
        """Would catch a typo that shows as a traceback in the middle of a session."""
        with pytest.raises(BadInput) as refused:
            Renderer(RIG, {"sample1": spec}, variant="scalar")
        assert "\n" not in str(refused.value)
        assert spec in str(refused.value)

    @pytest.mark.parametrize("variant", ["scalar", "llvm"])
    def test_a_mirror_shows_the_lamp_and_only_in_the_mirror_direction(self, variant: str) -> None:
        """Would catch a mirror rendered black because a point cannot be hit by a ray."""
        renderer = Renderer(RIG, {"sample1": "mitsuba:conductor,material=none"}, variant=variant)
        parts = renderer.plan("sample1", POSES[0]).decision.parts
        assert [part.method.name for part in parts] == ["path tracing"]
        seen = renderer.radiance("sample1", (0.5, 0.0, -0.5, 0.0))
        lamp = RIG.lamp.distance_mm**2 / (np.pi * (RIG.lamp.diameter_mm / 2.0) ** 2)
        assert seen.max() == pytest.approx(lamp, rel=3e-3)
        assert not renderer.radiance("sample1", (0.5, 0.0, -0.8, 0.0)).any()

    def test_a_housing_adds_light_that_grows_with_its_albedo(self) -> None:
        """Would catch stray light that is left out, and a housing that hides the lamp or the camera."""
        if choose_variant().variant != LLVM:
            pytest.skip("no LLVM >= 19 on this machine")
        # Without the machine's solids, which would hide some of the walls.
        rig, pose = RIG.model_copy(update={"solids": ()}), POSES[0]
        seen = inside(RIG, pose)
        towards = Kinematics(RIG).frames(pose).light_mm / RIG.lamp.distance_mm
        cosine = pixel_geometry(RIG, pose).wi[seen] @ towards
        direct = exact(RIG, "lambert:kd=0.6").radiance(pose)[seen] * cosine[:, None]
        stray = []
        for albedo in (0.2, 0.4):
            renderer = Renderer(rig, {"sample1": "lambert:kd=0.6"}, variant="llvm", housing_albedo=albedo)
            stray.append(np.mean(renderer.radiance("sample1", pose)[seen] / direct) - 1.0)
            assert 0.05 * albedo**2 < stray[-1] < sum(renderer.plan("sample1", pose).decision.bounds[1:])
        # A wall's light is in proportion; what goes from wall to wall comes on top.
        assert 2.0 < stray[1] / stray[0] < 5.0

    def test_a_mirror_behind_a_distorting_lens_is_refused(self) -> None:
        """Would catch a picture whose distortion is silently left out."""
        renderer = Renderer(DISTORTED, {"sample1": "mitsuba:conductor,material=none"}, variant="scalar")
        with pytest.raises(Refused, match="distort"):
            renderer.radiance("sample1", POSES[0])
