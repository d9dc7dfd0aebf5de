"""The instrument in the fit: exact nodes, the lobe behind the blur, and no cost where it is not seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.bootstrap import bootstrap
from analysis.fit import fit
from analysis.identifiability import Kind
from analysis.instrument import Gain, Instrument, Seen, Spread, around, disc_nodes, instrument_of
from analysis.intervals import profile_intervals
from analysis.models import MODELS
from analysis.models.base import Geometry
from analysis.problem import Problem
from analysis.resolution import TOLERATED, second_moment
from analysis.samples import make_samples
from rig.angles import spherical_to_direction

TRUTH = {"kd": [0.2, 0.1], "ks": [0.9, 0.8], "f0": 0.05}


def solid_angle_sr(radius_rad):
    """Return the solid angle of a cap."""
    return 4.0 * np.pi * np.sin(0.5 * radius_rad) ** 2


def around_the_mirror(count, width, seed=0):
    """Return pairs of directions, half of them within a few widths of the mirror direction."""
    random = np.random.default_rng(seed)
    theta_i = np.radians(random.uniform(5.0, 65.0, count))
    spread = np.where(np.arange(count) % 2 == 0, 3.0 * width, 0.6)
    theta_o = np.clip(np.abs(theta_i + spread * random.standard_normal(count)), 0.0, np.radians(75.0))
    wi = spherical_to_direction(theta_i, np.full(count, np.pi))
    return wi, spherical_to_direction(theta_o, spread * random.standard_normal(count))


def blurred(alpha, discs, *, count=500, noise=0.01, seed=0, order=5, **columns):
    """Return what an instrument with two discs measures of a surface of GGX facets."""
    wi, wo = around_the_mirror(count, max(alpha, discs.source_rad + discs.receiver_rad), seed)
    everywhere = Spread(discs, wi, wo, np.ones(count, dtype=bool), order)
    f_r = Seen(MODELS["ggx"](alpha=alpha, **TRUTH), everywhere).evaluate(wi, wo)
    noisy = f_r * (1.0 + noise * np.random.default_rng(seed).standard_normal(f_r.shape))
    return make_samples(
        wi, wo, noisy, u_noise=noise * f_r, source_solid_angle_sr=solid_angle_sr(discs.source_rad),
        receiver_solid_angle_sr=solid_angle_sr(discs.receiver_rad), **columns,
    )  # fmt: skip


@pytest.mark.parametrize("order", [1, 2, 3])
def test_nodes_are_exact_to_their_degree(order):
    """Catches a wrong weight or radius: means of all monomials over the disc, in closed form."""
    from math import factorial

    nodes, weights = disc_nodes(order)
    assert weights.sum() == pytest.approx(1.0, rel=1e-14)
    for p in range(4 * order):
        for q in range(4 * order - p):
            exact = 0.0
            if p % 2 == 0 and q % 2 == 0:
                half = (p + q) // 2
                ring = (
                    factorial(p)
                    * factorial(q)
                    / (factorial(p // 2) * factorial(q // 2) * 4**half * factorial(half))
                )
                exact = ring / (half + 1)
            assert weights @ (nodes[:, 0] ** p * nodes[:, 1] ** q) == pytest.approx(exact, abs=1e-14)


def test_caps_have_their_solid_angle():
    """Catches a projection that does not keep areas, and directions that are not unit vectors."""
    axis = spherical_to_direction(np.array([0.0, 0.7, 1.5]), np.array([0.0, 2.0, -1.0]))
    directions, weights = around(axis, 0.3, 4)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, rtol=1e-14)
    cosines = np.einsum("kni,ni->kn", directions, axis)
    assert cosines.min() >= np.cos(0.3)
    # Means over a cap: of the cosine (1 + cos a)/2, of the direction that along the axis.
    np.testing.assert_allclose(weights @ cosines, 0.5 * (1.0 + np.cos(0.3)), rtol=1e-13)
    np.testing.assert_allclose(
        np.einsum("k,kni->ni", weights, directions), 0.5 * (1.0 + np.cos(0.3)) * axis, atol=1e-12
    )


def test_the_mean_is_that_of_a_dense_quadrature():
    """Catches a disc that is forgotten, a cosine that is, and an order that promises too much."""
    discs, (wi, wo) = Instrument(0.02, 0.015), around_the_mirror(60, 0.05)
    model, errors = MODELS["ggx"](alpha=0.05, **TRUTH), []
    random = np.random.default_rng(1)
    lights, cameras = (
        around(axis, radius, 9)[0] for axis, radius in ((wi, discs.source_rad), (wo, discs.receiver_rad))
    )
    weights = np.outer(disc_nodes(9)[1], disc_nodes(9)[1])
    picked = random.integers(0, 60, 12)
    dense = []
    for i in picked:
        first, second = np.meshgrid(np.arange(len(lights)), np.arange(len(cameras)), indexing="ij")
        light, camera = lights[first.ravel(), i], cameras[second.ravel(), i]
        weight = weights.ravel() * light[:, 2] * camera[:, 2]
        dense.append(weight @ model.evaluate(light, camera) / weight.sum())
    for order in (1, 2, 3):
        every = np.ones(60, dtype=bool)
        found = Seen(model, Spread(discs, wi, wo, every, order)).evaluate(wi, wo)[picked]
        errors.append(np.max(np.abs(found / dense - 1.0)))
    assert errors[0] < 1e-2
    assert errors[1] < 1e-4
    assert errors[2] < 1e-5


@pytest.mark.parametrize(
    ("alpha", "radii"), [(0.02, (0.02, 0.015)), (0.05, (0.03, 0.0)), (0.03, (0.0, 0.03))]
)
def test_the_lobe_behind_the_instrument_is_found(alpha, radii):
    """Catches a fit that takes the instrument's width for the surface's: with the discs no bias."""
    samples = blurred(alpha, Instrument(*radii), count=300, order=4)
    plain, whole = (fit(samples, "ggx", instrument=on) for on in (False, True))
    assert plain.parameters["alpha"] - alpha > 10.0 * plain.u["alpha"]
    for name, truth in (TRUTH | {"alpha": alpha}).items():
        assert np.all(np.abs(whole.parameters[name] - truth) < 4.0 * whole.u[name]), name
    assert whole.u["alpha"] < 0.01 * alpha
    assert plain.metrics["chi2_dof"] > 3.0
    assert whole.metrics["chi2_dof"] == pytest.approx(1.0, abs=0.2)
    assert whole.cautions == ()


def test_pulls_behind_the_instrument_are_what_u_says():
    """Catches a Jacobian, and so a u, of the lobe without the instrument."""
    pulls = []
    for seed in range(6):
        result = fit(blurred(0.08, Instrument(0.03, 0.03), seed=seed, count=150, order=2, noise=0.03), "ggx")
        truth = TRUTH | {"alpha": 0.08}
        pulls.append(
            np.concatenate([np.ravel((result.parameters[n] - truth[n]) / result.u[n]) for n in truth])
        )
    assert 0.75 < np.sqrt(np.mean(np.square(pulls))) < 1.25


def test_intervals_and_replicas_are_of_the_same_problem():
    """Catches intervals or replicas that forget the instrument and drift to the wider lobe."""
    result = fit(blurred(0.03, Instrument(0.02, 0.0), count=200), "ggx")
    low, high = profile_intervals(result, scales=False)["alpha"]
    assert high - low == pytest.approx(2.0 * 1.96 * float(result.u["alpha"]), rel=0.1)
    replicas = bootstrap(result, 40)
    assert replicas.u()["alpha"] == pytest.approx(float(result.u["alpha"]), rel=0.4)
    assert np.mean(replicas.parameters["alpha"]) == pytest.approx(
        float(result.parameters["alpha"]), abs=float(result.u["alpha"])
    )


def test_a_wide_lobe_needs_no_instrument():
    """Catches a mean that is taken where it changes nothing, or left out where it moves a parameter."""
    samples = blurred(0.4, Instrument(0.004, 0.004), count=300, order=2)
    result = fit(samples, "ggx")
    assert result.state.problem.spread is None
    plain = fit(samples, "ggx", instrument=False)
    np.testing.assert_array_equal(result.covariance, plain.covariance)
    # What was skipped, taken everywhere after all, moves no parameter by the tolerance.
    state, every = result.state, np.ones(result.count // 2, dtype=bool)
    geometry = state.problem.geometry
    spread = Spread(Instrument(0.004, 0.004), geometry.wi, geometry.wo, every, 2)
    forced = replace(state.problem, spread=spread)
    solution = state.solution
    terms = forced.terms(solution.shapes[None])
    change = state.loss.residual(
        terms.values(solution.kd[None], solution.ks[None])[0].T
    ) - state.loss.residual(
        state.problem.terms(solution.shapes[None]).values(solution.kd[None], solution.ks[None])[0].T
    )
    assert np.sqrt(np.sum(np.square(change))) < TOLERATED
    estimate = second_moment(state.problem, state.loss, solution, Instrument(0.004, 0.004))
    np.testing.assert_allclose(estimate, change, atol=0.02 * np.abs(change).max())


def test_a_wide_lobe_is_raised_and_not_averaged(monkeypatch):
    """Catches a gain that does not settle, or another answer than that of the mean inside the fit."""
    samples = blurred(0.2, Instrument(0.01, 0.008), noise=0.002)
    raised = fit(samples, "ggx")
    assert isinstance(raised.state.problem.spread, Gain)
    monkeypatch.setattr("analysis.resolution.MILD", 0.0)
    averaged = fit(samples, "ggx")
    assert isinstance(averaged.state.problem.spread, Spread)
    plain = fit(samples, "ggx", instrument=False)
    assert abs(plain.parameters["alpha"] - averaged.parameters["alpha"]) > 2.0 * averaged.u["alpha"]
    for name, u in averaged.u.items():
        assert np.all(np.abs(raised.parameters[name] - averaged.parameters[name]) < 2.0 * TOLERATED * u), name
        np.testing.assert_allclose(raised.u[name], u, rtol=0.02)


def test_a_gain_leaves_out_its_square_at_most():
    """Catches a bound on what is left out that does not hold, and light at an underflow."""
    discs, (wi, wo) = Instrument(0.02, 0.015), around_the_mirror(300, 0.1)
    model, geometry = (
        MODELS["ggx"](alpha=np.array([0.1]), f0=np.array([0.05]), kd=0.2, ks=0.9),
        Geometry(wi, wo),
    )
    terms = model.terms_at(geometry)
    gain = Gain.of(model, geometry, discs)
    exact = Spread(discs, wi, wo, np.ones(300, dtype=bool), 4).average(model, terms)["ks"].value
    error = np.abs(gain.average(model, terms)["ks"].value / exact - 1.0)
    assert np.max(np.abs(gain.share["ks"])) > 1e-2
    assert np.max(error) < 3.0 * np.max(np.square(gain.share["ks"]))
    assert np.all(np.isfinite(gain.share["kd"]))
    np.testing.assert_allclose(gain.share["kd"], 0.0, atol=1e-14)


def test_a_lobe_lost_in_the_instrument_is_said_so():
    """Catches a width of a tenth of the aperture's with a small uncertainty."""
    result = fit(blurred(0.003, Instrument(0.03, 0.0), count=200, order=12), "ggx")
    assert {c.kind for c in result.cautions} & {Kind.NARROW_LOBE, Kind.AT_BOUND}
    assert np.isinf(result.u["alpha"])


def test_solid_angles_become_radii():
    """Catches a small-angle formula, and an instrument invented where nothing is stated."""
    wi, wo = around_the_mirror(3, 0.1)
    assert instrument_of(make_samples(wi, wo, np.ones(3))) is None
    samples = make_samples(wi, wo, np.ones(3), source_solid_angle_sr=solid_angle_sr(0.4))
    found = instrument_of(samples)
    assert found.source_rad == pytest.approx(0.4, rel=1e-12)
    assert found.receiver_rad == 0.0


def test_some_of_a_problem_keeps_its_instrument():
    """Catches samples that lose their mean when a fold is left out."""
    wi, wo = around_the_mirror(20, 0.05)
    rows = np.arange(20) % 2 == 0
    spread = Spread(Instrument(0.02, 0.02), wi, wo, rows, 1)
    problem = Problem(MODELS["ggx"], Geometry(wi, wo), 1, spread)
    shapes, few = np.log([[0.03, 0.05]]), np.array([0, 3, 8])
    shapes[0, 1] = problem.shapes[1].coordinate.forward(0.05)
    np.testing.assert_allclose(
        problem.some(few).terms(shapes).lobe, problem.terms(shapes).lobe[:, few], rtol=1e-13
    )


def test_errors_of_joints_are_those_of_the_lobe_as_it_is_seen():
    """Catches the gradient of the bare lobe, steeper than what the camera saw, in the weights and in u."""
    count, step = 200, 1e-4
    wi, wo = around_the_mirror(count, 0.05)
    tangent = np.stack([wo[:, 2], np.zeros(count), -wo[:, 0]], axis=1)
    joints = {
        "pose": np.arange(count) // 10, "d_wi": np.zeros((count, 1, 3)), "d_wo": tangent[:, None, :],
        "u_joint_rad": [np.radians(0.1)],
    }  # fmt: skip
    samples = blurred(0.02, Instrument(0.03, 0.0), count=count, order=4, **joints)
    result = fit(samples, "ggx")
    assert result.state.problem.spread is not None
    assert result.parameters["alpha"] == pytest.approx(0.02, abs=4.0 * float(result.u["alpha"]))
    assert result.u["alpha"] > 1.5 * fit(samples.drop_vars("pose"), "ggx").u["alpha"]
    from analysis.uncertainty import directional_slope

    seen = Seen(result.model, result.state.problem.spread)
    moved = [
        seen.evaluate(wi, (wo + s * tangent) / np.linalg.norm(wo + s * tangent, axis=1)[:, None])
        for s in (step, -step)
    ]
    slope = directional_slope(seen, wi, wo, np.zeros((count, 3)), tangent)
    np.testing.assert_allclose(slope, (moved[0] - moved[1]) / (2.0 * step), atol=1e-3 * np.abs(slope).max())
    assert (
        np.abs(slope).max()
        < 0.8 * np.abs(directional_slope(result.model, wi, wo, np.zeros((count, 3)), tangent)).max()
    )
