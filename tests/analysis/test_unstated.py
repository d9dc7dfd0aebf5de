"""Fits of samples that state no uncertainty: their residuals must tell it, whatever the noise is like."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.fit import fit
from analysis.intervals import profile_intervals
from analysis.losses import make_loss
from analysis.models import MODELS
from analysis.noise import noise_variance
from analysis.samples import make_samples
from analysis.unstated import bend
from rig.angles import spherical_to_direction

TRUTH = {"kd": 0.2, "ks": 0.9, "alpha": 0.1, "f0": 0.05}
KINDS = ("in proportion", "constant", "photons")


def directions(count, random):
    """Return pairs of which most lie near the mirror direction, some anywhere."""
    theta_i = np.radians(random.uniform(3.0, 75.0, count))
    spread = np.where(np.arange(count) % 3 == 0, 0.6, 0.2)
    theta_o = np.clip(np.abs(theta_i + spread * random.standard_normal(count)), 0.0, 1.4)
    phi = 2.0 * spread * random.standard_normal(count)
    return spherical_to_direction(theta_i, np.full(count, np.pi)), spherical_to_direction(theta_o, phi)


def sizes(exact, kind):
    """Return the standard deviation of noise of a kind."""
    middle = np.median(exact)
    return (
        0.04
        * {
            "in proportion": exact,
            "constant": np.full_like(exact, middle),
            "photons": np.sqrt(exact * middle),
        }[kind]
    )


def pulls(kind, loss, draws, count=250):
    """Return (value - truth) / u of each draw and parameter."""
    random, found = np.random.default_rng(5), []
    wi, wo = directions(count, random)
    exact = MODELS["ggx"](**TRUTH).evaluate(wi, wo)
    for _ in range(draws):
        f_r = exact + sizes(exact, kind) * random.standard_normal(exact.shape)
        result = fit(make_samples(wi, wo, f_r), "ggx", loss=loss)
        found.append([(result.parameters[n].item() - TRUTH[n]) / result.u[n].item() for n in TRUTH])
    return np.array(found)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("loss", ["log", "l2", "cbrt", "robust"])
def test_pulls_are_of_size_one_whatever_the_noise(kind, loss):
    """Catches residuals taken as of one size, up to six times too small, and a robust fit too sure."""
    size = np.median(np.abs(pulls(kind, loss, 40)), axis=0) / 0.6745
    assert np.all((size > 0.4) & (size < 1.5)), size
    assert 0.7 < np.mean(size) < 1.4, size


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("robust", [False, True])
def test_the_law_of_the_noise_is_found(kind, robust):
    """Catches a law that misses the noise of dark or of bright data, or follows gross errors."""
    random = np.random.default_rng(1)
    f = np.exp(random.uniform(np.log(0.05), np.log(50.0), (4000, 2)))
    sigma = sizes(f, kind) * [1.0, 3.0]
    residual = sigma * random.standard_normal(f.shape)
    used = random.random(f.shape) > 0.2
    residual[~used] = 1e9
    if robust:
        residual[::20] = 40.0 * random.standard_normal(residual[::20].shape)
    found = np.sqrt(noise_variance(residual**2, f, np.ones_like(f), used, robust=robust))
    np.testing.assert_allclose(found / sigma, 1.0, atol=0.4 if robust else 0.25)
    np.testing.assert_allclose(np.median(found / sigma), 1.0, atol=0.15 if robust else 0.08)


def test_a_black_model_leaves_some_noise():
    """Catches a division by nothing where a model predicts no light at all and noise grows with the light."""
    random = np.random.default_rng(3)
    f = np.exp(random.uniform(np.log(0.05), np.log(50.0), (5000, 1)))
    f[7] = 1e-200
    square = np.square(0.05 * f * random.standard_normal(f.shape))
    square[7] = 1e-4
    found = noise_variance(square, f, np.ones_like(f), np.ones(f.shape, dtype=bool))
    assert np.all(np.isfinite(square / found))


def test_noise_that_no_law_of_brightness_describes_widens_u():
    """Catches a law that is believed against the residuals: here noise comes with the azimuth, not with f."""
    random = np.random.default_rng(2)
    wi = spherical_to_direction(np.full(400, 0.5), np.zeros(400))
    tilt = random.uniform(0.0, 1.4, 400)
    wo = spherical_to_direction(tilt, random.uniform(0.0, 2.0 * np.pi, 400))
    # f is the same everywhere, and only the light's own slant has noise.
    noisy = np.where(tilt > 1.2, 0.3, 0.001)
    samples = make_samples(wi, wo, 0.1 * (1.0 + noisy * random.standard_normal(400))[:, None])
    result = fit(samples, "oren-nayar", loss="l2")
    assert np.isfinite(result.state.freedom).all()
    assert result.state.freedom.min() < 250.0


def test_few_samples_have_wide_intervals():
    """Catches a normal quantile where six degrees of freedom tell the noise: Student's is 2.45."""
    random = np.random.default_rng(0)
    tilt = np.linspace(0.0, 1.2, 7)
    wi, wo = spherical_to_direction(np.full(7, 0.3), np.zeros(7)), spherical_to_direction(tilt, np.zeros(7))
    samples = make_samples(wi, wo, (0.1 + 0.01 * random.standard_normal(7))[:, None])
    result = fit(samples, "lambert", loss="l2")
    low, high = profile_intervals(result)["kd"][0]
    assert high - low == pytest.approx(2.0 * 2.447 * result.u["kd"][0], rel=0.01)


def test_a_datum_that_the_fit_must_meet_tells_nothing_of_its_error():
    """Catches a u of zero where one datum determines the lobe: its residual is zero, its error is not."""
    random = np.random.default_rng(3)
    tilt = np.concatenate([np.radians(np.linspace(30.0, 80.0, 60)), [0.0]])
    wi = spherical_to_direction(np.zeros(61), np.zeros(61))
    wo = spherical_to_direction(tilt, np.zeros(61))
    exact = MODELS["blinn-phong"](kd=0.3, ks=0.5, exponent=4000.0).evaluate(wi, wo)
    result = fit(
        make_samples(wi, wo, exact * (1.0 + 0.02 * random.standard_normal(exact.shape))), "blinn-phong"
    )
    assert not result.u["ks"] < 0.015 * result.parameters["ks"]


def test_a_curved_measure_is_off_by_what_the_noise_bends_it():
    """Catches a bias left out: the mean of ln(1 + d cos) of noisy data lies below that of their mean."""
    random = np.random.default_rng(4)
    f, u, cos = np.full((200000, 1), 0.6), np.full((200000, 1), 0.2), np.full((200000, 1), 0.8)
    data = f + u * random.standard_normal(f.shape)
    loss = make_loss("log", data, np.ones(f.shape, bool), cos, None)
    np.testing.assert_allclose(
        -np.mean(loss.residual(f)), (bend(loss, f, u) * loss.weight()).mean(), rtol=0.1
    )
    linear = make_loss("l2", data, np.ones(f.shape, bool), cos, None)
    assert not bend(linear, f, u).any()


def test_as_many_data_as_parameters_say_nothing_of_their_errors():
    """Catches a u of zero, or a crash, where every datum is met."""
    wi, wo = (
        spherical_to_direction(np.array([0.2, 0.2]), np.zeros(2)),
        spherical_to_direction(np.array([0.2, 1.2]), np.full(2, np.pi)),
    )
    exact = MODELS["cook-torrance"](kd=0.2, ks=0.5, m=0.4, ior=1.5).evaluate(
        *directions(4, np.random.default_rng(1))
    )
    few = make_samples(*directions(4, np.random.default_rng(1)), exact)
    assert np.isinf(fit(few, "cook-torrance").u["m"])
    one = make_samples(wi, wo, np.array([[0.1, 0.1], [0.1, np.nan]]))
    assert fit(one, "lambert").u["kd"][0] < 1e-9


def test_residuals_as_large_as_the_lobe_leave_u_finite():
    """Catches a second order taken where noise exceeds the value: u of a mirror's width of 350 widths."""
    random = np.random.default_rng(6)
    theta_i = np.radians(random.uniform(5.0, 70.0, 600))
    theta_o = np.abs(theta_i + 0.05 * random.standard_normal(600))
    wi = spherical_to_direction(theta_i, np.full(600, np.pi))
    wo = spherical_to_direction(theta_o, 0.05 * random.standard_normal(600))
    exact = MODELS["ggx"](kd=0.01, ks=1.0, alpha=0.01, f0=0.9).evaluate(wi, wo)
    samples = make_samples(wi, wo, exact * np.exp(1.2 * random.standard_normal(exact.shape)))
    result = fit(samples, "ggx", loss="log")
    assert 0.02 < result.u["alpha"] / result.parameters["alpha"] < 0.3
