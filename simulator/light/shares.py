"""How much of the light over the sample each class of paths can be at a pose: bounds, before anything is lit.

The share of a class is its mean radiance over the pixels that see the sample, over that of all light; its
bound is the class's own bound over the direct light alone, the larger of the channels', and at most 1. Light
is followed along every walk of a class (`simulator.light.bounds`); what the sample makes of it in a pose
needs integrals of f_r over the hemisphere. All is done for many poses at once, each as if it were alone.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from simulator.light.bounds import Surroundings
from simulator.light.classes import SAMPLE, SHORT, path_classes, walks
from simulator.light.hemisphere import hemisphere
from simulator.light.lights import MARGIN, RINGS, TURNS, Light, Lobe, Start
from simulator.light.lobes import OwnImage, brightest_within, image_cone
from simulator.light.looks import Looks
from simulator.light.scene import Event

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from simulator.light.classes import PathClass, Walk
    from simulator.light.looks import Look
    from simulator.light.scene import Scene

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]

_NODES = 12
"""Rows and columns of pixels, of the whole frame, from which the direct light's mean is taken."""
_LOBE_MARGIN = 1.3
"""What the largest value of f_r in a cone may be above that of its nodes."""
_IMAGE_MARGIN = 1.5
"""What the brightest place of a sample that lights itself may be above that of its pairs of places."""
_LOWEST_COSINE = 1e-3
"""Of a lamp's direction: one below the horizon lights nothing, and is asked nothing."""
_APART_MARGIN = 1.2
"""For perspective and distortion, which draw places apart as well."""
_DIGITS = 3
"""To which bounds are stated, rounded up: below, they may depend on what else is asked at once."""
_TOGETHER = 32
"""Poses that are looked at in one go, so that their cells stay near the processor."""
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
        self._unbounded = len(self.classes) < 2 or not scene.plain or scene.curved_mirrors or scene.obstructed
        if not self._unbounded:
            self._looks = Looks(scene.rig, _NODES)
            self._surroundings = Surroundings(scene, *self._over_all_directions())
            self._before_longer = () if self.classes[-1].walks else tuple(walks(scene, SHORT))
            self._images = [OwnImage(scene, mirror) for mirror in self._surroundings.mirrors]
            self._again = self._to_and_fro()

    def bounds(self, poses_rad: Sequence[Sequence[float]]) -> list[tuple[float, ...]]:
        """Bound each class's share at poses.

        Parameters
        ----------
        poses_rad : sequence of sequences of float
            True angles of the arm joints, of P poses.

        Returns
        -------
        list of tuple of float
            For each pose, in the order of `classes`; between 0 and 1, and 1 where no bound is known, as for
            samples that are not flat, level and alike everywhere, and beside curved mirrors.
        """
        if self._unbounded:
            return [(1.0,) * len(self.classes)] * len(poses_rad)
        poses = np.asarray(poses_rad, dtype=np.float64)
        parts = np.array_split(poses, range(_TOGETHER, len(poses), _TOGETHER))
        found = np.concatenate([self._at(part, self._looks) for part in parts])
        return [tuple(row) for row in found.tolist()]

    def _at(self, poses: Array, looks: Looks) -> Array:
        """Bounds (P, classes); poses that show no sample at the places looked at are looked at everywhere."""
        look = looks.at(poses)
        seen = look.seen.any(axis=1)
        found = np.ones((len(poses), len(self.classes)))
        if not seen.all():
            if looks is self._looks:
                found[~seen] = self._at(poses[~seen], looks.all_pixels())
            if seen.any():
                found[seen] = self._at(poses[seen], looks)
            return found
        at = _Poses(self._scene, self._reflectance, look, self._surroundings)
        known: dict[Walk, Light] = {}
        direct = at.lit(look.light_mm, 1.0)
        for number, path_class in enumerate(self.classes):
            found[:, number] = _share(self._radiance(at, path_class, known), direct)
        return found

    def _over_all_directions(self) -> tuple[Array, Array]:
        """Largest albedo, and largest f_r times a cosine, for light from anywhere; (C,) each."""
        phi = np.array([[0.0], [0.5 * np.pi]])
        parts = np.sin(_THETAS) * np.cos(phi), np.sin(_THETAS) * np.sin(phi), np.cos(_THETAS) + 0.0 * phi
        found = hemisphere(self._reflectance, np.stack(parts, axis=-1), rings=RINGS, turns=TURNS)
        albedo = np.pi * found.least + MARGIN * found.rest
        return albedo.max(axis=(0, 1)), MARGIN * found.largest_cosine.max(axis=(0, 1))

    def _to_and_fro(self) -> Array | None:
        """Bound what is left (C,) of light from the sample over the only mirror back to it.

        None where light has other ways to go, or where more comes back than went.
        """
        scene = self._scene
        if scene.housing is not None or len(scene.mirrors) != 1 or Event.MIRROR in scene.events:
            return None
        # Light that comes from anywhere leaves with the albedo at most; a narrow cone may hold less.
        (mirror,) = self._surroundings.mirrors
        left = mirror.reflectance * self._surroundings.albedo
        cone = image_cone(scene, mirror)
        if cone is not None:
            within = cone.solid_angle * brightest_within(self._reflectance, cone)
            left = np.minimum(left, _LOBE_MARGIN * mirror.reflectance * within)
        return np.asarray(left) if np.all(left < 1.0) else None

    def _radiance(self, at: _Poses, path_class: PathClass, known: dict[Walk, Light]) -> Array | None:
        """Mean radiance (P, C) of a class, at most; None where no bound is known."""
        if not path_class.walks:
            return self._longer(at, known)
        total = np.zeros_like(at.camera_mm)
        for walk in path_class.walks:
            if _returns(walk):
                total += self._in_own_image(at, int(walk[1][0]))
                continue
            arrived = self._camera(at, self._surroundings.along(walk[:-1], at.start, known), walk[-1][1])
            if arrived is None:
                return None
            total += arrived
        return total

    def _camera(self, at: _Poses, light: Light, event: Event) -> Array | None:
        """Mean radiance (P, C) of the sample, at most, lit by what is on its way."""
        around = self._surroundings
        if event is Event.MIRROR:
            # The lamp in a mirror is brighter than all else; how bright the sample is in one is not known.
            unknown = light.lamp_mm is not None or light.sample.any()
            return None if unknown else around.radiance_on_sample(light)
        if light.lamp_mm is not None:
            return at.lit(light.lamp_mm, light.kept, around.reaches(light, at.points_mm, at.apart_mm))
        return self._scattered(at, light)

    def _scattered(self, at: _Poses, light: Light) -> Array:
        """Mean radiance (P, C) of the sample, at most, lit by what scatters."""
        around = self._surroundings
        found = np.zeros_like(at.camera_mm)
        if self._scene.housing is not None:
            found += around.by_walls(light, at.lobe)
        if light.sample.any():
            found += at.lobe.largest.max(axis=1) * around.sample_on_itself(light)
        return found

    def _in_own_image(self, at: _Poses, number: int) -> Array:
        """Mean radiance (P, C) of the sample lit by its image in a mirror, at most."""
        image = self._images[number]
        return _IMAGE_MARGIN * image.radiance(self._reflectance, at.start.lamp_mm, at.camera_mm)

    def _longer(self, at: _Poses, known: dict[Walk, Light]) -> Array | None:
        """Mean radiance (P, C) of all paths beyond the short ones, at most: a geometric series."""
        if self._again is not None:
            return self._in_own_image(at, 0) * self._again / (1.0 - self._again)
        around = self._surroundings
        lights = [around.along(walk, at.start, known) for walk in self._before_longer]
        if any(light.lamp_mm is not None for light in lights):
            return None
        total = around.series(lights)
        if total is None or (Event.MIRROR in self._scene.events and total.sample.any()):
            return None
        found = self._scattered(at, total)
        return found + around.radiance_on_sample(total) if Event.MIRROR in self._scene.events else found


def _returns(walk: Walk) -> bool:
    """Tell whether light goes from the lamp over the sample and one mirror to the sample, scattered twice."""
    events = [event is Event.MIRROR for _, event in walk]
    return events == [False, True, False] and walk[0][0] == SAMPLE == walk[2][0] and walk[1][0] != SAMPLE


def _share(radiance: Array | None, direct: Array) -> Array | float:
    """Return shares (P,) of the channel of the largest; 1 where nothing is known."""
    if radiance is None:
        return 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(radiance > 0.0, radiance / direct, 0.0)
    largest = np.nan_to_num(ratio, nan=1.0, posinf=1.0).max(axis=1)
    return np.minimum(1.0, _rounded_up(largest))


def _rounded_up(values: Array) -> Array:
    """Round numbers (N,) up to a few digits."""
    positive = values > 0.0
    scale = 10.0 ** (np.floor(np.log10(np.where(positive, values, 1.0))) - _DIGITS + 1.0)
    return np.where(positive, np.ceil(values / scale - 1e-6) * scale, 0.0)


class _Poses:
    """What poses decide, for all classes.

    Attributes
    ----------
    start : Start
    camera_mm : ndarray, shape (P, 3)
    points_mm : ndarray, shape (P, N, 3)
        Places of the sample that are looked at.
    apart_mm : ndarray, shape (P,)
        How far around each of them there may be no other.
    """

    def __init__(self, scene: Scene, reflectance: Reflectance, look: Look, around: Surroundings) -> None:
        self._scene, self._reflectance = scene, reflectance
        self.points_mm, self._seen = np.where(look.seen[..., None], look.points_mm[:, 0], 0.0), look.seen
        self.apart_mm = self._apart_mm(look.camera_mm)
        self._wo = unit(look.camera_mm[:, None] - self.points_mm)
        lamp = look.light_mm
        rows, ends = np.arange(len(lamp))[:, None], self._ends()
        self.camera_mm, self._cells = look.camera_mm, around.cells
        self._towards = self._wo[rows, ends]
        wi = unit(lamp - self.points_mm[rows[:, 0], ends[:, 1]])
        wi[:, 2] = np.maximum(wi[:, 2], _LOWEST_COSINE)
        self.start = Start(lamp, unit(wi), reflectance)

    @cached_property
    def lobe(self) -> Lobe:
        """For the lowest and the highest of the camera's directions."""
        found = hemisphere(self._reflectance, self._towards, rings=RINGS, turns=TURNS)
        return Lobe(
            found.least,
            MARGIN * found.rest,
            MARGIN * found.largest_cosine,
            MARGIN * found.weights,
            self._cells.seen(found.directions),
        )

    def _apart_mm(self, camera_mm: Array) -> Array:
        """Half the diagonal (P,) between places on the sample, which a view at an angle draws apart."""
        camera, distance = self._scene.rig.camera, np.linalg.norm(camera_mm, axis=-1)
        pixels = max(camera.height_px, camera.width_px) / min(_NODES, camera.height_px, camera.width_px)
        cosine = np.maximum(camera_mm[:, 2] / distance, _LOWEST_COSINE)
        apart = 0.5 * pixels * distance / camera.focal_length_px * np.hypot(1.0, 1.0 / cosine)
        return np.asarray(np.minimum(_APART_MARGIN * apart, 2.0 * self._scene.sample_radius_mm))

    def _ends(self) -> NDArray[np.intp]:
        """Places (P, 2) of the lowest and the highest of the camera's directions."""
        cosine = np.where(self._seen, self._wo[..., 2], np.nan)
        return np.stack([np.nanargmin(cosine, axis=1), np.nanargmax(cosine, axis=1)], axis=1)

    def lit(self, lamp_mm: Array, kept: float, where: NDArray[np.bool_] | None = None) -> Array:
        """Mean radiance (P, C) of the sample lit by the lamp, or by an image that nothing hides.

        Parameters
        ----------
        lamp_mm : ndarray, shape (P, 3)
        kept : float
            Of its light.
        where : ndarray of bool, shape (P, N), optional
            Which places; the others are dark.
        """
        way = lamp_mm[:, None] - self.points_mm
        asked = self._seen & (way[..., 2] > 0.0)
        if where is not None:
            asked &= where
        way = way[asked]
        distance = np.sqrt(np.sum(way**2, axis=-1))
        wi = way / distance[:, None]
        radiance = np.zeros(self.points_mm.shape)
        irradiance = kept * self._scene.lamp_intensity * wi[:, 2] / distance**2
        radiance[asked] = self._reflectance(wi, self._wo[asked]) * irradiance[:, None]
        return np.asarray(radiance.sum(axis=1) / self._seen.sum(axis=1)[:, None])
