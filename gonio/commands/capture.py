"""Run a plan on a machine into a session, or resume one.

The first Ctrl-C finishes the frame, a second one aborts; `gonio rig stop` from another terminal stops too.
However it ends, light and arms are stopped, and `gonio capture --resume SESSION` goes on.

Before it goes on, a resumed capture shoots a reference pose again; where its light has changed, it refuses.
A pose whose fault does not pass is skipped and tried again at the end of its pass. Poses still missing then
are listed with their reasons (exit code 4); resuming tries them again.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.mounting import add_mounted_option, machine_wishes, mounted_roles
from gonio.output import add_json_option, print_json, say
from rig.errors import BadInput, GonioError, Refused, Transient

if TYPE_CHECKING:
    import argparse

    from capture.wishes import CaptureResult, Wishes

EXAMPLE = (
    "gonio capture plan.toml --rig rig.toml --out brass    then, if interrupted: gonio capture --resume brass"
)

ROLES = ("white", "sample", "trap")
"""What a person may have to mount."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("plan", nargs="?", type=Path, metavar="PLAN", help="a plan that gonio plan wrote")
    parser.add_argument("--rig", type=Path, metavar="FILE", help="the machine; default: rig.toml")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="the new session")
    parser.add_argument("--resume", type=Path, metavar="SESSION", help="go on with this session")
    parser.add_argument("--servos", metavar="PORT", help="serial port of the servos, instead of the file's")
    parser.add_argument("--lamp", metavar="PORT", help="serial port of the lamp, instead of the file's")
    parser.add_argument("--frames", type=Path, metavar="FOLDER", help="hot folder, instead of the file's")
    parser.add_argument(
        "--reference-tolerance",
        type=float,
        metavar="SHARE",
        help="with --resume: by how much the light of a reference pose may have changed (default: rig file)",
    )
    add_mounted_option(parser, ROLES)
    add_json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Capture: 0 when all is recorded, 4 with poses missing; 130 after Ctrl-C, 143 after SIGTERM."""
    from gonio.signals import StopRequests

    mounted = mounted_roles(options.mounted, ROLES)
    if options.resume is None and (options.plan is None or options.out is None):
        raise BadInput("nothing to do", where="gonio capture", todo=f"for example: {EXAMPLE}")
    if options.resume is not None and options.out is not None:
        raise BadInput("--out and --resume", where="gonio capture", todo="give one of them")
    tolerance = options.reference_tolerance
    if tolerance is not None and (options.resume is None or not tolerance > 0.0):
        todo = "give a share above 0, together with --resume"
        raise BadInput(f"{tolerance:g} cannot be used", where="--reference-tolerance", todo=todo)
    with StopRequests("frame") as requests:
        wishes = machine_wishes(requests, mounted, "capture")
        try:
            result = _capture(options, wishes)
        except GonioError as error:
            if requests.exit_code is None:
                raise
            say(f"gonio capture: {' '.join(str(error).split())}")
            return requests.exit_code
        exit_code = requests.exit_code
    _print_result(result, json=options.json)
    if result.complete:
        return 0
    if exit_code is not None:
        return exit_code
    return Transient.exit_code if result.holes else Refused.exit_code


def _capture(options: argparse.Namespace, wishes: Wishes) -> CaptureResult:
    from capture.run import capture, resume

    ports = {"servos": options.servos, "lamp": options.lamp, "frames": options.frames}
    if options.resume is not None:
        return resume(
            options.resume,
            plan=options.plan,
            rig=options.rig,
            reference_tolerance=options.reference_tolerance,
            wishes=wishes,
            **ports,
        )
    from rig.description import load_rig

    rig_file = options.rig or Path("rig.toml")
    rig = load_rig(rig_file, **ports)
    return capture(options.plan, rig, options.out, rig_file=rig_file, wishes=wishes)


def _print_result(result: CaptureResult, *, json: bool) -> None:
    stopped = result.stop.outcome.value if result.stop is not None else "unknown"
    facts: dict[str, Any] = {
        "session": str(result.session),
        "complete": result.complete,
        "poses": result.poses,
        "refused": result.refused,
        "flagged": result.flagged,
        "frames": result.frames,
        "seconds": result.seconds,
        "stop": stopped,
        "holes": [hole.as_dict() for hole in result.holes],
    }
    if json:
        print_json(facts)
    else:
        flagged = f", {result.flagged} flagged" if result.flagged else ""
        print(
            f"{result.session}: {result.poses} poses, {result.frames} frames{flagged}, "
            f"{result.seconds:.1f} s; light off and arms stopped: {stopped}"
        )
    for hole in result.holes:
        say(f"gonio capture: {hole.role} {hole.pose} is missing, tried {hole.times} times: {hole.reason}")
    if not result.complete:
        ended = "poses are missing" if result.holes else "interrupted"
        say(f"gonio capture: {ended}; go on with: gonio capture --resume {result.session}")
