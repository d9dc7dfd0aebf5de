"""Where a search begins: the width read from the data, and points that fill the box."""

from __future__ import annotations

import numpy as np
import pytest

from analysis import starts
from analysis.models import MODELS
from analysis.models.base import Geometry
from analysis.problem import Problem
from analysis.slopes import mean_slope, power_iteration


def _direction(theta, phi):
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


@pytest.fixture(scope="module")
def around():
    """Return pairs of directions about many half vectors; the first 200 look back at the light."""
    random = np.random.default_rng(5)
    theta_h = np.concatenate([np.linspace(0.002, 1.2, 200), np.radians(75.0) * random.random(4000) ** 3])
    theta_d = np.concatenate([np.full(200, 0.02), random.uniform(0.15, 0.6, 4000)])
    half = _direction(theta_h, np.zeros_like(theta_h))
    across = np.tile([0.0, 1.0, 0.0], (len(half), 1))
    turn = random.uniform(0.0, 2.0 * np.pi, len(half))
    side = np.cos(turn)[:, None] * np.cross(across, half) + np.sin(turn)[:, None] * across
    c, s = np.cos(theta_d)[:, None], np.sin(theta_d)[:, None]
    wi, wo = c * half + s * side, c * half - s * side
    lit = (wi[:, 2] > 0.1) & (wo[:, 2] > 0.1)
    return wi[lit], wo[lit]


@pytest.mark.parametrize("looks_back", [True, False])
@pytest.mark.parametrize("width", [0.02, 0.1, 0.4])
def test_width_is_read_from_the_data(around, width, looks_back):
    """Catches a moment of the wrong order or a lost factor: each would miss by a factor of 2 or more."""
    wi, wo = around if looks_back else (around[0][200:], around[1][200:])
    geometry = Geometry(wi, wo)
    for name, parameter, expected in (("beckmann", "m", 1.0), ("ggx", "alpha", 2.0 / 3.0)):
        f_r = MODELS[name](kd=0.1, ks=0.5, **{parameter: width}).evaluate(wi, wo)
        slope = mean_slope(geometry, f_r, np.isfinite(f_r))
        of_slope = next(p.of_slope for p in MODELS[name].PARAMETERS if p.name == parameter)
        assert expected * width / 1.8 < of_slope(slope) < expected * width * 1.8


def test_power_iteration_finds_the_distribution():
    """Catches a kernel or a weight that is wrong: D must come out in shape, masking taken off."""
    theta = np.linspace(0.01, 1.55, 120)
    wi = _direction(theta, np.zeros_like(theta))
    model = MODELS["ggx-separable"](kd=0.0, ks=1.0, alpha=0.5, f0=1.0)
    # Smith's separable G1 counts twice in f towards the light; the eigenvalue problem holds it once.
    a2 = np.square(0.5 * np.tan(theta))
    once = 0.5 * (1.0 + np.sqrt(1.0 + a2))
    found = power_iteration(theta, model.evaluate(wi, wi)[:, 0] * once)
    exact = np.square((1.0 + np.tan(theta) ** 2) / (1.0 + np.tan(theta) ** 2 / 0.25))
    np.testing.assert_allclose((found / found[0])[:90], (exact / exact[0])[:90], rtol=0.05)


def test_nothing_is_read_where_there_is_no_lobe(around):
    """Catches a width made of a diffuse surface's rounding, or of nothing."""
    wi, wo = around
    geometry = Geometry(wi, wo)
    flat = np.full((len(wi), 2), 0.25)
    assert mean_slope(geometry, flat, np.ones_like(flat, dtype=bool)) is None
    assert mean_slope(geometry, flat, np.zeros_like(flat, dtype=bool)) is None


@pytest.mark.parametrize("name", ["ggx-two-lobes", "ggx-anisotropic", "ggx-conductor", "sgd"])
def test_points_fill_the_box_and_hold_the_width(around, name):
    """Catches starts outside the bounds, in a heap, or without the width that the data show."""
    problem = Problem(MODELS[name], Geometry(*around), 1)
    low, high = problem.bounds()
    points = starts.spread(problem, 0.0123)
    assert len(points) == starts.POINTS * len(low)
    assert np.all(points >= low)
    assert np.all(points <= high)
    which = next(i for i, p in enumerate(problem.shapes) if p.of_slope is not None)
    width = problem.shapes[which].coordinate.forward(0.0123)
    assert np.count_nonzero(np.abs(points[:, which] - width) < 1e-9) >= len(points) // starts.EVERY
    without = starts.spread(problem, None)
    share = (without - low) / (high - low)
    assert np.all(np.ptp(share, axis=0) > 0.5)


def test_points_of_one_basin_count_once():
    """Catches a choice that spends all on one basin, found along a shape that does nothing there."""
    pairs = np.tile([[0.0, 0.0, 1.0]], (3, 1))
    problem = Problem(MODELS["ggx-two-lobes"], Geometry(pairs, pairs), 1)
    low, high = problem.bounds()
    share = np.array(
        [[0.5, 0.5, 0.0, 0.5], [0.5, 0.9, 0.0, 0.5], [0.51, 0.5, 0.0, 0.5], [0.1, 0.5, 0.2, 0.5]]
    )
    cost = np.array([1.0, 1.0, 1.1, 2.0])
    assert starts.apart(problem, low + share * (high - low), cost, 5) == [0, 3]


def test_a_plain_of_equal_costs_is_one_basin():
    """Catches starts spent on shapes of a lobe that is not there, each followed to its end."""
    cost = np.array([3.0, 3.0, 3.0, 3.0, 1.0, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0, 2.0])
    points = np.arange(12.0)[:, None]
    assert starts.Grid(points, (12,)).basins(cost) == [4, 11, 0]
