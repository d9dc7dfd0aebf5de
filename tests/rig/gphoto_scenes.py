"""What tests do with libgphoto2's own virtual camera, each in a process of its own.

Real and virtual cameras cannot share one, and the virtual camera's store is full for ever after 26 shots.

    VCAMERADIR=folder python tests/rig/gphoto_scenes.py SCENE FOLDER

prints one line of JSON.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from rig.cameras.gphoto import Tether
from rig.errors import GonioError

SERIAL = "0.1"


def told(error: GonioError) -> dict[str, str]:
    """Return an error as JSON carries it."""
    return {"kind": type(error).__name__, "line": str(error)}


def shutter(_folder: Path) -> Any:
    """Set times that the camera has, nearly has, and has not."""
    found: list[Any] = []
    with Tether(SERIAL) as tether:
        for exposure_s in (0.05, 0.0102, 0.3):
            try:
                held = tether.set_shutter(exposure_s)
                again = tether._shutter(tether._config()).get_value()
                found.append([held, again])
            except GonioError as error:
                found.append(told(error))
        return {"serial": tether.serial, "shutters_s": tether.shutters_s(), "found": found}


def shots(folder: Path) -> Any:
    """Shoot until the store is full."""
    names: list[list[str]] = []
    with Tether() as tether:
        try:
            names.extend(
                [path.name for path in tether.shoot(0.01, f"shot-{number}", folder)] for number in range(30)
            )
        except GonioError as error:
            return {"names": names, "error": told(error)}
    return {"names": names}


def stranger(_folder: Path) -> Any:
    """Ask for a camera that is not there."""
    try:
        Tether("123456")
    except GonioError as error:
        return told(error)
    return None


def returned(folder: Path) -> Any:
    """Shoot, lose the camera once in the middle, and shoot again."""
    import gphoto2

    with Tether(SERIAL) as tether:
        tether.shoot(0.05, "before", folder)
        lost = tether._camera

        class Dead:
            def __getattr__(self, name: str) -> Any:
                if name == "exit":
                    return lost.exit
                raise gphoto2.GPhoto2Error(gphoto2.GP_ERROR_IO)

        tether._camera = Dead()
        try:
            tether.shoot(0.05, "lost", folder)
            error = None
        except GonioError as caught:
            error = told(caught)
        held = tether._shutter(tether._config()).get_value()
        return {"error": error, "again": [p.name for p in tether.shoot(0.05, "lost", folder)], "held": held}


def machine(folder: Path) -> Any:
    """Move, shoot lit and dark, on the twin's servos and lamp, with the camera on USB."""
    from capture.raw import inspect_frame
    from rig.description import load_rig
    from rig.machine import open_machine
    from rig.stop_report import StopOutcome
    from simulator.twin import Twin

    with Twin({"sample1": "lambert:kd=0.5"}, speed=100.0) as twin:
        rig = load_rig(twin.rig, frames=folder)
        camera = rig.camera.model_copy(update={"kind": "gphoto", "serial": SERIAL, "file_timeout_s": 3.0})
        rig = rig.model_copy(update={"camera": camera})
        with open_machine(rig, inspect=inspect_frame) as opened:
            opened.move((-0.5, 0.0, 0.5, 0.0), "white")
            pictures = [opened.shoot("lit", 0.01).name, opened.shoot("dark", 0.01, dark=True).name]
        log = twin.wire_log()
        lines = b"".join(
            bytes.fromhex(event["data"])
            for event in log
            if event["line"] == "lamp" and event["direction"] == "in"
        )
        light = [event["on"] for event in log if event.get("event") == "light"]
        report = opened.stop_report
    return {
        "pictures": pictures,
        "light": light,
        "shutter by wire": b"SHUT:EXP" in lines,
        "stopped": report is not None and report.outcome is StopOutcome.CONFIRMED,
    }


if __name__ == "__main__":
    scene, where = sys.argv[1:]
    print(json.dumps(globals()[scene](Path(where))))  # noqa: T201
