"""Albedo and colour differences against values known from elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.appearance import (
    albedo_difference,
    appearance,
    ciede2000,
    interpolated,
    lab,
    shaded_sphere,
    sphere_delta_e,
)
from analysis.models import MODELS
from rig.angles import spherical_to_direction


def hemisphere(theta_i_deg, count=4000, seed=0):
    """Return one light and cameras spread evenly in projected solid angle."""
    random = np.random.default_rng(seed)
    wi = spherical_to_direction(np.full(count, np.radians(theta_i_deg)), np.full(count, 1.0))
    theta_o = np.arcsin(np.sqrt(random.uniform(0.0, 0.999, count)))
    return wi, spherical_to_direction(theta_o, random.uniform(0.0, 2.0 * np.pi, count))


@pytest.mark.parametrize("theta_i_deg", [0.0, 30.0, 60.0])
def test_the_albedo_of_a_known_difference(theta_i_deg):
    """Catches a lost pi, a cosine too many, and cells of the wrong weight."""
    wi, wo = hemisphere(theta_i_deg)
    first, second = MODELS["lambert"](kd=[0.5, 0.5]), MODELS["lambert"](kd=[0.4, 0.4])
    found = albedo_difference(first.evaluate(wi, wo), second.evaluate(wi, wo), wi, wo)
    assert found.pop(f"albedo_{theta_i_deg:.0f}") == pytest.approx(0.1)
    assert all(np.isnan(value) for value in found.values())
    lobe = MODELS["blinn-phong"](kd=0.0, ks=0.5, exponent=20.0).evaluate(wi, wo)
    truth = np.pi * lobe.mean()
    found = albedo_difference(lobe, np.zeros_like(lobe), wi, wo)
    assert found[f"albedo_{theta_i_deg:.0f}"] == pytest.approx(truth, rel=0.05)


def test_samples_in_one_plane_have_no_albedo():
    """Catches an albedo made from a single plane."""
    theta_o = np.linspace(-1.4, 1.4, 500)
    wi = spherical_to_direction(np.full(500, 0.0), np.zeros(500))
    wo = spherical_to_direction(np.abs(theta_o), np.where(theta_o < 0.0, np.pi, 0.0))
    f_r = np.full((500, 1), 0.1)
    assert np.isnan(albedo_difference(f_r, 2.0 * f_r, wi, wo)["albedo_0"])


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, -1.3802, -84.2814), (50.0, 0.0, -82.7485), 1.0000),
        ((50.0, 0.0, 0.0), (50.0, -1.0, 2.0), 2.3669),
        ((50.0, 2.49, -0.001), (50.0, -2.49, 0.0009), 7.1792),
        ((50.0, 2.49, -0.001), (50.0, -2.49, 0.0011), 7.2195),
        ((50.0, 2.5, 0.0), (61.0, -5.0, 29.0), 22.8977),
        ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_ciede2000_against_the_published_pairs(first, second, expected):
    """Catches any slip in the formula: Sharma, Wu & Dalal 2005, table 1."""
    a, b = np.array([first]), np.array([second])
    assert ciede2000(a, b)[0] == pytest.approx(expected, abs=1e-4)
    assert ciede2000(b, a)[0] == pytest.approx(expected, abs=1e-4)


def test_lab_of_known_colours():
    """Catches a transposed matrix or another white."""
    found = lab(np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(found[0], [100.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found[1], [0.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found[2], [53.24, 80.09, 67.20], atol=0.02)
    np.testing.assert_allclose(lab(np.array([[0.5]])), lab(np.array([[0.5, 0.5, 0.5]])))


def test_a_white_sphere():
    """Catches light from below, and a wrong scale: where it faces the lamp a white sphere has radiance 1."""
    picture = shaded_sphere(MODELS["lambert"](kd=1.0).evaluate, 200)
    assert picture.max() == pytest.approx(1.0, abs=1e-3)
    assert picture.min() > 0.0
    # The part of the disc that a lamp at this angle to the view reaches: (1 + cos)/2.
    cosine = 0.65 / np.linalg.norm([-0.45, 0.6, 0.65])
    assert len(picture) / (np.pi * 100.0**2) == pytest.approx(0.5 * (1.0 + cosine), rel=0.01)


def test_spheres_differ_as_their_materials():
    """Catches a difference that is none, or that does not grow."""
    base = MODELS["ggx"](kd=[0.5, 0.2, 0.1], ks=1.0, alpha=0.2, f0=0.04)
    near = MODELS["ggx"](kd=[0.5, 0.2, 0.1], ks=1.0, alpha=0.21, f0=0.04)
    far = MODELS["ggx"](kd=[0.1, 0.2, 0.5], ks=1.0, alpha=0.5, f0=0.04)
    assert sphere_delta_e(base.evaluate, base.evaluate)["delta_e_mean"] == 0.0
    small, large = (sphere_delta_e(base.evaluate, other.evaluate)["delta_e_mean"] for other in (near, far))
    assert 0.0 < small < 1.0
    assert large > 10.0


def test_dense_samples_stand_for_their_material():
    """Catches an interpolation that mixes up directions."""
    model = MODELS["ggx"](kd=[0.5, 0.2, 0.1], ks=1.0, alpha=0.3, f0=0.04)
    random = np.random.default_rng(0)
    angles = random.uniform(0.0, 1.5, (2, 40000))
    wi = spherical_to_direction(angles[0], random.uniform(0.0, 6.28, 40000))
    wo = spherical_to_direction(angles[1], random.uniform(0.0, 6.28, 40000))
    found = sphere_delta_e(interpolated(wi, wo, model.evaluate(wi, wo)), model.evaluate)
    assert found["delta_e_mean"] < 1.5


def test_what_samples_do_not_cover_is_not_seen():
    """Catches a sphere made of samples of one plane, and unused samples that count."""
    model = MODELS["ggx"](kd=[0.5, 0.2, 0.1], ks=1.0, alpha=0.3, f0=0.04)
    wi, wo = hemisphere(30.0)
    f_r = model.evaluate(wi, wo)
    f_r[::7, 1] = np.nan
    found = appearance(model.evaluate, wi, wo, f_r)
    assert found["albedo_30"] == pytest.approx(0.0, abs=1e-12)
    assert np.isfinite(found["delta_e_mean"])
    in_plane = np.abs(wo[:, 1]) < 0.02
    found = appearance(model.evaluate, wi[in_plane], wo[in_plane], f_r[in_plane])
    assert np.isnan(found["delta_e_mean"])
