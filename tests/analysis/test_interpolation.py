"""Interpolation: would catch smeared peaks, holes filled in silence, and an uncertainty that is not true."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.formats.scattered import usable
from analysis.interpolation import Interpolant
from analysis.interpolation.interpolant import places
from analysis.interpolation.isotropy import require_isotropic
from analysis.models import MODELS
from analysis.samples import read
from rig.angles import direction_to_spherical, spherical_to_direction
from rig.errors import BadInput, Refused

PAINT = MODELS["ggx"](kd=np.array([0.3, 0.1]), ks=0.6, alpha=0.15, f0=0.05)


def directions(count, seed, largest_deg=80.0, smallest_deg=0.0):
    """Draw directions that are even over a zone."""
    rng = np.random.default_rng(seed)
    theta = np.arccos(rng.uniform(*np.cos(np.radians([largest_deg, smallest_deg])), count))
    return spherical_to_direction(theta, rng.uniform(-np.pi, np.pi, count))


def layered(theta_deg, each, seed):
    """Draw directions with few polar angles of the light."""
    wi = np.repeat(spherical_to_direction(np.radians(theta_deg), 0.0), each, axis=0)
    return wi, directions(len(wi), seed)


@pytest.mark.parametrize("layers", [False, True])
def test_a_peak_is_followed_between_samples(layers):
    """Catches a trend that misses the lobe, and neighbours that are looked for in the wrong space."""
    wi, wo = (
        layered(np.arange(0.0, 81.0, 8.0), 600, 1) if layers else (directions(8000, 1), directions(8000, 2))
    )
    found = Interpolant(wi, wo, PAINT.evaluate(wi, wo))
    wi, wo = directions(1500, 3, 70.0), directions(1500, 4, 70.0)
    true = PAINT.evaluate(wi, wo)
    got = found(wi, wo)
    error = np.abs(got.f_r - true) / true
    assert np.median(error) < 0.005
    assert np.percentile(error, 95.0) < 0.05
    assert got.hole.mean() < 0.02


def test_samples_come_back():
    """Catches smoothing where no uncertainty asks for it."""
    wi, wo = directions(3000, 1), directions(3000, 2)
    f_r = PAINT.evaluate(wi, wo)
    np.testing.assert_allclose(Interpolant(wi, wo, f_r)(wi, wo).f_r, f_r, rtol=2e-2)


@pytest.mark.parametrize("layers", [False, True])
@pytest.mark.parametrize("noise", [0.003, 0.03, 0.2])
def test_uncertainty_is_that_of_samples_held_out(layers, noise):
    """Catches an uncertainty that forgets noise or distance, or counts either twice."""
    wi, wo = (
        layered(np.arange(0.0, 81.0, 5.0), 300, 5) if layers else (directions(5000, 5), directions(5000, 6))
    )
    rng = np.random.default_rng(7)
    true = PAINT.evaluate(wi, wo)
    u = noise * true
    f_r = true + u * rng.standard_normal(true.shape)
    held = rng.random(len(wi)) < 0.2
    found = Interpolant(wi[~held], wo[~held], f_r[~held], u_independent=u[~held])
    got = found(wi[held], wo[held])
    near = ~got.hole
    against_samples = ((got.f_r - f_r[held]) / np.hypot(got.u_f_r, u[held]))[near]
    against_truth = ((got.f_r - true[held]) / got.u_f_r)[near]
    assert 0.7 < np.sqrt(np.mean(np.square(against_samples))) < 1.4
    assert 0.55 < np.mean(np.abs(against_truth) < 1.0) < 0.85


def test_common_uncertainty_does_not_average_out():
    """Catches a reference's uncertainty that shrinks with the number of neighbours."""
    wi, wo = directions(2000, 8), directions(2000, 9)
    f_r = PAINT.evaluate(wi, wo)
    got = Interpolant(wi, wo, f_r, u_common=0.05 * f_r)(wi[:200], wo[:200])
    assert np.median(got.u_f_r / got.f_r) == pytest.approx(0.05, rel=0.1)


def test_holes_are_marked_and_nothing_else():
    """Catches values invented without a mark, and a mask that covers what was measured."""
    wi, wo = directions(8000, 10), directions(8000, 11)
    # A zone is missing for light and camera alike: reciprocity has nothing to give.
    theta_i, theta_o = (np.degrees(direction_to_spherical(w)[0]) for w in (wi, wo))
    seen = (np.abs(theta_i - 45.0) > 20.0) & (np.abs(theta_o - 45.0) > 20.0)
    found = Interpolant(wi[seen], wo[seen], PAINT.evaluate(wi[seen], wo[seen]))
    middle = directions(300, 12, 46.0, 44.0), directions(300, 13, 46.0, 44.0)
    assert found(*middle).hole.mean() > 0.7
    assert found(wi[seen][::10], wo[seen][::10]).hole.mean() < 0.01
    far = directions(300, 14, 89.9, 88.0), directions(300, 15, 89.9, 88.0)
    assert found(*far).hole.mean() > 0.9


def test_reciprocity_fills_what_the_exchanged_directions_know():
    """Catches a hole where the other way round was measured, and a loan that is not told."""
    wi, wo = directions(8000, 16, 35.0), directions(8000, 17, 80.0)
    found = Interpolant(wi, wo, PAINT.evaluate(wi, wo))
    wi, wo = directions(300, 18, 75.0, 45.0), directions(300, 19, 30.0)
    got = found(wi, wo)
    assert got.borrowed.mean() > 0.9
    assert not (got.borrowed & got.hole).any()
    true = PAINT.evaluate(wi, wo)
    assert np.median((np.abs(got.f_r - true) / true)[got.borrowed]) < 0.01


def test_one_side_of_the_plane_of_incidence_is_enough():
    """Catches a half of the sphere without values where the samples were folded."""
    wi, wo = layered([20.0, 30.0, 40.0], 800, 20)
    wo[:, 1] = np.abs(wo[:, 1])
    got = Interpolant(wi, wo, PAINT.evaluate(wi, wo))(wi[::7], wo[::7] * [1.0, -1.0, 1.0])
    assert not got.hole.any()
    np.testing.assert_allclose(got.f_r, PAINT.evaluate(wi[::7], wo[::7]), rtol=0.02)


def test_a_fan_in_the_plane_is_refused():
    """Catches a half space invented from one plane."""
    theta = np.radians(np.linspace(1.0, 80.0, 60))
    wo = spherical_to_direction(theta, np.pi)
    wi = np.broadcast_to(spherical_to_direction(0.3, 0.0), wo.shape)
    with pytest.raises(BadInput, match="one plane"):
        Interpolant(wi, wo, PAINT.evaluate(wi, wo))


def test_incidences_far_from_all_layers_are_holes():
    """Catches one incidence taken for all."""
    wi, wo = layered([30.0], 800, 21)
    found = Interpolant(wi, wo, PAINT.evaluate(wi, wo))
    wi, wo = layered([50.0], 200, 22)
    assert found(wi, wo).hole.mean() > 0.8


@pytest.mark.parametrize("grid", [True, False])
def test_anisotropic_samples_are_refused(grid):
    """Catches a brushed metal that is interpolated as if the light's azimuth did not matter."""
    rng = np.random.default_rng(3)
    if grid:
        theta_i, phi_i, theta_o, phi = (
            axis.ravel()
            for axis in np.meshgrid(
                np.radians([10.0, 40.0, 65.0]), np.radians([0, 45, 90]), np.radians(np.arange(4, 80, 8)),
                np.radians(np.arange(0.0, 360.0, 12.0)),
            )
        )  # fmt: skip
        phi_o = phi_i + phi
    else:
        theta_i, theta_o = np.arccos(rng.uniform(np.cos(1.3), 1.0, (2, 4000)))
        phi_i, phi_o = rng.uniform(-np.pi, np.pi, (2, 4000))
    wi, wo = spherical_to_direction(theta_i, phi_i), spherical_to_direction(theta_o, phi_o)
    noise = np.exp(0.02 * rng.standard_normal((len(wi), 1)))
    brushed = MODELS["ggx-anisotropic"](kd=0.1, ks=1.0, alpha_x=0.1, alpha_y=0.4, f0=0.3)
    with pytest.raises(Refused, match=r"anisotropic.*write a format of samples"):
        Interpolant(wi, wo, brushed.evaluate(wi, wo)[:, :1] * noise)
    paint = MODELS["ggx"](kd=0.1, ks=1.0, alpha=0.2, f0=0.3)
    Interpolant(wi, wo, paint.evaluate(wi, wo)[:, :1] * noise)


@pytest.mark.realdata
def test_real_isotropic_samples_are_not_refused(shared_data):
    """Catches a laboratory's sample that lies a little tilted, taken for anisotropic."""
    raw = shared_data / "rt300s" / "raw"
    blank = raw / "blank_v2o0_20250911.xls"
    tilted = read(raw / "NiTE_on_steel_v1o0B_20250916.xls", blank=blank)
    smooth = [read(shared_data / "merl-standins" / f"{name}-fabric.npz") for name in ("light-brown", "white")]
    for given in map(usable, [tilted, *smooth]):
        require_isotropic(places(given.wi, given.wo), given.wi, given.f_r)
