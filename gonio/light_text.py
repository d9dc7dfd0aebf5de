"""Answers of `gonio sim --explain` and `--stray` as text, or as one JSON object."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from gonio.output import Progress, print_json
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse

_DEFAULT_MATERIAL = "lambert:kd=0.5"


def audit(options: argparse.Namespace) -> int:
    """Answer for every material asked about.

    Parameters
    ----------
    options : argparse.Namespace
        Of `gonio sim`.

    Returns
    -------
    int
        0.

    Raises
    ------
    BadInput
        An option, a material or the rig file is wrong.
    Refused
        No method covers the light of a scene.
    """
    from rig.description import default_rig, load_rig
    from rig.surroundings import parse_mirror
    from simulator.light.audit import audit_poses, audit_scene, explain, stray_light
    from simulator.options import check_light

    if options.explain and options.stray:
        raise BadInput("--explain and --stray together", where="gonio sim", todo="ask one at a time")
    check_light(options)
    if options.poses < 1:
        raise BadInput(f"{options.poses} poses", where="--poses", todo="ask for at least 1")
    rig = load_rig(options.rig) if options.rig else default_rig()
    if options.mirror:
        mirrors = tuple(parse_mirror(line) for line in options.mirror)
        rig = rig.model_copy(update={"twin": rig.twin.model_copy(update={"mirrors": mirrors})})
    tolerance = rig.twin.tolerance if options.tolerance is None else options.tolerance
    albedo = rig.twin.housing_albedo if options.housing_albedo is None else options.housing_albedo
    poses = audit_poses(rig, options.poses, options.seed)
    materials = options.material or [_DEFAULT_MATERIAL]
    answers: dict[str, Any] = {}
    progress = Progress("poses", len(materials) * len(poses))
    for material in materials:
        mi, scene = audit_scene(rig, material, housing_albedo=albedo, variant=options.variant)
        if options.explain:
            answers[material] = explain(mi, scene, poses, tolerance)
        else:
            answers[material] = stray_light(mi, scene, poses, tolerance, progress)
    if options.json:
        print_json(
            {
                "joints": [joint.name for joint in rig.arm_joints],
                "housing_albedo": albedo,
                "tolerance": tolerance,
                "materials": answers,
            }
        )
        return 0
    for material, answer in answers.items():
        print(f"{material}: light paths {answer['paths'] or 'none'}")
        for pose in answer["poses"]:
            print(f"\n  {_angles(pose['angles_deg'], rig.arm_joints)}")
            _print_explained(pose, tolerance) if options.explain else _print_stray(answer, pose)
        print()
    return 0


def _angles(angles_deg: list[float], joints: Any) -> str:
    return ", ".join(f"{joint.name} {angle:.1f} deg" for joint, angle in zip(joints, angles_deg, strict=True))


def _print_explained(pose: dict[str, Any], tolerance: float) -> None:
    print(f"    {'paths':<20} {'at most':>10}  method")
    for row in pose["classes"]:
        method = "skipped"
        if row["method"]:
            method = f"{row['method']}, about {1e3 * row['seconds']:.0f} ms"
            if row["leaves_out"]:
                method += f", leaves out {row['leaves_out']:.1e}"
        print(f"    {row['paths']:<20} {row['bound']:>10.2e}  {method}")
    _print_solids(pose["solids"])
    verdict = "within" if pose["reached"] else "NOT within"
    print(f"    skipped: at most {pose['skipped_bound']:.1e} of the light; {verdict} {tolerance:g} in all")


def _print_solids(solids: dict[str, Any]) -> None:
    if solids["bound"] == 0.0 and not solids["shadow"]:
        return
    what = "skipped" if solids["followed"] else "left out: the rig file's twin.solids is false"
    if solids["method"]:
        what = solids["method"]
        if solids["seconds"] is not None:
            what += f", about {1e3 * solids['seconds']:.0f} ms"
    if solids["shadow"]:
        what += f"; shadow of {solids['shadow']}"
    print(f"    {'solids':<20} {solids['bound']:>10.2e}  {what}")


def _print_stray(answer: dict[str, Any], pose: dict[str, Any]) -> None:
    print(f"    {'paths':<20} {'share':>10}  {'+-':>8}")
    for name, share, error in zip(answer["classes"], pose["shares"], pose["errors"], strict=True):
        known = not math.isnan(share)
        print(f"    {name:<20} {share:>10.3e}  {error:>8.1e}" if known else f"    {name:<20} {'unknown':>10}")
    if pose["stray"] is not None:
        print(f"    stray light: {100.0 * pose['stray']:.3f} % of all")
    if pose["solids"]:
        print(f"    the machine's solids, besides: at most {100.0 * pose['solids']:.3f} %")
