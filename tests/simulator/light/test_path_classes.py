"""Images by class of light paths: they add up, and agree with other renders and with exact methods."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rig.description import default_rig
from rig.errors import Refused
from simulator.light.path_classes import PathClasses, class_table
from simulator.light.path_tracer import Estimate, PathLight
from simulator.light.paths import LightPaths
from simulator.light.scene import Event, Housing, PlanarMirror, Scene
from simulator.materials import parse_material

ANGLES = np.radians([30.0, 40.0, -20.0, 15.0])
PAINT = "cook-torrance:kd=0.2,ks=0.6,m=0.3,ior=1.5"
MIRROR = PlanarMirror((-300.0, 0.0, 100.0), (0.0, 400.0, 0.0), (0.0, 0.0, 400.0), 0.8)


def scene(*, cosine: bool) -> Scene:
    """Return a paint in a bright housing, with a mirror where the lamp has a size."""
    rig = default_rig()
    # A lamp that chance often meets: of a small one, few fireflies would be all that is seen in the mirror.
    rig = rig.model_copy(update={"lamp": rig.lamp.model_copy(update={"diameter_mm": 200.0})})
    return Scene(
        rig,
        parse_material(PAINT),
        frozenset({Event.GLOSSY}),
        housing=Housing(0.5, 900.0),
        mirrors=(MIRROR,) if cosine else (),
        lamp_cosine=cosine,
    )


def binned(estimate: Estimate, side: int = 16) -> tuple[Any, Any]:
    """Return means of squares of pixels and their standard errors: nearer to normal than single pixels."""
    height, width, _ = estimate.mean.shape
    shape = (height // side, side, width // side, side, 3)
    mean = estimate.mean.reshape(shape).mean(axis=(1, 3))
    square = np.square(estimate.standard_error).reshape(shape).mean(axis=(1, 3)) / side**2
    return mean, square


def accept(found: Estimate, wanted: Estimate) -> None:
    """Z-test of all squares together (Sidak 1967): 1 in 100 right renders fails; seeds are fixed."""
    from scipy.special import ndtri

    (a, va), (b, vb) = binned(found), binned(wanted)
    # Noise estimated from few renders is itself uncertain: that of all squares together is not.
    spread = np.sqrt((va + vb).mean(axis=(0, 1)))
    z = np.abs(a - b) / spread
    assert z.max() < -ndtri(0.5 * (1.0 - 0.99 ** (1.0 / z.size)))
    assert np.all(np.abs((a - b).mean(axis=(0, 1))) < 4.0 * spread / np.sqrt(a[..., 0].size))


class TestTable:
    def test_every_word_has_its_place(self) -> None:
        """Would catch words that share a place, or a reversed word."""
        everything = class_table([LightPaths("L(D|S)+E")], 4)
        assert np.count_nonzero(everything == 0) == 3 + 9 + 27 + 81
        first = class_table([LightPaths("LSDlE")], 3)
        last = class_table([LightPaths("LDlSE")], 3)
        assert np.count_nonzero(first == 0) == np.count_nonzero(last == 0) == 1
        assert np.argmin(first) != np.argmin(last)

    def test_classes_that_overlap_are_refused(self) -> None:
        """Would catch light that goes to the last of two classes without a word."""
        with pytest.raises(Refused):
            class_table([LightPaths("LDE"), LightPaths("LD+E")], 3)


@pytest.mark.render
class TestImages:
    @pytest.mark.parametrize("cosine", [False, True])
    def test_they_add_up_to_the_path_tracer(self, vector: Any, *, cosine: bool) -> None:
        """Would catch light lost between classes or counted in two, with a lamp of either kind."""
        what = scene(cosine=cosine)
        words = [LightPaths(word) for word in ("LDE", "LDDE", "LSDE")]
        rest = LightPaths("L(D|S)+E") - words[0] - words[1] - words[2]
        classes = PathClasses(vector, what, [*words, rest], longest=5, samples_per_pixel=32)
        parts = classes.estimates(ANGLES, 4)
        whole = PathLight(vector, what, last=5, samples_per_pixel=32).estimate(ANGLES, 4)
        error = np.sqrt(sum(np.square(part.standard_error) for part in parts))
        accept(Estimate(sum(part.mean for part in parts), error), whole)
        assert (parts[2].mean.mean() > 0.0) == cosine

    @pytest.mark.parametrize("cosine", [False, True])
    def test_all_but_the_direct_is_the_difference_of_renders(self, vector: Any, *, cosine: bool) -> None:
        """Would catch a difference of sets that is not the difference of their light."""
        what = scene(cosine=cosine)
        beyond = LightPaths("L(D|S)*E") - LightPaths("LE|LDE")
        (found,) = PathClasses(vector, what, [beyond], longest=5, samples_per_pixel=32).estimates(ANGLES, 4)
        whole, direct = (
            PathLight(vector, what, last=last, samples_per_pixel=32).estimate(ANGLES, 4) for last in (5, 1)
        )
        noise = np.hypot(whole.standard_error, direct.standard_error)
        accept(found, Estimate(whole.mean - direct.mean, noise))
        assert found.mean.mean() > 0.05 * whole.mean.mean()

    def test_direct_light_is_the_closed_form(self, vector: Any) -> None:
        """Would catch words read from the wrong end: only one event is direct."""
        from simulator.light.pixelwise import PixelwiseLight
        from simulator.light.reflectance import closed_form_reflectance

        what = scene(cosine=False)
        (found,) = PathClasses(vector, what, [LightPaths("LDgE")], samples_per_pixel=16).estimates(ANGLES, 2)
        exact = PixelwiseLight(what.rig, closed_form_reflectance(what.material))  # type: ignore[arg-type]
        wanted = exact.render(ANGLES, 1e-3).radiance
        np.testing.assert_allclose(found.mean.mean(axis=(0, 1)), wanted.mean(axis=(0, 1)), rtol=1e-4)

    def test_scalar_is_refused(self, scalar: Any) -> None:
        """Would catch hours of rendering ray by ray."""
        with pytest.raises(Refused):
            PathClasses(scalar, scene(cosine=False), [LightPaths("LDE")])
