"""The light paths of a scene, exactly, in classes that do not overlap.

A path is a walk from the lamp over the scene's surfaces to the sample, where the camera looks: what the
camera sees beside the sample is not asked for. A flat surface never lights itself, so neither the sample nor
a planar mirror follows itself; a hollow mirror can, and a wall of the housing can follow another one. Short
walks that are spelt alike make a class of their own; all longer ones together are the last.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from simulator.light.paths import LightPaths
from simulator.light.scene import Event, PlanarMirror, SphericalMirror

if TYPE_CHECKING:
    from collections.abc import Iterator

    from simulator.light.scene import Mirror, Scene

Node = str | int
"""A surface: the sample, the housing, or the number of a mirror."""

Walk = tuple[tuple[Node, Event], ...]
"""Surfaces in the order in which light meets them, and what it does there."""

SAMPLE: Node = "sample"
HOUSING: Node = "housing"
SOLIDS: Node = "solids"
_LAMP: Node = "lamp"
_CAMERA: Node = "camera"

SHORT = 3
"""Events up to which every spelling is a class of its own: beyond, a housing's light has lost its letters."""


@dataclass(frozen=True)
class PathClass:
    """Paths that are kept or skipped together.

    Attributes
    ----------
    paths : LightPaths
        The class; those of one scene do not overlap, and together are all that the scene can have.
    walks : tuple of Walk
        Every way over the surfaces that is spelt so; empty for the class of all longer paths.
    name : str
        For people: how the paths are spelt, or that they are the longer ones.
    """

    paths: LightPaths
    walks: tuple[Walk, ...]
    name: str


@lru_cache(maxsize=64)
def light_paths(scene: Scene) -> LightPaths:
    """Every path that can carry light from the lamp over the sample to the camera.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    LightPaths
        Empty for a black sample.
    """
    if not scene.events:
        return LightPaths("")
    letters = surface_events(scene)
    steps: dict[tuple[Node, Node], str] = {(SAMPLE, _CAMERA): "E"}
    for node, after in followers(scene).items():
        steps |= {(node, other): _either(*letters[other]) for other in after}
    for node in letters:
        _eliminate(steps, node)
    return LightPaths("L" + steps[_LAMP, _CAMERA])


def path_classes(scene: Scene) -> tuple[PathClass, ...]:
    """Divide a scene's paths into classes.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    tuple of PathClass
        Disjoint, fewest events first, together `light_paths`.
    """
    spelt: dict[str, list[Walk]] = {}
    for length in range(1, SHORT + 1):
        for walk in walks(scene, length):
            if walk[-1][0] == SAMPLE:
                spelt.setdefault("L" + "".join(event for _, event in walk) + "E", []).append(walk)
    classes = [PathClass(LightPaths(word), tuple(ways), word) for word, ways in spelt.items()]
    longer = light_paths(scene).with_events(SHORT + 1)
    if not longer:
        return tuple(classes)
    return (*classes, PathClass(longer, (), f"{SHORT + 1} events and more"))


def walks(scene: Scene, length: int) -> Iterator[Walk]:
    """Every walk of so many events, wherever it ends."""
    letters, after = surface_events(scene), followers(scene)

    def extended(walk: Walk) -> Iterator[Walk]:
        if len(walk) == length:
            yield walk
            return
        for node in after[walk[-1][0] if walk else _LAMP]:
            for event in letters[node]:
                yield from extended((*walk, (node, event)))

    return extended(())


def surface_events(scene: Scene) -> dict[Node, tuple[Event, ...]]:
    """Return what light can do at each surface; a black sample is none."""
    letters: dict[Node, tuple[Event, ...]] = {}
    if scene.events:
        letters[SAMPLE] = tuple(sorted(scene.events))
    if scene.housing is not None:
        letters[HOUSING] = (Event.LAMBERTIAN,)
    if scene.obstructed and any(solid.albedo > 0.0 for solid in scene.rig.solids):
        letters[SOLIDS] = (Event.LAMBERTIAN,)
    return letters | dict.fromkeys(range(len(scene.mirrors)), (Event.MIRROR,))


def followers(scene: Scene) -> dict[Node, tuple[Node, ...]]:
    """Return which surfaces light can go to from each surface, and from the lamp."""
    nodes = tuple(surface_events(scene))
    return {_LAMP: nodes} | {
        node: tuple(other for other in nodes if _can_follow(scene, node, other)) for node in nodes
    }


def _can_follow(scene: Scene, node: Node, other: Node) -> bool:
    if {HOUSING, SOLIDS} & {node, other}:
        return True
    if node == other:
        mirror = scene.mirrors[node] if isinstance(node, int) else None
        return isinstance(mirror, SphericalMirror) and mirror.hollow
    if isinstance(node, int) and isinstance(other, int):
        first, second = scene.mirrors[node], scene.mirrors[other]
        return _before(first, second) and _before(second, first)
    mirror = scene.mirrors[node if isinstance(node, int) else int(other)]
    return mirror_faces_sample(scene, mirror)


def mirror_faces_sample(scene: Scene, mirror: Mirror) -> bool:
    """Tell whether some point of the sample is before the mirror, and some of the mirror above the sample.

    Of a curved mirror no more is told than that it may.
    """
    if isinstance(mirror, SphericalMirror):
        return True
    reach_mm = scene.sample_radius_mm * float(np.hypot(*mirror.normal[:2]))
    sample_before = reach_mm - float(np.asarray(mirror.centre_mm) @ mirror.normal) > 0.0
    return sample_before and bool(mirror.corners_mm[:, 2].max() > 0.0)


def _before(mirror: Mirror, other: Mirror) -> bool:
    """Tell whether some corner of the other mirror is before a mirror, or it is not known."""
    if not (isinstance(mirror, PlanarMirror) and isinstance(other, PlanarMirror)):
        return True
    return bool(np.any((other.corners_mm - np.asarray(mirror.centre_mm)) @ mirror.normal > 0.0))


def _eliminate(steps: dict[tuple[Node, Node], str], node: Node) -> None:
    """Go round a node by longer steps (Brzozowski and McCluskey 1963, elimination of states)."""
    loop = steps.pop((node, node), "")
    into = {a: steps.pop((a, b)) for a, b in list(steps) if b == node}
    out = {b: steps.pop((a, b)) for a, b in list(steps) if a == node}
    for a, first in into.items():
        for b, last in out.items():
            around = first + (f"({loop})*" if loop else "") + last
            steps[a, b] = _either(steps[a, b], around) if (a, b) in steps else around


def _either(*expressions: str) -> str:
    return expressions[0] if len(expressions) == 1 else f"({'|'.join(expressions)})"
