"""Ways round: a leg that was not checked, a way that ends elsewhere, or none where there is one."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.clearance_dense import DenseClearance, driven_poses
from rig.clearance import Clearance
from rig.description import Sphere, default_rig
from rig.detour import Detours
from rig.errors import Refused
from rig.ticks import rad_to_ticks, ticks_to_rad

RIG = default_rig()
LOOSE_MM = 0.05


@pytest.fixture(scope="module")
def clearance() -> Clearance:
    """Return the default machine's clearance."""
    return Clearance(RIG)


def test_of_the_blocked_moves_nine_in_ten_get_round(clearance: Clearance) -> None:
    """Catches a way with a leg that comes too near, and moves given up too soon."""
    low, high = clearance.pairs.kinematics.limits_rad.T
    poses = np.random.default_rng(4).uniform(low, high, (500, low.size))
    poses = poses[clearance.poses(poses).clear][:400]
    start, end = poses[::2], poses[1::2]
    blocked = ~clearance.moves(start, end).clear
    ways = Detours(clearance).ways(start, end)
    found = np.array([way is not None for way in ways])
    assert found[~blocked].all()
    assert blocked.sum() > 40
    assert found[blocked].mean() >= 0.9
    straight = clearance.straight_moves(start, end).clear
    assert found[straight].all()
    dense, margin = DenseClearance(RIG), RIG.clearance.margin_mm
    for move in np.flatnonzero(blocked & found)[:40]:
        way = ways[move]
        assert way is not None
        np.testing.assert_array_equal(way[-1], end[move])
        assert np.all((way >= low - 1e-9) & (way <= high + 1e-9))
        for leg_start, leg_end in zip([start[move], *way[:-1]], way, strict=True):
            driven = driven_poses(RIG, leg_start, leg_end, 40)
            assert dense.nearest_mm(driven, margin - LOOSE_MM) >= margin - LOOSE_MM


def test_ways_are_always_the_same(clearance: Clearance) -> None:
    """Catches a road map that is drawn anew: a resumed session would go other ways."""
    start, end = np.array([[0.0, 0.0, -0.6, 0.0]]), np.array([[0.0, 0.0, 0.6, 0.0]])
    first, second = (Detours(Clearance(RIG)).ways(start, end)[0] for _ in range(2))
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first, second)


def test_the_map_is_used_where_no_order_of_joints_helps() -> None:
    """Catches a map that is never reached, and stops on it that no servo can hold."""
    balls = tuple(
        Sphere(name=f"ball{number}", centre_mm=place, radius_mm=60.0)
        for number, place in enumerate([(0.0, 650.0, 150.0), (0.0, -650.0, 150.0), (-450.0, 450.0, 250.0)])
    )
    rig = default_rig(solids=(*RIG.solids, *balls))
    clearance = Clearance(rig)
    low, high = clearance.pairs.kinematics.limits_rad.T
    poses = np.random.default_rng(4).uniform(low, high, (600, low.size))
    poses = poses[clearance.poses(poses).clear][:120]
    start, end = poses[::2], poses[1::2]
    detours = Detours(clearance)
    ways = detours.ways(start, end)
    assert np.mean([way is not None for way in ways]) >= 0.9
    assert "_map" in vars(detours)
    nodes = detours._map[0]
    for place, joint in enumerate(rig.arm_joints):
        held = ticks_to_rad(joint, rad_to_ticks(joint, nodes[:, place]))
        np.testing.assert_array_equal(nodes[:, place], held)


def test_what_cannot_be_reached_is_refused_by_name(clearance: Clearance) -> None:
    """Catches a refusal that does not say which solids meet, and where."""
    with pytest.raises(Refused) as refused:
        Detours(clearance).way((0.0, 0.0, 1.0, 0.0), (0.2, 0.0, 0.2, 0.0))
    assert "lamp" in str(refused.value)
    assert "camera_elevation 11.5" in str(refused.value)


def test_a_stop_that_was_missed_by_a_tolerance_is_gone_on_from(clearance: Clearance) -> None:
    """Catches a detour that ends at its first stop, or goes on without a look from a place far off."""
    detours = Detours(clearance)
    start, end = np.array([0.0, 0.0, -0.6, 0.0]), np.array([0.0, 0.0, 0.6, 0.0])
    way = detours.way(start, end)
    np.testing.assert_array_equal(detours.onward(way[0] + 1e-3, way[1:]), way[1:])
    again = detours.onward(start, end[None])
    assert len(again) > 1
