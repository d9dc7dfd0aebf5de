"""Lamps in mirrors against closed forms, and against Mitsuba's path tracer on a lamp with a size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rig.angles import unit
from rig.description import default_rig
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.paths import LightPaths
from simulator.light.scene import Event, PlanarMirror, Scene
from simulator.light.virtual_lamps import virtual_lamps
from simulator.light.virtual_lights import VirtualLights
from simulator.materials import parse_material

ANGLES = np.radians([30.0, 40.0, -20.0, 15.0])
BOUNCED = LightPaths("LS+DE")


def lambert(wi: Any, wo: Any) -> Any:
    """Return f_r of a white."""
    return np.full((len(wi), 3), 1.0 / np.pi)


def mirror_at(x_mm: float, half_mm: float, reflectance: float = 1.0) -> PlanarMirror:
    """Return an upright mirror that faces the z axis."""
    across = (0.0, half_mm, 0.0) if x_mm < 0.0 else (0.0, -half_mm, 0.0)
    return PlanarMirror((x_mm, 0.0, 100.0), across, (0.0, 0.0, half_mm), reflectance)


def scene(*mirrors: PlanarMirror, cosine: bool = False) -> Scene:
    """Return the default rig with a white sample."""
    material = parse_material("lambert:kd=1")
    events = frozenset({Event.LAMBERTIAN})
    return Scene(default_rig(), material, events, mirrors=mirrors, lamp_cosine=cosine)


def expected(lamp_mm: Any, angles: Any = ANGLES) -> Any:
    """Return the radiance of a white lit by a point lamp somewhere, at the pixels' centres."""
    rig = default_rig()
    pixels = pixel_geometry(rig, angles)
    way = lamp_mm - np.concatenate([pixels.position_mm, np.zeros((*pixels.on_sample.shape, 1))], axis=-1)
    distance = np.linalg.norm(way, axis=-1)
    return rig.lamp.distance_mm**2 * way[..., 2] / distance**3 / np.pi, pixels.on_sample


class TestClosedForm:
    @pytest.mark.parametrize("x_mm", [-300.0, 300.0])
    def test_one_mirror_is_a_second_lamp(self, x_mm: float) -> None:
        """Would catch a lost reflectance, the wrong image or a wrong distance."""
        what = scene(mirror_at(x_mm, 2000.0, 0.7))
        lamp = Kinematics(what.rig).frames(ANGLES).light_mm
        found = VirtualLights(what, lambert, BOUNCED).render(ANGLES, 1e-5)
        wanted, lit = expected(lamp * [-1.0, 1.0, 1.0] + [2.0 * x_mm, 0.0, 0.0])
        assert lit.any()
        np.testing.assert_allclose(found.radiance[lit, 0], 0.7 * wanted[lit], rtol=1e-5)

    def test_two_that_face_each_other_show_images_of_images(self) -> None:
        """Would catch images in the wrong order: the second pair lies two gaps further away."""
        what = scene(mirror_at(-300.0, 5e4, 0.5), mirror_at(300.0, 5e4, 0.5))
        lamps = virtual_lamps(what, LightPaths("LSDE|LSSDE"))
        assert [len(lamp.mirrors) for lamp in lamps] == [1, 1, 2, 2]
        places = sorted(float(lamp.image(np.array([50.0, 0.0, 400.0]))[0]) for lamp in lamps)
        assert places == pytest.approx([-1150.0, -650.0, 550.0, 1250.0])

    def test_two_in_a_row_add_up(self) -> None:
        """Would catch a way over two mirrors that is not followed through both."""
        what = scene(mirror_at(-300.0, 5e4, 0.5), mirror_at(300.0, 5e4, 0.5))
        light = np.array([50.0, 0.0, 400.0])
        point, wo = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
        found = VirtualLights(what, lambert, LightPaths("LSSDE")).radiance(light, point, wo, 1)
        ways = np.array([[-1150.0, 0.0, 400.0], [1250.0, 0.0, 400.0]])
        wanted = 0.25 * 500.0**2 * np.sum(ways[:, 2] / np.linalg.norm(ways, axis=1) ** 3) / np.pi
        assert found[0, 0] == pytest.approx(wanted, rel=1e-12)

    def test_the_window_ends_where_the_mirror_does(self) -> None:
        """Would catch a mirror that lights what cannot see the lamp in it."""
        light = np.array([0.0, 0.0, 500.0])
        # From the image at (400, 0, 500) the ray to the origin passes the plane x = 200 at z = 250.
        points = np.array([[0.0, 0.0, 0.0]])
        wo = np.array([[0.0, 0.0, 1.0]])
        for top, bright in ((260.0, True), (240.0, False)):
            mirror = PlanarMirror((200.0, 0.0, top - 50.0), (0.0, -20.0, 0.0), (0.0, 0.0, 50.0))
            found = VirtualLights(scene(mirror), lambert, BOUNCED).radiance(light, points, wo, 1)
            assert (found[0, 0] > 0.0) == bright

    def test_its_back_is_dark(self) -> None:
        """Would catch a mirror that reflects from behind."""
        front = mirror_at(200.0, 2000.0)
        back = replace(front, across_mm=tuple(-x for x in front.across_mm))
        points, wo = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
        light = np.array([0.0, 0.0, 500.0])
        found = [
            VirtualLights(scene(m), lambert, BOUNCED).radiance(light, points, wo, 1)[0, 0]
            for m in (front, back)
        ]
        assert found[0] > 0.0
        assert found[1] == 0.0

    def test_a_mirror_in_the_way_hides_another(self) -> None:
        """Would catch ways that pass through a mirror that they do not meet."""
        # The way from (200, 0, 250) to the origin passes x = 100 at z = 125, inside the card, which is
        # itself too low to show the lamp.
        card = replace(mirror_at(100.0, 20.0), centre_mm=(100.0, 0.0, 125.0))
        wall = mirror_at(200.0, 160.0)
        points, wo = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
        light = np.array([0.0, 0.0, 500.0])
        bare, hidden = (
            VirtualLights(scene(*mirrors), lambert, LightPaths("LSDE")).radiance(light, points, wo, 1)[0, 0]
            for mirrors in ((wall,), (wall, card))
        )
        assert bare > 0.0
        assert hidden == 0.0

    def test_a_lamp_with_a_cosine_sends_less_sideways(self) -> None:
        """Would catch the emitter's cosine forgotten, or taken from the image's other side."""
        mirror, light = mirror_at(200.0, 2000.0), np.array([0.0, 0.0, 500.0])
        points, wo = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
        even, cosine = (
            VirtualLights(scene(mirror, cosine=c), lambert, BOUNCED).radiance(light, points, wo, 4)[0, 0]
            for c in (False, True)
        )
        along = unit([200.0, 0.0, -250.0]) @ [0.0, 0.0, -1.0]
        assert cosine / even == pytest.approx(along, rel=1e-4)
