"""What points for lamp, pixel and pupil leave out: estimated beforehand, against the full quadrature."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.light_scenes import draw_scenes
from rig.kinematics import Kinematics
from simulator.light.direct_float64 import Float64Nodes
from simulator.light.direct_view import extents_of, lens_of, sample_share, view_of
from simulator.light.finite_size import point_errors
from simulator.light.pixelwise import PixelwiseLight
from simulator.light.reflectance import material_reflectance
from simulator.light.sparse_rules import Levels, product_rule

PLACES = 8


def test_the_estimate_is_the_error(scalar: Any) -> None:
    """Would catch a factor of the lamp's disc forgotten: a method taken for right that is not."""
    ratios = []
    for drawn in draw_scenes(scalar, 14, 61):
        scene, pose = drawn.scene, np.asarray(drawn.pose)
        reflectance = material_reflectance(scalar, scene.material)
        extents, lens = extents_of(scene.rig), lens_of(scene.rig)
        view, side = view_of(Kinematics(scene.rig).frames(pose), extents), scene.rig.camera.width_px
        grid = ((np.arange(PLACES) + 0.5) * side / PLACES).astype(int)
        pixels = (grid[:, None] * side + grid).ravel()
        pixels = pixels[sample_share(view, lens[pixels], 3.0, scene.sample_radius_mm) == 1.0]
        if len(pixels) < PLACES:
            continue
        nodes = Float64Nodes(reflectance, extents, scene.sample_radius_mm)
        truth = nodes.radiance([view], lens[pixels], product_rule(Levels(2, 1, 2)))[0]
        light = PixelwiseLight(scene.rig, reflectance, lamp_cosine=scene.lamp_cosine)
        points = light.radiance(drawn.pose).reshape(-1, 3)[pixels]
        error = np.sqrt(np.mean((points - truth) ** 2)) / truth.mean()
        ratios.append(point_errors(scene, reflectance, [drawn.pose])[0] / error)
    assert len(ratios) > 8
    assert min(ratios) > 0.9
    # Where lobes are narrow, four nodes say too much.
    assert np.median(ratios) < 1.2


@pytest.mark.parametrize("number", [0, 1])
def test_many_poses_are_estimated_as_each_is_alone(scalar: Any, number: int) -> None:
    """Would catch an estimate, and so a decision, that depends on what else is asked."""
    scene = list(draw_scenes(scalar, 2, 62))[number].scene
    reflectance = material_reflectance(scalar, scene.material)
    poses = np.random.default_rng(0).uniform(-1.2, 1.2, (12, 4))
    together = point_errors(scene, reflectance, poses)
    assert together.tolist() == [point_errors(scene, reflectance, [pose])[0] for pose in poses]
