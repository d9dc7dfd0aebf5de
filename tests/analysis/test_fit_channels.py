"""Shapes of each channel's own on request: fits of the channels alone, with the errors that they share."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.bootstrap import bootstrap
from analysis.comparison import judge
from analysis.fit import Shape, fit
from analysis.identifiability import Kind
from analysis.intervals import profile_intervals
from analysis.models import MODELS
from analysis.samples import make_samples
from rig.angles import spherical_to_direction
from rig.errors import BadInput

TRUTH = {"kd": [0.2, 0.1], "ks": [0.7, 0.8], "alpha": [0.2, 0.35], "f0": [0.06, 0.04]}


def iridescent(count=600, *, noise=0.01, seed=0, alpha=(0.2, 0.35), **columns):
    """Return noisy samples of a surface whose lobe is wider in the second channel."""
    random = np.random.default_rng(seed)
    wi = spherical_to_direction(np.arccos(random.uniform(0.2, 1.0, count)), np.zeros(count))
    wo = spherical_to_direction(
        np.arccos(random.uniform(0.2, 1.0, count)), random.uniform(0.0, 2.0 * np.pi, count)
    )
    f_r = MODELS["ggx"](**(TRUTH | {"alpha": alpha})).evaluate(wi, wo)
    noisy = f_r * (1.0 + noise * random.standard_normal(f_r.shape))
    return make_samples(wi, wo, noisy, channels=["blue", "red"], u_noise=noise * f_r, **columns)


@pytest.mark.parametrize("loss", ["chi2", "log", "robust"])
def test_each_channel_is_fitted_as_if_alone(loss):
    """Catches channels that are mixed up, or a row of the covariance that is another's."""
    samples = iridescent()
    both = fit(samples, "ggx", loss=loss, shape=Shape.PER_CHANNEL)
    assert both.names == tuple((name, c) for name in ("alpha", "f0", "kd", "ks") for c in (0, 1))
    for c in (0, 1):
        alone = fit(samples, "ggx", loss=loss, channels=[c])
        rows = [i for i, (_, channel) in enumerate(both.names) if channel == c]
        np.testing.assert_allclose(both.covariance[np.ix_(rows, rows)], alone.covariance, rtol=1e-6)
        for name in TRUTH:
            assert both.parameters[name].shape == both.u[name].shape == (2,)
            assert both.parameters[name][c] == pytest.approx(np.ravel(alone.parameters[name])[0], rel=1e-8)
        assert both.derived["ks_F0"][0][c] == pytest.approx(alone.derived["ks_F0"][0][0], rel=1e-8)
    for name, truth in TRUTH.items():
        assert np.all(np.abs(both.parameters[name] - truth) < 5.0 * both.u[name]), name


def test_one_shape_does_not_describe_two():
    """Catches a request that is ignored: with shared shapes these samples leave residuals."""
    samples = iridescent()
    shared, own = (fit(samples, "ggx", shape=shape).metrics["chi2_dof"] for shape in Shape)
    assert shared > 5.0
    assert own == pytest.approx(1.0, abs=0.15)


def test_channels_share_the_errors_that_they_share():
    """Catches channels taken as independent: all were divided by one white, and its error is one error."""
    result = fit(iridescent(u_reference=0.002), "ggx", shape="per-channel")
    rows = [result.names.index(("kd", c)) for c in (0, 1)]
    assert result.correlation[rows[0], rows[1]] > 0.5
    alone = fit(iridescent(), "ggx", shape="per-channel")
    assert alone.correlation[rows[0], rows[1]] == pytest.approx(0.0, abs=1e-12)


def test_intervals_and_replicas_know_the_channels():
    """Catches an interval of the wrong channel, or of the wrong length."""
    result = fit(iridescent(), "ggx", shape="per-channel")
    ends, replicas = profile_intervals(result), bootstrap(result, 200)
    for name in TRUTH:
        assert ends[name].shape == (2, 2)
        width = (ends[name][:, 1] - ends[name][:, 0]) / (2.0 * 1.96 * result.u[name])
        assert np.all((width > 0.9) & (width < 1.2)), (name, width)
        ratio = replicas.u()[name] / result.u[name]
        assert np.all((ratio > 0.7) & (ratio < 1.3)), (name, ratio)
    assert np.isfinite(judge(result).cross_validation)


def test_a_caution_names_its_channel():
    """Catches a doubt about one channel's width that falls on all."""
    grid = np.radians(np.arange(0.0, 80.0, 10.0))
    theta_i, theta_o = (axis.ravel() for axis in np.meshgrid(grid, grid))
    wi = spherical_to_direction(theta_i, np.full_like(theta_i, np.pi))
    wo = spherical_to_direction(theta_o, np.zeros_like(theta_o))
    f_r = MODELS["ggx"](**(TRUTH | {"alpha": [0.02, 0.3]})).evaluate(wi, wo)
    samples = make_samples(wi, wo, f_r, channels=["blue", "red"], u_noise=0.01 * f_r)
    result = fit(samples, "ggx", shape="per-channel")
    narrow = [
        c for c in result.cautions if c.kind in {Kind.NARROW_LOBE, Kind.AT_BOUND} and "alpha" in c.parameters
    ]
    assert [c.channel for c in narrow] == [0]
    assert narrow[0].text.startswith("blue: ")
    assert np.isinf(result.u["alpha"][0])
    assert result.u["alpha"][1] < 0.05


def test_one_channel_may_have_shapes_of_its_own():
    """Catches a shape () where (1,) was asked for."""
    result = fit(iridescent(), "ggx", channels=[1], shape="per-channel")
    assert result.parameters["alpha"].shape == result.u["alpha"].shape == (1,)
    assert result.names[0] == ("alpha", 0)


def test_an_unknown_shape_is_refused():
    """Catches a typo that becomes a default."""
    with pytest.raises(BadInput, match="shared, per-channel"):
        fit(iridescent(50), "ggx", shape="each")


def test_grazing_samples_are_left_out_on_request():
    """Catches a mask that forgets the camera, or the light."""
    samples = iridescent()
    result = fit(samples, "ggx", max_theta_deg=60.0)
    cosines = np.minimum(samples["wi"].to_numpy()[:, 2], samples["wo"].to_numpy()[:, 2])
    assert result.count == 2 * np.count_nonzero(cosines >= 0.5)
    with pytest.raises(BadInput, match="no sample has both angles"):
        fit(samples, "ggx", max_theta_deg=1.0)
