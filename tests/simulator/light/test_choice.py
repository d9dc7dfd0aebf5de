"""What is computed and what is skipped: every path once, within the tolerance, by the quicker method."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rig.description import Camera, default_rig
from rig.errors import Refused
from simulator.light.choice import MOST_SKIPPED, Chooser, Decision
from simulator.light.classes import light_paths
from simulator.light.evaluator import Evaluator, Method
from simulator.light.methods import METHODS
from simulator.light.mitsuba_scene import sample_events
from simulator.light.paths import LightPaths
from simulator.light.scene import Scene, default_housing
from simulator.materials import parse_material

RIG = default_rig(
    camera=Camera(width_px=64, height_px=48, focal_length_px=600.0, principal_point_px=(31.5, 23.5))
)
POSE = (-0.4, 0.3, -0.5, 0.2)
GLOSSY = "cook-torrance:kd=0.3,ks=0.5,m=0.3,ior=1.5"


def scene_of(mi: Any, spec: str, albedo: float) -> Scene:
    """Return a sample in a housing."""
    material = parse_material(spec)
    return Scene(RIG, material, sample_events(mi, material), default_housing(RIG, albedo))


class Fake(Method):
    """A method of a given reach, price and fault."""

    def __init__(
        self, name: str, covers: str, seconds: float, *, left_out: float = 0.0, why: str = ""
    ) -> None:
        self.name, self.covers = name, LightPaths(covers)
        self._seconds, self._left_out, self._why = seconds, left_out, why or None

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:
        """Say why it cannot."""
        return self._why

    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:
        """Tell the price."""
        return self._seconds

    def leaves_out(self, mi: Any, scene: Scene, angles_rad: Any) -> float:
        """Tell the fault."""
        return self._left_out

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> Evaluator:
        """Never asked for."""
        raise NotImplementedError


def check(scene: Scene, decision: Decision) -> None:
    """Every path once, and what is skipped within its part of the tolerance."""
    rest = light_paths(scene)
    for paths in (*(part.paths for part in decision.parts), *(c.paths for c in decision.skipped)):
        assert paths <= rest
        rest -= paths
    assert not rest
    assert decision.skipped_bound <= MOST_SKIPPED * decision.tolerance
    for part in decision.parts:
        assert part.paths <= part.method.covers


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-3, 1e-5])
@pytest.mark.parametrize("albedo", [0.0, 0.04, 0.5])
@pytest.mark.parametrize("spec", ["lambert:kd=0.5", "lambert:kd=0", GLOSSY])
def test_every_path_is_computed_once_or_skipped(
    scalar: Any, spec: str, albedo: float, tolerance: float
) -> None:
    """Would catch light computed twice, forgotten, or skipped although it counts."""
    scene = scene_of(scalar, spec, albedo)
    decision = Chooser(scalar, scene, tolerance, METHODS).decide(POSE)
    check(scene, decision)
    assert bool(decision.parts) == (spec != "lambert:kd=0")


def test_a_looser_tolerance_skips_more(scalar: Any) -> None:
    """Would catch a tolerance that nothing heeds."""
    scene = scene_of(scalar, "lambert:kd=0.5", 0.04)
    skipped = [len(Chooser(scalar, scene, t, METHODS).decide(POSE).skipped) for t in (1e-7, 1e-3, 0.1)]
    assert skipped == sorted(skipped)
    assert skipped[0] == 0 < skipped[-1]


def test_many_poses_are_decided_as_each_is_alone(scalar: Any) -> None:
    """Would catch a decision, and so a frame, that depends on what else was asked."""
    chooser = Chooser(scalar, scene_of(scalar, GLOSSY, 0.04), 1e-3, METHODS)
    poses = np.random.default_rng(0).uniform(-1.2, 1.2, (40, 4))
    alone = Chooser(scalar, scene_of(scalar, GLOSSY, 0.04), 1e-3, METHODS)
    for together, pose in zip(chooser.decide_many(poses), poses, strict=True):
        one = alone.decide(pose)
        assert together.bounds == one.bounds
        assert [(part.method, part.tolerance) for part in together.parts] == [
            (part.method, part.tolerance) for part in one.parts
        ]


class TestDivision:
    cheap = Fake("cheap", "LDE", 0.1)
    stray = Fake("stray", "LDD+E", 1.0)
    dear = Fake("dear", "L(D|S)+E", 5.0)

    @pytest.mark.parametrize(
        ("methods", "expected"),
        [
            ((cheap, stray, dear), {"cheap", "stray"}),
            ((dear, stray, cheap), {"cheap", "stray"}),
            ((cheap, Fake("slow", "LDD+E", 10.0), dear), {"dear"}),
            ((Fake("broken", "LDE", 0.1, why="it is broken"), stray, dear), {"dear"}),
            ((Fake("rough", "LDE", 0.01, left_out=0.5), cheap, stray), {"cheap", "stray"}),
            ((Fake("rough", "LDE", 0.01, left_out=0.5), stray), {"rough", "stray"}),
        ],
    )
    def test_the_least_time_that_is_right_wins(
        self, scalar: Any, methods: tuple[Method, ...], expected: set[str]
    ) -> None:
        """Would catch a division that is dear, impossible or too rough while a better one is there."""
        scene = scene_of(scalar, GLOSSY, 0.3)
        decision = Chooser(scalar, scene, 1e-3, methods).decide(POSE)
        check(scene, decision)
        assert {part.method.name for part in decision.parts} == expected
        assert decision.reached == ("rough" not in expected)

    def test_what_nothing_covers_is_refused_with_the_reason(self, scalar: Any) -> None:
        """Would catch light left out without a word."""
        scene = scene_of(scalar, GLOSSY, 0.3)
        broken = Fake("broken", "L(D|S)+E", 0.1, why="it is broken")
        with pytest.raises(Refused, match=r"LDlDgE.*broken: it is broken"):
            Chooser(scalar, scene, 1e-3, (self.cheap, broken)).decide(POSE)
