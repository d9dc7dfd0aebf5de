"""How much of the light over the sample each class of paths can be at a pose: bounds, before anything is lit.

The share of a class is its mean radiance over the pixels that see the sample, over that of all light; its
bound is the class's own bound over the direct light alone, the larger of the channels', and at most 1. Light
is followed along every walk of a class (`simulator.light.bounds`); what the sample makes of it in a pose
needs integrals of f_r over the hemisphere, done here once a pose.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.bounds import CHANNELS, Light, Surroundings
from simulator.light.classes import SAMPLE, SHORT, path_classes, walks
from simulator.light.hemisphere import hemisphere
from simulator.light.lobes import brightest_from, brightest_within, image_cone
from simulator.light.scene import Event

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from simulator.light.classes import PathClass, Walk
    from simulator.light.scene import Scene

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]

_NODES = 24
"""Rows and columns of pixels, of the whole frame, from which the direct light's mean is taken."""
_MARGIN = 1.05
"""What the integrals over the hemisphere may be wrong by: their rule does not know the lobe."""
_LOBE_MARGIN = 1.3
"""What the largest value of f_r in a cone may be above that of its nodes."""
_DIRECTIONS = 5
"""Directions of lamp and camera, of all points seen, for which a cone is looked through."""
_THETAS = np.radians([0.0, 15.0, 30.0, 45.0, 60.0, 70.0, 80.0, 85.0, 89.0])
"""Polar angles at which the sample is looked at for light from anywhere."""


class Shares:
    """Bounds of the shares of a scene's path classes.

    Parameters
    ----------
    scene : Scene
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr, of the sample's parts that scatter.
    """

    def __init__(self, scene: Scene, reflectance: Reflectance) -> None:
        self._scene, self._reflectance = scene, reflectance
        self.classes: tuple[PathClass, ...] = path_classes(scene)
        self._kinematics = Kinematics(scene.rig)
        self._unbounded = len(self.classes) < 2 or not scene.plain
        if not self._unbounded:
            self._surroundings = Surroundings(scene, *self._over_all_directions())
            self._before_longer = () if self.classes[-1].walks else tuple(walks(scene, SHORT))
            self._cones = [image_cone(scene, mirror) for mirror in scene.mirrors]
            self._again = self._to_and_fro()

    def bounds(self, angles_rad: Sequence[float]) -> tuple[float, ...]:
        """Bound each class's share at a pose.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints.

        Returns
        -------
        tuple of float
            In the order of `classes`; between 0 and 1, and 1 where no bound is known, as for samples that are
            not flat, level and alike everywhere.
        """
        if self._unbounded:
            return (1.0,) * len(self.classes)
        pose = _Pose.look(self._scene, self._kinematics, self._reflectance, angles_rad)
        if pose is None:
            return (1.0,) * len(self.classes)
        direct = pose.lit(pose.lamp_mm, 1.0)
        return tuple(_share(self._radiance(pose, path_class), direct) for path_class in self.classes)

    def _over_all_directions(self) -> tuple[Array, Array]:
        """Largest albedo, and largest f_r times a cosine, for light from anywhere; (channels,) each."""
        found = [
            hemisphere(self._reflectance, np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)]))
            for t in _THETAS
            for p in (0.0, 0.5 * np.pi)
        ]
        albedo = np.max([np.pi * f.least + _MARGIN * f.rest for f in found], axis=0)
        return albedo, _MARGIN * np.max([f.largest_cosine for f in found], axis=0)

    def _to_and_fro(self) -> Array | None:
        """Bound what is left (channels,) of light from the sample over the only mirror back to it.

        None where light has other ways to go, or where more comes back than went.
        """
        scene = self._scene
        if scene.housing is not None or len(scene.mirrors) != 1 or Event.MIRROR in scene.events:
            return None
        if self._cones[0] is None:
            return None
        within = brightest_within(self._reflectance, self._cones[0])
        left = _LOBE_MARGIN * scene.mirrors[0].reflectance * self._cones[0].solid_angle * within
        return left if np.all(left < 1.0) else None

    def _radiance(self, pose: _Pose, path_class: PathClass) -> Array | None:
        """Mean radiance of a class, at most; None where no bound is known."""
        if not path_class.walks:
            return self._longer(pose)
        total = np.zeros(CHANNELS)
        for walk in path_class.walks:
            if _returns(walk) and (found := self._in_own_image(pose, int(walk[1][0]))) is not None:
                total += found
                continue
            light = self._surroundings.along(walk[:-1], pose.lamp_mm)
            arrived = self._camera(pose, light, walk[-1][1])
            if arrived is None:
                return None
            total += arrived
        return total

    def _camera(self, pose: _Pose, light: Light, event: Event) -> Array | None:
        """Mean radiance (channels,) of the sample, at most, lit by what is on its way."""
        around = self._surroundings
        if event is Event.MIRROR:
            # The lamp in a mirror is brighter than all else; how bright the sample is in one is not known.
            unknown = light.lamp_mm is not None or light.sample.any()
            return None if unknown else around.radiance_on_sample(light)
        if light.lamp_mm is not None:
            if not around.reaches_sample(light):
                return np.zeros(CHANNELS)
            return pose.lit(light.lamp_mm, light.kept)
        found = pose.largest * around.sample_on_itself(light)
        # What f_r is at least, all walls light together; the rest looks where the lobe looks.
        walls = [
            lobe.least * around.irradiance_of_sample(light) + _MARGIN * around.lobe_on_sample(light, lobe)
            for lobe in pose.lobes
        ]
        return np.asarray(found + np.max(walls, axis=0))

    def _in_own_image(self, pose: _Pose, number: int) -> Array | None:
        """Mean radiance (channels,) of the sample lit by its image in a mirror, at most."""
        cone, mirror = self._cones[number], self._scene.mirrors[number]
        if cone is None:
            return None
        lit = pose.irradiance * brightest_from(self._reflectance, cone, pose.wi)
        seen = brightest_from(self._reflectance, cone, pose.wo)
        return np.asarray(_LOBE_MARGIN**2 * mirror.reflectance * cone.solid_angle * lit * seen)

    def _longer(self, pose: _Pose) -> Array | None:
        """Mean radiance of all paths beyond the short ones, at most: a geometric series."""
        if self._again is not None:
            once = self._in_own_image(pose, 0)
            return None if once is None else once * self._again / (1.0 - self._again)
        around = self._surroundings
        lights = [around.along(walk, pose.lamp_mm) for walk in self._before_longer]
        if any(light.lamp_mm is not None for light in lights):
            return None
        total = around.series(lights)
        if total is None or (Event.MIRROR in self._scene.events and total.sample.any()):
            return None
        brightest = around.radiance_on_sample(total)
        mirrored = brightest if Event.MIRROR in self._scene.events else 0.0
        scattered = (np.pi * pose.least + pose.rest) * brightest
        return np.asarray(scattered + mirrored + pose.largest * around.sample_on_itself(total))


def _returns(walk: Walk) -> bool:
    """Tell whether light goes from the lamp over the sample and one mirror to the sample, scattered twice."""
    events = [event is Event.MIRROR for _, event in walk]
    return events == [False, True, False] and walk[0][0] == SAMPLE == walk[2][0] and walk[1][0] != SAMPLE


def _share(radiance: Array | None, direct: Array) -> float:
    if radiance is None:
        return 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(radiance > 0.0, radiance / direct, 0.0)
    return float(min(1.0, np.nan_to_num(ratio, nan=1.0, posinf=1.0).max()))


class _Pose:
    """What a pose decides, for all classes.

    Attributes
    ----------
    lamp_mm : ndarray, shape (3,)
    wi, wo : ndarray, shape (N, 3)
        Of a few points seen, towards lamp and camera.
    irradiance : float
        By the lamp, at most.
    lobes : list of Hemisphere
        Seen from the lowest, the middle and the highest of the camera's directions.
    least, rest, largest : ndarray, shape (channels,)
        As in `hemisphere`, over the directions of the camera.
    """

    def __init__(
        self, scene: Scene, reflectance: Reflectance, lamp_mm: Array, points_mm: Array, wo: Array
    ) -> None:
        self._scene, self._reflectance = scene, reflectance
        self.lamp_mm, self._points_mm, self._wo = lamp_mm, points_mm, wo
        few = np.unique(np.linspace(0, len(points_mm) - 1, _DIRECTIONS).astype(int))
        way = lamp_mm - points_mm[few]
        self.wi, self.wo = unit(way), wo[few]
        self.wi = self.wi[self.wi[:, 2] > 0.0]
        nearest = max(lamp_mm[2], float(np.linalg.norm(lamp_mm)) - scene.sample_radius_mm, 1e-300)
        self.irradiance = scene.lamp_intensity * max(0.0, float(lamp_mm[2])) / nearest**3
        order = np.argsort(wo[:, 2])
        found = [hemisphere(reflectance, end) for end in wo[order[[0, len(order) // 2, -1]]]]
        self.lobes = found
        self.least = np.min([f.least for f in found], axis=0)
        total = np.max([np.pi * f.least + _MARGIN * f.rest for f in found], axis=0)
        self.rest = total - np.pi * self.least
        self.largest = _MARGIN * np.max([f.largest_cosine for f in found], axis=0)

    @classmethod
    def look(
        cls, scene: Scene, kinematics: Kinematics, reflectance: Reflectance, angles_rad: Sequence[float]
    ) -> _Pose | None:
        """Look at a pose; None where the camera does not see the sample."""
        camera = scene.rig.camera
        rows, cols = (np.linspace(0, n - 1, min(n, _NODES)) for n in (camera.height_px, camera.width_px))
        pixels = pixel_geometry(scene.rig, angles_rad, rows=rows, cols=cols)
        if not pixels.on_sample.any():
            pixels = pixel_geometry(scene.rig, angles_rad)
        seen = pixels.on_sample
        if not seen.any():
            return None
        points = np.column_stack([pixels.position_mm[seen], np.zeros(int(seen.sum()))])
        return cls(scene, reflectance, kinematics.frames(angles_rad).light_mm, points, pixels.wo[seen])

    def lit(self, lamp_mm: Array, kept: float) -> Array:
        """Mean radiance (channels,) of the sample lit by the lamp, or by an image that nothing hides."""
        way = lamp_mm - self._points_mm
        distance = np.linalg.norm(way, axis=-1)
        above = way[:, 2] > 0.0
        wi = way[above] / distance[above, None]
        radiance = np.zeros((len(way), CHANNELS))
        irradiance = kept * self._scene.lamp_intensity * wi[:, 2] / distance[above] ** 2
        radiance[above] = self._reflectance(wi, self._wo[above]) * irradiance[:, None]
        return np.asarray(radiance.mean(axis=0))
