"""The robust fit: gross errors do not move it, clean data lose little, and what was set aside is said."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.fit import fit
from analysis.identifiability import Kind
from analysis.models import MODELS
from analysis.robust import BIWEIGHT, beyond_given_weights, scatter_of
from analysis.samples import make_samples
from rig.angles import spherical_to_direction

TRUTH = {"kd": [0.2, 0.1, 0.05], "ks": [0.7, 0.8, 0.6], "alpha": 0.15, "f0": 0.06}


def paint(count=900, *, seed=0, stated=True, noise=0.01):
    """Return noisy samples of a glossy paint."""
    random = np.random.default_rng(seed)
    wi = spherical_to_direction(np.arccos(random.uniform(0.2, 1.0, count)), np.zeros(count))
    wo = spherical_to_direction(
        np.arccos(random.uniform(0.2, 1.0, count)), random.uniform(0.0, 2.0 * np.pi, count)
    )
    f_r = MODELS["ggx"](**TRUTH).evaluate(wi, wo)
    normal = noise * random.standard_normal(f_r.shape)
    if stated:
        return make_samples(wi, wo, f_r * (1.0 + normal), u_noise=noise * f_r)
    # Noise of one size in ln(1 + f cos): what is fitted where no uncertainty is stated.
    return make_samples(wi, wo, np.expm1(np.log1p(f_r * wi[:, 2:]) + 0.2 * normal) / wi[:, 2:])


def spoiled(samples, kind, share=0.05, seed=1):
    """Return the samples with gross errors in a share of the data."""
    random = np.random.default_rng(seed)
    f_r = samples["f_r"].to_numpy().copy()
    bad = random.random(f_r.shape) < share
    match kind:
        case "glints":
            f_r[bad] = f_r[bad] * random.uniform(3.0, 100.0, bad.sum())
        case "lamp off":
            f_r[bad] = 0.0
        case "dust":
            f_r[bad] += random.choice([-0.5, 2.0], bad.sum())
    return samples.assign(f_r=(samples["f_r"].dims, f_r)), bad


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("kind", ["glints", "lamp off", "dust"])
def test_gross_errors_do_not_move_the_parameters(kind, stated):
    """Catches a fit that follows one datum in twenty: parameters may move by their u, not by more."""
    clean = paint(stated=stated)
    samples, bad = spoiled(clean, kind)
    reference, plain, robust = (
        fit(s, "ggx", loss=loss) for s, loss in ((clean, None), (samples, None), (samples, "robust"))
    )
    moved = {
        name: np.abs(robust.parameters[name] - value) / reference.u[name]
        for name, value in reference.parameters.items()
    }
    assert all(np.all(shift < 1.0) for shift in moved.values()), moved
    assert any(
        np.any(np.abs(plain.parameters[name] - value) > 3.0 * reference.u[name])
        for name, value in reference.parameters.items()
    )
    for name, u in robust.u.items():
        assert np.all((u > 0.9 * reference.u[name]) & (u < 1.3 * reference.u[name])), name
    aside = [c for c in robust.cautions if c.kind is Kind.OUTLIERS]
    assert len(aside) == 1
    assert robust.count <= bad.size - 0.8 * bad.sum()
    assert robust.loss == "robust"


def test_clean_data_lose_little():
    """Catches weights that eat good data: the peak of a sharp lobe, above all, is no gross error."""
    samples = paint()
    plain, robust = (fit(samples, "ggx", loss=loss) for loss in ("chi2", "robust"))
    for name, value in plain.parameters.items():
        assert np.all(np.abs(robust.parameters[name] - value) < plain.u[name]), name
        ratio = robust.u[name] / plain.u[name]
        assert np.all((ratio > 0.99) & (ratio < 1.08)), (name, ratio)
    assert plain.count - robust.count <= 3


def test_data_without_noise_are_fitted_exactly():
    """Catches a scatter of zero."""
    result = fit(paint(noise=0.0, stated=False), "ggx", loss="robust")
    np.testing.assert_allclose(result.parameters["alpha"], 0.15, rtol=1e-6)
    assert result.count == 2700


def test_pulls_of_spoiled_data_are_what_u_says():
    """Catches u of all data where some count for nothing, and a bias that outlives the weights."""
    pulls = []
    for seed in range(25):
        result = fit(spoiled(paint(300, seed=seed), "glints", seed=seed)[0], "ggx", loss="robust")
        pulls.append(
            np.concatenate([np.ravel((result.parameters[n] - TRUTH[n]) / result.u[n]) for n in TRUTH])
        )
    pulls = np.array(pulls)
    assert 0.85 < np.sqrt(np.mean(np.square(pulls))) < 1.2
    assert np.all(np.abs(pulls.mean(axis=0)) < 3.5 / np.sqrt(len(pulls)))


def test_the_scatter_is_that_of_the_good_data():
    """Catches a median over unused data, or one of all channels."""
    random = np.random.default_rng(0)
    residual = random.standard_normal((20000, 2)) * [1.0, 3.0]
    residual[::20] = 1e6
    used = np.ones(residual.shape, dtype=bool)
    used[:5000] = False
    found = scatter_of(
        np.where(used, residual, 0.0), used, np.repeat(np.linspace(0.0, 1.0, 20000)[:, None], 2, 1)
    )
    np.testing.assert_allclose(found, np.broadcast_to([1.0, 3.0], found.shape), rtol=0.15)


def test_weights_that_follow_the_data_cost_what_is_said() -> None:
    """Catches u of a robust fit that takes its weights for given, or a correction for another measure."""
    r = np.random.default_rng(2).standard_normal((4000, 300))
    mean = np.median(r, axis=1, keepdims=True)
    for _ in range(30):
        weight = np.square(np.maximum(1.0 - np.square((r - mean) / BIWEIGHT), 0.0))
        mean = np.sum(weight * r, axis=1, keepdims=True) / np.sum(weight, axis=1, keepdims=True)
    given = np.sqrt(np.sum(np.square(weight), axis=1)) / np.sum(weight, axis=1)
    found = mean.std() / np.sqrt(np.mean(np.square(given)))
    assert found == pytest.approx(beyond_given_weights(), abs=3.0 / np.sqrt(2.0 * len(r)))
