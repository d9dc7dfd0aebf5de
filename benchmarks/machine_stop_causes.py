"""What makes a program stop a machine, done on purpose: in this process, and in children."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from capture.raw import inspect_frame
from gonio.signals import StopRequests
from rig.bus import ServoBus
from rig.control_table import ALERT_BIT
from rig.description import Rig, load_rig
from rig.errors import GonioError
from rig.machine import Machine
from rig.owner import request_stop
from rig.stop_report import StopOutcome, StopReport
from simulator.packets import Packet, PacketReader

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from simulator.twin import Twin

NEAR, FAR = (0.2, 0.0, 0.5, 0.0), (-0.9, 2.0, -0.9, 2.5)
LONG_S = 60.0
"""An exposure that is still running when something happens: more than a second on a hurried twin."""

FRAME_S = 1.0
UNDER_WAY_S = 0.15
FAILING_JOINT = "camera_azimuth"
WAIT_S = 30.0
RECOVERY_S = 0.5
"""An open door is closed again in less; an overheated servo is asked so often whether it has cooled."""

ROOT = Path(__file__).resolve().parents[1]


class TimedMachine(Machine):
    """A machine that notes when it was first stopped, and how that ended.

    Attributes
    ----------
    first_stop : tuple of float and StopReport, or None
        Begin and end on the monotonic clock, and the report.
    """

    def __init__(self, rig: Rig) -> None:
        self.first_stop: tuple[float, float, StopReport] | None = None
        self._alone = threading.Lock()
        super().__init__(rig, inspect_frame)

    def stop(self) -> StopReport:
        """Stop, as every machine does."""
        begin = time.monotonic()
        report = super().stop()
        with self._alone:
            if self.first_stop is None:
                self.first_stop = (begin, time.monotonic(), report)
        return report


@dataclass(frozen=True, slots=True)
class Stop:
    """One stop.

    Attributes
    ----------
    known : float
        When the program could know, on the monotonic clock.
    end : float
        When `Machine.stop` returned.
    confirmed : bool
        What it answered.
    """

    known: float
    end: float
    confirmed: bool


class Scene:
    """A twin, and the machine on it."""

    def __init__(self, twin: Twin) -> None:
        self.twin, self.rig = twin, load_rig(twin.rig)

    @contextlib.contextmanager
    def machine(self) -> Iterator[TimedMachine]:
        """Open it, at a pose of which it can take pictures."""
        with TimedMachine(self.rig) as machine:
            machine.move(NEAR, "white")
            yield machine

    def stop_of(self, machine: TimedMachine, known: float) -> Stop:
        """Make the record of a machine's first stop."""
        assert machine.first_stop is not None
        _, end, report = machine.first_stop
        return Stop(known, end, report.outcome is StopOutcome.CONFIRMED)

    def answer(self, line: str, since: float, tells: Callable[[bytes], bool]) -> float:
        """When the twin first said something on a line."""
        for event in self.twin.wire_log():
            said = event["t"] > since and (event["line"], event.get("direction")) == (line, "out")
            if said and tells(bytes.fromhex(event["data"])):
                return float(event["t"])
        raise RuntimeError(f"nothing on the {line} line told it")

    def fault(self, kind: str, since: float) -> float:
        """When a fault of the script happened."""
        for event in self.twin.wire_log():
            if event.get("event") == "fault" and event["kind"] == kind and event["t"] > since:
                return float(event["t"])
        raise RuntimeError(f"no {kind} happened")


# -- causes inside the program


def stopped_from_outside(scene: Scene) -> Stop:
    """Stop with `gonio rig stop` while the arms move."""
    with scene.machine() as machine:
        mover = _moving(machine)
        known = time.monotonic()
        request_stop(scene.rig)
        mover.join(WAIT_S)
    return scene.stop_of(machine, known)


def an_exception(scene: Scene) -> Stop:
    """Let a mistake in the program end it while the arms move."""
    known = 0.0
    with contextlib.suppress(ZeroDivisionError), scene.machine() as machine:
        machine.lamp.on()
        _moving(machine)
        known = time.monotonic()
        raise ZeroDivisionError
    return scene.stop_of(machine, known)


def an_open_door(scene: Scene) -> Stop:
    """Open the door in an exposure."""
    return _failing(scene, "door-open", "lamp", lambda data: b"0\n" in data)


def an_overheated_servo(scene: Scene) -> Stop:
    """Let a servo grow too warm in an exposure."""
    return _failing(scene, "overheating", "servos", _alert)


def an_overloaded_servo(scene: Scene) -> Stop:
    """Let a servo be overloaded in an exposure."""
    return _failing(scene, "overload", "servos", _alert)


def a_drifting_lamp(scene: Scene) -> Stop:
    """Let the lamp lose light; the frame is refused, and the error that says so ends the run."""
    known = 0.0
    with contextlib.suppress(GonioError), scene.machine() as machine:
        try:
            machine.shoot("drift", LONG_S / 10.0)
        except GonioError:
            known = time.monotonic()
            raise
    stop = scene.stop_of(machine, known)
    with scene.machine() as again:  # the script has the light come back at the next exposure
        again.shoot("healed", 0.001, dark=True)
    return stop


def _failing(scene: Scene, kind: str, line: str, tells: Callable[[bytes], bool]) -> Stop:
    """Shoot, while the script lets something fail; switch the servo off and on afterwards."""
    since = time.monotonic()
    with contextlib.suppress(GonioError), scene.machine() as machine:
        machine.shoot(kind, LONG_S)
    happened = scene.fault(kind, since)
    stop = scene.stop_of(machine, scene.answer(line, happened, tells))
    time.sleep(RECOVERY_S)
    failing = next(joint.id for joint in scene.rig.joints if joint.name == FAILING_JOINT)
    deadline = time.monotonic() + WAIT_S
    with ServoBus(scene.rig.ports.servos, scene.rig.bus.baud) as bus:
        bus.reboot(failing)
        while bus.read(failing, "hardware_error_status"):  # still too warm
            assert time.monotonic() < deadline
            time.sleep(RECOVERY_S)
            bus.reboot(failing)
    return stop


def _moving(machine: Machine) -> threading.Thread:
    """Have the arms on a way that takes longer than the stop."""

    def move() -> None:
        with contextlib.suppress(GonioError):
            machine.move(FAR)

    mover = threading.Thread(target=move)
    mover.start()
    time.sleep(UNDER_WAY_S)
    return mover


def _alert(data: bytes) -> bool:
    return any(
        isinstance(packet, Packet) and packet.parameters[:1] and packet.parameters[0] & ALERT_BIT
        for packet in PacketReader().feed(data)
    )


# -- causes outside the program, which runs in a child


def ctrl_c(scene: Scene) -> Stop:
    """Press Ctrl-C once in a row of frames: the frame under way is finished, then everything stops."""
    return _in_child(scene, "frames", lambda child: child.send_signal(signal.SIGINT))


def ctrl_c_twice(scene: Scene) -> Stop:
    """Press it twice in a long exposure."""

    def impatient(child: subprocess.Popen[str]) -> None:
        child.send_signal(signal.SIGINT)
        time.sleep(UNDER_WAY_S)
        child.send_signal(signal.SIGINT)

    return _in_child(scene, "exposure", impatient)


def sigterm(scene: Scene) -> Stop:
    """Send SIGTERM while the arms move."""
    return _in_child(scene, "move", lambda child: child.send_signal(signal.SIGTERM))


def a_dead_parent(scene: Scene) -> Stop:
    """Kill the program that started the one that moves the arms."""
    return _in_child(scene, "orphan", lambda parent: parent.kill(), between=True)


def _in_child(
    scene: Scene, work: str, provoke: Callable[[subprocess.Popen[str]], None], *, between: bool = False
) -> Stop:
    """Have a child work on the machine, provoke it or the parent between, and hear when it stopped."""
    command = [sys.executable, "-m", "benchmarks.machine_stop_causes", scene.twin.rig, work]
    if between:
        start = f"import subprocess; subprocess.run({command!r})"
        command = [sys.executable, "-c", start]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT
    ) as child:
        assert child.stdout is not None
        _hear(child.stdout)
        time.sleep(UNDER_WAY_S)
        provoke(child)
        sent = time.monotonic()
        told = _hear(child.stdout)
    known = float(told["known"] or sent)  # what the child does not say counts from the signal
    return Stop(known, told["end"], told["outcome"] == StopOutcome.CONFIRMED.value)


def _hear(stream: IO[str]) -> dict[str, Any]:
    said: dict[str, Any] = json.loads(stream.readline())
    return said


def _child(rig_file: str, work: str) -> None:
    """Be the child: say when the machine works, and after its end when it was stopped."""
    known: list[float] = []
    # Whoever runs this under nohup would not be stopped by the end of its parent.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    with (
        StopRequests("frame") as requests,
        contextlib.suppress(GonioError),
        TimedMachine(load_rig(rig_file)) as machine,
    ):
        if work == "orphan":
            requests.on_abort(lambda: known.append(time.monotonic()))
        requests.on_abort(machine.stop)
        machine.move(NEAR, "white")
        print("{}", flush=True)
        if work in {"move", "orphan"}:
            machine.move(FAR)
        for number in range(1000):
            machine.shoot(f"frame-{number}", LONG_S if work == "exposure" else FRAME_S)
            if requests.finish_requested:
                known.append(time.monotonic())
                break
    assert machine.first_stop is not None
    _, end, report = machine.first_stop
    print(json.dumps({"known": known[0] if known else None, "end": end, "outcome": report.outcome.value}))


if __name__ == "__main__":
    _child(*sys.argv[1:])
