"""Photons: light on its way from the lamp over mirrors of any form to the sample, in portions.

A portion leaves the lamp, or the surface that scatters the lamp's light first, towards a place on a mirror;
Mitsuba tells what stands in its way, and what it meets from there, until it comes to the sample. The lamp
aims only at those parts of mirrors that throw its light on the sample: they are searched for beforehand
(Jensen 1996, "Global illumination using photon maps", section 2, projection maps). Portions are spread evenly
over lamp and mirrors by Sobol's sequence, not at random.

A photon on the sample may be scattered towards a mirror again. What it has met is known by its word (see
`simulator.light.paths`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from simulator.light.obstacles import Obstacles
from simulator.light.paths import LightPaths
from simulator.light.photon_starts import CHANNELS, Origin, Starts, first_words
from simulator.light.scene import Event, SphericalMirror

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from simulator.light.photon_starts import Start
    from simulator.light.scene import Scene

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MOST_MIRRORED, _MOST_SCATTERED = 16, 3
"""Mirrors in a row, and returns to the sample, after which a photon is given up."""
BEYOND = 1.25
"""Radius, in that of the sample, within which photons are kept: its edge needs what lies beyond."""
_FIRST_SIDE, _LAST_SIDE = 32, 512
"""Cells along each side of a mirror at first, and at most."""
_ENOUGH = 1024
"""Cells that are not divided further."""
_PILOTS = 1 << 14
"""Photons with which cells are tried."""
_DIMENSIONS = 6
"""Two each of the mirror, of the lamp, and of what scatters its light."""


@dataclass(frozen=True, eq=False)
class Photons:
    """Portions of light where they meet the sample's plane.

    Attributes
    ----------
    places_mm : ndarray, shape (N, 2)
        Up to `BEYOND` the sample's edge.
    wi : ndarray, shape (N, 3)
        Unit vectors to where they came from.
    power : ndarray, shape (N, 3)
        Irradiance times square millimetres.
    lost : float
        Power of those that were given up on their way.
    """

    places_mm: Array
    wi: Array
    power: Array
    lost: float

    def __len__(self) -> int:
        return len(self.places_mm)


@dataclass(frozen=True, eq=False)
class _Cells:
    """Parts of mirrors: the numbers (C,) of mirrors, columns and rows of a grid of `side` squared cells."""

    mirrors: Indices
    columns: Indices
    rows: Indices
    side: int

    @property
    def count(self) -> int:
        return len(self.mirrors)


class _Words:
    """What is asked about words, each once."""

    def __init__(self, paths: LightPaths) -> None:
        self._paths = paths
        self._known: dict[str, bool] = {}

    def wanted(self, word: str) -> bool:
        """Tell whether a whole path is asked for."""
        if word not in self._known:
            self._known[word] = word in self._paths
        return self._known[word]

    def go_on(self, word: str) -> bool:
        """Tell whether some path that begins so is asked for."""
        if word not in self._known:
            self._known[word] = bool(self._paths & LightPaths(f"{word}(D|S)*E"))
        return self._known[word]


class PhotonTracer:
    """Photons of one scene.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set.
    scene : Scene
        Its sample is flat and level.
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr of the sample.
    paths : LightPaths
        Those wanted; of them L (D? S+)+ D E are found.
    """

    def __init__(self, mi: Any, scene: Scene, reflectance: Reflectance, paths: LightPaths) -> None:
        self._scene = scene
        self._obstacles = Obstacles(mi, scene)
        self._starts = Starts(scene, reflectance, self._obstacles)
        self._letter = str(min(scene.events - {Event.MIRROR}))
        self._words = _Words(paths)
        self._reflectances = np.array([mirror.reflectance for mirror in scene.mirrors])
        self._mirrors = {f"mirror{number}": number for number in range(len(scene.mirrors))}

    def trace(self, light_mm: Array, count: int, seed: int) -> Photons:
        """Send photons.

        Parameters
        ----------
        light_mm : ndarray, shape (3,)
            The lamp.
        count : int
            How many are sent from each kind of start; a power of two.
        seed : int
            Of the scrambling.
        """
        found: list[Photons] = []
        again: dict[str, list[Photons]] = {}
        for origin, words in first_words(self._scene).items():
            for word in words:
                if self._words.go_on(f"L{word}S"):
                    cells, u = self._lit_cells(light_mm, origin), _sobol(count, seed)
                    start = self._starts.draw(origin, light_mm, u[:, 2:])
                    self._sort(f"L{word}", self._send(start, cells, u)[0], found, again)
        everywhere = self._everywhere()
        for _ in range(_MOST_SCATTERED):
            landed, again = again, {}
            for word, photons in landed.items():
                together = self._on_sample(_together(photons))
                if len(together):
                    u = _sobol(count, seed + 1)
                    start = self._starts.from_photons(together, u[:, 2])
                    self._sort(word, self._send(start, everywhere, u)[0], found, again)
        lost = sum(float(photons.power.sum()) for some in again.values() for photons in some)
        return _together([*found, _nothing(lost)])

    def _sort(
        self, word: str, arrived: Sequence[Photons], found: list[Photons], again: dict[str, list[Photons]]
    ) -> None:
        """Keep photons that are asked for, and those that go on, by what they have met."""
        for place, photons in enumerate(arrived):
            whole = f"{word}{'S' * (place + 1)}{self._letter}"
            if len(photons) and self._words.wanted(f"{whole}E"):
                found.append(photons)
            if len(photons) and self._words.go_on(f"{whole}S"):
                again.setdefault(whole, []).append(photons)

    def _on_sample(self, photons: Photons) -> Photons:
        kept = np.sum(np.square(photons.places_mm), axis=1) <= self._scene.sample_radius_mm**2
        return Photons(photons.places_mm[kept], photons.wi[kept], photons.power[kept], photons.lost)

    def _everywhere(self, side: int = 1) -> _Cells:
        """Return all mirrors, each cut into equal cells."""
        mirrors, columns, rows = np.indices((len(self._scene.mirrors), side, side))
        return _Cells(mirrors.ravel(), columns.ravel(), rows.ravel(), side)

    def _lit_cells(self, light_mm: Array, origin: Origin) -> _Cells:
        """Find the parts of mirrors that throw light on the sample, ever smaller ones."""
        if origin is not Origin.LAMP:
            # What is scattered may come from everywhere: no part of a mirror can be left out.
            return self._everywhere()
        cells = self._everywhere(_FIRST_SIDE)
        while True:
            u = _sobol(1 << max(_PILOTS, 8 * cells.count).bit_length(), 0)
            _, hit = self._send(self._starts.draw(origin, light_mm, u[:, 2:]), cells, u)
            cells = self._with_neighbours(cells, np.unique(hit))
            if cells.count == 0 or cells.count > _ENOUGH or cells.side == _LAST_SIDE:
                return cells
            cells = _divided(cells)

    def _with_neighbours(self, cells: _Cells, hit: Indices) -> _Cells:
        """Keep the cells that were hit, and those around them."""
        side = cells.side
        kept = np.zeros((len(self._scene.mirrors), side, side), dtype=bool)
        kept[cells.mirrors[hit], cells.columns[hit], cells.rows[hit]] = True
        around = kept.copy()
        for across in (-1, 0, 1):
            for up in (-1, 0, 1):
                # Round a spherical mirror rows close; elsewhere a cell too many does no harm.
                around |= np.roll(kept, (across, up), axis=(1, 2))
        mirrors, columns, rows = np.nonzero(around)
        return _Cells(mirrors, columns, rows, side)

    def _send(self, start: Start, cells: _Cells, u: Array) -> tuple[list[Photons], Indices]:
        """Send photons at cells; return those that arrive, by mirrors met, and the cell of each of all."""
        if cells.count == 0:
            return [], np.zeros(0, dtype=np.intp)
        scaled = u[:, 0] * cells.count
        number = np.minimum(scaled.astype(np.intp), cells.count - 1)
        targets, normals, areas = self._targets(cells, number, scaled - number, u[:, 1])
        way = targets - start.points
        distance = np.linalg.norm(way, axis=1)
        directions = way / distance[:, None]
        cosines = -np.sum(directions * normals, axis=1)
        factor = np.maximum(cosines, 0.0) * areas / np.square(distance) / len(u)
        power = start.flux * start.sends(directions) * factor[:, None]
        kept = np.flatnonzero(power.any(axis=1))
        kept = kept[self._obstacles.clear(start.points[kept], directions[kept], distance[kept])]
        photons, of = self._follow(
            targets[kept], normals[kept], directions[kept], power[kept], cells.mirrors[number[kept]]
        )
        return photons, number[kept][of]

    def _targets(self, cells: _Cells, number: Indices, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Places on cells, normals there, and the area that each photon stands for."""
        points, normals, areas = np.zeros((len(u), 3)), np.zeros((len(u), 3)), np.zeros(len(u))
        across, up = (cells.columns[number] + u) / cells.side, (cells.rows[number] + v) / cells.side
        for place, mirror in enumerate(self._scene.mirrors):
            here = cells.mirrors[number] == place
            points[here], normals[here] = mirror.at(across[here], up[here])
            areas[here] = mirror.area_mm2 * cells.count / cells.side**2
        return points, normals, areas

    def _follow(
        self,
        points: Array,
        normals: Array,
        directions: Array,
        power: Array,
        mirrors: Indices,
    ) -> tuple[list[Photons], Indices]:
        """Follow photons from the first mirror on; return those that arrive, and which of all they are."""
        which, found, ends = np.arange(len(points)), [], []
        for _ in range(MOST_MIRRORED):
            power = power * self._reflectances[mirrors][:, None]
            directions = directions - 2.0 * np.sum(directions * normals, axis=1, keepdims=True) * normals
            points = points + self._obstacles.off_mm * normals
            met, distance = self._obstacles.meet(points, directions)
            arrived = self._landed(points, directions, distance)
            at = points[arrived] - (points[arrived, 2:] / directions[arrived, 2:]) * directions[arrived]
            found.append(Photons(at[:, :2], -directions[arrived], power[arrived], 0.0))
            ends.append(which[arrived])
            kept, points, normals, mirrors = self._mirrored_again(points, directions, distance, met)
            which, directions, power = which[kept], directions[kept], power[kept]
            if len(which) == 0:
                break
        # What still goes from mirror to mirror may yet arrive.
        found[-1] = replace(found[-1], lost=float(power.sum()))
        return found, np.concatenate(ends)

    def _landed(self, points: Array, directions: Array, distance: Array) -> Indices:
        """Return which rays meet the sample's plane, from above, before they meet anything else."""
        reach = BEYOND * self._scene.sample_radius_mm
        down = np.flatnonzero((directions[:, 2] < 0.0) & (points[:, 2] > 0.0))
        way = -points[down, 2] / directions[down, 2]
        at = points[down, :2] + way[:, None] * directions[down, :2]
        near = np.sum(np.square(at), axis=1) <= reach**2
        return np.asarray(down[near & (way < distance[down] + 10.0 * self._obstacles.off_mm)])

    def _mirrored_again(
        self, points: Array, directions: Array, distance: Array, met: Indices
    ) -> tuple[Indices, Array, Array, Indices]:
        """Return which photons meet a mirror's bright side, where, its normals there, and its number."""
        numbers = np.array([self._mirrors.get(name, -1) for name in (*self._obstacles.names, "")])[met]
        at, normals = np.zeros_like(points), np.zeros_like(points)
        for number, mirror in enumerate(self._scene.mirrors):
            here = np.flatnonzero(numbers == number)
            at[here] = points[here] + distance[here, None] * directions[here]
            if isinstance(mirror, SphericalMirror):
                normals[here] = mirror.normals_at(at[here])
                # Facets lie off the sphere.
                at[here] = mirror.centre_mm - mirror.radius_mm * normals[here]
            else:
                normals[here] = mirror.normal
        kept = np.flatnonzero((numbers >= 0) & (np.sum(directions * normals, axis=1) < 0.0))
        return kept, at[kept], normals[kept], numbers[kept]


def _divided(cells: _Cells) -> _Cells:
    """Cut each cell into four."""
    across, up = (index.ravel() for index in np.indices((2, 2)))
    return _Cells(
        np.repeat(cells.mirrors, 4),
        (2 * cells.columns[:, None] + across).ravel(),
        (2 * cells.rows[:, None] + up).ravel(),
        2 * cells.side,
    )


def _sobol(count: int, seed: int) -> Array:
    return np.asarray(qmc.Sobol(_DIMENSIONS, rng=np.random.default_rng(seed)).random(count))


def _nothing(lost: float) -> Photons:
    return Photons(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, CHANNELS)), lost)


def _together(found: Sequence[Photons]) -> Photons:
    found = [*found, _nothing(0.0)]
    return Photons(
        np.concatenate([photons.places_mm for photons in found]),
        np.concatenate([photons.wi for photons in found]),
        np.concatenate([photons.power for photons in found]),
        sum(photons.lost for photons in found),
    )
