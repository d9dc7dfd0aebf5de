"""Illumination as the lecture writes it: ambient, Lambert, Phong, many lights, shadows."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.models import MODELS
from analysis.shading import shade, sphere
from rig.errors import BadInput


def unit(*vector):
    """Return a unit vector."""
    return np.array(vector) / np.linalg.norm(vector)


EYE = unit(0.1, -0.2, 1.0)
LIGHTS = np.stack([unit(0.4, 0.3, 0.8), unit(-0.6, 0.1, 0.4), unit(0.0, -0.9, 0.3)])
INTENSITIES = np.array([[1.0, 0.9, 0.8], [0.2, 0.3, 0.4], [0.5, 0.5, 0.5]])


def by_the_lecture(normal, lit, *, kd, ks, exponent, ambient, k_ambient):
    """I = I_a k_a + sum of I_j (k_d L.N + k_s (R.V)^n) over the lights not in shadow, point by point."""
    total = np.full(3, ambient * k_ambient)
    for light, intensity, reaches in zip(LIGHTS, INTENSITIES, lit, strict=True):
        cosine = light @ normal
        if not reaches or cosine <= 0.0 or EYE @ normal <= 0.0:
            continue
        mirror = 2.0 * cosine * normal - light
        total = total + intensity * (kd * cosine + ks * max(mirror @ EYE, 0.0) ** exponent)
    return total


def test_the_lectures_sum():
    """Catches a missing pi, a light from behind, a shadow that does not darken, or channels mixed up."""
    random = np.random.default_rng(1)
    normals = random.standard_normal((40, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    lit = random.random((3, 40)) < 0.6
    kd, ks, exponent = 0.6, 0.3, 12.0
    model = MODELS["phong"](kd=kd, ks=ks / np.pi, exponent=exponent)
    ours = shade(model, normals, EYE, LIGHTS, INTENSITIES, lit=lit, ambient=0.4, k_ambient=0.25)
    theirs = [
        by_the_lecture(normal, lit[:, i], kd=kd, ks=ks, exponent=exponent, ambient=0.4, k_ambient=0.25)
        for i, normal in enumerate(normals)
    ]
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_ambient_and_lambert():
    """Catches an ambient term that depends on the light, or a diffuser that is not I_i k_d N.L."""
    normals, inside = sphere(32)
    model = MODELS["lambert"](kd=0.5)
    picture = shade(model, normals, [0.0, 0.0, 1.0], [[0.6, 0.0, 0.8]], [2.0], ambient=0.3, k_ambient=0.1)
    cosine = np.maximum(normals @ [0.6, 0.0, 0.8], 0.0)
    np.testing.assert_allclose(picture[inside, 0], (0.03 + 2.0 * 0.5 * cosine)[inside], rtol=1e-12)
    assert np.any(picture[inside] == 0.03)


def test_lights_may_differ_from_point_to_point():
    """Catches a near lamp whose direction is taken from one point for all."""
    normals = np.stack([unit(0.0, 0.1, 1.0), unit(0.3, 0.0, 1.0)])
    near = np.stack([LIGHTS[:2], LIGHTS[1:]])
    model = MODELS["ggx"](kd=[0.1, 0.2, 0.3])
    both = shade(model, normals, EYE, near, INTENSITIES[:2])
    each = [shade(model, normals[i], EYE, near[:, i], INTENSITIES[:2]) for i in range(2)]
    np.testing.assert_allclose(both, each, rtol=1e-13)


def test_the_frame_does_not_matter_to_an_isotropic_model():
    """Catches a frame that is not orthonormal, or a normal that is not its z."""
    normals, inside = sphere(16)
    normals = normals[inside]
    tangent = np.array([0.2, 0.9, 0.1])
    model = MODELS["ggx"]()
    free = shade(model, normals, EYE, LIGHTS, INTENSITIES)
    held = shade(model, normals, EYE, LIGHTS, INTENSITIES, tangents=np.broadcast_to(tangent, normals.shape))
    np.testing.assert_allclose(free, held, rtol=1e-9)
    brushed = MODELS["ggx-anisotropic"]()
    turned = shade(
        brushed, normals, EYE, LIGHTS, INTENSITIES, tangents=np.broadcast_to(tangent, normals.shape)
    )
    other = shade(
        brushed, normals, EYE, LIGHTS, INTENSITIES, tangents=np.full(normals.shape, [1.0, 0.1, 0.0])
    )
    assert np.abs(turned - other).max() > 0.1 * turned.max()


def test_missing_normals_stay_missing():
    """Catches a NaN that becomes black."""
    normals = np.stack([unit(0.0, 0.0, 1.0), np.full(3, np.nan)])
    picture = shade(MODELS["ggx"](), normals, EYE, LIGHTS, INTENSITIES[:, 0])
    assert np.isfinite(picture[0]).all()
    assert np.isnan(picture[1]).all()


@pytest.mark.parametrize(
    ("changed", "complaint"),
    [
        ({"normals": np.zeros((4, 2))}, "normals"),
        ({"lights": np.array([0.0, 0.0, 1.0])}, "lights"),
        ({"intensities": [1.0]}, "intensities"),
        ({"lit": np.ones((2, 4), dtype=bool)}, "lit"),
        ({"model": MODELS["ggx-anisotropic"]()}, "tangents"),
    ],
)
def test_what_does_not_fit_together_is_refused(changed, complaint):
    """Catches arrays that broadcast into a picture of something else."""
    given = {
        "model": MODELS["lambert"](),
        "normals": np.tile([0.0, 0.0, 1.0], (4, 1)),
        "eye": EYE,
        "lights": LIGHTS,
        "intensities": INTENSITIES,
    }
    with pytest.raises(BadInput, match=complaint):
        shade(**{**given, **changed})
