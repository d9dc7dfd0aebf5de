"""The solids of a machine as numbers: which pairs can meet, how far apart they are, how fast."""

from __future__ import annotations

import copy
import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rig.convex import Answer, Question, Solids, distances, rod_distances
from rig.kinematics import Kinematics
from rig.placement import Links, placement, shape_of

if TYPE_CHECKING:
    from rig.angles import FloatArray
    from rig.convex import BoolArray, IntArray
    from rig.description import Rig

RESOLUTION_MM = 0.01
"""Solids that come this close to the margin count as nearer: it bounds every search."""

_ON_AXIS_MM = 1e-9
"""A round solid whose axis is this close to its joint's stays where it is when the joint turns."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Every solid at K poses: rotation (K, S, 3, 3), centre (K, S, 3), half the line of its rod (K, S, 3)."""

    turn: FloatArray
    centre_mm: FloatArray
    rod_mm: FloatArray


class SolidPairs:
    """The pairs of solids of a machine that move past each other, P of them.

    Parameters
    ----------
    rig : Rig

    Attributes
    ----------
    kinematics : Kinematics
    links : Links
    names : tuple of str
        Of the solids, S of them.
    link : ndarray of int, shape (S,)
        The link that carries each.
    rod_radius_mm : ndarray, shape (S,)
        Radius of a rod with round ends around each.
    pairs : ndarray of int, shape (P, 2)
        Places of both solids.
    margins_mm : ndarray, shape (P,)
        How near they may come.
    levers_mm : ndarray, shape (P, J)
        For each joint the farthest that a point of either solid can move against the other per radian.
    """

    def __init__(self, rig: Rig) -> None:
        self.kinematics = Kinematics(rig)
        self._margin_mm = rig.clearance.margin_mm
        self.names = tuple(solid.name for solid in rig.solids)
        self.links = Links(self.kinematics)
        self.link = np.array([self.links.index[solid.link] for solid in rig.solids], dtype=np.int64)
        shapes = [shape_of(solid) for solid in rig.solids]
        places = [placement(solid) for solid in rig.solids]
        self._turn = np.array([turn for turn, _ in places]).reshape(-1, 3, 3)
        self._centre = np.array([centre for _, centre in places]).reshape(-1, 3)
        self._half = np.array([shape.half_mm for shape in shapes]).reshape(-1, 3)
        self._disc = np.array([shape.disc_mm for shape in shapes])
        self._ball = np.array([shape.ball_mm for shape in shapes])
        self._round = np.array([shape.kind != "box" for shape in shapes], dtype=bool)
        self._set_rods()
        pairs = np.array(list(itertools.combinations(range(len(shapes)), 2)), dtype=np.int64).reshape(-1, 2)
        self._set_pairs(pairs, self._against(pairs))
        self._keep(np.asarray(self.levers_mm.any(axis=1)))
        self._keep(~self._joined())

    @property
    def moving_joints(self) -> BoolArray:
        """Which joints make a difference, shape (J,)."""
        return np.asarray(self.levers_mm.any(axis=0))

    def poses(self, angles_rad: FloatArray) -> Poses:
        """Place every solid at K poses, (K, J)."""
        links = self.links.rotations(angles_rad)[:, self.link]
        turn = links @ self._turn
        centre = np.einsum("ksij,sj->ksi", links, self._centre)
        return Poses(turn, centre, np.einsum("ksij,sj->ksi", turn, self._rod))

    def at_least(self, poses: Poses, pose: IntArray, pair: IntArray) -> FloatArray:
        """Bound the distances of N pairs from below by those of the rods around them; exact for rods."""
        first, second = self.pairs[pair].T
        lines = rod_distances(
            poses.centre_mm[pose, first],
            poses.rod_mm[pose, first],
            poses.centre_mm[pose, second],
            poses.rod_mm[pose, second],
        )
        return np.asarray(lines - self.rod_radius_mm[first] - self.rod_radius_mm[second])

    def bounds(
        self, poses: Poses, pose: IntArray, pair: IntArray, question: Question | None = None
    ) -> Answer:
        """Bound the distances of N pairs at some poses from both sides; see `rig.convex.distances`."""
        first, second = (self.batch(poses, pose, solid) for solid in self.pairs[pair].T)
        return distances(first, second, question)

    def without(self, pair: IntArray) -> SolidPairs:
        """Return the same machine without some pairs, which are known never to come near."""
        fewer = copy.copy(self)
        fewer._keep(~np.isin(np.arange(len(self.pairs)), pair))  # noqa: SLF001 - a copy of itself
        return fewer

    def leaving(self, angles_rad: FloatArray) -> SolidPairs:
        """Return the same machine for moves from a pose (J,) where solids stand too near to each other.

        They may stay as near as they are there, but must not touch; the others keep their margins.
        """
        asked = np.arange(len(self.pairs))
        here = self.bounds(self.poses(angles_rad[None]), np.zeros_like(asked), asked).lower_mm
        nearer = copy.copy(self)
        nearer.margins_mm = np.minimum(self.margins_mm, np.maximum(here - 2.0 * RESOLUTION_MM, 0.0))
        return nearer

    def out_of_reach(self) -> IntArray:
        """Pairs that never come near: all joints turn about one point, so distances from it never change."""
        count = len(self._half)
        batch = Solids(self._half, self._disc, self._ball, self._turn, self._centre)
        nothing = np.zeros((count, 3))
        point = Solids(nothing, np.zeros(count), np.zeros(count), np.tile(np.eye(3), (count, 1, 1)), nothing)
        nearest = distances(batch, point).lower_mm
        farthest = [np.linalg.norm(self._corners(solid), axis=1).max() for solid in range(count)]
        gap = nearest[self.pairs] - np.array(farthest)[self.pairs[:, ::-1]]
        return np.flatnonzero((gap >= self._margin_mm + RESOLUTION_MM).any(axis=1))

    def are_rods(self, pair: IntArray) -> BoolArray:
        """Whether `at_least` is exact for pairs."""
        return np.asarray(self._both_rods[pair])

    def batch(self, poses: Poses, pose: IntArray, solid: IntArray) -> Solids:
        """Return some solids at some poses, N of each."""
        return Solids(
            self._half[solid],
            self._disc[solid],
            self._ball[solid],
            poses.turn[pose, solid],
            poses.centre_mm[pose, solid],
        )

    def solids_of(self, pair: int) -> tuple[str, str]:
        """Names of a pair's solids."""
        first, second = self.pairs[pair]
        return self.names[first], self.names[second]

    def on_surfaces(self, pair: int, points_mm: FloatArray) -> FloatArray:
        """Carry the points (2, 3) that prove a distance of cores to the surfaces of a pair's solids."""
        apart = points_mm[1] - points_mm[0]
        length = float(np.linalg.norm(apart))
        if length == 0.0:
            return points_mm
        balls = self._ball[self.pairs[pair]] / length
        return np.stack([points_mm[0] + balls[0] * apart, points_mm[1] - balls[1] * apart])

    def _set_rods(self) -> None:
        """Enclose every solid in a rod with round ends along its longest edge."""
        count = len(self._half)
        longest = np.argmax(self._half, axis=1) if count else np.zeros(0, dtype=np.int64)
        across = self._half.copy()
        across[np.arange(count), longest] = 0.0
        self._rod = np.zeros((count, 3))
        self._rod[np.arange(count), longest] = self._half[np.arange(count), longest]
        self.rod_radius_mm = np.linalg.norm(across, axis=1) + self._disc + self._ball
        self._is_rod = (self._disc == 0.0) & ~across.any(axis=1)

    def _levers(self) -> FloatArray:
        """Farthest that a point of each solid moves per radian of each joint, shape (S, J)."""
        levers = np.zeros((len(self.link), len(self.kinematics.joints)))
        for solid, link in enumerate(self.link):
            joints = self.links.below[link]
            if not joints:
                continue
            corners = self._corners(solid)
            levers[solid, list(joints)] = np.linalg.norm(corners, axis=1).max()
            # The last joint's axis is fixed in the solid's own link; those of the joints before it are not.
            axis = self.kinematics.axes[joints[-1]]
            levers[solid, joints[-1]] = np.linalg.norm(np.cross(corners, axis), axis=1).max()
            if self._turns_in_place(solid, axis):
                levers[solid, joints[-1]] = 0.0
        return levers

    def _corners(self, solid: int) -> FloatArray:
        """Points in the link's frame whose hull, widened by the ball, holds the solid; the ball is added."""
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        half = self._half[solid] + self._disc[solid] * np.array([1.0, 1.0, 0.0]) + self._ball[solid]
        return np.asarray(self._centre[solid] + (signs * half) @ self._turn[solid].T)

    def _turns_in_place(self, solid: int, axis: FloatArray) -> bool:
        own_axis = self._turn[solid][:, 2]
        is_ball = not self._half[solid].any() and self._disc[solid] == 0.0
        aligned = is_ball or bool(np.linalg.norm(np.cross(own_axis, axis)) < _ON_AXIS_MM)
        off_axis = float(np.linalg.norm(np.cross(self._centre[solid], axis)))
        return bool(self._round[solid]) and aligned and off_axis < _ON_AXIS_MM

    def _against(self, pairs: IntArray) -> FloatArray:
        """Levers of pairs, shape (P, J): of each joint that carries one of the two and not the other."""
        levers = self._levers()
        against = np.zeros((len(pairs), levers.shape[1]))
        for place, pair in enumerate(pairs):
            ways = [self.links.below[link] for link in self.link[pair]]
            common = sum(1 for _ in itertools.takewhile(lambda both: both[0] == both[1], zip(*ways)))  # noqa: B905
            for solid, way, other, others in zip(pair, ways, pair[::-1], ways[::-1], strict=True):
                own = list(way[common:])
                against[place, own] = levers[solid, own]
                # What is round about the first of these axes, and does not move itself, looks the same.
                if (
                    own
                    and len(others) == common
                    and self._turns_in_place(other, self.kinematics.axes[own[0]])
                ):
                    against[place, own[0]] = 0.0
        return against

    def _set_pairs(self, pairs: IntArray, levers_mm: FloatArray) -> None:
        self.pairs, self.levers_mm = pairs, levers_mm
        self.margins_mm = np.full(len(pairs), self._margin_mm)
        self._both_rods = self._is_rod[pairs].all(axis=1)

    def _keep(self, kept: BoolArray) -> None:
        self._set_pairs(self.pairs[kept], self.levers_mm[kept])

    def _joined(self) -> BoolArray:
        """Which pairs are the two sides of one bearing: one joint between them, nearer than the margin."""
        below = self.links.below
        joined = np.zeros(len(self.pairs), dtype=bool)
        for place, (first, second) in enumerate(self.link[self.pairs]):
            longer, shorter = sorted((below[first], below[second]), key=len, reverse=True)
            joined[place] = longer[:-1] == shorter and len(longer) > len(shorter)
        asked = np.flatnonzero(joined)
        if asked.size:
            home = self.poses(np.zeros((1, len(self.kinematics.joints))))
            answer = self.bounds(home, np.zeros(asked.size, dtype=np.int64), asked)
            joined[asked] = answer.lower_mm < self._margin_mm
        return joined
