"""Fixtures of the light's tests: Mitsuba in each of the two variants."""

from __future__ import annotations

from typing import Any

import pytest

from simulator import bsdfs
from simulator.variant import LLVM, choose_variant, load_mitsuba


@pytest.fixture
def vector() -> Any:
    """Mitsuba in its LLVM variant, our BSDFs registered."""
    if choose_variant().variant != LLVM:
        pytest.skip("no LLVM >= 19 on this machine")
    mi = load_mitsuba("llvm")
    bsdfs.register(mi)
    return mi


@pytest.fixture
def scalar() -> Any:
    """Mitsuba in its scalar variant, our BSDFs registered."""
    mi = load_mitsuba("scalar")
    bsdfs.register(mi)
    return mi
