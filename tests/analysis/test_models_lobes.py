"""Ward, Torrance-Sparrow, Lafortune, two lobes, anisotropy: formulas in 50 digits, limits."""

from __future__ import annotations

from types import SimpleNamespace

import mpmath as mp
import numpy as np
import pytest

from analysis.models import MODELS
from analysis.models.torrance_sparrow import HALF_WIDTH


def tan2(cosine):
    """Return the squared tangent of an angle given by its cosine."""
    return 1 / cosine**2 - 1


def ward(denominator):
    """Return Ward's Gaussian over a denominator."""

    def formula(g, p):
        lobe = mp.exp(-tan2(g.cos_h) / p.alpha**2) / (mp.pi * p.alpha**2 * denominator(g))
        return p.kd / mp.pi + p.ks * lobe

    return formula


def torrance_sparrow(distribution):
    """Return D G F / ((N.L)(N.E)) with the exact dielectric reflectance."""

    def formula(g, p):
        c, n = g.cos_d, p.ior
        root = mp.sqrt(n * n + c * c - 1)
        fresnel = ((root - c) / (root + c)) ** 2 / 2
        fresnel *= 1 + ((c * (root + c) - 1) / (c * (root - c) + 1)) ** 2
        groove = min(mp.mpf(1), 2 * g.cos_h * g.cos_o / c, 2 * g.cos_h * g.cos_i / c)
        lobe = distribution(g.cos_h, p.half_width_rad) * groove * fresnel / (g.cos_i * g.cos_o)
        return p.kd / mp.pi + p.ks * lobe

    return formula


def cosine_power(cos_h, beta):
    """Blinn 1977, D1."""
    return cos_h ** (-mp.log(2) / mp.log(mp.cos(beta)))


def gauss(cos_h, beta):
    """Blinn 1977, D2."""
    return mp.exp(-((mp.acos(min(cos_h, mp.mpf(1))) * mp.sqrt(mp.log(2)) / beta) ** 2))


def trowbridge_reitz(cos_h, beta):
    """Blinn 1977, D3."""
    c2 = (mp.cos(beta) ** 2 - 1) / (mp.cos(beta) ** 2 - mp.sqrt(2))
    return (c2 / (cos_h**2 * (c2 - 1) + 1)) ** 2


def lafortune_base(g, p, sign):
    """Lafortune et al. 1997, equation 9, before the exponent."""
    return sign * (g.light[0] * g.eye[0] + g.light[1] * g.eye[1]) + p.ratio * g.cos_i * g.cos_o


def lafortune(sign):
    """Return Lafortune's model with this sign of C_x."""

    def formula(g, p):
        base = lafortune_base(g, p, sign)
        return p.kd / mp.pi + p.ks * (base**p.exponent if base > 0 else 0)

    return formula


def ggx_lobe(g, width):
    """D G / (4 (N.L)(N.E)) of GGX, heights correlated."""
    density = width**2 / (mp.pi * g.cos_h**4 * (width**2 + tan2(g.cos_h)) ** 2)
    one, two = ((mp.sqrt(1 + width**2 * tan2(c)) - 1) / 2 for c in (g.cos_i, g.cos_o))
    return density / (1 + one + two) / (4 * g.cos_i * g.cos_o)


def schlick(g, p):
    """Schlick 1994, equation 15."""
    return p.f0 + (1 - p.f0) * (1 - g.cos_d) ** 5


def two_lobes(g, p):
    """Two widths of GGX."""
    both = (1 - p.share) * ggx_lobe(g, p.alpha) + p.share * ggx_lobe(g, p.alpha * p.widening)
    return p.kd / mp.pi + p.ks * both * schlick(g, p)


def with_retro(g, p):
    """GGX, and GGX about the back vector."""
    back = [-g.eye[0] + g.light[0], -g.eye[1] + g.light[1], g.eye[2] + g.light[2]]
    length = mp.sqrt(sum(x * x for x in back))
    mirrored = SimpleNamespace(cos_h=back[2] / length, cos_i=g.cos_i, cos_o=g.cos_o)
    forth = ggx_lobe(g, p.alpha) * schlick(g, p)
    return p.kd / mp.pi + p.ks * ((1 - p.share) * forth + p.share * ggx_lobe(mirrored, p.alpha_retro))


def anisotropic(family, first, second):
    """Return the anisotropic lobe of a family, heights correlated (Heitz 2014)."""

    def formula(g, p):
        c, s = mp.cos(p.axis_rad), mp.sin(p.axis_rad)
        x, y = getattr(p, first), getattr(p, second)

        def components(v):
            return c * v[0] + s * v[1], c * v[1] - s * v[0]

        hx, hy = components(g.half)
        steepness = (hx / x) ** 2 / g.cos_h**2 + (hy / y) ** 2 / g.cos_h**2

        def masking(v):
            vx, vy = components(v)
            run = mp.sqrt((x * vx) ** 2 + (y * vy) ** 2)
            if run == 0:
                return mp.mpf(0)
            if family == "ggx":
                return (mp.sqrt(1 + (run / v[2]) ** 2) - 1) / 2
            a = v[2] / run
            return (mp.exp(-(a**2)) / (a * mp.sqrt(mp.pi)) - mp.erfc(a)) / 2

        peak = 1 / (mp.pi * x * y * g.cos_h**4)
        density = peak / (1 + steepness) ** 2 if family == "ggx" else peak * mp.exp(-steepness)
        shade = 1 / (1 + masking(g.light) + masking(g.eye))
        return p.kd / mp.pi + p.ks * schlick(g, p) * density * shade / (4 * g.cos_i * g.cos_o)

    return formula


FORMULAS = {
    "ward": ward(lambda g: 4 * mp.sqrt(g.cos_i * g.cos_o)),
    "ward-duer": ward(lambda g: 4 * g.cos_i * g.cos_o),
    "ward-bounded": ward(lambda g: (g.cos_i + g.cos_o) ** 4 / g.sum_length**2),
    "torrance-sparrow-cosine": torrance_sparrow(cosine_power),
    "torrance-sparrow-gauss": torrance_sparrow(gauss),
    "torrance-sparrow-trowbridge-reitz": torrance_sparrow(trowbridge_reitz),
    "ggx-two-lobes": two_lobes,
    "ggx-retro": with_retro,
    "ggx-anisotropic": anisotropic("ggx", "alpha_x", "alpha_y"),
    "beckmann-anisotropic": anisotropic("beckmann", "m_x", "m_y"),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_formula_and_derivatives(name, agree_with_50_digits):
    """Catches a wrong formula or derivative, and digits lost at grazing angles or at a corner of the box."""
    agree_with_50_digits(name, FORMULAS[name])


@pytest.mark.parametrize(("name", "sign"), [("lafortune", -1), ("lafortune-retro", 1)])
def test_lafortune(name, sign, agree_with_50_digits):
    """Catches a wrong sign of C_x; where the base cancels no formula in doubles has all digits."""
    agree_with_50_digits(
        name,
        lafortune(sign),
        skip=lambda g, values: abs(lafortune_base(g, SimpleNamespace(**values), sign)) < 0.2,
    )


@pytest.mark.parametrize("name", [name for name in MODELS if name.startswith("torrance-sparrow")])
@pytest.mark.parametrize("half_width", [0.01, 0.3, HALF_WIDTH.bounds[1]])
def test_half_width_is_where_the_distribution_is_one_half(name, half_width):
    """Catches a width that means another thing in each of the three distributions."""
    theta = np.array([0.0, half_width])
    # Light and camera a fixed angle apart about H, across the plane of H's tilt: F and G stay.
    wi, wo = (
        np.stack([0.1 * sign + 0.0 * theta, np.sin(theta), np.cos(theta)], axis=-1) for sign in (1.0, -1.0)
    )
    wi, wo = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (wi, wo))
    f = MODELS[name](kd=0.0, half_width_rad=half_width).evaluate(wi, wo)[:, 0]
    shading = f * wi[:, 2] * wo[:, 2] / wi[0, 2] / wo[0, 2]
    groove = min(1.0, 2.0 * np.cos(half_width) * wi[1, 2] / np.linalg.norm(0.5 * (wi[1] + wo[1])))
    assert shading[1] / shading[0] == pytest.approx(0.5 * groove, rel=1e-12)


def test_equal_widths_are_isotropic(hard_pairs):
    """Catches an axis that matters where it must not."""
    wi, wo = hard_pairs
    for family, width in (("ggx", "alpha"), ("beckmann", "m")):
        plain = MODELS[family](**{width: 0.3}).evaluate(wi, wo)
        turned = MODELS[f"{family}-anisotropic"](
            **{f"{width}_x": 0.3, f"{width}_y": 0.3, "axis_rad": 0.7}
        ).evaluate(wi, wo)
        np.testing.assert_allclose(turned, plain, rtol=1e-11)


def test_widths_exchanged_and_a_quarter_turn_are_the_same(hard_pairs):
    """Catches an axis that turns the wrong way for one of the parts."""
    wi, wo = hard_pairs
    one = MODELS["ggx-anisotropic"](alpha_x=0.1, alpha_y=0.5, axis_rad=0.4).evaluate(wi, wo)
    two = MODELS["ggx-anisotropic"](alpha_x=0.5, alpha_y=0.1, axis_rad=0.4 - np.pi / 2).evaluate(wi, wo)
    np.testing.assert_allclose(one, two, rtol=1e-9)


def test_light_spreads_along_the_larger_width():
    """Catches the two widths interchanged."""
    tilt = np.array([0.3, 0.0, np.sqrt(1.0 - 0.09)])
    across = tilt[[1, 0, 2]]
    model = MODELS["ggx-anisotropic"](kd=0.0, alpha_x=0.4, alpha_y=0.1)
    normal = [0.0, 0.0, 1.0]
    assert model.evaluate(normal, tilt)[0] > 3.0 * model.evaluate(normal, across)[0]


def test_two_lobes_become_one_at_either_end(hard_pairs):
    """Catches a share that is the other lobe's."""
    wi, wo = hard_pairs
    single, double = MODELS["ggx"], MODELS["ggx-two-lobes"]
    for share, alpha in ((0.0, 0.1), (1.0, 0.5)):
        both = double(alpha=0.1, widening=5.0, share=share).evaluate(wi, wo)
        np.testing.assert_allclose(both, single(alpha=alpha).evaluate(wi, wo), rtol=1e-13)


def test_the_lobe_back_peaks_at_the_light():
    """Catches a retro lobe that is a mirror lobe."""
    light = np.array([np.sin(0.6), 0.0, np.cos(0.6)])
    for name, values in (("ggx-retro", {"share": 1.0}), ("lafortune-retro", {"ratio": 1.0})):
        model = MODELS[name](kd=0.0, **values)
        back, mirrored = model.evaluate(light, np.stack([light, light * [-1.0, 1.0, 1.0]]))
        assert back > 20.0 * mirrored
