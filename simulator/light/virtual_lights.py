"""Lamps in planar mirrors: L S+ D E by the method of images, without noise.

A planar ideal mirror shows the lamp behind itself; what the image lights is what the lamp lights over the
mirror, times the reflectance, seen through the mirror as through a window. Several mirrors show images of
images. Each point of the sample is followed back, mirror by mirror: its way to the last image must pass the
last mirror's rectangle, from there to the image before it the mirror before, and so to the lamp, and neither
the sample nor another mirror may stand in a part of the way.

The mean over the lamp's disc, the pixel's footprint and the entrance pupil is taken with few nodes of a
product rule where the picture is smooth, and along the windows' edges, which it makes soft, with ever more
nodes that are evenly spread in all six dimensions at once.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from analysis.instrument import disc_nodes
from rig.angles import unit
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.classes import light_paths
from simulator.light.costs import value_s
from simulator.light.direct_view import extents_of, lens_of, meet, view_of
from simulator.light.evaluator import Evaluator, Method, Rendering
from simulator.light.even_rules import even_rule
from simulator.light.paths import LightPaths
from simulator.light.reflectance import material_reflectance
from simulator.light.sparse_rules import CENTRES, product_rule, sparse_rule
from simulator.light.virtual_lamps import MOST_IMAGES, hidden, virtual_lamps

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from simulator.light.direct_view import Lens, View
    from simulator.light.scene import Scene
    from simulator.light.sparse_rules import Rule

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_SPREAD = (32, 128, 512, 2048)
"""Nodes of lamp, pixel and pupil together along the edges of windows."""
_FIRST = sparse_rule(frozenset({CENTRES, *CENTRES.children()}))
"""Four nodes in each part, one after the other."""
_SECONDS_PER_NODE = 6e-7
"""Time of one node of one image in one pixel besides that of its f_r."""
_EDGES, _EDGE_ERROR = 6.0, 0.4
"""Pixels along a window's edges, in rows of the frame, and the error of one node there."""
_SETTLED = 0.3
"""Change of a pixel, in tolerances of the mean, below which it is not refined further."""


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
        self._lens = lens_of(scene.rig)
        self.lamps = virtual_lamps(scene, paths)

    def render(self, angles_rad: Sequence[float], tolerance: float) -> Rendering:
        """Compute the radiance of a pose; see `Evaluator`."""
        scene, camera = self._scene, self._scene.rig.camera
        angles = np.asarray(angles_rad, dtype=np.float64)
        on_sample = pixel_geometry(scene.rig, angles).on_sample
        radiance = np.zeros((*on_sample.shape, 3))
        extents = extents_of(scene.rig)
        extents = extents if scene.lamp_cosine else replace(extents, lamp_radius_mm=0.0)
        view = view_of(self._kinematics.frames(angles), extents)
        # A pixel whose centre is on the sample is taken to see it everywhere.
        lens = self._lens[np.flatnonzero(on_sample)]
        coarse, picture = (self.mean(view, lens, rule) for rule in (product_rule(CENTRES), _FIRST))
        change, nodes = picture - coarse, len(_FIRST.weights)
        error = _relative(change, picture)
        for count in _SPREAD:
            if error <= tolerance:
                break
            open_ = _unsettled(on_sample, change, _SETTLED * tolerance * max(0.0, float(picture.mean())))
            fine = self.mean(view, lens[np.flatnonzero(open_)], even_rule(0, count))
            change[open_], picture[open_], nodes = fine - picture[open_], fine, count
            error = _relative(change, picture)
        radiance[on_sample] = np.maximum(picture, 0.0)
        did = f"{len(self.lamps)} images of the lamp, up to {nodes} nodes of lamp, pixel and pupil"
        return Rendering(
            radiance.reshape(camera.height_px, camera.width_px, 3), error + self._left_out(), did
        )

    def mean(self, view: View, lens: Lens, rule: Rule) -> Array:
        """Mean radiance of pixels over a rule's nodes.

        Parameters
        ----------
        view : View
            Of a pose.
        lens : Lens
            N pixels.
        rule : Rule
            Nodes of lamp, pixel and pupil.

        Returns
        -------
        ndarray, shape (N, 3)
        """
        total = np.zeros((len(lens), 3))
        for node, weight in zip(rule.nodes, rule.weights, strict=True):
            points, w = meet(view, lens, node[2:4], node[4:])
            points = np.where(w[:, None] > 0.0, points, 0.0)
            wo = unit(view.camera_mm + node[4:] @ view.pupil_disc_mm - points)
            place = view.light_mm + node[:2] @ view.light_disc_mm
            total += self._lit(view.light_mm, place, weight * view.strength, points, wo)
        return total

    def _left_out(self) -> float:
        """Bound what images of more mirrors would add, relative to those that were followed."""
        if len(self._scene.mirrors) < 2:
            return 0.0
        brightest = max(mirror.reflectance for mirror in self._scene.mirrors)
        deepest = [lamp for lamp in self.lamps if len(lamp.mirrors) == MOST_IMAGES]
        if not deepest:
            return 0.0
        return float(brightest**MOST_IMAGES * len(deepest) / max(1.0 - brightest, 1e-3))

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
            radiance += self._lit(light_mm, place, intensity, points_mm, wo)
        return radiance

    def _lit(self, light_mm: Array, place: Array, intensity: float, points_mm: Array, wo: Array) -> Array:
        """Radiance (N, 3) of points lit by one place of the lamp."""
        radiance = np.zeros((len(points_mm), 3))
        for lamp in self.lamps:
            passes, corners = lamp.ways(place, points_mm)
            passes &= ~hidden(self._scene, lamp, corners)
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


def _unsettled(on_sample: Bools, change: Array, level: float) -> Bools:
    """Tell which pixels (N,) of the sample the last step changed, along the windows' edges, or one beside."""
    moved = np.zeros(on_sample.shape, dtype=bool)
    moved[on_sample] = (np.abs(change) > level).any(axis=-1)
    return np.asarray(binary_dilation(moved, np.ones((3, 3)))[on_sample])


def _relative(change: Array, picture: Array) -> float:
    """RMS of a change (N, 3), relative to the mean."""
    mean = float(picture.mean()) if picture.size else 0.0
    return float(np.sqrt(np.mean(np.square(change)))) / mean if mean > 0.0 else 0.0


class VirtualLightsMethod(Method):
    """The row of `VirtualLights` in the table of methods."""

    name = "virtual lights"
    covers = LightPaths("LS+DE")

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:  # noqa: ARG002
        """Say why it cannot compute the paths; see `Method`."""
        if not scene.mirrors:
            return "no mirror but the sample's own part"
        if scene.curved_mirrors:
            return "a curved mirror's image of the lamp has no place"
        housed = scene.housing is not None
        beyond = paths.with_events(MOST_IMAGES + 2) & light_paths(scene)
        brightest = max(mirror.reflectance for mirror in scene.mirrors)
        if beyond and not housed and brightest > 1.0 - 1e-3:
            return f"mirrors without loss face each other, and {MOST_IMAGES} images are followed"
        return None

    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:
        """Predict the time of one pose; see `Method`."""
        lamps = len(virtual_lamps(scene, paths))
        width, height = scene.rig.camera.width_px, scene.rig.camera.height_px
        edges = min(1.0, _EDGES / min(width, height))
        needed = [count for count in _SPREAD if _EDGE_ERROR * edges**0.5 / count**0.6 > tolerance]
        nodes = len(_FIRST.weights) + 1 + edges * sum(_SPREAD[: len(needed) + 1])
        return lamps * nodes * width * height * (_SECONDS_PER_NODE + value_s(scene.material, vector=vector))

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> VirtualLights:
        """Set it to work; see `Method`."""
        return VirtualLights(scene, material_reflectance(mi, scene.material), paths)
