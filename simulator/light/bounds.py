"""Upper bounds of light on its way over the surroundings of a sample, surface by surface, many poses at once.

On the walls of a housing light is followed cell by cell (`simulator.light.cells`); in mirrors by the lamp's
image, and by the largest radiance that they can show. A bound may be far above the truth. It is below it only
where a lobe or the lamp's light on a wall is sharper than its nodes tell, for which there are margins: tests
hold bounds against converged light over scenes drawn at random.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from simulator.light.cells import Cells
from simulator.light.classes import HOUSING, SAMPLE
from simulator.light.lights import CHANNELS, Light, Lobe, Start
from simulator.light.scene import Event, PlanarMirror

if TYPE_CHECKING:
    from collections.abc import Sequence

    from simulator.light.classes import Walk
    from simulator.light.scene import Scene

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Surroundings:
    """What light can meet on its way to a sample and back.

    Parameters
    ----------
    scene : Scene
    albedo : ndarray, shape (C,)
        The sample's largest directional albedo.
    largest : ndarray, shape (C,)
        Its largest f_r times the cosine of one of the directions.
    """

    def __init__(self, scene: Scene, albedo: Array, largest: Array) -> None:
        self._scene, self.albedo, self._largest = scene, albedo, largest
        self._wall_albedo = scene.housing.albedo if scene.housing else 0.0
        # Without a housing no light asks the cells for anything; they still need a size.
        self._half_mm = scene.housing.half_size_mm if scene.housing else 10.0 * scene.sample_radius_mm
        self.cells = Cells(self._half_mm, scene.sample_radius_mm)
        self._area = np.pi * scene.sample_radius_mm**2
        # Beside curved mirrors nothing is bounded.
        self.mirrors = tuple(mirror for mirror in scene.mirrors if isinstance(mirror, PlanarMirror))
        origin = np.zeros((1, 3))
        nearest = min((float(_distance(mirror, origin)[0]) for mirror in self.mirrors), default=np.inf)
        self._to_mirror_mm = max(0.0, nearest - scene.sample_radius_mm)

    def along(self, walk: Walk, start: Start, known: dict[Walk, Light]) -> Light:
        """Follow the lamp's light over all surfaces of a walk.

        Parameters
        ----------
        walk : Walk
        start : Start
        known : dict of Walk to Light
            Of the same start: what walks have in common is followed once.
        """
        if not walk:
            return replace(Light.dark(len(start.lamp_mm)), lamp_mm=start.lamp_mm)
        if walk not in known:
            light, (node, event) = self.along(walk[:-1], start, known), walk[-1]
            if node == HOUSING:
                known[walk] = self._on_walls(light)
            elif event is Event.MIRROR:
                known[walk] = _in_mirror(light, None if node == SAMPLE else self.mirrors[int(node)])
            else:
                known[walk] = self._on_sample(light, start)
        return known[walk]

    def radiance_on_sample(self, light: Light) -> Array:
        """Largest radiance (P, C) that walls, or mirrors that show them, send to the sample."""
        most = light.most[:, self.cells.above] if light.by_cells else light.most
        return np.asarray(light.kept * self._wall_albedo / np.pi * most.max(axis=1))

    def by_walls(self, light: Light, lobe: Lobe) -> Array:
        """Radiance (P, C) of the sample lit by walls, or by mirrors that show them."""
        brightest = self.radiance_on_sample(light)
        if light.by_cells:
            irradiance = self.cells.on_sample(self._wall_albedo * light.walls)
            poses = np.arange(len(light.most))[:, None, None]
            seen = self._wall_albedo / np.pi * light.most[poses, lobe.cells]
            found = lobe.least * irradiance[:, None] + np.einsum("plnc,plnc->plc", lobe.weights, seen)
        else:
            found = (np.pi * lobe.least + lobe.rest) * brightest[:, None]
        if light.flux is not None:
            # All of the flux falls where the lobe is brightest, straight ahead, at the least distance.
            whole = lobe.largest * (self._wall_albedo / np.pi * light.flux / self._half_mm**2)[:, None]
            found = np.minimum(found, whole)
        return np.asarray(found.max(axis=1))

    def sample_on_itself(self, light: Light) -> Array:
        """Irradiance (P, C) of the sample by its own image in a mirror."""
        return light.kept * light.sample * self._solid_angle(2.0 * self._to_mirror_mm)

    def reaches(self, light: Light, places_mm: Array, around_mm: Array) -> Bools:
        """Tell which places of the sample may see the lamp's image in the last mirror.

        Where the way from a place to the image meets the mirror's plane is known within an interval along
        each side of the mirror's rectangle, for all of the lamp and of the place's surroundings.

        Parameters
        ----------
        light : Light
            Of the lamp, over mirrors alone.
        places_mm : ndarray, shape (P, N, 3)
        around_mm : ndarray, shape (P,)
            How far around a place counts as it.

        Returns
        -------
        ndarray of bool, shape (P, N)
        """
        image, mirror, radius = light.lamp_mm, light.mirror, self._scene.lamp_radius_mm
        if image is None:
            raise ValueError("light that was scattered comes from no lamp")
        if mirror is None:
            return np.ones(places_mm.shape[:2], dtype=bool)
        way, behind = places_mm - np.asarray(mirror.centre_mm), image - np.asarray(mirror.centre_mm)
        before_mm, behind_mm = way @ mirror.normal, -(behind @ mirror.normal)[:, None]
        least_mm, most_mm = np.maximum(before_mm - around_mm[:, None], 0.0), before_mm + around_mm[:, None]
        nearest_mm, farthest_mm = np.maximum(behind_mm - radius, 0.0), behind_mm + radius
        found = (most_mm > 0.0) & (farthest_mm > 0.0) & (image[:, 2:] + radius > 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            # Of the way from the place to the image, as far as the mirror.
            shares = least_mm / (least_mm + farthest_mm), most_mm / (most_mm + nearest_mm)
            for side in (np.asarray(mirror.across_mm), np.asarray(mirror.up_mm)):
                length = np.linalg.norm(side)
                here, there = way @ side / length**2, (behind @ side / length**2)[:, None]
                low, high = (
                    [
                        (1.0 - share) * (here + sign * around_mm[:, None] / length)
                        + share * (there + sign * radius / length)
                        for share in shares
                    ]
                    for sign in (-1.0, 1.0)
                )
                found &= (np.minimum(*low) <= 1.0) & (np.maximum(*high) >= -1.0)
        return np.asarray(found)

    def series(self, lights: Sequence[Light]) -> Light | None:
        """Sum lights and all that they become over any number of further surfaces.

        Parameters
        ----------
        lights : sequence of Light
            Scattered at least once; not none.

        Returns
        -------
        Light or None
            As if over a mirror, which shows the walls' sum and the sample's; None if the sum is endless.
        """
        if self._summed is None:
            return None
        start = np.zeros((len(lights[0].sample), 4, CHANNELS))
        for light in lights:
            shown = 2 * int(light.mirrored)
            start[:, shown] += light.kept * light.most.max(axis=1)
            start[:, shown + 1] += light.kept * light.sample
        total = np.einsum("cij,pjc->pic", self._summed, start)
        walls = (total[:, 0] + total[:, 2])[:, None]
        return Light(walls, walls, total[:, 3], mirrored=True)

    @cached_property
    def _summed(self) -> Array | None:
        """Sum of all powers of the steps of each channel, (C, 4, 4); None if it is endless."""
        steps = np.stack([self._step(channel) for channel in range(CHANNELS)])
        if not np.all(np.isfinite(steps)) or np.max(np.abs(np.linalg.eigvals(steps))) >= 1.0:
            return None
        return np.asarray(np.linalg.inv(np.eye(4) - steps))

    def _step(self, channel: int) -> Array:
        """How walls, sample, walls in mirrors and sample in mirrors feed each other, at most; (4, 4)."""
        scene, a = self._scene, self._wall_albedo
        reflectances = [mirror.reflectance for mirror in scene.mirrors] + [1.0] * (
            Event.MIRROR in scene.events
        )
        r = max(reflectances, default=0.0)
        again = r if len(reflectances) > 1 else 0.0
        albedo, largest = self.albedo[channel] * a / np.pi, self._largest[channel]
        to_walls = self.cells.from_sample.max() if scene.housing else 0.0
        shown_to_walls = self._solid_angle(self._to_mirror_mm) if scene.housing else 0.0
        on_itself = largest * self._solid_angle(2.0 * self._to_mirror_mm)
        return np.array(
            [
                [a, to_walls, a, shown_to_walls],
                [albedo, 0.0, albedo, on_itself],
                [r, 0.0, again, 0.0],
                [0.0, r, 0.0, again],
            ]
        )

    def _on_sample(self, light: Light, start: Start) -> Light:
        dark = Light.dark(len(light.sample))
        if light.lamp_mm is not None:
            straight = light.lamp_mm is start.lamp_mm
            irradiance = light.kept * self._irradiance(light.lamp_mm)[:, None]
            albedo, brightest = start.thrown if straight else (self.albedo, self._largest)
            return replace(dark, sample=brightest * irradiance, flux=albedo * irradiance * self._area)
        lit_by_walls = self.albedo * self.radiance_on_sample(light)
        return replace(dark, sample=lit_by_walls + self._largest * self.sample_on_itself(light))

    def _on_walls(self, light: Light) -> Light:
        scene, cells = self._scene, self.cells
        if light.lamp_mm is not None and light.mirrored:
            squared = np.square(self._lamp_to_mirror_mm(light))
            return self._evenly((light.kept * scene.lamp_intensity / squared)[:, None])
        if light.lamp_mm is not None:
            axis = unit(-light.lamp_mm) if scene.lamp_cosine else None
            lit = cells.lit_by(light.lamp_mm, scene.lamp_intensity, scene.lamp_radius_mm, axis)
            # Its light is grey: one channel stands for all.
            mean, most = (values[..., None] for values in lit)
            return Light(mean, most, np.zeros((len(mean), CHANNELS)))
        if light.mirrored:
            by_sample = light.kept * light.sample * self._solid_angle(self._to_mirror_mm)
            return self._evenly(np.pi * self.radiance_on_sample(light) + by_sample)
        none = np.zeros_like(light.sample)
        if light.by_cells:
            walls = cells.exchange(self._wall_albedo * light.walls)
            return Light(walls, walls, none)
        walls = cells.from_sample[:, None] * light.sample[:, None]
        return Light(walls, walls, none, flux=light.flux)

    def _evenly(self, irradiance: Array) -> Light:
        cells = len(self.cells.above)
        walls = np.broadcast_to(irradiance[:, None], (len(irradiance), cells, CHANNELS))
        return Light(walls, walls, np.zeros((len(irradiance), CHANNELS)))

    def _irradiance(self, lamp_mm: Array) -> Array:
        """Irradiance (P,) of the sample by the lamp or an image of it."""
        height = np.maximum(0.0, lamp_mm[:, 2])
        nearest = np.linalg.norm(lamp_mm, axis=-1) - self._scene.sample_radius_mm
        nearest = np.maximum(np.maximum(height, nearest), 1e-100)
        return np.asarray(self._scene.lamp_intensity * height / nearest**3)

    def _lamp_to_mirror_mm(self, light: Light) -> Array:
        """Shortest way (P,) from the lamp over all mirrors so far, less than which no wall behind is away."""
        assert light.lamp_mm is not None  # noqa: S101 - only asked of a lamp's light
        if light.mirror is None:
            nearest = np.linalg.norm(light.lamp_mm, axis=-1) - self._scene.sample_radius_mm
        else:
            nearest = _distance(light.mirror, light.lamp_mm) - self._scene.lamp_radius_mm
        return np.asarray(np.maximum(1e-100, nearest))

    def _solid_angle(self, distance_mm: float) -> float:
        """Area of the sample over a distance squared; infinite for none."""
        return self._area / distance_mm**2 if distance_mm > 0.0 else np.inf


def _in_mirror(light: Light, mirror: PlanarMirror | None) -> Light:
    """Meet a mirror, or the sample's own mirror-like part, which reflects all of it at most."""
    image = light.lamp_mm
    if image is not None:
        image = image * [1.0, 1.0, -1.0] if mirror is None else mirror.image(image)
    kept = light.kept * (1.0 if mirror is None else mirror.reflectance)
    return replace(light, lamp_mm=image, mirror=mirror, mirrored=True, kept=kept, flux=None)


def _distance(mirror: PlanarMirror, points_mm: Array) -> Array:
    """Distances (P,) of points (P, 3) from a mirror's rectangle."""
    way = points_mm - np.asarray(mirror.centre_mm)
    for side in (np.asarray(mirror.across_mm), np.asarray(mirror.up_mm)):
        way = way - np.clip(way @ side / (side @ side), -1.0, 1.0)[:, None] * side
    return np.asarray(np.linalg.norm(way, axis=-1))
