"""Checks of samples: each finds the defect it is for, and passes without it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from analysis.checks import Verdict, check, worst
from analysis.samples import make_samples, read
from rig.angles import mirror, spherical_to_direction

MATERIALS = (
    "Alu sandgestrahlt",
    "Edelstahl gebürstet",
    "Kupfer",
    "Referenzlack (Glatt)",
    "Referenzlack (Rau)",
    "Verzinkter Stahl",
)


def _grid(step_phi=30.0):
    theta = np.arange(5.0, 86.0, 10.0)
    phi = np.arange(0.0, 360.0, step_phi)
    theta_i, theta_o, phi_o = (np.radians(axis.ravel()) for axis in np.meshgrid(theta, theta, phi))
    return spherical_to_direction(theta_i, np.pi), spherical_to_direction(theta_o, phi_o)


def _value(wi, wo):
    """Return a reciprocal lobe about the mirror direction, nowhere constant."""
    return 0.05 + 0.2 * np.exp(3.0 * (np.sum(mirror(wi) * wo, axis=1) - 1.0))


def _found(samples, name):
    return next(finding for finding in check(samples) if finding.name == name)


def test_a_good_sample_passes():
    """Catches false alarms: an exact reciprocal, energy-conserving model on a grid."""
    wi, wo = _grid()
    findings = check(make_samples(wi, wo, _value(wi, wo), u_f_r=np.full(len(wi), 1e-3)))
    assert worst(findings) is Verdict.PASS
    by_name = {finding.name: finding for finding in findings}
    assert by_name["reciprocity"].value < 1e-9
    assert by_name["reciprocity"].count > 100
    assert by_name["mirror symmetry"].verdict is Verdict.PASS
    assert by_name["noise"].value < 1e-6


@pytest.mark.parametrize(("power", "hint"), [(1, "cos.* inside"), (-1, "divided by cos")])
def test_a_cosine_breaks_reciprocity(power, hint):
    """Catches a cosine that goes unnamed."""
    wi, wo = _grid()
    finding = _found(make_samples(wi, wo, _value(wi, wo) * wo[:, 2] ** power), "reciprocity")
    assert finding.verdict is Verdict.FAIL
    assert re.search(hint, finding.meaning)
    assert "without it 0.0%" in finding.meaning


def test_energy_of_a_diffuser():
    """Catches a wrong projected solid angle: albedo 0.9 passes with its number, 1.2 fails, a gap is said."""
    wi, wo = _grid()
    ninety = _found(make_samples(wi, wo, np.full(len(wi), 0.9 / np.pi)), "energy")
    # 85 deg is the outermost ring, and 12 chords stand for each circle.
    assert ninety.value == pytest.approx(0.9 * 12 / (2 * np.pi) * np.sin(np.pi / 6), rel=0.02)
    assert ninety.verdict is Verdict.PASS
    assert "95%" in ninety.quantity
    assert _found(make_samples(wi, wo, np.full(len(wi), 1.2 / np.pi)), "energy").verdict is Verdict.FAIL
    near = wo[:, 2] > 0.8
    narrow = _found(make_samples(wi[near], wo[near], np.full(near.sum(), 9.0)), "energy")
    assert narrow.verdict is Verdict.NOT_TESTED
    assert "no albedo" in narrow.meaning


def test_symmetries():
    """Catches an azimuth's offset and an anisotropic sample that pass."""
    wi, wo = _grid()
    turned = wo @ np.array([[0.94, 0.342, 0], [-0.342, 0.94, 0], [0, 0, 1]])
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    sharp = np.exp(8.0 * np.sum(wi * [-1, -1, 1] * turned, axis=1))
    assert _found(make_samples(wi, wo, sharp), "mirror symmetry").verdict is Verdict.FAIL
    stage = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    both = np.concatenate([wi, wi @ stage.T]), np.concatenate([wo, wo @ stage.T])
    same = np.concatenate([_value(wi, wo)] * 2)
    assert _found(make_samples(*both, same), "isotropy").verdict is Verdict.PASS
    brushed = same * np.repeat([1.0, 1.5], len(wi))
    finding = _found(make_samples(*both, brushed), "isotropy")
    assert finding.verdict is Verdict.WARN
    assert finding.value == pytest.approx(1.0 / 3.0)


def test_rows():
    """Catches copies, bad repeats, negatives and floors that go unnoticed, each with its share."""
    wi, wo = _grid()
    value = _value(wi, wo)
    twice = np.concatenate([wi, wi[:50]]), np.concatenate([wo, wo[:50]])
    copied = make_samples(*twice, np.concatenate([value, value[:50]]))
    assert _found(copied, "duplicates").count == 50
    repeated = make_samples(*twice, np.concatenate([value, value[:50] * 1.1]))
    assert _found(repeated, "duplicates").verdict is Verdict.PASS
    assert _found(repeated, "repeatability").value == pytest.approx(1.0 - 1.0 / 1.1)
    low = value - np.quantile(value, 0.05)
    assert _found(make_samples(wi, wo, low), "negatives").value == pytest.approx(0.05, abs=0.005)
    clipped = _found(make_samples(wi, wo, np.maximum(low, 0.0)), "clipped values")
    assert clipped.value == pytest.approx(0.05, abs=0.005)
    assert clipped.verdict is Verdict.WARN


@pytest.mark.parametrize(
    ("factor", "verdict"), [(1.1, Verdict.PASS), (1.6, Verdict.WARN), (3.0, Verdict.FAIL)]
)
def test_one_incidence_at_another_level(factor, verdict):
    """Catches a lamp that was turned up for one incidence, which the median over all pairs does not show."""
    wi, wo = _grid()
    one = np.isclose(wi[:, 2], np.cos(np.radians(35.0)))
    finding = _found(make_samples(wi, wo, _value(wi, wo) * np.where(one, factor, 1.0)), "levels")
    assert finding.verdict is verdict
    assert finding.value == pytest.approx(1.0 - 1.0 / factor, rel=1e-6)
    if verdict is not Verdict.PASS:
        assert finding.where.startswith("incidence near 35 deg")
        assert finding.where.endswith("too high")
        np.testing.assert_array_equal(finding.samples, np.flatnonzero(one))


def test_ends():
    """Catches a saturated channel, a floor of one channel only, zeros everywhere, and lost numbers."""
    wi, wo = _grid()
    value = np.stack([_value(wi, wo), 2.0 * _value(wi, wo)], axis=1)
    assert _found(make_samples(wi, wo, value), "clipped values").verdict is Verdict.PASS
    ceiling = np.minimum(value, [np.inf, np.quantile(value[:, 1], 0.95)])
    saturated = _found(make_samples(wi, wo, ceiling), "clipped values")
    assert saturated.verdict is Verdict.WARN
    assert saturated.value == pytest.approx(0.05, abs=0.005)
    assert "a ceiling of" in saturated.meaning
    assert saturated.where.startswith("channel 1")
    floor = np.maximum(value, [np.quantile(value[:, 0], 0.3), 0.0])
    assert _found(make_samples(wi, wo, floor), "clipped values").verdict is Verdict.FAIL
    assert _found(make_samples(wi, wo, 0.0 * value), "clipped values").verdict is Verdict.FAIL
    assert _found(make_samples(wi, wo, 0.0 * value + 1.0), "clipped values").verdict is Verdict.PASS
    lost = make_samples(wi, wo, np.where(np.arange(len(wi))[:, None] == 7, np.nan, value))
    assert _found(lost, "missing values").verdict is Verdict.WARN
    assert _found(lost, "missing values").where == "sample 7"
    lost["flags"][7] = 1
    assert _found(lost, "missing values").verdict is Verdict.PASS


def test_noise_against_the_stated_uncertainty():
    """Catches an uncertainty that is ten times too small."""
    wi, wo = _grid()
    noisy = _value(wi, wo) + 0.01 * np.random.default_rng(0).standard_normal(len(wi))
    honest = _found(make_samples(wi, wo, noisy, u_f_r=np.full(len(wi), 0.01)), "noise")
    assert honest.value == pytest.approx(1.0, rel=0.15)
    small = _found(make_samples(wi, wo, noisy, u_f_r=np.full(len(wi), 0.001)), "noise")
    assert small.verdict is Verdict.FAIL


@pytest.mark.parametrize("count", [0, 1, 5])
def test_few_samples(count):
    """Catches a traceback where there is next to nothing, or nothing usable, to check."""
    wi, wo = _grid()
    samples = make_samples(wi[:count], wo[:count], np.full(count, 0.1))
    assert worst(check(samples)) is not Verdict.FAIL
    samples["flags"][:] = 1
    assert worst(check(samples)) is not Verdict.FAIL


@pytest.mark.realdata
@pytest.mark.parametrize("material", MATERIALS)
def test_the_published_cosine_is_found(shared_data, material):
    """Catches that the mid-infrared instrument's published formula passes, or that its cure does not show."""
    path = shared_data / "mwir" / "radiance.csv"
    published = _found(read(path, material=material, as_published=True), "reciprocity")
    assert published.verdict is Verdict.FAIL
    assert 0.38 < published.value < 0.48
    assert "cos(theta_o) seems to be inside" in published.meaning
    cured = _found(read(path, material=material), "reciprocity")
    assert cured.verdict is not Verdict.FAIL
    assert cured.value < 0.5 * published.value
    if "Glatt" not in material and "Stahl" not in material:
        assert cured.value < 0.102


def _scan(random, noise=0.02, turn_deg=0.0):
    """Return directions and values of a rough surface as an instrument scans it, with an azimuth's offset."""
    theta_i, theta_o, phi = np.meshgrid(
        np.radians([10.0, 30.0, 50.0, 70.0]), np.radians(np.arange(5.0, 81.0, 7.5)), np.arange(0.0, 6.2, 0.21)
    )
    wi = spherical_to_direction(theta_i.ravel(), np.full(theta_i.size, 0.3))
    true = spherical_to_direction(theta_o.ravel(), phi.ravel())
    seen = spherical_to_direction(theta_o.ravel(), phi.ravel() + np.radians(turn_deg))
    return wi, seen, _value(wi, true) * (1.0 + noise * random.standard_normal(len(wi)))


@pytest.mark.parametrize("turn_deg", [0.0, 5.0, -12.0])
def test_an_offset_of_the_azimuth(turn_deg):
    """Catches azimuths that count from beside the plane of incidence, and an alarm where they do not."""
    wi, wo, value = _scan(np.random.default_rng(1), turn_deg=turn_deg)
    finding = _found(make_samples(wi, wo, value), "azimuth offset")
    assert finding.value == pytest.approx(abs(turn_deg), abs=1.0)
    assert finding.verdict is (Verdict.WARN if turn_deg else Verdict.PASS)
    if turn_deg:
        assert f"turning views by {'-' if turn_deg > 0.0 else '+'}" in finding.where


def test_an_offset_needs_both_sides():
    """Catches an offset told of views on one side of the plane, or of a surface alike all around."""
    wi, wo, value = _scan(np.random.default_rng(1))
    one = np.cross(wi, wo)[:, 2] > 0.0
    half = _found(make_samples(wi[one], wo[one], value[one]), "azimuth offset")
    assert half.verdict is Verdict.NOT_TESTED
    assert "one side" in half.meaning
    flat = make_samples(wi, wo, np.full(len(wi), 0.2))
    assert _found(flat, "azimuth offset").verdict is Verdict.PASS


@pytest.mark.parametrize("factor", [10.0, 0.05])
def test_outliers_are_named(factor):
    """Catches a digit that was lost in few rows, which medians do not show."""
    random = np.random.default_rng(2)
    wi, wo, value = _scan(random)
    assert _found(make_samples(wi, wo, value), "outliers").verdict is Verdict.PASS
    wrong = random.choice(np.flatnonzero(wo[:, 2] > 0.3), 5, replace=False)
    value[wrong] *= factor
    finding = _found(make_samples(wi, wo, value), "outliers")
    assert finding.verdict is Verdict.WARN
    np.testing.assert_array_equal(finding.samples, np.sort(wrong))
    assert re.search(r"\d times too (large|small)", finding.where)


def test_a_narrow_peak_is_no_outlier():
    """Catches a mirror's peak, one sample wide at each incidence, that is called wrong."""
    wi, wo, value = _scan(np.random.default_rng(3))
    half = (wi + wo) / np.linalg.norm(wi + wo, axis=1, keepdims=True)
    peaked = value * (1.0 + 30.0 * np.exp(-((np.arccos(np.minimum(half[:, 2], 1.0)) / 0.06) ** 2)))
    assert _found(make_samples(wi, wo, peaked), "outliers").verdict is Verdict.PASS


@pytest.mark.parametrize(("times", "verdict"), [(0.1, "pass"), (1.0, "pass"), (10.0, "warn")])
def test_an_uncertainty_that_is_too_large(times, verdict):
    """Catches ten times the noise that passes for caution, and an alarm where the statement is right."""
    wi, wo, value = _scan(np.random.default_rng(4))
    finding = _found(make_samples(wi, wo, value, u_f_r=times * 0.02 * value), "overstated noise")
    assert finding.verdict.value == verdict
    own = make_samples(wi, wo, value, u_noise=0.02 * value, u_reference=0.2 * value)
    assert _found(own, "overstated noise").verdict is Verdict.PASS
