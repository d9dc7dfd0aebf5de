"""Light that meets the sample once, LDE, of a lamp with a size, seen by pixels with a size through a pupil.

The radiance of a pixel is the mean of f_r E over the lamp's disc, the pixel's box and the entrance pupil. It
is a sum over nodes, as many as the pose needs (`simulator.light.direct_search`), in float64 or through
Mitsuba's BSDFs. A flat sample in black surroundings shadows nothing. A pixel that the sample's edge crosses
holds the share of it that the sample fills; its nodes are taken as if the sample went on.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rig.kinematics import Kinematics
from simulator.light.costs import value_s
from simulator.light.direct_float64 import Float64Nodes
from simulator.light.direct_llvm import MitsubaNodes
from simulator.light.direct_search import CAUTION, MOST_NODES, Search
from simulator.light.direct_view import extents_of, lens_of, view_of
from simulator.light.evaluator import Evaluator, Method, Rendering
from simulator.light.finite_size import pose_error, pose_errors
from simulator.light.paths import LightPaths
from simulator.light.reflectance import closed_form_reflectance, mitsuba_reflectance
from simulator.light.sparse_rules import CENTRES, Levels, product_rule, sparse_rule
from simulator.materials import NOT_RENDERED

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rig.description import Rig
    from simulator.light.direct_view import Extents, Lens, View
    from simulator.light.scene import Scene
    from simulator.light.sparse_rules import Rule

Array = NDArray[np.float64]

LOOKED_AT = 64
"""Rows and columns of pixels that the search looks at, evenly spread over the frame."""
SLOPED_AT = 16
"""Likewise where it is estimated how fast radiance changes with direction."""
TOGETHER = 1 << 20
"""Pixels of all poses of one launch."""
FLOAT64_NODE_S, MITSUBA_NODE_S, LAUNCHES_S = 2.5e-7, 6e-8, 3e-3
"""Processor seconds per node of a pixel in float64, through LLVM; and of LLVM's launches."""
COARSE, FEW_NODES = 1e-3, 13
"""Tolerance that centres alone mostly meet, and nodes that mostly do for finer ones."""
_CENTRE = product_rule(CENTRES)
_NUDGE = 1e-4
"""Step of the lamp that tells how fast radiance changes with direction, in radians."""


class Nodes(Protocol):
    """What evaluates nodes: `Float64Nodes`, `MitsubaNodes`.

    Attributes
    ----------
    rounding : float
        Relative error (RMS) of a radiance where f_r is constant.
    step_rad : float
        Error (RMS) of a direction.
    """

    @property
    def rounding(self) -> float:
        """See above."""

    @property
    def step_rad(self) -> float:
        """See above."""

    def radiance(self, views: Sequence[View], lens: Lens, rule: Rule) -> Array:
        """Mean radiance (P, N, 3) of N pixels over a rule's nodes, for P views."""


class DirectLight(Evaluator):
    """Direct light by adaptive quadrature.

    Parameters
    ----------
    rig : Rig
        The machine.
    nodes : Nodes
        What evaluates them.
    extents : Extents
        Of lamp, pixel and pupil: those that `nodes` has.
    """

    def __init__(self, rig: Rig, nodes: Nodes, extents: Extents) -> None:
        self._rig = rig
        self._nodes = nodes
        self._extents = extents
        self._kinematics = Kinematics(rig)
        self._lens = lens_of(rig)
        self._looked_at = self._lens[_spread(rig, LOOKED_AT)]
        self._sloped_at = self._lens[_spread(rig, SLOPED_AT)]

    def render(self, angles_rad: Sequence[float], tolerance: float) -> Rendering:
        """Compute the radiance of a pose; see `Evaluator.render`."""
        return next(self.render_many([angles_rad], tolerance))

    def render_many(self, poses_rad: Iterable[Sequence[float]], tolerance: float) -> Iterator[Rendering]:
        """Compute many poses, as many at once as fit into a launch; see `Evaluator.render_many`."""
        size, batch = max(1, TOGETHER // len(self._lens)), []
        for angles_rad in poses_rad:
            batch.append(self._view(angles_rad))
            if len(batch) == size:
                yield from self._batch(batch, tolerance)
                batch = []
        if batch:
            yield from self._batch(batch, tolerance)

    def _view(self, angles_rad: Sequence[float]) -> View:
        return view_of(self._kinematics.frames(np.asarray(angles_rad)), self._extents)

    def _batch(self, views: Sequence[View], tolerance: float) -> Iterator[Rendering]:
        rounding = self._rounding(views)
        searches = [Search(self._extents.parts, tolerance - floor, floor) for floor in rounding]
        self._search(views, searches)
        radiance: dict[int, Array] = {}
        for levels in {search.taken for search in searches}:
            those = [place for place, search in enumerate(searches) if search.taken == levels]
            found = self._nodes.radiance([views[place] for place in those], self._lens, sparse_rule(levels))
            radiance |= dict(zip(those, found, strict=True))
        shape = (self._rig.camera.height_px, self._rig.camera.width_px, 3)
        for place, (search, floor) in enumerate(zip(searches, rounding, strict=True)):
            rule = sparse_rule(search.taken)
            highest = Levels(*(max(part) for part in zip(*search.taken, strict=True)))
            did = (
                f"{len(rule.weights)} nodes per pixel: levels {highest.lamp} on the lamp, {highest.pixel} on "
                f"the pixel, {highest.pupil} on the pupil"
            )
            yield Rendering(radiance[place].reshape(shape), search.error + float(floor), did)

    def _search(self, views: Sequence[View], searches: Sequence[Search]) -> None:
        """Search for all poses at once."""
        while any(search.wanted for search in searches):
            found: list[dict[Levels, Array]] = [{} for _ in searches]
            for levels in {levels for search in searches for levels in search.wanted}:
                those = [place for place, search in enumerate(searches) if levels in search.wanted]
                values = self._look([views[place] for place in those], levels)
                for place, value in zip(those, values, strict=True):
                    found[place][levels] = value
            for search, told in zip(searches, found, strict=True):
                if told:
                    search.tell(told)

    def _look(self, views: Sequence[View], levels: Levels) -> Array:
        return self._nodes.radiance(views, self._looked_at, product_rule(levels))

    def _rounding(self, views: Sequence[View]) -> list[float]:
        """Estimate what the arithmetic loses: an error of directions counts by the radiance's slope."""
        if self._nodes.step_rad == 0.0:
            return [self._nodes.rounding] * len(views)
        steps_mm = [_NUDGE * np.linalg.norm(view.light_mm) * view.light_axes for view in views]
        moved = [
            replace(view, light_mm=view.light_mm + step)
            for view, both in zip(views, steps_mm, strict=True)
            for step in (0.0 * both[0], *both)
        ]
        values = self._nodes.radiance(moved, self._sloped_at, _CENTRE).reshape(len(views), 3, -1)
        slopes = np.sqrt(np.sum(np.square(values[:, 1:] - values[:, :1]), axis=(1, 2))) / _NUDGE
        count = np.sqrt(np.count_nonzero(values[:, 0], axis=1))
        mean = np.sum(np.abs(values[:, 0]), axis=1) / np.maximum(count, 1.0)
        relative = np.divide(slopes, mean, out=np.zeros_like(mean), where=mean > 0.0)
        return [self._nodes.rounding + self._nodes.step_rad * float(slope) for slope in relative]


def predicted_s(scene: Scene, tolerance: float, node_s: float, centres: float = COARSE) -> float:
    """Predict the time of a pose from that of a node of a pixel, and the error of the pixels' centres alone.

    Each further level is a quarter of what is left, or less, and costs four times as much.
    """
    camera = scene.rig.camera
    looked_at = min(camera.width_px, LOOKED_AT) * min(camera.height_px, LOOKED_AT)
    pixels = camera.width_px * camera.height_px
    short = CAUTION * centres / tolerance
    taken = 1.0 if short <= 1.0 else min(FEW_NODES * short**0.5, MOST_NODES)
    return node_s * ((FEW_NODES if taken == 1.0 else 4.0 * taken + FEW_NODES) * looked_at + pixels * taken)


def _spread(rig: Rig, most: int) -> NDArray[np.intp]:
    """Return pixels in up to so many rows and columns, evenly spread."""
    rows, cols = (
        ((np.arange(count) + 0.5) * size / count).astype(np.intp)
        for size in (rig.camera.height_px, rig.camera.width_px)
        for count in [min(size, most)]
    )
    return (rows[:, None] * rig.camera.width_px + cols).ravel()


class _DirectMethod(Method):
    """What both rows of direct light have in common."""

    covers = LightPaths("LDE")

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:  # noqa: ARG002
        """Nothing is against it: flat samples are all that it is asked about."""
        return None

    def seconds(self, scene: Scene, paths: LightPaths, tolerance: float, *, vector: bool) -> float:  # noqa: ARG002
        """Predict the time of a pose; see `Method.seconds`."""
        return self._seconds(scene, tolerance, COARSE, vector=vector)

    def foresee(self, mi: Any, scene: Scene, poses_rad: Sequence[tuple[float, ...]]) -> None:
        """Estimate for many poses at once; see `Method.foresee`."""
        if scene.plain:
            pose_errors(mi, scene, poses_rad)

    def seconds_at(
        self,
        mi: Any,
        scene: Scene,
        paths: LightPaths,  # noqa: ARG002
        tolerance: float,
        angles_rad: Sequence[float],
        *,
        vector: bool,
    ) -> float:
        """Predict the time of a certain pose: narrow lobes need more nodes; see `Method.seconds_at`."""
        return self._seconds(scene, tolerance, pose_error(mi, scene, tuple(angles_rad)), vector=vector)

    @abstractmethod
    def _seconds(self, scene: Scene, tolerance: float, centres: float, *, vector: bool) -> float:
        """Predict the time of a pose whose pixels' centres alone have a certain error."""


class DirectFloat64(_DirectMethod):
    """Direct light in float64; a material without a closed form is asked for through Mitsuba."""

    name = "direct light by quadrature in float64"

    def _seconds(self, scene: Scene, tolerance: float, centres: float, *, vector: bool) -> float:
        node_s = FLOAT64_NODE_S + value_s(scene.material, vector=vector)
        return predicted_s(scene, tolerance, node_s, centres)

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> DirectLight:  # noqa: ARG002
        """Set it to work; see `Method.build`."""
        if scene.material.has_closed_form:
            reflectance = closed_form_reflectance(scene.material)
        else:
            reflectance = mitsuba_reflectance(mi, scene.material)
        extents = extents_of(scene.rig)
        return DirectLight(scene.rig, Float64Nodes(reflectance, extents, scene.sample_radius_mm), extents)


class DirectMitsuba(_DirectMethod):
    """Direct light through Mitsuba's BSDFs, vectorised."""

    name = "direct light by quadrature through Mitsuba"

    def obstacle(self, scene: Scene, paths: LightPaths, *, vector: bool) -> str | None:  # noqa: ARG002
        """Say why it cannot; see `Method.obstacle`."""
        if not scene.material.rendered:
            return NOT_RENDERED
        return None if vector else "it needs the LLVM variant"

    def _seconds(self, scene: Scene, tolerance: float, centres: float, *, vector: bool) -> float:  # noqa: ARG002
        return LAUNCHES_S + predicted_s(scene, tolerance, MITSUBA_NODE_S, centres)

    def build(self, mi: Any, scene: Scene, paths: LightPaths) -> DirectLight:  # noqa: ARG002
        """Set it to work; see `Method.build`."""
        extents = extents_of(scene.rig)
        return DirectLight(
            scene.rig, MitsubaNodes(mi, scene.material, extents, scene.sample_radius_mm), extents
        )
