"""Profiles in closed form: where they end, how fast they may be, what they do in between."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.motion import Limits, Motion, ProfileKind, move_to, turn_at

TICKS = st.integers(-5000, 5000).map(float)
VELOCITY = st.floats(-900, 900)
LIMITS = st.builds(Limits, st.floats(10, 2000), st.floats(10, 1e6))


@given(TICKS, TICKS, VELOCITY, LIMITS)
def test_it_ends_at_the_target_at_rest(target: float, start: float, velocity: float, limits: Limits) -> None:
    """Catches a branch (overshoot, wrong way, too fast) whose segments do not add up to the distance."""
    motion = move_to(target, start, velocity, limits)
    assert motion.at(motion.duration_s + 1.0) == (target, 0.0)
    # The closed form must arrive there by itself, not only because the end is pinned to the target.
    position, speed = motion.at(motion.duration_s * (1 - 1e-12))
    assert position == pytest.approx(target, abs=1e-3)
    assert speed == pytest.approx(0.0, abs=1e-3 * limits.acceleration)


@given(TICKS, TICKS, VELOCITY, LIMITS, st.floats(0, 1))
def test_the_limits_hold(target: float, start: float, velocity: float, limits: Limits, when: float) -> None:
    """Catches a motion faster than its profile, or with a step in velocity."""
    motion = move_to(target, start, velocity, limits)
    fastest = max(limits.velocity, abs(velocity))
    time = when * motion.duration_s
    assert abs(motion.at(time)[1]) <= fastest * (1 + 1e-9)
    step = 1e-4
    change = abs(motion.at(time + step)[1] - motion.at(time)[1])
    assert change <= limits.acceleration * step * (1 + 1e-6) + 1e-6 * fastest


@given(TICKS, TICKS, VELOCITY, LIMITS, st.floats(0, 1))
def test_a_new_goal_in_mid_move_continues_the_motion(
    target: float, start: float, velocity: float, limits: Limits, when: float
) -> None:
    """Catches a jump when a client changes the goal while the shaft turns."""
    first = move_to(target, start, 0.0, limits)
    position, speed = first.at(when * first.duration_s)
    second = move_to(start, position, speed, limits)
    assert second.at(0.0) == pytest.approx((position, speed), abs=1e-9)
    assert second.at(second.duration_s + 1)[0] == start


@given(st.integers(1, 5000), LIMITS)
def test_duration_from_rest_to_rest(distance: int, limits: Limits) -> None:
    """Catches a profile slower or faster than d/v + v/a, or than 2 sqrt(d/a) where it has no cruise."""
    motion = move_to(float(distance), 0.0, 0.0, limits)
    v, a = limits.velocity, limits.acceleration
    cruises = distance > v * v / a
    expected = distance / v + v / a if cruises else 2 * math.sqrt(distance / a)
    assert motion.duration_s == pytest.approx(expected, rel=1e-9)
    if not math.isclose(distance, v * v / a, rel_tol=1e-9):
        assert motion.kind is (ProfileKind.TRAPEZOIDAL if cruises else ProfileKind.TRIANGULAR)


def test_no_distance_is_no_motion() -> None:
    """Catches a division by zero or an endless profile for the goal where the shaft already stands."""
    assert move_to(7.0, 7.0, 0.0, Limits(1.0, 1.0)) == Motion(7.0)


def test_turning_at_a_velocity_never_ends() -> None:
    """Catches velocity mode that stops by itself, or reaches its speed at once."""
    motion = turn_at(-100.0, 0.0, 50.0, 10.0)
    assert motion.duration_s == math.inf
    assert motion.at(5.0)[1] == pytest.approx(0.0)
    assert motion.at(1000.0)[1] == pytest.approx(-100.0)
    assert turn_at(0.0, 0.0, 50.0, 10.0).at(100.0) == pytest.approx((125.0, 0.0))
