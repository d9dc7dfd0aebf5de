"""Every kind of fault of the twin, and how the machine takes it: made good unseen, shot again, or stopped."""

from __future__ import annotations

import contextlib
import re
import time
from typing import TYPE_CHECKING, Any

import pytest
import tomli_w

from capture.raw import inspect_frame
from rig.bus import ServoBus
from rig.description import default_rig, dump_rig, load_rig
from rig.errors import DeviceLost, GonioError, Transient, Unsafe
from rig.lamp import Lamp
from rig.machine import Machine, open_machine
from simulator.faults import SERVO, FaultKind
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rig.description import Rig

pytestmark = pytest.mark.render

JOINT, AILING = "camera_azimuth", 2
POSES = ((0.2, 0.0, 0.5, 0.0), (0.2, 0.4, 0.5, 0.0))
NOTHING = None
K = FaultKind

OUTCOMES: dict[FaultKind, tuple[type[GonioError] | None, str]] = {
    K.DROP: (NOTHING, ""),
    K.CORRUPT: (NOTHING, ""),
    K.DUPLICATE: (NOTHING, ""),
    K.DELAY: (NOTHING, ""),
    K.UNPLUG: (DeviceLost, "port is gone"),
    K.STUCK: (Unsafe, r"\(camera_azimuth\).*short"),
    K.SLOW: (NOTHING, ""),
    K.OVERLOAD: (Unsafe, r"\(camera_azimuth\).*reports overload"),
    K.OVERHEATING: (Unsafe, r"\(camera_azimuth\).*reports overheating"),
    K.LOAD: (NOTHING, ""),
    K.LOW_VOLTAGE: (Unsafe, r"\(camera_azimuth\).*reports input voltage"),
    K.BROWN_OUT: (Unsafe, r"\(camera_azimuth\).*its torque is off"),
    K.LOST_TURN: (NOTHING, ""),  # a servo of one turn has none to lose
    K.BUS_WATCHDOG: (Unsafe, r"\(camera_azimuth\).*watchdog has tripped"),
    K.DOOR_OPEN: (Unsafe, "interlock is open"),
    K.LAMP_DRIFT: (Transient, "the lamp gave"),
    K.LAMP_FLICKER: (Transient, "the lamp gave"),
    K.LAMP_DEAD: (Transient, "the lamp gave 0 times"),
    K.LAMP_RESTART: (GonioError, "cut short|restarted"),
    K.NO_FILE: (DeviceLost, "no file arrived"),
    K.LATE_FILE: (NOTHING, ""),
    K.TRUNCATED_FILE: (Transient, "does not decode"),
    K.FILE_TWICE: (NOTHING, ""),
    K.FILE_OUT_OF_ORDER: (DeviceLost, "no file arrived"),
    K.WRONG_EXPOSURE: (Transient, "exposed 2 s, expected 1 s"),
    K.DISK_FULL: (GonioError, "no file arrived|does not decode"),
    K.CLOCK_STEP: (Transient, "older than the trigger"),
}
"""What comes of a shot and a move in which it happens: the error, and what it says."""

FIELDS: dict[FaultKind, dict[str, Any]] = {
    K.UNPLUG: {"for_s": 0.5},
    K.STUCK: {"for_s": 2.0},
    K.SLOW: {"for_s": 1.0},
    K.LOAD: {"for_s": 1.0},
    K.LOW_VOLTAGE: {"for_s": 0.5},
    K.DOOR_OPEN: {"for_s": 0.3},
    K.LAMP_DRIFT: {"factor": 0.5, "for_s": 0.0},
    K.LAMP_FLICKER: {"factor": 0.0},
    K.LAMP_DEAD: {"for_s": 0.5},
    K.LATE_FILE: {"for_s": 0.3},
}
MORE: dict[FaultKind, dict[str, Any]] = {K.LAMP_DRIFT: {"factor": 1.0, "for_s": 0.0}}
"""What makes it good again, at the next exposure."""


def script() -> dict[str, Any]:
    """Let every kind happen at an exposure of its own, every third one."""
    faults = []
    for number, kind in enumerate(OUTCOMES):
        place = {"joint": JOINT} if kind in SERVO else {}
        fault = {"kind": kind.value, **place}
        faults.append({**fault, "at_exposure": 3 * number + 1, **FIELDS.get(kind, {})})
        if kind in MORE:
            faults.append({**fault, "at_exposure": 3 * number + 3, **MORE[kind]})
    return {"fault": faults}


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    """Return a twin of the default machine, with a small picture, to which everything happens."""
    folder = tmp_path_factory.mktemp("faults")
    rig = default_rig()
    small = {"width_px": 32, "height_px": 24, "focal_length_px": 600.0, "principal_point_px": (15.5, 11.5)}
    camera = rig.camera.model_copy(update={**small, "file_timeout_s": 1.0})
    dump_rig(rig.model_copy(update={"camera": camera, "solids": ()}), folder / "rig.toml")
    (folder / "faults.toml").write_text(tomli_w.dumps(script()))
    with Twin(speed=50.0, rig=folder / "rig.toml", faults=folder / "faults.toml") as twin:
        yield twin


def work(machine: Machine, kind: FaultKind) -> Path:
    """Shoot at the fault's exposure, at the one after it, and move in between."""
    picture = machine.shoot(f"{kind}-1", 1.0)
    machine.move(POSES[1])
    return picture if kind is not K.LAMP_FLICKER else machine.shoot(f"{kind}-2", 0.01)


def exposures(twin: Twin) -> int:
    """How many exposures have begun."""
    return sum(event.get("event") == "shutter" and event["open"] for event in twin.wire_log())


def recover(rig: Rig, twin: Twin, done: int) -> None:
    """Switch the ailing servo off and on, wait for servo and door, bring the count of exposures to `done`."""
    deadline = time.monotonic() + 30.0
    while not well(rig):
        assert time.monotonic() < deadline
        time.sleep(0.2)
    while exposures(twin) < done:
        assert time.monotonic() < deadline
        with contextlib.suppress(GonioError), open_machine(rig) as machine:
            machine.lamp.expose(0.001, "spare", dark=True)


def well(rig: Rig) -> bool:
    """Whether the ailing servo, started anew, reports nothing and the door is closed."""
    with contextlib.suppress(GonioError):
        with ServoBus(rig.ports.servos, rig.bus.baud) as bus:
            bus.reboot(AILING)
            if bus.read(AILING, "hardware_error_status"):
                return False
        with Lamp(rig.ports.lamp) as lamp:
            return lamp.interlock_closed()
    return False


def test_every_kind_of_fault_is_met(twin: Twin) -> None:
    """Catches a fault that passes unseen, is called by another's name, or ends what could have gone on."""
    assert set(OUTCOMES) == set(FaultKind)
    rig = load_rig(twin.rig)
    wrong = {}
    for number, (kind, (error, says)) in enumerate(OUTCOMES.items(), start=1):
        met: GonioError | None = None
        try:
            with open_machine(rig, inspect=inspect_frame) as machine:
                machine.move(POSES[0], "white")
                work(machine, kind)
        except GonioError as caught:
            met = caught
        fits = met is None if error is None else isinstance(met, error) and re.search(says, str(met))
        if not fits:
            wrong[kind.value] = repr(met)
        recover(rig, twin, 3 * number)
    assert wrong == {}
