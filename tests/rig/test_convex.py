"""Distances of convex solids: a wrong distance, or a bound that does not hold.

The other code is a quadratic programme: the least distance of weighted corners, solved by scipy.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from rig.angles import FloatArray, rotation
from rig.convex import Beams, Question, Solids, distances, rod_distances

CIRCLE = 240
"""Corners that stand for a disc: at most R (1 - cos(pi / n)) inside it."""


def solids(seed: int, count: int) -> Solids:
    """Draw boxes, cylinders, capsules, spheres, and boxes with round edges, anywhere."""
    random = np.random.default_rng(seed)
    kind = random.integers(0, 5, count)
    half = random.uniform(0.5, 60.0, (count, 3)) * np.isin(kind, (0, 4))[:, None]
    half[:, 2] += random.uniform(0.5, 150.0, count) * np.isin(kind, (1, 2))
    disc = random.uniform(1.0, 60.0, count) * np.isin(kind, (1, 4))
    ball = random.uniform(1.0, 40.0, count) * np.isin(kind, (2, 3, 4))
    turn = rotation(random.normal(size=(count, 3)), random.uniform(-3.0, 3.0, count))
    return Solids(half, disc, ball, turn, random.normal(size=(count, 3)) * 120.0)


def corners(batch: Solids, row: int) -> FloatArray:
    """Corners whose hull is the solid without its ball, all but the arc between the corners of its disc."""
    angles = np.linspace(0.0, 2.0 * np.pi, CIRCLE, endpoint=False)
    circle = batch.disc_mm[row] * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    points = np.unique((signs * batch.half_mm[row])[:, None] + circle, axis=0).reshape(-1, 3)
    return np.asarray(batch.centre_mm[row] + points @ batch.turn[row].T)


def apart(a: FloatArray, b: FloatArray) -> float:
    """Distance of two hulls of corners, by non-negative least squares.

    The sums of the weights are held to 1 by two equations that weigh a lot.
    """
    heavy = 1e5
    sums = np.block(
        [
            [np.full((1, len(a)), heavy), np.zeros((1, len(b)))],
            [np.zeros((1, len(a))), np.full((1, len(b)), heavy)],
        ]
    )
    weights, _ = nnls(np.vstack([np.hstack([a.T, -b.T]), sums]), np.array([0.0, 0.0, 0.0, heavy, heavy]))
    first, second = weights[: len(a)], weights[len(a) :]
    return float(np.linalg.norm(first @ a / first.sum() - second @ b / second.sum()))


@pytest.mark.parametrize("seed", range(3))
def test_distances_are_those_of_other_code(seed: int) -> None:
    """Catches a search that ends too early, or a support function of another solid."""
    a, b = solids(2 * seed, 40), solids(2 * seed + 1, 40)
    found = distances(a, b)
    balls = a.ball_mm + b.ball_mm
    known = np.array([apart(corners(a, row), corners(b, row)) for row in range(40)])
    arc = (a.disc_mm + b.disc_mm) * (1.0 - np.cos(np.pi / CIRCLE))
    assert np.all(found.upper_mm <= known - balls + 1e-3)
    assert np.all(found.lower_mm >= known - balls - arc - 1e-3)


def test_bounds_meet_and_are_proved() -> None:
    """Catches a lower bound without its plane or an upper one without its points, over many random solids."""
    a, b = solids(10, 5000), solids(11, 5000)
    found = distances(a, b)
    assert np.all(found.upper_mm - found.lower_mm <= 2e-5)
    core = found.upper_mm + a.ball_mm + b.ball_mm
    between = found.points_mm[:, 1] - found.points_mm[:, 0]
    np.testing.assert_allclose(np.linalg.norm(between, axis=1), core, atol=1e-9)
    rows = np.flatnonzero(core > 1.0)
    direction = between[rows]
    gap = np.sum(direction * (b.support(rows, -direction) - a.support(rows, direction)), axis=1) / core[rows]
    np.testing.assert_allclose(gap, core[rows], atol=1e-3)
    for batch, point in ((a, found.points_mm[:, 0]), (b, found.points_mm[:, 1])):
        own = np.einsum("kij,ki->kj", batch.turn, point - batch.centre_mm)
        outside = np.maximum(np.abs(own) - batch.half_mm, 0.0)
        assert np.all(outside[rows, 2] < 1e-6)
        assert np.all(np.hypot(outside[rows, 0], outside[rows, 1]) < batch.disc_mm[rows] + 1e-6)


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 1000),
    axis=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda axis: np.linalg.norm(axis) > 0.1),
    angle=st.floats(-3.0, 3.0),
    shift=st.tuples(*[st.floats(-500.0, 500.0)] * 3),
)
def test_turning_and_shifting_both_changes_nothing(
    seed: int, axis: tuple[float, ...], angle: float, shift: tuple[float, ...]
) -> None:
    """Catches a distance that depends on where the machine stands."""
    turn, shift_mm = rotation(axis, angle), np.array(shift)

    def moved(batch: Solids) -> Solids:
        centre = batch.centre_mm @ turn.T + shift_mm
        return Solids(batch.half_mm, batch.disc_mm, batch.ball_mm, turn @ batch.turn, centre)

    a, b = solids(seed, 30), solids(seed + 5000, 30)
    before, after = distances(a, b), distances(moved(a), moved(b))
    np.testing.assert_allclose(after.upper_mm, before.upper_mm, atol=3e-5)


def test_a_question_ends_the_search_with_its_answer() -> None:
    """Catches a pair that is called clear, or near, and is not."""
    a, b = solids(20, 3000), solids(21, 3000)
    exact = distances(a, b).upper_mm
    near, clear = np.full(3000, 10.0), np.full(3000, 60.0)
    found = distances(a, b, Question(near, clear))
    assert np.all(found.lower_mm <= exact + 1e-5)
    assert np.all(found.upper_mm >= exact - 3e-5)
    decided = (found.lower_mm >= clear) | (found.upper_mm < near)
    decided |= (found.lower_mm >= near) & (found.upper_mm < clear)
    assert np.all(decided | (found.upper_mm - found.lower_mm < 2e-5))


def test_rods_are_solids_without_a_search() -> None:
    """Catches the closed form of two lines, parallel and crossing ones among them."""
    random = np.random.default_rng(3)
    centre_a, half_a, centre_b, half_b = random.normal(size=(4, 4000, 3)) * 50.0
    half_b[:1000] = half_a[:1000] * random.uniform(-2.0, 2.0, (1000, 1))
    half_a[1000:1100] = 0.0
    half_b[1050:1150] = 0.0
    centre_b[1200:1300] = centre_a[1200:1300]
    half_b[1300:1600] = half_a[1300:1600] + random.normal(size=(300, 3)) * 1e-5
    known = [
        apart(np.stack([ca - ha, ca + ha]), np.stack([cb - hb, cb + hb]))
        for ca, ha, cb, hb in zip(
            centre_a[::7], half_a[::7], centre_b[::7], half_b[::7], strict=True
        )
    ]  # fmt: skip
    np.testing.assert_allclose(rod_distances(centre_a, half_a, centre_b, half_b)[::7], known, atol=2e-3)


def test_a_beam_is_the_hull_of_its_discs() -> None:
    """Catches a beam that is only a rod, or whose discs face elsewhere."""
    ends = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 500.0]]])
    normals = np.array([[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]])
    beam = Beams(ends, normals, np.array([25.0, 5.0]))
    for height, edge in ((0.0, 25.0), (250.0, 15.0), (500.0, 5.0)):
        place = np.array([[edge + 3.0, 0.0, height]])
        point = Solids(np.zeros((1, 3)), np.zeros(1), np.zeros(1), np.eye(3)[None], place)
        slope = np.hypot(1.0, 20.0 / 500.0)
        expected = 3.0 / slope if 0.0 < height < 500.0 else 3.0
        assert distances(beam, point).upper_mm[0] == pytest.approx(expected, rel=2e-3)


def test_a_beam_on_its_axis_is_not_thickened_by_rounding() -> None:
    """Catches a rim that rounding puts out of its disc's plane: the stage would shade its own sample."""
    random = np.random.default_rng(0)
    turns = rotation([0.0, 0.0, 1.0], random.uniform(-3.0, 3.0, 500))
    upright = turns[:, :, 2]  # along z but for rounding
    normals = np.stack([upright, upright], axis=1)
    ends = np.tile([[0.0, 0.0, 0.5], [0.0, 0.0, 500.0]], (500, 1, 1))
    stage = Solids(
        np.tile([0.0, 0.0, 15.0], (500, 1)),
        np.full(500, 30.0),
        np.zeros(500),
        turns,
        np.tile([0.0, 0.0, -15.0], (500, 1)),
    )
    beams = Beams(ends, normals, np.array([25.0, 2.5]))
    np.testing.assert_allclose(distances(beams, stage).lower_mm, 0.5, atol=1e-4)
