"""Where the solids of a machine are at a pose.

A link is a joint with all that it carries, or the base. With all joints at zero every link's frame is the
sample's: origin on the sample's surface, millimetres. All axes pass through that origin, so a link's pose is
a rotation about it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from rig.angles import FloatArray, rotation, unit
from rig.kinematics import Kinematics
from rig.solids import BASE, Box, Capsule, Cylinder, Sphere

if TYPE_CHECKING:
    from rig.description import Rig
    from rig.solids import Solid

_X, _Y, _Z = np.eye(3)


@dataclass(frozen=True, slots=True)
class Shape:
    """A convex solid in its own frame, its centre the origin, its axis (where it has one) along z.

    All four kinds are one: the box of `half_mm`, widened by a disc of radius `disc_mm` in the x-y plane, then
    by a ball of radius `ball_mm`.

    Attributes
    ----------
    kind : str
        "box", "cylinder", "capsule" or "sphere".
    half_mm : tuple of float
        Half the edges of a box; (0, 0, half the length) of a cylinder or a capsule's line; zero of a sphere.
    disc_mm, ball_mm : float
        Radius of a cylinder; of a capsule or a sphere; else 0.
    """

    kind: str
    half_mm: tuple[float, float, float]
    disc_mm: float
    ball_mm: float

    @property
    def radius_mm(self) -> float:
        """Radius of a cylinder, a capsule or a sphere; 0 of a box."""
        return self.disc_mm + self.ball_mm


class PlacedSolid(NamedTuple):
    """A solid at a pose.

    Attributes
    ----------
    name : str
    shape : Shape
    pose : ndarray, shape (4, 4)
        Carries the shape's coordinates to those asked for, column vectors, millimetres.
    albedo : float
    """

    name: str
    shape: Shape
    pose: FloatArray
    albedo: float


def placed_solids(rig: Rig, angles_rad: npt.ArrayLike, *, in_sample_frame: bool = True) -> list[PlacedSolid]:
    """Place a machine's solids.

    Parameters
    ----------
    rig : Rig
    angles_rad : array_like, shape (J,)
        Joint angles in the order of `rig.arm_joints`.
    in_sample_frame : bool
        In the frame of the sample, in which `Kinematics.frames` gives lamp and camera; else in the frame of
        the base, which differs when the sample is turned.

    Returns
    -------
    list of PlacedSolid
        In the order of the rig file.

    Raises
    ------
    BadInput
        The number of angles is wrong.
    """
    kinematics = Kinematics(rig)
    kinematics.directions(angles_rad)  # refuses what is no pose
    links = Links(kinematics)
    turned = links.rotations(np.asarray(angles_rad, dtype=np.float64))
    if in_sample_frame:
        turned = np.swapaxes(turned[links.sample], -1, -2) @ turned
    placed = []
    for solid in rig.solids:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = placement(solid)
        whole = np.eye(4)
        whole[:3, :3] = turned[links.index[solid.link]]
        placed.append(PlacedSolid(solid.name, shape_of(solid), whole @ pose, solid.albedo))
    return placed


def shape_of(solid: Solid) -> Shape:
    """Reduce a solid to its shape."""
    match solid:
        case Box():
            a, b, c = (edge / 2.0 for edge in solid.size_mm)
            return Shape("box", (a, b, c), 0.0, 0.0)
        case Cylinder():
            return Shape("cylinder", (0.0, 0.0, _half_length(solid)), solid.radius_mm, 0.0)
        case Capsule():
            return Shape("capsule", (0.0, 0.0, _half_length(solid)), 0.0, solid.radius_mm)
        case Sphere():
            return Shape("sphere", (0.0, 0.0, 0.0), 0.0, solid.radius_mm)


def placement(solid: Solid) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and centre (3,) of a solid in its link's frame."""
    match solid:
        case Box():
            x, y, z = np.radians(solid.turn_deg)
            return rotation(_Z, z) @ rotation(_Y, y) @ rotation(_X, x), np.array(solid.centre_mm)
        case Sphere():
            return np.eye(3), np.array(solid.centre_mm)
        case _:
            ends = np.array([solid.from_mm, solid.to_mm])
            return _z_along(ends[1] - ends[0]), ends.mean(axis=0)


class Links:
    """The links of a machine, base first, then one for each joint in the order of poses.

    Parameters
    ----------
    kinematics : Kinematics

    Attributes
    ----------
    index : dict
        Name of a link to its place.
    below : tuple of tuple of int
        For each link the joints that move it, base to tip, as places in a pose.
    sample : int
        The link that carries the sample.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self._axes = kinematics.axes
        names = [joint.name for joint in kinematics.joints]
        self.index = {BASE: 0} | {name: place + 1 for place, name in enumerate(names)}
        chains = (kinematics.light_chain, kinematics.camera_chain, kinematics.sample_chain)
        below: list[tuple[int, ...]] = [()] * (len(names) + 1)
        for chain in chains:
            for end, joint in enumerate(chain, start=1):
                below[joint + 1] = chain[:end]
        self.below = tuple(below)
        self.light, self.camera, self.sample = (chain[-1] + 1 if chain else 0 for chain in chains)

    def rotations(self, angles_rad: FloatArray) -> FloatArray:
        """Rotation of every link from where it is with all joints at zero, in the frame of the base.

        Parameters
        ----------
        angles_rad : ndarray, shape (..., J)

        Returns
        -------
        ndarray, shape (..., J + 1, 3, 3)
        """
        matrices = rotation(self._axes, angles_rad)
        turned = np.empty((*matrices.shape[:-3], len(self.below), 3, 3))
        for link, joints in enumerate(self.below):
            turned[..., link, :, :] = np.eye(3)
            for joint in joints:
                turned[..., link, :, :] = turned[..., link, :, :] @ matrices[..., joint, :, :]
        return turned


def _half_length(solid: Cylinder | Capsule) -> float:
    return math.dist(solid.from_mm, solid.to_mm) / 2.0


def _z_along(direction: FloatArray) -> FloatArray:
    """Rotation that carries +z to a direction by the shortest turn."""
    z = unit(direction)
    axis = np.cross(_Z, z)
    if not axis.any():
        return np.diag([1.0, z[2], z[2]])
    return rotation(axis, math.atan2(float(np.linalg.norm(axis)), float(z[2])))
