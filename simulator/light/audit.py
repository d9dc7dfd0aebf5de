"""What a laboratory asks about its light before it trusts a dark sample: which paths there are, and how much.

`explain` tells what would be computed and what skipped, with bounds, and renders nothing. `stray_light`
computes every path class by itself and gives its share: in one render of all classes that are best followed
from the camera, and by whatever method is quickest for each of the others.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator import bsdfs
from simulator.bands import seen_through
from simulator.light.choice import Chooser
from simulator.light.classes import light_paths
from simulator.light.methods import METHODS
from simulator.light.mitsuba_scene import sample_events
from simulator.light.path_classes import PathClasses, PathClassesMethod
from simulator.light.planner import Planner
from simulator.light.reflectance import material_reflectance
from simulator.light.scene import Scene, rig_housing, rig_mirrors
from simulator.light.solids import SolidsLight
from simulator.materials import parse_material
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rig.description import Rig
    from simulator.light.choice import Decision
    from simulator.light.evaluator import Evaluator, Method
    from simulator.light.path_tracer import Estimate
    from simulator.light.planner import Plan
    from simulator.light.solids import SolidsAt

Pose = tuple[float, ...]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_FEWEST_RENDERS, _MOST_RENDERS = 4, 64
_LOOK = 0.5
"""Relative error of a first look at a class by itself, which tells how much it matters."""
_STRAY_ERROR = 0.02
"""Error of a pose's stray light, relative to itself, at which its classes are known well enough."""
_LOWEST = 0.1
"""Least height of lamp and camera over the sample's plane, in units of their distance."""


def audit_scene(
    rig: Rig, material: str, *, housing_albedo: float | None = None, variant: str | None = None
) -> tuple[Any, Scene]:
    """Return Mitsuba, and a material's scene.

    Parameters
    ----------
    rig : Rig
        The machine.
    material : str
        Its line; see `simulator.materials`.
    housing_albedo : float, optional
        0 is black surroundings; by default what the rig file says.
    variant : str, optional
        Of Mitsuba; by default the fastest that can run.

    Raises
    ------
    BadInput
        The material, the albedo or the variant is wrong.
    """
    mi = load_mitsuba(variant)
    bsdfs.register(mi)
    lies = seen_through(rig, parse_material(material), 1e-4)
    housing, mirrors = rig_housing(rig, housing_albedo), rig_mirrors(rig)
    return mi, Scene(rig, lies, sample_events(mi, lies), housing, mirrors)


def audit_poses(rig: Rig, count: int, seed: int) -> list[Pose]:
    """Draw poses within the joints' limits at which lamp and camera see the sample.

    Parameters
    ----------
    rig : Rig
        The machine.
    count : int
        How many; fewer where nearly none of the machine's poses see it.
    seed : int
        Decides which.

    Returns
    -------
    list of tuple of float
        Joint angles in radians, in the order of `rig.arm_joints`.
    """
    rng, kinematics = np.random.default_rng(seed), Kinematics(rig)
    limits = np.radians([joint.limits_deg for joint in rig.arm_joints])
    poses: list[Pose] = []
    for angles in rng.uniform(limits[:, 0], limits[:, 1], (1000 * count, len(limits))):
        frames = kinematics.frames(angles)
        heights = frames.light_mm[2] / rig.lamp.distance_mm, frames.camera_mm[2] / rig.camera.distance_mm
        if min(heights) > _LOWEST:
            poses.append(tuple(angles.tolist()))
        if len(poses) == count:
            break
    return poses


def explain(mi: Any, scene: Scene, poses: Sequence[Pose], tolerance: float) -> dict[str, Any]:
    """Tell what would be done at each pose.

    Parameters
    ----------
    mi : module
        Mitsuba, `simulator.bsdfs` registered.
    scene : Scene
    poses : sequence of tuple of float
        Joint angles in radians.
    tolerance : float
        Relative error that is allowed.

    Returns
    -------
    dict
        ``{"paths", "poses": [{"angles_deg", "classes": [{"paths", "bound", "method", "seconds",
        "leaves_out"}], "skipped_bound", "solids": {"bound", "shadow", "followed", "method", "seconds"},
        "reached"}]}``; method is None for what is skipped, and seconds are those of all that the method
        computes at the pose. `solids` are the machine's: what they add at most, which one casts a shadow, and
        how their light is computed, on top of the classes or with them, if they are followed (`twin.solids`
        of the rig file).

    Raises
    ------
    Refused
        No method covers the scene's light.
    """
    followed = scene.rig.twin.solids
    planner = Planner(mi, scene, tolerance, METHODS, follow_solids=followed)
    told = []
    for pose in poses:
        plan, solids = planner.plan(pose), planner.solids(pose)
        decision, rows = plan.decision, []
        for path_class, bound in zip(decision.classes, decision.bounds, strict=True):
            part = decision.by(path_class)
            if part is None and path_class not in decision.skipped:
                part = plan.added
            rows.append(
                {
                    "paths": path_class.name,
                    "bound": bound,
                    "method": part.method.name if part else None,
                    "seconds": part.seconds if part else None,
                    "leaves_out": part.leaves_out if part else None,
                }
            )
        added = plan.added
        told.append(
            {
                "angles_deg": np.degrees(pose).tolist(),
                "classes": rows,
                "skipped_bound": decision.skipped_bound,
                "solids": {
                    "bound": solids.share,
                    "shadow": solids.shadow or None,
                    "followed": followed,
                    "method": added.method.name if added else _followed(plan),
                    "seconds": added.seconds if added else None,
                },
                "reached": plan.reached and (followed or _dispensable(solids, decision, tolerance)),
            }
        )
    return {"paths": str(light_paths(scene)), "poses": told}


def _dispensable(solids: SolidsAt, decision: Decision, tolerance: float) -> bool:
    """Whether the solids can be left out beside what is left out already."""
    return not solids.shadow and decision.left_out + solids.share <= tolerance


def _followed(plan: Plan) -> str | None:
    """Return the method that follows light among the solids, if all light is."""
    return plan.decision.parts[0].method.name if plan.scene.obstructed and plan.decision.parts else None


def stray_light(
    mi: Any,
    scene: Scene,
    poses: Sequence[Pose],
    tolerance: float,
    progress: Callable[[], object] = lambda: None,
) -> dict[str, Any]:
    """Compute the share of every path class at each pose.

    Parameters
    ----------
    mi, scene, poses
        As in `explain`.
    tolerance : float
        Error wanted of each share. Those of stray light are computed to 2 % of all stray light of their pose
        besides, so that a small sum is not lost in the tolerance, and no class is followed further than it
        matters to that sum.
    progress : callable, optional
        Called after each pose.

    Returns
    -------
    dict
        ``{"paths", "classes", "poses": [{"angles_deg", "shares", "errors", "stray", "solids"}]}``: a share is
        the mean radiance of a class over the sample's pixels, over that of all classes; None for a class that
        no method computes by itself, and for a sample that is not seen. `errors` are absolute errors of the
        shares, `stray` is the share of all that met more
        than one surface. The machine's solids are part of the scene, but for mirrors beside the sample and
        in a scalar variant, which cannot tell classes apart among them: then `solids` bounds what they add.
    """
    solids = SolidsLight(scene, material_reflectance(mi, scene.material))
    if not scene.mirrors and not mi.variant().startswith("scalar"):
        scene = replace(scene, obstructed=bool(scene.rig.solids))
    methods = [method for method in METHODS if method.among_solids or not scene.obstructed]
    chooser = Chooser(mi, scene, tolerance, methods)
    classes = chooser.classes
    means = [*_traced(mi, scene, chooser, tolerance), *_alone(mi, scene, chooser, tolerance)]
    stray = np.array([bool(path_class.paths.with_events(2)) for path_class in classes], dtype=bool)
    told = []
    for pose in poses:
        found = _found(pose, _seen(scene, pose), means, stray, tolerance)
        total = np.nansum(found[:, 0])
        shares = found[:, 0] / total if total > 0.0 else np.full(len(found), np.nan)
        told.append(
            {
                "angles_deg": np.degrees(pose).tolist(),
                "shares": shares.tolist(),
                "errors": (found[:, 1] / total if total > 0.0 else shares).tolist(),
                "stray": float(np.nansum(shares[stray])) if total > 0.0 else None,
                "solids": None if scene.obstructed else solids.at(pose).share,
            }
        )
        progress()
    names = [path_class.name for path_class in classes]
    return {"paths": str(light_paths(scene)), "classes": names, "poses": told}


_Means = tuple[list[int], "Callable[[Pose, Bools, float], Array]"]
"""Numbers of classes, and what gives their mean radiances over pixels and the errors of those, (C, 2), given
the error that is allowed."""


def _found(pose: Pose, seen: Bools, means: Sequence[_Means], stray: Bools, tolerance: float) -> Array:
    """Mean radiance of every class and its error, (C, 2): looked at first, then as exactly as it matters."""
    found = np.full((len(stray), 2), np.nan)
    if not seen.any():
        return found
    for numbers, mean in means:
        found[numbers] = mean(pose, seen, np.inf)
    total, added = np.nansum(found[:, 0]), np.nansum(found[stray, 0])
    allowed = np.where(stray, min(tolerance * total, _STRAY_ERROR * added), tolerance * total)
    for numbers, mean in means:
        if np.any(found[numbers, 1] > allowed[numbers]):
            found[numbers] = mean(pose, seen, float(allowed[numbers].min()))
    return found


def _quickest(mi: Any, scene: Scene, chooser: Chooser, tolerance: float) -> dict[int, Method]:
    """Return the method that is quickest for each class by itself, by its number; none for some."""
    vector, found = not mi.variant().startswith("scalar"), {}
    for number, path_class in enumerate(chooser.classes):
        able = chooser.able(path_class)
        if able:
            found[number] = min(
                able, key=lambda method: method.seconds(scene, path_class.paths, tolerance, vector=vector)
            )
    return found


def _traced(mi: Any, scene: Scene, chooser: Chooser, tolerance: float) -> list[_Means]:
    """Return the means of all classes that paths from the camera serve best: one render has them all."""
    quickest = _quickest(mi, scene, chooser, tolerance)
    numbers = [number for number, method in quickest.items() if isinstance(method, PathClassesMethod)]
    if not numbers:
        return []
    classes = PathClasses(mi, scene, [chooser.classes[number].paths for number in numbers])

    def mean(pose: Pose, seen: Bools, allowed: float) -> Array:
        renders = _FEWEST_RENDERS
        while True:
            found = np.array([_mean_of(estimate, seen) for estimate in classes.estimates(pose, renders)])
            if np.all(found[:, 1] <= allowed) or renders >= _MOST_RENDERS:
                return found
            renders *= 2

    return [(numbers, mean)]


def _mean_of(estimate: Estimate, seen: Bools) -> tuple[float, float]:
    """Mean over pixels and channels, and its standard error: pixels' noises are independent."""
    noise = np.sqrt(np.mean(np.square(estimate.standard_error[seen].mean(axis=-1))) / np.count_nonzero(seen))
    return float(estimate.mean[seen].mean()), float(noise)


def _alone(mi: Any, scene: Scene, chooser: Chooser, tolerance: float) -> list[_Means]:
    """Return the means of classes that other methods serve best, each by itself."""
    found: list[_Means] = []
    for number, method in _quickest(mi, scene, chooser, tolerance).items():
        if isinstance(method, PathClassesMethod):
            continue
        evaluator = method.build(mi, scene, chooser.classes[number].paths)

        def mean(
            pose: Pose, seen: Bools, allowed: float, *, method: Method = method, by: Evaluator = evaluator
        ) -> Array:
            rendering = by.render(pose, _LOOK)
            level = float(rendering.radiance[seen].mean())
            if level * rendering.error > allowed:
                rendering = by.render(pose, allowed / level)
                level = float(rendering.radiance[seen].mean())
            return np.array([[level, level * (rendering.error + method.leaves_out(mi, scene, pose))]])

        found.append(([number], mean))
    return found


def _seen(scene: Scene, pose: Pose) -> Bools:
    """Tell which pixels see the sample's disc."""
    return pixel_geometry(scene.rig, pose).on_sample
