"""Mixtures of lobes: they describe what no single lobe does, and never less well than one."""

from __future__ import annotations

import numpy as np

from analysis.doctor_lobes import Lobes
from analysis.models import MODELS
from rig.angles import spherical_to_direction


def _directions(count=300):
    random = np.random.default_rng(2)
    wi = spherical_to_direction(random.uniform(0.0, 1.2, count), np.zeros(count))
    return wi, spherical_to_direction(random.uniform(0.0, 1.2, count), random.uniform(0.0, 6.3, count))


def test_two_lobes_over_a_diffuser():
    """Catches a mixture that stays at its start: two lobes leave nothing, the best single one much."""
    wi, wo = _directions()
    wide = MODELS["ggx"](kd=0.1, ks=1.0, alpha=0.45, f0=0.04).evaluate(wi, wo)[:, 0]
    narrow = MODELS["ggx"](kd=0.0, ks=1.0, alpha=0.06, f0=0.3).evaluate(wi, wo)[:, 0]
    lobes = Lobes.at(wi, wo, np.ones(len(wi)))
    log_f = np.log(wide + narrow)
    single, mixture = (float(np.std(lobes.residual(log_f, mixture=mixed))) for mixed in (False, True))
    assert single > 0.05
    assert mixture < 0.2 * single


def test_a_factor_changes_nothing():
    """Catches a misfit that depends on the unit of the values."""
    wi, wo = _directions()
    lobes = Lobes.at(wi, wo, np.ones(len(wi)))
    log_f = np.random.default_rng(0).normal(size=len(wi))
    first, second = (lobes.residual(log_f + shift, mixture=True) for shift in (0.0, 9.0))
    np.testing.assert_allclose(first, second, atol=1e-6)
    assert np.square(first).sum() <= np.square(lobes.residual(log_f, mixture=False)).sum()


def test_lobes_that_no_sample_sees():
    """Catches no number out of lobes so narrow that their squares vanish, far from the mirror direction."""
    theta = np.linspace(1.0, 1.4, 40)
    wi = spherical_to_direction(theta, np.zeros(40))
    wo = spherical_to_direction(theta[::-1], np.full(40, 0.01))
    residual = Lobes.at(wi, wo, np.ones(40)).residual(np.sin(7.0 * theta), mixture=True)
    assert np.isfinite(residual).all()
