"""Where photons set out: on the lamp, or where the lamp's light is scattered first."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from simulator.light.classes import HOUSING, SAMPLE
from simulator.light.scene import Event

if TYPE_CHECKING:
    from collections.abc import Callable

    from simulator.light.obstacles import Obstacles
    from simulator.light.photons import Photons
    from simulator.light.scene import Scene

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]

CHANNELS = 3


class Origin(StrEnum):
    """What throws light at the mirrors."""

    LAMP = "lamp"
    SAMPLE = SAMPLE
    HOUSING = HOUSING


class Start(NamedTuple):
    """Where N photons set out.

    `flux` (N, channels) times what `sends` gives for directions, times the cosine at what they are aimed at
    and its area over the distance squared, is their power.
    """

    points: Array
    flux: Array
    sends: Callable[[Array], Array]


def first_words(scene: Scene) -> dict[Origin, tuple[str, ...]]:
    """Return the words that light has gathered, without L, when it leaves each origin for a mirror."""
    letters = tuple(str(letter) for letter in sorted(scene.events - {Event.MIRROR}))
    words = {Origin.LAMP: ("",), Origin.SAMPLE: letters}
    return words if scene.housing is None else words | {Origin.HOUSING: (str(Event.LAMBERTIAN),)}


class Starts:
    """Starts of the photons of one scene.

    Parameters
    ----------
    scene : Scene
        Its sample is flat and level.
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr of the sample.
    obstacles : Obstacles
        What stands in the way.
    """

    def __init__(self, scene: Scene, reflectance: Reflectance, obstacles: Obstacles) -> None:
        self._scene, self._reflectance, self._obstacles = scene, reflectance, obstacles

    def draw(self, origin: Origin, light_mm: Array, u: Array) -> Start:
        """Return starts.

        Parameters
        ----------
        origin : Origin
        light_mm : ndarray, shape (3,)
            The lamp.
        u : ndarray, shape (N, 4)
            Between 0 and 1: two for the lamp, two for what scatters its light.
        """
        scene, axis = self._scene, unit(-light_mm)
        strength, lamp = scene.lamp_intensity, np.broadcast_to(light_mm, (len(u), 3))
        if scene.lamp_cosine:
            # A disc's irradiance falls short of a point's by the second part: it is made up for.
            strength += scene.lamp_radius_mm**2
            lamp = light_mm + scene.lamp_radius_mm * to_disc(u[:, :2], axis)

        def shines(directions: Array) -> Array:
            cosine = np.maximum(directions @ axis, 0.0) if scene.lamp_cosine else np.ones(len(directions))
            return strength * cosine

        if origin is Origin.LAMP:
            return Start(lamp, np.ones((len(u), CHANNELS)), lambda ways: shines(ways)[:, None])
        if origin is Origin.SAMPLE:
            return self._on_sample(lamp, shines, u[:, 2:])
        ways, per_steradian = _shone(u[:, 2:], axis, cosine=scene.lamp_cosine)
        return self._on_walls(lamp, ways, shines(ways) * per_steradian)

    def _on_sample(self, lamp_mm: Array, shines: Callable[[Array], Array], u: Array) -> Start:
        radius = self._scene.sample_radius_mm
        points = radius * to_disc(u, np.array([0.0, 0.0, 1.0]))
        way = lamp_mm - points
        distance = np.linalg.norm(way, axis=1)
        wi = way / distance[:, None]
        flux = np.pi * radius**2 * shines(-wi) * np.maximum(wi[:, 2], 0.0) / np.square(distance)
        flux[~self._obstacles.clear(points, wi, distance)] = 0.0
        return self._scattered(points, wi, np.tile(flux[:, None], CHANNELS))

    def from_photons(self, photons: Photons, u: Array) -> Start:
        """Return starts of photons that the sample scatters once more.

        Parameters
        ----------
        photons : Photons
            On the sample; not none.
        u : ndarray, shape (N,)
            Between 0 and 1; picks them.
        """
        which = np.minimum((u * len(photons)).astype(np.intp), len(photons) - 1)
        points = np.column_stack([photons.places_mm[which], np.zeros(len(u))])
        return self._scattered(points, photons.wi[which], len(photons) * photons.power[which])

    def _scattered(self, points: Array, wi: Array, flux: Array) -> Start:
        """Return starts at points of the sample that light comes to from directions."""

        def sends(ways: Array) -> Array:
            found = np.zeros((len(ways), CHANNELS))
            above = (wi[:, 2] > 0.0) & (ways[:, 2] > 0.0)
            found[above] = self._reflectance(wi[above], ways[above]) * ways[above, 2:]
            return found

        return Start(points, flux, sends)

    def _on_walls(self, lamp_mm: Array, ways: Array, flux: Array) -> Start:
        housing, obstacles = self._scene.housing, self._obstacles
        assert housing is not None  # noqa: S101 - else there is no such start
        met, distance = obstacles.meet(lamp_mm, ways)
        walls = met == obstacles.names.index(HOUSING)
        points = lamp_mm + np.where(walls, distance, 0.0)[:, None] * ways
        # The wall that a point lies on is that of its largest coordinate.
        largest = np.argmax(np.abs(points), axis=1)
        normals = np.zeros_like(points)
        rows = np.arange(len(points))
        normals[rows, largest] = -np.sign(points[rows, largest])
        sent = np.where(walls, housing.albedo / np.pi * flux, 0.0)
        return Start(
            points,
            np.tile(sent[:, None], CHANNELS),
            lambda ways: np.maximum(np.sum(ways * normals, axis=1), 0.0)[:, None],
        )


def _shone(u: Array, axis: Array, *, cosine: bool) -> tuple[Array, Array]:
    """Directions (N, 3) from the lamp, and the solid angle that each stands for, over their number."""
    if cosine:
        across = to_disc(u, axis)
        height = np.sqrt(np.maximum(1.0 - np.sum(np.square(across), axis=1), 1e-30))
        return across + height[:, None] * axis, np.pi / height
    height, turn = 1.0 - 2.0 * u[:, 0], 2.0 * np.pi * u[:, 1]
    ring = np.sqrt(np.maximum(1.0 - height**2, 0.0))
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=-1), np.full(len(u), 4.0 * np.pi)


def to_disc(u: Array, axis: Array) -> Array:
    """Carry the unit square to the unit disc (N, 3) at right angles to an axis, areas kept."""
    radius, turn = np.sqrt(u[:, :1]), 2.0 * np.pi * u[:, 1:2]
    first = unit(np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis))
    second = np.cross(axis, first)
    return np.asarray(radius * np.cos(turn) * first + radius * np.sin(turn) * second)
