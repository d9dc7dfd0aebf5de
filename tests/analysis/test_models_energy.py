"""Energy and reciprocity over the whole box of shapes, by adaptive quadrature: what classes promise."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.models import MODELS
from benchmarks.models_energy import (
    ALBEDO_TARGET,
    GRAZING_DEG,
    RECIPROCITY_TARGET,
    albedo,
    integral,
    largest_albedo,
    projected_areas,
    reciprocity,
)


def test_normalised_distributions_cover_the_surface_once():
    """Catches a distribution whose facets cover more, or less, than the surface, from 0.001 to 3."""
    for name, area in projected_areas().items():
        assert area == pytest.approx(1.0, abs=1e-6), name


def test_the_quadrature_finds_a_needle():
    """Catches a quadrature that misses narrow lobes, and so finds that every model conserves energy."""
    width, theta, phi = 1e-4, 1.1, 0.7
    tip = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])

    def needle(directions):
        return np.exp(-np.sum(np.square(directions - tip), axis=-1) / width**2) / (np.pi * width**2)

    assert integral(needle, theta, phi) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("name", [name for name in MODELS if MODELS[name].CONSERVES])
def test_what_conserves_energy_reflects_no_more_than_its_scale(name):
    """Catches a term that creates light for some direction or shape, which a fit would take as true."""
    angles_deg = (0.0, GRAZING_DEG) if MODELS[name].ISOTROPIC else (0.0,)
    found = largest_albedo(MODELS[name], draws=2, angles_deg=angles_deg)
    assert found.albedo <= ALBEDO_TARGET, found


@pytest.mark.parametrize("roughness", [0.1, 1.0])
@pytest.mark.parametrize("theta_deg", [0.0, 60.0, GRAZING_DEG])
def test_white_facets_of_eon_lose_nothing(roughness, theta_deg):
    """Catches an error of the closed form of the albedo: with it, all light comes out at every angle."""
    white = MODELS["eon"](kd=1.0, roughness=roughness, facet_albedo=1.0)
    assert albedo(white, theta_deg) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("exponent", [0.1, 1.0, 20.0, 1e3, 1e6])
@pytest.mark.parametrize("name", ["modified-phong", "blinn-phong"])
def test_normalised_lobes_reflect_what_ks_says(name, exponent):
    """Catches a normalisation that is off: ks is the albedo at normal incidence, where it is largest."""
    model = MODELS[name](kd=0.0, ks=0.8, exponent=exponent)
    assert albedo(model, 0.0) == pytest.approx(0.8, abs=1e-6)
    assert albedo(model, 50.0) < 0.8


@pytest.mark.parametrize("m", [0.003, 0.1, 0.4])
def test_the_microfacet_lobe_conserves_energy(m):
    """Catches a missing 4 or pi in Cook-Torrance: facets that are mirrors reflect nearly all."""
    model = MODELS["cook-torrance"](kd=0.0, ks=1.0, m=m, ior=1e6)
    assert 0.93 < albedo(model, 0.0) <= ALBEDO_TARGET


@pytest.mark.parametrize("name", [name for name in MODELS if MODELS[name].RECIPROCAL])
def test_light_and_camera_may_change_places(name):
    """Catches an asymmetry between light and camera, up to 89.999 deg and over the box of shapes."""
    assert reciprocity(MODELS[name], draws=10) <= RECIPROCITY_TARGET


@pytest.mark.parametrize("name", [name for name in MODELS if not MODELS[name].RECIPROCAL])
def test_what_is_called_not_reciprocal_is_not(name):
    """Catches a model that is reciprocal and listed among those that are not."""
    assert reciprocity(MODELS[name], draws=2, steepest_deg=80.0) > 1e-3


@pytest.mark.parametrize("name", [name for name in MODELS if name.startswith("torrance-sparrow")])
def test_classical_distributions_are_one_at_their_peak(name):
    """Catches a classical D with a norm: at normal incidence the lobe is F, whatever the width."""
    widths = np.array([0.003, 0.3, 1.2])
    model = MODELS[name](kd=0.0, ks=1.0, half_width_rad=widths, ior=1.5)
    np.testing.assert_allclose(model.evaluate([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]), [0.04] * 3, rtol=1e-13)
