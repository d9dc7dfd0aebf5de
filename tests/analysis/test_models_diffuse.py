"""Diffuse terms that are not Lambert's, Ashikhmin-Shirley, ABC: formulas in 50 digits, refusals."""

from __future__ import annotations

from types import SimpleNamespace

import mpmath as mp
import numpy as np
import pytest

from analysis.fit import fit
from analysis.models import FITTED_MODELS, MODELS
from analysis.samples import make_samples, read
from rig.errors import BadInput


def dot_in_surface(g):
    """Return sin(theta_i) sin(theta_o) cos(phi_i - phi_o)."""
    return g.light[0] * g.eye[0] + g.light[1] * g.eye[1]


def oren_nayar(g, p):
    """Oren & Nayar 1994, equation 30, by angles."""
    square = p.sigma_rad**2
    level, rise = (
        1 - square / (square + mp.mpf("0.33")) / 2,
        mp.mpf("0.45") * square / (square + mp.mpf("0.09")),
    )
    theta_i, theta_o = (mp.acos(min(c, mp.mpf(1))) for c in (g.cos_i, g.cos_o))
    sines = mp.sin(theta_i) * mp.sin(theta_o)
    cos_phi = dot_in_surface(g) / sines if sines > 0 else mp.mpf(0)
    larger, smaller = max(theta_i, theta_o), min(theta_i, theta_o)
    return p.kd / mp.pi * (level + rise * max(mp.mpf(0), cos_phi) * mp.sin(larger) * mp.tan(smaller))


def fujii(g, p):
    """Fujii 2012 in the notation of Portsmouth, Kutz & Hill 2024."""
    s = dot_in_surface(g)
    ratio = s / max(g.cos_i, g.cos_o) if s > 0 else s
    level = 1 / (1 + (mp.mpf(1) / 2 - 2 / (3 * mp.pi)) * p.roughness)
    return p.kd / mp.pi * level * (1 + p.roughness * ratio)


def ashikhmin_shirley(g, p):
    """Ashikhmin & Shirley 2000, equations 4 and 5."""
    c, s = mp.cos(p.axis_rad), mp.sin(p.axis_rad)
    along, across = c * g.half[0] + s * g.half[1], c * g.half[1] - s * g.half[0]
    square = along**2 + across**2
    power = (p.exponent_x * along**2 + p.exponent_y * across**2) / square if square else mp.mpf(0)
    lobe = mp.sqrt((p.exponent_x + 1) * (p.exponent_y + 1)) / (8 * mp.pi) * g.cos_h**power
    lobe *= (p.f0 + (1 - p.f0) * (1 - g.cos_d) ** 5) / (g.cos_d * max(g.cos_i, g.cos_o))
    below = 28 / (23 * mp.pi) * (1 - p.f0) * (1 - (1 - g.cos_i / 2) ** 5) * (1 - (1 - g.cos_o / 2) ** 5)
    return p.kd * below + p.ks * lobe


def abc(g, p):
    """Löw et al. 2012, microfacet form."""
    c, n = g.cos_d, p.ior
    root = mp.sqrt(n * n + c * c - 1)
    fresnel = ((root - c) / (root + c)) ** 2 / 2
    fresnel *= 1 + ((c * (root + c) - 1) / (c * (root - c) + 1)) ** 2
    groove = min(mp.mpf(1), 2 * g.cos_h * g.cos_o / c, 2 * g.cos_h * g.cos_i / c)
    density = 1 / (1 + p.b * (1 - g.cos_h)) ** p.c
    return p.kd / mp.pi + p.ks * fresnel * groove * density / (mp.pi * g.cos_i * g.cos_o)


def shifted_gamma_masking(cosine, p):
    """Bagher et al. 2012: the masking of one direction."""
    beyond = max(mp.acos(min(cosine, mp.mpf(1))) - p.theta0_rad, mp.mpf(0))
    return max(mp.mpf(0), 1 + p.lam * (1 - mp.exp(p.c * beyond**p.k)))


def sgd(g, p):
    """Bagher et al. 2012, D without its norm."""
    tan2 = 1 / g.cos_h**2 - 1
    density = mp.exp(-(p.alpha**2 + tan2) / p.alpha) / (p.alpha**2 + tan2) ** p.p / g.cos_h**4
    peak = mp.exp(-p.alpha) / p.alpha ** (2 * p.p)
    reflectance = p.f0 - g.cos_d * p.f1 + (1 - p.f0) * (1 - g.cos_d) ** 5
    masked = shifted_gamma_masking(g.cos_i, p) * shifted_gamma_masking(g.cos_o, p)
    return p.kd / mp.pi + p.ks * reflectance * density / peak * masked / (4 * g.cos_i * g.cos_o)


FORMULAS = {"oren-nayar": oren_nayar, "fujii": fujii, "ashikhmin-shirley": ashikhmin_shirley, "abc": abc}


@pytest.mark.parametrize("name", FORMULAS)
def test_formula_and_derivatives(name, agree_with_50_digits):
    """Catches a wrong formula or derivative, and digits lost at grazing angles or at a corner of the box."""
    agree_with_50_digits(name, FORMULAS[name])


def test_shifted_gamma(agree_with_50_digits):
    """Catches a wrong formula; where masking or reflectance end in zero no formula has all digits."""

    def cancels(g, values):
        p = SimpleNamespace(**{key: mp.mpf(value) for key, value in values.items()})
        flat = p.f0 + (1 - p.f0) * (1 - g.cos_d) ** 5
        masked = min(shifted_gamma_masking(c, p) for c in (g.cos_i, g.cos_o))
        return masked < 0.2 or abs(flat - g.cos_d * p.f1) < 0.1 * flat

    agree_with_50_digits("sgd", sgd, skip=cancels)


PUBLISHED = {
    ("special-walnut-224", 0): {"alpha": 0.117091, "p": 0.548899, "f0": 0.0808859, "f1": 0.0327605}
    | {"theta0_rad": -0.31158, "k": 22.9756, "lam": 3.61532, "c": 1.19182e-7},
    ("red-fabric", 1): {"alpha": 0.228455, "p": 0.821197, "f0": 0.0644687, "f1": -0.0062547}
    | {"theta0_rad": -0.530789, "k": 19.649, "lam": 3.93046, "c": 1.04152e-7},
}
"""Bagher et al. 2012, supplemental material: shapes of one channel of two MERL materials."""


@pytest.mark.realdata
@pytest.mark.parametrize(("material", "channel"), PUBLISHED)
def test_published_shapes_describe_the_materials(shared_data, material, channel):
    """Catches a formula that is not the one for which the paper's parameters of these materials hold."""
    samples = read(shared_data / "merl-standins" / f"{material}.npz")
    wi, wo, f_r = (samples[key].to_numpy() for key in ("wi", "wo", "f_r"))
    columns = MODELS["sgd"](**PUBLISHED[material, channel]).basis(wi, wo)
    design = np.stack([columns["kd"][:, 0], columns["ks"][:, 0]], axis=1)
    data, cosine = f_r[:, channel], wi[:, 2]
    weight = cosine / (1.0 + data * cosine)
    scales = np.linalg.lstsq(design * weight[:, None], data * weight, rcond=None)[0]
    residual = np.log1p(design @ scales * cosine) - np.log1p(data * cosine)
    assert np.sqrt(np.mean(residual**2)) < 0.35 * np.std(np.log1p(data * cosine))


@pytest.mark.parametrize(
    ("name", "smooth"), [("oren-nayar", {"sigma_rad": 0.0}), ("fujii", {"roughness": 0.0})]
)
def test_without_roughness_it_is_lambert(name, smooth, hard_pairs):
    """Catches a diffuse term that does not end in Lambert's."""
    f = MODELS[name](kd=0.4, **smooth).evaluate(*hard_pairs)
    np.testing.assert_allclose(f, 0.4 / np.pi, rtol=1e-14)


def test_rough_surfaces_shine_back():
    """Catches the sign of the dot product: a rough diffuser is brighter towards the light."""
    light = np.array([np.sin(1.1), 0.0, np.cos(1.1)])
    for name in ("oren-nayar", "fujii"):
        back, forth = MODELS[name]().evaluate(light, np.stack([light, light * [-1.0, 1.0, 1.0]]))
        assert back > 1.2 * forth


@pytest.mark.parametrize("name", [name for name in MODELS if name not in FITTED_MODELS])
def test_the_fit_refuses_what_it_would_take_for_lambert(name, hard_pairs):
    """Catches a fit that takes a model's own diffuse term for kd/pi and returns numbers without a meaning."""
    wi, wo = hard_pairs
    with pytest.raises(BadInput, match=r"not fitted|diffuse term"):
        fit(make_samples(wi, wo, MODELS[name]().evaluate(wi, wo)), name)
