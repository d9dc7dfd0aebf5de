"""Emissivity against 1 - albedo: compared where samples allow, refused with the reason where not."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.checks.emissivity import Emissivity, emissivity, read_emissivity
from analysis.checks.finding import Verdict
from analysis.models import MODELS
from analysis.pairing import usable_samples
from analysis.samples import make_samples, read
from rig.angles import spherical_to_direction
from rig.errors import BadInput


def _grey(albedo, phi, theta_deg=None):
    theta_o, phi_o = np.meshgrid(
        np.radians(np.arange(2.5, 90.0, 5.0) if theta_deg is None else theta_deg), phi
    )
    wi = spherical_to_direction(np.full(theta_o.size, 0.5), 0.0)
    wo = spherical_to_direction(theta_o.ravel(), phi_o.ravel())
    return usable_samples(make_samples(wi, wo, np.full(theta_o.size, albedo / np.pi)))


def _known(value, u=0.02):
    return Emissivity(np.array([0.0, 80.0]), np.full(2, value), np.full(2, u))


@pytest.mark.parametrize("phi", [np.arange(0.0, 6.2, 0.2), np.array([0.0, np.pi])], ids=["all", "plane"])
def test_compared(phi):
    """Catches an albedo that is off: 0.3 agrees with 0.7, not with 0.5, over the hemisphere and by bounds."""
    agrees = emissivity(_grey(0.3, phi), _known(0.7))
    assert agrees.verdict is Verdict.PASS
    assert agrees.value < 1.0
    wrong = emissivity(_grey(0.3, phi), _known(0.5))
    assert wrong.verdict is Verdict.FAIL
    assert "1 - albedo 0.7" in wrong.where


def test_refused():
    """Catches an albedo from one side of one plane, or from a patch."""
    one_side = emissivity(_grey(0.3, np.array([np.pi])), _known(0.7))
    assert one_side.verdict is Verdict.NOT_TESTED
    assert "one side of the normal" in one_side.meaning
    patch = emissivity(_grey(0.3, np.arange(0.0, 6.2, 0.2), np.arange(1.0, 40.0, 5.0)), _known(0.7))
    assert "projected hemisphere" in patch.meaning
    plane = _grey(0.3, np.array([0.0, np.pi]))
    peaked = plane._replace(f_r=np.where(np.abs(plane.turn) > 1.0, 5.0, 1.0)[:, None] * plane.f_r)
    assert "lies anywhere in" in emissivity(peaked, _known(0.7)).meaning


def test_given_by_a_person(tmp_path):
    """Catches a number or a table that is taken for another one."""
    assert read_emissivity("0.9", tmp_path / "0.9", None).at(40.0) == (0.9, 0.0)
    path = tmp_path / "e.csv"
    path.write_text(
        "material,camera_angle_deg,emissivity_mean,emissivity_std\nCu,60,0.2,0.01\nCu,20,0.1,0.03\nAl,60,0.5,0.1\n"
    )
    value, u = read_emissivity(str(path), path, "Cu").at(40.0)
    assert (value, u) == (pytest.approx(0.15), pytest.approx(0.02))
    for text, material, what in (("1.2", None, "no emissivity"), (str(path), None, "2 materials")):
        with pytest.raises(BadInput, match=what):
            read_emissivity(text, tmp_path / text, material)
    path.write_text("material,emissivity\nCu,0.1\n")
    with pytest.raises(BadInput, match="no column"):
        read_emissivity(str(path), path, None)


def _one_side(evaluate, lights_deg=(15.0, 30.0, 45.0, 60.0)):
    theta_i, theta_o = np.meshgrid(np.radians(lights_deg), np.radians(np.arange(1.0, 86.0, 2.0)))
    wi = spherical_to_direction(theta_i.ravel(), 0.0)
    wo = spherical_to_direction(theta_o.ravel(), np.pi)
    return usable_samples(make_samples(wi, wo, evaluate(wi, wo)))


@pytest.mark.parametrize("scale", [1.0, 2.0, 8.0])
def test_one_side_of_the_plane_allows_a_rough_surface(scale):
    """Catches a modelled albedo that is off, too sure, or compared although no surface reflects so much."""
    paint = MODELS["ggx"](kd=0.2, ks=1.0, alpha=0.4, f0=0.05)
    usable = _one_side(lambda wi, wo: scale * paint.evaluate(wi, wo)[:, :1])
    # The albedo of this paint by a fine sum: 0.239 at 15 and at 30 deg.
    found = emissivity(usable, _known(1.0 - 0.239))
    if scale == 1.0:
        assert found.verdict is Verdict.PASS
        assert found.value < 1.5
        assert found.count >= 2
    elif scale == 2.0:
        assert found.verdict is not Verdict.PASS
    else:
        assert found.verdict is Verdict.NOT_TESTED
        assert "times the light it gets" in found.meaning


def test_one_side_of_the_plane_does_not_allow_a_mirror():
    """Catches an albedo told from a peak that nobody resolved."""
    mirror = MODELS["ggx"](kd=0.05, ks=1.0, alpha=0.02, f0=0.6)
    usable = _one_side(lambda wi, wo: mirror.evaluate(wi, wo)[:, :1])
    found = emissivity(usable, _known(0.4))
    assert found.verdict is Verdict.NOT_TESTED
    assert "one side of the normal: the rest leaves" in found.meaning


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("material", "verdict", "words"),
    [
        ("Referenzlack (Rau)", Verdict.PASS, ""),
        ("Alu sandgestrahlt", Verdict.NOT_TESTED, "one side of the normal: the rest leaves"),
        ("Edelstahl gebürstet", Verdict.NOT_TESTED, "times the light it gets: the surface is not isotropic"),
    ],
)
def test_mid_infrared(shared_data, material, verdict, words):
    """Catches an albedo told where the published half plane allows none, or refused where it does."""
    table = shared_data / "mwir" / "emissivity.csv"
    samples = read(shared_data / "mwir" / "radiance.csv", material=material)
    found = emissivity(usable_samples(samples), read_emissivity(str(table), table, material))
    assert found.verdict is verdict
    assert words in found.meaning
