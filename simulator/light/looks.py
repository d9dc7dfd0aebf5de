"""What places of the frame see, many poses at once: for estimates made before anything is rendered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.kinematics import Kinematics
from rig.pixels import camera_rays

if TYPE_CHECKING:
    from rig.description import Rig

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Look:
    """What pixels see at poses, in the sample's frame, in millimetres.

    Attributes
    ----------
    light_mm, camera_mm : ndarray, shape (P, 3)
        Lamp and entrance pupil.
    camera_rotation : ndarray, shape (P, 3, 3)
        Columns: right, down, forward.
    points_mm : ndarray, shape (P, K, N, 3)
        Where K points of N pixels each meet the sample's plane; anything where they do not.
    seen : ndarray of bool, shape (P, N)
        Whether the first point of the pixel sees the sample's disc from above.
    """

    light_mm: Array
    camera_mm: Array
    camera_rotation: Array
    points_mm: Array
    seen: NDArray[np.bool_]


class Looks:
    """Some places of a camera's frame, evenly spread over it.

    Parameters
    ----------
    rig : Rig
    count : int
        Rows and columns of them, at most.
    offsets : sequence of (float, float)
        Down and right, in pixels, of the points of each from its centre; the first decides what it sees.
    """

    def __init__(
        self, rig: Rig, count: int, offsets: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    ) -> None:
        self._rig, self._kinematics, self._count, self._offsets = rig, Kinematics(rig), count, offsets
        camera = rig.camera
        rows, cols = (_spread(size, min(size, count)) for size in (camera.height_px, camera.width_px))
        self._rays = np.stack(
            [camera_rays(rig, rows + down, cols + right).reshape(-1, 3) for down, right in offsets]
        )

    def at(self, poses_rad: Array) -> Look:
        """Look at poses, each as if it were alone.

        Parameters
        ----------
        poses_rad : ndarray, shape (P, J)
            True angles of the arm joints.
        """
        frames = [self._kinematics.frames(pose) for pose in poses_rad]
        light, camera, rotation = (
            np.stack([getattr(frame, name) for frame in frames])
            for name in ("light_mm", "camera_mm", "camera_rotation")
        )
        # One product for each pose: how many there are changes no digit.
        rays = self._rays.reshape(-1, 3) @ np.swapaxes(rotation, -1, -2)
        with np.errstate(divide="ignore", invalid="ignore"):
            way = -camera[:, None, 2:] / rays[..., 2:]
            points = camera[:, None] + way * rays
        points[..., 2] = 0.0
        points = points.reshape(len(frames), *self._rays.shape)
        meets = (way[..., 0] > 0.0).reshape(points.shape[:3])[:, 0]
        edge = self._rig.sample.diameter_mm / 2.0
        with np.errstate(invalid="ignore"):
            inside = np.sum(points[:, 0, :, :2] ** 2, axis=-1) <= edge**2
        seen = meets & inside & (camera[:, None, 2] > 0.0)
        return Look(light, camera, rotation, points, seen)

    def all_pixels(self) -> Looks:
        """Return the same for every pixel of the frame."""
        return Looks(self._rig, max(self._rig.camera.height_px, self._rig.camera.width_px), self._offsets)


def _spread(size: int, count: int) -> Array:
    """Return the middles of so many equal parts of a row of pixels; as many as there are, their centres."""
    return (np.arange(count) + 0.5) * size / count - 0.5
