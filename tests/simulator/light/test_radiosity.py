"""Light over a housing against closed forms, the three-point solver, and Mitsuba's path tracer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rig.angles import unit
from rig.description import default_rig
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.paths import LightPaths
from simulator.light.radiosity import Radiosity, RadiosityMethod
from simulator.light.reflectance import closed_form_reflectance
from simulator.light.scene import Event, Housing, Scene
from simulator.light.three_point import PointLamp, Surface, ThreePoint
from simulator.light.walls import Walls
from simulator.materials import ClosedFormMaterial, parse_material

ANGLES = np.radians([30.0, 40.0, -20.0, 15.0])
HALF_MM = 900.0
PAINT = "cook-torrance:kd=0.2,ks=0.6,m=0.3,ior=1.5"
WHITE = "lambert:kd=0.9"


def scene(material: str, albedo: float, *, cosine: bool = False) -> Scene:
    """Return the default rig in a housing."""
    event = Event.LAMBERTIAN if material == WHITE else Event.GLOSSY
    housing = Housing(albedo, HALF_MM)
    return Scene(
        default_rig(), parse_material(material), frozenset({event}), housing=housing, lamp_cosine=cosine
    )


def evaluator(what: Scene, paths: str) -> Radiosity:
    """Return radiosity at work on some paths."""
    assert isinstance(what.material, ClosedFormMaterial)
    return Radiosity(what, closed_form_reflectance(what.material), LightPaths(paths))


def middle(image: Any) -> float:
    """Return the mean of the four pixels about the image's centre."""
    rows, cols = image.shape[0] // 2, image.shape[1] // 2
    return float(image[rows - 1 : rows + 1, cols - 1 : cols + 1, 0].mean())


class TestWalls:
    def test_all_that_a_patch_receives_comes_from_others(self) -> None:
        """Would catch a form factor that is wrong where walls meet."""
        shares = Walls(700.0, 4).form_factors()
        np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-9)
        np.testing.assert_allclose(shares, shares.T, rtol=1e-9)

    def test_the_rule_covers_the_cube(self) -> None:
        """Would catch squares lost or doubled where the rule is refined towards a lamp near a wall."""
        walls = Walls(100.0, 4)
        rule = walls.rule(np.array([99.0, 20.0, -30.0]), 3)
        assert len(rule.points) > 9 * len(walls)
        assert rule.areas.sum() == pytest.approx(6.0 * 200.0**2, rel=1e-12)
        way = rule.points - [99.0, 20.0, -30.0]
        flux = np.sum(-np.sum(way * rule.normals, axis=1) / np.linalg.norm(way, axis=1) ** 3 * rule.areas)
        assert flux == pytest.approx(4.0 * np.pi, rel=1e-4)

    def test_rays_meet_the_patch_whose_node_they_are_sent_to(self) -> None:
        """Would catch walls mixed up between the rule and the rays."""
        walls = Walls(100.0, 4)
        rule = walls.rule(np.zeros(3), 2)
        start = np.broadcast_to([10.0, -20.0, 5.0], rule.points.shape)
        hit = walls.hit(start, unit(rule.points - start))
        np.testing.assert_allclose(hit.points, rule.points, atol=1e-9)
        np.testing.assert_array_equal(hit.patches, rule.patches)
        np.testing.assert_array_equal(hit.normals, rule.normals)


class TestAgainstThreePoint:
    @pytest.mark.parametrize("material", [PAINT, WHITE])
    def test_the_first_bounces_agree(self, material: str, cube: Any) -> None:
        """Would catch a lost cosine, the wrong lobe or a shadow in the wrong place; class by class."""
        what = scene(material, 0.2)
        letter = "Dl" if material == WHITE else "Dg"
        f_r = closed_form_reflectance(what.material)  # type: ignore[arg-type]
        frames = Kinematics(what.rig).frames(ANGLES)
        radius = what.sample_radius_mm
        disc = Surface([0, 0, 0], [radius, 0, 0], [0, radius, 0], f_r, 2, round_=True)
        lamp = PointLamp(frames.light_mm, what.lamp_intensity)
        solver = ThreePoint([disc, *cube(HALF_MM, 0.2, 9)], lamp)
        wo = unit(frames.camera_mm)[None]
        _, once, twice = solver.camera_radiance(0, np.zeros((1, 3)), wo, 3)[:, 0, 0]
        found = [
            middle(evaluator(what, paths).render(ANGLES, 1e-3).radiance)
            for paths in (f"LDl{letter}E", f"LDlDl{letter}E|L{letter}Dl{letter}E")
        ]
        assert found[0] == pytest.approx(once, rel=5e-3)
        assert found[1] == pytest.approx(twice, rel=1e-2)

    def test_classes_add_up_to_all(self) -> None:
        """Would catch paths counted twice or never."""
        what = scene(PAINT, 0.3)
        parts = ("LDlDgE", "LDlDlDgE", "LDgDlDgE", "LD(D|Dl)(D|Dl)+DgE")
        found = [evaluator(what, paths).render(ANGLES, 3e-2).radiance for paths in parts]
        whole = evaluator(what, "LD*DlDgE").render(ANGLES, 3e-2).radiance
        np.testing.assert_allclose(sum(found), whole, rtol=2e-3)


class TestClosedForm:
    def test_a_bright_housing_is_a_white_furnace(self) -> None:
        """Would catch a wrong solution for all bounces: what walls lose is what the lamp gives."""
        albedo = 0.995
        what = scene(WHITE, albedo)
        found = middle(evaluator(what, "LD*DlDlE").render(ANGLES, 1e-2).radiance)
        # Nearly even light: the lamp's flux is what walls, and the sample's two sides, do not give back.
        taken = (1.0 - albedo) * 6.0 * (2.0 * HALF_MM) ** 2 + (0.1 + 1.0) * np.pi * what.sample_radius_mm**2
        even = 4.0 * np.pi * what.lamp_intensity * albedo / taken
        assert found == pytest.approx(0.9 / np.pi * even, rel=6e-3)

    def test_a_narrow_lobe_sees_the_wall_as_a_mirror_would(self) -> None:
        """Would catch nodes that miss a narrow lobe: it shows the wall's radiance times the lobe's albedo."""
        narrow, wide = (
            evaluator(scene(f"cook-torrance:kd=0,ks=1,m={m},ior=1.5", 0.04), "LDlDgE").render(ANGLES, 1e-3)
            for m in (0.02, 0.04)
        )
        assert max(narrow.error, wide.error) < 2e-2
        assert middle(narrow.radiance) == pytest.approx(middle(wide.radiance), rel=2e-2)

    def test_the_error_that_it_states_is_no_smaller_than_the_true_one(self) -> None:
        """Would catch an error estimate that promises too much."""
        what = scene(PAINT, 0.04)
        method = evaluator(what, "LD*DlDgE")
        best = method.render(ANGLES, 0.0).radiance
        lit = pixel_geometry(what.rig, ANGLES).on_sample
        for tolerance in (3e-2, 1e-3):
            quick = method.render(ANGLES, tolerance)
            assert quick.error <= tolerance
            wrong = np.sqrt(np.mean(np.square(quick.radiance[lit] - best[lit]))) / best[lit].mean()
            assert wrong <= quick.error


class TestMethod:
    def test_it_says_what_it_cannot_do(self) -> None:
        """Would catch a scene without a housing, or a lamp outside it, taken on."""
        method, paths = RadiosityMethod(), LightPaths("LDlDgE")
        what = scene(PAINT, 0.04)
        assert method.obstacle(what, paths, vector=True) is None
        bare = Scene(what.rig, what.material, what.events)
        assert method.obstacle(bare, paths, vector=True) is not None
        small = Scene(what.rig, what.material, what.events, housing=Housing(0.04, 300.0))
        assert method.obstacle(small, paths, vector=True) is not None
        assert method.obstacle(what, LightPaths("LDlDlDlDgE"), vector=True) is not None
        assert method.obstacle(what, LightPaths("LD*DlDgE"), vector=True) is None


@pytest.mark.render
class TestAgainstMitsuba:
    def test_the_path_tracer_finds_the_same_stray_light(self, vector: Any) -> None:
        """Would catch either of two independent solutions being wrong, a paint in a grey housing."""
        from simulator.light.path_tracer import PathLight

        what = scene(PAINT, 0.2)
        path = PathLight(vector, what, first=2, samples_per_pixel=32).estimate(ANGLES, 4)
        lit = pixel_geometry(what.rig, ANGLES).on_sample
        stray = path.mean[lit].mean()
        noise = np.sqrt(np.mean(np.square(path.standard_error[lit])) / lit.sum())
        found = evaluator(what, "LD*DlDgE").render(ANGLES, 1e-3)
        assert found.radiance[lit].mean() == pytest.approx(stray, abs=4.0 * noise + 3e-3 * stray)
