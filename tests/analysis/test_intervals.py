"""Profile intervals: those of a brute-force profile, those of u for a linear model, open where flat."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq, least_squares

from analysis.fit import fit
from analysis.intervals import profile_intervals
from analysis.models import MODELS
from analysis.samples import make_samples
from rig.angles import spherical_to_direction


def pairs(count, seed, theta_i=None):
    """Return random pairs; theta_i fixes the light."""
    random = np.random.default_rng(seed)
    light = np.arccos(random.uniform(0.2, 1.0, count)) if theta_i is None else np.full(count, theta_i)
    wo = np.arccos(random.uniform(0.2, 1.0, count)), random.uniform(0.0, 2.0 * np.pi, count)
    return spherical_to_direction(light, np.zeros(count)), spherical_to_direction(*wo)


def ggx_samples(count, noise, **directions):
    """Return noisy samples of a surface of GGX facets."""
    wi, wo = pairs(count, 2, **directions)
    f_r = MODELS["ggx"](kd=0.2, ks=0.7, alpha=0.25, f0=0.06).evaluate(wi, wo)
    noisy = f_r * (1.0 + noise * np.random.default_rng(0).standard_normal(f_r.shape))
    return make_samples(wi, wo, noisy, u_noise=noise * f_r)


def test_a_linear_model_has_the_interval_of_its_uncertainty():
    """Catches a wrong quantile, and shared errors that the profile does not know of."""
    wi, wo = pairs(200, 0)
    for shared in (0.0, 0.004):
        samples = make_samples(wi, wo, np.full((200, 2), 0.1), u_noise=0.01, u_reference=shared)
        result = fit(samples, "lambert")
        for level, quantile in ((0.95, 1.959964), (0.6826895, 1.0)):
            ends = profile_intervals(result, level)["kd"]
            expected = result.parameters["kd"][:, None] + quantile * result.u["kd"][:, None] * [-1.0, 1.0]
            np.testing.assert_allclose(ends, expected, rtol=1e-5)


def test_against_a_profile_by_brute_force():
    """Catches others that are not fitted anew, and ends that are not where the cost has risen enough."""
    samples = ggx_samples(80, 0.05)
    result = fit(samples, "ggx")
    wi, wo, f_r, u = (samples[name].to_numpy() for name in ("wi", "wo", "f_r", "u_noise"))
    names = ("kd", "ks", "alpha", "f0")
    best = np.array([np.ravel(result.parameters[name])[0] for name in names])

    def cost(held, value):
        free = [i for i in range(4) if i != held]

        def residual(x):
            full = np.empty(4)
            full[held], full[free] = value, x
            model = MODELS["ggx"](**dict(zip(names, full, strict=True)))
            return ((model.evaluate(wi, wo) - f_r) / u).ravel()

        low, high = np.full(3, 1e-9), np.array([np.inf if n in {"kd", "ks"} else 1.0 for n in names])[free]
        found = least_squares(residual, best[free], bounds=(low, high), x_scale=best[free], xtol=1e-12)
        return 2.0 * found.cost

    lowest = cost(0, best[0])
    ends = profile_intervals(result)
    for held in (0, 2, 3):
        spread = np.ravel(result.u[names[held]])[0]
        for side, sign in ((0, -1.0), (1, 1.0)):
            end = brentq(
                lambda x, held=held: cost(held, x) - lowest - 1.959964**2,
                best[held] + 0.3 * sign * spread,
                best[held] + 6.0 * sign * spread,
                xtol=1e-5 * spread,
            )
            assert np.ravel(ends[names[held]])[side] == pytest.approx(end, abs=0.02 * spread)


def test_what_is_not_known_has_open_ends():
    """Catches a symmetric interval about an f0 that normal incidence does not hold."""
    result = fit(ggx_samples(300, 0.01, theta_i=0.0), "ggx")
    ends = profile_intervals(result)
    low, high = ends["f0"]
    value, u = float(result.parameters["f0"]), float(result.u["f0"])
    assert low < 0.06 < high
    if np.isfinite(u):
        assert high - value > 2.0 * (value - low)
    np.testing.assert_allclose(ends["alpha"], result.parameters["alpha"], rtol=0.05)


def test_a_shape_on_its_bound_goes_from_bound_to_bound():
    """Catches an end made from an infinite uncertainty."""
    wi, wo = pairs(400, 3)
    f_r = MODELS["cook-torrance"](kd=0.1, ks=0.8, m=9.0, ior=1.5).evaluate(wi, wo)
    ends = profile_intervals(fit(make_samples(wi, wo, f_r), "cook-torrance"))
    np.testing.assert_allclose(ends["m"], [0.003, 3.0])
    np.testing.assert_allclose(ends["ks"][0], [0.0, np.inf])
