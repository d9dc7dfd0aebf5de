"""The machine as Bluesky devices: arms to set, read and stop, a camera to trigger and read.

They satisfy `bluesky.protocols` by shape, without importing Bluesky. Work runs in a thread of each device, so
that the engine stays awake; `read` returns what the last verified move or shot left, and touches no wire.
"""

from __future__ import annotations

import math
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from rig.arms import HeldPose
    from rig.machine import Machine
    from rig.supervision import Breach, Levels

Reading = dict[str, dict[str, Any]]


class Status:
    """Outcome of work under way, as `bluesky.protocols.Status` wants it."""

    def __init__(self) -> None:
        self._over = threading.Event()
        self._lock = threading.Lock()
        self._error: BaseException | None = None
        self._callbacks: list[Callable[[Status], None]] = []

    @property
    def done(self) -> bool:
        """Whether the work is over, well or not."""
        return self._over.is_set()

    @property
    def success(self) -> bool:
        """Whether it is over and went well."""
        return self._over.is_set() and self._error is None

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Error of the work, or None if it went well.

        Raises
        ------
        TimeoutError
            If it is not over after `timeout` seconds (None waits for ever).
        """
        if not self._over.wait(timeout):
            raise TimeoutError("the work is not over yet")
        return self._error

    def add_callback(self, callback: Callable[[Status], None]) -> None:
        """Call back when the work is over; at once if it is."""
        with self._lock:
            if not self._over.is_set():
                self._callbacks.append(callback)
                return
        callback(self)

    def finish(self, error: BaseException | None = None) -> None:
        """Mark the work as over."""
        with self._lock:
            self._error = error
            self._over.set()
            callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback(self)


class _Device:
    """A device with a name, a thread for its work, and nothing above it."""

    parent = None

    def __init__(self, name: str) -> None:
        self.name = name
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)

    def close(self) -> None:
        """End the device's thread, after the work under way."""
        self._worker.shutdown(wait=True)

    def _start(self, work: Callable[[], None]) -> Status:
        status = Status()

        def run() -> None:
            try:
                work()
            except BaseException as error:  # noqa: BLE001 - the engine raises it in the plan
                status.finish(error)
            else:
                status.finish()

        self._worker.submit(run)
        return status


@dataclass(frozen=True, slots=True)
class PoseGoal:
    """What the arms are set to.

    Attributes
    ----------
    angles_rad : tuple of float
        One angle for each of `rig.arm_joints`.
    station : str or None
        What the wheel brings to the centre; None leaves it.
    """

    angles_rad: tuple[float, ...]
    station: str | None = None


class ArmsDevice(_Device):
    """The arms: Movable, Readable, Stoppable.

    Parameters
    ----------
    machine : Machine
    name : str
        Prefix of the readings.
    """

    def __init__(self, machine: Machine, name: str = "arms") -> None:
        super().__init__(name)
        self._machine = machine
        self._pose: HeldPose | None = None
        self._status: Status | None = None
        self._time_s = time.time()

    @property
    def pose(self) -> HeldPose | None:
        """The last verified pose, None before the first move."""
        return self._pose

    def set(self, value: PoseGoal) -> Status:
        """Start a move; its status is done when every arm has verifiably arrived."""
        self._status = self._start(lambda: self._move(value))
        return self._status

    def stop(self, success: bool = True) -> None:
        """Stop light and arms; at the regular end of a plan only if an arm is still on its way."""
        if not success or (self._status is not None and not self._status.done):
            self._machine.stop()

    def read(self) -> Reading:
        """Measured angles in degrees, ticks and station of the last move; cached."""
        if self._pose is None:
            return {}
        values = self._values(self._pose)
        return {key: {"value": value, "timestamp": self._time_s} for key, value in values.items()}

    def describe(self) -> Reading:
        """Shape and unit of each reading."""
        keys: Reading = {}
        for joint in self._machine.rig.arm_joints:
            keys[f"{self.name}_{joint.name}_deg"] = _key(joint.name, "number", "deg")
        for joint in self._machine.rig.joints:
            keys[f"{self.name}_{joint.name}_ticks"] = _key(joint.name, "integer", "tick")
        keys[f"{self.name}_station"] = _key("station", "string", "")
        return keys

    def _move(self, goal: PoseGoal) -> None:
        self._pose = self._machine.move(goal.angles_rad, goal.station)
        self._time_s = time.time()

    def _values(self, pose: HeldPose) -> Mapping[str, Any]:
        rig = self._machine.rig
        angles = zip(rig.arm_joints, pose.angles_rad, strict=True)
        values: dict[str, Any] = {f"{self.name}_{j.name}_deg": math.degrees(angle) for j, angle in angles}
        ticks = zip(rig.joints, pose.ticks, strict=True)
        values |= {f"{self.name}_{j.name}_ticks": count for j, count in ticks}
        values[f"{self.name}_station"] = pose.station or ""
        return values


@dataclass(frozen=True, slots=True)
class Shot:
    """What the camera takes next.

    Attributes
    ----------
    shot_id : str
    exposure_s : float
    dark : bool
    """

    shot_id: str
    exposure_s: float
    dark: bool = False


class CameraDevice(_Device):
    """Lamp and camera: Triggerable, Readable. `prepare` says what the next trigger takes.

    Parameters
    ----------
    machine : Machine
    name : str
        Prefix of the readings.
    """

    def __init__(self, machine: Machine, name: str = "camera") -> None:
        super().__init__(name)
        self._machine = machine
        self._next: Shot | None = None
        self._last: tuple[Shot, Path, float, float] | None = None

    @property
    def path(self) -> Path | None:
        """Picture of the last shot, None before the first."""
        return self._last[1] if self._last else None

    @property
    def lamp_output(self) -> float:
        """Light of the last shot over what the lamp's level promises; NaN where it was not measured."""
        return self._last[2] if self._last else math.nan

    def prepare(self, value: Shot) -> Status:
        """Set what the next trigger takes."""
        self._next = value
        status = Status()
        status.finish()
        return status

    def trigger(self) -> Status:
        """Start the exposure; its status is done when the verified picture lies in the hot folder.

        Raises
        ------
        RuntimeError
            If nothing was prepared: a plan's mistake, not the machine's.
        """
        shot, self._next = self._next, None
        if shot is None:
            raise RuntimeError(f"{self.name} was triggered before it was prepared")
        return self._start(lambda: self._shoot(shot))

    def read(self) -> Reading:
        """Name, exposure, light and file of the last shot; cached."""
        if self._last is None:
            return {}
        shot, path, lamp_output, time_s = self._last
        values = {
            "shot_id": shot.shot_id,
            "exposure_s": shot.exposure_s,
            "lit": not shot.dark,
            "lamp_output": lamp_output,
            "path": str(path),
        }
        return {f"{self.name}_{key}": {"value": value, "timestamp": time_s} for key, value in values.items()}

    def describe(self) -> Reading:
        """Shape and unit of each reading."""
        kinds = {
            "shot_id": ("string", ""),
            "exposure_s": ("number", "s"),
            "lit": ("boolean", ""),
            "lamp_output": ("number", ""),
            "path": ("string", ""),
        }
        return {f"{self.name}_{key}": _key(key, kind, unit) for key, (kind, unit) in kinds.items()}

    def _shoot(self, shot: Shot) -> None:
        path = self._machine.shoot(shot.shot_id, shot.exposure_s, dark=shot.dark)
        self._last = (shot, path, self._machine.lamp_output, time.time())


class SupervisionDevice(_Device):
    """Levels of the machine: Triggerable, Readable.

    Parameters
    ----------
    machine : Machine
    name : str
        Prefix of the readings.
    """

    def __init__(self, machine: Machine, name: str = "levels") -> None:
        super().__init__(name)
        self._machine = machine
        self._time_s = time.time()
        self.levels: Levels | None = None
        """What the last trigger read."""

    def trigger(self) -> Status:
        """Start to read all levels."""
        return self._start(self._look)

    def lamp_deg_c(self) -> float | None:
        """Temperature of the lamp's head at the last look; None where it was not read."""
        value = math.nan if self.levels is None else self.levels.lamp_deg_c
        return value if math.isfinite(value) else None

    def breaches(self, after: Sequence[Breach] = ()) -> tuple[Breach, ...]:
        """List the levels last read that are outside their bands; see `Supervisor.breaches`."""
        servos = self.levels.servos if self.levels else ()
        return self._machine.supervisor.breaches(servos, after)

    def read(self) -> Reading:
        """Levels last read; cached."""
        if self.levels is None:
            return {}
        values: dict[str, Any] = {"lamp_deg_c": self.levels.lamp_deg_c}
        for servo in self.levels.servos:
            values |= {f"{servo.joint}_{name}": getattr(servo, name) for name in _SERVO_LEVELS}
        return {
            f"{self.name}_{key}": {"value": value, "timestamp": self._time_s} for key, value in values.items()
        }

    def describe(self) -> Reading:
        """Shape and unit of each reading."""
        units = {"lamp_deg_c": "deg C"}
        for joint in self._machine.rig.joints:
            units |= {f"{joint.name}_{name}": unit for name, unit in _SERVO_LEVELS.items()}
        return {f"{self.name}_{key}": _key(key, "number", unit) for key, unit in units.items()}

    def _look(self) -> None:
        self.levels = self._machine.levels()
        self._time_s = time.time()


_SERVO_LEVELS = {"temperature_deg_c": "deg C", "voltage_v": "V", "load": ""}


def _key(source: str, kind: str, unit: str) -> dict[str, Any]:
    return {"source": f"gonio:{source}", "dtype": kind, "shape": [], "units": unit}
