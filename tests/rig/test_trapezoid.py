"""The profile of one axis: where it is at a time, and when it is where."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.description import default_rig
from rig.motion import Moves, ServoProfile
from rig.trapezoid import Trapezoid

POSITIVE = st.floats(1e-3, 1e3)


@given(st.floats(0.0, 1e4), POSITIVE, POSITIVE, st.floats(0.0, 1.0))
def test_when_is_the_other_way_round_of_where(
    way: float, speed: float, acceleration: float, share: float
) -> None:
    """Would catch a phase of the profile whose time is worked out from another's."""
    profile = Trapezoid(way, speed, acceleration)
    reached_s = profile.reached_s(share * way)
    assert 0.0 <= reached_s <= profile.duration_s * (1.0 + 1e-12)
    assert profile.travelled(reached_s) == pytest.approx(share * way, rel=1e-6, abs=1e-6 * way)


@pytest.mark.parametrize(("way", "duration_s"), [(0.0, 0.0), (8.0, 4.0), (18.0, 6.0), (30.0, 8.0)])
def test_a_profile_by_hand(way: float, duration_s: float) -> None:
    """Would catch a ramp counted once: 6 per second at 2 per second squared, short of the top and beyond."""
    profile = Trapezoid(way, 6.0, 2.0)
    assert profile.duration_s == pytest.approx(duration_s)
    assert profile.travelled(duration_s / 2.0) == pytest.approx(way / 2.0)
    assert profile.travelled(-1.0) == 0.0
    assert profile.travelled(duration_s + 1.0) == way


def test_joints_move_as_their_servos_are_told() -> None:
    """Would catch arms that are checked on one profile and compared with another."""
    rig = default_rig()
    profile = ServoProfile.of(rig)
    start, end = np.zeros((1, 4)), np.array([[0.3, -1.2, 0.02, 0.0]])
    moves = Moves(start, end, profile)
    for share in np.linspace(0.0, 1.0, 31):
        pose = moves.at(np.array([0]), np.array([share]))[0]
        for joint, speed, acceleration in zip(
            range(4), profile.speed_rad_s, profile.acceleration_rad_s2, strict=True
        ):
            axis = Trapezoid(abs(end[0, joint]), speed, acceleration)
            assert abs(pose[joint]) == pytest.approx(
                axis.travelled(share * float(moves.duration_s[0])), abs=1e-12
            )
