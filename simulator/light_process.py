"""The light process: renders frames, in a process of its own so that rendering never delays a reply.

Run as `python -m simulator.light_process`. Lines of JSON come in and go out: first a `LightSettings`,
answered by what the wire process needs to know of the machine; then exposures, each answered by the frame's
path. It is also the only process of the twin that loads the rig file, and with it the heavy libraries.
"""

from __future__ import annotations

import json
import math
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.errors import BadInput, DeviceLost, GonioError, Refused, Transient, Unsafe
from simulator.camera_faults import FaultyCamera

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import TextIO

    from rig.description import Rig
    from simulator.frames import FrameMaker
    from simulator.request import FrameRequest

ERRORS: dict[str, type[GonioError]] = {
    kind.__name__: kind for kind in (GonioError, BadInput, Refused, Transient, DeviceLost, Unsafe)
}
"""Errors that may cross from one process to the other, by name."""

_NICENESS = 5
"""Rendering yields to the wires: a late reply is a fault that the client sees."""


@dataclass(frozen=True)
class LightSettings:
    """What the light process is started with.

    Parameters
    ----------
    folder : str
        The twin's folder, where rig file, calibration and hot folder lie.
    servos, lamp : str
        Ports, for the rig file.
    rig : str or None
        Rig file that the machine is taken from; None for the default machine.
    materials : dict of str to str
        Material by station.
    seed : int
        The twin's seed.
    variant : str or None
        Mitsuba's variant, None to choose.
    housing_albedo : float, optional
        Of the walls around the machine; 0 is black; by default what the rig file says.
    tolerance : float, optional
        Error of the light that is allowed, relative to the mean radiance over the sample;
        likewise.
    """

    folder: str
    servos: str
    lamp: str
    rig: str | None = None
    materials: dict[str, str] = field(default_factory=dict)
    seed: int = 0
    variant: str | None = None
    housing_albedo: float | None = None
    tolerance: float | None = None

    @property
    def rig_file(self) -> Path:
        """The twin's own rig file."""
        return Path(self.folder) / "rig.toml"

    @property
    def frames(self) -> Path:
        """The hot folder."""
        return Path(self.folder) / "frames"


def error_record(error: GonioError | OSError) -> dict[str, str]:
    """Turn an error into something that JSON carries."""
    if isinstance(error, OSError):
        what, where = error.strerror or str(error), str(error.filename or "twin")
        error = BadInput(what, where=where, todo="check the folder, its permissions and the free space")
    return {"kind": type(error).__name__, "what": error.what, "where": error.where, "todo": error.todo}


def error_from(record: dict[str, str]) -> GonioError:
    """Turn it back."""
    kind = ERRORS.get(record["kind"], GonioError)
    return kind(record["what"], where=record["where"], todo=record["todo"])


def prepare_rig(settings: LightSettings) -> Rig:
    """Write the twin's rig file, the given machine or the default one with the twin's ports; load it."""
    from rig.description import Ports, default_rig, dump_rig, load_rig

    source = load_rig(settings.rig) if settings.rig else default_rig()
    ports = Ports(servos=settings.servos, lamp=settings.lamp, frames=settings.frames.absolute())
    dump_rig(source.model_copy(update={"ports": ports}), settings.rig_file)
    return load_rig(settings.rig_file)


def machine_record(rig: Rig) -> dict[str, Any]:
    """Return what the wire process needs to know of the machine: its servos, parked, and their baud rate."""
    from rig.ticks import rad_to_ticks

    return {
        "baud": rig.bus.baud,
        "joints": [
            {
                "name": joint.name,
                "id": joint.id,
                "model": joint.model,
                "ticks": rad_to_ticks(joint, math.radians(joint.park_deg)),
            }
            for joint in rig.joints
        ],
    }


def frame_request(rig: Rig, settings: LightSettings, order: dict[str, Any]) -> FrameRequest:
    """Complete the wire process's order (ticks, backlash, exposure) with the truth about the pose."""
    from simulator.request import FrameRequest
    from simulator.truth import station_at, true_angles_rad

    ticks, behind = order.pop("ticks"), order.pop("behind")
    return FrameRequest(
        seed=settings.seed,
        station=station_at(rig, ticks),
        ticks=ticks,
        angles_rad=true_angles_rad(rig, settings.seed, ticks, behind),
        **order,
    )


def _answers(lines: Iterator[str]) -> Iterator[dict[str, Any]]:
    """Answer each line that comes in."""
    settings = LightSettings(**json.loads(next(lines)))
    try:
        rig = prepare_rig(settings)
        camera = FaultyCamera(_frame_maker(rig, settings))
    except (GonioError, OSError) as error:
        yield {"error": error_record(error)}
        return
    yield machine_record(rig)
    for line in lines:
        order = json.loads(line)
        shot, fault = order["shot"], order.pop("fault", None)
        try:
            yield {"shot": shot, "path": camera.deliver(frame_request(rig, settings, order), fault)}
        except (GonioError, OSError) as error:
            yield {"shot": shot, "error": error_record(error)}


def _frame_maker(rig: Rig, settings: LightSettings) -> FrameMaker:
    from simulator.frames import FrameMaker

    return FrameMaker(
        rig,
        settings.materials,
        settings.seed,
        variant=settings.variant,
        housing_albedo=settings.housing_albedo,
        tolerance=settings.tolerance,
    )


def _private_standard_output() -> TextIO:
    """Keep standard output for the answers; whatever a library prints goes to standard error."""
    private = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return os.fdopen(private, "w", buffering=1)


def main() -> int:
    """Serve until standard input ends."""
    os.nice(_NICENESS)
    answers = _private_standard_output()
    for answer in _answers(iter(sys.stdin.readline, "")):
        answers.write(json.dumps(answer) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
