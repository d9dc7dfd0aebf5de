"""Fits of the factored model: stiffness by cross-validation, tables, any loss."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.factored_fit import LADDER, fit_factored
from analysis.models import MODELS
from analysis.ranking import rank
from analysis.samples import make_samples, read
from rig.angles import spherical_to_direction
from rig.errors import BadInput

TRUTH = MODELS["beckmann"](kd=[0.1, 0.3], ks=[0.8, 0.5], m=0.3, f0=0.05)


def grid(theta_i_deg):
    """Return directions around the mirror direction, in and out of plane, for some incidences."""
    theta_i, theta_o, phi = (
        np.radians(axis.ravel())
        for axis in np.meshgrid(theta_i_deg, np.arange(0.0, 80.0, 5.0), [0.0, 10.0, 30.0, 120.0])
    )
    return spherical_to_direction(theta_i, np.full_like(theta_i, np.pi)), spherical_to_direction(theta_o, phi)


def drawn(model, theta_i_deg, noise=0.02, **columns):
    """Return samples of a surface with noise."""
    wi, wo = grid(theta_i_deg)
    exact = model.evaluate(wi, wo)
    f_r = exact * (1.0 + noise * np.random.default_rng(3).standard_normal(exact.shape))
    if columns.get("stated"):
        return make_samples(wi, wo, f_r, u_noise=noise * exact)
    return make_samples(wi, wo, f_r)


def test_where_ggx_is_the_truth_the_tables_stay_stiff():
    """Catches tables that follow noise: they must predict hardly worse than the model that made the data."""
    samples = drawn(MODELS["ggx"](kd=0.2, ks=0.9, alpha=0.25, f0=0.05), [5.0, 20.0, 35.0, 50.0, 65.0])
    candidates = {each.name: each for each in rank(samples, ["ggx", "factored"], loss="log")}
    assert candidates["factored"].result.stiffness >= 1.0
    assert candidates["factored"].cross_validation < 1.2 * candidates["ggx"].cross_validation
    assert candidates["factored"].bic > candidates["ggx"].bic


def test_where_ggx_is_wrong_the_tables_predict_better():
    """Catches a stiffness that is always the largest; under stated uncertainties, so by chi2."""
    samples = drawn(TRUTH, [5.0, 15.0, 25.0, 35.0, 45.0, 55.0, 65.0], stated=True)
    first, second = rank(samples, ["ggx", "factored"])
    assert first.name == "factored"
    assert first.result.loss == "chi2"
    assert first.result.metrics["chi2_dof"] < 0.7 * second.result.metrics["chi2_dof"]
    assert first.cross_validation < 0.9 * second.cross_validation


def test_tables_are_the_factors():
    """Catches tables in other units: D is normalised, F keeps the scale, both are those of the truth."""
    samples = drawn(TRUTH, np.arange(5.0, 80.0, 7.0), noise=1e-4)
    found = fit_factored(samples, loss="log")
    density, reflectance = found.tables["D"], found.tables["F"]
    tan2 = np.square(np.tan(np.radians(density.theta_deg)))
    inside = density.theta_deg < 25.0
    beckmann = np.exp(-tan2 / 0.09) / (np.pi * 0.09) * np.square(1.0 + tan2)
    np.testing.assert_allclose(density.value[inside], beckmann[inside], rtol=0.15)
    np.testing.assert_allclose(reflectance.value[0], [0.04, 0.025], rtol=0.25)
    np.testing.assert_allclose(reflectance.value[0, 0] / reflectance.value[0, 1], 1.6, rtol=0.03)
    assert np.all(density.relative_u[inside] < 0.2)
    assert 2.0 < found.freedom < 60.0


def test_one_incidence_is_said_to_be_a_guess():
    """Catches a stiffness that looks measured and is not."""
    wi, wo = grid([30.0])
    extra = [spherical_to_direction(np.radians(np.full(99, 30.0)), np.full(99, np.pi))]
    far = spherical_to_direction(np.radians(np.linspace(1.0, 75.0, 99)), np.linspace(0.0, 3.0, 99))
    wi, wo = np.concatenate([wi, *extra]), np.concatenate([wo, far])
    found = fit_factored(make_samples(wi, wo, TRUTH.evaluate(wi, wo)), loss="log")
    assert not found.squares.size
    assert "one incidence" in found.message


def test_too_few_samples_are_refused_and_an_unknown_name_too():
    """Catches tables made of nothing, and a refusal without a way out."""
    wi, wo = grid([30.0])
    few = make_samples(wi[:20], wo[:20], TRUTH.evaluate(wi[:20], wo[:20]))
    with pytest.raises(BadInput, match="20 samples for"):
        fit_factored(few)
    with pytest.raises(BadInput, match="did you mean ward-duer"):
        rank(few, ["ward-dür"])
    left_out = {}
    assert [each.name for each in rank(few, ["factored", "lambert"], left_out=left_out)] == ["lambert"]
    assert list(left_out) == ["factored"]


@pytest.mark.realdata
def test_a_real_paint_is_predicted_better(shared_data):
    """Catches tables that fit better and predict worse, on 1439 real samples."""
    from analysis.samples import select

    samples = select(read(shared_data / "cornell" / "garnet_red.brdf"), wavelength_nm=[550.0])
    first, second = rank(samples, ["ggx", "factored"], loss="log")
    assert first.name == "factored"
    assert first.result.metrics["rms_log"] < 0.55 * second.result.metrics["rms_log"]
    assert first.cross_validation < 0.7 * second.cross_validation
    assert first.result.stiffness in LADDER
