"""Microfacet models: formulas in 50 digits, normalisation, energy."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from analysis.models import MODELS
from analysis.models.fresnel import conductor_with_slopes, dielectric, schlick_with_slope
from analysis.models.microfacet import beckmann, ggx


def tan2(cosine):
    """Return the squared tangent of an angle given by its cosine."""
    return 1 / cosine**2 - 1


def exact_ggx(g, width):
    """GGX, Walter et al. 2007, equation 33."""
    return width**2 / (mp.pi * g.cos_h**4 * (width**2 + tan2(g.cos_h)) ** 2)


def exact_beckmann(g, width):
    """Beckmann, Walter et al. 2007, equation 25."""
    return mp.exp(-tan2(g.cos_h) / width**2) / (mp.pi * width**2 * g.cos_h**4)


def lambda_ggx(cosine, width):
    """Walter et al. 2007, equation 34, as Lambda = 1/G1 - 1."""
    return (mp.sqrt(1 + width**2 * tan2(cosine)) - 1) / 2


def lambda_beckmann(cosine, width):
    """Smith's Lambda of Beckmann's distribution."""
    t = tan2(cosine)
    if t <= 0:
        return mp.mpf(0)
    a = 1 / (width * mp.sqrt(t))
    return (mp.exp(-(a**2)) / (a * mp.sqrt(mp.pi)) - mp.erfc(a)) / 2


def groove(g):
    """V-groove masking, Blinn 1977."""
    return min(mp.mpf(1), 2 * g.cos_h * g.cos_o / g.cos_d, 2 * g.cos_h * g.cos_i / g.cos_d)


def schlick(g, p):
    """Schlick 1994, equation 15."""
    return p.f0 + (1 - p.f0) * (1 - g.cos_d) ** 5


def fresnel(g, index):
    """Fresnel's amplitudes of a boundary to a complex index."""
    root = mp.sqrt(index * index - 1 + g.cos_d**2)
    senkrecht = (g.cos_d - root) / (g.cos_d + root)
    parallel = (index**2 * g.cos_d - root) / (index**2 * g.cos_d + root)
    return (abs(senkrecht) ** 2 + abs(parallel) ** 2) / 2


def microfacet(density, masking, reflectance, width):
    """Return Walter et al. 2007, equation 20, with these parts, and a Lambert term."""

    def formula(g, p):
        w = getattr(p, width)
        if masking == "groove":
            shade = groove(g)
        else:
            one, two = (
                (lambda_ggx if density is exact_ggx else lambda_beckmann)(c, w) for c in (g.cos_i, g.cos_o)
            )
            shade = 1 / (1 + one + two) if masking == "correlated" else 1 / ((1 + one) * (1 + two))
        lobe = density(g, w) * shade * reflectance(g, p) / (4 * g.cos_i * g.cos_o)
        return p.kd / mp.pi + p.ks * lobe

    return formula


def dielectric_facets(g, p):
    """Reflectance of a dielectric."""
    return fresnel(g, p.ior)


def metal_facets(g, p):
    """Reflectance of a metal."""
    return fresnel(g, mp.mpc(p.eta, p.k))


FORMULAS = {
    "ggx": microfacet(exact_ggx, "correlated", schlick, "alpha"),
    "ggx-separable": microfacet(exact_ggx, "separable", schlick, "alpha"),
    "ggx-dielectric": microfacet(exact_ggx, "correlated", dielectric_facets, "alpha"),
    "ggx-conductor": microfacet(exact_ggx, "correlated", metal_facets, "alpha"),
    "beckmann": microfacet(exact_beckmann, "correlated", schlick, "m"),
    "beckmann-separable": microfacet(exact_beckmann, "separable", schlick, "m"),
    "cook-torrance-schlick": microfacet(exact_beckmann, "groove", schlick, "m"),
    "cook-torrance-conductor": microfacet(exact_beckmann, "groove", metal_facets, "m"),
    "cook-torrance-ggx": microfacet(exact_ggx, "groove", schlick, "alpha"),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_formula_and_derivatives(name, agree_with_50_digits):
    """Catches a wrong formula or derivative, and digits lost at grazing angles or at a corner of the box."""
    agree_with_50_digits(name, FORMULAS[name])


@pytest.mark.parametrize("width", [0.02, 0.2, 1.0])
@pytest.mark.parametrize("density", [ggx, beckmann])
def test_projected_area_of_the_facets_is_one(density, width):
    """Catches a distribution whose facets cover more, or less, than the surface."""
    # With q = tan^2/(w^2 + tan^2) the integrand is smooth on [0, 1]: pi cos^4 D d(tan^2).
    nodes, weights = np.polynomial.legendre.leggauss(200)
    q = 0.5 * (nodes + 1.0)
    t = width**2 * q / (1.0 - q)
    jacobian = width**2 / (1.0 - q) ** 2
    value, _ = density(t, np.asarray(width))
    projected = np.pi * value / np.square(1.0 + t) * jacobian
    assert 0.5 * weights @ projected == pytest.approx(1.0, rel=1e-10)


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
