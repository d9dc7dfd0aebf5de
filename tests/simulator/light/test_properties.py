"""What light does whatever the rig: it adds up, falls with the square of the distance, and knows no north.

Rigs, poses and materials are drawn at random, more of them in slow runs. Every method of the table takes part
in what it can serve.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_erosion

from analysis.models import MODELS
from benchmarks.light_stability_light import scaled, scenes, served, units_target
from rig.angles import unit
from rig.description import Camera, Lamp, Rig, Sample, default_rig
from rig.pixels import pixel_geometry
from simulator.light.classes import light_paths
from simulator.light.hemisphere import hemisphere
from simulator.light.methods import METHODS
from simulator.light.mitsuba_scene import sample_events
from simulator.light.path_classes import PathClassesMethod
from simulator.light.path_tracer import PathTracing
from simulator.light.paths import LightPaths
from simulator.light.pixelwise import PointMethod
from simulator.light.radiosity import RadiosityMethod
from simulator.light.reflectance import closed_form_reflectance
from simulator.light.scene import Housing, Scene
from simulator.light.three_point import PointLamp, Surface, ThreePoint
from simulator.light.walls import Walls
from simulator.materials import ClosedFormMaterial, closed_form_material, load_bsdf

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from simulator.light.evaluator import Method

    Array = NDArray[np.float64]

TOLERANCE = 1e-2
SIDE_PX = 7
EXACT = [method for method in METHODS if not isinstance(method, PathTracing | PathClassesMethod)]
LONG = {"radiosity of the housing", "direct light on the sample's form in float64", "photon map"}
"""Methods that take seconds."""
METHOD = pytest.mark.parametrize(
    "method",
    [pytest.param(m, marks=pytest.mark.slow if m.name in LONG else [], id=m.name) for m in EXACT],
)
COUNT = pytest.mark.parametrize("count", [2, pytest.param(25, marks=pytest.mark.slow)])
FEW = pytest.mark.parametrize("count", [1, pytest.param(5, marks=pytest.mark.slow)])


@dataclass(frozen=True)
class Setting:
    """A rig, a pose and a material."""

    rig: Rig
    pose: tuple[float, ...]
    material: ClosedFormMaterial

    def changed(self, **parameters: float) -> Setting:
        """Return it with other parameters of the material."""
        values = {**self.material.parameters, **parameters}
        return replace(self, material=closed_form_material(self.material.model, values))


def lengths(low: float, high: float) -> st.SearchStrategy[float]:
    """Draw a length."""
    return st.floats(low, high, allow_subnormal=False)


@st.composite
def a_setting(draw: st.DrawFn) -> Setting:
    """Draw a rig whose sample about fills the frame, a pose above the horizon and an isotropic material."""
    distance_mm, diameter_mm = draw(lengths(200.0, 2000.0)), draw(lengths(10.0, 100.0))
    camera = Camera(
        distance_mm=distance_mm,
        width_px=SIDE_PX,
        height_px=SIDE_PX,
        focal_length_px=draw(lengths(0.7, 1.5)) * SIDE_PX * distance_mm / diameter_mm,
        principal_point_px=(SIDE_PX // 2, SIDE_PX // 2),
        aperture_diameter_mm=draw(lengths(1.0, 20.0)),
    )
    lamp = Lamp(distance_mm=draw(lengths(200.0, 2000.0)), diameter_mm=draw(lengths(1.0, 20.0)))
    rig = default_rig(camera=camera, lamp=lamp, sample=Sample(diameter_mm=diameter_mm))
    steep, around = lengths(-1.2, 1.2), lengths(-3.0, 3.0)
    name = draw(st.sampled_from([n for n, model in MODELS.items() if model.ISOTROPIC and n != "sgd"]))
    values = {p.name: p.default for p in MODELS[name].PARAMETERS}
    scales = {key: draw(lengths(0.05, 0.4)) for key in ("kd", "ks") if key in values}
    material = closed_form_material(name, values | scales)
    return Setting(rig, (draw(steep), draw(around), draw(steep), draw(around)), material)


def check(count: int, claim: Callable[[Setting], None]) -> None:
    """Let a claim be tried on so many settings, the same every time."""
    asked = settings(
        max_examples=count, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
    )
    asked(given(a_setting())(claim))()


def picture(evaluator: Any, setting: Setting) -> Array:
    """Radiance of the setting's pose."""
    return np.asarray(evaluator.render(setting.pose, TOLERANCE).radiance)


def at_work(mi: Any, method: Method, setting: Setting, scale: float = 1.0) -> dict[str, Any]:
    """Return a method at work on every scene that it can serve."""
    return served(mi, method, scenes(mi, setting.rig, setting.material, scale))


def accept(found: Array, expected: Array, relative: float) -> None:
    """Require equality relative to the mean."""
    assert np.abs(found - expected).max() <= relative * max(expected.mean(), 1e-30)


def digits(method: Method) -> float:
    """Return what rounding may do to a pixel of a lobe as narrow as the defaults."""
    return 1e-5 if "Mitsuba" in method.name or "BSDF" in method.name else 1e-9


@pytest.mark.render
@METHOD
@COUNT
class TestMethods:
    def test_scale(self, vector: Any, method: Method, count: int) -> None:
        """Would catch a length that is typed in, or an intensity that does not go with the distance."""

        def claim(setting: Setting) -> None:
            bigger = at_work(vector, method, setting, 37.0)
            for name, evaluator in at_work(vector, method, setting).items():
                accept(
                    picture(bigger[name], setting), picture(evaluator, setting), 100 * units_target(method)
                )

        check(count, claim)

    def test_albedo(self, vector: Any, method: Method, count: int) -> None:
        """Would catch light that is not in proportion to what the sample reflects, event by event."""

        def claim(setting: Setting) -> None:
            scales = {k: v for k, v in setting.material.parameters.items() if k in {"kd", "ks"}}
            half = setting.changed(**{key: 0.5 * float(value) for key, value in scales.items()})  # type: ignore[arg-type]
            for name, evaluator in at_work(vector, method, half).items():
                if name == "housing" and isinstance(method, RadiosityMethod):
                    continue  # light that meets the sample twice is there too
                twice = at_work(vector, method, setting)[name]
                accept(2.0 * picture(evaluator, half), picture(twice, setting), digits(method))

        check(count, claim)

    def test_no_direction_is_special(self, vector: Any, method: Method, count: int) -> None:
        """Would catch axes that are mixed up: an isotropic sample may be turned about its normal."""

        def claim(setting: Setting) -> None:
            evaluators = at_work(vector, method, setting)
            if "plain" in evaluators:
                turned = replace(setting, pose=(*setting.pose[:3], setting.pose[3] + 1.0))
                here, there = (picture(evaluators["plain"], each) for each in (setting, turned))
                accept(there, here, digits(method))

        check(count, claim)

    def test_square_of_the_distance(self, vector: Any, method: Method, count: int) -> None:
        """Would catch a lamp that falls with another power: it is 1 at the centre from any distance."""

        def claim(setting: Setting) -> None:
            if not isinstance(method, PointMethod):
                return
            farther = setting.rig.lamp.model_copy(update={"distance_mm": 3.0 * setting.rig.lamp.distance_mm})
            other = replace(setting, rig=setting.rig.model_copy(update={"lamp": farther}))
            here, there = (
                picture(at_work(vector, method, each)["plain"], each)[SIDE_PX // 2, SIDE_PX // 2]
                for each in (setting, other)
            )
            accept(there, here, digits(method))

        check(count, claim)


class TestWalls:
    def test_furnace(self) -> None:
        """Would catch form factors that lose light: evenly lit walls give each other 1 + a + a^2 + ..."""
        shares = Walls(700.0, 8).form_factors()
        np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-9)
        for albedo in (0.04, 0.5, 0.95):
            solved = np.linalg.solve(np.eye(len(shares)) - albedo * shares, np.ones(len(shares)))
            np.testing.assert_allclose(solved, 1.0 / (1.0 - albedo), rtol=1e-9)

    @pytest.mark.slow
    @pytest.mark.parametrize("count", [3])
    def test_wall_albedo(self, count: int) -> None:
        """Would catch light over one wall that is not in proportion to what the wall reflects."""

        def claim(setting: Setting) -> None:
            white = replace(setting, material=closed_form_material("lambert", {"kd": 0.5}))
            scene = Scene(white.rig, white.material, frozenset(sample_events(None, white.material)))
            found = []
            for albedo in (0.2, 0.6):
                housed = replace(scene, housing=Housing(albedo, 4000.0))
                once = LightPaths("LDlDlE") & light_paths(housed)
                found.append(picture(RadiosityMethod().build(None, housed, once), white))
            accept(3.0 * found[0], found[1], 1e-9)

        check(count, claim)


class TestThreePoint:
    @COUNT
    def test_square_linearity_and_origin(self, count: int) -> None:
        """Would catch g without its square, power that does not count once, or a place that matters."""

        def claim(setting: Setting) -> None:
            rho, s = float(setting.material.parameters["kd"]), setting.rig.lamp.distance_mm / 100.0  # type: ignore[arg-type]
            shift = np.array([3.0, -7.0, 5.0])

            def light(scale: float, power: float, albedo: float, origin: Array) -> Array:
                lower = Surface(origin, (scale, 0, 0), (0, scale, 0), albedo, 4)
                above = origin + np.array([0.0, 0.0, 2.0 * scale])
                upper = Surface(above, (scale, 0, 0), (0, -scale, 0), albedo, 4)
                lamp = PointLamp(origin + scale * np.array([2.0, 0.3, 1.0]), power)
                point, wo = origin + scale * np.array([[0.1, 0.2, 0.0]]), unit(np.array([[0.1, 0.5, 1.0]]))
                return ThreePoint([lower, upper], lamp).camera_radiance(0, point, wo, 3)

            plain = light(1.0, 1.0, rho, np.zeros(3))
            np.testing.assert_allclose(light(s, 1.0, rho, np.zeros(3)), plain / s**2, rtol=1e-12)
            np.testing.assert_allclose(light(1.0, s, rho, np.zeros(3)), s * plain, rtol=1e-12)
            np.testing.assert_allclose(light(1.0, 1.0, rho, shift), plain, rtol=1e-12)
            per_event = np.power(0.5, [1, 2, 3])[:, None, None]
            np.testing.assert_allclose(light(1.0, 1.0, 0.5 * rho, np.zeros(3)), per_event * plain, rtol=1e-12)

        check(count, claim)


class TestFurnace:
    def test_white(self) -> None:
        """Would catch a hemisphere whose weights do not sum to pi."""
        white = closed_form_reflectance(closed_form_material("lambert", {"kd": 1.0}))
        for theta in (0.0, 1.0, 1.57):
            half = hemisphere(white, np.array([np.sin(theta), 0.0, np.cos(theta)]))
            np.testing.assert_allclose(np.pi * half.least + half.rest, 1.0, rtol=1e-12)

    @pytest.mark.render
    @pytest.mark.parametrize("albedo", [0.3, 1.0])
    def test_of_mitsuba(self, vector: Any, albedo: float) -> None:
        """Would catch a white that is no white: inside a white sphere it cannot be seen."""
        white = load_bsdf(vector, closed_form_material("lambert", {"kd": albedo}))
        scene = vector.load_dict(
            {
                "type": "scene",
                "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}},
                "sample": {"type": "rectangle", "bsdf": white},
            },
            optimize=False,
        )
        camera = vector.load_dict(
            {
                "type": "perspective",
                "fov": 5.0,
                "to_world": vector.ScalarTransform4f().look_at([0, -3, 6], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
            }
        )
        direct = vector.load_dict({"type": "direct", "emitter_samples": 0, "bsdf_samples": 1})
        image = np.asarray(vector.render(scene, sensor=camera, integrator=direct, spp=16))
        np.testing.assert_allclose(image, albedo, rtol=2e-6)


@pytest.mark.render
@FEW
def test_paths_are_the_same_in_other_units(vector: Any, count: int) -> None:
    """Would catch a path tracer with a length of its own: an epsilon, a clip, an intensity."""
    method = next(method for method in METHODS if isinstance(method, PathTracing))

    def claim(setting: Setting) -> None:
        upright = replace(setting, pose=(0.4, 0.3, -0.2, 0.1))
        scene = Scene(upright.rig, upright.material, sample_events(vector, upright.material))
        bigger = replace(scene, rig=scaled(upright.rig, 37.0))
        paths = light_paths(scene)
        here, there = (method.build(vector, each, paths) for each in (scene, bigger))
        one, other = (evaluator.render(upright.pose, 0.3).radiance for evaluator in (here, there))
        # A ray that grazes the sample's edge may fall on either side of it, in single precision.
        inside = binary_erosion(pixel_geometry(upright.rig, upright.pose).on_sample)
        assert np.sqrt(np.mean(np.square(one - other)[inside])) <= 1e-3 * one.mean()

    check(count, claim)
