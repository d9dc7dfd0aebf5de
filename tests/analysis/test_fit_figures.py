"""Pictures of fits: what is chosen to be shown, the profiles, and that every kind of fit can be drawn."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.fit import fit
from analysis.fit_figures import COLUMNS, MOST_INCIDENCES, draw, incidences
from analysis.models import MODELS
from analysis.profiles import profile
from analysis.ranking import rank
from analysis.samples import make_samples
from rig.angles import spherical_to_direction


def pairs(theta_i_deg, phi_deg=(0.0, 20.0, 160.0)):
    """Return directions of scans at some incidences, in the plane and off it."""
    theta_i, theta_o, phi = (
        np.radians(axis.ravel()) for axis in np.meshgrid(theta_i_deg, np.arange(0.0, 80.0, 5.0), phi_deg)
    )
    return spherical_to_direction(theta_i, np.full_like(theta_i, np.pi)), spherical_to_direction(theta_o, phi)


def surface(theta_i_deg, noise=0.02, **options):
    """Return samples of a GGX surface with noise."""
    wi, wo = pairs(theta_i_deg)
    exact = MODELS["ggx"](kd=[0.1, 0.3], ks=0.9, alpha=0.2, f0=0.05).evaluate(wi, wo)
    f_r = exact * (1.0 + noise * np.random.default_rng(1).standard_normal(exact.shape))
    return make_samples(wi, wo, f_r, **options)


def test_incidences_are_those_with_scans():
    """Catches stations that no sample belongs to, more than fit, and scans off the plane that are taken."""
    found, tolerance_deg = incidences(*pairs(np.arange(5.0, 80.0, 7.0)))
    assert len(found) == MOST_INCIDENCES
    assert np.degrees(found[0]) == pytest.approx(5.0)
    assert np.degrees(found[-1]) == pytest.approx(75.0)
    assert tolerance_deg == 0.25
    assert incidences(*pairs([30.0], phi_deg=[40.0, 90.0]))[0] == []


def test_incidences_a_little_off_the_plane_are_found_with_a_wider_tolerance():
    """Catches a picture without dots for a rig whose camera stands two degrees beside the plane."""
    found, tolerance_deg = incidences(*pairs([10.0, 40.0, 70.0], phi_deg=[1.9]))
    assert len(found) >= COLUMNS - 1
    assert tolerance_deg > 0.25


def test_a_profile_is_the_parabola_of_u_where_the_fit_is_nearly_linear():
    """Catches a rise in other units, a profile that holds the wrong shape, or one that is no minimum."""
    result = fit(surface([10.0, 40.0, 70.0], noise=1e-3), "ggx", loss="log")
    for row in (0, 1):
        found = profile(result, row)
        assert found is not None
        assert found.name == result.names[row][0]
        parabola = np.square((found.values - found.best) / found.u)
        np.testing.assert_allclose(found.rise, parabola, rtol=0.05, atol=0.02)


def test_every_kind_of_fit_can_be_drawn(tmp_path):
    """Catches a kind of model, of loss or of samples that breaks the picture."""
    samples = surface([10.0, 40.0, 70.0], channels=["450 nm", "650 nm"])
    fits = [*rank(samples, ["lambert", "factored"]), *rank(samples, ["ggx"], shape="per-channel")]
    for number, one in enumerate(fits):
        draw(tmp_path / f"{number}.png", one, ["450 nm", "650 nm"], title="made")
    wi, wo = pairs([30.0], phi_deg=[40.0, 90.0])
    f_r = MODELS["blinn-phong"]().evaluate(wi, wo)
    (one,) = rank(make_samples(wi, wo, f_r, u_noise=0.02 * f_r), ["blinn-phong"])
    draw(tmp_path / "3.png", one, ["mono"], title="made")
    for path in tmp_path.glob("*.png"):
        assert path.read_bytes().startswith(b"\x89PNG")
    assert len(list(tmp_path.glob("*.png"))) == 4
