"""Model comparison: the true model wins, a needless one gains nothing, and one incidence decides nothing."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.comparison import bic, compare, folds_of, in_words, judge
from analysis.fit import fit
from analysis.models import MODELS
from analysis.samples import make_samples, read, select
from rig.angles import spherical_to_direction


def paint(name, *, noise=0.02, theta_i_deg=(5.0, 20.0, 35.0, 50.0, 65.0), stated=True, **parameters):
    """Return samples in plane and beside it for some incidences."""
    random = np.random.default_rng(0)
    theta_i = np.repeat(np.radians(theta_i_deg), 80)
    theta_o = np.tile(np.radians(np.linspace(0.0, 78.0, 80)), len(theta_i_deg))
    wi = spherical_to_direction(theta_i, np.full_like(theta_i, np.pi))
    wo = spherical_to_direction(theta_o, random.uniform(-0.5, 0.5, theta_o.size))
    f_r = MODELS[name](**parameters).evaluate(wi, wo)
    noisy = f_r * (1.0 + noise * random.standard_normal(f_r.shape))
    return make_samples(wi, wo, noisy, **({"u_noise": noise * f_r} if stated else {}))


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("name", ["lambert", "blinn-phong", "cook-torrance", "ggx"])
def test_the_true_model_wins(name, stated):
    """Catches a ranking by the fit itself, and one that is upside down."""
    truth = {
        "lambert": {"kd": 0.4},
        "blinn-phong": {"kd": 0.2, "ks": 0.3, "exponent": 60.0},
        "cook-torrance": {"kd": 0.2, "ks": 0.7, "m": 0.25, "ior": 1.5},
        "ggx": {"kd": 0.2, "ks": 0.7, "alpha": 0.25, "f0": 0.05},
    }[name]
    ranked = compare(paint(name, stated=stated, **truth), ["lambert", "blinn-phong", "cook-torrance", "ggx"])
    best = {each.name: each for each in ranked}
    if name == "lambert":
        # Larger models hold it: they cannot be better, and BIC charges for what they do not need.
        assert min(best.values(), key=lambda each: each.bic).name == "lambert"
        assert best["lambert"].cross_validation <= 1.01 * ranked[0].cross_validation
    else:
        assert ranked[0].name == name
        assert f"seen {name} errs by" in in_words(ranked)
    scores = [each.cross_validation for each in ranked]
    assert scores == sorted(scores)
    if stated:
        assert best[name].cross_validation == pytest.approx(1.0, abs=0.1)


def test_no_gain_is_said_to_be_none():
    """Catches the praise of a second model that is the same."""
    samples = paint("cook-torrance", kd=0.2, ks=0.7, m=0.25, ior=1.5)
    ranked = compare(samples, ["cook-torrance", "cook-torrance-1982"])
    assert "no more than chance" in in_words(ranked)
    assert in_words(ranked[:1]) == ""


def test_a_lobe_bent_to_one_incidence_is_found_out():
    """Catches folds that share incidences: then a wrong lobe predicts as well as it fits."""
    samples = paint("cook-torrance", kd=0.2, ks=0.7, m=0.3, ior=1.5)
    candidate = judge(fit(samples, "phong", loss="log"))
    assert candidate.cross_validation > 1.05 * candidate.result.metrics["rms_log"]
    assert len(candidate.squares) == 5


def test_one_incidence_is_ranked_by_bic():
    """Catches a NaN that ranks first."""
    samples = paint("blinn-phong", theta_i_deg=(30.0,), kd=0.2, ks=0.3, exponent=60.0)
    ranked = compare(samples, ["lambert", "blinn-phong"])
    assert ranked[0].name == "blinn-phong"
    assert np.isnan(ranked[0].cross_validation)
    assert "by BIC blinn-phong is ahead of lambert" in in_words(ranked)


def test_bic_is_the_formula():
    """Catches a penalty per channel or a lost factor of two."""
    samples = paint("lambert", kd=0.4)
    result = fit(samples, "lambert")
    chi2 = result.metrics["chi2_dof"] * (result.count - 1)
    assert bic(result) == pytest.approx(chi2 + np.log(result.count))
    result = fit(samples, "lambert", loss="log")
    expected = 2.0 * result.count * np.log(result.metrics["rms_log"]) + np.log(result.count)
    assert bic(result) == pytest.approx(expected)


def test_folds():
    """Catches an incidence in two folds, neighbours in one, and an empty fold."""
    fold = folds_of(np.repeat(np.radians([0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]), 4))
    np.testing.assert_array_equal(fold, np.repeat([0, 1, 2, 3, 4, 0, 1], 4))
    theta = np.random.default_rng(0).uniform(0.0, 1.4, 2000)
    many = folds_of(theta)
    assert np.bincount(many).min() > 300
    assert np.count_nonzero(np.diff(many[np.argsort(theta)])) == 9


@pytest.mark.realdata
def test_ggx_is_the_model_of_garnet_red(shared_data):
    """Catches a comparison that cannot tell GGX from Beckmann on real paint."""
    samples = select(read(shared_data / "cornell" / "garnet_red.brdf"), wavelength_nm=[550.0])
    ranked = compare(samples, ["lambert", "blinn-phong", "cook-torrance", "ggx"])
    assert [each.name for each in ranked[:2]] == ["ggx", "cook-torrance"]
    assert "chance" not in in_words(ranked)
