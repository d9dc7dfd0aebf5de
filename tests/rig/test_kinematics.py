"""Joint angles to directions and back, for the common machine and for others."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rig import inverse
from rig.angles import mirror, rotation, spherical_to_direction
from rig.description import Arms, Clearance, Joint, Rig
from rig.description import default_rig as describe
from rig.errors import BadInput, Refused
from rig.kinematics import Kinematics

if TYPE_CHECKING:
    from rig.angles import FloatArray

COMMON = Kinematics(describe())
TIGHT = Kinematics(describe(clearance=Clearance(min_separation_deg=0.0)))
NORMAL = np.array([0.0, 0.0, 1.0])


def machine(light: str, camera: str, sample: str = "", **limits: tuple[float, float]) -> Kinematics:
    """Describe a machine by its axes: `light="zy"` is a lamp on an elevation that stands on an azimuth.

    Joints are named after arm and place (`light0`); capital letters are axes that point the other way.
    """
    axes = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0), "d": (1.0, 2.0, -0.5)}
    joints: list[Joint] = []
    arms: dict[str, tuple[str, ...]] = {}
    for arm, letters in (("light", light), ("camera", camera), ("sample", sample)):
        arms[arm] = tuple(f"{arm}{place}" for place in range(len(letters)))
        for name, letter in zip(arms[arm], letters, strict=True):
            sign = -1.0 if letter.isupper() else 1.0
            x, y, z = axes[letter.lower()]
            joints.append(
                Joint(
                    name=name,
                    id=len(joints),
                    axis=(sign * x, sign * y, sign * z),
                    limits_deg=limits.get(name, (-180.0, 179.9)),
                )
            )
    return Kinematics(
        Rig(joints=tuple(joints), arms=Arms(**arms), clearance=Clearance(min_separation_deg=0.0))
    )


MACHINES = {
    "in-plane": machine("y", "y"),
    "camera on an azimuth": machine("y", "zy", "z"),
    "all axes reversed": machine("Y", "ZY", "Z"),
    "sample on two hinges": machine("", "y", "yz"),
    "fixed camera, robot sample": machine("zy", "", "zyz"),
    "skew axes": machine("dy", "xdz", "d"),
    "both domes": machine("zy", "zy"),
}

elevations = st.floats(0.0, math.radians(84.9)) | st.sampled_from([0.0, 1e-12, 1e-10, 1e-8, 1e-4])
leans = st.floats(0.01, math.radians(84.9))
azimuths = st.floats(-math.pi, math.pi) | st.sampled_from([k * math.pi / 4 for k in range(-4, 5)])
anywhere = st.floats(-math.pi, math.pi)


def poses(kinematics: Kinematics, count: int = 7) -> FloatArray:
    """Draw poses within the limits."""
    low, high = kinematics.limits_rad.T
    return np.random.default_rng(5).uniform(low, high, size=(count, low.size))


def test_zero_pose_looks_down_on_the_sample(default_rig: Rig) -> None:
    """Catch a picture that is mirrored or turned: at zero it is a map, right +x, up +y."""
    kinematics = Kinematics(default_rig)
    wi, wo = kinematics.directions(np.zeros(4))
    frames = kinematics.frames(np.zeros(4))
    np.testing.assert_array_equal([wi, wo], [NORMAL, NORMAL])
    np.testing.assert_array_equal(frames.light_mm, [0, 0, 500])
    np.testing.assert_array_equal(frames.camera_mm, [0, 0, 600])
    np.testing.assert_array_equal(frames.camera_rotation.T, [[1, 0, 0], [0, -1, 0], [0, 0, -1]])


@pytest.mark.parametrize(
    ("angles_deg", "wi", "wo"),
    [
        ((30, 0, 0, 0), (30, 0), (0, 0)),
        ((-30, 0, 0, 0), (30, 180), (0, 0)),
        ((0, 0, 40, 0), (0, 0), (40, 0)),
        ((0, 90, 40, 0), (0, 0), (40, 90)),
        ((30, 90, 40, 20), (30, -20), (40, 70)),
        ((30, 90, -40, 20), (30, -20), (40, -110)),
    ],
)
def test_directions_by_hand(
    angles_deg: tuple[float, ...], wi: tuple[float, float], wo: tuple[float, float]
) -> None:
    """Catch a sign: light leans to +x, the camera's azimuth turns +x to +y, the turntable turns both back."""
    directions = COMMON.directions(np.radians(angles_deg))
    expected = [spherical_to_direction(*np.radians(w)) for w in (wi, wo)]
    np.testing.assert_allclose(directions, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", MACHINES)
def test_chains_of_any_kind(name: str) -> None:
    """Catch a wrong order of joints: each chain against its rotations multiplied one by one."""
    kinematics = MACHINES[name]
    for pose in poses(kinematics):
        tips = []
        for chain in (kinematics.light_chain, kinematics.camera_chain, kinematics.sample_chain):
            tip = np.eye(3)
            for place in chain:
                tip = tip @ rotation(kinematics.joints[place].axis, pose[place])
            tips.append(tip)
        wi, wo = kinematics.directions(pose)
        np.testing.assert_allclose(tips[2] @ wi, tips[0] @ NORMAL, rtol=0, atol=1e-14)
        np.testing.assert_allclose(tips[2] @ wo, tips[1] @ NORMAL, rtol=0, atol=1e-14)


def test_many_poses_at_once() -> None:
    """Catch broadcasting that mixes poses with joints, and NaN that spreads to other poses."""
    many = poses(COMMON, 6).reshape(2, 3, 4)
    many[1, 2, 0] = np.nan
    wi, wo = COMMON.directions(many)
    d_wi, d_wo = COMMON.derivatives(many)
    assert wi.shape == wo.shape == (2, 3, 3)
    assert d_wi.shape == d_wo.shape == (2, 3, 4, 3)
    assert np.isnan(wi).all(axis=-1).tolist() == [[False, False, False], [False, False, True]]
    for index in np.ndindex(2, 2):
        np.testing.assert_array_equal(wi[index], COMMON.directions(many[index])[0])
        np.testing.assert_array_equal(d_wo[index], COMMON.derivatives(many[index])[1])
    assert COMMON.separation_rad(many).shape == (2, 3)


@pytest.mark.parametrize("name", MACHINES)
def test_derivatives_against_differences(name: str) -> None:
    """Catch a joint with the wrong sign, above all one that turns the sample."""
    kinematics = MACHINES[name]
    step = 1e-6
    for pose in poses(kinematics):
        exact = np.stack(kinematics.derivatives(pose))
        for place in range(len(kinematics.joints)):
            nudge = step * np.eye(len(kinematics.joints))[place]
            ahead, behind = (np.stack(kinematics.directions(pose + s * nudge)) for s in (1, -1))
            np.testing.assert_allclose((ahead - behind) / (2 * step), exact[:, place], rtol=0, atol=1e-9)


@given(elevations, azimuths, elevations, azimuths, st.tuples(anywhere, anywhere, anywhere, anywhere))
def test_solve_meets_every_reachable_pose(
    theta_i: float, phi_i: float, theta_o: float, phi_o: float, near: tuple[float, ...]
) -> None:
    """Catch a branch, a seam or a pole where the closed form misses, or leaves the limits."""
    wi, wo = spherical_to_direction(theta_i, phi_i), spherical_to_direction(theta_o, phi_o)
    angles = TIGHT.solve(wi, wo, near)
    assert np.all(angles >= TIGHT.limits_rad[:, 0])
    assert np.all(angles <= TIGHT.limits_rad[:, 1])
    # Between +179.9 and -180 deg a joint rests on a limit, at most half a tick away. An azimuth on
    # the normal, to 1e-9 rad, stays as it is.
    at_a_limit = np.any(np.abs(angles[[1, 3], None] - TIGHT.limits_rad[[1, 3]]) == 0.0)
    tolerance = 2e-3 if at_a_limit else 2.1e-9 if min(theta_i, theta_o) <= 1e-9 else 1e-12
    np.testing.assert_allclose(TIGHT.directions(angles), [wi, wo], rtol=0, atol=tolerance)


@given(leans, azimuths, leans, azimuths, st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_solve_takes_the_nearest_pose(
    theta_i: float, phi_i: float, theta_o: float, phi_o: float, seed: int
) -> None:
    """Catch arms that swing to the other side without need: no branch that the search finds may be nearer."""
    wi, wo = spherical_to_direction(theta_i, phi_i), spherical_to_direction(theta_o, phi_o)
    near = np.random.default_rng(seed).uniform(*TIGHT.limits_rad.T)
    closed = TIGHT.solve(wi, wo, near)
    searched = inverse._search(TIGHT, wi, wo, near, "pose")
    assert np.abs(closed - near).max() <= np.abs(searched - near).max() + 1e-7


@given(st.integers(0, 2**32 - 1))
def test_solve_stays_where_it_is(seed: int) -> None:
    """Catch a jump to another branch: from a pose to itself nothing moves."""
    pose = np.random.default_rng(seed).uniform(*TIGHT.limits_rad.T)
    assume(np.all(np.abs(pose[[0, 2]]) > 1e-6))
    np.testing.assert_allclose(TIGHT.solve(*TIGHT.directions(pose), pose), pose, rtol=0, atol=1e-9)


def test_free_joints_stay() -> None:
    """Catch a turntable or azimuth that turns for nothing where light or camera are on the normal."""
    near = np.radians([10.0, 50.0, 20.0, -70.0])
    light_on_normal = COMMON.solve(NORMAL, spherical_to_direction(0.6, math.radians(115.0)), near)
    np.testing.assert_allclose(np.degrees(light_on_normal), [0, 45, math.degrees(0.6), -70], atol=1e-9)
    camera_on_normal = COMMON.solve(spherical_to_direction(0.6, math.radians(75.0)), NORMAL, near)
    np.testing.assert_allclose(np.degrees(camera_on_normal), [math.degrees(0.6), 50, 0, -75], atol=1e-9)


def test_a_free_turntable_helps_a_camera_with_a_short_azimuth() -> None:
    """Catch a refusal under light along the normal, where the turntable could turn the sample instead."""
    short = machine("y", "zy", "z", camera0=(-10.0, 10.0), camera1=(0.0, 80.0))
    wo = spherical_to_direction(0.6, math.radians(100.0))
    angles = short.solve(NORMAL, wo, near=np.zeros(4))
    np.testing.assert_allclose(short.directions(angles), [NORMAL, wo], rtol=0, atol=1e-14)
    both_short = machine("y", "zy", "z", camera0=(-10.0, 60.0), camera1=(0.0, 80.0), sample0=(-60.0, 5.0))
    angles = both_short.solve(NORMAL, wo, near=np.zeros(4))
    np.testing.assert_allclose(both_short.directions(angles), [NORMAL, wo], rtol=0, atol=1e-14)


def test_the_other_branch_is_taken_when_one_is_out_of_reach() -> None:
    """Catch a closed form that knows positive elevations only."""
    one_sided = machine("y", "zy", "z", light0=(-80.0, 20.0))
    wi, wo = spherical_to_direction(1.0, 0.2), spherical_to_direction(0.5, -2.0)
    angles = one_sided.solve(wi, wo)
    assert angles[0] == pytest.approx(-1.0)
    np.testing.assert_allclose(one_sided.directions(angles), [wi, wo], rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", [name for name in MACHINES if name != "in-plane"])
def test_other_chains_are_searched(name: str) -> None:
    """Catch a search that gets stuck: every pose that forward kinematics makes must be found again."""
    kinematics = MACHINES[name]
    for pose in poses(kinematics, 5):
        wi, wo = kinematics.directions(pose)
        found = kinematics.solve(wi, wo)
        np.testing.assert_allclose(kinematics.directions(found), [wi, wo], rtol=0, atol=2e-3)
        assert np.all((found >= kinematics.limits_rad[:, 0]) & (found <= kinematics.limits_rad[:, 1]))


def test_search_stays_near() -> None:
    """Catch a search that swings a six-joint machine about when a small move does."""
    kinematics = MACHINES["skew axes"]
    for pose in poses(kinematics, 5) * 0.8:
        wi, wo = kinematics.directions(pose + 0.01)
        found = kinematics.solve(wi, wo, near=pose)
        np.testing.assert_allclose(kinematics.directions(found), [wi, wo], rtol=0, atol=1e-8)
        assert np.abs(found - pose).max() < 0.05


def test_joints_to_spare_respect_their_limits() -> None:
    """Catch a refusal where one joint's limit can be made good by another joint."""
    redundant = machine("yy", "y", light0=(-20.0, 20.0), light1=(-60.0, 60.0))
    wi, wo = spherical_to_direction(math.radians(75.0), 0.0), spherical_to_direction(0.3, math.pi)
    angles = redundant.solve(wi, wo)
    assert angles[0] + angles[1] == pytest.approx(math.radians(75.0), abs=1e-8)
    assert abs(angles[0]) <= math.radians(20.0)
    with pytest.raises(Refused, match="light"):
        redundant.solve(spherical_to_direction(math.radians(85.0), 0.0), wo)
    at_the_corner = redundant.solve(spherical_to_direction(math.radians(79.99), 0.0), wo)
    np.testing.assert_allclose(np.degrees(at_the_corner[:2]), [20.0, 60.0], atol=0.011)


def test_unreachable_names_joint_angle_and_limits() -> None:
    """Catch a refusal that leaves the person to guess which joint it was."""
    with pytest.raises(Refused) as caught:
        COMMON.solve(spherical_to_direction(math.radians(86.5), 0.3), NORMAL)
    message = str(caught.value)
    assert "theta_i 86.50" in message
    assert "light_elevation would have to turn to 86.50 deg, beyond its limits -85 to 85 deg" in message
    assert "limits_deg" in message
    with pytest.raises(Refused, match="camera_elevation"):
        COMMON.solve(NORMAL, [0.0, 0.0, -1.0])  # from below


def test_less_than_half_a_tick_beyond_a_limit_is_the_limit() -> None:
    """Catch a refusal for an angle that no servo can tell from its limit, and angles beyond it."""
    half_a_tick_deg = 180.0 / 4096
    wi = spherical_to_direction(math.radians(85.0 + 0.9 * half_a_tick_deg), 0.0)
    assert COMMON.solve(wi, NORMAL)[0] == math.radians(85.0)
    with pytest.raises(Refused, match="light_elevation"):
        COMMON.solve(spherical_to_direction(math.radians(85.0 + 1.1 * half_a_tick_deg), 0.0), NORMAL)


def test_whole_turns_stay_near() -> None:
    """Catch a geared joint unwinding a whole turn where a small move does."""
    wheel = Joint(name="z", id=2, axis=(0.0, 0.0, 1.0), gear_ratio=0.5, limits_deg=(-360.0, 359.8))
    hinge = Joint(name="y", id=3, axis=(0.0, 1.0, 0.0), limits_deg=(-80.0, 80.0))
    lamp = Joint(name="lamp", id=4, axis=(0.0, 1.0, 0.0), limits_deg=(-80.0, 80.0))
    table = Joint(name="table", id=5, axis=(0.0, 0.0, 1.0), limits_deg=(-180.0, 179.9))
    arms = Arms(light=("lamp",), camera=("z", "y"), sample=("table",))
    geared = Kinematics(Rig(joints=(lamp, wheel, hinge, table), arms=arms))
    wi, wo = spherical_to_direction(0.3, 0.0), spherical_to_direction(0.6, math.radians(200.0))
    for azimuth_deg in (200.0, -160.0):
        near = np.radians([20.0, azimuth_deg + 5.0, 30.0, 0.0])
        assert math.degrees(geared.solve(wi, wo, near)[1]) == pytest.approx(azimuth_deg)


def test_out_of_plane_pose_of_an_in_plane_machine() -> None:
    """Catch a search that returns its nearest miss as if it had arrived."""
    with pytest.raises(Refused, match=r"no joint angles reach it, the nearest miss is \d+\.\d+ deg"):
        MACHINES["in-plane"].solve(spherical_to_direction(0.5, 0.0), spherical_to_direction(0.5, 1.0))


def test_lamp_in_the_cameras_view_is_refused() -> None:
    """Catch retro-reflection planned through the lamp: the least is 12 deg, and 12 is allowed."""
    wi = spherical_to_direction(math.radians(30.0), 0.0)
    with pytest.raises(Refused, match=r"11\.90 deg apart, less than 12 deg.*min_separation_deg"):
        COMMON.solve(wi, spherical_to_direction(math.radians(41.9), 0.0))
    angles = COMMON.solve(wi, spherical_to_direction(math.radians(42.0), 0.0))
    assert math.degrees(COMMON.separation_rad(angles)) == pytest.approx(12.0)
    COMMON.check(angles)
    with pytest.raises(Refused, match=r"0\.00 deg apart"):
        COMMON.check(np.zeros(4))


def test_check_names_the_joint_beyond_its_limits() -> None:
    """Catch a pose from a file that goes to the servos beyond their limits."""
    COMMON.check(np.radians([85.0, -180.0, 85.0, 179.9]))
    with pytest.raises(Refused, match=r"camera_azimuth would have to turn to 179\.95 deg"):
        COMMON.check(np.radians([85.0, 179.95, -85.0, 0.0]))
    with pytest.raises(Refused, match="turntable"):
        COMMON.check([0.0, 0.0, 1.0, math.nan])


@pytest.mark.parametrize("bad", [[0.0, 0.0, 0.0], [1.0, math.nan, 0.0], [math.inf, 0.0, 0.0], [1.0, 0.0]])
def test_no_direction_is_bad_input(bad: list[float]) -> None:
    """Catch NaN joint angles on their way to the servos."""
    with pytest.raises(BadInput, match="wi"):
        COMMON.solve(bad, NORMAL)
    with pytest.raises(BadInput, match="wo"):
        COMMON.solve(NORMAL, bad)


@pytest.mark.parametrize("shape", [(), (3,), (2, 5)])
def test_wrong_number_of_angles_is_bad_input(shape: tuple[int, ...]) -> None:
    """Catch a pose of all five servos where the four of the arms are meant."""
    with pytest.raises(BadInput, match="light_elevation, camera_azimuth"):
        COMMON.directions(np.zeros(shape))


def test_camera_frame_is_rigid_and_looks_at_the_sample() -> None:
    """Catch a camera that looks past the centre, or a mirrored picture, at any pose of any machine."""
    for kinematics in MACHINES.values():
        for pose in poses(kinematics, 3):
            frames = kinematics.frames(pose)
            _, wo = kinematics.directions(pose)
            np.testing.assert_allclose(frames.camera_rotation[:, 2], -wo, rtol=0, atol=1e-14)
            np.testing.assert_allclose(frames.camera_mm, 600.0 * wo, rtol=0, atol=1e-10)
            gram = frames.camera_rotation.T @ frames.camera_rotation
            np.testing.assert_allclose(gram, np.eye(3), rtol=0, atol=1e-14)
            assert np.linalg.det(frames.camera_rotation) == pytest.approx(1.0)


def test_mirror_poses_keep_the_turntable() -> None:
    """Catch a sweep in the plane of incidence that turns sample and camera about between neighbours."""
    near = COMMON.park_rad
    for theta_deg in range(10, 85, 5):
        wi = spherical_to_direction(math.radians(theta_deg), math.pi)
        near = COMMON.solve(wi, mirror(wi), near)
        np.testing.assert_allclose(np.degrees(near), [-theta_deg, 0.0, theta_deg, 0.0], rtol=0, atol=1e-9)
