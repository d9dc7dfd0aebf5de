"""Nights with faults: what the session holds is what was true on the twin."""

from __future__ import annotations

import pytest

from benchmarks.soak import Night, spend
from simulator.faults import FaultKind


def require_true(night: Night) -> None:
    """Pass only if every frame that counts is what it says, and no pose was lost or taken twice."""
    assert not +night.wrong, f"{night.wrong} after {night.happened}"
    assert night.poses == night.planned > 0
    assert night.frames >= night.poses


@pytest.mark.render
def test_a_short_night_with_lost_packets() -> None:
    """Catches a pose that is recorded though the arms stood elsewhere, or a frame that is lost on the way."""
    require_true(spend(poses=15, each=0, rate=0.02, seed=3))


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.timeout(600)
def test_a_night_with_every_fault() -> None:
    """Catches any kind of fault after which a frame counts that should not, or a pose is missing."""
    night = spend(poses=60, each=1, seed=5)
    require_true(night)
    assert set(night.happened) == set(FaultKind)
