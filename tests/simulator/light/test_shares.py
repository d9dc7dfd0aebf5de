"""Bounds of path classes: never below the truth, which the three-point solver and images of the lamp tell."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.light_scenes import draw_scenes
from rig.angles import unit
from rig.description import Rig, default_rig
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.classes import light_paths, path_classes
from simulator.light.gather_nodes import LEVELS
from simulator.light.path_classes import PathClasses
from simulator.light.paths import LightPaths
from simulator.light.pixelwise import PixelwiseLight
from simulator.light.radiosity import Radiosity
from simulator.light.reflectance import closed_form_reflectance, material_reflectance
from simulator.light.scene import Event, Housing, PlanarMirror, Scene, default_housing
from simulator.light.shares import Shares
from simulator.light.three_point import PointLamp, Surface, ThreePoint
from simulator.light.virtual_lights import VirtualLights
from simulator.materials import ClosedFormMaterial, parse_material

RIG = default_rig()
MIRROR = PlanarMirror((120.0, 0.0, 100.0), (0.0, -60.0, 0.0), (0.0, 0.0, 60.0), 0.9)


def scene_of(spec: str, rig: Rig = RIG, **parts: Any) -> Scene:
    """Return a scene of a closed form."""
    material = parse_material(spec)
    assert isinstance(material, ClosedFormMaterial)
    event = Event.LAMBERTIAN if material.model == "lambert" else Event.GLOSSY
    return Scene(rig, material, frozenset({event}), **parts)


def shares_of(scene: Scene) -> Shares:
    """Return the bounds of a scene of a closed form."""
    assert isinstance(scene.material, ClosedFormMaterial)
    return Shares(scene, closed_form_reflectance(scene.material))


class TestClasses:
    @pytest.mark.parametrize(
        ("events", "housing", "mirrors", "expression"),
        [
            ({"Dl"}, False, (), "LDlE"),
            ({"Dg", "S"}, False, (), "L(Dg|S)E"),
            ({"Dl"}, True, (), "LDl+E"),
            ({"Dg"}, True, (), "L(Dl|DgDl)*DgE"),
            ({"S"}, True, (), "L(S?Dl)*SE"),
            ({"Dg"}, False, (MIRROR,), "LS?(DgS)*DgE"),
            (set(), True, (MIRROR,), ""),
        ],
    )
    def test_the_paths_are_those_of_the_walks(
        self, events: set[str], housing: bool, mirrors: Any, expression: str
    ) -> None:
        """Would catch a flat sample that lights itself, and a path that no class holds or two hold."""
        scene = Scene(
            RIG,
            parse_material("lambert:kd=0.5"),
            frozenset(map(Event, events)),
            default_housing(RIG, 0.1 if housing else 0.0),
            mirrors,
        )
        assert light_paths(scene) == LightPaths(expression)
        rest = light_paths(scene)
        for path_class in path_classes(scene):
            assert path_class.paths <= rest
            rest -= path_class.paths
        assert not rest

    def test_a_mirror_that_the_sample_cannot_see_is_no_part_of_its_light(self) -> None:
        """Would catch light from behind a mirror, or from below the sample's horizon."""
        turned = PlanarMirror(MIRROR.centre_mm, MIRROR.up_mm, MIRROR.across_mm)
        below = PlanarMirror((120.0, 0.0, -100.0), MIRROR.across_mm, MIRROR.up_mm)
        for mirror in (turned, below):
            scene = scene_of("lambert:kd=0.5", mirrors=(mirror,))
            assert (
                max(shares_of(scene).bounds(np.radians([[-40.0, 0.0, 20.0, 0.0]]))[0][1:], default=0.0) == 0.0
            )


class TestHousing:
    @pytest.mark.parametrize("seed", range(4))
    def test_bounds_hold_and_are_of_use(self, seed: int, cube: Any) -> None:
        """Would catch a bound below the truth, for which light would be skipped, or far above it."""
        rng = np.random.default_rng(seed)
        albedo = float(rng.uniform(0.03, 0.6))
        spec = (
            f"lambert:kd={rng.uniform(0.1, 0.9)}",
            f"cook-torrance:kd={rng.uniform(0.05, 0.5)},ks=0.5,m={rng.uniform(0.25, 0.5)},ior=1.5",
        )[seed % 2]
        half_mm = float(rng.uniform(1.3, 2.0)) * RIG.lamp.distance_mm
        scene = scene_of(spec, housing=Housing(albedo, half_mm), lamp_cosine=False)
        shares = shares_of(scene)
        angles = np.radians([rng.uniform(-70, 70), rng.uniform(-180, 179), rng.uniform(-70, 70), 0.0])
        found = three_point_shares(scene, angles, cube)
        bounds = dict(zip((c.name for c in shares.classes), shares.bounds([angles])[0], strict=True))
        longer = bounds.pop("4 events and more")
        by_events = [
            sum(b for name, b in bounds.items() if LightPaths(name).with_events(n, n)) for n in (1, 2, 3)
        ]
        assert by_events[0] == pytest.approx(1.0)
        assert found[0] <= by_events[1]
        assert found[1] <= by_events[2]
        assert sum(found[2:]) <= longer
        # 1.1 to 1.5 times the truth for one wall, up to 2 for two, here.
        assert by_events[1] < 2.0 * found[0]
        assert by_events[2] < 4.0 * found[1]


def three_point_shares(scene: Scene, angles: Any, cube: Any) -> list[float]:
    """Shares of the light with 2, 3, ... 6 events, at the sample's centre, of the channel of the largest."""
    assert isinstance(scene.material, ClosedFormMaterial)
    assert scene.housing is not None
    frames = Kinematics(scene.rig).frames(angles)
    radius = scene.sample_radius_mm
    disc = Surface(
        [0, 0, 0], [radius, 0, 0], [0, radius, 0], closed_form_reflectance(scene.material), 2, round_=True
    )
    solver = ThreePoint(
        [disc, *cube(scene.housing.half_size_mm, scene.housing.albedo, 6)],
        PointLamp(frames.light_mm, scene.lamp_intensity),
    )
    wo = unit(frames.camera_mm)[None]
    orders = solver.camera_radiance(0, np.zeros((1, 3)), wo, 6)[:, 0, 0]
    return [float(order / orders.sum()) for order in orders[1:]]


class TestMirrors:
    @pytest.mark.parametrize("seed", range(6))
    def test_the_lamps_image_is_bounded(self, seed: int) -> None:
        """Would catch a mirror taken to be invisible, or its image too weak."""
        rng = np.random.default_rng(seed)
        scene = scene_of("cook-torrance:kd=0.2,ks=0.5,m=0.3,ior=1.5", mirrors=(MIRROR,))
        shares = shares_of(scene)
        angles = np.radians([rng.uniform(-60, 0), rng.uniform(-180, 179), rng.uniform(-60, 60), 0.0])
        names = [path_class.name for path_class in shares.classes]
        bound = shares.bounds([angles])[0][names.index("LSDgE")]
        pixels = pixel_geometry(RIG, angles)
        seen = pixels.on_sample
        points = np.column_stack([pixels.position_mm[seen], np.zeros(seen.sum())])
        material = scene.material
        assert isinstance(material, ClosedFormMaterial)
        f_r = closed_form_reflectance(material)
        lamp = Kinematics(RIG).frames(angles).light_mm
        direct = radiance(f_r, points, pixels.wo[seen], lamp).mean()
        image = MIRROR.image(lamp)
        across = Surface(MIRROR.centre_mm, MIRROR.across_mm, MIRROR.up_mm, 1.0, 1)
        through = across.blocks(points, np.broadcast_to(image, points.shape))
        mirrored = 0.9 * (through[:, None] * radiance(f_r, points, pixels.wo[seen], image)).mean()
        assert mirrored / (direct + mirrored) <= bound
        assert bound == 0.0 or through.any()


def radiance(f_r: Any, points: Any, wo: Any, lamp: Any) -> Any:
    """Radiance (N, 3) of points of the sample lit by a point."""
    way = lamp - points
    distance = np.linalg.norm(way, axis=1)
    wi = way / distance[:, None]
    return f_r(wi, wo) * (RIG.lamp.distance_mm**2 * np.maximum(wi[:, 2], 0.0) / distance**2)[:, None]


class TestDrawnScenes:
    """Every kind of material, lamp, distance, aperture and pose, as the study of the choice draws them."""

    @pytest.mark.parametrize("seed", [101, pytest.param(102, marks=pytest.mark.slow)])
    def test_bounds_of_a_housing_hold(self, scalar: Any, seed: int) -> None:
        """Would catch a bound below the light that the walls give, which would be skipped."""
        checked = 0
        for drawn in draw_scenes(scalar, 8, seed):
            if drawn.scene.housing is None or drawn.scene.mirrors:
                continue
            reflectance = material_reflectance(scalar, drawn.scene.material)
            pixels = pixel_geometry(drawn.scene.rig, drawn.pose)
            frames = Kinematics(drawn.scene.rig).frames(drawn.pose)
            direct = PixelwiseLight(drawn.scene.rig, reflectance).radiance(drawn.pose)[pixels.on_sample]
            if not direct.any():
                continue
            shares = Shares(drawn.scene, reflectance)
            places = pixels.position_mm[pixels.on_sample]
            for path_class, bound in zip(shares.classes, shares.bounds([drawn.pose])[0], strict=True):
                if path_class.paths <= LightPaths("LDE"):
                    continue
                walls = Radiosity(drawn.scene, reflectance, path_class.paths)
                light = walls.picture(frames.light_mm, frames.camera_mm, places, LEVELS[2])[0]
                share = (light.mean(axis=0) / (direct.mean(axis=0) + light.mean(axis=0))).max()
                assert share <= bound, drawn.label
                checked += 1
        assert checked > 4

    @pytest.mark.parametrize("seed", [103, pytest.param(104, marks=pytest.mark.slow)])
    def test_bounds_of_lamps_in_mirrors_hold(self, scalar: Any, seed: int) -> None:
        """Would catch a mirror that is taken to throw no light on the sample although it does."""
        seen = 0
        for drawn in draw_scenes(scalar, 45, seed):
            if drawn.scene.housing is not None or not drawn.scene.mirrors:
                continue
            reflectance = material_reflectance(scalar, drawn.scene.material)
            on_sample = pixel_geometry(drawn.scene.rig, drawn.pose).on_sample
            direct = PixelwiseLight(drawn.scene.rig, reflectance).radiance(drawn.pose)[on_sample].mean(axis=0)
            shares = Shares(drawn.scene, reflectance)
            for path_class, bound in zip(shares.classes, shares.bounds([drawn.pose])[0], strict=True):
                if path_class.paths <= LightPaths("LS+DE"):
                    lights = VirtualLights(drawn.scene, reflectance, path_class.paths)
                    light = lights.render(drawn.pose, 3e-2).radiance[on_sample].mean(axis=0)
                    with np.errstate(invalid="ignore"):
                        share = np.nan_to_num(light / (direct + light)).max()
                    assert share <= bound, drawn.label
                    seen += share > 0.0
        assert seen

    @pytest.mark.slow
    @pytest.mark.render
    @pytest.mark.parametrize("seed", [105, 106])
    def test_bounds_of_light_to_and_fro_hold(self, vector: Any, seed: int) -> None:
        """Would catch light between a sample and a mirror that is skipped although it counts."""
        checked = 0
        for drawn in draw_scenes(vector, 40, seed):
            if drawn.scene.housing is not None or not drawn.scene.mirrors:
                continue
            reflectance = material_reflectance(vector, drawn.scene.material)
            on_sample = pixel_geometry(drawn.scene.rig, drawn.pose).on_sample
            shares = Shares(drawn.scene, reflectance)
            classes = [one.paths for one in shares.classes]
            if len(classes) < 2 or not on_sample.any():
                continue
            found = PathClasses(vector, drawn.scene, classes, longest=6).estimates(drawn.pose, 4)
            means = np.array([one.mean[on_sample].mean(axis=0) for one in found])
            noise = np.array([one.standard_error[on_sample].max(axis=0) for one in found])
            for number, path_class in enumerate(shares.classes):
                if path_class.paths <= LightPaths("LS*DE"):
                    continue
                bound = shares.bounds([drawn.pose])[0][number]
                light = means[number] - 3.0 * noise[number] / np.sqrt(on_sample.sum())
                assert (light / means.sum(axis=0)).max() <= bound, (drawn.label, path_class.name)
                checked += means[number].any()
        assert checked


def test_many_poses_are_bounded_as_each_is_alone(scalar: Any) -> None:
    """Would catch a pose that is told from others asked at the same time: frames would depend on it."""
    for drawn in draw_scenes(scalar, 9, 107):
        if drawn.scene.housing is None and not drawn.scene.mirrors:
            continue
        shares = Shares(drawn.scene, material_reflectance(scalar, drawn.scene.material))
        rng = np.random.default_rng(0)
        poses = rng.uniform(-1.2, 1.2, (20, 4))
        assert shares.bounds(poses) == [shares.bounds([pose])[0] for pose in poses]
