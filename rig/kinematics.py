"""Joint angles to directions and back.

A machine is three open chains of hinges from one base: one carries the lamp, one the camera, one the sample.
With every joint at zero the three tips agree: lamp and camera stand above the sample on its normal +z, and
the sample's frame is the base's. A joint turns everything after it in its chain, right-handed about its axis,
so that a positive elevation (about +y) leans from +z towards +x. The lamp's direction is its chain's product
of rotations applied to +z, the camera's likewise, and both are told in the frame of the sample, which its own
chain may have turned.

The camera looks at the sample's centre. At zero its image's right is +x and its image's down is -y: seen from
above, the picture is a map with x to the right and y up.

`Kinematics.solve` goes the other way. For one light elevation, camera azimuth and elevation, and a turntable
it is closed form; `rig.inverse` holds that and the search for any other machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from rig.angles import FloatArray, direction_to_spherical, rotation, unit
from rig.errors import BadInput, Refused
from rig.inverse import CommonMachine, beyond_limits, solutions
from rig.ticks import tick_rad

if TYPE_CHECKING:
    from collections.abc import Callable

    from rig.description import Joint, Rig

CAMERA_AT_ZERO = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
"""Columns: image right, image down, viewing direction of a camera whose joints are all at zero."""

_Z = np.array([0.0, 0.0, 1.0])
_ROUNDING_RAD = 1e-9


@dataclass(frozen=True, eq=False)
class Frames:
    """Where lamp and camera stand, in the sample's frame.

    Attributes
    ----------
    light_mm, camera_mm : ndarray, shape (3,)
        Centre of the lamp's disc and of the camera's entrance pupil.
    camera_rotation : ndarray, shape (3, 3)
        Columns: the image's right, the image's down, the viewing direction. It carries camera coordinates
        (OpenCV's) to the sample's.
    """

    light_mm: FloatArray
    camera_mm: FloatArray
    camera_rotation: FloatArray


class Kinematics:
    """Forward and inverse kinematics of one machine.

    Poses are arrays of joint angles in radians in the order of `rig.arm_joints`, J of them.

    Parameters
    ----------
    rig : Rig
    """

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.joints: tuple[Joint, ...] = rig.arm_joints
        places = {joint.name: place for place, joint in enumerate(self.joints)}
        self.light_chain = tuple(places[name] for name in rig.arms.light)
        self.camera_chain = tuple(places[name] for name in rig.arms.camera)
        self.sample_chain = tuple(places[name] for name in rig.arms.sample)
        self.axes: FloatArray = unit([joint.axis for joint in self.joints])
        self.limits_rad: FloatArray = np.radians([joint.limits_deg for joint in self.joints])
        self.reach_rad: FloatArray = np.radians([joint.reach_deg for joint in self.joints])
        self.park_rad: FloatArray = np.radians([joint.park_deg for joint in self.joints])
        self.ticks_rad: FloatArray = np.array([tick_rad(joint) for joint in self.joints])
        self.common = CommonMachine.recognise(self)

    def directions(self, angles_rad: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Directions to lamp and camera from the sample's centre.

        Parameters
        ----------
        angles_rad : array_like, shape (..., J)

        Returns
        -------
        wi, wo : ndarray, shape (..., 3)
            Unit vectors in the sample's frame.
        """
        light, camera = self._tips(self._angles(angles_rad))
        return light @ _Z, camera @ _Z

    def frames(self, angles_rad: npt.ArrayLike) -> Frames:
        """Places of lamp and camera and the camera's orientation, in the sample's frame.

        Parameters
        ----------
        angles_rad : array_like, shape (J,)
        """
        light, camera = self._tips(self._angles(angles_rad, axes=1))
        return Frames(
            light_mm=self.rig.lamp.distance_mm * (light @ _Z),
            camera_mm=self.rig.camera.distance_mm * (camera @ _Z),
            camera_rotation=camera @ CAMERA_AT_ZERO,
        )

    def turns(self, angles_rad: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Rotation vectors of lamp and camera about the sample, per radian of each joint.

        Anything fixed to the lamp (or camera) at p, in the sample's frame, moves by ``cross(turn, p)`` per
        radian. A joint that turns the sample turns both the other way round.

        Parameters
        ----------
        angles_rad : array_like, shape (..., J)

        Returns
        -------
        light, camera : ndarray, shape (..., J, 3)
        """
        angles = self._angles(angles_rad)
        matrices = rotation(self.axes, angles)
        sample, sample_axes = self._chain(matrices, self.sample_chain)
        _, light_axes = self._chain(matrices, self.light_chain)
        _, camera_axes = self._chain(matrices, self.camera_chain)
        # Row vectors times the sample's rotation are its transpose applied: base frame to sample frame.
        return (light_axes - sample_axes) @ sample, (camera_axes - sample_axes) @ sample

    def derivatives(self, angles_rad: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Change of the central directions per radian of each joint, exact.

        Parameters
        ----------
        angles_rad : array_like, shape (..., J)

        Returns
        -------
        d_wi, d_wo : ndarray, shape (..., J, 3)
        """
        wi, wo = self.directions(angles_rad)
        light, camera = self.turns(angles_rad)
        return np.cross(light, wi[..., None, :]), np.cross(camera, wo[..., None, :])

    def separation_rad(self, angles_rad: npt.ArrayLike) -> FloatArray:
        """Angle between the directions to lamp and camera.

        Parameters
        ----------
        angles_rad : array_like, shape (..., J)

        Returns
        -------
        ndarray, shape (...)
        """
        return _angle_between(*self.directions(angles_rad))

    def check(self, angles_rad: npt.ArrayLike) -> None:
        """Make sure that a pose is within the joints' limits and keeps lamp and camera apart.

        Parameters
        ----------
        angles_rad : array_like, shape (J,)

        Raises
        ------
        Refused
            It is not; the message names the joint, its angle and its limits.
        """
        angles = self._angles(angles_rad, axes=1)
        self.require_limits(angles)
        self._check_separation(*self.directions(angles), where=lambda: "pose")

    def require_limits(self, angles_rad: npt.ArrayLike) -> None:
        """Make sure that a pose is within the joints' limits.

        Parameters
        ----------
        angles_rad : array_like, shape (J,)

        Raises
        ------
        Refused
            It is not; the message names the joint, its angle and its limits.
        """
        angles = self._angles(angles_rad, axes=1)
        for joint, angle, (low, high) in zip(self.joints, angles, self.reach_rad, strict=True):
            if not low - _ROUNDING_RAD <= angle <= high + _ROUNDING_RAD:
                raise beyond_limits(joint, float(angle), where="pose")

    def solve(self, wi: npt.ArrayLike, wo: npt.ArrayLike, near: npt.ArrayLike | None = None) -> FloatArray:
        """Find joint angles that bring lamp and camera to given directions.

        Where several poses do, the one whose farthest-travelling joint travels least from `near` is taken. So
        a joint that makes no difference (the turntable under light along the normal, the azimuth of a camera
        on the normal) stays where it is, unless that makes another one's way longer. An angle less than half
        a tick beyond a limit is taken for the limit.

        Parameters
        ----------
        wi, wo : array_like, shape (3,)
            Directions to light and camera in the sample's frame, any length.
        near : array_like, shape (J,), optional
            Where the joints are; by default parked.

        Returns
        -------
        ndarray, shape (J,)

        Raises
        ------
        BadInput
            A direction is not three finite numbers, or zero.
        Refused
            The pose is out of the machine's reach, or light and camera would be too close.
        """
        return self.solutions(wi, wo, near)[0]

    def solutions(
        self, wi: npt.ArrayLike, wo: npt.ArrayLike, near: npt.ArrayLike | None = None
    ) -> list[FloatArray]:
        """Find all the joint angles that `solve` chooses from, the one with the least travel first.

        A machine without a closed form may have more than are found.

        Parameters
        ----------
        wi, wo, near
            As in `solve`, which also says what is raised.

        Returns
        -------
        list of ndarray, shape (J,)
            At least one.
        """
        wi, wo = _direction(wi, "wi"), _direction(wo, "wo")
        where = partial(_name_pose, wi, wo)
        self._check_separation(wi, wo, where)
        start = self.park_rad if near is None else self._angles(near, axes=1)
        return solutions(self, wi, wo, start, where)

    def _check_separation(self, wi: FloatArray, wo: FloatArray, where: Callable[[], str]) -> None:
        apart_deg = math.degrees(float(_angle_between(wi, wo)))
        least_deg = self.rig.clearance.min_separation_deg
        if apart_deg < least_deg - math.degrees(_ROUNDING_RAD):
            raise Refused(
                f"light and camera would be {apart_deg:.2f} deg apart, less than {least_deg:g} deg",
                where=where(),
                todo="leave this pose out, or lower clearance.min_separation_deg if the arms allow it",
            )

    def _angles(self, angles_rad: npt.ArrayLike, axes: int | None = None) -> FloatArray:
        angles = np.asarray(angles_rad, dtype=np.float64)
        if angles.ndim == 0 or angles.shape[-1] != len(self.joints) or axes not in {None, angles.ndim}:
            raise BadInput(
                f"a pose has {len(self.joints)} joint angles, not shape {angles.shape}",
                where="pose",
                todo=f"give one angle for each of {', '.join(joint.name for joint in self.joints)}",
            )
        return angles

    def _tips(self, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations of the lamp's and the camera's tip, in the sample's frame."""
        matrices = rotation(self.axes, angles)
        to_sample = np.swapaxes(self._chain(matrices, self.sample_chain)[0], -1, -2)
        light, _ = self._chain(matrices, self.light_chain)
        camera, _ = self._chain(matrices, self.camera_chain)
        return to_sample @ light, to_sample @ camera

    def _chain(self, matrices: FloatArray, chain: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Rotation (..., 3, 3) of a chain's tip, and its joints' axes (..., J, 3) in the base's frame.

        The axes of joints that are not in the chain are zero.
        """
        tip = np.broadcast_to(np.eye(3), (*matrices.shape[:-3], 3, 3))
        axes = np.zeros(matrices.shape[:-1])
        for place in chain:
            axes[..., place, :] = tip @ self.axes[place]
            tip = tip @ matrices[..., place, :, :]
        return tip, axes


def _angle_between(a: FloatArray, b: FloatArray) -> FloatArray:
    chord, total = np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)
    return np.asarray(2.0 * np.arctan2(chord, total))


def _direction(w: npt.ArrayLike, name: str) -> FloatArray:
    vector = np.asarray(w, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)) or not np.any(vector):
        raise BadInput(
            f"{name} = {np.array2string(vector, threshold=8)} is no direction",
            where="pose",
            todo="give three finite numbers that are not all zero",
        )
    return unit(vector)


def _name_pose(wi: FloatArray, wo: FloatArray) -> str:
    # Rounded, and -0 made 0, for a person.
    (theta_i, phi_i), (theta_o, phi_o) = (
        np.round(np.degrees(direction_to_spherical(w)), 2) + 0.0 for w in (wi, wo)
    )
    return f"pose theta_i {theta_i:.2f} phi_i {phi_i:.2f} theta_o {theta_o:.2f} phi_o {phi_o:.2f} deg"
