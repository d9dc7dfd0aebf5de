"""What a laboratory asks about its light before it trusts a dark sample: which paths there are, and how much.

`explain` tells what would be computed and what skipped, with bounds, and renders nothing. `stray_light`
computes every path class by itself, each by the method that is quickest for it, and gives its share.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rig.kinematics import Kinematics
from rig.pixels import pixel_geometry
from simulator import bsdfs
from simulator.bands import seen_through
from simulator.light.choice import Chooser
from simulator.light.classes import light_paths
from simulator.light.methods import METHODS
from simulator.light.mitsuba_scene import sample_events
from simulator.light.scene import Scene, default_housing
from simulator.materials import parse_material
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rig.description import Rig
    from simulator.light.classes import PathClass
    from simulator.light.evaluator import Evaluator, Method

Pose = tuple[float, ...]

_LOWEST = 0.1
"""Least height of lamp and camera over the sample's plane, in units of their distance."""


def audit_scene(
    rig: Rig, material: str, *, housing_albedo: float = 0.0, variant: str | None = None
) -> tuple[Any, Scene]:
    """Return Mitsuba, and a material's scene.

    Parameters
    ----------
    rig : Rig
        The machine.
    material : str
        Its line; see `simulator.materials`.
    housing_albedo : float
        0 is black surroundings.
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
    return mi, Scene(rig, lies, sample_events(mi, lies), default_housing(rig, housing_albedo))


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
        "leaves_out"}], "skipped_bound", "reached"}]}``; method is None for what is skipped, and seconds are
        those of all that the method computes at the pose.

    Raises
    ------
    Refused
        No method covers the scene's light.
    """
    chooser = Chooser(mi, scene, tolerance, METHODS)
    told = []
    for pose in poses:
        decision = chooser.decide(pose)
        rows = []
        for path_class, bound in zip(decision.classes, decision.bounds, strict=True):
            part = decision.by(path_class)
            rows.append(
                {
                    "paths": path_class.name,
                    "bound": bound,
                    "method": part.method.name if part else None,
                    "seconds": part.seconds if part else None,
                    "leaves_out": part.leaves_out if part else None,
                }
            )
        told.append(
            {
                "angles_deg": np.degrees(pose).tolist(),
                "classes": rows,
                "skipped_bound": decision.skipped_bound,
                "reached": decision.reached,
            }
        )
    return {"paths": str(light_paths(scene)), "poses": told}


def stray_light(mi: Any, scene: Scene, poses: Sequence[Pose], tolerance: float) -> dict[str, Any]:
    """Compute the share of every path class at each pose.

    Parameters
    ----------
    mi, scene, poses
        As in `explain`.
    tolerance : float
        Error wanted of each class, relative to its own radiance.

    Returns
    -------
    dict
        ``{"paths", "classes", "poses": [{"angles_deg", "shares", "errors", "stray"}]}``: a share is the mean
        radiance of a class over the pixels of the sample, over that of all classes; None for a class that no
        method computes by itself, and for a sample that is not seen. `errors` are absolute errors of the
        shares, `stray` is the share of all that met more
        than one surface.
    """
    chooser = Chooser(mi, scene, tolerance, METHODS)
    alone = [_alone(mi, scene, chooser, path_class, tolerance) for path_class in chooser.classes]
    stray = np.array([bool(path_class.paths.with_events(2)) for path_class in chooser.classes])
    told = []
    for pose in poses:
        found = np.array([_mean(mi, scene, one, pose, tolerance) for one in alone]).reshape(-1, 2)
        total = np.nansum(found[:, 0])
        shares = found[:, 0] / total if total > 0.0 else np.full(len(found), np.nan)
        told.append(
            {
                "angles_deg": np.degrees(pose).tolist(),
                "shares": shares.tolist(),
                "errors": (shares * found[:, 1]).tolist(),
                "stray": float(np.nansum(shares[stray])) if total > 0.0 else None,
            }
        )
    names = [path_class.name for path_class in chooser.classes]
    return {"paths": str(light_paths(scene)), "classes": names, "poses": told}


def _alone(
    mi: Any, scene: Scene, chooser: Chooser, path_class: PathClass, tolerance: float
) -> tuple[Method, Evaluator] | None:
    """Set the quickest method to work on one class; None if there is none."""
    able = chooser.able(path_class)
    if not able:
        return None
    vector = not mi.variant().startswith("scalar")
    quickest = min(able, key=lambda method: method.seconds(scene, path_class.paths, tolerance, vector=vector))
    return quickest, quickest.build(mi, scene, path_class.paths)


def _mean(
    mi: Any, scene: Scene, alone: tuple[Method, Evaluator] | None, pose: Pose, tolerance: float
) -> tuple[float, float]:
    """Mean radiance of a class over the sample's pixels, and its relative error; NaN where unknown."""
    seen = pixel_geometry(scene.rig, pose).on_sample
    if alone is None or not seen.any():
        return np.nan, np.nan
    method, evaluator = alone
    rendering = evaluator.render(pose, tolerance)
    error = rendering.error + method.leaves_out(mi, scene, pose)
    return float(rendering.radiance[seen].mean()), error
