"""Samples of any form, mounting and pattern: against integrals in closed form, and against Mitsuba."""

from __future__ import annotations

from math import cos, degrees, pi, radians, sin, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from rig.description import Camera, Rig, default_rig
from rig.errors import BadInput
from rig.kinematics import Kinematics
from rig.pixels import camera_rays
from simulator.light import mitsuba_scene
from simulator.light.choice import Chooser
from simulator.light.direct_view import POINTS, Extents
from simulator.light.methods import METHODS
from simulator.light.mitsuba_scene import sample_events
from simulator.light.path_tracer import PathLight
from simulator.light.pixelwise import PixelwiseLight
from simulator.light.reflectance import closed_form_reflectance
from simulator.light.scene import Event, Housing, Scene
from simulator.light.surface_light import SurfaceLight
from simulator.materials import parse_material
from simulator.mounting import PLAIN, Relief
from simulator.patterns import pattern_weight, relief_slopes, relief_waves

if TYPE_CHECKING:
    from pathlib import Path

POSES = [(0.4, 0.3, -0.5, 0.2), (1.1, 2.0, 1.0, -1.0)]
RIG = default_rig(
    camera=Camera(width_px=48, height_px=36, focal_length_px=450.0, principal_point_px=(23.5, 17.5))
)
GLOSSY = frozenset({Event.GLOSSY})
LINES = [
    "lambert:kd=0.5@tilted:x_deg=12,y_deg=-7@raised:mm=2",
    "ggx:kd=0.1,ks=0.5,alpha=0.3,f0=0.05@sphere:radius_mm=15",
    "ggx:kd=0.1,ks=0.5,alpha=0.3,f0=0.05@cylinder:radius_mm=12,axis_deg=30@tilted:y_deg=5",
    "ggx:kd=0.1,ks=0.5,alpha=0.3,f0=0.05@rough:slope_rms=0.1,wavelength_mm=8,seed=4",
    "ggx-anisotropic:kd=0.1,ks=0.5,alpha_x=0.2,alpha_y=0.5,f0=0.05,axis_rad=0@turned:deg=30@sphere:radius_mm=25",
    "lambert:kd=0.8@gradient:kd=0.1/0.2/0.6,along_deg=40@cylinder:radius_mm=30",
    "ggx:kd=0.1,ks=0.5,alpha=0.3,f0=0.05@checker:side_mm=9,kd=0.6,alpha=0.5",
]


def scene_of(line: str, rig: Rig = RIG) -> Scene:
    """Return the scene of a line, without asking Mitsuba what it can do."""
    return Scene(rig, parse_material(line), GLOSSY)


def light(line: str, rig: Rig = RIG, extents: Extents | None = None) -> SurfaceLight:
    """Light of a closed form."""
    material = parse_material(line)
    pattern = material.mounting.pattern
    other = None if pattern is None else closed_form_reflectance(pattern.other)
    return SurfaceLight(scene_of(line, rig), closed_form_reflectance(material), other, extents)


def accepted(mi: Any, line: str, renders: int) -> tuple[float, float]:
    """Return the part of inner pixels that a z-test accepts, and the deviation of their mean."""
    material = parse_material(line)
    scene = Scene(RIG, material, sample_events(mi, material))
    part, bias = [], []
    for pose in POSES:
        rendering = light(line).smooth.render(pose, 3e-4)
        found = rendering.radiance
        traced = PathLight(mi, scene, last=1, samples_per_pixel=16).estimate(pose, renders)
        # Where an edge crosses a pixel the spread of few paths is no measure of their error.
        inside = (found > 0.0) & (traced.standard_error < 0.02 * traced.mean)
        off = np.abs(found - traced.mean)[inside]
        # What it says of itself is a root mean square.
        own = 3.0 * rendering.error * found[inside].mean()
        part.append(float(np.mean(off < 4.5 * traced.standard_error[inside] + own)))
        bias.append(float(abs(found[inside].sum() / traced.mean[inside].sum() - 1.0)))
        assert np.count_nonzero(inside) > 100
    return min(part), max(bias)


@pytest.mark.render
@pytest.mark.parametrize(
    "line",
    [pytest.param(line, marks=() if "sphere:radius_mm=15" in line else pytest.mark.slow) for line in LINES],
)
def test_mitsubas_path_tracer_sees_the_same(vector: Any, line: str) -> None:
    """Would catch a form, normal, axis, relief or pattern that the two scenes do not share."""
    part, bias = accepted(vector, line, 32)
    assert part >= 0.9975
    assert bias < 1e-3


@pytest.mark.parametrize("line", LINES)
def test_single_rays_of_the_scalar_variant_see_the_same(scalar: Any, line: str) -> None:
    """Would catch a plugin that works on arrays alone, or in which the two forms differ somewhere."""
    scene = scene_of(line)
    frames = Kinematics(RIG).frames(np.asarray(POSES[0]))
    exact = light(line, extents=POINTS).render(POSES[0], 1e-2).radiance
    traced = scalar.load_dict(
        {"type": "scene", "sample": mitsuba_scene.sample(scalar, scene)}, optimize=False
    )
    ways = camera_rays(RIG) @ frames.camera_rotation.T
    seen = 0
    for row, column in [(row, column) for row in range(3, 36, 4) for column in range(3, 48, 5)]:
        way = ways[row, column]
        si = traced.ray_intersect(scalar.Ray3f(frames.camera_mm.tolist(), way.tolist()))
        value = np.zeros(3)
        if si.is_valid():
            to_light = frames.light_mm - np.array(si.p)
            distance = np.linalg.norm(to_light)
            wi = si.to_local(scalar.Vector3f((to_light / distance).tolist()))
            value = np.array(si.bsdf().eval(scalar.BSDFContext(), si, wi)) * (
                scene.lamp_intensity / distance**2
            )
        np.testing.assert_allclose(value, exact[row, column], rtol=2e-4, atol=1e-5)
        seen += bool(exact[row, column].any())
    assert seen > 10


@pytest.mark.parametrize("pose", [(0.3, 0.0, -0.4, 0.0), (0.9, 0.5, 0.6, 1.0)])
def test_a_lambertian_ball_has_its_phase_function(pose: tuple[float, ...]) -> None:
    """Would catch a wrong normal, attached shadow, cosine or distance: they change the flux of the ball."""
    far_mm, radius_mm, focal_px = 1e5, 15.0, 1e5
    camera = Camera(
        width_px=64,
        height_px=64,
        focal_length_px=focal_px,
        principal_point_px=(31.5, 31.5),
        distance_mm=far_mm,
        aperture_diameter_mm=1.0,
    )
    rig = default_rig(camera=camera)
    rig = rig.model_copy(update={"lamp": rig.lamp.model_copy(update={"distance_mm": far_mm})})
    found = light(f"lambert:kd=0.7@sphere:radius_mm={radius_mm}@raised:mm={radius_mm}", rig)
    radiance = found.render(pose, 2e-3).radiance[..., 0]
    frames = Kinematics(rig).frames(np.asarray(pose))
    alpha = np.arccos(frames.light_mm @ frames.camera_mm / far_mm**2)
    # Lambert (1760): a ball of radius R in irradiance 1 has this intensity at phase angle alpha.
    expected = 2.0 / 3.0 * 0.7 / pi * radius_mm**2 * (sin(alpha) + (pi - alpha) * cos(alpha))
    assert radiance.sum() * (far_mm / focal_px) ** 2 == pytest.approx(expected, rel=5e-4)


def test_a_wide_ball_is_flat() -> None:
    """Would catch an intersection that loses its digits where the form is large."""
    flat = PixelwiseLight(RIG, closed_form_reflectance(parse_material("lambert:kd=0.5"))).radiance(POSES[0])
    for form in ("sphere:radius_mm=1e8", "cylinder:radius_mm=1e8,axis_deg=20"):
        found = light(f"lambert:kd=0.5@{form}", extents=POINTS).render(POSES[0], 1e-2).radiance
        np.testing.assert_allclose(found, flat, rtol=1e-6)


def test_a_tilted_plane_is_lit_by_its_own_cosine() -> None:
    """Would catch a tilt about the wrong axis or with the wrong sign."""
    x_deg, y_deg = 8.0, -5.0
    found = light(f"lambert:kd=0.5@tilted:x_deg={x_deg},y_deg={y_deg}", extents=POINTS)
    tan_x, tan_y = radians(x_deg), radians(y_deg)
    # +z, turned about x, then about y.
    normal = np.array([cos(tan_x) * sin(tan_y), -sin(tan_x), cos(tan_x) * cos(tan_y)])
    odd = default_rig(camera=RIG.camera.model_copy(update={"principal_point_px": (23.0, 17.0)}))
    found = light(f"lambert:kd=0.5@tilted:x_deg={x_deg},y_deg={y_deg}", odd, POINTS)
    light_mm = Kinematics(odd).frames(np.asarray(POSES[0])).light_mm
    expected = 0.5 / pi * normal @ light_mm / np.linalg.norm(light_mm)
    assert found.render(POSES[0], 1e-2).radiance[17, 23, 0] == pytest.approx(expected, rel=1e-12)


def test_a_raised_sample_is_nearer_to_the_lamp() -> None:
    """Would catch a height that moves nothing, or the wrong way."""
    odd = default_rig(camera=RIG.camera.model_copy(update={"principal_point_px": (23.0, 17.0)}))
    upright = (0.0,) * len(odd.arm_joints)
    raised = light("lambert:kd=0.5@raised:mm=3", odd, POINTS).render(upright, 1e-2).radiance[17, 23, 0]
    distance = odd.lamp.distance_mm
    light_mm = Kinematics(odd).frames(np.zeros(len(odd.arm_joints))).light_mm
    way = light_mm - [0.0, 0.0, 3.0]
    expected = 0.5 / pi * way[2] * distance**2 / np.linalg.norm(way) ** 3
    assert raised == pytest.approx(expected, rel=2e-5)


def test_turning_the_sample_turns_its_grain() -> None:
    """Would catch a grain that turns the other way than the model's own axis."""
    base = "ggx-anisotropic:kd=0.1,ks=0.5,alpha_x=0.1,alpha_y=0.4,f0=0.05,axis_rad="
    turned = light(f"{base}0@turned:deg=30", extents=POINTS).render(POSES[1], 1e-2).radiance
    plain = closed_form_reflectance(parse_material(f"{base}{radians(30.0)!r}"))
    np.testing.assert_allclose(turned, PixelwiseLight(RIG, plain).radiance(POSES[1]), rtol=1e-9, atol=1e-15)
    assert parse_material("lambert:kd=0.5@turned:deg=30").mounting == PLAIN


def test_a_relief_has_the_slope_that_it_states() -> None:
    """Would catch a factor of two in the slope, or waves that lie in one direction."""
    places = np.random.default_rng(0).uniform(-500.0, 500.0, (100_000, 2))
    slopes = relief_slopes(relief_waves(Relief(0.05, 2.0, 3)), places)
    assert sqrt(np.mean(np.sum(slopes**2, axis=1))) == pytest.approx(0.05, rel=0.01)
    assert np.all(np.abs(slopes.mean(axis=0)) < 1e-3)
    ratio = np.mean(slopes[:, 0] ** 2) / np.mean(slopes[:, 1] ** 2)
    assert 0.4 < ratio < 2.5


def test_patterns_lie_where_they_are_said_to(tmp_path: Path) -> None:
    """Would catch a picture upside down or mirrored, a checker off the centre, a gradient backwards."""
    import cv2

    def weight(part: str, *place: float) -> float:
        pattern = parse_material(f"lambert:kd=0.5@{part}").mounting.pattern
        assert pattern is not None
        return float(pattern_weight(pattern, 20.0, np.array([place]))[0, 0])

    checker = "checker:side_mm=4,kd=0.1"
    assert [weight(checker, *at) for at in ((1, 1), (-1, 1), (-1, -1), (5, 1))] == [0.0, 1.0, 0.0, 1.0]
    gradient = "gradient:kd=0.1,along_deg=90"
    assert [weight(gradient, 3, y) for y in (-20, 0, 10, 25)] == pytest.approx([0.0, 0.5, 0.75, 1.0])
    corner = np.zeros((4, 4), np.uint8)
    corner[0, 3] = 255
    cv2.imwrite(str(tmp_path / "corner.png"), corner)
    picture = f"image:file={tmp_path}/corner.png,kd=0.1"
    assert [weight(picture, *at) for at in ((15, 15), (-15, 15), (15, -15), (10, 15))] == [1.0, 0.0, 0.0, 0.5]


@pytest.mark.render
def test_a_coloured_picture_looks_the_same_through_mitsuba(vector: Any, tmp_path: Path) -> None:
    """Would catch a picture that is flipped, gamma-corrected or with red and blue exchanged."""
    import cv2

    picture = np.random.default_rng(1).integers(0, 65535, (3, 4, 3)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "leaf.png"), picture)
    part, bias = accepted(vector, f"lambert:kd=0.9@image:file={tmp_path}/leaf.png,kd=0.1/0.2/0.3", 32)
    assert part >= 0.9975
    assert bias < 1e-3


def test_the_error_of_a_checker_is_known() -> None:
    """Would catch edges whose error is not counted: a coarse answer is as far from a fine one as it says."""
    line = "lambert:kd=0.8@checker:side_mm=9,kd=0.1"
    coarse, fine = (light(line).render(POSES[0], tolerance) for tolerance in (1e-1, 1e-2))
    off = coarse.radiance - fine.radiance
    lit = fine.radiance.any(axis=-1)
    mean = fine.radiance[lit].mean()
    assert np.sqrt(np.mean(off[lit] ** 2)) / mean < coarse.error + fine.error
    assert fine.error <= 1e-2


@pytest.mark.parametrize("line", LINES)
def test_no_method_for_flat_samples_is_chosen(vector: Any, line: str) -> None:
    """Would catch a picture of a flat, even sample in place of what lies there."""
    material = parse_material(line)
    events = sample_events(vector, material)
    for housing in (None, Housing(0.05, 2000.0)):
        chooser = Chooser(vector, Scene(RIG, material, events, housing), 1e-2, METHODS)
        parts = chooser.decide(POSES[0]).parts
        assert parts
        assert all(part.method.any_sample for part in parts)


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("lambert:kd=0.5@spher:radius_mm=3", "did you mean sphere"),
        ("lambert:kd=0.5@sphere:", "needs radius_mm"),
        ("lambert:kd=0.5@sphere:radius_mm=-3", "radius_mm=-3 is impossible"),
        ("lambert:kd=0.5@sphere:radius_mm=3,axis_deg=4", "has no axis_deg"),
        ("lambert:kd=0.5@sphere:radius_mm=3@cylinder:radius_mm=3", "two forms"),
        ("lambert:kd=0.5@tilted:x_deg=50", "x_deg is too large"),
        ("lambert:kd=0.5@tilted:x_deg=1@tilted:y_deg=1", "given twice"),
        ("lambert:kd=0.5@checker:side_mm=3", "changes nothing"),
        ("lambert:kd=0.5@checker:side_mm=3,ks=2", "has no parameter ks"),
        ("lambert:kd=0.5@checker:side_mm=3,kd=-2", "below 0"),
        ("lambert:kd=0.5@image:file=nowhere.png,kd=0.1", "no file nowhere.png"),
        ("lambert:kd=0.5@checker:side_mm=3,kd=0.1@gradient:kd=0.2", "two patterns"),
        ("lambert:kd=0.5@rough:slope_rms=0.9,wavelength_mm=2", "slope_rms=0.9 is impossible"),
        ("lambert:kd=0.5@rough:slope_rms=0.1,wavelength_mm=2,seed=1.5", "no whole number"),
        ("lambert:kd=0.5@raised:mm=1/2/3", "has 3 values"),
    ],
)
def test_wrong_parts_are_refused_in_one_line(line: str, what: str) -> None:
    """Would catch a silent default, or a traceback."""
    with pytest.raises(BadInput, match=what) as caught:
        parse_material(line)
    assert "\n" not in str(caught.value)


def test_angles_are_in_degrees() -> None:
    """Would catch radians at the person's side."""
    mounting = parse_material("lambert:kd=0.5@cylinder:radius_mm=9,axis_deg=30@tilted:x_deg=2").mounting
    assert degrees(mounting.axis_rad) == pytest.approx(30.0)
    assert degrees(mounting.tilt_x_rad) == pytest.approx(2.0)
