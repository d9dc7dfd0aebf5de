"""Torrance-Sparrow, Lafortune, two lobes, anisotropy: limits and directions."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.models import MODELS
from analysis.models.torrance_sparrow import HALF_WIDTH


@pytest.mark.parametrize("name", [name for name in MODELS if name.startswith("torrance-sparrow")])
@pytest.mark.parametrize("half_width", [0.01, 0.3, HALF_WIDTH.bounds[1]])
def test_half_width_is_where_the_distribution_is_one_half(name, half_width):
    """Catches a width that means another thing in each of the three distributions."""
    theta = np.array([0.0, half_width])
    # Light and camera a fixed angle apart about H, across the plane of H's tilt: F and G stay.
    wi, wo = (
        np.stack([0.1 * sign + 0.0 * theta, np.sin(theta), np.cos(theta)], axis=-1) for sign in (1.0, -1.0)
    )
    wi, wo = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (wi, wo))
    f = MODELS[name](kd=0.0, half_width_rad=half_width).evaluate(wi, wo)[:, 0]
    shading = f * wi[:, 2] * wo[:, 2] / wi[0, 2] / wo[0, 2]
    groove = min(1.0, 2.0 * np.cos(half_width) * wi[1, 2] / np.linalg.norm(0.5 * (wi[1] + wo[1])))
    assert shading[1] / shading[0] == pytest.approx(0.5 * groove, rel=1e-12)


def test_equal_widths_are_isotropic(hard_pairs):
    """Catches an axis that matters where it must not."""
    wi, wo = hard_pairs
    for family, width in (("ggx", "alpha"), ("beckmann", "m")):
        plain = MODELS[family](**{width: 0.3}).evaluate(wi, wo)
        turned = MODELS[f"{family}-anisotropic"](
            **{f"{width}_x": 0.3, f"{width}_y": 0.3, "axis_rad": 0.7}
        ).evaluate(wi, wo)
        np.testing.assert_allclose(turned, plain, rtol=1e-11)


def test_widths_exchanged_and_a_quarter_turn_are_the_same(hard_pairs):
    """Catches an axis that turns the wrong way for one of the parts."""
    wi, wo = hard_pairs
    one = MODELS["ggx-anisotropic"](alpha_x=0.1, alpha_y=0.5, axis_rad=0.4).evaluate(wi, wo)
    two = MODELS["ggx-anisotropic"](alpha_x=0.5, alpha_y=0.1, axis_rad=0.4 - np.pi / 2).evaluate(wi, wo)
    np.testing.assert_allclose(one, two, rtol=1e-9)


def test_light_spreads_along_the_larger_width():
    """Catches the two widths interchanged."""
    tilt = np.array([0.3, 0.0, np.sqrt(1.0 - 0.09)])
    across = tilt[[1, 0, 2]]
    model = MODELS["ggx-anisotropic"](kd=0.0, alpha_x=0.4, alpha_y=0.1)
    normal = [0.0, 0.0, 1.0]
    assert model.evaluate(normal, tilt)[0] > 3.0 * model.evaluate(normal, across)[0]


def test_two_lobes_become_one_at_either_end(hard_pairs):
    """Catches a share that is the other lobe's."""
    wi, wo = hard_pairs
    single, double = MODELS["ggx"], MODELS["ggx-two-lobes"]
    for share, alpha in ((0.0, 0.1), (1.0, 0.5)):
        both = double(alpha=0.1, widening=5.0, share=share).evaluate(wi, wo)
        np.testing.assert_allclose(both, single(alpha=alpha).evaluate(wi, wo), rtol=1e-13)


def test_the_lobe_back_peaks_at_the_light():
    """Catches a retro lobe that is a mirror lobe."""
    light = np.array([np.sin(0.6), 0.0, np.cos(0.6)])
    for name, values in (("ggx-retro", {"share": 1.0}), ("lafortune-retro", {"ratio": 1.0})):
        model = MODELS[name](kd=0.0, **values)
        back, mirrored = model.evaluate(light, np.stack([light, light * [-1.0, 1.0, 1.0]]))
        assert back > 20.0 * mirrored
