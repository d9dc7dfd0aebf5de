"""Where the nodes of lamp, pixel and pupil lie at a pose: a few numbers in float64, for any arithmetic.

A pixel's place (x, y) on the plane at distance 1 before the camera goes to the sample's plane by a homography
whose numbers are exact near the image's middle. Single precision loses nothing there, as it would in the
intersection of a ray that comes from half a metre away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.pixels import camera_rays

if TYPE_CHECKING:
    from rig.description import Rig
    from rig.kinematics import Frames

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Extents:
    """How far the parts reach that radiance is averaged over; 0 for a point.

    Parameters
    ----------
    lamp_radius_mm : float
        A lamp of no size shines equally into all directions; a disc has its cosine.
    pixel : float
        Side of what a pixel sees, in pixels: 1, or 0 for its centre.
    pupil_radius_mm : float
        Radius of the camera's entrance pupil.
    focus_mm : float
        Distance from the pupil to the plane that is in focus; 0 where everything is.
    """

    lamp_radius_mm: float
    pixel: float
    pupil_radius_mm: float
    focus_mm: float = 0.0

    @property
    def parts(self) -> tuple[bool, bool, bool]:
        """Whether lamp, pixel and pupil have a size."""
        return self.lamp_radius_mm > 0.0, self.pixel > 0.0, self.pupil_radius_mm > 0.0


POINTS = Extents(0.0, 0.0, 0.0)
"""Point lamp, pixel's centre, pinhole."""


def extents_of(rig: Rig) -> Extents:
    """Return what the rig file states."""
    camera = rig.camera
    focus_mm = camera.focus_distance_mm or camera.distance_mm
    return Extents(rig.lamp.diameter_mm / 2.0, 1.0, camera.aperture_diameter_mm / 2.0, focus_mm)


@dataclass(frozen=True, eq=False)
class Lens:
    """Pixels on the plane at distance 1 before the camera.

    Within one pixel the lens is taken as affine; strong distortion bends it by 1e-4 of a pixel.

    Attributes
    ----------
    places : ndarray, shape (N, 2)
        (x, y) of the pixels' centres: right, down. NaN where the lens gives no ray.
    across, down : ndarray, shape (N, 2)
        From one side of the pixel to the other.
    """

    places: Array
    across: Array
    down: Array

    def __getitem__(self, pixels: NDArray[np.intp]) -> Lens:
        return Lens(self.places[pixels], self.across[pixels], self.down[pixels])

    def __len__(self) -> int:
        return len(self.places)


def lens_of(rig: Rig) -> Lens:
    """Return the pixels of a rig's camera, row by row."""
    rows, cols = np.arange(rig.camera.height_px), np.arange(rig.camera.width_px)
    return Lens(
        _places(rig, rows, cols),
        _places(rig, rows, cols + 0.5) - _places(rig, rows, cols - 0.5),
        _places(rig, rows + 0.5, cols) - _places(rig, rows - 0.5, cols),
    )


def _places(rig: Rig, rows: NDArray[Any], cols: NDArray[Any]) -> Array:
    rays = camera_rays(rig, rows, cols).reshape(-1, 3)
    return np.asarray(rays[:, :2] / rays[:, 2:])


@dataclass(frozen=True, eq=False)
class View:
    """Lamp and camera of one pose in the sample's frame, in millimetres.

    Attributes
    ----------
    homography : ndarray, shape (3, 3)
        Carries (x, y, 1) of the lens to (X w, Y w, w), where the ray meets the sample's plane; w > 0 where
        it does.
    camera_rotation : ndarray, shape (3, 3)
        Columns: right, down, forward.
    light_mm, light_axes : ndarray, shape (3,) and (2, 3)
        Centre of the lamp, and unit vectors along two radii of its disc at right angles.
    light_radius_mm : float
        Of that disc.
    facing : ndarray, shape (3,)
        Unit vector from the lamp to the sample's centre.
    camera_mm, pupil_disc_mm : ndarray, shape (3,) and (2, 3)
        Likewise of the entrance pupil.
    strength : float
        Of a lamp whose irradiance at the sample's centre at normal incidence is 1: times the cosines over
        the distance squared it is the irradiance.
    focus_mm : float
        As in `Extents`.
    """

    homography: Array
    camera_rotation: Array
    light_mm: Array
    light_axes: Array
    light_radius_mm: float
    facing: Array
    camera_mm: Array
    pupil_disc_mm: Array
    strength: float
    focus_mm: float

    @property
    def light_disc_mm(self) -> Array:
        """The two radii, shape (2, 3)."""
        return self.light_radius_mm * self.light_axes

    @property
    def numbers(self) -> Array:
        """What nodes on a flat sample need, in a row, shape (32,)."""
        parts = (self.homography, self.light_mm, self.light_disc_mm, self.facing, self.camera_mm)
        last = np.array([self.strength, self.focus_mm])
        return np.concatenate([part.ravel() for part in (*parts, self.pupil_disc_mm, last)])


def view_of(frames: Frames, extents: Extents) -> View:
    """Return the view of a pose.

    Parameters
    ----------
    frames : Frames
        Where lamp and camera stand.
    extents : Extents
        Sizes of lamp and pupil.
    """
    rotation, camera, light = frames.camera_rotation, frames.camera_mm, frames.light_mm
    distance_squared = float(light @ light)
    facing = -light / np.sqrt(distance_squared)
    # A ray q from the camera meets z = 0 at camera - camera_z/q_z q; w = -q_z is above 0 if it goes down.
    homography = -np.outer([*camera[:2], 1.0], rotation[2])
    homography[:2] += camera[2] * rotation[:2]
    # The disc's irradiance where it is straight above is radiance pi a^2/(a^2 + d^2).
    return View(
        homography=homography,
        camera_rotation=rotation,
        light_mm=light,
        light_axes=_disc_axes(facing),
        light_radius_mm=extents.lamp_radius_mm,
        facing=facing,
        camera_mm=camera,
        pupil_disc_mm=extents.pupil_radius_mm * rotation[:, :2].T,
        strength=distance_squared + extents.lamp_radius_mm**2,
        focus_mm=extents.focus_mm,
    )


def meet(view: View, lens: Lens, offset: Array, pupil: Array | None = None) -> tuple[Array, Array]:
    """Return where pixels' points meet the sample's plane, seen from the pupil's middle or another point.

    Parameters
    ----------
    view : View
    lens : Lens
        N pixels.
    offset : array_like, shape (2,)
        Of the point from the pixel's centre, right and down, in pixels.
    pupil : array_like, shape (2,), optional
        A point of the pupil, right and down, in its radii.

    Returns
    -------
    points : ndarray, shape (N, 3)
    w : ndarray, shape (N,)
        Above 0 where the ray does meet it.
    """
    x, y = (lens.places + offset[0] * lens.across + offset[1] * lens.down).T
    across, up, w = (
        np.outer(view.homography[:, 0], x) + np.outer(view.homography[:, 1], y) + view.homography[:, 2:]
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        points = np.stack([across / w, up / w, np.zeros_like(w)], axis=-1)
        if pupil is not None and view.focus_mm > 0.0:
            points = out_of_focus(
                points, view.camera_mm, view.camera_rotation[:, 2], pupil @ view.pupil_disc_mm, view.focus_mm
            )
    return points, w


def out_of_focus(points_mm: Array, camera_mm: Array, forward: Array, off_mm: Array, focus_mm: float) -> Array:
    """Move points of the sample's plane to where another point of the pupil sees them.

    All rays of a pixel's point through a thin lens meet in the plane in focus; the one through the lens's
    middle goes straight on. Potmesil and Chakravarty (1981, "A lens and aperture camera model for synthetic
    image generation", section 4) measure what is left beside that plane: the circle of confusion.

    Parameters
    ----------
    points_mm : ndarray, shape (..., 3)
        Where rays through the pupil's middle meet z = 0.
    camera_mm, forward : ndarray, shape (..., 3)
        That middle, and the unit vector along the optical axis.
    off_mm : ndarray, shape (..., 3)
        The pupil's other point, from its middle.
    focus_mm : float
        Distance of the plane in focus.
    """
    way = points_mm - camera_mm
    depth = np.sum(way * forward, axis=-1, keepdims=True)
    slope = way / depth
    beyond = (focus_mm - depth) / (focus_mm * slope[..., 2:] - off_mm[..., 2:])
    moved = points_mm + beyond * (slope[..., 2:] * off_mm - off_mm[..., 2:] * slope)
    moved[..., 2] = points_mm[..., 2]
    return np.asarray(moved)


def sample_share(view: View, lens: Lens, side: float, radius_mm: float) -> Array:
    """Return which part of each pixel the sample fills, shape (N,).

    Within a pixel the sample's edge is taken as straight, at the mean distance of what is curved. With
    `side` 0 it is the centre that decides.
    """
    if view.camera_mm[2] <= 0.0:
        return np.zeros(len(lens))
    centre, w = _beyond(view, lens, np.zeros(2), radius_mm)
    if side > 0.0:
        behind, ahead = (
            np.stack([_beyond(view, lens, sign * offset, radius_mm)[0] for offset in 0.5 * side * np.eye(2)])
            for sign in (-1, 1)
        )
        # The mean over the box: the edge is curved, and its chord would lie inside.
        middle = centre + np.sum(ahead - 2.0 * centre + behind, axis=0) / 6.0
        share = half_plane_share(-middle, *np.abs(ahead - behind))
    else:
        share = np.where(centre <= 0.0, 1.0, 0.0)
    return np.where((w > 0.0) & np.isfinite(share), share, 0.0)


def half_plane_share(reach: Array, a: Array, b: Array) -> Array:
    """Return the part of the unit square around the origin where a u + b v <= reach, for a, b >= 0."""
    # The square's shadow on the gradient is a trapezium: flat in the middle, a triangle at either end.
    half, flat = 0.5 * (a + b), 0.5 * np.abs(a - b)
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = 0.5 + reach / np.maximum(a, b)
        corner = np.square(half - np.abs(reach)) / (2.0 * a * b)
    end = np.where(reach > 0.0, 1.0 - corner, corner)
    share = np.where(np.abs(reach) <= flat, middle, end)
    return np.where(reach >= half, 1.0, np.where(reach <= -half, 0.0, share))


def _beyond(view: View, lens: Lens, offset: Array, radius_mm: float) -> tuple[Array, Array]:
    """How far points lie beyond the sample's edge, in millimetres, and w as `meet` has it."""
    points, w = meet(view, lens, offset)
    return np.hypot(points[:, 0], points[:, 1]) - radius_mm, w


def _disc_axes(axis: Array) -> Array:
    """Return two unit vectors (2, 3) at right angles to a unit vector (3,)."""
    first = _cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.sqrt(first @ first)
    return np.stack([first, _cross(axis, first)])


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of two vectors (3,), in a tenth of NumPy's time."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
