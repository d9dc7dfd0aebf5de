"""The sphere of a report is lit as stated, and looks the same whatever renders it."""

from __future__ import annotations

import numpy as np
import pytest

from rig.errors import BadInput
from simulator.sphere import LAMP_DIRECTION, SKY_RADIANCE, fitted_material, render_sphere
from simulator.variant import LLVM, choose_variant

pytestmark = pytest.mark.render


def test_a_white_sphere_has_the_cosine_of_the_lamp_and_the_sky() -> None:
    """Would catch a wrong scale, a picture upside down, and a rim brighter than the sphere."""
    picture = render_sphere("lambert:kd=1.0", 64, variant="scalar")
    assert picture.shape == (64, 64, 3)
    assert picture.max() == pytest.approx(1.0 + SKY_RADIANCE, rel=2e-3)
    assert picture[32, 32, 0] == pytest.approx(LAMP_DIRECTION[2] + SKY_RADIANCE, rel=0.03)
    brightest = np.unravel_index(picture[..., 0].argmax(), picture.shape[:2])
    assert brightest[0] < 32
    assert brightest[1] < 32
    assert not picture[0, 0].any()
    assert not picture[-1, -1].any()


@pytest.mark.parametrize(
    "spec", ["cook-torrance:kd=0.2/0.1/0.05,ks=0.8,m=0.15,ior=1.5", "mitsuba:roughconductor"]
)
def test_both_variants_draw_the_same_picture(spec: str) -> None:
    """Would catch a sphere whose look depends on the libraries of the machine."""
    if choose_variant().variant != LLVM:
        pytest.skip("no LLVM >= 19 on this machine")
    pictures = [render_sphere(spec, 48, variant=variant) for variant in ("llvm", "scalar")]
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=1e-4, atol=1e-5)
    assert pictures[0].max() > 1.5 * np.median(pictures[0][20:28, 20:28])


def test_a_fits_parameters_are_drawn() -> None:
    """Would catch channels of a fit that reach the wrong colour."""
    parameters = {"kd": np.array([0.6, 0.3, 0.1]), "ks": np.array([0.05]), "exponent": 30.0}
    assert fitted_material("phong", parameters).truth["kd"] == [0.6, 0.3, 0.1]
    picture = render_sphere("phong", 32, parameters=parameters, variant="scalar", background=0.5)
    red, green, blue = picture[20, 18]
    assert red > green > blue > 0.0
    np.testing.assert_allclose(picture[0, 0], 0.5)
    with pytest.raises(BadInput, match="phong needs exponent"):
        render_sphere("phong", 32, parameters={"kd": 0.1, "ks": 0.1}, variant="scalar")


def test_a_fit_that_mitsuba_does_not_know_is_drawn_by_its_formula() -> None:
    """Would catch a report that fails, or shows another model, once the fit knows more than the twin."""
    shape = {"kd": [0.2, 0.1, 0.05], "ks": 0.5, "alpha": 0.2, "f0": 0.04}
    picture = render_sphere("ggx", 24, parameters=shape, variant="scalar")
    assert picture.max() > 0.1
    assert picture[12, 12, 0] > 1.5 * picture[12, 12, 2]
