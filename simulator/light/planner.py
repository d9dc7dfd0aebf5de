"""What is computed of a pose where a machine has solids: first it is asked whether they matter.

Mostly they do not: what they add is less than is left of the tolerance, and they are skipped like a class of
paths. Where they add more, all light but the direct is followed from the camera among them; where one shades
or hides the sample, all light is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from simulator.light.choice import Chooser, Decision, Part
from simulator.light.classes import light_paths
from simulator.light.reflectance import material_reflectance
from simulator.light.solids import SolidsAt, SolidsLight

if TYPE_CHECKING:
    from collections.abc import Sequence

    from simulator.light.evaluator import Method
    from simulator.light.scene import Scene

_ROUGHEST = 0.3
"""Largest error that is asked of what the solids add, relative to it."""


@dataclass(frozen=True)
class Plan:
    """What is computed of a pose.

    Attributes
    ----------
    decision : Decision
        About `scene`.
    scene : Scene
        With or without the machine's solids.
    solids : SolidsAt
        What they do.
    added : Part or None
        Light among the solids that is computed on top, in the scene `among`.
    among : Scene
        The scene with the solids.
    reached : bool
        Whether all of it is predicted to stay within the tolerance.
    """

    decision: Decision
    scene: Scene
    solids: SolidsAt
    added: Part | None
    among: Scene
    reached: bool

    @property
    def parts(self) -> tuple[tuple[Scene, Part], ...]:
        """Everything that is computed, with the scene that it is computed in."""
        parts = tuple((self.scene, part) for part in self.decision.parts)
        return parts if self.added is None else (*parts, (self.among, self.added))


class Planner:
    """Decides about the light of one scene, solids included, pose by pose.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set and `simulator.bsdfs` registered.
    scene : Scene
        Without solids.
    tolerance : float
        As in `Chooser`.
    methods : sequence of Method
        Those to choose from.
    follow_solids : bool
        Whether the machine's solids take part; otherwise their light is left out, and no shadow falls.

    Raises
    ------
    BadInput
        Mitsuba refuses the material.
    """

    def __init__(
        self,
        mi: Any,
        scene: Scene,
        tolerance: float,
        methods: Sequence[Method],
        *,
        follow_solids: bool = True,
    ) -> None:
        self._follow_solids = follow_solids
        self._mi, self._scene, self._tolerance, self._methods = mi, scene, tolerance, methods
        self.chooser = Chooser(mi, scene, tolerance, methods)
        self.obstructed = replace(scene, obstructed=True)
        self._solids = SolidsLight(scene, material_reflectance(mi, scene.material))
        self._following = [method for method in methods if method.among_solids]

    def plan(self, angles_rad: Sequence[float]) -> Plan:
        """Decide about a pose.

        Parameters
        ----------
        angles_rad : sequence of float
            True angles of the arm joints.

        Raises
        ------
        Refused
            No methods can compute what may not be skipped.
        """
        if not self._follow_solids:
            decision = self.chooser.decide(angles_rad)
            return Plan(
                decision, self._scene, SolidsAt(0.0, ""), None, self.obstructed, reached=decision.reached
            )
        solids, scene = self.solids(angles_rad), self._scene
        able = bool(self._following_able) and not scene.mirrors
        if solids.shadow and able:
            decision = self._among_solids.decide(angles_rad)
            return Plan(decision, self.obstructed, solids, None, self.obstructed, decision.reached)
        decision = self.chooser.decide(angles_rad)
        if decision.left_out + solids.share <= self._tolerance:
            return Plan(decision, scene, solids, None, self.obstructed, reached=not solids.shadow)
        if solids.share <= 0.5 * self._tolerance:
            strict = self._strict.decide(angles_rad)
            return Plan(strict, scene, solids, None, self.obstructed, strict.reached and not solids.shadow)
        if not able or not scene.plain:
            return Plan(decision, scene, solids, None, self.obstructed, reached=False)
        direct = self._direct.decide(angles_rad)
        stray = solids.share + sum(
            bound
            for path_class, bound in zip(decision.classes, decision.bounds, strict=True)
            if path_class.paths.with_events(2)
        )
        added = self._added(min(_ROUGHEST, 0.5 * self._tolerance / stray))
        whole = Decision(decision.classes, decision.bounds, direct.parts, (), self._tolerance)
        return Plan(whole, self._direct_scene, solids, added, self.obstructed, direct.reached)

    def solids(self, angles_rad: Sequence[float]) -> SolidsAt:
        """Tell what the machine's solids do at a pose, whether they take part or not."""
        return self._solids.at(angles_rad)

    @cached_property
    def _following_able(self) -> tuple[Method, ...]:
        """Methods that can compute all light but the direct among solids, the quickest first."""
        paths = light_paths(self.obstructed).with_events(2)
        able = [
            method
            for method in self._following
            if paths
            and paths <= method.covers
            and method.obstacle(self.obstructed, paths, vector=self._vector) is None
        ]
        return tuple(
            sorted(able, key=lambda m: m.seconds(self.obstructed, paths, _ROUGHEST, vector=self._vector))
        )

    def _added(self, tolerance: float) -> Part:
        paths, method = light_paths(self.obstructed).with_events(2), self._following_able[0]
        classes = tuple(c for c in self._among_solids.classes if c.paths.with_events(2))
        seconds = method.seconds(self.obstructed, paths, tolerance, vector=self._vector)
        return Part(method, classes, paths, seconds, tolerance, 0.0)

    @property
    def _vector(self) -> bool:
        return not self._mi.variant().startswith("scalar")

    @cached_property
    def _direct_scene(self) -> Scene:
        return replace(self._scene, housing=None)

    @cached_property
    def _strict(self) -> Chooser:
        return Chooser(self._mi, self._scene, 0.5 * self._tolerance, self._methods)

    @cached_property
    def _direct(self) -> Chooser:
        return Chooser(self._mi, self._direct_scene, 0.5 * self._tolerance, self._methods)

    @cached_property
    def _among_solids(self) -> Chooser:
        return Chooser(self._mi, self.obstructed, self._tolerance, self._following)
