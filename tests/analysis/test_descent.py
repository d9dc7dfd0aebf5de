"""The bounded least-squares search against a library's, and on a bound."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import least_squares

from analysis.descent import Equations, descend, from_residuals


class Found(NamedTuple):
    """One minimum."""

    x: np.ndarray
    cost: float


def rosenbrock(x):
    """Return the residuals of the curved valley."""
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def rosenbrock_slopes(x):
    """Return their derivatives."""
    return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


def search(residual, jacobian, start, bounds, **options):
    """Descend from one start."""
    found = descend(from_residuals(residual, jacobian), np.array([start]), bounds, **options)
    return Found(found.x[0], found.cost[0])


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ((-9.0, -9.0), (9.0, 9.0)),
        ((-9.0, -9.0), (0.5, 9.0)),
        ((-9.0, 1.5), (9.0, 9.0)),
        ((-9.0, -9.0), (9.0, -1.0)),
    ],
)
def test_rosenbrock_in_boxes(low, high):
    """Catches a step that crosses a bound, or a parameter that never leaves one again."""
    bounds = (np.array(low), np.array(high))
    start = np.clip([-1.2, 1.0], *bounds)
    found = search(rosenbrock, rosenbrock_slopes, start, bounds, tolerance=1e-14, most=500)
    reference = least_squares(
        rosenbrock, np.clip(start, bounds[0] + 1e-6, bounds[1] - 1e-6), rosenbrock_slopes, bounds=bounds,
        ftol=1e-14, xtol=1e-14, gtol=1e-14, max_nfev=2000,
    )  # fmt: skip
    assert np.all((found.x >= bounds[0]) & (found.x <= bounds[1]))
    assert found.cost <= reference.cost * (1.0 + 1e-9) + 1e-18
    np.testing.assert_allclose(found.x, reference.x, atol=1e-5)


def test_linear_problems_with_bounds_end_exactly():
    """Catches a scale that should be zero and is left at a small number."""
    random = np.random.default_rng(0)
    matrix, target = random.standard_normal((50, 6)), random.standard_normal(50)
    bounds = (np.zeros(6), np.full(6, np.inf))
    found = search(
        lambda x: matrix @ x - target, lambda _: matrix, np.ones(6), bounds, tolerance=1e-15, most=200
    )
    from scipy.optimize import nnls

    best, _ = nnls(matrix, target)
    assert np.any(best == 0.0)
    np.testing.assert_array_equal(found.x == 0.0, best == 0.0)
    np.testing.assert_allclose(found.x, best, atol=1e-8)


def test_a_parameter_without_effect_stays():
    """Catches a singular matrix where one parameter does nothing."""
    slopes = np.array([[1.0, 0.0], [2.0, 0.0]])
    bounds = (np.full(2, -9.0), np.full(2, 9.0))
    found = search(
        lambda x: slopes @ x - np.array([1.0, 2.0]), lambda _: slopes, np.array([0.0, 3.0]), bounds,
        tolerance=1e-12, most=50,
    )  # fmt: skip
    np.testing.assert_allclose(found.x, [1.0, 3.0], atol=1e-5)


def test_searches_together_end_as_each_alone():
    """Catches a search that takes another's damping, equations or end."""
    bounds = (np.full(2, -9.0), np.array([0.9, 9.0]))
    starts = np.random.default_rng(0).uniform(-5.0, 5.0, (20, 2))
    problem = from_residuals(rosenbrock, rosenbrock_slopes)
    together = descend(problem, starts, bounds, tolerance=1e-14, most=500)
    for start, x, cost in zip(starts, *together, strict=True):
        alone = search(rosenbrock, rosenbrock_slopes, start, bounds, tolerance=1e-14, most=500)
        np.testing.assert_allclose(x, alone.x, atol=1e-6)
        assert cost == pytest.approx(alone.cost, rel=1e-9)


def test_members_know_their_own_problem():
    """Catches equations asked for with another member's number once some searches have ended."""
    targets = np.array([[3.0, 1.0], [-2.0, 0.5], [0.0, 0.0]])
    problems = [
        from_residuals(lambda x, t=t: rosenbrock(x - t), lambda x, t=t: rosenbrock_slopes(x - t))
        for t in targets
    ]

    def linearise(x, members):
        each = [problems[m](x[i : i + 1], members[:1]) for i, m in enumerate(members)]
        return Equations(*(np.concatenate(parts) for parts in zip(*each, strict=True)))

    bounds = (np.full(2, -99.0), np.full(2, 99.0))
    found = descend(linearise, np.zeros((3, 2)), bounds, tolerance=1e-16, most=500)
    np.testing.assert_allclose(found.x, targets + 1.0, atol=1e-6)


def test_large_residuals_do_not_slow_the_search():
    """Catches the loss of the curvature that J^T J leaves out, which alone takes thousands of steps here.

    The curvature is 2 - 2 bend at the solution, 0, and J^T J holds the 2 of it.
    """
    bend, calls = 0.99, []

    def residual(x):
        calls.append(x)
        return np.array([x[0] + 1.0, bend * x[0] ** 2 + x[0] - 1.0])

    def slopes(x):
        return np.array([[1.0], [2.0 * bend * x[0] + 1.0]])

    bounds = (np.full(1, -0.3), np.full(1, 0.3))
    found = search(residual, slopes, np.array([0.2]), bounds, tolerance=1e-15, most=3000)
    np.testing.assert_allclose(found.x, 0.0, atol=1e-6)
    assert len(calls) < 25


def test_parameters_that_make_up_for_one_another_meet_a_bound():
    """Catches a search that stays where it began: both would leave the box together, one of them ought to."""
    matrix = np.linalg.cholesky(np.array([[1.0, -3.0], [-3.0, 9.1]])).T
    wanted = matrix @ np.array([-3.0, -0.9])
    found = search(
        lambda x: matrix @ x - wanted,
        lambda x: matrix,  # noqa: ARG005
        np.array([0.05, 0.094]),
        (np.zeros(2), np.full(2, np.inf)),
        tolerance=1e-14,
        most=50,
    )
    np.testing.assert_allclose(found.x, [0.0, 9.0 / 9.1 - 0.9], atol=1e-9)
