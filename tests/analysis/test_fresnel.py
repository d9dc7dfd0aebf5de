"""The exact dielectric reflectance against 50 digits and against what physics says of it."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.models.fresnel import (
    dielectric,
    dielectric_with_slope,
    normal_reflectance,
    normal_reflectance_slope,
)

DIGITS = 50


def reference(cos_d, ior):
    """Snell's angles and Fresnel's amplitudes, as in a textbook, with digits to waste."""
    c, n = mp.mpf(cos_d), mp.mpf(ior)
    t = mp.sqrt(1 - (1 - c * c) / (n * n))
    perpendicular = (c - n * t) / (c + n * t)
    parallel = (n * c - t) / (n * c + t)
    return (perpendicular**2 + parallel**2) / 2


def by_angles(cos_d, ior):
    """F = (sin^2(a)/sin^2(b) + tan^2(a)/tan^2(b))/2, a and b difference and sum of Snell's angles."""
    phi = mp.acos(mp.mpf(cos_d))
    theta = mp.asin(mp.sin(phi) / mp.mpf(ior))
    apart, together = phi - theta, phi + theta
    return ((mp.sin(apart) / mp.sin(together)) ** 2 + (mp.tan(apart) / mp.tan(together)) ** 2) / 2


def by_cosines(cos_d, ior):
    """F = (g - c)^2/(g + c)^2 (1 + ((c(g + c) - 1)/(c(g - c) + 1))^2)/2, g^2 = n^2 + c^2 - 1."""
    c = mp.mpf(cos_d)
    g = mp.sqrt(mp.mpf(ior) ** 2 + c**2 - 1)
    ratio = (c * (g + c) - 1) / (c * (g - c) + 1)
    return ((g - c) / (g + c)) ** 2 * (1 + ratio**2) / 2


@pytest.mark.parametrize("form", [by_angles, by_cosines])
@pytest.mark.parametrize("ior", [1.0 + 1e-9, 1.33, 1.5, 3.4, 100.0])
def test_both_forms_of_the_lecture_are_this_one(form, ior):
    """Catches a reflectance that is neither of the two formulas that books print, up to 89.999 deg."""
    angles = np.radians([1e-4, 20.0, 45.0, 56.0, 80.0, 89.0, 89.999])
    with mp.workdps(DIGITS):
        for cos_d in np.cos(angles):
            theirs = form(cos_d, ior)
            assert abs(mp.mpf(float(dielectric(cos_d, ior))) - theirs) <= 1e-12 * theirs


@given(cos_d=st.floats(1e-6, 1.0), above_one=st.floats(1e-12, 99.0))
def test_agrees_with_50_digits(cos_d, above_one):
    """Catches cancellation: near n = 1 the textbook form has no digit left in double precision."""
    ior = 1.0 + above_one
    with mp.workdps(DIGITS), np.errstate(all="raise"):
        ours, slope = dielectric_with_slope(cos_d, ior)
        theirs = reference(cos_d, ior)
        assert abs(mp.mpf(float(ours)) - theirs) <= 1e-12 * theirs
        step = mp.mpf(10) ** -20 * (mp.mpf(ior) - 1)
        numeric = (reference(cos_d, mp.mpf(ior) + step) - reference(cos_d, mp.mpf(ior) - step)) / (2 * step)
        # The slope itself passes through zero; its natural size is F / (n - 1).
        assert abs(mp.mpf(float(slope)) - numeric) <= 1e-9 * max(abs(numeric), theirs / (mp.mpf(ior) - 1))


@pytest.mark.parametrize("ior", [1.0, 1.3, 1.5, 4.0])
def test_limits(ior):
    """Catches a wrong limit at normal or grazing incidence, or a NaN at either."""
    with np.errstate(all="raise"):
        at_normal, at_grazing = dielectric([1.0, 0.0], ior)
    assert at_normal == pytest.approx(float(normal_reflectance(ior)), rel=1e-14, abs=1e-300)
    assert at_grazing == pytest.approx(0.0 if ior == 1.0 else 1.0, abs=1e-14)


def test_brewster():
    """Catches swapped polarisations: at Brewster's angle only the perpendicular half is reflected."""
    ior = 1.5
    angle = np.arctan(ior)
    perpendicular = np.square((ior**2 - 1.0) / (ior**2 + 1.0))
    assert float(dielectric(np.cos(angle), ior)) == pytest.approx(perpendicular / 2.0, rel=1e-13)


def test_normal_reflectance_and_its_slope():
    """Catches a slope that would give ks_F0 a wrong uncertainty."""
    assert float(normal_reflectance(1.5)) == pytest.approx(0.04, rel=1e-14)
    numeric = (normal_reflectance(1.5 + 1e-6) - normal_reflectance(1.5 - 1e-6)) / 2e-6
    assert float(normal_reflectance_slope(1.5)) == pytest.approx(float(numeric), rel=1e-8)


def test_shapes_broadcast():
    """Catches a channel axis that is taken for a sample axis."""
    assert dielectric(np.full((7, 1), 0.5), [1.3, 1.5, 1.7]).shape == (7, 3)
