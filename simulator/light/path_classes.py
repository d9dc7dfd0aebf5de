"""Every class of light paths as an image of its own, from one render.

A path is followed from the camera; at each surface the letter of its event is kept (S where the direction was
drawn from a delta function, otherwise the surface's kind of D), so that when it meets the lamp its word is
known, and its light is added to the class that holds the word. The lamp is asked at each surface and met by
chance, weighted by the power heuristic (Veach and Guibas 1995, "Optimally combining sampling techniques for
Monte Carlo rendering", section 3.3). All classes come from the same paths: their noises are not independent.
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.errors import Refused
from simulator.light.evaluator import Method
from simulator.light.path_tracer import (
    FEWEST,
    NOISE_STRAY,
    SMALL_LAMP,
    Estimate,
    PathLight,
    camera_obstacle,
    direct_noise,
    renders_s,
)
from simulator.light.paths import LightPaths
from simulator.light.scene import Event
from simulator.sensor import derived_seed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from simulator.light.scene import Scene

Array = NDArray[np.float64]

LONGEST = 6
"""Events after which a path ends, unless told otherwise."""
_SAMPLES_PER_PIXEL = 16
"""As a method, paths per pixel and render."""
_MIRRORED_FIRST = LightPaths("LS+D(D|S)*E")
TWO_WAYS = "the sample scatters light in two ways, which it does not tell apart"
_CODES = {"Dl": 0, "Dg": 1, "S": 2}
_LETTERS = len(_CODES)


class PathClasses(PathLight):
    """Light on one scene, told apart by paths.

    Parameters
    ----------
    mi : module
        Mitsuba in an LLVM variant, `simulator.bsdfs` registered.
    scene : Scene
    classes : sequence of LightPaths
        Disjoint. Paths of none of them are followed and given up.
    longest : int
        Events after which a path ends.
    samples_per_pixel : int
        Paths per pixel and render; a power of two.

    Raises
    ------
    Refused
        The variant is scalar, two classes hold the same path, or the sample scatters in two ways.
    """

    def __init__(
        self,
        mi: Any,
        scene: Scene,
        classes: Sequence[LightPaths],
        *,
        longest: int = LONGEST,
        samples_per_pixel: int = 64,
    ) -> None:
        if mi.variant().startswith("scalar"):
            raise Refused("path classes in a scalar variant", todo="use llvm")
        super().__init__(mi, scene, samples_per_pixel=samples_per_pixel)
        letters = scattering_letters(scene)
        if len(letters) > 1:
            raise Refused(TWO_WAYS, where=scene.material.spec, todo="use path tracing")
        self._count = len(classes)
        shapes = {shape.id(): shape for shape in self._scene.shapes()}
        self._integrator = _integrator_type(mi)(
            sample=shapes["sample"],
            # A sample that only mirrors has no D that could be asked for.
            letter=_CODES[letters[0]] if letters else _CODES["S"],
            table=class_table(classes, longest),
            classes=len(classes),
            longest=longest,
        )

    def estimates(self, angles_rad: Sequence[float], renders: int) -> list[Estimate]:
        """Mean and standard error of every class over independent renders.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints.
        renders : int
            How many, at least 2.

        Returns
        -------
        list of Estimate
            In the order of the classes.
        """
        self._pose(angles_rad)
        images = np.stack([self._classes(derived_seed("classes", number)) for number in range(renders)])
        means, errors = images.mean(axis=0), images.std(axis=0, ddof=1) / np.sqrt(renders)
        return [Estimate(means[..., c, :], errors[..., c, :]) for c in range(self._count)]

    def _render(self, seed: int) -> Array:
        return np.asarray(self._classes(seed).sum(axis=2))

    def _classes(self, seed: int) -> Array:
        """One render, shape (height, width, classes, 3)."""
        image = np.asarray(
            self._mi.render(
                self._scene, integrator=self._integrator, spp=self._samples_per_pixel, seed=seed % 2**32
            ),
            dtype=np.float64,
        )
        # First come the channels of all paths together.
        return image[..., 3:].reshape(*image.shape[:2], self._count, 3)


class PathClassesMethod(Method):
    """The row of `PathClasses` in the table of methods: any short paths, told apart by their words."""

    name = "path tracing by class"
    covers = LightPaths("L(D|S)+E")
    any_sample = True
    among_solids = True

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:
        """Say why it cannot; see `Method.obstacle`."""
        if not vector:
            return "it needs the LLVM variant"
        if len(scattering_letters(scene)) > 1:
            return TWO_WAYS
        if paths & _MIRRORED_FIRST:
            return SMALL_LAMP
        if paths.with_events(LONGEST + 1):
            return f"it keeps the words of paths of up to {LONGEST} events"
        return camera_obstacle(scene)

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
        """Predict the time of a certain pose; see `Method.seconds_at`."""
        return self._predicted(scene, paths, tolerance, direct_noise((mi, scene, angles_rad)), vector=vector)

    @staticmethod
    def _predicted(
        scene: Scene, paths: LightPaths, tolerance: float, direct: float, *, vector: bool
    ) -> float:
        longest = _most_events(paths)
        noise = direct if longest == 1 else direct + NOISE_STRAY
        renders = max((noise / tolerance) ** 2 / _SAMPLES_PER_PIXEL, FEWEST)
        return renders_s(scene, renders, [longest], _SAMPLES_PER_PIXEL, vector=vector)

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> PathClasses:
        """Set it to work; see `Method.build`."""
        return PathClasses(mi, scene, [paths], samples_per_pixel=_SAMPLES_PER_PIXEL)


@lru_cache(maxsize=256)
def _most_events(paths: LightPaths) -> int:
    return max(count for count in range(1, LONGEST + 1) if paths.with_events(count, count))


def scattering_letters(scene: Scene) -> list[Event]:
    """Return the ways in which the sample scatters light, mirrors apart."""
    return [event for event in sorted(scene.events) if event is not Event.MIRROR]


def class_table(classes: Sequence[LightPaths], longest: int) -> NDArray[np.uint32]:
    """Return the class of every word of at most so many events, by `_place`; their number for none.

    Parameters
    ----------
    classes : sequence of LightPaths
        Disjoint.
    longest : int
        Events of the longest words.

    Raises
    ------
    Refused
        Two classes hold the same path.
    """
    table = np.full(_start(longest + 1), len(classes), dtype=np.uint32)
    for number, paths in enumerate(classes):
        for word in paths.with_events(1, longest).words():
            place = _place(word)
            if table[place] != len(classes):
                raise Refused(f"{word} is in two classes", where="path classes", todo="make them disjoint")
            table[place] = number
    return table


def _start(events: int) -> int:
    """Return the place of the first word of so many events."""
    return sum(_LETTERS**shorter for shorter in range(events))


def _place(word: str) -> int:
    """Return a word's place: its events from the camera on, as digits."""
    codes = [_CODES[event] for event in word[1:-1].replace("D", " D").replace("S", " S").split()]
    return _start(len(codes)) + int(sum(code * _LETTERS**k for k, code in enumerate(reversed(codes))))


@cache
def _integrator_type(mi: Any) -> Any:
    """Return the integrator's class: its base exists once Mitsuba's variant is set."""
    import drjit as dr

    class ByPathClass(mi.SamplingIntegrator):  # type: ignore[misc]
        """One image for every class of paths."""

        def __init__(
            self, *, sample: Any, letter: int, table: NDArray[np.uint32], classes: int, longest: int
        ) -> None:
            super().__init__(mi.Properties())
            self._sample, self._letter = mi.ShapePtr(sample), letter
            self._table, self._classes, self._longest = mi.UInt32(table), classes, longest

        def aov_names(self) -> list[str]:
            """Name the channels: three for each class."""
            return [f"class{number}.{channel}" for number in range(self._classes) for channel in "RGB"]

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:  # noqa: ARG002
            """Follow one path from the camera."""
            first = scene.ray_intersect(ray, active)
            # The lamp seen by the camera is no path of its own here, and hides nothing.
            lamp = first.is_valid() & first.shape.is_emitter()
            behind = first.spawn_ray(ray.d)
            start = dr.select(lamp, behind, mi.Ray3f(ray))
            state = (
                sampler,
                scene.ray_intersect(start, active),
                mi.Spectrum(1.0),
                mi.UInt32(0),
                mi.UInt32(0),
                mi.UInt32(1),
                mi.Bool(active),
                [mi.Spectrum(0.0) for _ in range(self._classes)],
            )
            state = dr.while_loop(
                state,
                lambda *s: s[6],
                lambda *s: self._event(scene, *s),
                label="path classes",
            )
            images = state[-1]
            channels = [channel for image in images for channel in (image.x, image.y, image.z)]
            total = mi.Spectrum(0.0)
            for image in images:
                total += image
            return total, first.is_valid(), channels

        def _event(  # noqa: PLR0917 - the loop's state
            self,
            scene: Any,
            sampler: Any,
            si: Any,
            throughput: Any,
            events: Any,
            code: Any,
            power: Any,
            active: Any,
            images: list[Any],
        ) -> tuple[Any, ...]:
            """Meet one surface: ask the lamp, draw a direction, see what is there."""
            active = active & si.is_valid() & ~si.shape.is_emitter()
            context, bsdf = mi.BSDFContext(), si.bsdf()
            diffuse = dr.select(si.shape == self._sample, mi.UInt32(self._letter), mi.UInt32(_CODES["Dl"]))
            ds, light = scene.sample_emitter_direction(si, sampler.next_2d(active), True, active)
            wo = si.to_local(ds.d)
            value, pdf = bsdf.eval_pdf(context, si, wo, active)
            weight = dr.select(ds.delta, 1.0, _power_heuristic(ds.pdf, pdf))
            asked = active & (ds.pdf > 0.0)
            images = self._add(
                images, events, code + diffuse * power, throughput * value * light * weight, asked
            )
            bs, factor = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
            delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
            throughput = throughput * factor
            code = code + dr.select(delta, mi.UInt32(_CODES["S"]), diffuse) * power
            active = active & dr.any(throughput != 0.0)
            following = scene.ray_intersect(si.spawn_ray(si.to_world(bs.wo)), active)
            emitter = following.emitter(scene)
            met = active & following.is_valid() & (emitter != None)  # noqa: E711 - drjit compares lanes
            chance = scene.pdf_emitter_direction(si, mi.DirectionSample3f(scene, following, si), met & ~delta)
            weight = dr.select(delta, 1.0, _power_heuristic(bs.pdf, chance))
            shine = emitter.eval(following, met)
            images = self._add(images, events, code, throughput * shine * weight, met)
            events = events + 1
            active = active & ~met & (events < self._longest)
            return sampler, following, throughput, events, code, power * _LETTERS, active, images

        def _add(self, images: list[Any], before: Any, code: Any, light: Any, active: Any) -> list[Any]:
            """Add light to the class of its word, of one event more than before."""
            start = mi.UInt32([_start(events) for events in range(1, self._longest + 1)])
            place = dr.gather(mi.UInt32, start, before, active) + code
            number = dr.gather(mi.UInt32, self._table, place, active)
            return [image + dr.select(active & (number == k), light, 0.0) for k, image in enumerate(images)]

        def to_string(self) -> str:
            """Return its name, as Mitsuba prints it."""
            return "ByPathClass[]"

    def _power_heuristic(a: Any, b: Any) -> Any:
        return dr.select(a > 0.0, dr.square(a) / (dr.square(a) + dr.square(b)), 0.0)

    return ByPathClass
