"""Microfacet models: reflectance of facets, masking, and what their parts owe one another."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.models import MODELS
from analysis.models.fresnel import conductor_with_slopes, dielectric, schlick_with_slope


def test_a_metal_without_absorption_is_a_dielectric():
    """Catches two Fresnel formulas that disagree where both hold."""
    c = np.linspace(0.0, 1.0, 50)
    metal, _, by_k = conductor_with_slopes(c, 1.7, 0.0)
    np.testing.assert_allclose(metal, dielectric(c, 1.7), rtol=1e-13)
    np.testing.assert_allclose(by_k, 0.0, atol=1e-13)


def test_schlick_meets_its_two_ends():
    """Catches F0 at grazing incidence or 1 at normal incidence."""
    value, slope = schlick_with_slope(np.array([1.0, 0.0]), np.array([0.0, 1.0]), 0.04)
    np.testing.assert_allclose(value, [0.04, 1.0])
    np.testing.assert_allclose(slope, [1.0, 0.0])


def test_silver_reflects_like_silver():
    """Catches eta and k that changed places: silver at 633 nm reflects 99 % at normal incidence."""
    assert conductor_with_slopes(1.0, 0.056, 4.28)[0] == pytest.approx(0.989, abs=0.003)


@pytest.mark.parametrize("m", [0.1, 0.5])
def test_correlated_heights_let_more_light_out(m, hard_pairs):
    """Catches the two Smith forms interchanged."""
    wi, wo = hard_pairs
    for family, width in (("ggx", "alpha"), ("beckmann", "m")):
        values = {"kd": 0.0, width: m}
        more = MODELS[family](**values).evaluate(wi, wo)
        less = MODELS[f"{family}-separable"](**values).evaluate(wi, wo)
        assert np.all(less <= more * (1.0 + 1e-12))
        assert np.any(less < 0.9 * more)
