"""The audit of a machine's light: shares add up and stay below their bounds."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from rig.description import Camera, default_rig
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.audit import audit_poses, audit_scene, explain, stray_light
from simulator.light.classes import path_classes
from simulator.light.path_classes import PathClassesMethod
from simulator.light.scene import PlanarMirror

RIG = default_rig(
    camera=Camera(width_px=32, height_px=24, focal_length_px=300.0, principal_point_px=(15.5, 11.5))
)


@pytest.fixture(params=["lambert:kd=0.4", "cook-torrance:kd=0.2,ks=0.5,m=0.3,ior=1.5"])
def audited(request: pytest.FixtureRequest) -> tuple[Any, Any]:
    """Return Mitsuba, and a sample in a housing of 20 %."""
    return audit_scene(RIG, request.param, housing_albedo=0.2, variant="scalar")


def test_poses_are_seen_and_repeat() -> None:
    """Would catch an audit of poses at which there is nothing to see."""
    poses = audit_poses(RIG, 5, 1)
    assert poses == audit_poses(RIG, 5, 1) != audit_poses(RIG, 5, 2)
    for pose in poses:
        frames = Kinematics(RIG).frames(pose)
        assert min(frames.light_mm[2], frames.camera_mm[2]) > 0.0


def test_shares_add_up_and_are_within_their_bounds(audited: tuple[Any, Any]) -> None:
    """Would catch a class computed as another one, and a bound that light exceeds."""
    poses = audit_poses(RIG, 2, 3)
    told, found = explain(*audited, poses, 1e-3), stray_light(*audited, poses, 1e-2)
    assert told["paths"] == found["paths"]
    for expected, pose in zip(told["poses"], found["poses"], strict=True):
        assert sum(pose["shares"]) == pytest.approx(1.0)
        assert pose["stray"] == pytest.approx(sum(pose["shares"][1:]))
        assert 0.0 < pose["stray"] < 0.2
        assert math.hypot(*pose["errors"][1:]) <= 0.02 * math.sqrt(3.0) * pose["stray"]
        for row, share in zip(expected["classes"], pose["shares"], strict=True):
            assert 0.0 < share <= row["bound"]


@pytest.mark.render
def test_classes_from_one_render_add_up_to_all_light(vector: Any) -> None:
    """Would catch classes of one render that are mixed up, or an error that is not theirs."""
    mirror = PlanarMirror((-100.0, 0.0, 80.0), (0.0, 40.0, 0.0), (24.0, 0.0, 32.0), 0.8)
    _, bare = audit_scene(RIG, "lambert:kd=0.4", housing_albedo=0.3)
    what = replace(bare, mirrors=(mirror,))
    poses = audit_poses(RIG, 1, 3)
    found = stray_light(vector, what, poses, 0.02)
    (pose,) = found["poses"]
    known = {n: (s, e) for n, s, e in zip(found["classes"], pose["shares"], pose["errors"], strict=True)}
    # Light that walls get from a mirror first is met by chance alone: nobody knows it.
    assert math.isnan(known["LSDlDlE"][0])
    classes = PathClassesMethod()
    assert known["LDlSDlE"][0] > 20.0 * known["LDlSDlE"][1] > 0.0
    numbers = {path_class.name: path_class.paths for path_class in path_classes(what)}
    assert classes.obstacle(what, numbers["LSDlDlE"], vector=True) is not None
    whole = numbers["LDlE"] | numbers["LDlDlE"] | numbers["LDlSDlE"] | numbers["LDlDlDlE"]
    assert classes.obstacle(what, whole, vector=True) is None
    on = pixel_geometry(RIG, poses[0]).on_sample
    total, parts = (
        [classes.build(vector, what, p).render(poses[0], 0.01).radiance[on].mean() for p in some]
        for some in ([whole], [numbers["LDlE"]])
    )
    stray = sum(known[name][0] for name in ("LDlDlE", "LDlSDlE", "LDlDlDlE"))
    assert total[0] / parts[0] - 1.0 == pytest.approx(stray / known["LDlE"][0], rel=0.06)


def test_black_surroundings_have_no_stray_light() -> None:
    """Would catch a share where there is none, and a black sample that fails."""
    poses = audit_poses(RIG, 1, 0)
    (pose,) = stray_light(*audit_scene(RIG, "lambert:kd=0.4", variant="scalar"), poses, 1e-2)["poses"]
    assert pose["shares"] == [1.0]
    assert pose["stray"] == 0.0
    (dark,) = stray_light(*audit_scene(RIG, "lambert:kd=0", variant="scalar"), poses, 1e-2)["poses"]
    assert dark["shares"] == []
    assert dark["stray"] is None
