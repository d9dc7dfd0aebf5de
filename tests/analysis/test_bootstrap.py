"""Bootstrap: replicas are fits, their spread is the uncertainty, and they cost little."""

from __future__ import annotations

import time

import numpy as np
import pytest

from analysis.bootstrap import bootstrap
from analysis.fit import fit
from analysis.models import MODELS
from analysis.samples import make_samples
from rig.angles import spherical_to_direction
from rig.errors import BadInput

TRUTH = {"kd": [0.2, 0.1], "ks": [0.7, 0.8], "alpha": 0.25, "f0": 0.06}


def paint(count, *, noise=0.01, seed=0, shared=None):
    """Return noisy samples; shared is an error per group of 20 samples."""
    random = np.random.default_rng(seed)
    wi = spherical_to_direction(np.arccos(random.uniform(0.2, 1.0, count)), np.zeros(count))
    wo = spherical_to_direction(
        np.arccos(random.uniform(0.2, 1.0, count)), random.uniform(0.0, 2.0 * np.pi, count)
    )
    f_r = MODELS["ggx"](**TRUTH).evaluate(wi, wo)
    noisy = f_r * (1.0 + noise * random.standard_normal(f_r.shape))
    if shared is not None:
        noisy *= 1.0 + shared * np.repeat(random.standard_normal(count // 20), 20)[:, None]
    return make_samples(wi, wo, noisy, u_noise=noise * f_r)


@pytest.mark.parametrize("loss", ["chi2", "log"])
def test_spread_of_replicas_is_the_uncertainty(loss):
    """Catches replicas that do not move, move too much, or forget the weights."""
    samples = paint(1500)
    if loss == "log":
        # Noise of one size in ln(1 + f cos), and none stated: what that loss is for.
        random, cos_i = np.random.default_rng(3), samples["wi"].to_numpy()[:, 2:]
        exact = MODELS["ggx"](**TRUTH).evaluate(samples["wi"], samples["wo"])
        noisy = np.log1p(exact * cos_i) + 0.002 * random.standard_normal(exact.shape)
        samples = make_samples(samples["wi"], samples["wo"], np.expm1(noisy) / cos_i)
    result = fit(samples, "ggx", loss=loss)
    replicas = bootstrap(result, 600)
    for name, u in replicas.u().items():
        assert replicas.parameters[name].shape == (600, *np.shape(result.parameters[name]))
        ratio = u / result.u[name]
        assert np.all((ratio > 0.8) & (ratio < 1.2)), (name, ratio)
        middle = np.mean(replicas.parameters[name], axis=0)
        assert np.all(np.abs(middle - result.parameters[name]) < 0.3 * result.u[name])


def test_intervals_are_percentiles():
    """Catches swapped ends, or a wrong axis."""
    replicas = bootstrap(fit(paint(400), "ggx"), 200)
    ends = replicas.interval(0.9)
    assert ends["alpha"].shape == (2,)
    assert ends["kd"].shape == (2, 2)
    inside = (replicas.parameters["kd"] > ends["kd"][:, 0]) & (replicas.parameters["kd"] < ends["kd"][:, 1])
    np.testing.assert_allclose(inside.mean(axis=0), 0.9, atol=0.02)


def test_a_replica_is_the_fit_of_its_samples():
    """Catches replicas that end before the bottom, or count samples wrongly."""
    samples = paint(300, noise=0.03)
    result = fit(samples, "ggx")
    random = np.random.default_rng(5)
    drawn = random.multinomial(300, np.full(300, 1.0 / 300.0), size=4)
    replicas = bootstrap(result, 4, seed=5)
    for counts, alpha, kd in zip(drawn, replicas.parameters["alpha"], replicas.parameters["kd"], strict=True):
        again = fit(samples.isel(sample=np.repeat(np.arange(300), counts)), "ggx")
        assert alpha == pytest.approx(float(again.parameters["alpha"]), abs=0.03 * float(result.u["alpha"]))
        assert np.all(np.abs(kd - again.parameters["kd"]) < 0.03 * result.u["kd"])


def test_drawn_by_groups_it_knows_shared_errors():
    """Catches groups that are ignored: an error shared by 20 samples does not average out."""
    result = fit(paint(2000, shared=0.02), "ggx")
    alone = bootstrap(result, 300).u()["kd"]
    together = bootstrap(result, 300, groups=np.repeat(np.arange(100), 20)).u()["kd"]
    assert np.all(together > 2.0 * alone)


def test_groups_that_do_not_fit():
    """Catches groups of another data set, and a spread made from three poses."""
    result = fit(paint(100), "ggx")
    with pytest.raises(BadInput, match="give one number"):
        bootstrap(result, 10, groups=np.arange(99))
    with pytest.raises(BadInput, match="3 groups are too few"):
        bootstrap(result, 10, groups=np.arange(100) % 3)


def test_scales_at_zero_stay_admissible():
    """Catches replicas that cross a bound."""
    wi = spherical_to_direction(np.linspace(0.1, 1.2, 300), np.zeros(300))
    random = np.random.default_rng(1)
    wo = spherical_to_direction(random.uniform(0.0, 1.2, 300), random.uniform(0.0, 6.28, 300))
    f_r = 0.1 + 0.002 * random.standard_normal(300)
    replicas = bootstrap(fit(make_samples(wi, wo, f_r, u_noise=0.002), "blinn-phong"), 100)
    assert np.all(replicas.parameters["ks"] >= 0.0)
    assert np.isfinite(replicas.parameters["exponent"]).all()


def test_replicas_together_cost_a_fraction_of_a_fit_each():
    """Catches replicas that are fitted one by one: a thousand must cost at most 300 fits."""
    samples = paint(1250)
    result = fit(samples, "ggx")
    begin = time.process_time()
    for _ in range(5):
        fit(samples, "ggx")
    one = (time.process_time() - begin) / 5.0
    begin = time.process_time()
    bootstrap(result, 200)
    assert (time.process_time() - begin) * 5.0 < 300.0 * one
