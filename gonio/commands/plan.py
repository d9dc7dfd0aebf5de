"""Poses to a TOML plan, with what a machine makes of it: refusals, duration, disk, coverage.

grid        every combination of --theta-i-deg, --theta-o-deg and --phi-deg
sweep       in the plane of incidence; --theta-o-deg is signed, positive on the mirror's side
specular    about the mirror direction; --offset-deg is how far beyond it
hemisphere  --count camera directions spread evenly, for each --theta-i-deg
csv         a list of poses: theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg
show        what a machine makes of a plan that is there already

Angles are degrees: a list (0,15,30), a range with step (0:60:15), or both (0:60:15,65,70).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.output import add_json_option, print_json, say
from rig.errors import BadInput

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from capture.itinerary import Itinerary
    from capture.plan import Plan

EXAMPLE = "gonio plan grid --theta-i-deg 0:60:15 --theta-o-deg 0:75:15 --rig rig.toml --out plan.toml"

LISTED = 5
"""Refused poses that are printed; with --json all are."""

_LONGEST_RANGE = 10_000


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    kinds = parser.add_subparsers(
        dest="kind", required=True, metavar="grid|sweep|specular|hemisphere|csv|show"
    )
    _kind(kinds, "grid", "every combination of angles", theta_i=True, theta_o=True, phi=True)
    _kind(kinds, "sweep", "in the plane of incidence", theta_i=True, theta_o=True)
    specular = _kind(kinds, "specular", "about the mirror direction", theta_i=True)
    specular.add_argument(
        "--offset-deg", default="0", metavar="ANGLES", help="camera beyond the mirror direction"
    )
    hemisphere = _kind(kinds, "hemisphere", "camera directions spread evenly", theta_i=True)
    hemisphere.add_argument("--count", type=int, required=True, metavar="N", help="for each light direction")
    hemisphere.add_argument("--theta-o-max-deg", type=float, default=75.0, metavar="DEG", help="default: 75")
    table = _kind(kinds, "csv", "a list of poses")
    table.add_argument("table", type=Path, metavar="FILE", help="theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg")
    table.add_argument("--skip-refused", action="store_true", help="leave out what the machine cannot take")
    show = kinds.add_parser("show", help="a plan that is there already")
    show.add_argument("plan", type=Path, metavar="PLAN")
    show.add_argument("--rig", type=Path, default=Path("rig.toml"), metavar="FILE", help="default: rig.toml")
    add_json_option(show)


def _kind(
    kinds: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    text: str,
    *,
    theta_i: bool = False,
    theta_o: bool = False,
    phi: bool = False,
) -> argparse.ArgumentParser:
    parser = kinds.add_parser(name, help=text, description=text)
    if theta_i:
        parser.add_argument("--theta-i-deg", required=True, metavar="ANGLES", help="light, from the normal")
        phi_i = "0" if phi else 0.0
        parser.add_argument(
            "--phi-i-deg", default=phi_i, metavar="ANGLES" if phi else "DEG", help="light's azimuth"
        )
    if theta_o:
        parser.add_argument("--theta-o-deg", required=True, metavar="ANGLES", help="camera, from the normal")
    if phi:
        parser.add_argument(
            "--phi-deg", default="180", metavar="ANGLES", help="camera's azimuth minus the light's"
        )
    parser.add_argument(
        "--rig", type=Path, default=Path("rig.toml"), metavar="FILE", help="default: rig.toml"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("plan.toml"), metavar="FILE", help="default: plan.toml"
    )
    parser.add_argument("--name", default="", help="title of the session; default: the sample's name")
    parser.add_argument(
        "--sample", default="sample1", help="station or label of the sample; default: sample1"
    )
    parser.add_argument(
        "--snr", type=float, default=30.0, help="wanted in the dim part, per pixel; default: 30"
    )
    parser.add_argument("--max-frames", type=int, default=4, help="for one pose; default: 4")
    parser.add_argument("--first-s", type=float, default=0.02, help="the first exposure; default: 0.02")
    parser.add_argument(
        "--darks", type=int, default=3, help="dark frames at each of two exposures; default: 3"
    )
    parser.add_argument(
        "--trap-every",
        type=int,
        default=0,
        metavar="N",
        help="shoot the light trap at every so many poses, for the stray light; default: 0, not at all",
    )
    parser.add_argument(
        "--mark-spoiled",
        action="store_true",
        help="measure poses whose sample is shaded or hidden, or with the lamp in the picture, and mark them",
    )
    parser.add_argument("--no-white", action="store_true", help="do not shoot the white reference")
    add_json_option(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Write the plan and tell what a machine makes of it."""
    from capture.itinerary import lay_out
    from capture.plan import dump_plan, load_plan, plan_from
    from rig.description import load_rig

    rig = load_rig(options.rig)
    plan = load_plan(options.plan) if options.kind == "show" else plan_from(_content(options), "gonio plan")
    itinerary = lay_out(plan, rig)
    written = options.plan if options.kind == "show" else options.out
    if options.kind != "show":
        dump_plan(plan, written)
    _print(itinerary, plan, written, json=options.json)
    return 0


def _content(options: argparse.Namespace) -> dict[str, Any]:
    generators: dict[str, Callable[[argparse.Namespace], dict[str, Any]]] = {
        "grid": lambda o: {
            "theta_i_deg": _angles(o.theta_i_deg, "--theta-i-deg"),
            "theta_o_deg": _angles(o.theta_o_deg, "--theta-o-deg"),
            "phi_deg": _angles(o.phi_deg, "--phi-deg"),
            "phi_i_deg": _angles(o.phi_i_deg, "--phi-i-deg"),
        },
        "sweep": lambda o: {
            "theta_i_deg": _angles(o.theta_i_deg, "--theta-i-deg"),
            "theta_o_deg": _angles(o.theta_o_deg, "--theta-o-deg"),
            "phi_i_deg": _angle(o.phi_i_deg, "--phi-i-deg"),
        },
        "specular": lambda o: {
            "theta_i_deg": _angles(o.theta_i_deg, "--theta-i-deg"),
            "offset_deg": _angles(o.offset_deg, "--offset-deg"),
            "phi_i_deg": _angle(o.phi_i_deg, "--phi-i-deg"),
        },
        "hemisphere": lambda o: {
            "theta_i_deg": _angles(o.theta_i_deg, "--theta-i-deg"),
            "count": o.count,
            "theta_o_max_deg": o.theta_o_max_deg,
            "phi_i_deg": _angle(o.phi_i_deg, "--phi-i-deg"),
        },
        "csv": lambda o: {"directions_deg": _table(o.table)},
    }
    kind = "list" if options.kind == "csv" else options.kind
    strict = options.kind == "csv" and not options.skip_refused
    return {
        "version": 1,
        "plan": {
            "name": options.name or options.sample,
            "sample": options.sample,
            "white": "none" if options.no_white else "poses",
            "refused": "stop" if strict else "skip",
            "spoiled": "mark" if options.mark_spoiled else "drop",
        },
        "exposure": {"snr": options.snr, "first_s": options.first_s, "max_frames": options.max_frames},
        "darks": {"count": options.darks},
        "trap": {"every": options.trap_every},
        "poses": [{"kind": kind, **generators[options.kind](options)}],
    }


def _table(path: Path) -> list[list[float]]:
    from capture.poses import read_csv

    return [list(row) for row in read_csv(path)]


def _angles(text: str, option: str) -> list[float]:
    """Read a list of angles and ranges: first:last:step includes its ends."""
    angles: list[float] = []
    for part in text.split(","):
        ends = [_angle(number, option) for number in part.split(":")]
        if len(ends) == 1:
            angles.append(ends[0])
            continue
        if len(ends) != 3 or ends[2] == 0.0 or (ends[1] - ends[0]) / ends[2] < 0.0:
            raise BadInput(
                f"{part!r} is no range", where=option, todo="write first:last:step, such as 0:60:15"
            )
        count = math.floor((ends[1] - ends[0]) / ends[2] + 1e-9) + 1
        if count > _LONGEST_RANGE:
            raise BadInput(f"{part!r} has {count} angles", where=option, todo="take a larger step")
        angles += [round(ends[0] + number * ends[2], 9) for number in range(count)]
    return angles


def _angle(text: str | float, option: str) -> float:
    try:
        angle = float(text)
    except ValueError:
        angle = math.nan
    if not math.isfinite(angle):
        raise BadInput(
            f"{text!r} is no angle", where=option, todo="write degrees, such as 0,15,30 or 0:60:15"
        )
    return angle


def _print(itinerary: Itinerary, plan: Plan, written: Path, *, json: bool) -> None:
    forecast, feasible = itinerary.forecast(), itinerary.feasible
    refusals = feasible.refusals
    coverage = itinerary.coverage()
    if json:
        listed, marked = (
            [{"pose": r.index, "reason": r.reason.value, "detail": r.detail} for r in some]
            for some in (refusals, feasible.marks)
        )
        print_json(
            {
                "plan": str(written),
                "hash": plan.hash,
                "poses": forecast.poses,
                "repeats": forecast.repeats,
                "refused": listed,
                "refused_by": forecast.refused_by,
                "marked": marked,
                "marked_by": forecast.marked_by,
                "detours": forecast.detours,
                "frames": forecast.frames,
                "travel_s": forecast.travel_s,
                "duration_s": forecast.duration_s,
                "disk_bytes": forecast.disk_bytes,
                "coverage": coverage,
            }
        )
        return
    repeated = f" ({forecast.repeats} named more than once)" if forecast.repeats else ""
    print(f"{written}: {_poses(forecast.poses)}{repeated}, plan {plan.hash[:8]}")
    print(
        f"predicted: {_duration(forecast.duration_s)}, of that {_duration(forecast.travel_s)} travel; "
        f"{forecast.frames} frames, {forecast.disk_bytes / 1e6:.0f} MB"
    )
    print(
        f"covers:    theta_i {coverage['theta_i_min_deg']:.1f} to {coverage['theta_i_max_deg']:.1f} deg "
        f"({coverage['light_directions']} directions), theta_o {coverage['theta_o_min_deg']:.1f} to "
        f"{coverage['theta_o_max_deg']:.1f} deg ({coverage['camera_directions']}); {coverage['in_plane']} in "
        f"plane, {coverage['near_specular']} within 5 deg of the mirror direction"
    )
    if forecast.detours:
        print(f"detours:   {forecast.detours} moves go round solids")
    for reason, count in forecast.marked_by.items():
        say(f"marked:    {_poses(count)}: {reason}")
    for reason, count in forecast.refused_by.items():
        say(f"refused:   {_poses(count)}: {reason}")
    for refusal in refusals[:LISTED]:
        say(f"           {refusal.detail}")
    if len(refusals) > LISTED:
        say(f"           and {len(refusals) - LISTED} more, all with --json")


def _poses(count: int) -> str:
    return f"{count} pose" if count == 1 else f"{count} poses"


def _duration(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
