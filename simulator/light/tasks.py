"""Who could do what of a scene's light, and what each says about a pose: what the choice weighs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from simulator.light.evaluator import Method
    from simulator.light.paths import LightPaths
    from simulator.light.scene import Scene


class Way(NamedTuple):
    """What is skipped, by number, the sum of its bounds, and who computes the rest, in what time at least."""

    skipped: tuple[int, ...]
    spent: float
    division: Mapping[Method, tuple[int, ...]]
    least_s: float


class Task(NamedTuple):
    """What one method would do: as `Part`, its classes by number."""

    method: Method
    numbers: tuple[int, ...]
    seconds: float
    tolerance: float
    leaves_out: float


class Asked:
    """What methods say about a pose, asked for once."""

    def __init__(self, mi: Any, scene: Scene, angles_rad: tuple[float, ...], *, vector: bool) -> None:
        self._mi, self._scene, self._angles_rad, self._vector = mi, scene, angles_rad, vector
        self._left_out: dict[Method, float] = {}
        self._seconds: dict[tuple[Method, tuple[int, ...], float], float] = {}

    def left_out(self, method: Method) -> float:
        """Return what it leaves out however long it works."""
        if method not in self._left_out:
            self._left_out[method] = method.leaves_out(self._mi, self._scene, self._angles_rad)
        return self._left_out[method]

    def seconds(self, method: Method, numbers: tuple[int, ...], paths: LightPaths, tolerance: float) -> float:
        """Return its predicted time for some classes, whose union the paths are."""
        key = method, numbers, tolerance
        if key not in self._seconds:
            self._seconds[key] = method.seconds_at(
                self._mi, self._scene, paths, tolerance, self._angles_rad, vector=self._vector
            )
        return self._seconds[key]


def by_method(chosen: Sequence[Method], groups: Sequence[tuple[int, ...]]) -> dict[Method, tuple[int, ...]]:
    """Gather groups of classes that go to the same method."""
    division: dict[Method, tuple[int, ...]] = {}
    for method, numbers in zip(chosen, groups, strict=True):
        division[method] = tuple(sorted((*division.get(method, ()), *numbers)))
    return division
