"""What samples cannot tell is said: narrow lobes, parameters that trade; and nothing where they can."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.fit import fit
from analysis.identifiability import Kind, correlation_matrix, grid_step, half_width
from analysis.models import MODELS
from analysis.models.base import Geometry
from analysis.problem import Problem
from analysis.samples import make_samples, read, select
from analysis.wide_lobes import without_diffuse
from rig.angles import spherical_to_direction

WIDTH = {"ggx": "alpha", "cook-torrance": "m", "cook-torrance-schlick": "m"}


def grid(step_deg=10.0):
    """Return a laboratory's grid: both polar angles, and azimuths three steps apart."""
    polar, azimuth = (
        np.radians(np.arange(0.0, 81.0, step_deg)),
        np.radians(np.arange(0.0, 181.0, 3 * step_deg)),
    )
    theta_i, theta_o, phi = (axis.ravel() for axis in np.meshgrid(polar, polar, azimuth))
    return spherical_to_direction(theta_i, np.full_like(theta_i, np.pi)), spherical_to_direction(theta_o, phi)


def anywhere(count, seed, theta_i=None):
    """Return random pairs; theta_i fixes the light."""
    random = np.random.default_rng(seed)
    light = np.arccos(random.uniform(0.2, 1.0, count)) if theta_i is None else np.full(count, theta_i)
    wi = spherical_to_direction(light, np.zeros(count))
    return wi, spherical_to_direction(
        np.arccos(random.uniform(0.2, 1.0, count)), random.uniform(0.0, 2.0 * np.pi, count)
    )


def drawn(name, wi, wo, *, noise=0.01, seed=0, **parameters):
    """Return samples of a model with relative noise."""
    f_r = MODELS[name](**parameters).evaluate(wi, wo)
    noisy = f_r * (1.0 + noise * np.random.default_rng(seed).standard_normal(f_r.shape))
    return make_samples(wi, wo, noisy, u_noise=noise * f_r)


def kinds(result):
    """Return what a fit warns of."""
    return {caution.kind for caution in result.cautions}


@pytest.mark.parametrize("name", ["ggx", "cook-torrance"])
@pytest.mark.parametrize("width", [0.006, 0.02, 0.04, 0.06, 0.08])
def test_a_lobe_narrower_than_the_grid_has_no_certain_width(name, width):
    """Catches 0.006 +- 0.000: a width below half the grid's step of 0.175 that is reported as known."""
    other = {"f0": 0.04} if name == "ggx" else {"ior": 1.5}
    result = fit(drawn(name, *grid(), kd=0.2, ks=1.0, **{WIDTH[name]: width}, **other), name, loss="log")
    assert kinds(result) & {Kind.NARROW_LOBE, Kind.AT_BOUND}
    assert np.isinf(result.u[WIDTH[name]])
    assert np.all(np.isinf(result.u["ks"]))
    assert WIDTH[name] in result.message


@pytest.mark.parametrize("name", ["ggx", "cook-torrance"])
@pytest.mark.parametrize("width", [0.15, 0.3])
def test_a_lobe_that_the_grid_resolves_is_not_doubted(name, width):
    """Catches a warning that is always there, and so is read by nobody."""
    other = {"f0": 0.04} if name == "ggx" else {"ior": 1.5}
    result = fit(drawn(name, *grid(), kd=0.2, ks=1.0, **{WIDTH[name]: width}, **other), name)
    assert result.cautions == ()
    assert result.u[WIDTH[name]] < 0.01 * width


def in_plane(step_i_deg, step_o_deg):
    """Return pairs in the plane of incidence alone."""
    theta_i, theta_o = (
        np.radians(axis.ravel())
        for axis in np.meshgrid(np.arange(step_i_deg, 71.0, step_i_deg), np.arange(-80.0, 81.0, step_o_deg))
    )
    wi = spherical_to_direction(theta_i, np.full_like(theta_i, np.pi))
    return wi, spherical_to_direction(np.abs(theta_o), np.where(theta_o < 0.0, np.pi, 0.0))


def some_lights(lights, each):
    """Return scattered directions of view under a few directions of light."""
    random = np.random.default_rng(0)
    theta_i = np.repeat(np.arccos(random.uniform(0.3, 1.0, lights)), each)
    return spherical_to_direction(theta_i, np.full_like(theta_i, np.pi)), spherical_to_direction(
        np.arccos(random.uniform(0.2, 1.0, lights * each)), random.uniform(0.0, 2.0 * np.pi, lights * each)
    )


LABORATORIES = {
    "grid of 5 deg": (grid(5.0), 5.0),
    "grid of 15 deg": (grid(15.0), 15.0),
    "in plane, 5 deg": (in_plane(10.0, 5.0), 5.0),
    "in plane, 2 deg": (in_plane(15.0, 2.0), 2.0),
    "nine lights": (some_lights(9, 100), 6.0),
    "anywhere": (anywhere(800, 5), 6.0),
}
"""Directions, and their step in degrees, of scattered ones about that to the nearest neighbour."""


@pytest.mark.parametrize("name", ["ggx", "cook-torrance"])
@pytest.mark.parametrize("directions", LABORATORIES)
def test_laboratories_of_other_kinds(directions, name):
    """Catches limits made for one grid: below a third of a step doubted everywhere, wide lobes nowhere."""
    (wi, wo), step_deg = LABORATORIES[directions]
    other = {"f0": 0.04} if name == "ggx" else {"ior": 1.5}
    truth = {"kd": 0.2, "ks": 1.0} | other
    narrow = fit(drawn(name, wi, wo, **truth, **{WIDTH[name]: np.radians(0.3 * step_deg)}), name)
    assert not narrow.u[WIDTH[name]] < 0.5 * narrow.parameters[WIDTH[name]]
    assert any(WIDTH[name] in caution.parameters for caution in narrow.cautions)
    for width in (0.2, 0.3):
        wide = fit(drawn(name, wi, wo, **truth, **{WIDTH[name]: width}), name)
        assert wide.cautions == ()
        assert wide.parameters[WIDTH[name]] == pytest.approx(width, rel=0.02)


def test_a_finer_grid_resolves_what_a_coarse_one_does_not():
    """Catches a limit that does not know the step."""
    truth = {"kd": 0.2, "ks": 1.0, "alpha": 0.06, "f0": 0.04}
    doubted = [Kind.NARROW_LOBE in kinds(fit(drawn("ggx", *grid(step), **truth), "ggx")) for step in (10, 4)]
    assert doubted == [True, False]


def test_a_rough_lobe_is_told_from_lambert_or_named():
    """Catches kd and ks given apart where the lobe is nearly Lambert's."""
    for alpha, named in ((0.2, False), (0.3, False), (0.8, True), (1.2, True)):
        samples = drawn("ggx", *anywhere(600, 0), kd=0.2, ks=1.0, alpha=alpha, f0=0.04)
        result = fit(samples, "ggx")
        assert (Kind.KD_KS in kinds(result)) is named, alpha
        assert ("kd and ks trade" in result.message) is named


@pytest.mark.parametrize("name", ["ggx", "cook-torrance", "cook-torrance-schlick"])
def test_normal_incidence_alone_holds_only_ks_f0(name):
    """Catches an index or F0 to three digits where only its product with ks shows."""
    parameter, truth = ("ior", 1.5) if name == "cook-torrance" else ("f0", 0.04)
    wi, wo = anywhere(300, 1, theta_i=0.0)
    samples = drawn(name, wi, wo, kd=0.2, ks=1.0, **{WIDTH[name]: 0.2, parameter: truth})
    result = fit(samples, name)
    assert "only ks_F0 is meaningful" in result.message
    assert any(parameter in caution.parameters for caution in result.cautions)
    assert not result.u["ks"][0] < 0.5 * result.parameters["ks"][0]
    value, u = result.derived["ks_F0"]
    assert u[0] < 0.1 * value[0]
    assert value[0] == pytest.approx(0.04, rel=0.05)


def test_all_incidences_tell_ks_from_f0():
    """Catches a degeneracy that is named where there is none."""
    result = fit(drawn("ggx", *anywhere(600, 2), kd=0.2, ks=0.7, alpha=0.25, f0=0.06), "ggx")
    assert result.cautions == ()
    for name, truth in (("ks", 0.7), ("f0", 0.06)):
        assert abs(result.parameters[name] - truth) < 4.0 * result.u[name]
    value, u = result.derived["ks_F0"]
    assert abs(value[0] - 0.042) < 4.0 * u[0]


def test_half_widths_are_those_of_the_formulas():
    """Catches a width in the wrong unit, or of the wrong angle."""
    problem = Problem(MODELS["cook-torrance"], Geometry(*anywhere(5, 0)), 1)
    # exp(-tan^2/m^2) = 1/2, far below the angles at which cos^-4 or G matter.
    expected = np.arctan(0.05 * np.sqrt(np.log(2.0)))
    assert half_width(problem, np.array([np.log(0.05), np.log(0.5)])) == pytest.approx(expected, rel=0.03)
    rough = half_width(problem, np.array([np.log(3.0), np.log(0.5)]))
    assert rough > 1.0


def test_the_step_of_a_grid():
    """Catches a step made from pairs with different lights, and one invented for scattered directions."""
    wi, wo = grid()
    half = (wi + wo) / np.linalg.norm(wi + wo, axis=1, keepdims=True)
    assert np.degrees(grid_step(wi, wo, np.arccos(half[:, 2]))) == pytest.approx(10.0, abs=0.1)
    wi, wo = anywhere(500, 3)
    assert grid_step(wi, wo, np.zeros(500)) == 0.0
    assert grid_step(wi, wo, np.full(500, 1.0)) == 0.0


def test_correlations_of_what_is_not_known():
    """Catches infinities that become numbers."""
    covariance = np.array([[4.0, -1.0, np.inf], [-1.0, 1.0, np.inf], [np.inf, np.inf, np.inf]])
    found = correlation_matrix(covariance)
    np.testing.assert_allclose(found[:2, :2], [[1.0, -0.5], [-0.5, 1.0]])
    assert np.isnan(found[2]).all()


@pytest.mark.realdata
@pytest.mark.parametrize("paint", ["garnet_red", "krylon_blue"])
def test_real_paints_are_resolved_by_their_grid(shared_data, paint):
    """Catches a doubt about paints of alpha 0.14 and 0.19 on a grid of 10 deg, which hold it well."""
    samples = select(read(shared_data / "cornell" / f"{paint}.brdf"), wavelength_nm=[550.0])
    assert fit(samples, "ggx").cautions == ()


ROUGH = [
    *(("ggx", {"alpha": alpha, "f0": 0.05}) for alpha in (0.7, 0.85, 1.0)),
    *(("beckmann", {"m": m, "f0": 0.05}) for m in (0.7, 0.9, 1.5)),
    *(("cook-torrance", {"m": m, "ior": 1.5}) for m in (0.7, 1.2)),
]
GLOSSY = [
    *(("ggx", {"alpha": alpha, "f0": 0.05}) for alpha in (0.15, 0.25, 0.4)),
    *(("beckmann", {"m": m, "f0": 0.05}) for m in (0.2, 0.4)),
    ("cook-torrance", {"m": 0.3, "ior": 1.5}),
    ("blinn-phong", {"exponent": 30.0}),
    ("lafortune-retro", {"exponent": 40.0}),
]
DESIGNS = {
    "grid of 10 deg": grid(),
    "in plane, 5 deg": in_plane(15.0, 5.0),
    "two lights": some_lights(2, 60),
    "anywhere": anywhere(300, 5),
}


@pytest.mark.parametrize("noise", [0.01, 0.05])
@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize(("name", "shapes"), ROUGH)
def test_a_lobe_like_lamberts_is_named_however_it_was_measured(name, shapes, design, noise):
    """Catches kd and ks of a rough surface that pass without a word: their correlation alone is small."""
    result = fit(drawn(name, *DESIGNS[design], kd=0.2, ks=0.8, noise=noise, **shapes), name)
    assert kinds(result) & {Kind.KD_KS, Kind.NO_LOBE}
    assert "kd" in result.message or "no specular lobe" in result.message


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("design", ["grid of 10 deg", "in plane, 5 deg", "anywhere"])
@pytest.mark.parametrize(("name", "shapes"), GLOSSY)
def test_an_ordinary_lobe_is_not_called_wide(name, shapes, design, seed):
    """Catches a caution about kd and ks that is always there."""
    result = fit(drawn(name, *DESIGNS[design], kd=0.2, ks=0.8, seed=seed, noise=0.03, **shapes), name)
    assert Kind.KD_KS not in kinds(result)


def test_the_caution_says_what_the_diffuse_term_is_good_for():
    """Catches a growth of the residual that is not that of a fit without kd."""
    samples = drawn("beckmann", *grid(), kd=0.2, ks=0.8, m=0.9, f0=0.05, noise=0.02)
    result = fit(samples, "beckmann")
    block = result.state.blocks[0]
    grown = without_diffuse(block)
    assert f"{grown:.3g} times" in result.message
    assert grown > 5.0
    bare = fit(drawn("beckmann", *grid(), kd=0.0, ks=0.8, m=0.9, f0=0.05, noise=0.02), "beckmann")
    assert without_diffuse(bare.state.blocks[0]) == pytest.approx(1.0, abs=0.01)
