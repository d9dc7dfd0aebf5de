"""What rays meet in a scene, asked of Mitsuba from NumPy, in either variant."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.light import mitsuba_scene

if TYPE_CHECKING:
    from simulator.light.scene import Scene

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]

NOTHING = -1
_OFF = 1e-5
"""Step off a surface, in the lamp's distances: single precision knows places to 1e-7 of them."""
_FACETS = 2e-4
"""How far the facets of a mirror may lie off its sphere, in its radii."""


class Obstacles:
    """The surfaces of a scene, without the lamp.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set.
    scene : Scene
        Its sample is flat and level.

    Attributes
    ----------
    names : tuple of str
        Of the surfaces: ``sample``, ``housing``, ``mirror0``...
    off_mm : float
        Step off a surface from which rays do not meet it again.
    """

    def __init__(self, mi: Any, scene: Scene) -> None:
        description: dict[str, Any] = {
            "type": "scene",
            "sample": {"type": "disk", "to_world": mi.ScalarTransform4f().scale(scene.sample_radius_mm)},
        }
        if scene.housing is not None:
            description["housing"] = mitsuba_scene.housing(
                mi, scene.housing.albedo, scene.housing.half_size_mm
            )
        for number in range(len(scene.mirrors)):
            description[f"mirror{number}"] = mitsuba_scene.mirror(mi, number, scene)
        self._mi = mi
        self._scene = mi.load_dict(description, optimize=False)
        shapes = {shape.id(): shape for shape in self._scene.shapes()}
        self.names = tuple(shapes)
        self._shapes = [shapes[name] for name in self.names]
        radii = [abs(getattr(mirror, "radius_mm", 0.0)) for mirror in scene.mirrors]
        self.off_mm = _OFF * scene.rig.lamp.distance_mm + _FACETS * max(radii, default=0.0)

    def meet(self, points_mm: Array, directions: Array) -> tuple[Indices, Array]:
        """Find what rays meet first.

        Parameters
        ----------
        points_mm, directions : ndarray, shape (N, 3)
            The directions of length 1.

        Returns
        -------
        met : ndarray of int, shape (N,)
            Places in `names`, `NOTHING` for nothing.
        distance_mm : ndarray, shape (N,)
            Infinite for nothing.
        """
        if len(points_mm) == 0:
            return np.zeros(0, dtype=np.intp), np.zeros(0)
        if self._mi.variant().startswith("scalar"):
            return self._one_by_one(points_mm, directions)
        mi = self._mi
        ray = mi.Ray3f(
            mi.Point3f(points_mm.T.astype(np.float32)), mi.Vector3f(directions.T.astype(np.float32))
        )
        found = self._scene.ray_intersect_preliminary(ray, coherent=False)
        distance = np.array(found.t, dtype=np.float64)
        met = np.full(len(points_mm), NOTHING, dtype=np.intp)
        for place, shape in enumerate(self._shapes):
            met[np.array(found.shape == mi.ShapePtr(shape))] = place
        return met, distance

    def _one_by_one(self, points_mm: Array, directions: Array) -> tuple[Indices, Array]:
        mi, places = self._mi, {name: place for place, name in enumerate(self.names)}
        met = np.full(len(points_mm), NOTHING, dtype=np.intp)
        distance = np.full(len(points_mm), np.inf)
        for row, (point, direction) in enumerate(zip(points_mm.tolist(), directions.tolist(), strict=True)):
            found = self._scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(point), mi.Vector3f(direction)))
            if found.is_valid():
                met[row], distance[row] = places[found.shape.id()], found.t
        return met, distance

    def clear(self, points_mm: Array, directions: Array, distance_mm: Array) -> Bools:
        """Tell whether nothing stands between points and what lies at a distance from them.

        Parameters
        ----------
        points_mm, directions : ndarray, shape (N, 3)
        distance_mm : ndarray, shape (N,)
        """
        _, way = self.meet(points_mm + self.off_mm * directions, directions)
        return np.asarray(way > distance_mm - 10.0 * self.off_mm)
