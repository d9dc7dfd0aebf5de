"""Directions at which formulas break."""

from __future__ import annotations

import pytest

from benchmarks.models_digits import directions


@pytest.fixture(scope="session")
def hard_pairs():
    """Return wi, wo (N, 3): random, at and beside the mirror, back to the light, up to 89.999 deg."""
    return directions(12)
