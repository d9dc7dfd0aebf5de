"""What is computed of a scene's light at a pose, by which methods, and what is skipped: decided beforehand.

Every class of the scene's paths has a bound of its share at the pose (`simulator.light.shares`). The smallest
are skipped, as long as their bounds together are below the tolerance and something is left of it; the rest is
divided among methods that can compute it, at the least predicted time, each within its part of what is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.errors import Refused
from simulator.light.paths import LightPaths
from simulator.light.reflectance import material_reflectance
from simulator.light.shares import Shares
from simulator.light.tasks import Asked, Task, Way, by_method

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from simulator.light.classes import PathClass
    from simulator.light.evaluator import Method
    from simulator.light.scene import Scene


NOT_PLAIN = "it takes the sample for flat, level and alike everywhere"
"""Why a method is not asked about a scene whose sample is not."""


MOST_SKIPPED = 0.97
"""Part of the tolerance that may be spent on what is skipped: what is left, methods must do with."""


@dataclass(frozen=True)
class Part:
    """What one method computes.

    Attributes
    ----------
    method : Method
    classes : tuple of PathClass
        The classes that it computes.
    paths : LightPaths
        Their union.
    seconds : float
        Predicted time of the pose.
    tolerance : float
        The error that it is asked for, relative to the mean radiance of what it computes.
    leaves_out : float
        The error that it leaves however long it works, on top; relative to all light.
    """

    method: Method
    classes: tuple[PathClass, ...]
    paths: LightPaths
    seconds: float
    tolerance: float
    leaves_out: float


@dataclass(frozen=True)
class Decision:
    """What was decided, in words that can be shown.

    Attributes
    ----------
    classes : tuple of PathClass
        All of the scene's.
    bounds : tuple of float
        Upper bound of each one's share.
    parts : tuple of Part
        What is computed; empty for a black sample.
    skipped : tuple of PathClass
        What is not.
    tolerance : float
        The error allowed in all.
    """

    classes: tuple[PathClass, ...]
    bounds: tuple[float, ...]
    parts: tuple[Part, ...]
    skipped: tuple[PathClass, ...]
    tolerance: float

    @property
    def skipped_bound(self) -> float:
        """Upper bound of the share of all that is skipped."""
        return sum(b for c, b in zip(self.classes, self.bounds, strict=True) if c in self.skipped)

    @property
    def reached(self) -> bool:
        """Whether methods and skipped classes together are predicted to stay within the tolerance."""
        return self.left_out <= self.tolerance

    @property
    def left_out(self) -> float:
        """Upper bound of the share of all that is skipped, by class or by a method."""
        return self.skipped_bound + sum(part.leaves_out for part in self.parts)

    def by(self, path_class: PathClass) -> Part | None:
        """Return the part that computes a class, None if it is skipped."""
        return next((part for part in self.parts if path_class in part.classes), None)


class Chooser:
    """Decides about the light of one scene, pose by pose.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set and `simulator.bsdfs` registered.
    scene : Scene
    tolerance : float
        Relative error that is allowed, in the mean and in the pixels' RMS over the sample.
    methods : sequence of Method
        Those to choose from.

    Raises
    ------
    BadInput
        Mitsuba refuses the material.
    """

    def __init__(self, mi: Any, scene: Scene, tolerance: float, methods: Sequence[Method]) -> None:
        self._mi, self._scene, self._tolerance = mi, scene, tolerance
        self._vector = not mi.variant().startswith("scalar")
        self._shares = Shares(scene, material_reflectance(mi, scene.material))
        self._able = {
            number: tuple(method for method in methods if path_class.paths <= method.covers)
            for number, path_class in enumerate(self._shares.classes)
        }
        self._divided: dict[tuple[int, ...], tuple[tuple[float, dict[Method, tuple[int, ...]]], ...]] = {}
        self._obstacles: dict[tuple[Method, tuple[int, ...]], str | None] = {}
        self._unions: dict[tuple[int, ...], LightPaths] = {}

    @property
    def classes(self) -> tuple[PathClass, ...]:
        """The scene's path classes."""
        return self._shares.classes

    def able(self, path_class: PathClass) -> tuple[Method, ...]:
        """Return the methods that can compute a class by itself."""
        number = self.classes.index(path_class)
        return tuple(method for method in self._able[number] if self._obstacle(method, (number,)) is None)

    def decide_many(self, poses_rad: Iterable[Sequence[float]]) -> list[Decision]:
        """Decide about poses, each as if it were alone, in a fraction of the time.

        Parameters
        ----------
        poses_rad : iterable of sequences of float
            As in `decide`.

        Returns
        -------
        list of Decision
            In the order of the poses.

        Raises
        ------
        Refused
            As `decide`.
        """
        poses = [tuple(float(angle) for angle in pose) for pose in poses_rad]
        if not self.classes:
            return [Decision((), (), (), (), self._tolerance)] * len(poses)
        for method in dict.fromkeys(method for able in self._able.values() for method in able):
            method.foresee(self._mi, self._scene, poses)
        return [
            self._decided(pose, bounds)
            for pose, bounds in zip(poses, self._shares.bounds(poses), strict=True)
        ]

    def decide(self, angles_rad: Sequence[float]) -> Decision:
        """Decide about a pose.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints.

        Returns
        -------
        Decision
            Where no method can stay within the tolerance, with those that leave out least.

        Raises
        ------
        Refused
            No methods can compute what may not be skipped.
        """
        return self.decide_many([angles_rad])[0]

    def _decided(self, angles_rad: tuple[float, ...], bounds: tuple[float, ...]) -> Decision:
        asked = Asked(self._mi, self._scene, angles_rad, vector=self._vector)
        classes = self._shares.classes
        best: tuple[tuple[bool, float, float], Sequence[Task], tuple[int, ...]] | None = None
        for way in self._ways(bounds, MOST_SKIPPED * self._tolerance):
            dearest = best[0][1] if best is not None and not best[0][0] else np.inf
            if way.least_s > dearest:
                continue
            tasks = self._tasks(way, bounds, asked, dearest)
            if tasks is None:
                continue
            left_out = sum(task.leaves_out for task in tasks)
            missed = way.spent + left_out > self._tolerance
            # Of what costs the same, that which leaves out least.
            rank = missed, left_out if missed else sum(task.seconds for task in tasks), way.spent
            if best is None or rank < best[0]:
                best = rank, tasks, way.skipped
        if best is None:
            raise Refused(
                f"no method computes the light paths {self._unable()}",
                where=self._scene.material.spec,
                todo="simplify the scene, or allow a larger error",
            )
        skipped = tuple(classes[n] for n in best[2])
        return Decision(classes, bounds, self._parts(best[1]), skipped, self._tolerance)

    def ways(self, angles_rad: Sequence[float]) -> Iterator[tuple[Part, ...]]:
        """Yield every way to compute a pose, those too that skip more than may be.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints.
        """
        pose = tuple(float(angle) for angle in angles_rad)
        asked = Asked(self._mi, self._scene, pose, vector=self._vector)
        bounds = self._shares.bounds([pose])[0]
        for way in self._ways(bounds, np.inf):
            yield self._parts(self._tasks(way, bounds, asked, np.inf) or ())

    def _ways(self, bounds: Sequence[float], most: float) -> Iterator[Way]:
        """Yield what may be skipped, and who can compute the rest."""
        order = sorted(range(len(bounds)), key=lambda number: (bounds[number], -number))
        for count in reversed(range(len(order))):
            spent = sum(bounds[number] for number in order[:count])
            if spent > most:
                continue
            skipped = tuple(sorted(order[:count]))
            kept = tuple(number for number in range(len(bounds)) if number not in skipped)
            for least_s, division in self._divisions(kept):
                yield Way(skipped, spent, division, least_s)

    def _divisions(self, kept: tuple[int, ...]) -> tuple[tuple[float, dict[Method, tuple[int, ...]]], ...]:
        """Every way to divide classes among methods that can compute their parts exactly, cheapest first.

        With the least time that each can take: that of the roughest picture.
        """
        if kept not in self._divided:
            alike: dict[tuple[Method, ...], tuple[int, ...]] = {}
            for number in kept:
                able = self._able[number]
                alike[able] = (*alike.get(able, ()), number)
            found = [
                (sum(self._least_s(method, numbers) for method, numbers in division.items()), division)
                for chosen in product(*alike)
                if self._possible(division := by_method(chosen, tuple(alike.values())))
            ]
            self._divided[kept] = tuple(sorted(found, key=itemgetter(0)))
        return self._divided[kept]

    def _least_s(self, method: Method, numbers: tuple[int, ...]) -> float:
        return method.seconds(self._scene, self._union(numbers), _ROUGHEST, vector=self._vector)

    def _possible(self, division: Mapping[Method, tuple[int, ...]]) -> bool:
        return all(self._obstacle(method, numbers) is None for method, numbers in division.items())

    def _obstacle(self, method: Method, numbers: tuple[int, ...]) -> str | None:
        key = method, numbers
        if key not in self._obstacles:
            fits = self._scene.plain or method.any_sample
            self._obstacles[key] = (
                method.obstacle(self._scene, self._union(numbers), vector=self._vector) if fits else NOT_PLAIN
            )
        return self._obstacles[key]

    def _union(self, numbers: tuple[int, ...]) -> LightPaths:
        if numbers not in self._unions:
            paths = LightPaths("")
            for number in numbers:
                paths |= self._shares.classes[number].paths
            self._unions[numbers] = paths
        return self._unions[numbers]

    def _tasks(
        self, way: Way, bounds: Sequence[float], asked: Asked, dearest: float
    ) -> Sequence[Task] | None:
        """Ask each method for its part of what is left; light that is little may be rough.

        None if all together would take longer than the dearest that is still looked for.
        """
        left = max(self._tolerance - way.spent, (1.0 - MOST_SKIPPED) * self._tolerance)
        tasks, total = [], 0.0
        for method, numbers in way.division.items():
            missing = asked.left_out(method)
            allowed = max(left / len(way.division) - missing, _LEAST * self._tolerance)
            share = min(1.0, sum([bounds[number] for number in numbers]))
            tolerance = allowed / max(share, allowed / _ROUGHEST)
            seconds = asked.seconds(method, numbers, self._union(numbers), tolerance)
            total += seconds
            if total > dearest:
                return None
            tasks.append(Task(method, numbers, seconds, tolerance, missing))
        return tasks

    def _parts(self, tasks: Sequence[Task]) -> tuple[Part, ...]:
        return tuple(
            Part(
                task.method,
                tuple(self._shares.classes[number] for number in task.numbers),
                self._union(task.numbers),
                task.seconds,
                task.tolerance,
                task.leaves_out,
            )
            for task in tasks
        )

    def _unable(self) -> str:
        """Name paths and what stands in the way of each method."""
        numbers = tuple(self._able)
        everywhere = set.intersection(*(set(able) for able in self._able.values()))
        names = ", ".join(path_class.name for path_class in self._shares.classes)
        reasons = {m.name: self._obstacle(m, numbers) for m in everywhere}
        told = "; ".join(f"{name}: {reason}" for name, reason in reasons.items() if reason)
        return f"{names} ({told})" if told else names


_LEAST = 0.05
"""Least part of the tolerance that a method is asked for, where it leaves out nearly all of it itself."""

_ROUGHEST = 0.3
"""Largest error that a method is asked for, relative to what it computes: beyond, none knows its own."""
