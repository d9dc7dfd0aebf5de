"""Upper bounds of light on its way over the surroundings of a sample, surface by surface.

On the walls of a housing light is followed cell by cell (`simulator.light.cells`); in mirrors by the lamp's
image, and by the largest radiance that they can show. A bound may be far above the truth and is never below.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import unit
from simulator.light.cells import Cells
from simulator.light.classes import HOUSING, SAMPLE
from simulator.light.scene import Event

if TYPE_CHECKING:
    from collections.abc import Sequence

    from simulator.light.classes import Walk
    from simulator.light.hemisphere import Hemisphere
    from simulator.light.scene import PlanarMirror, Scene

Array = NDArray[np.float64]

CHANNELS = 3
_REACH_MARGIN, _LOST = 1.1, 1e-3
"""Of the sample's radius, for what points of the lamp do not tell; and of an image's height."""


@dataclass(frozen=True, eq=False)
class Light:
    """Bounds of light on its way.

    Attributes
    ----------
    lamp_mm : ndarray, shape (3,), optional
        The lamp, or its image in the mirrors so far; None once the light has been scattered.
    walls : ndarray, shape (cells, channels)
        Irradiance of the housing, where it was scattered last; one cell of zeros otherwise.
    sample : ndarray, shape (channels,)
        Radiance of the sample times its cosine, where it was scattered last.
    mirror : PlanarMirror, optional
        The last mirror, if light came over one since it was scattered.
    mirrored : bool
        Whether it came over one, or over the sample's mirror-like part.
    kept : float
        What mirrors have left of it since.
    """

    lamp_mm: Array | None = None
    walls: Array = field(default_factory=lambda: np.zeros((1, CHANNELS)))
    sample: Array = field(default_factory=lambda: np.zeros(CHANNELS))
    mirror: PlanarMirror | None = None
    mirrored: bool = False
    kept: float = 1.0


class Surroundings:
    """What light can meet on its way to a sample and back.

    Parameters
    ----------
    scene : Scene
    albedo : ndarray, shape (channels,)
        The sample's largest directional albedo.
    largest : ndarray, shape (channels,)
        Its largest f_r times the cosine of one of the directions.
    """

    def __init__(self, scene: Scene, albedo: Array, largest: Array) -> None:
        self._scene, self._albedo, self._largest = scene, albedo, largest
        self._wall_albedo = scene.housing.albedo if scene.housing else 0.0
        # Without a housing no light asks the cells for anything; they still need a size.
        half_size_mm = scene.housing.half_size_mm if scene.housing else 10.0 * scene.sample_radius_mm
        self._cells = Cells(half_size_mm, scene.sample_radius_mm)
        self._area = np.pi * scene.sample_radius_mm**2
        origin = np.zeros(3)
        nearest = min((_distance(mirror, origin) for mirror in scene.mirrors), default=np.inf)
        self._to_mirror_mm = max(0.0, nearest - scene.sample_radius_mm)
        self._known_from: Array | None = None
        self._known: dict[Walk, Light] = {}

    def along(self, walk: Walk, lamp_mm: Array) -> Light:
        """Follow the lamp's light over all surfaces of a walk; what walks have in common is followed once."""
        if self._known_from is None or not np.array_equal(self._known_from, lamp_mm):
            self._known_from, self._known = lamp_mm, {(): Light(lamp_mm=lamp_mm)}
        if walk not in self._known:
            light, (node, event) = self.along(walk[:-1], lamp_mm), walk[-1]
            if node == HOUSING:
                light = self._on_walls(light)
            elif event is Event.MIRROR:
                light = _in_mirror(light, None if node == SAMPLE else self._scene.mirrors[int(node)])
            else:
                light = self._on_sample(light)
            self._known[walk] = light
        return self._known[walk]

    def radiance_on_sample(self, light: Light) -> Array:
        """Largest radiance (channels,) that walls, or mirrors that show them, send to the sample."""
        walls = light.walls
        if len(walls) > 1 and not light.mirrored:
            walls = walls[self._cells.above]
        return np.asarray(light.kept * self._wall_albedo / np.pi * walls.max(axis=0))

    def irradiance_of_sample(self, light: Light) -> Array:
        """Irradiance (channels,) of the sample by walls, or by mirrors that show them."""
        if light.mirrored or len(light.walls) == 1:
            return np.pi * self.radiance_on_sample(light)
        return self._cells.on_sample(self._wall_albedo * light.walls)

    def lobe_on_sample(self, light: Light, lobe: Hemisphere) -> Array:
        """Radiance (channels,) that a lobe makes of the walls it looks at, or of mirrors that show them."""
        if light.mirrored or len(light.walls) == 1:
            return lobe.rest * self.radiance_on_sample(light)
        seen = self._wall_albedo / np.pi * light.walls[self._cells.seen(lobe.directions)]
        return np.asarray(np.sum(lobe.weights * seen, axis=0))

    def sample_on_itself(self, light: Light) -> Array:
        """Irradiance (channels,) of the sample by its own image in a mirror."""
        return light.kept * light.sample * self._solid_angle(2.0 * self._to_mirror_mm)

    def reaches_sample(self, light: Light) -> bool:
        """Tell whether the lamp's image can be seen from some point of the sample in the last mirror."""
        if light.lamp_mm is None or light.mirror is None:
            return True
        around = self._scene.lamp_radius_mm * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
        reach_mm = _REACH_MARGIN * self._scene.sample_radius_mm
        # Each point of the lamp's disc has a frame of light of its own.
        return any(_reaches(light.lamp_mm + off, light.mirror, reach_mm) for off in around)

    def series(self, lights: Sequence[Light]) -> Light | None:
        """Sum lights and all that they become over any number of further surfaces.

        Parameters
        ----------
        lights : sequence of Light
            Scattered at least once.

        Returns
        -------
        Light or None
            As if over a mirror, which shows the walls' sum and the sample's; None if the sum is endless.
        """
        start = np.zeros((4, CHANNELS))
        for light in lights:
            shown = 2 * int(light.mirrored)
            start[shown] += light.kept * light.walls.max(axis=0)
            start[shown + 1] += light.kept * light.sample
        total = np.empty_like(start)
        for channel in range(CHANNELS):
            step = self._step(channel)
            if not np.all(np.isfinite(step)) or np.max(np.abs(np.linalg.eigvals(step))) >= 1.0:
                return None
            total[:, channel] = np.linalg.solve(np.eye(4) - step, start[:, channel])
        return Light(walls=(total[0] + total[2])[None], sample=total[3], mirrored=True)

    def _step(self, channel: int) -> Array:
        """How walls, sample, walls in mirrors and sample in mirrors feed each other, at most; (4, 4)."""
        scene, a = self._scene, self._wall_albedo
        reflectances = [mirror.reflectance for mirror in scene.mirrors] + [1.0] * (
            Event.MIRROR in scene.events
        )
        r = max(reflectances, default=0.0)
        again = r if len(reflectances) > 1 else 0.0
        albedo, largest = self._albedo[channel] * a / np.pi, self._largest[channel]
        to_walls = self._cells.from_sample.max() if scene.housing else 0.0
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

    def _on_sample(self, light: Light) -> Light:
        if light.lamp_mm is not None:
            return Light(sample=self._largest * light.kept * self._irradiance(light.lamp_mm))
        lit_by_walls = self._albedo * self.radiance_on_sample(light)
        return Light(sample=lit_by_walls + self._largest * self.sample_on_itself(light))

    def _on_walls(self, light: Light) -> Light:
        scene, cells = self._scene, self._cells
        if light.lamp_mm is not None and light.mirrored:
            return self._evenly(light.kept * scene.lamp_intensity / self._lamp_to_mirror_mm(light) ** 2)
        if light.lamp_mm is not None:
            axis = unit(-light.lamp_mm) if scene.lamp_cosine else None
            lit = cells.lit_by(light.lamp_mm, scene.lamp_intensity, scene.lamp_radius_mm, axis)
            return Light(walls=np.repeat(lit[:, None], CHANNELS, axis=1))
        if light.mirrored:
            by_sample = light.kept * light.sample * self._solid_angle(self._to_mirror_mm)
            return self._evenly(np.pi * self.radiance_on_sample(light) + by_sample)
        walls = cells.from_sample[:, None] * light.sample
        if len(light.walls) > 1:
            walls = walls + cells.exchange(self._wall_albedo * light.walls)
        return Light(walls=walls)

    def _evenly(self, irradiance: float | Array) -> Light:
        return Light(walls=np.tile(np.broadcast_to(irradiance, CHANNELS), (len(self._cells.above), 1)))

    def _irradiance(self, lamp_mm: Array) -> float:
        """Irradiance of the sample by the lamp or an image of it."""
        height = max(0.0, float(lamp_mm[2]))
        nearest = max(height, float(np.linalg.norm(lamp_mm)) - self._scene.sample_radius_mm, 1e-300)
        return self._scene.lamp_intensity * height / nearest**3

    def _lamp_to_mirror_mm(self, light: Light) -> float:
        """Shortest way from the lamp over all mirrors so far, less than which no wall behind them is away."""
        assert light.lamp_mm is not None  # noqa: S101 - only asked of a lamp's light
        if light.mirror is None:
            return max(1e-300, float(np.linalg.norm(light.lamp_mm)) - self._scene.sample_radius_mm)
        return max(1e-300, _distance(light.mirror, light.lamp_mm) - self._scene.lamp_radius_mm)

    def _solid_angle(self, distance_mm: float) -> float:
        """Area of the sample over a distance squared; infinite for none."""
        return self._area / distance_mm**2 if distance_mm > 0.0 else np.inf


def _in_mirror(light: Light, mirror: PlanarMirror | None) -> Light:
    """Meet a mirror, or the sample's own mirror-like part, which reflects all of it at most."""
    image = light.lamp_mm
    if image is not None:
        image = image * [1.0, 1.0, -1.0] if mirror is None else mirror.image(image)
    kept = light.kept * (1.0 if mirror is None else mirror.reflectance)
    return replace(light, lamp_mm=image, mirror=mirror, mirrored=True, kept=kept)


def _reaches(image_mm: Array, mirror: PlanarMirror, reach_mm: float) -> bool:
    """Tell whether a point behind a mirror is seen in it from somewhere near the origin at z = 0."""
    height = image_mm[2]
    if height <= 0.0 or (image_mm - np.asarray(mirror.centre_mm)) @ mirror.normal >= 0.0:
        return False
    # What is higher than the image throws its light up, what is just below it so far away that it is lost.
    window = _between(mirror.corners_mm, 0.0, (1.0 - _LOST) * height)
    if len(window) < 3:
        return False
    scale = height / (height - window[:, 2])
    spots = image_mm + scale[:, None] * (window - image_mm)
    return bool(_distance_to_polygon(spots[:, :2]) <= reach_mm)


def _between(corners: Array, low: float, high: float) -> Array:
    """Cut a convex polygon (N, 3) at two heights, as Sutherland and Hodgman (1974) do."""
    for sign, level in ((1.0, low), (-1.0, high)):
        above = sign * (corners[:, 2] - level)
        kept = []
        for start, end, here, there in zip(
            corners, np.roll(corners, -1, axis=0), above, np.roll(above, -1), strict=True
        ):
            if here >= 0.0:
                kept.append(start)
            if here * there < 0.0:
                kept.append(start + here / (here - there) * (end - start))
        corners = np.array(kept).reshape(-1, 3)
    return corners


def _distance(mirror: PlanarMirror, point_mm: Array) -> float:
    """Distance of a point from a mirror's rectangle."""
    way = point_mm - np.asarray(mirror.centre_mm)
    sides = [np.asarray(side) for side in (mirror.across_mm, mirror.up_mm)]
    on = [np.clip(way @ side / (side @ side), -1.0, 1.0) * side for side in sides]
    return float(np.linalg.norm(way - on[0] - on[1]))


def _distance_to_polygon(corners: Array) -> float:
    """Distance of the origin from a convex polygon (N, 2); zero inside."""
    edges = np.roll(corners, -1, axis=0) - corners
    sides = edges[:, 0] * corners[:, 1] - edges[:, 1] * corners[:, 0]
    if np.all(sides >= 0.0) or np.all(sides <= 0.0):
        return 0.0
    t = np.clip(-np.sum(corners * edges, axis=1) / np.sum(edges**2, axis=1), 0.0, 1.0)
    return float(np.min(np.linalg.norm(corners + t[:, None] * edges, axis=1)))
