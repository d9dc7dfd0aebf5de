"""The three-point solver against closed forms, against itself, and against Mitsuba's path tracer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from analysis.models import MODELS
from rig.angles import unit
from simulator.light.three_point import PointLamp, Surface, ThreePoint

Array = "NDArray[np.float64]"

CENTRE = np.zeros((1, 3))
RADIUS_MM = 25.0


def sample(reflectance: Any, nodes: int = 2) -> Surface:
    """Return a disc at the origin that faces up."""
    return Surface([0, 0, 0], [RADIUS_MM, 0, 0], [0, RADIUS_MM, 0], reflectance, nodes, round_=True)


def glossy(wi: Any, wo: Any) -> Any:
    """Return f_r of a glossy paint, equal in all channels."""
    values = MODELS["cook-torrance"](kd=0.2, ks=0.6, m=0.3, ior=1.5).evaluate(wi, wo)
    return np.broadcast_to(values, (*values.shape[:-1], 3))


class TestClosedForms:
    def test_one_event_is_inverse_square_and_cosine(self) -> None:
        """Would catch a lost cosine, distance or 1/pi."""
        lamp_mm = 500.0 * unit([0.3, -0.2, 0.8])
        points = np.array([[0.0, 0.0, 0.0], [10.0, -5.0, 0.0]])
        found = ThreePoint([sample(0.5)], PointLamp(lamp_mm, 500.0**2)).camera_radiance(
            0, points, np.tile([0.0, 0.0, 1.0], (2, 1)), 1
        )
        way = lamp_mm - points
        expected = 0.5 / np.pi * 500.0**2 * way[:, 2] / np.linalg.norm(way, axis=1) ** 3
        np.testing.assert_allclose(found[0, :, 0], expected, rtol=1e-13)

    def test_two_events_between_discs(self) -> None:
        """Would catch a wrong kernel: a disc seen from its axis has form factor R^2/(R^2 + h^2)."""
        ceiling = Surface([0, 0, 80.0], [0, 60.0, 0], [60.0, 0, 0], 0.7, 8, round_=True)
        # Far away and below the sample's horizon: it lights the ceiling evenly and the sample not at all.
        far = 1e9 * unit([1.0, 0.0, -0.3])
        solver = ThreePoint([sample(0.5), ceiling], PointLamp(far, 1e18))
        found = solver.camera_radiance(0, CENTRE, np.array([[0.0, 0.0, 1.0]]), 2)[:, 0, 0]
        cosine = 0.3 / np.hypot(1.0, 0.3)
        expected = 0.5 / np.pi * (0.7 * cosine) * 60.0**2 / (60.0**2 + 80.0**2)
        assert found[0] == 0.0
        assert found[1] == pytest.approx(expected, rel=1e-6)

    def test_a_closed_housing_keeps_its_energy(self, cube: Any) -> None:
        """Would catch light lost or made at the edges: in a cube each event leaves the albedo's share."""
        walls = cube(100.0, 0.5, 6)
        solver = ThreePoint(walls, PointLamp([0.0, 0.0, 0.0], 1.0))
        points, areas = (np.concatenate(parts) for parts in zip(*(w.rule() for w in walls), strict=True))
        received = []
        starts = np.cumsum([0, *(len(w.rule()[1]) for w in walls)])
        for number, wall in enumerate(walls):
            part = slice(starts[number], starts[number + 1])
            wo = np.tile(wall.frame[:, 2], (starts[number + 1] - starts[number], 1))
            radiance = solver.camera_radiance(number, points[part], wo, 4)[..., 0]
            received.append(np.pi / 0.5 * radiance @ areas[part])
        flux = np.sum(received, axis=0)
        assert flux[0] == pytest.approx(4.0 * np.pi, rel=5e-3)
        np.testing.assert_allclose(flux[1:] / flux[:-1], 0.5, rtol=1e-2)

    def test_what_stands_in_the_way_casts_a_shadow(self) -> None:
        """Would catch a scene without visibility."""
        lamp = PointLamp([0.0, 0.0, 500.0], 500.0**2)
        card = Surface([0, 0, 100.0], [20.0, 0, 0], [0, 20.0, 0], 0.0, 1)
        points = np.array([[0.0, 0.0, 0.0], [24.9, 0.0, 0.0], [25.1, 0.0, 0.0]])
        found = ThreePoint([sample(1.0), card], lamp).camera_radiance(
            0, points, np.tile([0, 0, 1.0], (3, 1)), 1
        )
        assert (found[0, :, 0] > 0.0).tolist() == [False, False, True]


class TestRefinement:
    def test_any_reflectance_goes_the_same_way_as_an_albedo(self, cube: Any) -> None:
        """Would catch the general branch taking light from the wrong side."""
        lamp = PointLamp([150.0, 50.0, 400.0], 500.0**2)
        wo = np.array([unit([-0.3, 0.1, 0.9])])
        plain, general = (
            ThreePoint([sample(0.5), *cube(700.0, albedo, 3)], lamp).camera_radiance(0, CENTRE, wo, 4)
            for albedo in (0.3, lambda wi, wo: np.full((len(wi), 3), 0.3 / np.pi))  # noqa: ARG005
        )
        np.testing.assert_allclose(general, plain, rtol=1e-10)

    def test_more_nodes_change_little(self, cube: Any) -> None:
        """Would catch a rule that does not converge: the answer settles to 1 % for each number of events."""
        lamp = PointLamp(500.0 * unit([0.5, 0.0, 0.87]), 500.0**2)
        wo = np.array([unit([-0.3, 0.1, 0.9])])
        coarse, fine = (
            ThreePoint([sample(glossy), *cube(900.0, 0.04, n)], lamp).camera_radiance(0, CENTRE, wo, 2)
            for n in (6, 9)
        )
        np.testing.assert_allclose(coarse, fine, rtol=8e-3)


@pytest.mark.render
class TestAgainstMitsuba:
    def test_the_path_tracer_finds_the_same_stray_light(self, vector: Any, cube: Any) -> None:
        """Would catch either of two independent solutions of the same equation being wrong."""
        from rig.description import default_rig
        from rig.kinematics import Kinematics
        from simulator.light.path_tracer import PathLight
        from simulator.light.scene import Event, Scene, default_housing
        from simulator.materials import parse_material

        rig = default_rig()
        material = parse_material("cook-torrance:kd=0.2,ks=0.6,m=0.3,ior=1.5")
        angles = np.radians([30.0, 40.0, -20.0, 15.0])
        around = default_housing(rig, 0.2)
        assert around is not None
        scene = Scene(rig, material, frozenset({Event.GLOSSY}), around, lamp_cosine=False)
        stray = PathLight(vector, scene, first=2, samples_per_pixel=64).estimate(angles, 6)
        frames = Kinematics(rig).frames(angles)
        half_mm = around.half_size_mm
        radius = rig.sample.diameter_mm / 2.0
        disc = Surface([0, 0, 0], [radius, 0, 0], [0, radius, 0], glossy, 2, round_=True)
        solver = ThreePoint(
            [disc, *cube(half_mm, 0.2, 7)], PointLamp(frames.light_mm, rig.lamp.distance_mm**2)
        )
        orders = solver.camera_radiance(0, CENTRE, unit(frames.camera_mm)[None], 5)[:, 0, 0]
        middle = (slice(44, 52), slice(60, 68))
        found = stray.mean[middle].mean()
        noise = stray.standard_error[middle].mean() / 8.0
        assert found == pytest.approx(orders[1:].sum(), abs=4.0 * noise + 5e-3 * orders[1:].sum())
