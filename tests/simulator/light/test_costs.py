"""Predicted times: by what is asked, and cheap to ask."""

from __future__ import annotations

from typing import Any

from rig.description import Camera, default_rig
from simulator.light.costs import MITSUBA_VALUE_S, ONE_BY_ONE_S, value_s
from simulator.light.methods import METHODS
from simulator.light.mitsuba_scene import sample_events
from simulator.light.paths import LightPaths
from simulator.light.scene import Scene
from simulator.materials import parse_material


def test_a_materials_time_is_its_own() -> None:
    """Would catch one number for all: a dear model's closed form would be taken where it is slower."""
    assert 0.0 < value_s(parse_material("lambert:kd=0.5"), vector=True) < 1e-5
    other = parse_material("mitsuba:roughplastic")
    assert value_s(other, vector=True) == MITSUBA_VALUE_S
    assert value_s(other, vector=False) == ONE_BY_ONE_S


def test_more_pixels_and_less_tolerance_take_longer(scalar: Any) -> None:
    """Would catch a prediction that does not look at the question."""
    material = parse_material("cook-torrance:kd=0.3,ks=0.5,m=0.05,ior=1.5")
    paths, pose = LightPaths("LDgE"), (0.5, 0.0, -0.5, 0.0)
    small, large = (
        Scene(
            default_rig(
                camera=Camera(
                    width_px=side, height_px=side, focal_length_px=2400.0, principal_point_px=(side / 2,) * 2
                )
            ),
            material,
            sample_events(scalar, material),
        )
        for side in (32, 256)
    )
    for method in METHODS:
        if method.obstacle(small, paths, vector=True) is None and paths <= method.covers:
            times = [
                method.seconds_at(scalar, scene, paths, tolerance, pose, vector=True)
                for scene, tolerance in ((small, 1e-2), (large, 1e-2), (large, 1e-4))
            ]
            assert 0.0 < times[0] < times[1] <= times[2], method.name
