"""Radiance by Mitsuba's path tracer: for whatever nothing cheaper covers, and the reference of all the rest.

Mitsuba counts events but knows no letters. Paths with `first` to `last` events are the difference of two
renders with the same seed, whose shorter paths are equal to the last digit and leave no noise behind.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.kinematics import Kinematics
from rig.pixels import camera_rays, pixel_geometry
from simulator.light import mitsuba_scene
from simulator.light.classes import SHORT, light_paths
from simulator.light.evaluator import Evaluator, Method, Rendering
from simulator.light.finite_size import pose_error
from simulator.light.paths import LightPaths
from simulator.light.sample_shapes import SampleSurface
from simulator.light.scene import Event
from simulator.light.solids import SolidSurfaces
from simulator.materials import NOT_RENDERED
from simulator.sensor import derived_seed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from simulator.light.scene import Scene

Array = NDArray[np.float64]

DEEPEST = 12
"""Events after which a path ends: a housing of albedo 0.5 has lost all but 1e-4 of the light by then."""

FEWEST, _MOST = 4, 64
"""Renders: as many as tell their own spread, and as many as a pose is worth."""
_SAMPLES_PER_PIXEL = 16
_NOISE_DIRECT, NOISE_STRAY = 3e-3, 2.0
"""Noise of a pixel for one path, relative to the light itself: of direct light, and of all other."""
_STRAY_SHARE = 0.1
"""Of a housing, over a/(1 - a): what its noise is to that of all light."""
_EVENT_S, _SCALAR_EVENT_S, _RENDER_S = 1.3e-7, 4.5e-7, 3e-3
"""Time of one event of one path, vectorised or not, and of starting a render."""
_SOLID_FACETS = 64, 2
"""Facets round the machine's solids, and along them."""
_OPEN_EVENTS = 2.0
"""Events of a path that has no housing to meet: it leaves."""


class Estimate(NamedTuple):
    """Mean of independent renders, and the standard error of the mean; each (height, width, 3)."""

    mean: Array
    standard_error: Array


class PathLight(Evaluator):
    """Light on one sample, path traced.

    Parameters
    ----------
    mi : module
        Mitsuba, `simulator.bsdfs` registered.
    scene : Scene
        What is lit. Mirrors show its lamp only if it is a disc (`lamp_cosine`): a point is never met.
    first, last : int
        Number of events of the paths wanted.
    samples_per_pixel : int
        Paths per pixel and render; in LLVM a power of two.
    """

    def __init__(
        self,
        mi: Any,
        scene: Scene,
        *,
        first: int = 1,
        last: int = DEEPEST,
        samples_per_pixel: int = _SAMPLES_PER_PIXEL,
    ) -> None:
        rig = scene.rig
        self._mi, self._scene_data, self._kinematics = mi, scene, Kinematics(rig)
        self._samples_per_pixel = samples_per_pixel
        description: dict[str, Any] = {
            "type": "scene",
            "camera": mitsuba_scene.perspective_camera(mi, rig, samples_per_pixel),
            "lamp": mitsuba_scene.disc_lamp(mi, rig) if scene.lamp_cosine else mitsuba_scene.point_lamp(rig),
            "sample": mitsuba_scene.sample(mi, scene),
        }
        if scene.housing is not None:
            description["housing"] = mitsuba_scene.housing(
                mi, scene.housing.albedo, scene.housing.half_size_mm
            )
        for number in range(len(scene.mirrors)):
            description[f"mirror{number}"] = mitsuba_scene.mirror(mi, number, scene)
        self._solids = SolidSurfaces(rig, *_SOLID_FACETS) if scene.obstructed else None
        if self._solids is not None:
            description |= mitsuba_scene.solids(mi, self._solids)
            description["camera"]["near_clip"] = mitsuba_scene.near_clip_mm(rig)
        self._scene = mi.load_dict(description, optimize=False)
        self._parameters = mi.traverse(self._scene)
        self._longest = _integrator(mi, last)
        self._shorter = _integrator(mi, first - 1) if first > 1 else None

    def render(self, angles_rad: Sequence[float], tolerance: float) -> Rendering:
        """Render until the standard error is within the tolerance; see `Evaluator.render`."""
        self._pose(angles_rad)
        inside = _inside(self._scene_data, angles_rad)
        total = np.zeros((*inside.shape, 3))
        squares = np.zeros_like(total)
        count, wanted = 0, FEWEST
        error = math.inf
        while count < wanted:
            for number in range(count, wanted):
                image = self._render(derived_seed("paths", tuple(angles_rad), number))
                total += image
                squares += image**2
            count = wanted
            error = _relative_error(total, squares, count, inside)
            needed = count * (error / tolerance) ** 2 if error > tolerance else count
            wanted = min(_MOST, max(count, math.ceil(1.2 * needed) if needed > count else count))
        return Rendering(total / count, error, f"{count * self._samples_per_pixel} paths a pixel")

    def estimate(self, angles_rad: Sequence[float], renders: int) -> Estimate:
        """Mean and standard error over independent renders.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints.
        renders : int
            How many, at least 2.
        """
        self._pose(angles_rad)
        images = np.stack([self._render(derived_seed("estimate", number)) for number in range(renders)])
        return Estimate(images.mean(axis=0), images.std(axis=0, ddof=1) / np.sqrt(renders))

    def _pose(self, angles_rad: Sequence[float]) -> None:
        mi, frames = self._mi, self._kinematics.frames(np.asarray(angles_rad))
        placed = mitsuba_scene.camera_placed(mi, frames.camera_mm, frames.camera_rotation)
        self._parameters["camera.to_world"] = mi.Transform4f(placed)
        if self._scene_data.lamp_cosine:
            lamp = mitsuba_scene.disc_lamp_placed(mi, self._scene_data.rig, frames.light_mm)
            self._parameters["lamp.to_world"] = mi.Transform4f(lamp)
        else:
            self._parameters["lamp.position"] = mi.Point3f(*frames.light_mm.tolist())
        if self._solids is not None:
            for number, corners in enumerate(self._solids.corners(angles_rad)):
                key = f"solid{number}.vertex_positions"
                self._parameters[key] = type(self._parameters[key])(corners.ravel().tolist())
        self._parameters.update()

    def _render(self, seed: int) -> Array:
        image = self._image(self._longest, seed)
        return image if self._shorter is None else image - self._image(self._shorter, seed)

    def _image(self, integrator: Any, seed: int) -> Array:
        image = self._mi.render(
            self._scene, integrator=integrator, spp=self._samples_per_pixel, seed=seed % 2**32
        )
        return np.asarray(image, dtype=np.float64)


SMALL_LAMP = "it meets a small lamp in a mirror by chance, and knows no error where it does not"


def camera_obstacle(scene: Scene) -> str | None:
    """Say why light cannot be followed from the camera through Mitsuba, or None."""
    if any(scene.rig.camera.distortion):
        return "Mitsuba's camera cannot distort as this lens does"
    if not scene.lamp_cosine and (scene.mirrors or Event.MIRROR in scene.events):
        return "a mirror never shows a point"
    return None if scene.rendered else NOT_RENDERED


def direct_noise(pose: tuple[Any, Scene, Sequence[float]] | None) -> float:
    """Noise of a pixel of direct light for one path, relative to it: of a pose, or of any."""
    if pose is None or not pose[1].plain:
        return _NOISE_DIRECT
    mi, scene, angles_rad = pose
    # What lamp, pixel and pupil do to the mean is of second order, what they do to one path of first.
    return max(_NOISE_DIRECT, math.sqrt(pose_error(mi, scene, tuple(angles_rad))))


def renders_s(
    scene: Scene, renders: float, followed: Sequence[int], samples_per_pixel: int, *, vector: bool
) -> float:
    """Predict the time of renders of paths of so many events each."""
    longest = DEEPEST if scene.housing else _OPEN_EVENTS
    events = sum(min(events, longest) + 1.0 for events in followed)
    pixels = scene.rig.camera.width_px * scene.rig.camera.height_px
    each = pixels * samples_per_pixel * events * (_EVENT_S if vector else _SCALAR_EVENT_S)
    return float(renders * (_RENDER_S * len(followed) + each))


class PathTracing(Method):
    """Mitsuba's path tracer, for as many paths as the tolerance needs."""

    name = "path tracing"
    covers = LightPaths("L(D|S)+E")
    any_sample = True
    among_solids = True

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:  # noqa: ARG002
        """Say why it cannot; see `Method.obstacle`."""
        if paths & LightPaths("LS+DE"):
            return SMALL_LAMP
        if (reason := camera_obstacle(scene)) is not None:
            return reason
        if _events(scene, paths) is None:
            return "it tells paths apart by their number of events alone"
        return None

    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:
        """Predict the time of a pose; see `Method.seconds`."""
        return self._predicted(scene, paths, tolerance, direct_noise(None), vector=vector)

    def seconds_at(
        self,
        mi: Any,
        scene: Scene,
        paths: LightPaths,
        tolerance: float,
        angles_rad: Sequence[float],
        *,
        vector: bool,
    ) -> float:
        """Predict the time of a certain pose: narrow lobes are noisy; see `Method.seconds_at`."""
        return self._predicted(scene, paths, tolerance, direct_noise((mi, scene, angles_rad)), vector=vector)

    @staticmethod
    def _predicted(
        scene: Scene, paths: LightPaths, tolerance: float, direct: float, *, vector: bool
    ) -> float:
        first, last = _events(scene, paths) or (1, DEEPEST)
        albedo = scene.housing.albedo if scene.housing else 0.0
        share = 1.0 if first > 1 else 0.0 if last == 1 else _STRAY_SHARE * albedo / (1.0 - albedo)
        noise = direct + NOISE_STRAY * share
        # As many as it would need, though it stops before: what it cannot reach is not cheap.
        renders = max((noise / tolerance) ** 2 / _SAMPLES_PER_PIXEL, FEWEST)
        followed = [last, first - 1] if first > 1 else [last]
        return renders_s(scene, renders, followed, _SAMPLES_PER_PIXEL, vector=vector)

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> Evaluator:
        """Set it to work; see `Method.build`."""
        first, last = _events(scene, paths) or (1, DEEPEST)
        return PathLight(mi, scene, first=first, last=last)


@lru_cache(maxsize=256)
def _events(scene: Scene, paths: LightPaths) -> tuple[int, int] | None:
    """Return how many events these paths have, from and to, if they are all of the scene's with so many."""
    everything = light_paths(scene)
    for first in range(1, SHORT + 2):
        for last in (*range(first, SHORT + 1), None):
            if everything.with_events(first, last) == paths:
                return first, DEEPEST if last is None else last
    return None


def _integrator(mi: Any, events: int) -> Any:
    """Return the integrator of paths of up to so many events, the lamp itself left out."""
    depth = events + 1
    return mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": depth, "hide_emitters": True})


def _inside(scene: Scene, angles_rad: Sequence[float]) -> NDArray[np.bool_]:
    """Pixels (height, width) wholly on the sample: those on its edge are noisy by their coverage alone."""
    seen = pixel_geometry(scene.rig, angles_rad).on_sample if scene.plain else _seen(scene, angles_rad)
    on = np.pad(seen, 1, mode="edge")
    around = [on[1:-1, 1:-1], on[:-2, 1:-1], on[2:, 1:-1], on[1:-1, :-2], on[1:-1, 2:]]
    return np.asarray(np.logical_and.reduce(around))


def _seen(scene: Scene, angles_rad: Sequence[float]) -> NDArray[np.bool_]:
    """Pixels (height, width) whose centres see a sample of any form."""
    frames = Kinematics(scene.rig).frames(np.asarray(angles_rad))
    rays = camera_rays(scene.rig) @ frames.camera_rotation.T
    surface = SampleSurface(scene.material.mounting, scene.sample_radius_mm)
    return surface.meet(frames.camera_mm, rays.reshape(-1, 3)).seen.reshape(rays.shape[:2])


def _relative_error(total: Array, squares: Array, count: int, inside: NDArray[np.bool_]) -> float:
    """Return the standard error, RMS over the inside, relative to the mean there; 0 where it is dark."""
    if not inside.any():
        return 0.0
    mean = total[inside] / count
    variance = np.maximum(squares[inside] / count - mean**2, 0.0) / (count - 1)
    level = mean.mean()
    return float(np.sqrt(variance.mean()) / level) if level > 0.0 else 0.0
