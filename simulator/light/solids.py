"""The solids of a machine in its light: what they add at most, whether they cast a shadow, and their meshes.

A solid that the lamp, or the lit sample, shines on sends part of it back to the sample. Before anything is
rendered its whole surface is summed up, in patches, as if nothing stood between them: what little the solids
take from each other's light makes the sum larger than the truth. A solid between lamp and sample, or sample
and camera, is another matter: then light has to be followed (`Scene.obstructed`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from rig.kinematics import Kinematics
from rig.placement import Links, placed_solids
from rig.shadows import LIFT_MM, Shadows
from simulator.light.mitsuba_meshes import solid_mesh

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rig.description import Rig
    from simulator.light.scene import Scene

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_TURNS, _LENGTHS = 8, 8
"""Patches round a solid, and along it."""
_MARGIN = 1.5
"""Of the sum over patches, for what patches of this size leave out."""
_PLACES = 0.7 * np.array([[1.0, 0.0], [-0.5, 0.87], [-0.5, -0.87]])
"""Of the sample's radius, at which it is looked at."""
_LITTLE = 1e-4
"""Of the largest, below which a patch's light is not asked for f_r: the margin covers it."""
_BACK = 2e-4
"""Of the lamp's distance: by so much is moved back what may touch the lamp's disc, or the sample."""


@dataclass(frozen=True)
class SolidsAt:
    """What the solids do to the light of a pose.

    Attributes
    ----------
    share : float
        What they add to the mean radiance over the sample, over the direct light, at most; what a mirror-like
        part of the sample shows of them is not told.
    shadow : str
        The solid that shades the sample or hides it; empty if none does.
    """

    share: float
    shadow: str


class SolidSurfaces:
    """The solids of a machine as patches, at any pose.

    Parameters
    ----------
    rig : Rig
    turns, lengths : int
        Patches round each solid, and along it.

    Attributes
    ----------
    names : tuple of str
    albedos : ndarray, shape (S,)
    upright : list of ndarray, shape (V, 3)
        Corners of each with all joints at zero.
    """

    def __init__(self, rig: Rig, turns: int = _TURNS, lengths: int = _LENGTHS) -> None:
        self._links = Links(Kinematics(rig))
        solids = placed_solids(rig, np.zeros(len(rig.arm_joints)))
        self.names = tuple(solid.name for solid in solids)
        self.albedos = np.array([solid.albedo for solid in solids])
        self._link = [self._links.index[solid.link] for solid in rig.solids]
        self.upright, self._faces = [], []
        step_mm = _BACK * rig.lamp.distance_mm
        for solid, description in zip(solids, rig.solids, strict=True):
            corners, faces = solid_mesh(solid.shape, turns, lengths)
            corners = corners @ solid.pose[:3, :3].T + solid.pose[:3, 3]
            # What ends in the sample's plane carries it, and lies a little lower.
            if abs(float(corners[:, 2].max())) < step_mm:
                corners = corners - np.array([0.0, 0.0, 2.0 * step_mm])
            if description.link in rig.arms.light:
                corners = corners + np.array([0.0, 0.0, step_mm])
            self.upright.append(corners)
            self._faces.append(faces)
        self._patches = self._by_link()

    def faces(self, number: int) -> Indices:
        """Return the corners of a solid's triangles, shape (F, 3), counterclockwise from outside."""
        return self._faces[number]

    def corners(self, angles_rad: Sequence[float]) -> list[Array]:
        """Return the corners of each solid at a pose, shape (V, 3), in the sample's frame."""
        turned = self._turned(angles_rad)
        return [corners @ turned[link].T for corners, link in zip(self.upright, self._link, strict=True)]

    def patches(self, angles_rad: Sequence[float]) -> tuple[Array, Array, Array]:
        """Return middles (P, 3), normals times area (P, 3), and albedos (P,) of all patches at a pose."""
        turned = self._turned(angles_rad)
        middles = [middles @ turned[link].T for link, (middles, _, _) in self._patches.items()]
        areas = [areas @ turned[link].T for link, (_, areas, _) in self._patches.items()]
        albedos = [albedos for _, _, albedos in self._patches.values()]
        return np.concatenate(middles), np.concatenate(areas), np.concatenate(albedos)

    def _turned(self, angles_rad: Sequence[float]) -> Array:
        """Rotations (L, 3, 3) of the links: all axes pass through the sample's middle."""
        turned = self._links.rotations(np.asarray(angles_rad, dtype=np.float64))
        return np.asarray(turned[self._links.sample].T @ turned)

    def _by_link(self) -> dict[int, tuple[Array, Array, Array]]:
        """Patches of all solids that turn together, with all joints at zero."""
        found: dict[int, list[tuple[Array, Array, Array]]] = {}
        for corners, faces, albedo, link in zip(
            self.upright, self._faces, self.albedos, self._link, strict=True
        ):
            if albedo > 0.0:
                a, b, c = np.moveaxis(corners[faces], 1, 0)
                patches = (a + b + c) / 3.0, np.cross(b - a, c - a) / 2.0, np.full(len(a), albedo)
                found.setdefault(link, []).append(patches)
        empty = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
        grouped = {
            link: tuple(np.concatenate(parts) for parts in zip(*patches, strict=True))
            for link, patches in found.items()
        }
        return grouped or {0: empty}  # type: ignore[return-value]


class SolidsLight:
    """What the solids of a scene's machine do to its light.

    Parameters
    ----------
    scene : Scene
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr of the sample.
    """

    def __init__(self, scene: Scene, reflectance: Reflectance) -> None:
        self._scene, self._reflectance = scene, reflectance
        self._kinematics = Kinematics(scene.rig)

    @cached_property
    def _surfaces(self) -> SolidSurfaces:
        return SolidSurfaces(self._scene.rig)

    @cached_property
    def _shadows(self) -> Shadows:
        return Shadows(self._scene.rig)

    def at(self, angles_rad: Sequence[float]) -> SolidsAt:
        """Look at a pose.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints.
        """
        if not self._scene.rig.solids or not self._scene.events:
            return SolidsAt(0.0, "")
        sight = self._shadows.at(np.asarray([angles_rad], dtype=np.float64))
        by = max(int(sight.shaded_by[0]), int(sight.hidden_by[0]))
        return SolidsAt(self._share(angles_rad), self._shadows.names[by] if by >= 0 else "")

    def _share(self, angles_rad: Sequence[float]) -> float:
        scene, frames = self._scene, self._kinematics.frames(np.asarray(angles_rad))
        light, camera = frames.light_mm, frames.camera_mm
        middles, areas, albedos = self._surfaces.patches(angles_rad)
        centre = unit(light)[None]
        if min(light[2], camera[2]) <= 0.0:
            return 0.0
        # What the sample's middle sees: above its plane, and the right way round.
        away = np.linalg.norm(middles, axis=1)
        towards = middles / away[:, None]
        facing = -np.sum(areas * towards, axis=1)
        seen = (middles[:, 2] > LIFT_MM) & (facing > 0.0)
        middles, areas, albedos = middles[seen], areas[seen], albedos[seen]
        towards, away, facing = towards[seen], away[seen], facing[seen]
        if not len(middles):
            return 0.0
        size = np.linalg.norm(areas, axis=1)
        by_lamp = self._by_lamp(light, middles, areas / size[:, None])
        sample_area = np.pi * scene.sample_radius_mm**2
        lit = centre[0, 2] * self._reflectance(np.repeat(centre, len(middles), axis=0), towards)
        by_sample = lit * (sample_area * towards[:, 2] * facing / size / np.square(away))[:, None]
        wall = self._walls() if scene.housing is not None else 0.0
        again = 1.0 / (1.0 - min(float(self._surfaces.albedos.max()), 0.9))
        radiance = again * albedos[:, None] / np.pi * (by_lamp[:, None] + by_sample) + wall
        sent = radiance.max(axis=1) * facing * towards[:, 2] / np.square(away)
        counts = sent > _LITTLE * sent.max()
        middles, areas, radiance = middles[counts], areas[counts], radiance[counts]
        added, direct = np.zeros(3), np.zeros(3)
        for place in scene.sample_radius_mm * _PLACES:
            point = np.append(place, 0.0)
            way = middles - point
            distance = np.linalg.norm(way, axis=1)
            wi, wo = way / distance[:, None], unit(camera - point)
            turned = np.maximum(-np.sum(areas * wi, axis=1), 0.0) * wi[:, 2] / np.square(distance)
            f_r = self._reflectance(wi, np.repeat(wo[None], len(wi), axis=0))
            added += np.sum(f_r * radiance * turned[:, None], axis=0)
            to_lamp = light - point
            far = np.linalg.norm(to_lamp)
            strength = scene.lamp_intensity * to_lamp[2] / far**3
            direct += strength * self._reflectance((to_lamp / far)[None], wo[None])[0]
        if not np.all(direct[added > 0.0] > 0.0):
            return 1.0
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(min(1.0, _MARGIN * np.max(np.where(added > 0.0, added / direct, 0.0))))

    def _by_lamp(self, light_mm: Array, middles: Array, normals: Array) -> Array:
        """Irradiance (P,) of patches by the lamp, as if nothing stood between them."""
        way = light_mm - middles
        distance = np.linalg.norm(way, axis=1)
        wi = way / np.maximum(distance, 1e-9)[:, None]
        sent = np.maximum(-(wi @ unit(-light_mm)), 0.0) if self._scene.lamp_cosine else np.ones(len(wi))
        # Nothing is nearer to the lamp than its own disc is wide.
        near = np.maximum(distance, self._scene.lamp_radius_mm)
        return np.asarray(
            self._scene.lamp_intensity * sent * np.maximum(np.sum(wi * normals, axis=1), 0.0) / near**2
        )

    def _walls(self) -> float:
        """Radiance of a housing's walls that solids hide: all the lamp's light, evenly on them."""
        housing, flux = self._scene.housing, np.pi * self._scene.lamp_intensity
        assert housing is not None  # noqa: S101 - asked for only then
        return housing.albedo / (1.0 - housing.albedo) * flux / (24.0 * housing.half_size_mm**2) / np.pi
