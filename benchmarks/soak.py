"""A night on the twin with everything going wrong: faults of every kind, and a person who only restarts.

    gonio bench soak

Each fault of `simulator.faults` happens several times at exposures drawn from a seed, while one servo packet
in a hundred is dropped or corrupted. A run that stops is resumed, as the message says; a servo that has shut
down is switched off and on before. The twin knows what was true: where each shaft stood and how much light
there was when each frame was exposed. What the session holds is compared with that, frame by frame.
"""

from __future__ import annotations

import hashlib
import json
import math
import random
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w

from benchmarks.rows import row
from capture.interruptions import holes
from capture.journal import Journal
from capture.plan import plan_from
from capture.records import ShotState
from capture.run import capture, resume
from capture.session import JOURNAL_FILE
from capture.wishes import Wishes
from gonio.output import Progress, say
from rig.bus import ServoBus
from rig.description import default_rig, dump_rig, load_rig
from rig.errors import GonioError
from rig.ticks import rad_to_ticks
from simulator.faults import SERVO, FaultKind
from simulator.twin import Twin

POSES, EACH, RATE, SPEED = 1000, 3, 0.01, 200.0
MOST_RUNS = 200
LIMIT_S = 600.0
FILE_TIMEOUT_S = 1.5
LASTS_S = {
    FaultKind.LOAD: 2.0,
    FaultKind.LOW_VOLTAGE: 2.0,
    FaultKind.STUCK: 2.0,
    FaultKind.SLOW: 2.0,
    FaultKind.LAMP_DEAD: 2.0,
    FaultKind.DOOR_OPEN: 0.5,
}
OUTPUT_BAND = 0.1
"""Share by which the light of a frame that counts may be off: what the program is told to accept."""

TOO_CLOSE = "the arms stand too close already"
BY_HAND_S = 0.2

REFERENCE_TOLERANCE = 2.0 * OUTPUT_BAND
"""For reference poses after an interruption: both their shots may be off by the band."""


@dataclass
class Night:
    """What came of it.

    Attributes
    ----------
    seconds : float
    stops : list of str
        What each run that did not finish said.
    happened : Counter
        Faults by kind.
    told : Counter
        What the journal says happened, by kind of event.
    holes : int
        Poses that were skipped and never had.
    wrong : Counter
        Frames by what is wrong with them: nothing should be.
    frames, poses, planned : int
        Frames that count, poses done, poses asked for.
    """

    seconds: float = 0.0
    stops: list[str] = field(default_factory=list)
    happened: Counter[str] = field(default_factory=Counter)
    told: Counter[str] = field(default_factory=Counter)
    holes: int = 0
    wrong: Counter[str] = field(default_factory=Counter)
    frames: int = 0
    poses: int = 0
    planned: int = 0


def spend(poses: int = POSES, each: int = EACH, rate: float = RATE, seed: int = 0) -> Night:
    """Spend a night.

    Parameters
    ----------
    poses : int
        Poses of the plan.
    each : int
        How often each kind of fault happens.
    rate : float
        Share of servo packets that are hit besides.
    seed : int
        Decides when and where.

    Returns
    -------
    Night
    """
    with tempfile.TemporaryDirectory(prefix="gonio-soak-") as place:
        folder = Path(place)
        rig = _rig(folder)
        script = folder / "faults.toml"
        script.write_text(tomli_w.dumps(_script(poses, each, rate, seed)))
        began = time.monotonic()
        with Twin({"sample1": "lambert:kd=0.5"}, seed=seed, speed=SPEED, rig=rig, faults=script) as twin:
            night = _run(twin, folder / "session", poses)
            night.seconds = time.monotonic() - began
            _judge(night, folder / "session", twin)
        return night


def _rig(folder: Path) -> Path:
    """Write the default machine with a small picture and little patience."""
    rig = default_rig()
    camera = rig.camera.model_copy(
        update={
            "width_px": 32, "height_px": 24, "focal_length_px": 600.0, "principal_point_px": (15.5, 11.5),
            "file_timeout_s": FILE_TIMEOUT_S,
        }
    )  # fmt: skip
    path = folder / "machine.toml"
    dump_rig(rig.model_copy(update={"camera": camera}), path)
    return path


def _script(poses: int, each: int, rate: float, seed: int) -> dict[str, Any]:
    draw = random.Random(seed)  # noqa: S311
    joints = [joint.name for joint in default_rig().joints]
    faults = []
    for kind in FaultKind:
        for _ in range(each):
            fault: dict[str, Any] = {"kind": kind.value, "at_exposure": draw.randint(2, poses)}
            if kind in SERVO:
                fault["joint"] = draw.choice(joints)
            if kind in LASTS_S:
                fault["for_s"] = LASTS_S[kind]
            faults.append(fault)
    return {"seed": seed, "servo_error_rate": rate, "fault": faults}


def _plan(poses: int) -> Any:
    return plan_from(
        {
            "plan": {"name": "soak", "sample": "sample1", "white": "none", "refused": "skip"},
            "exposure": {"snr": 5.0, "first_s": 0.02, "max_frames": 1},
            "darks": {"count": 1},
            "poses": [
                {
                    "kind": "hemisphere", "theta_i_deg": [20.0 + 10.0 * k for k in range(5)],
                    "count": poses // 5, "theta_o_max_deg": 70.0,
                }
            ],
        },
        "soak",
    )  # fmt: skip


def _run(twin: Twin, session: Path, poses: int) -> Night:
    """Capture, and resume as often as it takes."""
    night, progress = Night(), Progress("poses", poses)
    wishes = Wishes(progress=lambda *_: progress())
    plan = _plan(poses)
    for _ in range(MOST_RUNS):
        try:
            if session.exists():
                result = resume(session, rig=twin.rig, reference_tolerance=REFERENCE_TOLERANCE, wishes=wishes)
            else:
                result = capture(plan, twin.rig, session, wishes=wishes)
        except GonioError as error:
            night.stops.append(str(error))
            say(f"stopped: {error}")
            _switch_off_and_on(twin)
            if TOO_CLOSE in str(error):
                _part_by_hand(twin)
            continue
        if result.complete:
            break
        say(f"ended with {len(result.holes)} poses missing")
    return night


def _switch_off_and_on(twin: Twin) -> None:
    """Do what the messages ask of a person: wait for the port, and power-cycle servos that have shut down."""
    rig = load_rig(twin.rig)
    for _ in range(20):
        try:
            with ServoBus(rig.ports.servos, rig.bus.baud) as bus:
                for joint in rig.joints:
                    if bus.read(joint.id, "hardware_error_status") or bus.read(joint.id, "bus_watchdog"):
                        bus.reboot(joint.id)
            return
        except GonioError:
            time.sleep(0.2)


def _part_by_hand(twin: Twin) -> None:
    """Bring arms apart that a stuck one has let come too close: the program refuses every move from there."""
    rig = load_rig(twin.rig)
    try:
        with ServoBus(rig.ports.servos, rig.bus.baud) as bus:
            for joint in rig.arm_joints:
                bus.write(joint.id, "torque_enable", 1)
                bus.write(joint.id, "goal_position", rad_to_ticks(joint, math.radians(joint.park_deg)))
                time.sleep(BY_HAND_S)
    except GonioError as error:
        say(f"by hand: {error}")


def _judge(night: Night, session: Path, twin: Twin) -> None:
    """Compare every frame that counts with what was true when it was exposed."""
    rig = load_rig(twin.rig)
    log = twin.wire_log()
    night.happened = Counter(str(event["kind"]) for event in log if event.get("event") == "fault")
    exposed: dict[str, list[dict[str, Any]]] = {}
    for event in log:
        if event.get("event") == "exposed":
            exposed.setdefault(str(event["id"]), []).append(event)
    journal = Journal(session / JOURNAL_FILE)
    visits = {visit.number: visit for visit in journal.visits()}
    shots = [shot for shot in journal.shots() if shot.state is ShotState.VERIFIED]
    seen = Counter((shot.visit, shot.frame) for shot in shots)
    night.wrong["twice"] = sum(count - 1 for count in seen.values())
    for shot in shots:
        visit = visits[shot.visit]
        held = (
            dict(zip((joint.name for joint in rig.joints), visit.held.ticks, strict=True))
            if visit.held
            else {}
        )
        truths = exposed.get(shot.shot_id, [])
        still = [truth for truth in truths if not truth["moved"]]
        near = [
            truth
            for truth in still
            if all(abs(truth["ticks"][name] - ticks) <= 1 for name, ticks in held.items())
        ]
        path = session / (shot.path or "")
        night.wrong["pose not held"] += not near or not held
        night.wrong["light not as recorded"] += bool(
            near and shot.lit and all(abs(truth["output"] - 1.0) > OUTPUT_BAND for truth in near)
        )
        night.wrong["file missing or changed"] += (
            not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != shot.sha256
        )
    done = [visit for visit in visits.values() if visit.done]
    night.wrong["visits without a frame"] = sum(
        visit.done and all(shot.visit != visit.number for shot in shots) for visit in visits.values()
    )
    night.told, night.holes = Counter(event.kind for event in journal.events()), len(holes(journal))
    night.wrong["guard frames among them"] = sum("guard" in shot.shot_id for shot in shots)
    night.wrong["poses without levels"] = len(
        {visit.number for visit in done} - {levels.visit for levels in journal.levels()}
    )
    night.frames, night.poses = len(shots), sum(visit.role.value == "sample" for visit in done)
    night.planned = sum(visit.role.value == "sample" for visit in visits.values())


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Spend the night; see the module."""
    del plots
    night = spend()
    least = min(night.happened.get(kind.value, 0) for kind in FaultKind)
    say(
        json.dumps(
            {
                "happened": night.happened,
                "told": night.told,
                "stops": Counter(s.split(":")[0] for s in night.stops),
            }
        )
    )
    return [
        row("poses done of those asked for", night.poses / max(night.planned, 1), "", 1.0, at_least=True),
        row("least often that a kind of fault happened", least, "", EACH, at_least=True),
        row("poses skipped and never had", night.holes, "", 0),
        row("runs that stopped with a reason and were resumed", len(night.stops)),
        row("shots made again", night.told["retry"]),
        row("poses skipped and tried again", night.told["skipped"]),
        row("reference poses shot again", night.told["reference"]),
        *(row(f"frames that count: {what}", count, "", 0) for what, count in sorted(night.wrong.items())),
        row("time", night.seconds, "s", LIMIT_S),
    ]
