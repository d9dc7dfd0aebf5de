"""The machine: look it over, move it, park it, stop it, draw it.

check  who answers on which port, expected against found; nothing moves, the light goes off
move   joints to angles in degrees (JOINT=DEGREES ...), the others stay; --station turns the wheel
park   light off, every arm to its park_deg; --others leaves alone those that report an error
stop   light off and arms stopped, whoever runs the machine
show   a drawing (PNG) of its solids at a pose, with light, line of sight and the nearest pair; nothing moves
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.output import add_json_option, print_json, say
from rig.errors import BadInput, GonioError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from rig.arms import HeldPose
    from rig.description import Rig
    from rig.machine import Machine
    from rig.stop_report import StopReport

EXAMPLE = "gonio rig move light_elevation=-30 camera_elevation=45 --station white --rig rig.toml"

EXIT_BY_STOP = {"confirmed": 0, "refused": 3, "unknown": 4}
"""Exit code of `gonio rig stop` and `park --others` by outcome."""


def add_rig_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a machine: its file, and ports that replace the file's."""
    parser.add_argument(
        "--rig", type=Path, default=Path("rig.toml"), metavar="FILE", help="default: rig.toml"
    )
    parser.add_argument("--servos", metavar="PORT", help="serial port of the servos, instead of the file's")
    parser.add_argument("--lamp", metavar="PORT", help="serial port of the lamp, instead of the file's")
    parser.add_argument("--frames", type=Path, metavar="FOLDER", help="hot folder, instead of the file's")


def load_rig_options(options: argparse.Namespace) -> Rig:
    """Load the machine that the options name.

    Raises
    ------
    BadInput
        If the file cannot be used.
    """
    from rig.description import load_rig

    return load_rig(options.rig, servos=options.servos, lamp=options.lamp, frames=options.frames)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="check|move|park|stop|show")
    helps = {
        "check": "who answers, expected against found",
        "move": "joints to angles",
        "park": "light off, arms to their park angles",
        "stop": "light off, arms stopped, whoever runs the machine",
        "show": "a drawing of the machine at a pose; nothing moves",
    }
    for name, text in helps.items():
        action = actions.add_parser(name, help=text, description=text)
        if name == "move":
            action.add_argument("angles", nargs="*", metavar="JOINT=DEGREES", help="where joints go")
            action.add_argument("--station", metavar="NAME", help="what the wheel brings to the centre")
        if name == "show":
            action.add_argument(
                "--pose",
                nargs="+",
                default=[],
                metavar="JOINT=DEGREES",
                help="where joints are; the others, and by default all, are parked",
            )
            action.add_argument(
                "--out", type=Path, default=Path("machine.png"), metavar="FILE", help="default: machine.png"
            )
        if name == "park":
            action.add_argument(
                "--others", action="store_true", help="leave alone servos that report an error or are silent"
            )
        add_rig_options(action)
        add_json_option(action)


def run(options: argparse.Namespace) -> int:
    """Run one action: 0 done, 2 to 5 as for every command, 130 after Ctrl-C, 143 after SIGTERM."""
    rig = load_rig_options(options)
    actions: dict[str, Callable[[Rig, argparse.Namespace], int]] = {
        "check": _check,
        "move": _move,
        "park": _park,
        "stop": _stop,
        "show": _show,
    }
    return actions[options.action](rig, options)


def _check(rig: Rig, options: argparse.Namespace) -> int:
    from rig.checkup import check_machine

    found = check_machine(rig)
    if options.json:
        print_json({"rig": rig.name, **found.as_dict()})
    else:
        _print_checkup(found.as_dict(), found.handshake.table() if found.handshake else "")
    for fault in found.faults[1:]:
        say(f"gonio rig: {' '.join(str(fault).split())}")
    if found.faults:
        raise found.faults[0]
    return 0


def _print_checkup(found: dict[str, Any], table: str) -> None:
    if table:
        print(table)
    lamp = found["lamp"]
    if lamp:
        interlock = "closed" if lamp["interlock_closed"] else "OPEN"
        print(f"lamp    {lamp['identity']}  interlock {interlock}  {lamp['temperature_deg_c']:.1f} deg C")
    frames = found["frames"]
    print(f"frames  {frames['folder']}  {frames['files']} RAW files")


def _move(rig: Rig, options: argparse.Namespace) -> int:
    from rig.kinematics import Kinematics

    wanted = _parse_angles(rig, options.angles)
    if not wanted and options.station is None:
        raise BadInput("nothing to move", where="gonio rig move", todo=f"for example: {EXAMPLE}")

    def move(machine: Machine) -> HeldPose:
        present = machine.arms.measure().angles_rad
        angles = [wanted.get(joint.name, angle) for joint, angle in zip(rig.arm_joints, present, strict=True)]
        if wanted:
            Kinematics(rig).check(angles)
        return machine.move(angles, options.station)

    return _run_machine(rig, options, move)


def _park(rig: Rig, options: argparse.Namespace) -> int:
    if options.others:
        return _park_others(rig, options)
    return _run_machine(rig, options, lambda machine: machine.park())


def _park_others(rig: Rig, options: argparse.Namespace) -> int:
    from gonio.signals import StopRequests
    from rig.rescue import park_others

    with StopRequests("move", patient=False) as requests:
        report = park_others(rig, requests.on_abort)
    return requests.exit_code or _tell(rig, report, "park", "parked", json=options.json)


def _run_machine(rig: Rig, options: argparse.Namespace, action: Callable[[Machine], HeldPose]) -> int:
    from gonio.signals import StopRequests
    from rig.machine import open_machine

    with StopRequests("move", patient=False) as requests:
        try:
            with open_machine(rig) as machine:
                requests.on_abort(machine.stop)
                pose = action(machine)
        except GonioError as error:
            if requests.exit_code is None:
                raise
            say(f"gonio rig: {error}")
            return requests.exit_code
    _print_pose(rig, pose, json=options.json)
    return requests.exit_code or 0


def _print_pose(rig: Rig, pose: HeldPose, *, json: bool) -> None:
    angles_deg = {
        joint.name: math.degrees(angle) for joint, angle in zip(rig.arm_joints, pose.angles_rad, strict=True)
    }
    ticks = {joint.name: ticks for joint, ticks in zip(rig.joints, pose.ticks, strict=True)}
    if json:
        print_json({"station": pose.station, "angles_deg": angles_deg, "ticks": ticks})
        return
    for name, angle_deg in angles_deg.items():
        print(f"{name:<20} {angle_deg:9.3f} deg  {ticks[name]:5d} ticks")
    if rig.station_joint is not None:
        print(f"{rig.station_joint.name:<20} {pose.station or 'between stations'}")


def _stop(rig: Rig, options: argparse.Namespace) -> int:
    from rig.owner import request_stop

    return _tell(rig, request_stop(rig), "stop", "stopped", json=options.json)


def _tell(rig: Rig, report: StopReport, what: str, done: str, *, json: bool) -> int:
    """Print a report part by part; the exit code of its outcome."""
    from rig.stop_report import StopOutcome

    if json:
        print_json(report.as_dict())
    else:
        print(f"{what} {report.outcome.value}")
        for line in report.details:
            print(f"  {line}")
    unsure = ", ".join(part.part for part in report.parts if part.outcome is not StopOutcome.CONFIRMED)
    if unsure:
        say(f"gonio rig: {rig.name}: {unsure} not proved {done}; look, and cut the power by hand if in doubt")
    return EXIT_BY_STOP[report.outcome.value]


def _show(rig: Rig, options: argparse.Namespace) -> int:
    import numpy as np

    from capture.feasible import Obstacles
    from gonio.machine_drawing import Drawn, draw_machine
    from rig.files import whole_file
    from rig.kinematics import Kinematics

    wanted = _parse_angles(rig, options.pose)
    kinematics = Kinematics(rig)
    angles = np.array([wanted.get(joint.name, math.radians(joint.park_deg)) for joint in rig.arm_joints])
    kinematics.require_limits(angles)
    obstacles = Obstacles(rig)
    nearest, obstacle = obstacles.clearance.nearest(angles), obstacles.at(angles[None])[0]
    beams = obstacles.shadows.beams(angles[None])
    title = ", ".join(
        f"{joint.name} {math.degrees(angle):.1f}" for joint, angle in zip(rig.arm_joints, angles, strict=True)
    )
    with whole_file(options.out) as file:
        draw_machine(rig, angles, Drawn(f"{rig.name}: {title} deg", beams, nearest), file)
    if options.json:
        found = None if nearest is None else {"solids": nearest.solids, "distance_mm": nearest.distance_mm}
        print_json({"out": str(options.out), "nearest": found, "obstacle": obstacle and obstacle[1]})
        return 0
    apart = "no solids that move past each other"
    if nearest is not None:
        apart = f"nearest are {' and '.join(nearest.solids)}, {nearest.distance_mm:.1f} mm"
    print(f"{options.out}: {apart}{'' if obstacle is None else f'; refused or marked: {obstacle[1]}'}")
    return 0


def _parse_angles(rig: Rig, arguments: list[str]) -> dict[str, float]:
    names = [joint.name for joint in rig.arm_joints]
    angles: dict[str, float] = {}
    for argument in arguments:
        name, _, text = argument.partition("=")
        if name not in names:
            raise BadInput(f"no joint {name!r}", where=argument, todo=f"joints are {', '.join(names)}")
        try:
            angle_deg = float(text)
        except ValueError:
            angle_deg = math.nan
        if not math.isfinite(angle_deg):
            raise BadInput(f"{text!r} is no angle", where=argument, todo=f"write {name}=30 for 30 degrees")
        angles[name] = math.radians(angle_deg)
    return angles
