"""The equations of the fit for every registered model: slopes of both terms, and parameters found again."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.descent import descend
from analysis.equations import Linearised
from analysis.fit import fit
from analysis.jacobian import search_jacobian
from analysis.losses import make_loss
from analysis.models import FITTED_MODELS, MODELS
from analysis.models.base import Geometry, Kind
from analysis.problem import Problem
from analysis.samples import make_samples
from analysis.solver import evaluate_near, minimise
from rig.angles import spherical_to_direction

SCALES = {"kd": [0.1, 0.2, 0.3], "ks": [0.5, 0.3, 0.4]}


def pairs(count, seed=0):
    """Return pairs of directions around the mirror direction, a third of them anywhere, at any azimuth."""
    random = np.random.default_rng(seed)
    theta_i = np.radians(random.uniform(3.0, 78.0, count))
    spread = np.where(np.arange(count) % 3 == 0, 0.6, 0.12)
    theta_o = np.clip(np.abs(theta_i + spread * random.standard_normal(count)), 0.0, np.radians(82.0))
    phi_i = random.uniform(-np.pi, np.pi, count)
    phi_o = phi_i + np.pi + 2.0 * spread * random.standard_normal(count)
    return spherical_to_direction(theta_i, phi_i), spherical_to_direction(theta_o, phi_o)


def truth_of(model):
    """Return parameters of a model: its default shapes, and scales that differ by channel."""
    return {p.name: p.default if p.kind is Kind.SHAPE else SCALES[p.name] for p in model.PARAMETERS}


def drawn_problem(name, *, seed=1, count=80):
    """Return a problem, data that its model does not quite meet, and a point of the search."""
    model, random = MODELS[name], np.random.default_rng(seed)
    wi, wo = pairs(count)
    problem = Problem(model, Geometry(wi, wo), 3)
    f_r = model(**truth_of(model)).evaluate(wi, wo) * (1.0 + 0.1 * random.standard_normal((count, 3)))
    shapes = np.array([p.coordinate.forward(p.default) for p in problem.shapes])
    shapes = np.clip(shapes + 0.05 * random.standard_normal(len(shapes)), *problem.bounds())
    return problem, (f_r, np.ones(f_r.shape, dtype=bool), wi[:, 2:], 0.01 + 0.05 * f_r), shapes


def slopes_of(cost, x, step=1e-5):
    """Differentiate a function of rows (M, P) at one point, to the fourth order."""
    moves = step * np.eye(len(x))
    near, far = (cost(x + k * moves) - cost(x - k * moves) for k in (1, 2))
    return (8.0 * near - far) / (12.0 * step)


def test_every_registered_model_can_be_fitted():
    """Catches a model that is evaluated and never fitted."""
    assert set(FITTED_MODELS) == set(MODELS)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("loss", ["l2", "log"])
def test_exact_samples_of_every_model_give_its_parameters_back(name, loss):
    """Catches a term whose slopes the equations forget, and a diffuse term taken for Lambert's."""
    model, truth = MODELS[name], truth_of(MODELS[name])
    wi, wo = pairs(500)
    result = fit(make_samples(wi, wo, model(**truth).evaluate(wi, wo)), name, loss=loss)
    assert result.metrics["rms_log"] < 1e-9
    if "axis_rad" in truth and abs(float(result.parameters["axis_rad"])) > 1.0:
        # The same surface turned by a quarter: its widths along and across have changed places.
        along, across = (p.name for p in model.PARAMETERS if p.name.endswith(("_x", "_y")))
        truth |= {along: truth[across], across: truth[along]}
        truth["axis_rad"] = float(result.parameters["axis_rad"]) - np.copysign(
            0.5 * np.pi, result.parameters["axis_rad"]
        )
        assert truth.pop("axis_rad") == pytest.approx(0.0, abs=1e-5)
    for parameter, value in truth.items():
        np.testing.assert_allclose(result.parameters[parameter], value, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_the_gradient_is_that_of_the_cost(name):
    """Catches a slope of either term that is missing, doubled, or of another coordinate."""
    problem, data, shapes = drawn_problem(name)
    alone = np.zeros(1, dtype=np.intp)
    linear = Linearised(problem, make_loss("chi2", *data).by_channel())
    if len(shapes):
        found = linear.shapes_alone(shapes[None], alone)
        numeric = slopes_of(lambda x: linear.shapes_alone(x, alone).cost, shapes)
        np.testing.assert_allclose(found.gradient[0], numeric, rtol=1e-5, atol=1e-6 * found.cost[0])
    whole = Linearised(problem, make_loss("log", *data[:3], None).by_channel())
    kd, ks = whole.linear_scales(problem.terms(shapes[None]))
    s = ks * whole.size(problem.terms(shapes[None]).lobe)
    x = np.concatenate([shapes, 1.05 * kd[0], 0.95 * s[0]])
    found = whole.all_parameters(x[None], alone)
    numeric = slopes_of(lambda y: whole.all_parameters(y, alone).cost, x)
    np.testing.assert_allclose(found.gradient[0], numeric, rtol=1e-5, atol=1e-6 * found.cost[0])


@pytest.mark.parametrize("name", ["oren-nayar", "ashikhmin-shirley", "ggx", "ggx-two-lobes"])
def test_normal_equations_are_those_of_the_whole_jacobian(name):
    """Catches products of basis functions put together wrongly: J^T J formed outright decides."""
    problem, data, shapes = drawn_problem(name)
    goal = make_loss("log", *data[:3], None)
    whole = Linearised(problem, goal.by_channel())
    terms = problem.terms(shapes[None])
    kd, ks = whole.linear_scales(terms)
    derivative = search_jacobian(problem, goal.weight(), shapes, kd[0], ks[0])
    columns = (goal.slope(derivative.f)[..., None] * derivative.columns).reshape(
        -1, derivative.columns.shape[-1]
    )
    x = np.concatenate([shapes, kd[0], ks[0] * whole.size(terms.lobe)[0]])
    found = whole.all_parameters(x[None], np.zeros(1, dtype=np.intp)).normal[0]
    size = columns.shape[1]
    np.testing.assert_allclose(found[:size, :size], columns.T @ columns, rtol=1e-9, atol=1e-12)


def test_a_line_across_a_minimum_is_not_lifted():
    """Catches costs that secants leave too high, so that a minimum across a ridge is not seen."""
    problem, (f_r, used, cos_i, _), _ = drawn_problem("torrance-sparrow-gauss")
    loss = make_loss("log", f_r * np.linspace(1.0, 2.0, len(f_r))[:, None], used, cos_i, None)
    best = minimise(problem, loss)
    equations = Linearised(problem, loss.by_channel())
    points = best.shapes + np.array([[0.0, 0.0], [0.0, 0.1], [0.0, -0.1]])
    low = np.hstack([points, np.zeros((3, 6))])
    high = np.hstack([points, np.full((3, 6), np.inf)])
    size = equations.size(problem.terms(points).lobe)
    start = np.hstack([points, np.tile(best.kd, (3, 1)), best.ks * size])
    true = descend(equations.all_parameters, start, (low, high), tolerance=1e-12, most=100).cost
    found = np.array([each.cost for each in evaluate_near(equations, points, best)])
    np.testing.assert_allclose(found, true, rtol=1e-4)
    assert found[0] == pytest.approx(best.cost, rel=1e-6)
