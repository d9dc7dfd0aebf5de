"""Light over a Lambertian housing: L D* Dl D E by radiosity, without noise.

The housing's walls light each other as patches do whose radiosity is even (Goral, Torrance, Greenberg and
Battaile 1984, "Modeling the interaction of light between diffuse surfaces"): the matrix of that is solved
once for a rig (`simulator.light.walls`). A pose lights the walls by the lamp, exactly at every node of a
quadrature rule, in the shadow of the sample, and by the sample, which throws the lamp's light on them as its
f_r does. The last step gathers, at a few points of the sample, the walls' radiance with f_r: near the
mirror direction, where a lobe may be narrow, with nodes in rings about that direction, elsewhere with the
nodes on the walls; a smooth weight divides the hemisphere between the two. Over the sample the light is
smooth, and is interpolated by polynomials. Everything is refined until the picture changes by less than the
tolerance.

Seen from the walls the sample is small: it hides from each patch a part of the one opposite, and what it
receives from the walls and gives back to them it spreads evenly, as much of it as its f_r reflects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.classes import light_paths
from simulator.light.costs import value_s
from simulator.light.evaluator import Evaluator, Method, Rendering
from simulator.light.hemisphere import hemisphere
from simulator.light.paths import LightPaths
from simulator.light.reflectance import material_reflectance
from simulator.light.scene import Event
from simulator.light.virtual_lights import crosses_disc
from simulator.light.walls import Walls

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from simulator.light.scene import Scene
    from simulator.light.walls import Indices, WallRule

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]

SIDE_PATCHES = 8
"""Patches along each side of a wall; what half as many give tells the error."""
_LOBE_RAD = (0.15, 0.75)
"""Angles from the mirror direction up to which, and from which on, nodes are in rings, and on walls."""
_NARROWEST_RAD = 1e-4
_SECONDS_PER_NODE, _POSE_S = 3e-7, 2e-3
"""Time of a node besides that of its f_r, and of a pose."""


class Level(NamedTuple):
    """How fine a pose is computed.

    Attributes
    ----------
    wall : int
        Nodes along each side of a patch.
    rings, turns : int
        Nodes about the mirror direction.
    points : int
        Points of the sample along each of its axes.
    """

    wall: int
    rings: int
    turns: int
    points: int


LEVELS = (
    Level(2, 12, 16, 3),
    Level(3, 18, 24, 4),
    Level(4, 28, 36, 5),
    Level(6, 40, 56, 7),
    Level(8, 60, 80, 9),
)


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
        if scene.housing is None:
            raise ValueError("radiosity needs a housing")
        self._scene, self._reflectance, self._wanted = scene, reflectance, Wanted.of(scene, paths)
        self._glossy = Event.GLOSSY in scene.events
        self._albedo, half_mm = scene.housing.albedo, scene.housing.half_size_mm
        self._kinematics = Kinematics(scene.rig)
        self.walls = Walls(half_mm, SIDE_PATCHES)
        self._sample_area = np.pi * scene.sample_radius_mm**2
        self._parents = self.walls.coarser()
        distance = np.linalg.norm(self.walls.centres, axis=1)
        here = -np.sum(self.walls.centres * self.walls.normals, axis=1)
        seen = self.walls.centres[:, 2] * here / distance**4
        self._seen_by_sample = np.maximum(seen, 0.0)
        fine = self.walls.form_factors()
        # The sample, at the middle of the cube, hides from each patch a part of the one opposite.
        fine[np.arange(len(self.walls)), self.walls.opposite()] -= self._sample_area / np.pi * np.abs(seen)
        coarse = _aggregated(fine, self._parents)
        self._exchanges = tuple(self._albedo * shares for shares in (fine, coarse))
        self._solved = tuple(np.linalg.inv(np.eye(len(k)) - k) for k in self._exchanges)
        self._sample_albedo = _hemispherical_albedo(reflectance)

    def render(self, angles_rad: Sequence[float], tolerance: float) -> Rendering:
        """Compute the radiance of a pose; see `Evaluator`."""
        rig, angles = self._scene.rig, np.asarray(angles_rad, dtype=np.float64)
        pixels = pixel_geometry(rig, angles)
        radiance = np.zeros((*pixels.on_sample.shape, 3))
        if not pixels.on_sample.any():
            return Rendering(radiance, 0.0, "the camera does not see the sample")
        positions, frames = pixels.position_mm[pixels.on_sample], self._kinematics.frames(angles)
        fine, error = self.picture(frames.light_mm, frames.camera_mm, positions, LEVELS[0])[0], np.inf
        for used in LEVELS[1:]:
            coarse = fine
            fine, other = self.picture(frames.light_mm, frames.camera_mm, positions, used)
            # Patches are of second order: of those twice as large, a third of the difference is left.
            error = _rms(fine, coarse) + _rms(fine, other) / 3.0
            if error <= tolerance:
                break
        radiance[pixels.on_sample] = fine
        did = (
            f"{len(self.walls)} patches, {used.wall}^2 nodes on each, {used.rings} x {used.turns} about "
            f"the mirror direction, at {used.points}^2 points"
        )
        return Rendering(radiance, error, did)

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
        across, up = (_interpolation(nodes, inside[:, axis]) for axis in (0, 1))
        fine, coarse = (
            np.einsum("ni,nic->nc", up, np.tensordot(across, g.reshape(len(nodes), len(nodes), 3), axes=1))
            for g in gathered
        )
        return fine, coarse

    def _gather(self, lamp_mm: Array, points: Array, wo: Array, level: Level) -> Array:
        """Radiance (2, K, 3) of points of the sample: with all patches and with a quarter of them."""
        rule = self.walls.rule(lamp_mm, level.wall)
        lamp, sample = self._lit_by_lamp(lamp_mm, rule), self._lit_by_sample(lamp_mm, rule)
        repeated = self._repeated(self._patch_means(rule, lamp), self._patch_means(rule, sample))
        above = rule.points[:, 2] > 0.0
        leaving = self._leaving(lamp[above], sample[above], repeated[:, rule.patches[above]])
        way = rule.points[above] - points[:, None]
        squared = np.sum(np.square(way), axis=-1)
        wi = way / np.sqrt(squared)[..., None]
        there = -np.einsum("knj,nj->kn", wi, rule.normals[above])
        weights = wi[..., 2] * there * rule.areas[above] / squared
        if self._glossy:
            weights *= 1.0 - _in_rings(wi, wo)
        kept = self._reflected(wi, wo) * weights[..., None]
        radiance = np.einsum("knc,snc->skc", kept, leaving)
        if self._glossy:
            radiance += self._gather_lobe(lamp_mm, points, wo, level, repeated)
        return np.asarray(radiance)

    def _gather_lobe(self, lamp_mm: Array, points: Array, wo: Array, level: Level, repeated: Array) -> Array:
        """Light from about the mirror direction, (2, K, 3)."""
        ring, solid_angle = _rings(level)
        mirror = wo * [-1.0, -1.0, 1.0]
        across = unit(np.cross(np.eye(3)[np.argmin(np.abs(mirror), axis=1)], mirror))
        wi = np.einsum("nj,kjc->knc", ring, np.stack([across, np.cross(mirror, across), mirror], axis=1))
        weights = solid_angle * np.maximum(wi[..., 2], 0.0) * _in_rings(wi, wo)
        above = wi[..., 2] > 0.0
        hit = self.walls.hit(np.broadcast_to(points[:, None], wi.shape)[above], wi[above])
        lamp, sample = self._lit_by_lamp(lamp_mm, hit), self._lit_by_sample(lamp_mm, hit)
        leaving = np.zeros((2, *wi.shape))
        leaving[:, above] = self._leaving(lamp, sample, repeated[:, hit.patches])
        kept = self._reflected(wi, wo) * weights[..., None]
        return np.asarray(np.einsum("knc,sknc->skc", kept, leaving))

    def _reflected(self, wi: Array, wo: Array) -> Array:
        """f_r (K, N, 3), zero below the horizon."""
        f = np.zeros(wi.shape)
        above = wi[..., 2] > 0.0
        f[above] = self._reflectance(wi[above], np.broadcast_to(wo[:, None], wi.shape)[above])
        return f

    def _leaving(self, lamp: Array, sample: Array, repeated: Array) -> Array:
        """Radiance (2, N, 3) of places on the walls, of the paths that are wanted."""
        first = self._wanted.once * lamp[:, None] + self._wanted.sample_first * sample
        return self._albedo / np.pi * (first + repeated)

    def _repeated(self, lamp: Array, sample: Array) -> Array:
        """Irradiance (2, P, 3) of the patches by other walls, with all patches and a quarter of them."""
        found = []
        for exchange, solved, parents in zip(
            self._exchanges, self._solved, (np.arange(len(lamp)), self._parents), strict=True
        ):
            first, given, seen = (
                _means(values, parents)
                for values in (lamp[:, None] * np.ones(3), sample, self._seen_by_sample)
            )
            twice = exchange @ first
            total = solved @ (first + given)
            area = self._sample_area * self.walls.patch_area * len(lamp) / len(first)
            back = self._sample_albedo / np.pi**2 * self._albedo * area * (seen @ total)
            longer = total + solved @ (seen[:, None] * back) - first - given - twice
            found.append((self._wanted.twice * twice + self._wanted.longer * longer)[parents])
        return np.stack(found)

    def _patch_means(self, rule: WallRule, values: Array) -> Array:
        total = np.zeros((len(self.walls), *values.shape[1:]))
        np.add.at(total, rule.patches, (values.T * rule.areas).T)
        return total / self.walls.patch_area

    def _lit_by_lamp(self, lamp_mm: Array, places: WallRule) -> Array:
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

    def _lit_by_sample(self, lamp_mm: Array, places: WallRule) -> Array:
        """Irradiance (N, 3) of places on the walls by the sample, which the lamp lights."""
        found = np.zeros((len(places.points), 3))
        asked = self._wanted.sample_first or self._wanted.longer
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


def _rings(level: Level) -> tuple[Array, Array]:
    """Directions (N, 3) about +z, dense at it, and their solid angles (N,)."""
    s, ds = np.polynomial.legendre.leggauss(level.rings)
    length = np.log(_LOBE_RAD[1] / _NARROWEST_RAD)
    gamma = _NARROWEST_RAD * np.exp(0.5 * (s + 1.0) * length)
    share = 0.5 * ds * length * gamma * np.sin(gamma) * 2.0 * np.pi / level.turns
    phi = 2.0 * np.pi * (np.arange(level.turns) + 0.5) / level.turns
    g, p = (axis.ravel() for axis in np.meshgrid(gamma, phi, indexing="ij"))
    return np.stack([np.sin(g) * np.cos(p), np.sin(g) * np.sin(p), np.cos(g)], axis=-1), np.repeat(
        share, level.turns
    )


def _in_rings(wi: Array, wo: Array) -> Array:
    """Smooth share (K, N) of a direction that is left to the nodes about the mirror direction."""
    mirror = wo * [-1.0, -1.0, 1.0]
    chord = np.linalg.norm(wi - mirror[:, None], axis=-1)
    gamma = 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))
    t = np.clip((gamma - _LOBE_RAD[0]) / (_LOBE_RAD[1] - _LOBE_RAD[0]), 0.0, 1.0)
    return np.asarray(1.0 - t**3 * (10.0 - 15.0 * t + 6.0 * t * t))


def _interpolation(nodes: Array, places: Array) -> Array:
    """Matrix (N, K) that takes values at Chebyshev nodes (K,) to places between -1 and 1."""
    degree = len(nodes) - 1
    basis, at = (np.polynomial.chebyshev.chebvander(x, degree) for x in (nodes, places))
    return np.asarray(at @ np.linalg.inv(basis))


def _rms(fine: Array, coarse: Array) -> float:
    mean = float(fine.mean())
    return float(np.sqrt(np.mean(np.square(fine - coarse)))) / mean if mean > 0.0 else 0.0


def _scatters(scene: Scene) -> str:
    """Return the letter of the sample's part that scatters; none for one that does not."""
    return next((event.value for event in sorted(scene.events) if event is not Event.MIRROR), "")


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
        levels = LEVELS[: 2 if tolerance >= 3e-3 else 3 if tolerance >= 5e-4 else len(LEVELS)]
        glossy = Event.GLOSSY in scene.events
        nodes = sum(
            level.points**2 * (3 * (SIDE_PATCHES * level.wall) ** 2 + glossy * level.rings * level.turns)
            for level in levels
        )
        asked = value_s(scene.material, vector=vector) if glossy else 0.0
        return _POSE_S + nodes * (_SECONDS_PER_NODE + asked)

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> Radiosity:
        """Set it to work; see `Method`."""
        return Radiosity(scene, material_reflectance(mi, scene.material), paths)
