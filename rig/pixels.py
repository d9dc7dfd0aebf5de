"""Directions and distances for every pixel of one image of a flat sample.

The camera is a pinhole in OpenCV's convention: the centre of the first pixel is (column 0, row 0), camera
coordinates are x along the image's right, y along its down, z along the viewing direction. A ray through a
pixel's centre meets the sample's plane z = 0 in one point; from there the lamp's centre and the pupil's
centre are seen in the directions wi and wo of that pixel. With camera azimuth and turntable at zero, image
right is the sample's +x and image down its -y.

The lamp is small: an isotropic point whose intensity is `distance_mm` squared at level 1, so that its
irradiance on the sample is ``(distance_mm / light_distance_mm)**2 * cos(theta_i)``, 1 at the centre under
normal incidence.

Everything is float64 and in the sample's frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from rig.angles import FloatArray, unit
from rig.kinematics import Kinematics

if TYPE_CHECKING:
    from rig.description import Rig

BoolArray = npt.NDArray[np.bool_]

_DISTORTION_TOLERANCE = 1e-9
"""Largest error of an undistorted ray, as a tangent: a millionth of a pixel at any usual focal length."""


@dataclass(frozen=True, eq=False)
class PixelGeometry:
    """What every pixel sees. A pixel whose ray never meets the sample's plane is NaN, and not on the sample.

    Attributes
    ----------
    position_mm : ndarray, shape (H, W, 2)
        Where the pixel's ray meets the sample, (x, y).
    wi, wo : ndarray, shape (H, W, 3)
        Unit vectors from there to the centres of lamp and pupil.
    light_distance_mm, camera_distance_mm : ndarray, shape (H, W)
        Lengths of those two ways.
    on_sample : ndarray of bool, shape (H, W)
        The pixel's centre sees the sample's disc from above.
    """

    position_mm: FloatArray
    wi: FloatArray
    wo: FloatArray
    light_distance_mm: FloatArray
    camera_distance_mm: FloatArray
    on_sample: BoolArray


def pixel_geometry(
    rig: Rig,
    angles_rad: npt.ArrayLike,
    *,
    rows: npt.ArrayLike | None = None,
    cols: npt.ArrayLike | None = None,
) -> PixelGeometry:
    """Geometry of the pixels of one image.

    Parameters
    ----------
    rig : Rig
    angles_rad : array_like, shape (J,)
        Joint angles in the order of `rig.arm_joints`.
    rows, cols : array_like, shape (H,) and (W,), optional
        Rows and columns wanted, as pixel coordinates (fractions are points between pixels' centres); by
        default the whole frame.

    Returns
    -------
    PixelGeometry
    """
    frames = Kinematics(rig).frames(angles_rad)
    rays = camera_rays(rig, rows, cols) @ frames.camera_rotation.T
    camera = frames.camera_mm
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = -camera[2] / rays[..., 2]
    distance = np.where(distance > 0.0, distance, np.nan)
    points = camera + distance[..., None] * rays
    points[..., 2] = 0.0  # what is left there is rounding
    to_light = frames.light_mm - points
    light_distance = np.sqrt(np.sum(to_light**2, axis=-1))
    position = points[..., :2]
    radius_squared = np.sum(position**2, axis=-1)
    return PixelGeometry(
        position_mm=position,
        wi=to_light / light_distance[..., None],
        wo=np.where(np.isnan(distance)[..., None], np.nan, -rays),
        light_distance_mm=light_distance,
        camera_distance_mm=distance,
        on_sample=(radius_squared <= (rig.sample.diameter_mm / 2.0) ** 2) & (camera[2] > 0.0),
    )


def pixel_direction_derivatives(
    rig: Rig,
    angles_rad: npt.ArrayLike,
    *,
    rows: npt.ArrayLike | None = None,
    cols: npt.ArrayLike | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Change of every pixel's directions per radian of each joint, exact.

    The pixel stays and the joint moves, so the pixel sees another point of the sample, and the derivative
    holds the change of wi that comes with it.

    Parameters
    ----------
    rig, angles_rad, rows, cols
        As in `pixel_geometry`.

    Returns
    -------
    d_wi, d_wo : ndarray, shape (J, H, W, 3)
    """
    kinematics = Kinematics(rig)
    frames = kinematics.frames(angles_rad)
    pixels = pixel_geometry(rig, angles_rad, rows=rows, cols=cols)
    light_turns, camera_turns = (turns[:, None, None, :] for turns in kinematics.turns(angles_rad))
    # The ray is fixed to the camera, so it turns with it: dwo = turn x wo.
    d_wo = np.cross(camera_turns, pixels.wo[None])
    # The point p = camera - distance * wo stays in the plane z = 0, which tells how the distance changes.
    distance = pixels.camera_distance_mm[..., None]
    d_point = np.cross(camera_turns, frames.camera_mm) - distance * d_wo
    d_point -= d_point[..., 2:] / pixels.wo[..., 2:] * pixels.wo
    d_to_light = np.cross(light_turns, frames.light_mm) - d_point
    along = np.sum(d_to_light * pixels.wi, axis=-1, keepdims=True)
    d_wi = (d_to_light - along * pixels.wi) / pixels.light_distance_mm[..., None]
    return d_wi, d_wo


def irradiance(rig: Rig, pixels: PixelGeometry, level: float = 1.0) -> FloatArray:
    """Irradiance of the small lamp on the sample, 1 at the centre under normal incidence at level 1.

    Parameters
    ----------
    rig : Rig
    pixels : PixelGeometry
    level : float
        Lamp level, 0 to 1.

    Returns
    -------
    ndarray, shape (H, W)
        0 where the lamp is below the horizon, NaN where the pixel does not see the sample's plane.
    """
    falloff = (rig.lamp.distance_mm / pixels.light_distance_mm) ** 2
    return np.asarray(level * falloff * np.maximum(pixels.wi[..., 2], 0.0))


def source_solid_angle_sr(rig: Rig) -> float:
    """Solid angle of the lamp's disc, seen from the sample's centre, in steradians."""
    return _disc_solid_angle_sr(rig.lamp.diameter_mm, rig.lamp.distance_mm)


def receiver_solid_angle_sr(rig: Rig) -> float:
    """Solid angle of the camera's entrance pupil, seen from the sample's centre, in steradians."""
    return _disc_solid_angle_sr(rig.camera.aperture_diameter_mm, rig.camera.distance_mm)


def _disc_solid_angle_sr(diameter_mm: float, distance_mm: float) -> float:
    """Solid angle of a disc seen along its axis: 2 pi (1 - cos of its half angle), without cancellation."""
    half_angle = math.atan2(diameter_mm / 2.0, distance_mm)
    return 4.0 * math.pi * math.sin(half_angle / 2.0) ** 2


def camera_rays(rig: Rig, rows: npt.ArrayLike | None = None, cols: npt.ArrayLike | None = None) -> FloatArray:
    """Directions of the pixels' rays in camera coordinates: right, down, forward.

    Parameters
    ----------
    rig : Rig
    rows, cols : array_like, shape (H,) and (W,), optional
        As in `pixel_geometry`.

    Returns
    -------
    ndarray, shape (H, W, 3)
        Unit vectors; NaN for a pixel that the lens gives no ray.
    """
    camera = rig.camera
    v = np.arange(camera.height_px) if rows is None else np.asarray(rows)
    u = np.arange(camera.width_px) if cols is None else np.asarray(cols)
    centre_u, centre_v = camera.principal_point_px
    x, y = np.meshgrid((u - centre_u) / camera.focal_length_px, (v - centre_v) / camera.focal_length_px)
    if any(camera.distortion):
        x, y = _undistort(x, y, camera.distortion)
    return unit(np.stack([x, y, np.ones_like(x)], axis=-1))


def _undistort(x: FloatArray, y: FloatArray, distortion: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Undo OpenCV's lens distortion on normalised image coordinates of any one shape."""
    import cv2

    points = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    coefficients = np.array(distortion)
    # Many more steps than OpenCV's default of five, which leave whole pixels of error in strong lenses.
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    straight = cv2.undistortPointsIter(points, np.eye(3), coefficients, np.eye(3), np.eye(3), criteria)
    rays = cv2.convertPointsToHomogeneous(straight)
    again, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), coefficients)
    # Where the lens model folds back on itself no ray belongs to the pixel, and the iteration wanders.
    lost = np.max(np.abs(again - points), axis=-1, keepdims=True) > _DISTORTION_TOLERANCE
    result = np.where(lost, np.nan, straight).reshape(*x.shape, 2)
    return result[..., 0], result[..., 1]
