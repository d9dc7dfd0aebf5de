"""What spoils a pose though nothing touches: a shaded sample, a hidden sample, the lamp in the picture.

All light that goes straight from the lamp's disc to the sample's disc fills a beam, the hull of both discs;
so do the rays by which the camera sees the sample. A solid that meets the first beam shades the sample, one
that meets the second hides it. What hangs on the lamp's own link stands in every pose where it was made to
stand, out of the lamp's way; likewise what hangs with the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rig.clearance_pairs import SolidPairs
from rig.convex import Beams, Question, distances, rod_distances
from rig.kinematics import CAMERA_AT_ZERO
from rig.pixels import camera_rays

if TYPE_CHECKING:
    from rig.angles import FloatArray
    from rig.clearance_pairs import Poses
    from rig.convex import BoolArray, IntArray
    from rig.description import Rig

LIFT_MM = 0.5
"""What is lower than this over the sample's plane casts no shadow: the stage, a clamp as thin as paper."""

_TOUCH_MM = 1e-3
"""A solid that is farther than this from a beam does not meet it."""

_BORDER = 33
"""Points along each side of the frame by which its field of view is found."""

_BATCH = 4000
"""Poses that are looked at together; it bounds the memory."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What spoils K poses.

    Attributes
    ----------
    shaded_by, hidden_by : ndarray of int, shape (K,)
        A solid between lamp and sample, or camera and sample; -1 where there is none.
    lamp_in_view : ndarray of bool, shape (K,)
        The camera's frame holds part of the lit disc.
    """

    shaded_by: IntArray
    hidden_by: IntArray
    lamp_in_view: BoolArray

    @property
    def clear(self) -> BoolArray:
        """Poses that nothing spoils, shape (K,)."""
        return np.asarray((self.shaded_by < 0) & (self.hidden_by < 0) & ~self.lamp_in_view)


@dataclass(frozen=True, eq=False)
class _Disc:
    """The end of a beam at K poses, and the link that carries it."""

    centre_mm: FloatArray
    normal: FloatArray
    radius_mm: float
    link: int


class Shadows:
    """Light paths and lines of sight of one machine.

    Parameters
    ----------
    rig : Rig
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._solids = SolidPairs(rig)
        rays = camera_rays(
            rig,
            np.linspace(-0.5, rig.camera.height_px - 0.5, _BORDER),
            np.linspace(-0.5, rig.camera.width_px - 0.5, _BORDER),
        )
        slopes = (rays[..., :2] / rays[..., 2:]).reshape(-1, 2)
        self._field = slopes.min(axis=0), slopes.max(axis=0)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the solids."""
        return self._solids.names

    def at(self, angles_rad: FloatArray) -> Sight:
        """Look at poses.

        Parameters
        ----------
        angles_rad : ndarray, shape (K, J)

        Returns
        -------
        Sight
        """
        parts = [
            self._look(angles_rad[begin : begin + _BATCH])
            for begin in range(0, max(len(angles_rad), 1), _BATCH)
        ]
        return Sight(
            np.concatenate([part.shaded_by for part in parts]),
            np.concatenate([part.hidden_by for part in parts]),
            np.concatenate([part.lamp_in_view for part in parts]),
        )

    def beams(self, angles_rad: FloatArray) -> tuple[Beams, Beams]:
        """Return the light's way to the sample and the camera's rays at K poses, in the frame of the base."""
        normal, discs = self._discs(angles_rad)
        light, camera = (self._beams(normal, disc) for disc in discs)
        return light, camera

    def _look(self, angles_rad: FloatArray) -> Sight:
        normal, discs = self._discs(angles_rad)
        poses = self._solids.poses(angles_rad)
        shaded, hidden = (self._met(poses, normal, disc) for disc in discs)
        camera_turn = self._solids.links.rotations(angles_rad)[:, self._solids.links.camera]
        return Sight(shaded, hidden, self._in_view(camera_turn, *discs))

    def _discs(self, angles_rad: FloatArray) -> tuple[FloatArray, tuple[_Disc, _Disc]]:
        """Find the sample's normal (K, 3), and the discs of lamp and pupil."""
        rig, links = self._rig, self._solids.links
        turned = links.rotations(angles_rad)
        to_lamp, to_camera, normal = (
            turned[:, link, :, 2] for link in (links.light, links.camera, links.sample)
        )
        lamp = _Disc(rig.lamp.distance_mm * to_lamp, to_lamp, rig.lamp.diameter_mm / 2.0, links.light)
        pupil_mm = rig.camera.aperture_diameter_mm / 2.0
        pupil = _Disc(rig.camera.distance_mm * to_camera, to_camera, pupil_mm, links.camera)
        return normal, (lamp, pupil)

    def _beams(self, normal: FloatArray, disc: _Disc) -> Beams:
        """All between the sample, lifted, and a disc."""
        ends = np.stack([LIFT_MM * normal, disc.centre_mm], axis=1)
        normals = np.stack([normal, disc.normal], axis=1)
        return Beams(ends, normals, np.array([self._rig.sample.diameter_mm / 2.0, disc.radius_mm]))

    def _met(self, poses: Poses, normal: FloatArray, disc: _Disc) -> IntArray:
        """Find a solid in each beam between a disc and the sample; -1 where there is none."""
        solids = self._solids
        met = np.full(len(normal), -1, dtype=np.int64)
        others = np.flatnonzero(solids.link != disc.link)
        beams = self._beams(normal, disc)
        pose, solid = (index.ravel() for index in np.meshgrid(np.arange(len(met)), others, indexing="ij"))
        around = rod_distances(
            beams.centre_mm[pose],
            (beams.ends_mm[:, 1] - beams.ends_mm[:, 0])[pose] / 2.0,
            poses.centre_mm[pose, solid],
            poses.rod_mm[pose, solid],
        )
        near = around < solids.rod_radius_mm[solid] + beams.radii_mm.max()
        pose, solid = pose[near], solid[near]
        if pose.size:
            beams = Beams(beams.ends_mm[pose], beams.normals[pose], beams.radii_mm)
            enough = np.full(pose.size, _TOUCH_MM)
            answer = distances(beams, solids.batch(poses, pose, solid), Question(enough, enough))
            hit = answer.lower_mm < _TOUCH_MM
            met[pose[hit]] = solid[hit]
        return met

    def _in_view(self, camera_turn: FloatArray, lamp: _Disc, pupil: _Disc) -> BoolArray:
        """Whether some of the lit disc is in the camera's frame, and the disc faces the camera."""
        away = lamp.centre_mm - pupil.centre_mm
        seen = np.einsum("kji,kj->ki", camera_turn @ CAMERA_AT_ZERO, away)
        ahead = seen[:, 2] > 0.0
        depth = np.where(ahead, seen[:, 2], 1.0)[:, None]
        slopes, spread = seen[:, :2] / depth, lamp.radius_mm / depth
        low, high = self._field
        inside = np.all((slopes >= low - spread) & (slopes <= high + spread), axis=1)
        faces = np.sum(away * lamp.normal, axis=1) > 0.0
        return np.asarray(ahead & inside & faces)
