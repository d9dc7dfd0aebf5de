"""Samples that no fit should be made of: each refusal names its evidence, and sound ones are not refused."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.fit import fit
from analysis.models import MODELS
from analysis.samples import make_samples, read
from rig.angles import spherical_to_direction
from rig.errors import BadInput

TRUTH = {"kd": [0.4, 0.1], "ks": [0.9, 0.8], "alpha": 0.2, "f0": 0.05}


def goniometer(*, noise=0.01, stated=True, seed=0, name="ggx", **truth):
    """Return a goniometer's samples: eight incidences, two planes of view."""
    theta_i, theta_o, phi = (
        axis.ravel()
        for axis in np.meshgrid(
            np.radians(np.arange(0.0, 71.0, 10.0)),
            np.radians(np.arange(2.0, 81.0, 4.0)),
            np.radians([0.0, 90.0, 180.0]),
        )
    )
    wi = spherical_to_direction(theta_i, np.full_like(theta_i, np.pi))
    wo = spherical_to_direction(theta_o, phi)
    f_r = MODELS[name](**(truth or TRUTH)).evaluate(wi, wo)
    noisy = f_r * (1.0 + noise * np.random.default_rng(seed).standard_normal(f_r.shape))
    return make_samples(wi, wo, noisy, u_noise=noise * f_r if stated else None)


def scaled(samples, factor, where):
    """Return samples with some values in another unit."""
    f_r = samples["f_r"].to_numpy().copy()
    f_r[where] *= factor
    return samples.assign(f_r=(samples["f_r"].dims, f_r))


def spoiled(samples, **columns):
    """Return samples with columns replaced by functions of them."""
    return samples.assign(
        {
            name: (samples[name].dims, change(samples[name].to_numpy().copy()))
            for name, change in columns.items()
        }
    )


def second_channel_gone(values):
    """Return values without those of the second channel."""
    values[:, 1] = np.nan
    return values


def second_channel_nearly_gone(values):
    """Return values with one left in the second channel."""
    values[1:, 1] = np.nan
    return values


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (lambda s: spoiled(s, wi=lambda w: 2.0 * w), "length 2, not 1.*neither angles nor positions"),
        (lambda s: spoiled(s, wo=np.degrees), "wo: .*not 1"),
        (lambda s: scaled(s, 100.0, slice(None)), "albedo of .*not in %/sr"),
        (lambda s: spoiled(s, u_noise=lambda u: 0.0 * u + 1.0), "uncertainties exceed the values.*in 1/sr"),
        (lambda s: spoiled(s, f_r=second_channel_gone), "channel 1 has no usable sample"),
        (lambda s: spoiled(s, u_noise=second_channel_gone), "channel 1 has no usable sample.*uncertainties"),
        (lambda s: spoiled(s, f_r=second_channel_nearly_gone), "channel 1 has 1 different pairs.*at least 2"),
        (lambda s: s.isel(sample=[0, 1, 2]), "3 different pairs of directions for 4 parameters"),
        (lambda s: s.isel(sample=[5] * 40), "1 different pairs"),
        (lambda s: spoiled(s, f_r=lambda f: 0.0 * f), "every f_r is zero"),
    ],
)
def test_what_no_fit_should_be_made_of(spoil, complaint):
    """Catches parameters made of numbers in the wrong unit, or of too few."""
    with pytest.raises(BadInput, match=complaint) as raised:
        fit(spoil(goniometer()), "ggx")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(("factor", "named"), [(np.pi, "pi"), (100.0, "100"), (0.01, "100"), (1e3, "1000")])
def test_blocks_in_another_unit(factor, named):
    """Catches a file put together of two, one of which held radiance factors or per cent."""
    samples = goniometer(name="lambert", kd=[0.02, 0.01])
    steep = samples["wi"].to_numpy()[:, 2] < 0.75
    with pytest.raises(BadInput, match=f"factor of {named} from some incidences"):
        fit(scaled(samples, factor, steep), "lambert")


def test_a_channel_in_another_unit():
    """Catches one channel in per cent beside one that is not."""
    samples = goniometer(stated=False, kd=[0.04, 0.04], ks=[0.3, 0.3], alpha=0.2, f0=0.05)
    with pytest.raises(BadInput, match=r"channel 1: .* channel 0 differ by a factor of 100"):
        fit(scaled(samples, 0.01, (slice(None), 1)), "ggx")


@pytest.mark.parametrize(
    "sound",
    [
        {},
        {"kd": [0.9, 0.009], "ks": [1.0, 1.0], "alpha": 0.1, "f0": 0.04},
        {"kd": [0.0, 0.0], "ks": [0.9, 0.3], "alpha": 0.05, "f0": 0.9},
        {"kd": [0.95, 0.95], "ks": [0.0, 0.0], "alpha": 0.05, "f0": 0.9},
        {"kd": [1e-3, 2e-3], "ks": [1.0, 1.0], "alpha": 0.6, "f0": 0.04},
    ],
)
def test_sound_samples_are_fitted(sound):
    """Catches a refusal of colours, metals, white and black surfaces."""
    for stated in (True, False):
        fit(goniometer(stated=stated, **sound), "ggx")


def test_noise_beyond_the_signal_is_no_other_unit():
    """Catches a refusal of black samples whose noise exceeds them, and which are negative as they should."""
    random = np.random.default_rng(3)
    samples = goniometer(name="lambert", kd=[3e-4, 3e-4])
    f_r = samples["f_r"].to_numpy() + 3e-4 * random.standard_normal(samples["f_r"].shape)
    dark = make_samples(samples["wi"], samples["wo"], f_r, u_noise=3e-4)
    result = fit(dark, "lambert")
    assert np.all(np.abs(result.parameters["kd"] - 3e-4) < 4.0 * result.u["kd"])


@pytest.mark.parametrize("loss", ["log", "cbrt", "l2", "robust"])
def test_non_positive_samples_count(loss):
    """Catches values at or below zero that are dropped: what is left would be twice as bright."""
    random = np.random.default_rng(4)
    samples = goniometer(name="lambert", kd=[3e-4, 3e-4])
    f_r = samples["f_r"].to_numpy() + 2e-4 * random.standard_normal(samples["f_r"].shape)
    assert np.mean(f_r < 0.0) > 0.2
    result = fit(make_samples(samples["wi"], samples["wo"], f_r), "lambert", loss=loss)
    positive = np.pi * np.mean(f_r[f_r > 0.0])
    assert np.all(result.parameters["kd"] < 0.7 * positive)
    assert np.all(np.abs(result.parameters["kd"] - 3e-4) < 5.0 * result.u["kd"])


@pytest.mark.realdata
def test_measured_materials_are_sound(shared_data):
    """Catches a refusal of real samples."""
    for path in sorted((shared_data / "merl-standins").glob("*.npz")):
        fit(read(path).isel(sample=slice(None, None, 20)), "lambert")
    for path in sorted((shared_data / "cornell").glob("*.brdf")):
        fit(read(path).isel(channel=[0, 10]), "lambert")
