"""What is not in the plane in focus: against rays through the lens, and against Mitsuba's thin lens."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rig.angles import unit
from rig.description import Camera, Rig, default_rig
from rig.kinematics import Kinematics
from simulator.light import mitsuba_scene
from simulator.light.direct_view import extents_of, lens_of, meet, view_of
from simulator.light.path_tracer import PathLight
from simulator.light.reflectance import closed_form_reflectance
from simulator.light.scene import Event, Scene
from simulator.light.surface_light import SurfaceLight
from simulator.materials import parse_material

ANGLES: Any = np.radians([-20.0, 15.0, 55.0, 0.0])


def rig_with(focus_mm: float = 0.0, aperture_mm: float = 10.0) -> Rig:
    """Return a machine with a small frame and a lens."""
    camera = Camera(
        width_px=40,
        height_px=30,
        focal_length_px=420.0,
        principal_point_px=(19.5, 14.5),
        aperture_diameter_mm=aperture_mm,
        focus_distance_mm=focus_mm,
    )
    return default_rig(camera=camera, solids=())


class ThinLens(PathLight):
    """Mitsuba's path tracer behind Mitsuba's thin lens."""

    def __init__(self, mi: Any, scene: Scene, samples_per_pixel: int) -> None:
        def lens(mi: Any, rig: Rig, count: int) -> dict[str, Any]:
            described = pinhole(mi, rig, count)
            # It knows no principal point; here that is in the middle.
            for name in ("principal_point_offset_x", "principal_point_offset_y"):
                assert described.pop(name) == pytest.approx(0.0)
            return described | {
                "type": "thinlens",
                "aperture_radius": rig.camera.aperture_diameter_mm / 2.0,
                "focus_distance": rig.camera.focus_distance_mm or rig.camera.distance_mm,
            }

        pinhole = mitsuba_scene.perspective_camera
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(mitsuba_scene, "perspective_camera", lens)
            super().__init__(mi, scene, last=1, samples_per_pixel=samples_per_pixel)


@pytest.mark.parametrize("focus_mm", [0.0, 300.0, 5000.0])
def test_points_are_those_of_rays_through_the_lens(focus_mm: float) -> None:
    """Would catch a blur to the wrong side, of the wrong size, or measured along the ray, not the axis."""
    rig = rig_with(focus_mm)
    frames = Kinematics(rig).frames(ANGLES)
    view, lens = view_of(frames, extents_of(rig)), lens_of(rig)
    offset, pupil = np.array([0.3, -0.2]), np.array([0.6, -0.7])
    found, _ = meet(view, lens, offset, pupil)
    right, down, forward = frames.camera_rotation.T
    place = lens.places + offset[0] * lens.across + offset[1] * lens.down
    slopes = place[:, :1] * right + place[:, 1:] * down + forward
    in_focus = frames.camera_mm + (focus_mm or 600.0) * slopes
    start = frames.camera_mm + 5.0 * (pupil[0] * right + pupil[1] * down)
    way = unit(in_focus - start)
    wanted = start - (start[2] / way[:, 2:]) * way
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    middle, _ = meet(view, lens, offset)
    assert np.abs(found - middle).max() > 0.1


def test_the_samples_centre_is_in_focus_by_default() -> None:
    """Would catch a focus that is on the pupil, or at infinity."""
    rig = rig_with()
    view = view_of(Kinematics(rig).frames(ANGLES), extents_of(rig))
    centre = lens_of(rig)[np.array([15 * 40 + 20])]
    offset = -centre.places[0] @ np.linalg.inv(np.stack([centre.across[0], centre.down[0]]))
    sharp, _ = meet(view, centre, offset, np.array([1.0, 0.0]))
    np.testing.assert_allclose(sharp, 0.0, atol=1e-9)


@pytest.mark.render
@pytest.mark.parametrize("focus_mm", [pytest.param(0.0, marks=pytest.mark.slow), 480.0])
def test_a_pattern_out_of_focus_is_mitsubas(vector: Any, focus_mm: float) -> None:
    """Would catch edges that stay sharp, and pixels that hold an edge without being told so (z-test)."""
    from scipy.special import ndtri

    rig = rig_with(focus_mm, aperture_mm=24.0)
    material = parse_material("lambert:kd=0.8@checker:side_mm=9,kd=0.1")
    scene = Scene(rig, material, frozenset({Event.LAMBERTIAN}))
    pattern = material.mounting.pattern
    assert pattern is not None
    own, other = (closed_form_reflectance(m) for m in (material, pattern.other))
    found = SurfaceLight(scene, own, other).render(ANGLES, 5e-3)
    traced = ThinLens(vector, scene, 256).estimate(ANGLES, 8)
    on = traced.mean[..., 0] > 0.0
    inside = on & np.roll(on, 1, 0) & np.roll(on, -1, 0) & np.roll(on, 1, 1) & np.roll(on, -1, 1)
    off = (found.radiance - traced.mean)[inside][:, 0]
    own_error = 3.0 * found.error * found.radiance[inside].mean()
    spread = np.sqrt(traced.standard_error[inside][:, 0] ** 2 + own_error**2)
    # Eight renders tell a spread with t's heavy tails: that of all pixels together has none.
    least = np.sqrt(np.mean(traced.standard_error[inside] ** 2))
    z = np.abs(off) / np.maximum(spread, least)
    limit = -ndtri(0.5 * (1.0 - 0.99 ** (1.0 / z.size)))
    assert np.mean(z < limit) >= 0.9975
    assert abs(off.mean()) < 4.0 * least / np.sqrt(z.size) + own_error
    # In focus the picture is another one where the sample leaves the plane.
    sharp = SurfaceLight(scene, own, other, extents_of(rig_with(aperture_mm=1e-3))).render(ANGLES, 5e-3)
    assert np.abs(sharp.radiance - found.radiance)[inside].max() > 0.02 * found.radiance.max()
