"""Natural-neighbour weights: catches areas that are not Sibson's, on scattered points and on tied grids."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.recipes.natural import natural_weights
from rig.errors import BadInput


def clipped(polygon, normal, offset):
    """Keep the part of a convex polygon where normal . x <= offset."""
    kept = []
    side = polygon @ normal - offset
    for k in range(len(polygon)):
        a, b, sa, sb = polygon[k - 1], polygon[k], side[k - 1], side[k]
        if (sa > 0) != (sb > 0):
            kept.append(a + (b - a) * sa / (sa - sb))
        if sb <= 0:
            kept.append(b)
    return np.array(kept).reshape(-1, 2)


def cell(points, index, box=1e3):
    """Voronoi cell of one point, by cutting a large box with every bisector."""
    polygon = np.array([[-box, -box], [box, -box], [box, box], [-box, box]], dtype=float)
    for other in np.delete(np.arange(len(points)), index):
        normal = points[other] - points[index]
        polygon = clipped(polygon, normal, normal @ (points[other] + points[index]) / 2)
    return polygon


def area(polygon):
    """Area of a polygon in the order of its corners."""
    if len(polygon) < 3:
        return 0.0
    x, y = polygon.T
    return 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def by_definition(points, place):
    """Sibson's weights as he defines them: what the place's cell takes of each cell that was."""
    new = cell(np.vstack([points, place]), len(points))
    taken = []
    for index in range(len(points)):
        part = new
        for other in np.delete(np.arange(len(points)), index):
            normal = points[other] - points[index]
            if len(part):
                part = clipped(part, normal, normal @ (points[other] + points[index]) / 2)
        taken.append(area(part))
    return np.array(taken) / sum(taken)


GRID = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("kind", ["scattered", "grid"])
def test_weights_are_the_areas_that_define_them(kind):
    """Catches a wrong or missing piece of any cell's area."""
    random = np.random.default_rng(5)
    if kind == "scattered":
        points = random.random((25, 2))
        corners = points[random.integers(0, 25, (12, 3))]
        places = (corners * random.dirichlet(np.ones(3), 12)[:, :, None]).sum(axis=1)
    else:
        points = GRID
        # In cells, on their edges and diagonals, where triangulations tie.
        places = np.array([[1.3, 1.7], [2.5, 1.5], [2.0, 1.25], [1.25, 2.0], [0.5, 0.5], [3.9, 2.1]])
    weights = natural_weights(points, places).toarray()
    for place, row in zip(places, weights, strict=True):
        np.testing.assert_allclose(row, by_definition(points, place), atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(4, 60),
    st.sampled_from(["scattered", "on a grid", "in rows"]),
)
def test_any_points(seed, count, kind):
    """Catches negative weights, sums off 1, and linear functions that are not kept."""
    random = np.random.default_rng(seed)
    points = random.random((count, 2))
    if kind == "on a grid":
        points = np.round(points * 5)
    elif kind == "in rows":
        points[:, 1] = np.round(points[:, 1] * 3)
    places = np.concatenate([random.random((20, 2)) * np.ptp(points, axis=0) + points.min(axis=0), points])
    if np.linalg.matrix_rank(points - points[0], tol=1e-6) < 2:
        with pytest.raises(BadInput, match="line"):
            natural_weights(points, places)
        return
    weights = natural_weights(points, places).toarray()
    total = weights.sum(axis=1)
    inside = total > 0
    assert inside[20:].all()
    assert weights.min() >= 0
    np.testing.assert_allclose(total[inside], 1.0, atol=1e-9)
    np.testing.assert_allclose((weights @ points)[inside], places[inside], atol=1e-6)


def test_samples_keep_their_value_and_outside_is_nothing():
    """Catches smoothing at the samples, extrapolation, and repeated samples that count twice."""
    values = np.arange(20.0) ** 2
    np.testing.assert_allclose(natural_weights(GRID, GRID) @ values, values, atol=1e-12)
    assert natural_weights(GRID, np.array([[-0.01, 1.0], [9.0, 9.0]])).nnz == 0
    doubled = natural_weights(np.vstack([GRID, GRID[:1]]), GRID[:1]).toarray()[0]
    assert doubled[0] == doubled[-1] == 0.5
    on_edge = natural_weights(GRID, np.array([[0.25, 0.0]])).toarray()[0]
    np.testing.assert_allclose(on_edge[:2], [0.75, 0.25], atol=1e-12)


def test_points_on_a_line_are_refused():
    """Catches a traceback of the triangulation."""
    for points in (np.zeros((0, 2)), np.zeros((5, 2)), np.stack([np.arange(6.0)] * 2, axis=-1)):
        with pytest.raises(BadInput, match="line"):
            natural_weights(points, np.zeros((1, 2)))
