"""Another code for clearance: solids placed by scipy, moved by the twin's own motion, measured by FCL.

Nothing here is shared with `rig.placement`, `rig.motion`, `rig.convex` and `rig.swept`, which it checks.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import fcl
import numpy as np
from scipy.spatial.transform import Rotation

from rig.handshake import ServoSpec
from rig.servo_models import MODELS
from rig.solids import Box, Capsule, Cylinder, Sphere
from simulator.motion import Limits, move_to

if TYPE_CHECKING:
    from rig.angles import FloatArray
    from rig.description import Joint, Rig
    from rig.solids import Solid

BALLS = 10
"""Balls that cover a solid, by which pairs that are far apart are told from others."""

_Z = np.array([0.0, 0.0, 1.0])


class DenseClearance:
    """Distances between a machine's solids at poses, one by one.

    Parameters
    ----------
    rig : Rig
    cutoff_mm : float
        Distances beyond are not told apart.
    """

    def __init__(self, rig: Rig, cutoff_mm: float = 50.0) -> None:
        self.rig, self._cutoff = rig, cutoff_mm
        self._objects = [fcl.CollisionObject(_shape(solid), fcl.Transform()) for solid in rig.solids]
        balls = [_balls(solid) for solid in rig.solids]
        self._radii = np.array([length / 2.0 + radius for length, radius, _, _ in balls])
        self._small = np.array([radius for _, _, radius, _ in balls])
        self._along = np.array([along for _, _, _, along in balls])
        places = [_place(solid) for solid in rig.solids]
        self._turns = Rotation.concatenate([turn for turn, _ in places])
        self._centres = np.array([centre for _, centre in places])
        self._chains = [_chain(rig, solid.link) for solid in rig.solids]
        self.pairs = [pair for pair in itertools.combinations(range(len(places)), 2) if self._can_meet(*pair)]

    def nearest_mm(self, angles_rad: FloatArray, stop_mm: float = -math.inf) -> float:
        """Least distance (mm) over all pairs and K poses (K, J); the search ends below `stop_mm`."""
        turns, centres = self._placed(angles_rad)
        least = self._cutoff
        first, second = np.array(self.pairs).reshape(-1, 2).T
        between = np.linalg.norm(centres[:, first] - centres[:, second], axis=2)
        near = between - self._radii[first] - self._radii[second] < self._cutoff
        pose, pair = np.nonzero(near)
        here, there = (
            centres[pose, solid][:, None] + np.einsum("nij,nbj->nbi", turns[pose, solid], self._along[solid])
            for solid in (first[pair], second[pair])
        )
        between = np.linalg.norm(here[:, :, None] - there[:, None], axis=-1).min(axis=(1, 2))
        close = between - self._small[first[pair]] - self._small[second[pair]] < self._cutoff
        for at, which in zip(pose[close], pair[close], strict=True):
            least = min(least, self._distance(turns[at], centres[at], *self.pairs[which]))
            if least < stop_mm:
                break
        return least

    def _distance(self, turns: FloatArray, centres: FloatArray, first: int, second: int) -> float:
        for solid in (first, second):
            self._objects[solid].setTransform(fcl.Transform(turns[solid], centres[solid]))
        return float(fcl.distance(self._objects[first], self._objects[second], *_asked()))

    def _placed(self, angles_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations (K, S, 3, 3) and centres (K, S, 3) of all solids."""
        links = {chain: self._turned(chain, angles_rad) for chain in set(self._chains)}
        turns = [links[chain] @ own for chain, own in zip(self._chains, self._turns.as_matrix(), strict=True)]
        centres = [links[chain] @ own for chain, own in zip(self._chains, self._centres, strict=True)]
        return np.stack(turns, axis=1), np.stack(centres, axis=1)

    def _turned(self, chain: tuple[int, ...], angles_rad: FloatArray) -> FloatArray:
        """Rotations (K, 3, 3) of a link."""
        joints = self.rig.arm_joints
        turn = Rotation.identity(len(angles_rad))
        for joint in chain:
            axis = np.array(joints[joint].axis) / np.linalg.norm(joints[joint].axis)
            turn = turn * Rotation.from_rotvec(angles_rad[:, joint, None] * axis)
        return np.asarray(turn.as_matrix())

    def _can_meet(self, first: int, second: int) -> bool:
        """On different links, and not the two sides of one bearing."""
        ways = sorted((self._chains[first], self._chains[second]), key=len)
        if ways[0] == ways[1]:
            return False
        if ways[1][:-1] != ways[0]:
            return True
        turns, centres = self._placed(np.zeros((1, len(self.rig.arm_joints))))
        return self._distance(turns[0], centres[0], first, second) >= self.rig.clearance.margin_mm


def driven_poses(rig: Rig, start: FloatArray, end: FloatArray, count: int) -> FloatArray:
    """Poses (count, J) at equal times of a move, as the twin's servos carry it out."""
    motions = []
    for joint, begin, goal in zip(rig.arm_joints, start, end, strict=True):
        motions.append(move_to(float(goal), float(begin), 0.0, _limits(joint)))
    times = np.linspace(0.0, max(motion.duration_s for motion in motions), count)
    return np.array([[motion.at(time_s)[0] for motion in motions] for time_s in times])


def _limits(joint: Joint) -> Limits:
    """Profile that the servo is told, in radians of the joint."""
    spec, model = ServoSpec.of(joint), MODELS[joint.model]
    per_turn = math.tau / joint.gear_ratio
    return Limits(
        spec.velocity * model.velocity_unit_rpm / 60.0 * per_turn,
        spec.acceleration * model.acceleration_unit_rpm2 / 3600.0 * per_turn,
    )


def _asked() -> tuple[Any, Any]:
    return fcl.DistanceRequest(), fcl.DistanceResult()


def _shape(solid: Solid) -> Any:
    match solid:
        case Box():
            return fcl.Box(*solid.size_mm)
        case Cylinder():
            return fcl.Cylinder(solid.radius_mm, math.dist(solid.from_mm, solid.to_mm))
        case Capsule():
            return fcl.Capsule(solid.radius_mm, math.dist(solid.from_mm, solid.to_mm))
        case Sphere():
            return fcl.Sphere(solid.radius_mm)


def _balls(solid: Solid) -> tuple[float, float, float, FloatArray]:
    """Length and radius of a rod around a solid, and equal balls around it: radius, centres (BALLS, 3)."""
    axis = 2
    match solid:
        case Box():
            axis = int(np.argmax(solid.size_mm))
            length = solid.size_mm[axis]
            radius = math.hypot(*np.delete(solid.size_mm, axis)) / 2.0
        case Sphere():
            length, radius = 0.0, solid.radius_mm
        case _:
            length, radius = math.dist(solid.from_mm, solid.to_mm), solid.radius_mm
    centres = np.zeros((BALLS, 3))
    centres[:, axis] = length * ((np.arange(BALLS) + 0.5) / BALLS - 0.5)
    return length, radius, length / (2.0 * BALLS) + radius, centres


def _place(solid: Solid) -> tuple[Rotation, FloatArray]:
    match solid:
        case Box():
            return Rotation.from_euler("xyz", solid.turn_deg, degrees=True), np.array(solid.centre_mm)
        case Sphere():
            return Rotation.identity(), np.array(solid.centre_mm)
        case _:
            ends = np.array([solid.from_mm, solid.to_mm])
            along = ends[1] - ends[0]
            return Rotation.align_vectors(along[None] / np.linalg.norm(along), _Z[None])[0], ends.mean(axis=0)


def _chain(rig: Rig, link: str) -> tuple[int, ...]:
    """Places of the joints that move a link, base to tip."""
    names = [joint.name for joint in rig.arm_joints]
    for chain in (rig.arms.light, rig.arms.camera, rig.arms.sample):
        if link in chain:
            return tuple(names.index(name) for name in chain[: chain.index(link) + 1])
    return ()
