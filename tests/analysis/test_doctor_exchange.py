"""Reciprocity between neighbours of exchanged directions: what a wrong cosine does to it, and what noise."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.angle_table import table_of
from analysis.doctor import diagnose
from analysis.doctor_exchange import Exchange
from analysis.models import MODELS
from analysis.samples import make_samples
from rig.angles import spherical_to_direction

PAINT = MODELS["ggx"](kd=0.1, ks=0.8, alpha=0.3, f0=0.1)


def _scattered(count=1500, largest_deg=75.0):
    """Draw pairs of directions of which no two are exchanged."""
    random = np.random.default_rng(5)
    theta = np.arccos(random.uniform(np.cos(np.radians(largest_deg)), 1.0, (2, count)))
    return spherical_to_direction(theta, random.uniform(-np.pi, np.pi, (2, count)))


@pytest.mark.parametrize(
    ("light", "view", "power"), [(0, 0, 0.0), (0, 1, -0.5), (1, 0, 0.5), (1, -1, 1.0), (1, 1, 0.0)]
)
def test_a_wrong_cosine_shows_as_its_power(light, view, power):
    """Catches a sign that is exchanged, a factor of two, and a cosine that hides between two samples."""
    wi, wo = _scattered()
    noise = 1.0 + 0.05 * np.random.default_rng(6).standard_normal(len(wi))
    f_r = PAINT.evaluate(wi, wo)[:, 0] * wi[:, 2] ** light * wo[:, 2] ** view * noise
    found = Exchange.at(wi, wo, np.ones(len(wi))).asymmetry(np.log(f_r))
    assert found.power == pytest.approx(power, abs=0.08)
    assert 0.1 <= found.uncertainty < 0.25
    assert (found.log_likelihood < -3.0) == (power != 0.0)


def test_where_nothing_tells():
    """Catches a number made of no pairs: light at one angle, or at the views' own angles only."""
    wo = spherical_to_direction(np.radians(np.arange(40.0)), np.zeros(40))
    wi = np.broadcast_to(spherical_to_direction(0.9, np.pi), wo.shape)
    nothing = Exchange.at(wi, wo, np.ones(40)).asymmetry(np.zeros(40))
    assert np.isnan(nothing.power)
    assert nothing.log_likelihood == 0.0
    alike = Exchange.at(wo, wo, np.ones(40)).asymmetry(np.zeros(40))
    assert alike.log_likelihood == 0.0


def test_clipped_noise_does_not_decide():
    """Catches dark values, of which half were clipped at 0, that pass for a cosine of view."""
    wi, wo = _scattered(3000)
    random = np.random.default_rng(7)
    true = MODELS["ggx"](kd=0.0, ks=1.0, alpha=0.12, f0=0.9).evaluate(wi, wo)[:, 0]
    floor = np.quantile(true, 0.4)
    # Noise that grows towards grazing views, as where values were divided by the cosine.
    read = true + floor * random.standard_normal(len(true)) / wo[:, 2] ** 2
    clipped = make_samples(wi, wo, np.maximum(read, 0.0))
    assert (clipped["f_r"] == 0.0).mean() > 0.1
    assert diagnose(table_of(clipped)).as_declared
