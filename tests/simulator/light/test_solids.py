"""A machine's solids in the light: shadows where geometry puts them, light as albedos have it, bounds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rig.angles import unit
from rig.description import Camera, Rig, default_rig
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from rig.placement import Shape
from rig.solids import Box, Capsule, Cylinder, Sphere
from simulator.light.audit import audit_poses
from simulator.light.methods import METHODS
from simulator.light.mitsuba_meshes import solid_mesh
from simulator.light.path_tracer import PathLight
from simulator.light.pixelwise import PixelwiseLight
from simulator.light.planner import Planner
from simulator.light.reflectance import closed_form_reflectance
from simulator.light.scene import Event, Scene
from simulator.light.solids import SolidsLight
from simulator.materials import parse_material

ANGLES: Any = np.radians([-30.0, 0.0, 40.0, 0.0])
SMALL = Camera(width_px=64, height_px=48, focal_length_px=800.0, principal_point_px=(31.5, 23.5))
PAINT = "lambert:kd=0.5"


def scene(*solids: Any, spec: str = PAINT, obstructed: bool = True) -> Scene:
    """Return a machine with some solids around a sample."""
    rig = default_rig(camera=SMALL, solids=solids)
    return Scene(rig, parse_material(spec), frozenset({Event.LAMBERTIAN}), obstructed=obstructed)


def inside(rig: Rig, pose: Any = ANGLES) -> Any:
    """Tell which pixels are not on the sample's edge."""
    return np.linalg.norm(np.nan_to_num(pixel_geometry(rig, pose).position_mm, nan=99.0), axis=-1) < 23.0


def places(rig: Rig) -> tuple[Any, Any]:
    """Return lamp and camera."""
    frames = Kinematics(rig).frames(ANGLES)
    return frames.light_mm, frames.camera_mm


def ball(place_mm: Any, radius_mm: float, albedo: float) -> Sphere:
    """Return a ball that stands still."""
    return Sphere(name="ball", centre_mm=tuple(place_mm), radius_mm=radius_mm, albedo=albedo)


def bare_light(what: Scene) -> Any:
    """Return the direct light without solids, at pixel centres."""
    return PixelwiseLight(what.rig, closed_form_reflectance(what.material)).render(ANGLES, 1e-3).radiance


def share_in_sight(points: Any, centre: Any, radius_mm: float, ends: Any) -> Any:
    """Return the share (N,) of ways from points to some ends that miss a ball."""
    seen = np.zeros(len(points))
    for end in ends:
        way = unit(end - points)
        off = (centre - points) - np.sum((centre - points) * way, axis=1, keepdims=True) * way
        seen += np.linalg.norm(off, axis=1) > radius_mm
    return seen / len(ends)


def on_disc(centre: Any, radius_mm: float, count: int = 400) -> Any:
    """Return points spread over a disc that faces the origin."""
    random = np.random.default_rng(1)
    across = unit(np.cross(centre, [0.0, 1.0, 0.3]))
    up = np.cross(unit(centre), across)
    turn, far = 2.0 * np.pi * random.random(count), radius_mm * np.sqrt(random.random(count))
    return centre + (far * np.cos(turn))[:, None] * across + (far * np.sin(turn))[:, None] * up


SHAPES = {
    "box": (Shape("box", (1.0, 2.0, 3.0), 0.0, 0.0), 88.0, 48.0),
    "cylinder": (Shape("cylinder", (0.0, 0.0, 3.0), 2.0, 0.0), 32.0 * np.pi, 24.0 * np.pi),
    "capsule": (Shape("capsule", (0.0, 0.0, 3.0), 0.0, 2.0), 40.0 * np.pi, (24.0 + 32.0 / 3.0) * np.pi),
    "sphere": (Shape("sphere", (0.0, 0.0, 0.0), 0.0, 2.0), 16.0 * np.pi, 32.0 / 3.0 * np.pi),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_meshes_are_closed_and_of_the_right_size(kind: str) -> None:
    """Would catch a hole, a face inside out, and an end left off."""
    shape, area, volume = SHAPES[kind]
    corners, faces = solid_mesh(shape, 64, 8)
    a, b, c = np.moveaxis(corners[faces], 1, 0)
    normals = np.cross(b - a, c - a) / 2.0
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(area, rel=3e-3)
    assert np.sum(normals * (a + b + c)) / 9.0 == pytest.approx(volume, rel=6e-3)
    np.testing.assert_allclose(normals.sum(axis=0), 0.0, atol=1e-9)


@pytest.mark.render
class TestShadows:
    def test_a_ball_before_the_lamp_shades_what_geometry_says(self, vector: Any) -> None:
        """Would catch a solid in the wrong place, or one that light passes through."""
        lamp, _ = places(default_rig(camera=SMALL))
        what = scene(ball(0.2 * lamp, 6.0, 0.0))
        pixels = pixel_geometry(what.rig, ANGLES)
        on = inside(what.rig)
        points = np.column_stack([pixels.position_mm[on], np.zeros(on.sum())])
        seen = share_in_sight(points, 0.2 * lamp, 6.0, on_disc(lamp, what.lamp_radius_mm))
        assert 0.02 < np.mean(seen < 0.5) < 0.5
        wanted = bare_light(what)[on][:, 0] * seen
        found = PathLight(vector, what, samples_per_pixel=64).estimate(ANGLES, 4).mean[on][:, 0]
        # A pixel with the shadow's edge in it sees some of both.
        sure = (seen == 0.0) | (seen == 1.0)
        assert np.sum(np.abs(found - wanted)[sure] > 0.02 * wanted.max()) < 0.03 * sure.sum()
        assert found.mean() == pytest.approx(wanted.mean(), rel=5e-3)

    def test_a_ball_before_the_camera_hides_what_geometry_says(self, vector: Any) -> None:
        """Would catch a solid that the camera looks through."""
        _, camera = places(default_rig(camera=SMALL))
        what = scene(ball(0.7 * camera, 3.0, 0.0))
        pixels = pixel_geometry(what.rig, ANGLES)
        on = inside(what.rig)
        points = np.column_stack([pixels.position_mm[on], np.zeros(on.sum())])
        # Mitsuba's camera is a pinhole.
        seen = share_in_sight(points, 0.7 * camera, 3.0, camera[None])
        assert 0.02 < np.mean(seen < 0.5) < 0.9
        found = PathLight(vector, what, samples_per_pixel=64).estimate(ANGLES, 4).mean[on][:, 0]
        assert found.mean() == pytest.approx((bare_light(what)[on][:, 0] * seen).mean(), rel=0.02)

    def test_all_light_is_followed_where_a_solid_shades(self, vector: Any) -> None:
        """Would catch a picture without the shadow, and one told to be right."""
        lamp, _ = places(default_rig(camera=SMALL))
        what = scene(ball(0.2 * lamp, 6.0, 0.04), obstructed=False)
        plan = Planner(vector, what, 0.01, METHODS).plan(ANGLES)
        assert plan.solids.shadow == "ball"
        assert plan.scene.obstructed
        assert all(part.method.among_solids for part in plan.decision.parts)

    def test_the_default_machine_does_not_stand_in_its_own_light(self, vector: Any) -> None:
        """Would catch a lens that hides its own view, and a lamp's body that shades it."""
        what = Scene(
            default_rig(camera=SMALL), parse_material(PAINT), frozenset({Event.LAMBERTIAN}), obstructed=True
        )
        on = inside(what.rig)
        found = PathLight(vector, what, last=1, samples_per_pixel=64).estimate(ANGLES, 2).mean[on]
        assert found.mean() == pytest.approx(bare_light(what)[on].mean(), rel=2e-3)


@pytest.mark.render
class TestAddedLight:
    def test_white_card_is_a_second_lamp(self, vector: Any) -> None:
        """Would catch an albedo that is not used, and a bound below the light that it bounds."""
        card = Box(name="card", centre_mm=(0.0, 100.0, 80.0), size_mm=(160.0, 2.0, 160.0), albedo=0.8)
        what = scene(card)
        on = inside(what.rig)
        added = PathLight(vector, what, first=2, samples_per_pixel=64).estimate(ANGLES, 4).mean[on].mean()
        share = added / bare_light(what)[on].mean()
        bound = SolidsLight(what, closed_form_reflectance(what.material)).at(ANGLES).share
        assert share > 0.01
        # Of the margin 3/2, and of five times for light that might go to and fro between such solids.
        assert share <= bound < 8.0 * share

    @pytest.mark.parametrize("spec", [PAINT, "cook-torrance:kd=0.1,ks=0.5,m=0.2,ior=1.5"])
    def test_bound_of_the_default_machine_holds(self, vector: Any, spec: str) -> None:
        """Would catch a share that is left out though it counts, at poses of all kinds."""
        event = Event.LAMBERTIAN if spec == PAINT else Event.GLOSSY
        rig = default_rig(camera=SMALL)
        what = Scene(rig, parse_material(spec), frozenset({event}), obstructed=True)
        light = SolidsLight(what, closed_form_reflectance(what.material))
        stray = PathLight(vector, what, first=2, last=4, samples_per_pixel=16)
        direct = PathLight(vector, what, last=1, samples_per_pixel=16)
        for pose in audit_poses(rig, 6, 3):
            told = light.at(pose)
            on = inside(rig, pose)
            if told.shadow or not on.any():
                continue
            level = direct.estimate(pose, 2).mean[on].mean()
            found = stray.estimate(pose, 4)
            noise = np.sqrt(np.mean(found.standard_error[on] ** 2) / on.sum())
            assert found.mean[on].mean() - 3.0 * noise <= told.share * level

    def test_a_bright_card_is_computed_on_top(self, vector: Any) -> None:
        """Would catch a card that is skipped, or its light counted twice."""
        card = Box(name="card", centre_mm=(0.0, 100.0, 80.0), size_mm=(160.0, 2.0, 160.0), albedo=0.8)
        bare = scene(card, obstructed=False)
        plan = Planner(vector, bare, 1e-3, METHODS).plan(ANGLES)
        assert plan.added is not None
        assert not plan.solids.shadow
        on = inside(bare.rig)
        total = sum(
            part.method.build(vector, where, part.paths).render(ANGLES, part.tolerance).radiance[on].mean()
            for where, part in plan.parts
        )
        whole = PathLight(vector, replace(bare, obstructed=True), samples_per_pixel=64).estimate(ANGLES, 4)
        assert total == pytest.approx(whole.mean[on].mean(), rel=2e-3)


def test_solids_below_the_sample_or_black_add_nothing(scalar: Any) -> None:
    """Would catch light that comes up through the sample, or from a solid that reflects none."""
    below = Cylinder(
        name="plate", from_mm=(0.0, 0.0, -60.0), to_mm=(0.0, 0.0, -40.0), radius_mm=400.0, albedo=1.0
    )
    black = Capsule(
        name="rod", from_mm=(-100.0, -100.0, 50.0), to_mm=(-100.0, 100.0, 50.0), radius_mm=9.0, albedo=0.0
    )
    what = scene(below, black, obstructed=False)
    plan = Planner(scalar, what, 1e-3, METHODS).plan(ANGLES)
    assert plan.solids.share == 0.0
    assert not plan.solids.shadow
    assert plan.added is None
    assert not plan.scene.obstructed
