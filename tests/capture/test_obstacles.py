"""Poses on a machine with solids: a spoiled pose that is measured unseen, or a good one that is lost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from capture.feasible import Obstacles, Reason, feasible
from capture.itinerary import lay_out
from capture.plan import plan_from
from capture.poses import listed
from capture.records import NO_FLAG, PoseFlag, Role
from capture.travel import travel_past
from rig.approach import leads_rad
from rig.clearance import Clearance
from rig.description import Box, Camera, Capsule, Rig, Sphere
from rig.description import default_rig as describe
from rig.kinematics import Kinematics
from rig.placement import placed_solids
from rig.shadows import LIFT_MM, Shadows

if TYPE_CHECKING:
    from rig.angles import FloatArray
    from rig.placement import PlacedSolid
    from rig.solids import Solid


def with_solids(*solids: Solid, **parts: Any) -> Rig:
    """Return the default machine with more solids."""
    return describe(solids=(*describe(**parts).solids, *solids), **parts)


def plan_of(directions_deg: list[list[float]], **head: str) -> Any:
    """Return a plan of listed poses."""
    content = {
        "version": 1,
        "plan": {"name": "x", "sample": "sample1"} | head,
        "poses": [{"kind": "list", "directions_deg": directions_deg}],
    }
    return plan_from(content, "test")


def rays(centre: FloatArray, radius: float, target_radius: float, count: int, seed: int) -> FloatArray:
    """Points (count, 150, 3) along rays from a disc that faces the sample's centre to the lifted sample."""
    random = np.random.default_rng(seed)
    towards = centre / np.linalg.norm(centre)
    across = np.linalg.svd(towards[None])[2][1:]
    angle, share = random.uniform(0.0, 2.0 * np.pi, (2, count)), np.sqrt(random.uniform(0.0, 1.0, (2, count)))
    begin = centre + radius * share[0, :, None] * (
        np.cos(angle[0])[:, None] * across[0] + np.sin(angle[0])[:, None] * across[1]
    )
    end = target_radius * share[1] * np.stack([np.cos(angle[1]), np.sin(angle[1])])
    foot = np.column_stack([*end, np.full(count, LIFT_MM)])
    steps = np.linspace(0.0, 1.0, 150)[None, :, None]
    return np.asarray((1.0 - steps) * foot[:, None] + steps * begin[:, None])


def outside_mm(solid: PlacedSolid, points: FloatArray) -> FloatArray:
    """Distances of points from a solid, by its own coordinates."""
    own = (points - solid.pose[:3, 3]) @ solid.pose[:3, :3]
    beyond = np.maximum(np.abs(own) - solid.shape.half_mm, 0.0)
    flat = np.maximum(np.hypot(beyond[..., 0], beyond[..., 1]) - solid.shape.disc_mm, 0.0)
    return np.asarray(np.maximum(np.hypot(flat, beyond[..., 2]) - solid.shape.ball_mm, 0.0))


def test_shadows_are_where_rays_end() -> None:
    """Catches a solid that shades or hides and is not named, or one that is named and does neither."""
    rig = with_solids(
        Box(name="clamp", link="turntable", centre_mm=(32.0, 0.0, 5.0), size_mm=(8.0, 20.0, 12.0)),
        Capsule(name="wire", from_mm=(-400.0, -300.0, 200.0), to_mm=(300.0, -300.0, 300.0), radius_mm=4.0),
    )
    kinematics, shadows, clearance = Kinematics(rig), Shadows(rig), Clearance(rig)
    low, high = kinematics.limits_rad.T
    poses = np.random.default_rng(8).uniform(low, high, (3000, 4))
    poses = poses[clearance.poses(poses).clear]
    sight = shadows.at(poses)
    shaded, hidden = np.flatnonzero(sight.shaded_by >= 0), np.flatnonzero(sight.hidden_by >= 0)
    assert min(len(shaded), len(hidden)) > 20
    asked = np.concatenate([shaded[:20], hidden[:20], np.arange(40)])
    tips = {"light": "light_elevation", "camera": "camera_elevation"}
    links = {solid.name: solid.link for solid in rig.solids}
    for pose in asked:
        frames = kinematics.frames(poses[pose])
        placed = placed_solids(rig, poses[pose])
        for arm, centre, diameter, found in (
            ("light", frames.light_mm, rig.lamp.diameter_mm, sight.shaded_by[pose]),
            ("camera", frames.camera_mm, rig.camera.aperture_diameter_mm, sight.hidden_by[pose]),
        ):
            points = rays(centre, diameter / 2.0, rig.sample.diameter_mm / 2.0, 200, int(pose))
            near = [outside_mm(s, points).min() if links[s.name] != tips[arm] else np.inf for s in placed]
            assert found >= 0 or min(near) > 0.0
            assert found < 0 or near[found] < 4.0  # between random rays there is room


def test_a_spoiled_pose_is_dropped_or_marked() -> None:
    """Catches a shaded sample that is measured without a word, or a mark that also drops it."""
    # A wall around half the stage: whatever side the arms are on, light at 70 degrees does not pass.
    wall = [
        Box(name=f"wall{n}", link="turntable", centre_mm=c, size_mm=s)
        for n, (c, s) in enumerate(
            [((60.0, 0.0, 40.0), (4.0, 160.0, 80.0)), ((0.0, 80.0, 40.0), (160.0, 4.0, 80.0))]
        )
    ]
    rig = with_solids(*wall)
    poses = [[70.0, 0.0, 10.0, 180.0], [10.0, 180.0, 30.0, 225.0], [10.0, 180.0, 70.0, 90.0]]
    dropped = lay_out(plan_of(poses), rig)
    assert dropped.feasible.counts == {Reason.SHADED: 1, Reason.HIDDEN: 1}
    assert {refusal.index for refusal in dropped.feasible.refusals} == {0, 2}
    assert "wall0 would shade" in dropped.feasible.refusals[0].detail
    marked = lay_out(plan_of(poses, spoiled="mark"), rig)
    assert marked.forecast().poses == 3
    assert marked.forecast().marked_by == {Reason.SHADED: 1, Reason.HIDDEN: 1}
    assert [mark.index for mark in marked.feasible.marks] == [0, 2]
    flags = {(visit.role, visit.pose): visit.flags for visit in marked.visits()}
    for role in (Role.WHITE, Role.SAMPLE):  # whatever lies there is shaded
        assert [flags[role, pose] for pose in range(3)] == [PoseFlag.SHADED, NO_FLAG, PoseFlag.HIDDEN]


def test_the_lamp_in_the_picture_is_seen() -> None:
    """Catches a wide picture at grazing angles that has the lamp in it."""
    poses = [[84.0, 0.0, 84.0, 180.0], [84.0, 0.0, 30.0, 180.0]]
    narrow = lay_out(plan_of(poses), describe())
    assert narrow.forecast().poses == 2
    wide = describe(camera=Camera(focal_length_px=400.0))
    assert lay_out(plan_of(poses), wide).feasible.counts == {Reason.LAMP_IN_VIEW: 1}


def test_another_side_is_taken_where_a_solid_stands() -> None:
    """Catches a pose given up though the arms can meet it from the other side."""
    wi, wo = listed(np.radians([[50.0, 0.0, 20.0, 90.0], [0.0, 0.0, 40.0, 77.0]]))
    bare = feasible(Kinematics(describe()), wi, wo)
    for row in range(2):
        turn = placed_solids(describe(), bare.angles_rad[row], in_sample_frame=False)
        housing = next(solid for solid in turn if solid.name == "camera").pose[:3, 3]
        ball = Sphere(name="ball", centre_mm=tuple(housing.tolist()), radius_mm=40.0)
        rig = with_solids(ball)
        found = feasible(Kinematics(rig), wi, wo)
        assert row in found.taken
        place = list(found.taken).index(row)
        assert not np.allclose(found.angles_rad[place], bare.angles_rad[row])
        light, camera = Kinematics(rig).directions(found.angles_rad)
        np.testing.assert_allclose(light, wi[found.taken], atol=1e-9)
        np.testing.assert_allclose(camera, wo[found.taken], atol=1e-9)
        assert all(obstacle is None for obstacle in Obstacles(rig).at(found.angles_rad))


def test_a_sweep_past_the_lamp_goes_round_it() -> None:
    """Catches a forecast without the time of detours, and a way back that was not looked at."""
    poses = [[0.0, 0.0, theta, phi] for phi in (0.0, 180.0) for theta in (20.0, 40.0, 60.0)]
    itinerary = lay_out(plan_of(poses), describe())
    assert itinerary.forecast().poses == 6
    direct = lay_out(plan_of(poses), describe(solids=()))
    assert direct.forecast().detours == 0
    assert itinerary.forecast().travel_s >= direct.forecast().travel_s


@pytest.fixture(scope="module")
def fenced() -> Rig:
    """Return a machine with a ring of balls at 62 degrees: the camera, parked within, cannot pass between."""
    angles = np.radians(np.arange(0.0, 360.0, 12.0))
    ring = 600.0 * np.column_stack([np.sin(1.08) * np.cos(angles), np.sin(1.08) * np.sin(angles)])
    balls = [
        Sphere(name=f"ball{n}", centre_mm=(x, y, 600.0 * np.cos(1.08)), radius_mm=34.0)
        for n, (x, y) in enumerate(ring.tolist())
    ]
    return describe(solids=(*(s for s in describe().solids if s.link.startswith("camera")), *balls))


IN_AND_OUT = [[45.0, 0.0, theta, 180.0] for theta in (5.0, 75.0, 10.0, 80.0)]


def test_poses_behind_a_wall_are_cut_off(fenced: Rig) -> None:
    """Catches a plan whose arms would have to pass through a solid."""
    found = lay_out(plan_of(IN_AND_OUT), fenced).feasible
    assert found.counts == {Reason.CUT_OFF: 2}
    assert list(found.taken) == [0, 2]
    assert "ball" in found.refusals[0].detail


def test_a_pose_after_one_that_is_cut_off_is_kept(fenced: Rig) -> None:
    """Catches a pose lost only because it came after one behind the wall."""
    wi, wo = listed(np.radians(IN_AND_OUT))
    kinematics, obstacles = Kinematics(fenced), Obstacles(fenced)
    found = feasible(kinematics, wi, wo, obstacles)
    left, order, travel = travel_past(obstacles.clearance, found, np.arange(4), kinematics.park_rad)
    assert list(left.taken) == [0, 2]
    assert list(order) == [0, 1]
    assert travel.seconds(2) == travel.first_s + travel.there_s + travel.back_s


@pytest.mark.parametrize("spoiled", ["drop", "mark"])
def test_a_machine_without_solids_takes_what_it_took(spoiled: str) -> None:
    """Catches a rig file of before that loses poses, or cannot be laid out."""
    poses = [[30.0, 0.0, 20.0, 180.0], [30.0, 0.0, 31.0, 0.0], [60.0, 40.0, 70.0, 300.0]]
    found = lay_out(plan_of(poses, spoiled=spoiled), describe(solids=())).feasible
    assert found.counts == {Reason.SEPARATION: 1}
    assert not found.marks


def one_sided(approach: str, **limits_deg: tuple[float, float]) -> Rig:
    """Return the default machine, its camera's elevation approached from one side, with other limits."""
    rig = describe()
    changes: dict[str, dict[str, Any]] = {name: {"limits_deg": limits} for name, limits in limits_deg.items()}
    changes.setdefault("camera_elevation", {}).update(approach=approach, overshoot_deg=22.0)
    joints = tuple(joint.model_copy(update=changes.get(joint.name, {})) for joint in rig.joints)
    return rig.model_copy(update={"joints": joints})


@pytest.mark.parametrize(
    ("approach", "takes"), [("direct", True), ("from_above", True), ("from_below", False)]
)
def test_the_last_push_to_a_pose_is_checked_with_it(approach: str, takes: bool) -> None:
    """Catches a plan that is refused the one-sided approach to a pose hours later, by the machine."""
    rig = one_sided(approach, camera_elevation=(-1.0, 85.0), camera_azimuth=(-60.0, 60.0))
    found = lay_out(plan_of([[0.0, 0.0, 25.0, 0.0], [0.0, 0.0, 60.0, 0.0]], refused="skip"), rig).feasible
    assert list(found.taken) == ([0, 1] if takes else [1])
    assert found.counts == ({} if takes else {Reason.CLEARANCE: 1})


@pytest.mark.parametrize(
    ("approach", "side", "lead_deg"), [("from_below", -1, -47.0), ("from_above", 1, 47.0)]
)
def test_the_side_with_room_for_the_last_push_is_taken(approach: str, side: int, lead_deg: float) -> None:
    """Catches a pose given up, or met from the side on which its approach is blocked."""
    rig = one_sided(approach)
    angles = lay_out(plan_of([[0.0, 0.0, 25.0, 0.0]]), rig).feasible.angles_rad
    assert angles[0, 2] == pytest.approx(np.radians(side * 25.0))
    assert np.degrees(leads_rad(rig, angles)[:, 0, 2]) == pytest.approx([lead_deg], abs=0.1)
