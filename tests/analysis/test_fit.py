"""The fit: known parameters found, uncertainties that are true, and honesty where the data say nothing."""

from __future__ import annotations

import time

import numpy as np
import pytest

from analysis.equations import solve_scales
from analysis.fit import fit
from analysis.losses import LOSSES, make_loss
from analysis.models import MODELS
from analysis.models.base import Geometry, Kind
from analysis.problem import Problem
from analysis.samples import make_samples, read, select
from analysis.solver import Solution, minimise
from rig.angles import spherical_to_direction
from rig.errors import BadInput

TRUTH = {
    "lambert": {"kd": [0.1, 0.2, 0.3]},
    "phong": {"kd": [0.1, 0.2, 0.3], "ks": [0.3, 0.1, 0.2], "exponent": 25.0},
    "modified-phong": {"kd": [0.1, 0.2, 0.3], "ks": [0.3, 0.1, 0.2], "exponent": 8.0},
    "blinn-phong": {"kd": [0.1, 0.2, 0.3], "ks": [0.3, 0.1, 0.2], "exponent": 150.0},
    "cook-torrance-1982": {"kd": [0.1, 0.2, 0.3], "ks": [0.3, 0.1, 0.2], "m": 0.15, "ior": 1.6},
    "cook-torrance": {"kd": [0.1, 0.2, 0.3], "ks": [0.9, 0.5, 0.7], "m": 0.3, "ior": 1.4},
}


def angles(count, seed=0, largest_deg=78.0):
    """Return polar angles and azimuth of pairs around the mirror direction, and some anywhere."""
    random = np.random.default_rng(seed)
    theta_i = np.radians(random.uniform(3.0, largest_deg, count))
    spread = np.where(np.arange(count) % 3 == 0, 0.6, 0.12)
    theta_o = np.clip(np.abs(theta_i + spread * random.standard_normal(count)), 0.0, np.radians(82.0))
    return theta_i, theta_o, 2.0 * spread * random.standard_normal(count)


def directions(theta_i, theta_o, phi_o):
    """Return the light at azimuth 180 deg and the camera at phi_o: the mirror direction is at 0."""
    return spherical_to_direction(theta_i, np.full_like(theta_i, np.pi)), spherical_to_direction(
        theta_o, phi_o
    )


def exact_samples(name, count=400, **extra):
    """Return what a model with the true parameters reflects."""
    wi, wo = directions(*angles(count))
    return make_samples(wi, wo, MODELS[name](**TRUTH[name]).evaluate(wi, wo), **extra)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("name", TRUTH)
def test_exact_data_give_the_parameters_back(name, loss):
    """Catches a wrong Jacobian, a start in the wrong basin, and channels that are mixed up."""
    result = fit(exact_samples(name, u_f_r=0.01), name, loss=loss)
    for parameter, value in TRUTH[name].items():
        np.testing.assert_allclose(result.parameters[parameter], value, rtol=2e-5)
        assert result.parameters[parameter].shape == np.shape(value)
        assert result.u[parameter].shape == np.shape(value)
    assert result.metrics["rms_log"] < 1e-6
    assert result.message == ""
    assert result.loss == loss
    assert name == result.model.NAME


def test_the_default_loss():
    """Catches uncertainties that are there and not used."""
    assert fit(exact_samples("lambert"), "lambert").loss == "log"
    assert fit(exact_samples("lambert", u_noise=0.01), "lambert").loss == "chi2"


def measured(seed, poses=30, bins=25):
    """Draw a session: noise, a white per pose, its reflectance, joints that are not where they say."""
    random = np.random.default_rng(seed)
    theta_i, theta_o, phi_o = angles(poses, seed=1, largest_deg=75.0)
    offsets = 0.03 * random.standard_normal((3, poses, bins))
    u_joint_rad = np.radians([0.05, 0.05, 0.05])

    def held(errors_rad):
        triple = (
            (centre + error)[:, None] + offset
            for centre, error, offset in zip((theta_i, theta_o, phi_o), errors_rad, offsets, strict=True)
        )
        return directions(*(angle.ravel() for angle in triple))

    still, step = np.zeros((3, poses)), 1e-5
    slopes = []
    for joint in range(3):
        moved = still.copy()
        moved[joint] = step
        slopes.append([(a - b) / (2 * step) for a, b in zip(held(moved), held(-moved), strict=True)])
    model = MODELS["cook-torrance"](**TRUTH["cook-torrance"])
    true = model.evaluate(*held(u_joint_rad[:, None] * random.standard_normal((3, poses))))
    pose = np.repeat(np.arange(poses), bins)
    u_noise, u_white, u_reference = 0.01 * true + 5e-4, 0.004 * true, 0.003 * true
    f_r = true + u_noise * random.standard_normal(true.shape)
    f_r += u_white * random.standard_normal((poses, 3))[pose] + u_reference * random.standard_normal()
    wi, wo = held(still)
    return make_samples(
        wi, wo, f_r, u_noise=u_noise, u_white=u_white, white_group=pose, u_reference=u_reference, pose=pose,
        d_wi=np.stack([s[0] for s in slopes], axis=1), d_wo=np.stack([s[1] for s in slopes], axis=1),
        u_joint_rad=u_joint_rad,
    )  # fmt: skip


def test_uncertainties_are_true():
    """Catches u too small (errors taken as independent) or too large: pulls over drawn sessions decide."""
    name, pulls, chi2 = "cook-torrance", [], []
    truth = TRUTH[name] | {"ks_F0": np.array(TRUTH[name]["ks"]) * (0.4 / 2.4) ** 2}
    for seed in range(60):
        result = fit(measured(seed), name)
        values = {key: (value, result.u[key]) for key, value in result.parameters.items()} | result.derived
        pulls.append(np.concatenate([np.ravel((v - truth[key]) / u) for key, (v, u) in values.items()]))
        chi2.append(result.metrics["chi2_dof"])
    pulls = np.array(pulls)
    spread = pulls.std(axis=0)
    assert np.all((spread > 0.75) & (spread < 1.3)), spread
    assert 0.85 < np.sqrt(np.mean(np.square(pulls))) < 1.15
    assert np.all(np.abs(pulls.mean(axis=0)) < 3.0 / np.sqrt(len(pulls)))
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.1)


def test_a_shared_error_does_not_average_out():
    """Catches u that shrinks with the number of samples although all were divided by one white."""
    few, many = (
        fit(exact_samples("lambert", count=n, u_noise=1e-3, u_reference=1e-3), "lambert") for n in (50, 5000)
    )
    assert few.u["kd"][0] == pytest.approx(np.pi * 1e-3, rel=0.02)
    assert many.u["kd"][0] == pytest.approx(np.pi * 1e-3, rel=0.001)
    # The same white for all channels: their errors are one error.
    correlation = many.covariance[0, 1] / np.sqrt(many.covariance[0, 0] * many.covariance[1, 1])
    assert correlation > 0.99


def test_lambert_is_the_weighted_mean():
    """Catches weights that are not 1/u^2."""
    wi, wo = directions(*angles(3))
    samples = make_samples(wi, wo, [0.1, 0.2, 0.4], u_noise=np.array([0.01, 0.02, 0.04]))
    weights = 1.0 / np.array([0.01, 0.02, 0.04]) ** 2
    result = fit(samples, "lambert")
    assert result.parameters["kd"][0] == pytest.approx(np.pi * np.average([0.1, 0.2, 0.4], weights=weights))
    assert result.u["kd"][0] == pytest.approx(np.pi / np.sqrt(weights.sum()))


def test_scatter_stands_in_for_missing_uncertainties():
    """Catches a u of zero, or one in the wrong unit, for files without uncertainties."""
    random = np.random.default_rng(9)
    samples = exact_samples("lambert", count=4000)
    samples["f_r"] += 0.01 * random.standard_normal(samples["f_r"].shape)
    result = fit(samples, "lambert", loss="l2")
    cos = samples["wi"].to_numpy()[:, 2]
    # kd = pi sum(cos^2 f) / sum(cos^2), of f with one and the same error.
    expected = np.pi * 0.01 * np.sqrt(np.sum(cos**4)) / np.sum(cos**2)
    assert result.u["kd"] == pytest.approx(expected, rel=0.05)


def test_flagged_missing_and_invisible_samples_are_left_out():
    """Catches one bad sample that ruins a fit."""
    samples = exact_samples("cook-torrance", count=300, u_noise=0.01)
    samples["f_r"][3, 1] = 1e6
    samples["flags"][3, 1] = 4
    samples["f_r"][5, 0] = np.nan
    samples["u_noise"][6, 0] = np.nan
    samples["f_r"][7] = 1e6
    samples["wo"][7] = samples["wo"][7] * np.array([1.0, 1.0, -1.0])
    result = fit(samples, "cook-torrance")
    assert result.count == 300 * 3 - 6
    np.testing.assert_allclose(result.parameters["m"], 0.3, rtol=1e-6)


def test_channels_can_be_fitted_alone():
    """Catches a channel selection that is ignored."""
    result = fit(exact_samples("blinn-phong"), "blinn-phong", channels=[2])
    np.testing.assert_allclose(result.parameters["kd"], [0.3], rtol=1e-5)


def test_an_index_that_cannot_be_seen_is_said_to_be_unknown():
    """Catches a silently precise ior: near normal incidence only ks F0 shows."""
    random = np.random.default_rng(3)
    theta_i, theta_o = np.radians(random.uniform(2.0, 20.0, (2, 300)))
    wi, wo = directions(theta_i, theta_o, 0.2 * random.standard_normal(300))
    true = MODELS["cook-torrance"](kd=0.1, ks=0.8, m=0.25, ior=1.5).evaluate(wi, wo)
    u = 0.01 * true
    result = fit(make_samples(wi, wo, true + u * random.standard_normal(u.shape), u_noise=u), "cook-torrance")
    assert "ior" in result.message
    value, spread = result.derived["ks_F0"]
    assert spread[0] / value[0] < 0.1
    assert abs(value[0] - 0.8 * 0.04) < 4.0 * spread[0]
    assert not result.u["ks"][0] < 0.5 * result.parameters["ks"][0]


def test_a_shape_on_its_bound_is_said_so():
    """Catches a bound reported as a measurement."""
    wi, wo = directions(*angles(400))
    samples = make_samples(wi, wo, MODELS["cook-torrance"](kd=0.1, ks=0.8, m=9.0, ior=1.5).evaluate(wi, wo))
    result = fit(samples, "cook-torrance")
    assert "m ended on the bound 3" in result.message
    assert np.isinf(result.u["m"])


def test_a_lobe_that_falls_between_the_samples_is_said_so():
    """Catches a silently precise m from a grid that saw the top of the lobe and nothing else."""
    grid = np.radians(np.arange(10.0, 80.0, 10.0))
    theta_i, theta_o = (axis.ravel() for axis in np.meshgrid(grid, grid))
    wi, wo = directions(theta_i, theta_o, np.zeros_like(theta_i))
    messages = {}
    for m in (0.02, 0.2):
        f_r = MODELS["cook-torrance"](kd=0.1, ks=0.8, m=m, ior=1.5).evaluate(wi, wo)
        messages[m] = fit(make_samples(wi, wo, f_r, u_noise=0.01 * f_r), "cook-torrance").message
    assert "m is not to be trusted" in messages[0.02]
    assert messages[0.2] == ""


def test_no_lobe_in_the_data():
    """Catches a crash, a warning, or an invented exponent where the surface is plain Lambert."""
    result = fit(exact_samples("lambert", u_noise=0.01), "blinn-phong")
    np.testing.assert_allclose(result.parameters["kd"], [0.1, 0.2, 0.3], rtol=1e-6)
    assert not np.any(result.parameters["ks"] > 1e-6)
    assert "exponent" in result.message or "no specular lobe" in result.message


def test_a_model_that_does_not_describe_the_data_is_said_so():
    """Catches a small u beside residuals many times as large."""
    result = fit(exact_samples("cook-torrance", u_noise=1e-3), "lambert")
    assert "residuals exceed" in result.message


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (lambda s: s.isel(sample=[0, 1, 2]), "at least 4 pairs"),
        (lambda s: s.isel(sample=[0] * 50), "1 different pairs"),
        (lambda s: s.assign(f_r=0.0 * s["f_r"]), "every f_r is zero"),
        (lambda s: s.assign(f_r=np.nan * s["f_r"]), "no usable sample"),
        (lambda s: s.assign(flags=s["flags"] + 1), "no usable sample"),
        (lambda s: s.assign(f_r=s["f_r"].where(s["channel"] != "1")), "channel 1 has no usable"),
    ],
)
def test_data_that_cannot_determine_a_model(spoil, complaint):
    """Catches numbers made from nothing."""
    with pytest.raises(BadInput, match=complaint):
        fit(spoil(exact_samples("cook-torrance")), "cook-torrance")


def test_unknown_names_list_the_known():
    """Catches a KeyError where a person made a typo."""
    with pytest.raises(BadInput, match="lambert, "):
        fit(exact_samples("lambert"), "lambertian")
    with pytest.raises(BadInput, match="chi2, log"):
        fit(exact_samples("lambert"), "lambert", loss="rmse")
    with pytest.raises(BadInput, match="chi2 needs uncertainties"):
        fit(exact_samples("lambert"), "lambert", loss="chi2")


def test_scales_are_the_best_non_negative_ones():
    """Catches a clipped free solution where the best admissible one is another."""
    random = np.random.default_rng(0)
    weight = random.random((40, 200)) + 0.1
    lobe = random.random((40, 1)) + random.integers(0, 2)
    data = random.standard_normal((40, 200)) + random.standard_normal(200)
    pair = np.stack([np.full(40, 1.0 / np.pi), lobe[:, 0]])
    kd, ks = solve_scales(weight.T, data.T, pair)
    assert np.all(kd >= 0.0)
    assert np.all(ks >= 0.0)
    assert np.any(kd == 0.0)
    assert np.any(ks == 0.0)
    assert np.any((kd > 0.0) & (ks > 0.0))
    from scipy.optimize import nnls

    for c in range(200):
        columns = weight[:, c : c + 1] * np.hstack([np.full((40, 1), 1.0 / np.pi), lobe])
        best, _ = nnls(columns, weight[:, c] * data[:, c])
        np.testing.assert_allclose([kd[c], ks[c]], best, rtol=1e-9, atol=1e-12)


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["gray-plastic", "pink-fabric"])
def test_no_random_start_finds_better(shared_data, name):
    """Catches a scan that misses the basin of the best solution on dense real materials."""
    samples = read(shared_data / "merl-standins" / f"{name}.npz").isel(sample=slice(None, None, 4))
    wi, wo, f_r = (samples[key].to_numpy() for key in ("wi", "wo", "f_r"))
    result = fit(samples, "cook-torrance")
    problem = Problem(MODELS["cook-torrance"], Geometry(wi, wo), 3)
    loss = make_loss("log", f_r, np.isfinite(f_r), wi[:, 2:], None)
    low, high = problem.bounds()
    random = np.random.default_rng(0)
    for _ in range(6):
        start = Solution(random.uniform(low, high), np.zeros(3), np.zeros(3), np.inf)
        other = np.sqrt(2.0 * minimise(problem, loss, start).cost / f_r.size)
        assert result.metrics["rms_log"] <= other * (1.0 + 1e-6)


@pytest.mark.realdata
def test_garnet_red(shared_data):
    """Catches a Cook-Torrance that is not the one that fits real paint to a hundredth in ln(1 + f cos)."""
    samples = select(read(shared_data / "cornell" / "garnet_red.brdf"), wavelength_nm=[550.0])
    result = fit(samples, "cook-torrance")
    assert result.count == 1439
    assert result.metrics["rms_log"] <= 0.0105
    again = result.model.evaluate(samples["wi"], samples["wo"]) * samples["wi"].to_numpy()[:, 2:]
    data = samples["f_r"].to_numpy() * samples["wi"].to_numpy()[:, 2:]
    assert np.sqrt(np.mean((np.log1p(again) - np.log1p(data)) ** 2)) == pytest.approx(
        result.metrics["rms_log"]
    )
    old = fit(samples, "cook-torrance-1982")
    np.testing.assert_allclose(old.parameters["ks"], result.parameters["ks"] / 4.0, rtol=1e-5)
    others = [fit(samples, name).metrics["rms_log"] for name in ("lambert", "phong", "blinn-phong")]
    assert min(others) > 5.0 * result.metrics["rms_log"]


def test_a_session_is_fitted_in_seconds():
    """Catches a fit that grew slow: 12000 samples of three channels with all their uncertainties."""
    samples = measured(0, poses=60, bins=200)
    fit(samples.isel(sample=slice(0, 200)), "cook-torrance")
    start = time.process_time()
    fit(samples, "cook-torrance")
    assert time.process_time() - start < 4.0


def test_models_declare_what_the_fit_solves():
    """Catches a model with a scale that the solver does not know."""
    for model in MODELS.values():
        scales = {p.name for p in model.PARAMETERS if p.kind is not Kind.SHAPE}
        assert scales in ({"kd"}, {"kd", "ks"})


def test_metrics_are_always_several():
    """Catches a fit that is judged by one number, and a sphere that nobody shaded."""
    result = fit(exact_samples("cook-torrance", count=2000, u_noise=1e-3), "lambert")
    residuals = {"rms_log", "l2_cos", "rms_cbrt", "median_relative", "chi2_dof"}
    seen = {"albedo_0", "albedo_30", "albedo_60", "delta_e_mean", "delta_e_95"}
    assert set(result.metrics) == residuals | seen
    assert set(result.goodness) == residuals
    random = np.random.default_rng(0)
    wi = spherical_to_direction(np.repeat(np.radians([0.0, 30.0, 60.0]), 500), np.zeros(1500))
    wo = spherical_to_direction(
        np.arcsin(np.sqrt(random.uniform(0.0, 0.97, 1500))), random.uniform(0.0, 6.28, 1500)
    )
    f_r = MODELS["blinn-phong"](**TRUTH["blinn-phong"]).evaluate(wi, wo)
    whole = fit(make_samples(wi, wo, f_r), "lambert").metrics
    assert all(np.isfinite(whole[name]) for name in seen)
    assert whole["delta_e_mean"] > 1.0
