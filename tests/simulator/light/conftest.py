"""Fixtures of the light's tests: Mitsuba in each of the two variants."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from simulator import bsdfs
from simulator.light.three_point import Surface
from simulator.variant import LLVM, choose_variant, load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Callable


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


@pytest.fixture
def cube() -> Callable[[float, Any, int], list[Surface]]:
    """Return what makes a cube, bright inside: of half a side in mm, reflectance, and nodes of each wall."""
    return _cube


def _cube(half_mm: float, reflectance: Any, nodes: int) -> list[Surface]:
    """Return the walls, cut where the sample's horizon is."""
    walls = []
    for axis, side in np.ndindex(3, 2):
        normal = np.zeros(3)
        normal[axis] = 1.0 - 2.0 * side
        across, up = np.roll(np.eye(3), -1 - axis, axis=0)[:2]
        if np.cross(across, up) @ normal < 0.0:
            across, up = up, across
        for lift in (0.0,) if axis == 2 else (-0.5, 0.5):
            sides = [half_mm * (0.5 if axis != 2 and way[2] else 1.0) * way for way in (across, up)]
            centre = -half_mm * normal + np.array([0.0, 0.0, lift * half_mm])
            walls.append(Surface(centre, *sides, reflectance, nodes))
    return walls
