"""Light on the walls of a housing: by the lamp, by the sample, and from wall to wall.

The walls light each other as patches do whose radiosity is even (Goral, Torrance, Greenberg and Battaile
1984, "Modeling the interaction of light between diffuse surfaces"): the matrix of that is solved once for a
rig (`simulator.light.walls`). Seen from the walls the sample is small: it hides from each patch a part of the
one opposite, and what it receives from the walls and gives back to them it spreads evenly, as much of it as
its f_r reflects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from simulator.light.hemisphere import hemisphere
from simulator.light.scene import Event
from simulator.light.walls import WallRule, Walls
from simulator.light.ways import crosses_disc

if TYPE_CHECKING:
    from collections.abc import Callable

    from simulator.light.paths import LightPaths
    from simulator.light.scene import Scene
    from simulator.light.walls import Indices

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]

SIDE_PATCHES = 8
"""Patches along each side of a wall; what half as many give tells the error."""


@dataclass(frozen=True)
class Wanted:
    """Which of a housing's paths are summed up, by the events before the sample's last.

    Attributes
    ----------
    once : bool
        The lamp on the walls.
    twice : bool
        From walls to walls.
    sample_first : bool
        The sample on the walls.
    longer : bool
        All with more events.
    """

    once: bool
    twice: bool
    sample_first: bool
    longer: bool

    @property
    def mostly_lamp(self) -> bool:
        """Whether light that the sample throws on the walls is little of it."""
        return self.once or self.twice

    @classmethod
    def of(cls, scene: Scene, paths: LightPaths) -> Wanted:
        """Read it off a set of paths."""
        last = _scatters(scene)
        return cls(
            once=f"LDl{last}E" in paths,
            twice=f"LDlDl{last}E" in paths,
            sample_first=f"L{last}Dl{last}E" in paths,
            longer=bool(paths.with_events(4)),
        )


class WallLight:
    """Light on the walls of one scene.

    Parameters
    ----------
    scene : Scene
        With a housing.
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr of the sample.
    paths : LightPaths
        What is asked for; a union of the scene's classes.

    Attributes
    ----------
    walls : Walls
    wanted : Wanted
    """

    def __init__(self, scene: Scene, reflectance: Reflectance, paths: LightPaths) -> None:
        if scene.housing is None:
            raise ValueError("radiosity needs a housing")
        self._scene, self._reflectance, self.wanted = scene, reflectance, Wanted.of(scene, paths)
        self._albedo, half_mm = scene.housing.albedo, scene.housing.half_size_mm
        self.walls = Walls(half_mm, SIDE_PATCHES)
        self._sample_area = np.pi * scene.sample_radius_mm**2
        self._patches = self._fine_and_coarse(_hemispherical_albedo(reflectance))

    def _fine_and_coarse(self, sample_albedo: Array) -> tuple[_Patches, _Patches]:
        """Solve all patches, and a quarter of them."""
        walls = self.walls
        distance = np.linalg.norm(walls.centres, axis=1)
        here = -np.sum(walls.centres * walls.normals, axis=1)
        seen = walls.centres[:, 2] * here / distance**4
        shares = walls.form_factors()
        # The sample, at the middle of the cube, hides from each patch a part of the one opposite.
        shares[np.arange(len(walls)), walls.opposite()] -= self._sample_area / np.pi * np.abs(seen)
        parents, seen = walls.coarser(), np.maximum(seen, 0.0)
        given_back = sample_albedo / np.pi**2 * self._albedo * self._sample_area * walls.patch_area
        area = len(walls) / (int(parents.max()) + 1)
        return (
            _Patches(np.arange(len(walls)), self._albedo * shares, seen, given_back),
            _Patches(
                parents,
                self._albedo * _aggregated(shares, parents),
                _means(seen, parents),
                given_back * area,
            ),
        )

    def leaving(self, lamp: Array, sample: Array, repeated: Array) -> Array:
        """Radiance (2, N, 3) of places on the walls, of the paths that are wanted."""
        first = self.wanted.once * lamp[:, None] + self.wanted.sample_first * sample
        return self._albedo / np.pi * (first + repeated)

    def repeated(self, rule: WallRule, lamp: Array, sample: Array) -> Array:
        """Irradiance (2, P, 3) of the patches by other walls, with all patches and a quarter of them.

        Parameters
        ----------
        rule : WallRule
            Nodes on the walls.
        lamp : ndarray, shape (N,)
            As `by_lamp` gives it for them.
        sample : ndarray, shape (N, 3)
            As `by_sample` does.
        """
        lamp, sample = self._patch_means(rule, lamp), self._patch_means(rule, sample)
        return np.stack([patches.repeated(lamp, sample, self.wanted) for patches in self._patches])

    def _patch_means(self, rule: WallRule, values: Array) -> Array:
        total = np.zeros((len(self.walls), *values.shape[1:]))
        np.add.at(total, rule.patches, (values.T * rule.areas).T)
        return total / self.walls.patch_area

    def from_lamp(self, lamp_mm: Array) -> Array:
        """Radiance (P,) of the patches as their middles tell, without what the sample throws on them."""
        walls, every = self.walls, np.arange(len(self.walls))
        middles = WallRule(walls.centres, walls.normals, np.full(len(every), walls.patch_area), every)
        first = self.by_lamp(lamp_mm, middles)
        return self._albedo / np.pi * self._patches[0].from_lamp(first, self.wanted)

    def by_lamp(self, lamp_mm: Array, places: WallRule) -> Array:
        """Irradiance (N,) of places on the walls by the lamp."""
        scene, way = self._scene, places.points - lamp_mm
        distance = np.linalg.norm(way, axis=1)
        strength = np.full(len(way), scene.lamp_intensity)
        if scene.lamp_cosine:
            # A disc's irradiance falls short of a point's by this factor: it is made up for.
            strength = (strength + scene.lamp_radius_mm**2) * np.maximum(way @ unit(-lamp_mm) / distance, 0.0)
        clear = ~crosses_disc(np.broadcast_to(lamp_mm, way.shape), places.points, scene.sample_radius_mm)
        cosine = np.maximum(-np.sum(way * places.normals, axis=1), 0.0) / distance
        return np.asarray(clear * strength * cosine / distance**2)

    def by_sample(self, lamp_mm: Array, places: WallRule) -> Array:
        """Irradiance (N, 3) of places on the walls by the sample, which the lamp lights."""
        found = np.zeros((len(places.points), 3))
        asked = self.wanted.sample_first or self.wanted.longer
        if not asked or lamp_mm[2] <= 0.0:
            return found
        above = places.points[:, 2] > 0.0
        way, wi = places.points[above], unit(lamp_mm)
        distance = np.linalg.norm(way, axis=1)
        out = way / distance[:, None]
        f = self._reflectance(np.broadcast_to(wi, out.shape), out)
        there = -np.sum(out * places.normals[above], axis=1)
        found[above] = f * (wi[2] * self._sample_area * out[:, 2] * there / distance**2)[:, None]
        return found


class _Patches:
    """Patches whose light from wall to wall is solved.

    Parameters
    ----------
    parents : ndarray of int, shape (P,)
        Which of these each of the finest patches lies in.
    exchange : ndarray, shape (M, M)
        Irradiance of each by the irradiance of each other one.
    seen : ndarray, shape (M,)
        How well the sample sees each.
    given_back : ndarray, shape (3,)
        What the sample makes of what it sees.
    """

    def __init__(self, parents: Indices, exchange: Array, seen: Array, given_back: Array) -> None:
        self._parents, self._exchange, self._seen, self._given_back = parents, exchange, seen, given_back
        self._solved = np.linalg.inv(np.eye(len(exchange)) - exchange)
        self._solved_seen = self._solved @ seen

    def repeated(self, lamp: Array, sample: Array, wanted: Wanted) -> Array:
        """Irradiance (P, 3) by other walls.

        Parameters
        ----------
        lamp : ndarray, shape (P,)
            Of the finest patches by the lamp.
        sample : ndarray, shape (P, 3)
            And by the sample.
        wanted : Wanted
            Which of it.
        """
        first = _means(lamp, self._parents)[:, None] * np.ones(3)
        found = np.zeros_like(first)
        if wanted.longer:
            given = _means(sample, self._parents)
            total = self._solved @ (first + given)
            back = self._given_back * (self._seen @ total)
            found = total + self._solved_seen[:, None] * back - first - given
        if wanted.twice != wanted.longer:
            twice = (self._exchange @ first[:, 0])[:, None]
            found = found + twice if wanted.twice else found - twice
        return np.asarray(found[self._parents])

    def from_lamp(self, first: Array, wanted: Wanted) -> Array:
        """Irradiance (M,) by the lamp (M,), and by other walls that it lights."""
        again = self._exchange @ first
        found = wanted.once * first + wanted.twice * again
        return found + (self._solved @ first - first - again) if wanted.longer else found


def _aggregated(shares: Array, parents: Indices) -> Array:
    """Form factors between patches that are groups of equal ones."""
    of = np.equal.outer(np.arange(int(parents.max()) + 1), parents).astype(np.float64)
    return np.asarray(of @ shares @ of.T / of.sum(axis=1, keepdims=True))


def _means(values: Array, parents: Indices) -> Array:
    counts = np.bincount(parents)
    total = np.zeros((len(counts), *values.shape[1:]))
    np.add.at(total, parents, values)
    return np.asarray((total.T / counts).T)


def _hemispherical_albedo(reflectance: Reflectance) -> Array:
    """Share (3,) of even light from the whole hemisphere that is reflected."""
    s, ds = np.polynomial.legendre.leggauss(4)
    sine = np.sqrt(0.5 * (1.0 + s))
    found = [hemisphere(reflectance, np.array([x, 0.0, np.sqrt(1.0 - x * x)])) for x in sine]
    return np.asarray(0.5 * ds @ np.stack([np.pi * half.least + half.rest for half in found]))


def _scatters(scene: Scene) -> str:
    """Return the letter of the sample's part that scatters; none for one that does not."""
    return next((event.value for event in sorted(scene.events) if event is not Event.MIRROR), "")
