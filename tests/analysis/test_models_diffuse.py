"""Diffuse terms that are not Lambert's, and published parameters of SGD: limits that physics gives."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.models import MODELS
from analysis.samples import read

PUBLISHED = {
    ("special-walnut-224", 0): {"alpha": 0.117091, "p": 0.548899, "f0": 0.0808859, "f1": 0.0327605}
    | {"theta0_rad": -0.31158, "k": 22.9756, "lam": 3.61532, "c": 1.19182e-7},
    ("red-fabric", 1): {"alpha": 0.228455, "p": 0.821197, "f0": 0.0644687, "f1": -0.0062547}
    | {"theta0_rad": -0.530789, "k": 19.649, "lam": 3.93046, "c": 1.04152e-7},
}
"""Bagher et al. 2012, supplemental material: shapes of one channel of two MERL materials."""


@pytest.mark.realdata
@pytest.mark.parametrize(("material", "channel"), PUBLISHED)
def test_published_shapes_describe_the_materials(shared_data, material, channel):
    """Catches a formula that is not the one for which the paper's parameters of these materials hold."""
    samples = read(shared_data / "merl-standins" / f"{material}.npz")
    wi, wo, f_r = (samples[key].to_numpy() for key in ("wi", "wo", "f_r"))
    columns = MODELS["sgd"](**PUBLISHED[material, channel]).basis(wi, wo)
    design = np.stack([columns["kd"][:, 0], columns["ks"][:, 0]], axis=1)
    data, cosine = f_r[:, channel], wi[:, 2]
    weight = cosine / (1.0 + data * cosine)
    scales = np.linalg.lstsq(design * weight[:, None], data * weight, rcond=None)[0]
    residual = np.log1p(design @ scales * cosine) - np.log1p(data * cosine)
    assert np.sqrt(np.mean(residual**2)) < 0.35 * np.std(np.log1p(data * cosine))


@pytest.mark.parametrize(
    ("name", "smooth"),
    [("oren-nayar", {"sigma_rad": 0.0}), ("fujii", {"roughness": 0.0}), ("eon", {"roughness": 0.0})],
)
def test_without_roughness_it_is_lambert(name, smooth, hard_pairs):
    """Catches a diffuse term that does not end in Lambert's."""
    f = MODELS[name](kd=0.4, **smooth).evaluate(*hard_pairs)
    np.testing.assert_allclose(f, 0.4 / np.pi, rtol=1e-14)


def test_rough_surfaces_shine_back():
    """Catches the sign of the dot product: a rough diffuser is brighter towards the light."""
    light = np.array([np.sin(1.1), 0.0, np.cos(1.1)])
    for name in ("oren-nayar", "fujii", "eon"):
        back, forth = MODELS[name]().evaluate(light, np.stack([light, light * [-1.0, 1.0, 1.0]]))
        assert back > 1.2 * forth


def test_eon_without_light_between_facets_is_fujii(hard_pairs):
    """Catches a second term that does not vanish with the facets' albedo."""
    f = MODELS["eon"](kd=0.4, roughness=0.7, facet_albedo=0.0).evaluate(*hard_pairs)
    np.testing.assert_allclose(f, MODELS["fujii"](kd=0.4, roughness=0.7).evaluate(*hard_pairs), rtol=1e-15)
