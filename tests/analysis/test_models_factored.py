"""The factored model: what it can learn, what it keeps of its start, what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.fit import fit
from analysis.models import MODELS
from analysis.models.factored import estimate
from analysis.samples import make_samples, read
from rig.angles import spherical_to_direction
from rig.errors import BadInput


def directions(count, seed=0):
    """Return pairs up to 80 deg, half of them about the mirror direction."""
    random = np.random.default_rng(seed)
    theta = np.radians(random.uniform(0.0, 80.0, (2, count)))
    phi = random.uniform(-np.pi, np.pi, count)
    near = np.arange(count) % 2 == 0
    theta[1] = np.where(near, np.abs(theta[0] + random.normal(0.0, 0.15, count)), theta[1])
    phi = np.where(near, np.pi + random.normal(0.0, 0.2, count), phi)
    return spherical_to_direction(theta[0], np.zeros(count)), spherical_to_direction(
        np.minimum(theta[1], np.radians(82.0)), phi
    )


def misfit(model, wi, wo, f_r):
    """RMS difference of ln(1 + f cos)."""
    difference = np.log1p(model.evaluate(wi, wo) * wi[:, 2:]) - np.log1p(f_r * wi[:, 2:])
    return float(np.sqrt(np.nanmean(np.square(difference))))


def test_a_start_that_is_right_is_kept():
    """Catches a search that leaves a minimum, or tables that are not zero where nothing is to correct."""
    wi, wo = directions(900)
    truth = MODELS["ggx"](kd=[0.1, 0.3], ks=[0.8, 0.5], alpha=0.2, f0=0.05)
    factored = estimate(wi, wo, truth.evaluate(wi, wo), truth)
    assert np.abs(factored.shared).max() < 1e-9
    np.testing.assert_allclose(factored.kd, truth.kd, rtol=1e-9)
    np.testing.assert_allclose(factored.evaluate(wi, wo), truth.evaluate(wi, wo), rtol=1e-8)


def test_it_learns_what_ggx_cannot():
    """Catches tables that do nothing: Beckmann facets of coloured metal, seen again at other directions."""
    wi, wo = directions(4000)
    truth = MODELS["cook-torrance-conductor"](kd=0.05, ks=0.9, m=0.3, eta=[0.2, 0.6, 1.4], k=[3.5, 2.4, 1.9])
    start = fit(make_samples(wi, wo, truth.evaluate(wi, wo)), "ggx", loss="log").model
    factored = estimate(wi, wo, truth.evaluate(wi, wo), start)
    wi, wo = directions(4000, seed=1)
    f_r = truth.evaluate(wi, wo)
    assert misfit(factored, wi, wo, f_r) < 0.3 * misfit(start, wi, wo, f_r)


def test_it_is_a_brdf_where_a_model_is_one():
    """Catches an asymmetry of the tables, light from below, swallowed NaN, a lost shape."""
    wi, wo = directions(900)
    truth = MODELS["beckmann"](kd=[0.1, 0.3], ks=0.8, m=0.3, f0=0.05)
    factored = estimate(
        wi, wo, truth.evaluate(wi, wo), MODELS["ggx"](kd=[0.1, 0.3], ks=0.8, alpha=0.3, f0=0.05)
    )
    wi, wo = directions(60, seed=2)
    f = factored.evaluate(wi, wo)
    assert np.all(f > 0.0)
    np.testing.assert_allclose(factored.evaluate(wo, wi), f, rtol=1e-10)
    cube = factored.evaluate(wi.reshape(3, 20, 3), wo.reshape(3, 20, 3))
    np.testing.assert_array_equal(cube.reshape(60, 2), f)
    below, missing = [0.6, 0.0, -0.8], [np.nan, 0.0, 1.0]
    edges = factored.evaluate([below, missing, [0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]] * 3)
    assert np.all(edges[0] == 0.0)
    assert np.isnan(edges[1]).all()
    assert np.isfinite(edges[2]).all()


def test_missing_samples_are_left_out():
    """Catches a NaN that spreads over the tables."""
    wi, wo = directions(900)
    truth = MODELS["beckmann"](kd=[0.1, 0.3], ks=0.8, m=0.3, f0=0.05)
    f_r = truth.evaluate(wi, wo)
    f_r[::7, 0] = np.nan
    factored = estimate(wi, wo, f_r, MODELS["ggx"](kd=[0.1, 0.3], ks=0.8, alpha=0.3, f0=0.05))
    assert misfit(factored, wi, wo, truth.evaluate(wi, wo)) < 0.01


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("material", "ratio"),
    [("blue-metallic-paint", 0.4), ("gray-plastic", 0.4), ("nickel", 0.6), ("white-fabric", 0.7)],
)
def test_measured_materials(shared_data, material, ratio):
    """Catches tables too stiff for real surfaces: plastic, metal, cloth, a paint that changes colour."""
    samples = read(shared_data / "merl-standins" / f"{material}.npz").isel(sample=slice(None, None, 4))
    wi, wo, f_r = (samples[key].to_numpy() for key in ("wi", "wo", "f_r"))
    start = fit(samples, "ggx", loss="log").model
    factored = estimate(wi, wo, f_r, start)
    assert misfit(factored, wi, wo, f_r) < ratio * misfit(start, wi, wo, f_r)


def test_what_cannot_be_estimated_is_refused():
    """Catches tables made of nothing."""
    wi, wo = directions(20)
    with pytest.raises(BadInput, match="20 samples"):
        estimate(wi, wo, np.full((20, 1), 0.1), MODELS["ggx"]())
    wi, wo = directions(200)
    with pytest.raises(BadInput, match="without a lobe"):
        estimate(wi, wo, np.full((200, 1), 0.1), MODELS["lambert"]())
