"""Stray light as one value: as good as it says over scenes of all kinds, and silent where it cannot know."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.light_scenes import draw_scenes
from rig.description import default_rig
from rig.pixels import pixel_geometry
from simulator.light.mitsuba_scene import sample_events
from simulator.light.paths import LightPaths
from simulator.light.radiosity import Radiosity
from simulator.light.reflectance import material_reflectance
from simulator.light.rough_walls import ERROR
from simulator.light.scene import Scene, default_housing
from simulator.materials import parse_material

STRAY = LightPaths("LD*DlDE")
POSE = tuple(np.radians([30.0, 40.0, -20.0, 15.0]).tolist())
ONE_VALUE = "one value"


def light(mi: Any, scene: Scene, paths: LightPaths = STRAY) -> Radiosity:
    """Return the walls' light at work."""
    return Radiosity(scene, material_reflectance(mi, scene.material), paths)


def housed(mi: Any, line: str) -> Scene:
    """Return a material in a housing."""
    rig, material = default_rig(), parse_material(line)
    return Scene(rig, material, sample_events(mi, material), default_housing(rig, 0.2))


@pytest.mark.parametrize("seed", [41, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (42, 43, 44))])
def test_it_is_as_good_as_it_says(scalar: Any, seed: int) -> None:
    """Would catch light that is skipped, or a lobe between patches, where the choice trusts one value."""
    errors = []
    for drawn in draw_scenes(scalar, 30, seed):
        if drawn.scene.housing is None or drawn.scene.mirrors:
            continue
        seen = pixel_geometry(drawn.scene.rig, np.asarray(drawn.pose)).on_sample
        method = light(scalar, drawn.scene)
        rough = method.render(drawn.pose, ERROR)
        if not seen.any() or ONE_VALUE not in rough.did:
            continue
        fine = method.render(drawn.pose, 1e-2).radiance[seen]
        errors.append(np.sqrt(np.mean(np.square(rough.radiance[seen] - fine))) / fine.mean())
        assert errors[-1] <= rough.error, drawn.label
        assert np.all(rough.radiance[~seen] == 0.0)
    assert len(errors) > 4


@pytest.mark.parametrize(
    "line", ["ggx:kd=0.02,ks=0.6,alpha=0.01,f0=0.5", "cook-torrance:kd=0.05,ks=0.8,m=0.03,ior=1.5"]
)
def test_narrow_lobes_are_left_to_more_nodes(scalar: Any, line: str) -> None:
    """Would catch a lobe that falls between the patches' middles, and is lost."""
    assert ONE_VALUE not in light(scalar, housed(scalar, line)).render(POSE, ERROR).did


def test_what_it_leaves_out_is_not_all_that_is_asked_for(scalar: Any) -> None:
    """Would catch darkness where only light from the sample over the walls is wanted."""
    scene = housed(scalar, "ggx:kd=0.3,ks=0.3,alpha=0.4,f0=0.05")
    found = light(scalar, scene, LightPaths("LDgDlDgE")).render(POSE, ERROR)
    assert ONE_VALUE not in found.did
    assert found.radiance.max() > 0.0


def test_a_lamp_that_shines_backwards_is_left_to_more_nodes(scalar: Any) -> None:
    """Would catch a bright spot on the wall behind the lamp, which the patches' middles miss."""
    scene = replace(housed(scalar, "lambert:kd=0.5"), lamp_cosine=False)
    assert ONE_VALUE not in light(scalar, scene).render(POSE, ERROR).did


def test_small_tolerances_are_kept(scalar: Any) -> None:
    """Would catch one value where the picture is asked for."""
    scene = housed(scalar, "lambert:kd=0.5")
    assert ONE_VALUE in light(scalar, scene).render(POSE, ERROR).did
    assert ONE_VALUE not in light(scalar, scene).render(POSE, 0.9 * ERROR).did
