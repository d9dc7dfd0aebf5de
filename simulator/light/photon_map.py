"""Light that mirrors of any form throw on the sample, from a map of photons: caustics, L (D? S+)+ D E.

The radiance of a point is the light of the k photons nearest to it, over the area of the disc that reaches to
the k-th (Jensen 1996, "Global illumination using photon maps", eq. 8). Each photon carries the radiance that
it makes where it lies, towards a point of the pupil, so that the disc blurs the picture and nothing else.

A small k is noisy, a large one blurs. Photons come in two halves, drawn independently: what the halves
differ by is noise, and what k photons change, in both, from what k/4 tell is blur. Of a smooth picture blur
grows as k, and is 4/3 of that; of an edge it grows, RMS, as k^(1/4), and is twice that: 5/2 is taken. k is
chosen where both together are least, and photons are added until they are within the tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import cKDTree

from rig.angles import unit
from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator.light.costs import value_s
from simulator.light.evaluator import Evaluator, Method, Rendering
from simulator.light.paths import LightPaths
from simulator.light.photon_starts import to_disc
from simulator.light.photons import BEYOND, PhotonTracer
from simulator.light.reflectance import material_reflectance
from simulator.light.scene import Event
from simulator.sensor import derived_seed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rig.kinematics import Frames
    from rig.pixels import PixelGeometry
    from simulator.light.photons import Photons
    from simulator.light.scene import Scene

    Reflectance = Callable[["Array", "Array"], "Array"]

Array = NDArray[np.float64]

_COUNTS = tuple(1 << power for power in range(13, 20, 2))
"""Photons sent in each half from each kind of start, until the error is within the tolerance."""
NEAREST = tuple(1 << power for power in range(2, 13))
"""Numbers of photons to choose from."""
_QUARTER = 2
"""Places in `NEAREST` from a number to its quarter."""
_LEFT_OF_BLUR = 2.5
"""Largest blur of k photons over what it differs by from that of k/4."""
_LOOKED_AT = 500
"""Pixels at which k is chosen, about."""
_AT_ONCE = (64, 512, 4096)
"""Largest k that are tried one after the other, as long as more is better."""
_DISCS = 10
"""Fewest discs that all photons must fill."""
_WIDEST = 3.0
"""Largest radius of a disc, in the median of those about photons."""
_PER_DISC = 8
"""Pixels asked for along a disc's radius: the picture between them is smooth."""
_TOGETHER = 1 << 21
"""Pairs of a pixel and a photon held at once."""
_PHOTON_S, _SCALAR_PHOTON_S, _PIXEL_S, _SEARCH_S = 4e-6, 6e-5, 5e-5, 0.3
"""Time of a photon, vectorised or not, of a pixel, and of the search for lit parts of mirrors."""
_SCATTERED = 50
"""Photons of scattered light over those of the lamp's, for the same error: nearly all go elsewhere."""
_ERROR_OF_ONE, _ORDER = 0.7, 2.5
"""Error of one photon, and the power of the error with which their number falls."""


@dataclass(frozen=True, eq=False)
class _Half:
    """One half of the photons.

    Attributes
    ----------
    photons : Photons
    tree : cKDTree
        Of their places.
    """

    photons: Photons
    tree: Any

    @classmethod
    def of(cls, photons: Photons) -> _Half:
        return cls(photons, cKDTree(photons.places_mm))

    def __len__(self) -> int:
        return len(self.photons)

    def reach_mm(self, places_mm: Array, nearest: int) -> Array:
        """Radii (M,) of the discs of so many photons about M places."""
        return np.asarray(self.tree.query(places_mm, k=[nearest])[0][:, 0])

    def radiance(self, places_mm: Array, values: Array, nearest: Sequence[int]) -> Array:
        """Radiance (K, M, 3) of M places by so many photons each.

        Parameters
        ----------
        places_mm : ndarray, shape (M, 2)
        values : ndarray, shape (N, 3)
            Radiance times area of each photon.
        nearest : sequence of int
            Ascending; K numbers, each up to that of all photons.
        """
        found = np.zeros((len(nearest), len(places_mm), values.shape[1]))
        # In the dark, discs do not reach for the light: those about photons tell how far is far.
        widest = _WIDEST * float(np.median(self.reach_mm(_some(self.photons.places_mm), nearest[-1])))
        values = np.vstack([values, np.zeros((1, values.shape[1]))])
        step = max(1, _TOGETHER // nearest[-1])
        for first in range(0, len(places_mm), step):
            some = slice(first, first + step)
            distance, which = self.tree.query(
                places_mm[some], k=nearest[-1], distance_upper_bound=max(widest, 1e-12)
            )
            total = np.cumsum(values[which], axis=1)
            for place, count in enumerate(nearest):
                most = widest * np.sqrt(count / nearest[-1])
                reach = distance[:, count - 1]
                # The last photon only says how far the disc reaches: counted, it would be one too many.
                inside = np.minimum(np.sum(distance[:, :count] <= most, axis=1), count - 1)
                light = np.where(inside[:, None] > 0, total[np.arange(len(total)), inside - 1], 0.0)
                found[place, some] = light / (np.pi * np.square(np.clip(reach, 1e-12, most)))[:, None]
        return found


class PhotonMap(Evaluator):
    """Light of one scene's mirrors on its sample.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set.
    scene : Scene
        Its sample is flat and level.
    reflectance : callable
        (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in 1/sr of the sample.
    paths : LightPaths
        What is asked for; a part of L (D? S+)+ D E.
    """

    def __init__(self, mi: Any, scene: Scene, reflectance: Reflectance, paths: LightPaths) -> None:
        self._scene, self._reflectance = scene, reflectance
        self._kinematics = Kinematics(scene.rig)
        self._tracer = PhotonTracer(mi, scene, reflectance, paths)
        self._held: tuple[tuple[float, ...], tuple[_Half, _Half]] | None = None

    def render(self, angles_rad: Sequence[float], tolerance: float) -> Rendering:
        """Compute the radiance of a pose; see `Evaluator.render`."""
        frames = self._kinematics.frames(np.asarray(angles_rad))
        pixels = pixel_geometry(self._scene.rig, angles_rad)
        radiance = np.zeros((*pixels.on_sample.shape, 3))
        places = pixels.position_mm[pixels.on_sample]
        looked_at = _some(places)
        for count in _COUNTS:
            halves = self._halves(frames.light_mm, count)
            landed = sum(len(half) for half in halves)
            if landed == 0 or len(places) == 0:
                return Rendering(radiance, 0.0, "no photon arrives")
            values = [self._values(half, frames) for half in halves]
            nearest, error = _best(halves, values, looked_at)
            if error <= tolerance:
                break
        if nearest:
            radiance = self._picture(angles_rad, halves, values, nearest)
            radiance[~pixels.on_sample] = 0.0
        did = f"{landed} of {len(halves) * count} photons arrived, the {nearest} nearest of each half"
        return Rendering(radiance, error, did)

    def _picture(
        self, angles_rad: Sequence[float], halves: Sequence[_Half], values: Sequence[Array], nearest: int
    ) -> Array:
        """Radiance (H, W, 3) of all pixels; what lies between pixels asked for is interpolated."""
        camera = self._scene.rig.camera
        middle = pixel_geometry(self._scene.rig, angles_rad)
        places = _some(middle.position_mm[middle.on_sample])
        reach = np.median([half.reach_mm(places, nearest) for half in halves])
        step = max(1, int(reach / _PER_DISC / _widest_pixel_mm(middle)))
        rows, cols = (
            np.unique(np.append(np.arange(0, n, step), n - 1)) for n in (camera.height_px, camera.width_px)
        )
        grid = pixel_geometry(self._scene.rig, angles_rad, rows=rows, cols=cols).position_mm
        near = np.linalg.norm(grid, axis=-1) <= BEYOND * self._scene.sample_radius_mm
        found = np.zeros((*near.shape, 3))
        for half, value in zip(halves, values, strict=True):
            found[near] += half.radiance(grid[near], value, [nearest])[0] / len(halves)
        if step == 1:
            return found
        between = RegularGridInterpolator((rows, cols), found)
        wanted = np.moveaxis(np.indices((camera.height_px, camera.width_px)), 0, -1)
        return np.asarray(between(wanted.astype(np.float64)))

    def _halves(self, light_mm: Array, count: int) -> tuple[_Half, _Half]:
        """Return photons of a lamp, those of last time if they are the same."""
        key = (*light_mm.tolist(), count)
        if self._held is None or self._held[0] != key:
            first, second = (
                _Half.of(self._tracer.trace(light_mm, count, derived_seed("photons", number)))
                for number in range(2)
            )
            self._held = key, (first, second)
        return self._held[1]

    def _values(self, half: _Half, frames: Frames) -> Array:
        """Radiance times area (N, 3) of each photon towards some point of the pupil."""
        photons = half.photons
        u = np.random.default_rng(derived_seed("pupil")).random((len(photons), 2))
        radius_mm = self._scene.rig.camera.aperture_diameter_mm / 2.0
        pupil = frames.camera_mm + radius_mm * to_disc(u, frames.camera_rotation[:, 2])
        wo = unit(pupil - np.column_stack([photons.places_mm, np.zeros(len(photons))]))
        values = np.zeros((len(photons), 3))
        seen = (photons.wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
        values[seen] = self._reflectance(photons.wi[seen], wo[seen]) * photons.power[seen]
        return values


def _best(halves: Sequence[_Half], values: Sequence[Array], places_mm: Array) -> tuple[int, float]:
    """Return how many nearest photons err least, and by how much; 0 and 1 where there are too few."""
    # Discs that are nearly the whole sample all err alike: there would be one difference to judge by.
    most = min(len(half) for half in halves) // _DISCS
    best, least = 0, 1.0
    for at_once in _AT_ONCE:
        nearest = [count for count in NEAREST if count <= min(most, at_once)]
        if len(nearest) <= _QUARTER:
            break
        errors = _errors(halves, values, places_mm, nearest)
        place = int(np.argmin(errors))
        best, least = nearest[place + _QUARTER], float(errors[place])
        if best < at_once:
            break
    lost = sum(half.photons.lost for half in halves) / sum(half.photons.power.sum() for half in halves)
    return best, least + float(lost)


def _errors(
    halves: Sequence[_Half], values: Sequence[Array], places_mm: Array, nearest: Sequence[int]
) -> Array:
    """Estimate the relative errors of so many nearest photons each, but for the first `_QUARTER`."""
    first, second = (
        half.radiance(places_mm, value, nearest) for half, value in zip(halves, values, strict=True)
    )
    noise = np.mean(np.square(first - second), axis=(1, 2))[_QUARTER:] / 4.0
    # What the halves agree on is no noise.
    change = (first[_QUARTER:] - first[:-_QUARTER]) * (second[_QUARTER:] - second[:-_QUARTER])
    blur = _LEFT_OF_BLUR**2 * np.maximum(np.mean(change, axis=(1, 2)), 0.0)
    level = 0.5 * (first + second)[_QUARTER:].mean(axis=(1, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(level > 0.0, np.sqrt(noise + blur) / level, 1.0)


def _some(places_mm: Array) -> Array:
    """Return some of the places, in no regular order, or all."""
    order = np.random.default_rng(derived_seed("looked at")).permutation(len(places_mm))
    return np.asarray(places_mm[order[:_LOOKED_AT]])


def _widest_pixel_mm(pixels: PixelGeometry) -> float:
    """Largest distance on the sample between neighbouring pixels."""
    across, up = (np.linalg.norm(np.diff(pixels.position_mm, axis=axis), axis=-1) for axis in (0, 1))
    on = pixels.on_sample
    widest = [
        np.max(steps, where=on[:-1] & on[1:] if axis == 0 else on[:, :-1] & on[:, 1:], initial=0.0)
        for axis, steps in enumerate((across, up))
    ]
    return max(float(max(widest)), 1e-12)


BOUNCED, _WALLS_FIRST = LightPaths("LS+DE"), LightPaths("LD?S+DE")


@lru_cache(maxsize=256)
def _scatters_before(paths: LightPaths) -> bool:
    """Tell whether light of some paths is scattered before it meets a mirror."""
    return bool(paths - BOUNCED)


class PhotonMapMethod(Method):
    """The row of `PhotonMap` in the table of methods."""

    name = "photon map"
    covers = LightPaths("L(D?S+)+DE")

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:  # noqa: ARG002
        """Say why it cannot compute the paths; see `Method`."""
        if not scene.mirrors:
            return "no mirror but the sample's own part"
        if Event.MIRROR in scene.events:
            return "it follows no light over the sample's own mirror-like part"
        if scene.housing is not None and not paths <= _WALLS_FIRST:
            return "it follows no light of mirrors on the walls"
        return None

    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:
        """Predict the time of one pose; see `Method`."""
        starts = 1 + _SCATTERED * _scatters_before(paths)
        # As many as it would need, though it stops before: what it cannot reach is not cheap.
        photons = 2.0 * starts * max(_COUNTS[0], (_ERROR_OF_ONE / tolerance) ** _ORDER)
        each = (_PHOTON_S if vector else _SCALAR_PHOTON_S) + value_s(scene.material, vector=vector)
        pixels = scene.rig.camera.width_px * scene.rig.camera.height_px
        return float(starts * _SEARCH_S + each * photons + _PIXEL_S * pixels)

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> PhotonMap:
        """Set it to work; see `Method`."""
        return PhotonMap(mi, scene, material_reflectance(mi, scene.material), paths)
