"""Light between a sample and its own image in a mirror: bounded from its cone, never below the truth."""

from __future__ import annotations

import numpy as np
import pytest

from rig.angles import unit
from rig.description import default_rig
from simulator.light.lobes import OwnImage, brightest_within, image_cone
from simulator.light.reflectance import closed_form_reflectance
from simulator.light.scene import Event, PlanarMirror, Scene
from simulator.light.three_point import Surface
from simulator.materials import parse_material

GLOSSY = "cook-torrance:kd=0.1,ks=0.5,m=0.1,ior=1.5"
RIG = default_rig()


def scene_of(mirror: PlanarMirror) -> Scene:
    """Return a glossy sample beside a mirror."""
    return Scene(RIG, parse_material(GLOSSY), frozenset({Event.GLOSSY}), mirrors=(mirror,))


def leaning(lean_rad: float, distance_mm: float = 100.0) -> PlanarMirror:
    """Return a mirror at +x whose lower edge is near the sample and which leans over it."""
    up = (-40.0 * np.sin(lean_rad), 0.0, 40.0 * np.cos(lean_rad))
    return PlanarMirror((distance_mm, 0.0, 45.0), (0.0, -60.0, 0.0), up, 0.9)


@pytest.mark.parametrize("lean_rad", [0.2, 0.5, 0.8])
def test_the_cone_holds_all_ways_between_sample_and_image(lean_rad: float) -> None:
    """Would catch a cone about another direction, or too narrow: light would go beside it."""
    mirror = leaning(lean_rad)
    scene = scene_of(mirror)
    cone = image_cone(scene, mirror)
    assert cone is not None
    rng = np.random.default_rng(1)
    phi, r = (
        rng.uniform(0.0, 2.0 * np.pi, (2, 500)),
        scene.sample_radius_mm * np.sqrt(rng.uniform(size=(2, 500))),
    )
    here, there = np.stack([r * np.cos(phi), r * np.sin(phi), 0.0 * r], axis=-1)
    ways = unit(mirror.image(there) - here)
    ways = ways[ways[:, 2] > 0.0]
    assert len(ways)
    # Nodes are a twentieth of the cone's half width, or a turn's step, apart.
    assert np.min(np.max(ways @ cone.directions.T, axis=1)) > np.cos(0.1)
    shortest = np.min(np.linalg.norm(mirror.image(there) - here, axis=1))
    assert cone.solid_angle >= np.pi * scene.sample_radius_mm**2 / shortest**2


def test_a_mirror_that_touches_the_sample_has_no_cone() -> None:
    """Would catch a bound where nothing is known."""
    mirror = leaning(0.3, 5.0)
    assert image_cone(scene_of(mirror), mirror) is None


def test_the_brightest_is_at_least_what_directions_of_the_cone_show() -> None:
    """Would catch a peak between nodes: no direction of the cone may be much brighter."""
    mirror = leaning(0.5)
    cone = image_cone(scene_of(mirror), mirror)
    assert cone is not None
    reflectance = closed_form_reflectance(parse_material(GLOSSY))
    rng = np.random.default_rng(2)
    pairs = cone.directions[rng.integers(len(cone.directions), size=(2, 4000))]
    both = reflectance(pairs[0], pairs[1])[:, 0] * pairs[0][:, 2] * pairs[1][:, 2]
    assert 1.3 * brightest_within(reflectance, cone)[0] >= both.max()


@pytest.mark.parametrize("lean_rad", [0.2, 0.4, 0.6])
def test_a_sample_in_its_own_image_is_as_bright_as_its_places_make_it(lean_rad: float) -> None:
    """Would catch a way of light, a cosine or the mirror's rim lost: against places drawn at random."""
    mirror = leaning(lean_rad)
    scene = scene_of(mirror)
    reflectance = closed_form_reflectance(parse_material(GLOSSY))
    lamp, camera = np.array([-300.0, 60.0, 400.0]), np.array([-200.0, -50.0, 560.0])
    rng = np.random.default_rng(3)
    phi, r = rng.uniform(0.0, 2.0 * np.pi, 20000), scene.sample_radius_mm * np.sqrt(rng.uniform(size=20000))
    start = np.stack([r * np.cos(phi), r * np.sin(phi), 0.0 * r], axis=-1)
    way, ends = mirror.image(start), np.zeros_like(start)
    through = Surface(mirror.centre_mm, mirror.across_mm, mirror.up_mm, 1.0, 1).blocks(ends, way)
    wi, squared = unit(way), np.sum(way**2, axis=-1)
    met = wi * ((np.asarray(mirror.centre_mm) @ mirror.normal) / (wi @ mirror.normal))[:, None]
    thrown, to_lamp = unit(met - start), lamp - start
    lit = scene.lamp_intensity * unit(to_lamp)[:, 2] / np.sum(to_lamp**2, axis=-1)
    bright = reflectance(unit(to_lamp), thrown)[:, 0] * lit
    seen = reflectance(wi, np.broadcast_to(unit(camera), wi.shape))[:, 0]
    area = np.pi * scene.sample_radius_mm**2
    truth = area * np.mean(through * bright * thrown[:, 2] * seen * wi[:, 2] / squared) * mirror.reflectance
    found = OwnImage(scene, mirror).radiance(reflectance, lamp[None], camera[None])[0, 0]
    # The middle of the sample is one of the places lit, and not the brightest.
    assert 0.0 < truth <= 1.01 * found < 2.0 * truth
