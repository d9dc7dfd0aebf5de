"""Lamps in planar mirrors: L S+ D E by the method of images, without noise.

A planar ideal mirror shows the lamp behind itself; what the image lights is what the lamp lights over the
mirror, times the reflectance, seen through the mirror as through a window. Several mirrors show images of
images. Each point of the sample is followed back, mirror by mirror: its way to the last image must pass the
last mirror's rectangle, from there to the image before it the mirror before, and so to the lamp, and neither
the sample nor another mirror may stand in a part of the way.

The mean over the lamp's disc and the pixel's footprint is taken with nodes that are refined until the picture
changes by less than the tolerance; it is what makes the window's edge soft. The entrance pupil is a point.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.instrument import disc_nodes
from rig.angles import unit
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.classes import light_paths, mirror_faces_sample, walks
from simulator.light.evaluator import Evaluator, Method, Rendering
from simulator.light.paths import LightPaths
from simulator.light.reflectance import material_reflectance
from simulator.light.scene import Event, PlanarMirror, Scene

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MOST_IMAGES = 6
"""Mirrors in a row that are followed: two of reflectance 0.9 that face each other have lost half by then."""
FINEST = 8
"""Nodes of the lamp's disc along its radius, and of the pixel along its side, at which refining ends."""
_TOUCHING = 1e-9
_SECONDS_PER_NODE = 2e-7
"""Time of one node of one image in one pixel with a closed form, on the machine of the benchmark."""


@dataclass(frozen=True, eq=False)
class VirtualLamp:
    """The lamp in mirrors, in the order in which its light meets them.

    Parameters
    ----------
    mirrors : tuple of PlanarMirror
    """

    mirrors: tuple[PlanarMirror, ...]

    @property
    def reflectance(self) -> float:
        """What the mirrors leave of its light."""
        return float(np.prod([mirror.reflectance for mirror in self.mirrors]))

    def image(self, points_mm: Array) -> Array:
        """Return where points (..., 3) appear in the last mirror."""
        for mirror in self.mirrors:
            points_mm = mirror.image(points_mm)
        return points_mm

    def ways(self, lamp_mm: Array, points_mm: Array) -> tuple[Bools, list[Array]]:
        """Follow light from a lamp over the mirrors to points.

        Parameters
        ----------
        lamp_mm : ndarray, shape (3,)
            The lamp itself.
        points_mm : ndarray, shape (N, 3)
            Where the light goes.

        Returns
        -------
        passes : ndarray of bool, shape (N,)
            Whether every mirror is met inside its rectangle and on its bright side.
        corners : list of ndarray, shape (N, 3)
            The way's ends and bends, lamp first; what passes nowhere is anything.
        """
        images = [lamp_mm]
        for mirror in self.mirrors:
            images.append(mirror.image(images[-1]))
        corners, passes = [points_mm], np.ones(len(points_mm), dtype=bool)
        for mirror, shown in zip(reversed(self.mirrors), reversed(images[1:]), strict=True):
            met, share, inside = _met(mirror, corners[-1], np.broadcast_to(shown, points_mm.shape))
            bright = (corners[-1] - np.asarray(mirror.centre_mm)) @ mirror.normal > 0.0
            passes &= inside & bright & (share > 0.0) & (share < 1.0)
            corners.append(met)
        return passes, [np.broadcast_to(lamp_mm, points_mm.shape), *reversed(corners)]


def virtual_lamps(scene: Scene, paths: LightPaths) -> tuple[VirtualLamp, ...]:
    """Every lamp in mirrors that can light the sample and is asked for, fewest mirrors first.

    Parameters
    ----------
    scene : Scene
    paths : LightPaths
        Paths that are wanted; only L S+ D E are found.
    """
    letters = sorted(scene.events - {Event.MIRROR})
    lamps = []
    for length in range(1, MOST_IMAGES + 1 if len(scene.mirrors) > 1 else 2):
        if not any("L" + "S" * length + letter + "E" in paths for letter in letters):
            continue
        for walk in walks(scene, length):
            met = [node for node, _ in walk if isinstance(node, int)]
            if len(met) == length and mirror_faces_sample(scene, scene.mirrors[met[-1]]):
                lamps.append(VirtualLamp(tuple(scene.mirrors[node] for node in met)))
    return tuple(lamps)


class VirtualLights(Evaluator):
    """The lamps in the mirrors of one scene, lighting its sample.

    Parameters
    ----------
    scene : Scene
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr of the sample.
    paths : LightPaths
        What is asked for; a part of L S+ D E.
    """

    def __init__(self, scene: Scene, reflectance: Reflectance, paths: LightPaths) -> None:
        self._scene, self._reflectance = scene, reflectance
        self._kinematics = Kinematics(scene.rig)
        self.lamps = virtual_lamps(scene, paths)

    def render(self, angles_rad: Sequence[float], tolerance: float) -> Rendering:
        """Compute the radiance of a pose; see `Evaluator`."""
        angles = np.asarray(angles_rad, dtype=np.float64)
        fineness, coarse, lit = 1, self._picture(angles, 1), self._lit(angles)
        while True:
            fineness *= 2
            fine = self._picture(angles, fineness)
            error = _change(fine, coarse, lit)
            if error <= tolerance or fineness >= FINEST:
                break
            coarse = fine
        left = self._left_out()
        nodes = fineness**2 * (4 * fineness**2 if self._scene.lamp_cosine else 1)
        did = f"{len(self.lamps)} images of the lamp, {nodes} nodes of lamp and pixel"
        return Rendering(fine, error + left, did)

    def _left_out(self) -> float:
        """Bound what images of more mirrors would add, relative to those that were followed."""
        if len(self._scene.mirrors) < 2:
            return 0.0
        brightest = max(mirror.reflectance for mirror in self._scene.mirrors)
        deepest = [lamp for lamp in self.lamps if len(lamp.mirrors) == MOST_IMAGES]
        if not deepest:
            return 0.0
        return float(brightest**MOST_IMAGES * len(deepest) / max(1.0 - brightest, 1e-3))

    def _lit(self, angles: Array) -> Bools:
        return pixel_geometry(self._scene.rig, angles).on_sample

    def _picture(self, angles: Array, fineness: int) -> Array:
        """Radiance of all pixels, each the mean over so many rows and columns inside it."""
        camera = self._scene.rig.camera
        rows, cols = (
            (np.arange(n * fineness) + 0.5) / fineness - 0.5 for n in (camera.height_px, camera.width_px)
        )
        pixels = pixel_geometry(self._scene.rig, angles, rows=rows, cols=cols)
        # A pixel whose centre is on the sample is taken to see it everywhere.
        whole = np.repeat(np.repeat(self._lit(angles), fineness, axis=0), fineness, axis=1)
        seen = whole & np.isfinite(pixels.light_distance_mm)
        points = np.column_stack([pixels.position_mm[seen], np.zeros(np.count_nonzero(seen))])
        radiance = np.zeros((*seen.shape, 3))
        radiance[seen] = self.radiance(
            self._kinematics.frames(angles).light_mm, points, pixels.wo[seen], fineness
        )
        parts = radiance.reshape(camera.height_px, fineness, camera.width_px, fineness, 3)
        return np.asarray(parts.mean(axis=(1, 3)))

    def radiance(self, light_mm: Array, points_mm: Array, wo: Array, fineness: int) -> Array:
        """Radiance of points of the sample.

        Parameters
        ----------
        light_mm : ndarray, shape (3,)
            Where the lamp is.
        points_mm : ndarray, shape (N, 3)
            On the sample.
        wo : ndarray, shape (N, 3)
            Unit vectors towards the camera.
        fineness : int
            Nodes along the radius of the lamp's disc.

        Returns
        -------
        ndarray, shape (N, 3)
        """
        radiance = np.zeros((len(points_mm), 3))
        for place, intensity in self._lamp_nodes(light_mm, fineness):
            for lamp in self.lamps:
                passes, corners = lamp.ways(place, points_mm)
                passes &= ~self._hidden(lamp, corners, passes)
                if not passes.any():
                    continue
                way = lamp.image(place) - points_mm[passes]
                distance = np.linalg.norm(way, axis=1)
                wi = way / distance[:, None]
                cosine = self._emitted(light_mm, place, corners[1][passes])
                strength = lamp.reflectance * intensity * cosine * np.maximum(wi[:, 2], 0.0) / distance**2
                radiance[passes] += self._reflectance(wi, wo[passes]) * strength[:, None]
        return radiance

    def _lamp_nodes(self, light_mm: Array, fineness: int) -> list[tuple[Array, float]]:
        """Places of a lamp and the intensity of each along its axis."""
        scene = self._scene
        if not scene.lamp_cosine:
            return [(light_mm, scene.lamp_intensity)]
        # A disc's irradiance falls short of a point's by this factor: it is made up for, so that it is 1.
        whole = scene.lamp_intensity + scene.lamp_radius_mm**2
        axis = unit(-light_mm)
        across = unit(np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis))
        nodes, weights = disc_nodes(fineness)
        places = light_mm + scene.lamp_radius_mm * nodes @ np.stack([across, np.cross(axis, across)])
        return [(place, whole * weight) for place, weight in zip(places, weights, strict=True)]

    def _emitted(self, light_mm: Array, place: Array, towards: Array) -> Array:
        """Return what a lamp sends to points (N, 3), relative to its axis."""
        if not self._scene.lamp_cosine:
            return np.ones(len(towards))
        return np.maximum(unit(towards - place) @ unit(-light_mm), 0.0)

    def _hidden(self, lamp: VirtualLamp, corners: list[Array], passes: Bools) -> Bools:
        """Tell where the sample, or a mirror that a part of the way does not end at, stands in the way."""
        hidden = np.zeros(len(passes), dtype=bool)
        ends = (None, *lamp.mirrors, None)
        for part, (start, end) in enumerate(pairwise(corners)):
            for mirror in self._scene.mirrors:
                if mirror is not ends[part] and mirror is not ends[part + 1]:
                    _, share, inside = _met(mirror, start, end)
                    hidden |= inside & (share > _TOUCHING) & (share < 1.0 - _TOUCHING)
            if part < len(corners) - 2:
                hidden |= crosses_disc(start, end, self._scene.sample_radius_mm)
        return hidden


def crosses_disc(start: Array, end: Array, radius_mm: float) -> Bools:
    """Tell which straight ways (..., 3) pass through the sample's disc.

    Parameters
    ----------
    start, end : ndarray, shape (..., 3)
    radius_mm : float
        The disc is about the origin in the plane z = 0.

    Returns
    -------
    ndarray of bool, shape (...)
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        share = start[..., 2] / (start[..., 2] - end[..., 2])
        met = start + share[..., None] * (end - start)
        inside = np.sum(np.square(met[..., :2]), axis=-1) < radius_mm**2
    return np.asarray(inside & (share > _TOUCHING) & (share < 1.0 - _TOUCHING))


def _met(mirror: PlanarMirror, start: Array, end: Array) -> tuple[Array, Array, Bools]:
    """Where ways (N, 3) meet a mirror's plane, the share of their length, and whether in its rectangle."""
    centre = np.asarray(mirror.centre_mm)
    way = end - start
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = ((centre - start) @ mirror.normal) / (way @ mirror.normal)
        met = start + share[:, None] * way
        inside = np.ones(len(start), dtype=bool)
        for side in (np.asarray(mirror.across_mm), np.asarray(mirror.up_mm)):
            inside &= np.abs((met - centre) @ side) <= side @ side
    return met, share, inside


def _change(fine: Array, coarse: Array, lit: Bools) -> float:
    """RMS difference over the pixels of the sample, relative to their mean."""
    mean = float(fine[lit].mean()) if lit.any() else 0.0
    return float(np.sqrt(np.mean(np.square(fine[lit] - coarse[lit])))) / mean if mean > 0.0 else 0.0


class VirtualLightsMethod(Method):
    """The row of `VirtualLights` in the table of methods."""

    name = "virtual lights"
    covers = LightPaths("LS+DE")

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:  # noqa: ARG002
        """Say why it cannot compute the paths; see `Method`."""
        if not scene.mirrors:
            return "no mirror but the sample's own part"
        housed = scene.housing is not None
        beyond = paths.with_events(MOST_IMAGES + 2) & light_paths(scene)
        brightest = max(mirror.reflectance for mirror in scene.mirrors)
        if beyond and not housed and brightest > 1.0 - 1e-3:
            return f"mirrors without loss face each other, and {MOST_IMAGES} images are followed"
        return None

    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:
        """Predict the time of one pose; see `Method`."""
        fineness = 2 if tolerance >= 1e-2 else FINEST // 2
        lamps = len(virtual_lamps(scene, paths))
        nodes = fineness**2 * (4 * fineness**2 if scene.lamp_cosine else 1)
        one_by_one = not vector and not scene.material.has_closed_form
        pixels = scene.rig.camera.width_px * scene.rig.camera.height_px
        return lamps * nodes * pixels * (3e-6 if one_by_one else _SECONDS_PER_NODE)

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> VirtualLights:
        """Set it to work; see `Method`."""
        return VirtualLights(scene, material_reflectance(mi, scene.material), paths)
