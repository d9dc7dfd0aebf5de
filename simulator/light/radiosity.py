"""Light over a Lambertian housing: L D* Dl D E by radiosity, without noise.

A pose lights the walls by the lamp, exactly at every node of a quadrature rule, in the shadow of the sample,
by the sample, which throws the lamp's light on them as its f_r does, and by each other
(`simulator.light.wall_light`). The last step gathers, at a few points of the sample, the walls' radiance with
f_r, where `simulator.light.gather_nodes` says. Over the sample the light is smooth, and is interpolated by
polynomials. Everything is refined until the picture changes by less than the tolerance; where that is large,
one value is taken for all of the picture (`simulator.light.rough_walls`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from rig.kinematics import Kinematics
from simulator.light.classes import light_paths
from simulator.light.costs import value_s
from simulator.light.direct_view import POINTS, lens_of, meet, view_of
from simulator.light.evaluator import Evaluator, Method, Rendering
from simulator.light.gather_nodes import LEVELS, Level, in_rings, interpolation, rings
from simulator.light.paths import LightPaths
from simulator.light.reflectance import material_reflectance
from simulator.light.rough_walls import ERROR, RoughWalls
from simulator.light.scene import Event
from simulator.light.wall_light import SIDE_PATCHES, WallLight

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from simulator.light.scene import Scene

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]

_SECONDS_PER_NODE, _LEVEL_S, _PIXEL_S = 3e-7, 2e-3, 1e-7
"""Time of a node besides that of its f_r, of a level, and of a pixel at each level."""
_ROUGH_S, _ROUGH_PIXEL_S = 7e-4, 4e-8
"""Time of one value for all of the picture, and of putting it in a pixel."""
_REACHED = (3e-2, 5e-3, 1e-3, 3e-4)
"""Estimated errors after the second level, and after those above."""


class Radiosity(Evaluator):
    """Light over the housing of one scene.

    Parameters
    ----------
    scene : Scene
        With a housing.
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr of the sample.
    paths : LightPaths
        What is asked for; a union of the scene's classes.
    """

    def __init__(self, scene: Scene, reflectance: Reflectance, paths: LightPaths) -> None:
        self._scene, self._reflectance = scene, reflectance
        self._glossy = Event.GLOSSY in scene.events
        self._kinematics, self._lens = Kinematics(scene.rig), lens_of(scene.rig)
        self._light = WallLight(scene, reflectance, paths)
        self._rough = RoughWalls(scene, reflectance, self._light)
        self.walls = self._light.walls

    def render(self, angles_rad: Sequence[float], tolerance: float) -> Rendering:
        """Compute the radiance of a pose; see `Evaluator`."""
        camera, frames = self._scene.rig.camera, self._kinematics.frames(np.asarray(angles_rad))
        points, w = meet(view_of(frames, POINTS), self._lens, np.zeros(2))
        with np.errstate(invalid="ignore"):
            edge = points[:, 0] ** 2 + points[:, 1] ** 2 <= self._scene.sample_radius_mm**2
        on_sample = np.flatnonzero(edge & (w > 0.0) & (frames.camera_mm[2] > 0.0))
        radiance = np.zeros((camera.height_px * camera.width_px, 3))
        shape = (camera.height_px, camera.width_px, 3)
        if not on_sample.size:
            return Rendering(radiance.reshape(shape), 0.0, "the camera does not see the sample")
        if tolerance >= ERROR:
            rough = self._rough.radiance(frames.light_mm, frames.camera_mm)
            if rough is not None:
                radiance[on_sample] = rough
                return Rendering(radiance.reshape(shape), ERROR, "one value, from the patches' middles")
        positions = points[on_sample, :2]
        fine, error = self.picture(frames.light_mm, frames.camera_mm, positions, LEVELS[0])[0], np.inf
        for used in LEVELS[1:]:
            coarse = fine
            fine, other = self.picture(frames.light_mm, frames.camera_mm, positions, used)
            # Patches are of second order: of those twice as large, a third of the difference is left.
            error = _rms(fine, coarse) + _rms(fine, other) / 3.0
            if error <= tolerance:
                break
        radiance[on_sample] = fine
        did = (
            f"{len(self.walls)} patches, {used.wall}^2 nodes on each, {used.rings} x {used.turns} about "
            f"the mirror direction, at {used.points}^2 points"
        )
        return Rendering(radiance.reshape(shape), error, did)

    def picture(
        self, lamp_mm: Array, camera_mm: Array, positions: Array, level: Level
    ) -> tuple[Array, Array]:
        """Radiance at places of the sample, computed as finely as told.

        Parameters
        ----------
        lamp_mm, camera_mm : ndarray, shape (3,)
            Where they are.
        positions : ndarray, shape (N, 2)
            Places (x, y) in millimetres.
        level : Level

        Returns
        -------
        fine, coarse : ndarray, shape (N, 3)
            With all patches, and with a quarter of them.
        """
        low, high = positions.min(axis=0), positions.max(axis=0)
        centre, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), np.finfo(float).tiny)
        nodes = np.cos(np.pi * (np.arange(level.points) + 0.5) / level.points)
        x, y = (axis.ravel() for axis in np.meshgrid(nodes, nodes, indexing="ij"))
        points = np.column_stack([centre + half * np.column_stack([x, y]), np.zeros(len(x))])
        gathered = self._gather(lamp_mm, points, unit(camera_mm - points), level)
        inside = np.clip((positions - centre) / half, -1.0, 1.0)
        across, up = (interpolation(nodes, inside[:, axis]) for axis in (0, 1))
        fine, coarse = (
            np.einsum("ni,nic->nc", up, np.tensordot(across, g.reshape(len(nodes), len(nodes), 3), axes=1))
            for g in gathered
        )
        return fine, coarse

    def _gather(self, lamp_mm: Array, points: Array, wo: Array, level: Level) -> Array:
        """Radiance (2, K, 3) of points of the sample: with all patches and with a quarter of them."""
        rule = self.walls.rule(lamp_mm, level.wall)
        lamp, sample = self._light.by_lamp(lamp_mm, rule), self._light.by_sample(lamp_mm, rule)
        repeated = self._light.repeated(rule, lamp, sample)
        above = rule.points[:, 2] > 0.0
        leaving = self._light.leaving(lamp[above], sample[above], repeated[:, rule.patches[above]])
        way = rule.points[above] - points[:, None]
        squared = np.sum(np.square(way), axis=-1)
        wi = way / np.sqrt(squared)[..., None]
        there = -np.einsum("knj,nj->kn", wi, rule.normals[above])
        weights = wi[..., 2] * there * rule.areas[above] / squared
        if self._glossy:
            weights *= 1.0 - in_rings(wi, wo)
        kept = self._reflected(wi, wo) * weights[..., None]
        radiance = np.einsum("knc,snc->skc", kept, leaving)
        if self._glossy:
            radiance += self._gather_lobe(lamp_mm, points, wo, level, repeated)
        return np.asarray(radiance)

    def _gather_lobe(self, lamp_mm: Array, points: Array, wo: Array, level: Level, repeated: Array) -> Array:
        """Light from about the mirror direction, (2, K, 3)."""
        ring, solid_angle = rings(level)
        mirror = wo * [-1.0, -1.0, 1.0]
        across = unit(np.cross(np.eye(3)[np.argmin(np.abs(mirror), axis=1)], mirror))
        wi = np.einsum("nj,kjc->knc", ring, np.stack([across, np.cross(mirror, across), mirror], axis=1))
        weights = solid_angle * np.maximum(wi[..., 2], 0.0) * in_rings(wi, wo)
        above = wi[..., 2] > 0.0
        hit = self.walls.hit(np.broadcast_to(points[:, None], wi.shape)[above], wi[above])
        lamp, sample = self._light.by_lamp(lamp_mm, hit), self._light.by_sample(lamp_mm, hit)
        leaving = np.zeros((2, *wi.shape))
        leaving[:, above] = self._light.leaving(lamp, sample, repeated[:, hit.patches])
        kept = self._reflected(wi, wo) * weights[..., None]
        return np.asarray(np.einsum("knc,sknc->skc", kept, leaving))

    def _reflected(self, wi: Array, wo: Array) -> Array:
        """f_r (K, N, 3), zero below the horizon."""
        f = np.zeros(wi.shape)
        above = wi[..., 2] > 0.0
        f[above] = self._reflectance(wi[above], np.broadcast_to(wo[:, None], wi.shape)[above])
        return f


def _rms(fine: Array, coarse: Array) -> float:
    mean = float(fine.mean())
    return float(np.sqrt(np.mean(np.square(fine - coarse)))) / mean if mean > 0.0 else 0.0


class RadiosityMethod(Method):
    """The row of `Radiosity` in the table of methods."""

    name = "radiosity of the housing"
    covers = LightPaths("LD*DlDE")

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:  # noqa: ARG002
        """Say why it cannot compute the paths; see `Method`."""
        if scene.housing is None:
            return "no housing"
        rig = scene.rig
        if max(rig.lamp.distance_mm, rig.camera.distance_mm) >= scene.housing.half_size_mm:
            return "lamp or camera can be outside the housing"
        possible = light_paths(scene).with_events(4)
        long = paths & possible
        if long and long != possible & self.covers:
            return "of paths with four events and more, all are computed or none"
        return None

    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:  # noqa: ARG002
        """Predict the time of one pose; see `Method`."""
        pixels = scene.rig.camera.width_px * scene.rig.camera.height_px
        if tolerance >= ERROR:
            return _ROUGH_S + _ROUGH_PIXEL_S * pixels
        needed = 2 + sum(tolerance < reached for reached in _REACHED)
        glossy = Event.GLOSSY in scene.events
        nodes = sum(
            level.points**2 * (3 * (SIDE_PATCHES * level.wall) ** 2 + glossy * level.rings * level.turns)
            for level in LEVELS[:needed]
        )
        asked = value_s(scene.material, vector=vector) if glossy else 0.0
        return needed * (_LEVEL_S + _PIXEL_S * pixels) + nodes * (_SECONDS_PER_NODE + asked)

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> Radiosity:
        """Set it to work; see `Method`."""
        return Radiosity(scene, material_reflectance(mi, scene.material), paths)
