"""Clearance along moves: a move that is accepted and comes too near, or refused and does not.

The other code (`benchmarks.clearance_dense`) places solids by scipy, moves them as the twin does, and
measures their distances with FCL.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.clearance_dense import DenseClearance, driven_poses
from rig.angles import rotation
from rig.clearance import Clearance
from rig.clearance_pairs import RESOLUTION_MM, SolidPairs
from rig.description import Arms, Box, Capsule, Cylinder, Joint, Rig, Sphere, default_rig
from rig.description import Clearance as Margin
from rig.motion import Moves, ServoProfile

if TYPE_CHECKING:
    from rig.angles import FloatArray
    from rig.solids import Solid

LOOSE_MM = 0.05
"""How far FCL's distances may be off."""


def random_poses(rig: Rig, count: int, seed: int) -> FloatArray:
    """Draw poses within the joints' limits."""
    low, high = np.radians([joint.limits_deg for joint in rig.arm_joints]).T
    return np.random.default_rng(seed).uniform(low, high, (count, low.size))


def random_solids(links: tuple[str, ...], count: int, seed: int) -> tuple[Solid, ...]:
    """Draw solids of every kind around the sample, on links."""
    random = np.random.default_rng(seed)
    solids: list[Solid] = []
    for number in range(count):
        name, link = f"solid{number}", links[number % len(links)]
        near, far = (tuple(float(x) for x in random.normal(size=3) * 150.0) for _ in range(2))
        radius = float(random.uniform(5.0, 40.0))
        made: tuple[Solid, ...] = (
            Sphere(name=name, link=link, centre_mm=near, radius_mm=radius),
            Capsule(name=name, link=link, from_mm=near, to_mm=far, radius_mm=radius),
            Cylinder(name=name, link=link, from_mm=near, to_mm=far, radius_mm=radius),
            Box(name=name, link=link, centre_mm=near, size_mm=(radius, 60.0, 20.0), turn_deg=far),
        )
        solids.append(made[int(random.integers(4))])
    return tuple(solids)


def other_machine(solids: tuple[Solid, ...], turn: FloatArray | None = None) -> Rig:
    """Return a machine of five joints on slanted axes, two of them under both arms, turned as a whole."""
    axes = np.array([[0.0, 0.0, 1.0], [0.3, 1.0, 0.2], [1.0, 0.2, 0.0], [0.0, 1.0, -0.4], [0.1, 0.0, 1.0]])
    axes = axes if turn is None else axes @ turn.T
    names = ("root", "light", "camera", "wrist", "table")
    speeds = (60.0, 20.0, 90.0, 45.0, 30.0)
    joints = tuple(
        Joint(
            name=name, id=number, axis=tuple(axis.tolist()), limits_deg=(-120.0, 100.0), speed_deg_s=speed,
            gear_ratio=1.5,
        )
        for number, (name, axis, speed) in enumerate(zip(names, axes, speeds, strict=True))
    )  # fmt: skip
    arms = Arms(light=("root", "light"), camera=("root", "camera", "wrist"), sample=("table",))
    return Rig(joints=joints, arms=arms, solids=solids, clearance=Margin(margin_mm=5.0))


def test_moves_are_those_of_the_servos() -> None:
    """Catches a profile in other units than the servos', or a joint that ends too early or too late."""
    for rig in (default_rig(), other_machine(())):
        start, end = random_poses(rig, 20, 1), random_poses(rig, 20, 2)
        end[3] = start[3]
        end[4, 1] = start[4, 1]
        end[5] = start[5] + 1e-4
        moves = Moves(start, end, ServoProfile.of(rig))
        for move in range(20):
            shares = np.linspace(0.0, 1.0, 33)
            found = moves.at(np.full(33, move), shares)
            np.testing.assert_allclose(found, driven_poses(rig, start[move], end[move], 33), atol=1e-9)
            np.testing.assert_array_equal(found[[0, -1]], [start[move], end[move]])


@pytest.mark.parametrize(
    "rig",
    [
        default_rig(),
        default_rig(solids=random_solids(("base", "light_elevation", "camera_elevation", "turntable"), 9, 7)),
        other_machine(random_solids(("base", "root", "light", "camera", "wrist", "table"), 9, 3)),
    ],
    ids=("default", "random solids", "other joints"),
)
def test_what_is_accepted_is_clear_and_what_is_refused_is_not(rig: Rig) -> None:
    """Catches a bound that is too low (accepted, too near), or too high (refused, clear)."""
    clearance, dense = Clearance(rig), DenseClearance(rig)
    margin = rig.clearance.margin_mm
    poses = random_poses(rig, 4000, 5)
    poses = poses[clearance.poses(poses).clear][:240]
    start, end = poses[0::2], poses[1::2]
    driven, straight = clearance.moves(start, end), clearance.straight_moves(start, end)
    assert 5 < driven.clear.sum() < len(start)
    share = np.linspace(0.0, 1.0, 60)[:, None]
    for move in range(len(start)):
        if driven.clear[move]:
            way = driven_poses(rig, start[move], end[move], 60)
            assert dense.nearest_mm(way, margin - LOOSE_MM) >= margin - LOOSE_MM
        else:
            assert dense.nearest_mm(driven.angles_rad[move : move + 1]) < margin + RESOLUTION_MM + LOOSE_MM
        if straight.clear[move]:
            way = (1.0 - share) * start[move] + share * end[move]
            assert dense.nearest_mm(way, margin - LOOSE_MM) >= margin - LOOSE_MM


def test_poses_are_refused_where_solids_are_near() -> None:
    """Catches a pose check that knows fewer pairs than the machine has."""
    for rig in (default_rig(), other_machine(random_solids(("base", "root", "light", "wrist"), 8, 12))):
        clearance, dense = Clearance(rig), DenseClearance(rig)
        poses = random_poses(rig, 300, 9)
        known = np.array([dense.nearest_mm(pose[None]) for pose in poses])
        undecided = np.abs(known - rig.clearance.margin_mm) < LOOSE_MM
        found = clearance.poses(poses).clear
        np.testing.assert_array_equal(found[~undecided], known[~undecided] >= rig.clearance.margin_mm)
        assert 5 < found.sum() < 300


@settings(deadline=None, max_examples=10)
@given(
    seed=st.integers(0, 100),
    axis=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda axis: np.linalg.norm(axis) > 0.1),
    angle=st.floats(-3.0, 3.0),
)
def test_a_machine_turned_as_a_whole_is_the_same(seed: int, axis: tuple[float, ...], angle: float) -> None:
    """Catches a distance or a lever that depends on how the machine stands in the room."""
    turn = rotation(axis, angle)
    rods = [
        solid for solid in random_solids(("base", "light", "wrist"), 30, seed) if isinstance(solid, Capsule)
    ]

    def turned(point: tuple[float, float, float]) -> tuple[float, ...]:
        return tuple((turn @ point).tolist())

    there = tuple(
        rod.model_copy(update={"from_mm": turned(rod.from_mm), "to_mm": turned(rod.to_mm)}) for rod in rods
    )
    here, other = other_machine(tuple(rods)), other_machine(there, turn)
    before, after = SolidPairs(here), SolidPairs(other)
    np.testing.assert_array_equal(before.pairs, after.pairs)
    np.testing.assert_allclose(before.levers_mm, after.levers_mm, rtol=0.5)
    poses = random_poses(here, 50, seed)
    for pose in poses[:10]:
        first, second = Clearance(here).nearest(pose), Clearance(other).nearest(pose)
        assert (first is None) == (second is None)
        if first is not None and second is not None:
            assert first.distance_mm == pytest.approx(second.distance_mm, abs=1e-4)


def test_solids_too_near_may_part_but_not_meet() -> None:
    """Catches arms that can never leave a place a tolerance inside the margin, or that close in."""
    rig = default_rig()
    clearance = Clearance(rig)
    low, high = 0.0, 1.0
    for _ in range(60):  # the camera's elevation at which its lens is just too near to the lamp
        middle = (low + high) / 2.0
        near = not clearance.poses(np.array([[0.0, 0.0, middle, 0.0]])).clear[0]
        low, high = (middle, high) if near else (low, middle)
    start = np.array([[0.0, 0.0, high - 0.005, 0.0]])
    away, closer = np.array([[0.0, 0.0, 1.0, 0.0]]), np.array([[0.0, 0.0, high - 0.05, 0.0]])
    assert not clearance.moves(start, away).clear[0]
    assert clearance.leaving(start[0]).moves(start, away).clear[0]
    assert not clearance.leaving(start[0]).moves(start, closer).clear[0]
    inside = np.array([[0.0, 0.0, 0.0, 0.0]])
    assert not clearance.leaving(inside[0]).moves(inside, away).clear[0]


def test_the_nearest_pair_and_its_points() -> None:
    """Catches points that lie inside the solids, or names of others."""
    balls = (
        Sphere(name="still", centre_mm=(0.0, 0.0, 100.0), radius_mm=10.0),
        Sphere(name="moving", link="light_elevation", centre_mm=(0.0, 0.0, 160.0), radius_mm=20.0),
    )
    found = Clearance(default_rig(solids=balls, clearance=Margin(margin_mm=1.0))).nearest([0.0] * 4)
    assert found is not None
    assert found.solids == ("still", "moving")
    assert found.distance_mm == pytest.approx(30.0, abs=1e-4)
    np.testing.assert_allclose(found.points_mm, [[0.0, 0.0, 110.0], [0.0, 0.0, 140.0]], atol=1e-3)
