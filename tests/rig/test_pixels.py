"""Geometry of every pixel, against OpenCV's own projection and against differences."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from rig.description import Camera, Lamp
from rig.description import default_rig as describe
from rig.kinematics import Kinematics
from rig.pixels import (
    irradiance,
    pixel_direction_derivatives,
    pixel_geometry,
    receiver_solid_angle_sr,
    source_solid_angle_sr,
)

if TYPE_CHECKING:
    from rig.angles import FloatArray
    from rig.description import Rig

POSES_DEG = [
    (0.0, 0.0, 0.0, 0.0),
    (30.0, 40.0, -50.0, 20.0),
    (-80.0, -170.0, 84.0, 100.0),
    (60.0, 180.0, 60.0, -45.0),
]
WIDE = Camera(focal_length_px=200.0, distortion=(-0.3, 0.1, 0.001, 0.002, 0.01))


def project(rig: Rig, angles_rad: FloatArray, points_mm: FloatArray) -> FloatArray:
    """Project points of the sample (N, 2) into the image with OpenCV: (N, 2) columns and rows."""
    frames = Kinematics(rig).frames(angles_rad)
    points = np.column_stack([points_mm, np.zeros(len(points_mm))])
    centre_u, centre_v = rig.camera.principal_point_px
    f = rig.camera.focal_length_px
    matrix = np.array([[f, 0.0, centre_u], [0.0, f, centre_v], [0.0, 0.0, 1.0]])
    in_camera = (points - frames.camera_mm) @ frames.camera_rotation
    found, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), matrix, np.array(rig.camera.distortion))
    return np.asarray(found[:, 0, :])


@pytest.mark.parametrize("pose_deg", POSES_DEG)
@pytest.mark.parametrize("camera", [Camera(), WIDE, Camera(principal_point_px=(10.0, 80.0))])
def test_pixels_project_back_onto_themselves(pose_deg: tuple[float, ...], camera: Camera) -> None:
    """Catch half a pixel, swapped axes, a mirrored image, or a distortion applied the wrong way round."""
    rig, pose = describe(camera=camera), np.radians(pose_deg)
    pixels = pixel_geometry(rig, pose)
    seen = np.isfinite(pixels.camera_distance_mm)
    assert seen.all() or pose_deg[2] > 80.0  # looking along the sample, the picture's top sees past it
    rows, columns = np.nonzero(seen)
    found = project(rig, pose, pixels.position_mm[seen])
    np.testing.assert_allclose(found, np.column_stack([columns, rows]), rtol=0, atol=1e-6)


@pytest.mark.parametrize("pose_deg", POSES_DEG)
def test_the_optical_axis_sees_the_central_directions(default_rig: Rig, pose_deg: tuple[float, ...]) -> None:
    """Catch a per-pixel geometry that disagrees with kinematics where both tell the same."""
    pose = np.radians(pose_deg)
    centre = pixel_geometry(default_rig, pose, rows=[47.5], cols=[63.5])
    wi, wo = Kinematics(default_rig).directions(pose)
    np.testing.assert_allclose(centre.wi[0, 0], wi, rtol=0, atol=1e-14)
    np.testing.assert_allclose(centre.wo[0, 0], wo, rtol=0, atol=1e-14)
    np.testing.assert_allclose(centre.position_mm, 0.0, atol=1e-10)
    assert centre.light_distance_mm[0, 0] == pytest.approx(500.0)
    assert centre.camera_distance_mm[0, 0] == pytest.approx(600.0)


def test_picture_from_above_is_a_map(default_rig: Rig) -> None:
    """Catch a picture that is turned or mirrored: x to the right, y up, 0.25 mm a pixel."""
    position = pixel_geometry(default_rig, np.zeros(4)).position_mm
    assert position.shape == (96, 128, 2)
    np.testing.assert_allclose(position[0, 0], [-63.5 / 4, 47.5 / 4], rtol=1e-12)
    np.testing.assert_allclose(position[0, 1] - position[0, 0], [0.25, 0.0], atol=1e-12)
    np.testing.assert_allclose(position[1, 0] - position[0, 0], [0.0, -0.25], atol=1e-12)


@pytest.mark.parametrize("pose_deg", POSES_DEG)
def test_directions_and_distances_close_the_triangle(default_rig: Rig, pose_deg: tuple[float, ...]) -> None:
    """Catch directions that are not unit, or do not lead from the point to lamp and pupil."""
    pose = np.radians(pose_deg)
    pixels = pixel_geometry(default_rig, pose)
    frames = Kinematics(default_rig).frames(pose)
    points = np.concatenate([pixels.position_mm, np.zeros((96, 128, 1))], axis=-1)
    lamp = points + pixels.light_distance_mm[..., None] * pixels.wi
    pupil = points + pixels.camera_distance_mm[..., None] * pixels.wo
    seen = np.isfinite(pixels.camera_distance_mm)
    np.testing.assert_allclose(lamp[seen], np.broadcast_to(frames.light_mm, lamp[seen].shape), atol=1e-8)
    np.testing.assert_allclose(pupil[seen], np.broadcast_to(frames.camera_mm, pupil[seen].shape), atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(pixels.wo[seen], axis=-1), 1.0, atol=1e-14)


@pytest.mark.parametrize("pose_deg", POSES_DEG[1:])
@pytest.mark.parametrize("camera", [Camera(), WIDE])
def test_derivatives_against_differences(pose_deg: tuple[float, ...], camera: Camera) -> None:
    """Catch the servo's share of the uncertainty going wrong: a sign, or the point's shift on the sample."""
    rig, pose = describe(camera=camera), np.radians(pose_deg)
    rows, cols, step = [5, 40, 90], [3, 64, 100, 127], 1e-5
    d_wi, d_wo = pixel_direction_derivatives(rig, pose, rows=rows, cols=cols)
    assert d_wi.shape == d_wo.shape == (4, 3, 4, 3)
    for joint in range(4):
        nudge = step * np.eye(4)[joint]
        ahead, behind = (pixel_geometry(rig, pose + s * nudge, rows=rows, cols=cols) for s in (1, -1))
        for exact, name in ((d_wi, "wi"), (d_wo, "wo")):
            difference = (getattr(ahead, name) - getattr(behind, name)) / (2 * step)
            # Grazing rays move fast over the sample: the difference's own error grows with the derivative.
            scale = max(1.0, float(np.nanmax(np.abs(difference))))
            np.testing.assert_allclose(exact[joint] / scale, difference / scale, rtol=0, atol=2e-6)


def test_derivative_at_the_centre_is_the_central_one_plus_the_shift(default_rig: Rig) -> None:
    """Catch a turntable that moves the image: it turns the directions about z, and wo by nothing else."""
    pose = np.radians(POSES_DEG[1])
    _, d_wo = pixel_direction_derivatives(default_rig, pose, rows=[47.5], cols=[63.5])
    _, expected = Kinematics(default_rig).derivatives(pose)
    np.testing.assert_allclose(d_wo[:, 0, 0], expected, rtol=0, atol=1e-14)


def test_rows_and_columns_select(default_rig: Rig) -> None:
    """Catch a window that is cut out at the wrong place or computed differently."""
    pose = np.radians(POSES_DEG[1])
    whole = pixel_geometry(default_rig, pose)
    part = pixel_geometry(default_rig, pose, rows=range(10, 20), cols=[0, 127])
    for name in ("position_mm", "wi", "wo", "light_distance_mm", "camera_distance_mm", "on_sample"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[10:20][:, [0, 127]])
    none = pixel_geometry(default_rig, pose, rows=[], cols=[3])
    assert none.wi.shape == (0, 1, 3)


def test_pixels_beside_the_sample(default_rig: Rig) -> None:
    """Catch pixels of the holder that count as sample, and samples cut too small."""
    pose = np.radians([0.0, 0.0, 80.0, 0.0])
    pixels = pixel_geometry(default_rig, pose)
    radius = np.hypot(pixels.position_mm[..., 0], pixels.position_mm[..., 1])
    assert pixels.on_sample.any()
    assert not pixels.on_sample.all()
    np.testing.assert_array_equal(pixels.on_sample, radius <= 25.0)


def test_rays_over_the_horizon_are_nan() -> None:
    """Catch points behind the camera taken for points of the sample, a warning, or NaN on the sample."""
    rig = describe(camera=Camera(focal_length_px=100.0))
    pose = np.radians([0.0, 0.0, 80.0, 0.0])
    pixels = pixel_geometry(rig, pose)
    lost = np.isnan(pixels.camera_distance_mm)
    assert 0 < lost.sum() < lost.size
    for values in (pixels.position_mm, pixels.wi, pixels.wo):
        assert np.array_equal(np.isnan(values).all(axis=-1), lost)
        assert np.array_equal(np.isnan(values).any(axis=-1), lost)
    assert np.array_equal(np.isnan(pixels.light_distance_mm), lost)
    assert not pixels.on_sample[lost].any()
    assert np.array_equal(np.isnan(irradiance(rig, pixels)), lost)
    for derivative in pixel_direction_derivatives(rig, pose):
        assert np.array_equal(np.isnan(derivative).any(axis=(0, -1)), lost)


def test_a_lens_that_folds_back_gives_nan_not_nonsense() -> None:
    """Catch rays that the distortion's inverse makes up where none exists."""
    rig = describe(camera=Camera(focal_length_px=60.0, distortion=(-0.5, 0.0, 0.0, 0.0, 0.0)))
    pixels = pixel_geometry(rig, np.zeros(4))
    seen = np.isfinite(pixels.camera_distance_mm)
    assert not seen[0, 0]
    assert seen[48, 64]
    rows, columns = np.nonzero(seen)
    found = project(rig, np.zeros(4), pixels.position_mm[seen])
    np.testing.assert_allclose(found, np.column_stack([columns, rows]), rtol=0, atol=1e-6)


def test_camera_below_the_sample_sees_none_of_it() -> None:
    """Catch the back of the sample measured as its front."""
    rig = describe()
    assert not pixel_geometry(rig, np.radians([0.0, 0.0, 120.0, 0.0])).on_sample.any()


def test_irradiance_is_normalised_and_falls_off() -> None:
    """Catch a cosine twice or never, or a distance to the wrong point."""
    rig = describe(lamp=Lamp(distance_mm=50.0))
    above = irradiance(rig, pixel_geometry(rig, np.zeros(4), rows=[47.5], cols=[63.5, 63.5 + 80.0]), 0.5)
    # 80 pixels are 20 mm: r^2 = 50^2 + 20^2, and E goes with 1 / r^2 and cos = 50 / r.
    np.testing.assert_allclose(above[0], [0.5, 0.5 * (50.0**2 / (50.0**2 + 20.0**2)) ** 1.5], rtol=1e-12)
    tilted = irradiance(rig, pixel_geometry(rig, np.radians([60.0, 0, 0, 0]), rows=[47.5], cols=[63.5]))
    assert tilted[0, 0] == pytest.approx(0.5)
    below = irradiance(rig, pixel_geometry(rig, np.radians([100.0, 0, 0, 0]), rows=[47.5], cols=[63.5]))
    assert below[0, 0] == 0.0


def test_solid_angles(default_rig: Rig) -> None:
    """Catch a diameter taken for a radius, and cancellation for a tiny lamp."""
    assert source_solid_angle_sr(default_rig) == pytest.approx(math.pi * 2.5**2 / 500.0**2, rel=3e-5)
    assert receiver_solid_angle_sr(default_rig) == pytest.approx(math.pi * 5.0**2 / 600.0**2, rel=1e-4)
    exact = 2.0 * math.pi * (1.0 - 100.0 / math.hypot(100.0, 75.0))
    assert source_solid_angle_sr(describe(lamp=Lamp(distance_mm=100.0, diameter_mm=150.0))) == pytest.approx(
        exact
    )
    tiny = source_solid_angle_sr(describe(lamp=Lamp(distance_mm=1e5, diameter_mm=1e-3)))
    assert tiny == pytest.approx(math.pi * 0.25e-16, rel=1e-12, abs=0)
