"""Travel times and the order of poses."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture.route import PIECE, order_by_travel, path_s
from rig.motion import ServoProfile, travel_s

if TYPE_CHECKING:
    from rig.angles import FloatArray

PROFILE = ServoProfile(np.radians([60.0, 60.0, 30.0]), np.radians([120.0, 120.0, 240.0]))
START = np.zeros(3)


def random_poses(count: int, seed: int) -> FloatArray:
    """Return joint angles anywhere within the limits."""
    return np.radians(np.random.default_rng(seed).uniform(-80.0, 80.0, (count, 3)))


def test_travel_time_is_that_of_an_integrated_trapezoid() -> None:
    """Would catch a wrong ramp: the distance covered in the time told must be the way."""
    for way_deg in (0.0, 5.0, 29.9, 30.1, 150.0):
        time_s = float(travel_s([0.0, 0.0, 0.0], np.radians([way_deg, 0.0, 0.0]), PROFILE))
        t = np.linspace(0.0, time_s, 20001)
        speed = np.minimum(np.minimum(120.0 * t, 60.0), 120.0 * (time_s - t))
        assert np.trapezoid(speed, t) == pytest.approx(way_deg, rel=1e-4, abs=1e-6)


def test_the_slowest_joint_decides() -> None:
    """Would catch a sum or a mean over joints that all move at once."""
    angles = np.radians([[60.0, 0.0, 0.0], [0.0, 0.0, 60.0], [60.0, 10.0, 60.0]])
    first, third, all_three = travel_s(np.zeros(3), angles, PROFILE)
    assert third > first
    assert all_three == third


@pytest.mark.parametrize("seed", range(12))
def test_close_to_the_best_of_all_orders(seed: int) -> None:
    """Would catch an improvement that stops early: seven poses have 5040 orders, the best is known."""
    angles = random_poses(7, seed)
    best = min(path_s(angles[list(way)], PROFILE, START) for way in itertools.permutations(range(7)))
    found = path_s(angles[order_by_travel(angles, PROFILE, START)], PROFILE, START)
    assert found <= 1.03 * best


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 40), st.integers(0, 10_000))
def test_an_order_is_a_permutation_and_never_slower(count: int, seed: int) -> None:
    """Would catch lost or doubled poses, and an improvement that makes it worse."""
    angles = random_poses(count, seed)
    order = order_by_travel(angles, PROFILE, START)
    assert sorted(order) == list(range(count))
    assert path_s(angles[order], PROFILE, START) <= path_s(angles, PROFILE, START) + 1e-9


def test_a_perfect_order_stays() -> None:
    """Would catch an order that is shuffled for nothing."""
    angles = np.linspace(0.0, 1.0, 30)[:, None] * np.ones(3)
    order = order_by_travel(angles, PROFILE, START)
    assert path_s(angles[order], PROFILE, START) == pytest.approx(path_s(angles, PROFILE, START))


def test_same_poses_same_order() -> None:
    """Would catch anything random: a resumed session must lay out the same way."""
    angles = random_poses(120, 3)
    np.testing.assert_array_equal(
        order_by_travel(angles, PROFILE, START), order_by_travel(angles.copy(), PROFILE, START.copy())
    )


def test_more_poses_than_one_piece() -> None:
    """Would catch a seam: poses lost or doubled where the improvement goes on with the next piece."""
    angles = random_poses(PIECE + 57, 5)
    order = order_by_travel(angles, PROFILE, START)
    assert sorted(order) == list(range(PIECE + 57))
    assert path_s(angles[order], PROFILE, START) < 0.6 * path_s(angles, PROFILE, START)


def test_a_path_is_the_sum_of_its_moves() -> None:
    """Would catch a start that is forgotten or counted twice."""
    angles = random_poses(5, 8)
    moves = [float(travel_s(a, b, PROFILE)) for a, b in itertools.pairwise(angles)]
    assert path_s(angles, PROFILE) == pytest.approx(math.fsum(moves))
    assert path_s(angles, PROFILE, START) == pytest.approx(
        math.fsum(moves) + float(travel_s(START, angles[0], PROFILE))
    )


def test_nothing_and_one_pose_need_no_order() -> None:
    """Would catch an error for the shortest plans."""
    assert list(order_by_travel(np.zeros((0, 3)), PROFILE, START)) == []
    assert list(order_by_travel(np.zeros((1, 3)), PROFILE, START)) == [0]
