"""Light that meets the sample once, LDE, of samples of any form, tilt, relief and pattern, in float64.

Where all of a pixel sees one kind of place, it is a sum over nodes, as many as the pose needs (as
`simulator.light.direct` has it). Pixels that the sample's outline or an edge of its pattern crosses take
many points, evenly spread over pixel, lamp and pupil together, doubled until they no longer change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.kinematics import Kinematics
from simulator.light.direct import DirectLight
from simulator.light.direct_view import extents_of, lens_of, view_of
from simulator.light.evaluator import Evaluator, Method, Rendering
from simulator.light.even_rules import even_rule
from simulator.light.paths import LightPaths
from simulator.light.reflectance import material_reflectance
from simulator.light.sample_shapes import SampleSurface

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from simulator.light.direct_view import Extents, Lens, View
    from simulator.light.scene import Scene
    from simulator.light.sparse_rules import Rule

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]

ROUNDING = 1e-11
"""Relative error of one radiance: a point on a curved sample is a difference of arms' lengths."""
_AROUND = np.array([[x, y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
"""Where it is looked for edges, in pixels from the centre: beyond the pixel, for the outline is steep."""
_TURNS = 0.25 * np.pi * np.arange(8)
_RIM = np.vstack([np.zeros((1, 2)), np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])])
"""The pupil's middle, and points of its rim, in its radii."""
_SHARP_MM = 1e-3
"""Circle of confusion on the sample that nobody sees."""
_FEWEST, _MOST = 16, 4096
"""Points of a pixel with an edge."""
_NODE_S, _ONE_BY_ONE_S, _NODES, _CROSSED = 8e-7, 4e-6, 13, 0.1
"""Seconds per node of a pixel, and those of a BSDF in scalar mode on top; nodes that mostly do; and the part
of the pixels that is taken to hold an edge."""


class SurfaceNodes:
    """Direct light on a sample of any form, node by node; zero in pixels with an edge.

    Parameters
    ----------
    surface : SampleSurface
    own, other : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr of the material, and of a pattern's second one.
    extents : Extents
        Of lamp, pixel and pupil.
    """

    rounding = ROUNDING
    step_rad = 0.0

    def __init__(
        self, surface: SampleSurface, own: Reflectance, other: Reflectance | None, extents: Extents
    ) -> None:
        self._surface, self._own, self._other, self._extents = surface, own, other, extents

    def radiance(self, views: Sequence[View], lens: Lens, rule: Rule) -> Array:
        """Mean radiance (P, N, 3) of N pixels over a rule's nodes, for P views."""
        found = np.zeros((len(views), len(lens), 3))
        for place, view in enumerate(views):
            inside = np.flatnonzero(~self.edges(view, lens))
            found[place, inside] = self.sum(view, lens[inside], rule)
        return found

    def edges(self, view: View, lens: Lens) -> NDArray[np.bool_]:
        """Tell which pixels (N,) hold an edge."""
        if self._extents.pixel == 0.0:
            return np.zeros(len(lens), dtype=bool)
        met = [
            self._surface.meet(*_rays(view, lens, offset, pupil))
            for offset in _AROUND
            for pupil in (_RIM if self._blurred(view) else _RIM[:1])
        ]
        return self._surface.edges(met)

    def _blurred(self, view: View) -> bool:
        """Tell whether the sample leaves the plane in focus by more than pixels show."""
        nearest, farthest = (
            np.linalg.norm(view.camera_mm) + sign * self._surface.reach_mm for sign in (-1.0, 1.0)
        )
        if view.focus_mm == 0.0:
            return False
        off = max(abs(view.focus_mm - nearest), abs(farthest - view.focus_mm))
        return bool(self._extents.pupil_radius_mm * off / view.focus_mm > _SHARP_MM)

    def sum(self, view: View, lens: Lens, rule: Rule) -> Array:
        """Mean radiance (N, 3) of pixels over a rule's nodes, edges or not."""
        total = np.zeros((len(lens), 3))
        for node, weight in zip(rule.nodes, rule.weights, strict=True):
            total += weight * self._node(view, lens, node)
        return total

    def _node(self, view: View, lens: Lens, node: Array) -> Array:
        """Radiance (N, 3) of points of pixels towards a point of the pupil, lit by a point of the lamp."""
        radiance = np.zeros((len(lens), 3))
        met = self._surface.meet(*_rays(view, lens, self._extents.pixel * node[2:4], node[4:]))
        to_light = view.light_mm + node[:2] @ view.light_disc_mm - met.points_mm
        to_camera = view.camera_mm + node[4:] @ view.pupil_disc_mm - met.points_mm
        lit = met.seen & (_dot(to_light, met.normals) > 0.0) & (_dot(to_camera, met.normals) > 0.0)
        met, to_light, to_camera = met[lit], to_light[lit], to_camera[lit]
        light_mm = np.linalg.norm(to_light, axis=-1)
        wi, wo = to_light / light_mm[:, None], to_camera / np.linalg.norm(to_camera, axis=-1)[:, None]
        strength = view.strength / light_mm**2
        if self._extents.lamp_radius_mm > 0.0:
            strength *= np.maximum(-(wi @ view.facing), 0.0)
        frames = self._surface.frames(met)
        wi, wo = (np.einsum("nij,nj->ni", frames, way) for way in (wi, wo))
        facing = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
        values = np.zeros((len(wi), 3))
        values[facing] = self._surface.f_r(self._own, self._other, met[facing], wi[facing], wo[facing])
        radiance[lit] = values * (strength * np.maximum(wi[:, 2], 0.0))[:, None]
        return radiance


class SurfaceLight(Evaluator):
    """Direct light on a sample of any form.

    Parameters
    ----------
    scene : Scene
    own, other : callable
        As in `SurfaceNodes`.
    extents : Extents, optional
        Of lamp, pixel and pupil; by default the rig's.

    Attributes
    ----------
    smooth : DirectLight
        The same without pixels that hold an edge: they are zero.
    """

    def __init__(
        self, scene: Scene, own: Reflectance, other: Reflectance | None, extents: Extents | None = None
    ) -> None:
        rig = scene.rig
        self._extents = extents_of(rig) if extents is None else extents
        surface = SampleSurface(scene.material.mounting, scene.sample_radius_mm)
        self._nodes = SurfaceNodes(surface, own, other, self._extents)
        self.smooth = DirectLight(rig, self._nodes, self._extents)
        self._kinematics, self._lens = Kinematics(rig), lens_of(rig)

    def render(self, angles_rad: Sequence[float], tolerance: float) -> Rendering:
        """Compute a pose; see `Evaluator.render`."""
        smooth = self.smooth.render(angles_rad, 0.5 * tolerance)
        view = view_of(self._kinematics.frames(np.asarray(angles_rad)), self._extents)
        crossed = np.flatnonzero(self._nodes.edges(view, self._lens))
        if crossed.size == 0:
            return smooth
        values, error, points = self._many(view, crossed, smooth.radiance, tolerance)
        radiance = smooth.radiance.reshape(-1, 3)
        radiance[crossed] = values
        did = f"{smooth.did}; {points} points per pixel with an edge, in {crossed.size} pixels"
        return Rendering(radiance.reshape(smooth.radiance.shape), smooth.error + error, did)

    def _many(
        self, view: View, crossed: NDArray[np.intp], smooth: Array, tolerance: float
    ) -> tuple[Array, float, int]:
        """Radiance of pixels with an edge, its error as `Rendering` has it, and how many points it took."""
        lens, points = self._lens[crossed], _FEWEST
        values = self._nodes.sum(view, lens, even_rule(0, points))
        while True:
            # Points are added, none is evaluated twice.
            more = self._nodes.sum(view, lens, even_rule(points, 2 * points))
            finer, points = 0.5 * (values + more), 2 * points
            change, values = finer - values, finer
            lit = max(1, int(smooth.any(axis=-1).sum()) + int(values.any(axis=-1).sum()))
            mean = (smooth.sum() + values.sum()) / (3 * lit)
            # The next doubling would change it by less: points that are evenly spread converge.
            error = float(np.sqrt(np.sum(change**2) / (3 * lit)) / mean) if mean > 0.0 else 0.0
            if error <= 0.5 * tolerance or points >= _MOST:
                return values, error, points


class SurfaceMethod(Method):
    """Direct light on samples of any form."""

    name = "direct light on the sample's form in float64"
    covers = LightPaths("LDE")
    any_sample = True

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:  # noqa: ARG002
        """Say why it cannot; see `Method.obstacle`."""
        return "the sample is flat and alike everywhere, which is less work" if scene.plain else None

    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:  # noqa: ARG002
        """Predict the time of a pose; see `Method.seconds`."""
        one_by_one = not scene.material.has_closed_form and not vector
        node_s = _NODE_S + (_ONE_BY_ONE_S if one_by_one else 0.0)
        # Points that are evenly spread over a pixel with an edge err by their number to the power -3/4.
        points = np.clip(tolerance ** (-4.0 / 3.0), _FEWEST, _MOST)
        pixels = scene.rig.camera.width_px * scene.rig.camera.height_px
        return float(node_s * pixels * (_NODES + _CROSSED * points))

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> Evaluator:  # noqa: ARG002
        """Set it to work; see `Method.build`."""
        pattern = scene.material.mounting.pattern
        other = None if pattern is None else material_reflectance(mi, pattern.other)
        return SurfaceLight(scene, material_reflectance(mi, scene.material), other)


def _ways(view: View, lens: Lens, offset: Array) -> Array:
    """Return unit vectors (N, 3) from the camera through points of pixels."""
    x, y = (lens.places + offset[0] * lens.across + offset[1] * lens.down).T
    ways = np.stack([x, y, np.ones_like(x)], axis=-1) @ view.camera_rotation.T
    return np.asarray(ways / np.linalg.norm(ways, axis=-1, keepdims=True))


def _rays(view: View, lens: Lens, offset: Array, pupil: Array) -> tuple[Array, Array]:
    """Return the origin (3,) and directions (N, 3) of rays from a point of the pupil to points of pixels."""
    off = pupil @ view.pupil_disc_mm
    if view.focus_mm == 0.0 or not off.any():
        return view.camera_mm, _ways(view, lens, offset)
    ways = _ways(view, lens, offset)
    in_focus = ways * (view.focus_mm / (ways @ view.camera_rotation[:, 2]))[:, None]
    ways = in_focus - off
    return view.camera_mm + off, ways / np.linalg.norm(ways, axis=-1, keepdims=True)


def _dot(first: Array, second: Array) -> Array:
    return np.asarray(np.sum(first * second, axis=-1))
