"""Readings that are one within noise: neither a peak elsewhere, nor a factor, nor other directions pass."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.angle_table import AngleTable
from analysis.doctor import same_within_noise
from analysis.doctor_readings import Reading, Step
from analysis.models import MODELS
from rig.angles import spherical_to_direction

NOISE = 0.03


def _surface(alpha=None, noise=NOISE, stated=None, azimuths=(-np.pi, np.pi), count=600):
    """Return a Lambertian surface, or one with a lobe, on random directions and three incidences."""
    random = np.random.default_rng(5)
    theta_i = random.choice(np.radians([20.0, 40.0, 60.0]), count)
    theta_o, phi_o = random.uniform(0.05, 1.2, count), random.uniform(*azimuths, count)
    f_r = np.full((count, 1), 0.2 / np.pi)
    if alpha is not None:
        wi, wo = spherical_to_direction(theta_i, np.zeros(count)), spherical_to_direction(theta_o, phi_o)
        f_r = MODELS["ggx"](kd=0.2, ks=1.0, alpha=alpha, f0=0.04).evaluate(wi, wo)[:, :1]
    f_r = f_r * np.exp(noise * random.standard_normal((count, 1)))
    facts = {} if stated is None else {"u_f_r": stated * f_r}
    return AngleTable(theta_i, np.zeros(count), theta_o, phi_o, f_r, facts)


@pytest.mark.parametrize("stated", [None, NOISE])
def test_a_diffuser_looks_the_same_from_the_other_side(stated):
    """Catches readings held apart that no measurement of this surface tells apart."""
    table = _surface(stated=stated)
    assert same_within_noise(table, Reading(), Reading((Step.OPPOSITE,)))
    assert same_within_noise(table, Reading(), Reading((Step.SWAPPED,)))


@pytest.mark.parametrize("stated", [None, NOISE])
@pytest.mark.parametrize("alpha", [0.08, 0.3])
def test_a_peak_elsewhere_is_a_difference(alpha, stated):
    """Catches a lobe on the other side that is lost among the many samples of the diffuser."""
    table = _surface(alpha=alpha, stated=stated)
    assert not same_within_noise(table, Reading(), Reading((Step.OPPOSITE,)))


def test_a_cosine_is_a_difference_unless_noise_hides_it():
    """Catches values called the same that a factor parts, and a stated uncertainty that is not used."""
    cosine = Reading((Step.OVER_COS_O,))
    assert not same_within_noise(_surface(), Reading(), cosine)
    assert not same_within_noise(_surface(stated=NOISE), Reading(), cosine)
    assert same_within_noise(_surface(stated=2.0), Reading(), cosine)


def test_a_common_factor_is_a_difference():
    """Catches values that are compared up to a factor: one incidence turns cos(theta_i) into one."""
    table = _surface()
    table = AngleTable(np.full(600, 1.0), table.phi_i, table.theta_o, table.phi_o, table.f_r)
    assert not same_within_noise(table, Reading(), Reading((Step.WITH_COS_I,)))


def test_other_directions_are_no_agreement():
    """Catches readings called the same because nothing of them can be compared."""
    forward = _surface(azimuths=(np.pi - 0.4, np.pi + 0.4))
    assert not same_within_noise(forward, Reading(), Reading((Step.OPPOSITE,)))
