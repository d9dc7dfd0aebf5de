"""The machine: arms, lamp and camera as one, safe on every way out.

Light and arms are stopped together, light first, whoever asks and from whichever thread: `Machine.stop`. A
stopped machine stays stopped; it is opened anew to go on.
"""

from __future__ import annotations

import math
import threading
import time
from typing import TYPE_CHECKING, TypeVar

from rig.arms import Arms
from rig.bus import ServoBus
from rig.cameras.gphoto import Tether
from rig.errors import BadInput, DeviceLost, GonioError, Refused, Transient, Unsafe
from rig.handshake import Handshake, ServoSpec
from rig.hotfolder import FrameFacts, HotFolder, Stray
from rig.lamp import Lamp
from rig.owner import PortOwner
from rig.servos import Servos
from rig.stop_report import PartStop, StopOutcome, StopReport
from rig.supervision import Levels, Supervisor
from rig.travel import Travel
from rig.trigger import LampTrigger, Trigger, UsbTrigger
from rig.watch import Watch

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path
    from types import TracebackType

    from rig.arms import HeldPose
    from rig.description import Rig

T = TypeVar("T")


class Machine:
    """An open machine; `open_machine` makes one.

    Attributes
    ----------
    rig : Rig
    handshake : Handshake
        Servos expected and found.
    arms : Arms
    lamp : Lamp
    camera : HotFolder
    supervisor : Supervisor
        Bands of the levels.
    lamp_output : float
        Light of the last shot over what the lamp's level promises; NaN for a dark or unmeasured one.
    """

    def __init__(self, rig: Rig, inspect: Callable[[Path], FrameFacts] | None = None) -> None:
        self.rig = rig
        self._stopped = threading.Event()
        self._stop_lock = threading.Lock()
        self._report: StopReport | None = None
        self._cause: GonioError | None = None
        self._at_work = 0
        self._measures = inspect is not None
        self._warm = rig.lamp.warm_up_s == 0.0
        self._exits: list[Callable[[], None]] = []
        self._lamp: Lamp | None = None
        self._servos: Servos | None = None
        self.lamp_output = math.nan
        try:
            self._open(inspect)
        except BaseException:
            self.stop()
            self.close()
            raise

    def _open(self, inspect: Callable[[Path], FrameFacts] | None) -> None:
        rig = self.rig
        specs = [ServoSpec.of(joint) for joint in rig.joints]
        require_port(rig.ports.servos, "servo bus", "--servos")
        require_port(rig.ports.lamp, "lamp controller", "--lamp")
        self.camera = HotFolder(rig.ports.frames, rig.camera.serial, inspect or _no_camera)
        if inspect is not None:
            self.camera.require()
        owner = PortOwner(rig, self.stop)
        self._exits.append(owner.release)
        self.lamp = self._lamp = Lamp(
            rig.ports.lamp, mode=rig.lamp.mode, level=rig.lamp.level, watchdog_s=rig.lamp.watchdog_s
        )
        self._exits.append(self.lamp.close)
        self.lamp.set_up()
        self._trigger: Trigger = LampTrigger(self.lamp)
        if rig.camera.kind == "gphoto" and inspect is not None:
            self._trigger = UsbTrigger(Tether(rig.camera.serial), self.lamp, rig.ports.frames)
            self._exits.append(self._trigger.close)
        names = {joint.id: joint.name for joint in rig.joints}
        bus = ServoBus(rig.ports.servos, rig.bus.baud, names=names)
        self._exits.append(bus.close)
        servos = Servos(
            bus,
            specs,
            torque_on_stop=rig.bus.torque_on_stop,
            settle_reads=rig.bus.settle_reads,
            watchdog_s=rig.bus.watchdog_s,
        )
        self.handshake: Handshake = servos.attach()
        self._servos = servos
        self.arms = Arms(rig, servos, self._stopped.is_set)
        self._travel = Travel(rig, self.arms)
        self.supervisor = Supervisor(rig, bus)
        ids = [spec.servo_id for spec in specs]
        watch = Watch(self.lamp, bus, ids, door_matters=self._door_matters, condemn=self.condemn)
        self._exits.append(watch.close)

    def __enter__(self) -> Machine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.stop()
        except KeyboardInterrupt:
            self.stop()  # an impatient Ctrl-C does not cut a stop short
            raise
        finally:
            self.close()

    @property
    def stopped(self) -> bool:
        """Whether the machine has been stopped; it then refuses everything."""
        return self._stopped.is_set()

    @property
    def stop_report(self) -> StopReport | None:
        """How the stop went; None while the machine runs."""
        return self._report

    def on_stray(self, callback: Callable[[Stray], None] | None) -> None:
        """Be told of every file that is not the picture waited for."""
        self.camera.on_stray = callback

    def move(self, angles_rad: Sequence[float], station: str | None = None) -> HeldPose:
        """Move, or stop everything and raise: an arm that does not obey ends the run.

        The way is checked before the first byte of a goal: where solids would come nearer than the margin,
        the arms go round by other poses.

        Raises
        ------
        Refused
            Also if there is no way round; nothing has moved then.
        As `Arms.move`; after `Unsafe` and `DeviceLost` the machine is stopped.
        """
        self._require_running()
        return self._guarded(lambda: self._travel.move(angles_rad, station))

    def park(self) -> HeldPose:
        """Light off for good, then every arm to its `park_deg`.

        Raises
        ------
        As `Arms.move`.
        """
        self._require_running()
        self._guarded(self.lamp.off)
        angles_rad = [math.radians(joint.park_deg) for joint in self.rig.arm_joints]
        return self.move(angles_rad)

    def shoot(self, shot_id: str, exposure_s: float, *, dark: bool = False) -> Path:
        """Make one exposure of the pose held and return its verified picture in the hot folder.

        Parameters
        ----------
        shot_id : str
            Its name: 1 to 40 characters of A-Z a-z 0-9 . _ -
        exposure_s : float
            1e-5 to 600 s.
        dark : bool
            With the lamp off.

        Raises
        ------
        Transient
            If it can be made again: cut short, or its picture went missing.
        Unsafe
            If an arm left its place, or the interlock is open; the machine is then stopped.
        DeviceLost
            If lamp or camera no longer answer; the machine is then stopped.
        Refused
            If the arms hold no verified pose, or the machine was stopped.
        """
        self._require_running()
        return self._guarded(lambda: self._shoot(shot_id, exposure_s, dark=dark))

    def levels(self) -> Levels:
        """Read what is supervised.

        Raises
        ------
        DeviceLost
            If servos or lamp no longer answer; the machine is then stopped.
        Refused
            If the machine was stopped.
        """
        self._require_running()
        return self._guarded(
            lambda: Levels(self.supervisor.read(), self.lamp.temperature_deg_c(), self.lamp_output)
        )

    def darken(self) -> None:
        """Switch the light off; the next lit shot warms the lamp up again.

        Raises
        ------
        As `levels`.
        """
        self._require_running()
        self._guarded(self.lamp.off)
        self._warm = self.rig.lamp.warm_up_s == 0.0

    def stop(self) -> StopReport:
        """Stop everything: light off first, then every servo where it is; from any thread, on every way out.

        Never raises. Asked twice, it stops again and answers again.
        """
        self._stopped.set()
        with self._stop_lock:
            lamp, servos = self._lamp, self._servos
            if lamp is not None:
                lamp.darken()
            # Neither waits for what the other reads back.
            light = _Aside(lambda: _attempt("lamp", lambda: (lamp.halt(),)) if lamp is not None else ())
            arms = _attempt("servos", servos.halt) if servos is not None else ()
            self._report = StopReport(light.result() + arms)
            return self._report

    def condemn(self, cause: GonioError) -> StopReport:
        """Stop everything for a reason, which is then what every refusal says; the first reason stays."""
        if self._cause is None and not self._stopped.is_set():
            self._cause = cause
        return self.stop()

    def close(self) -> None:
        """Release ports, lock file and threads; a second time does nothing."""
        while self._exits:
            self._exits.pop()()

    def _shoot(self, shot_id: str, exposure_s: float, *, dark: bool) -> Path:
        self.arms.require_held()
        if not dark:
            self._warm_up()
        mark = self.camera.mark()
        shutter_s = self._trigger.expose(exposure_s, shot_id, dark=dark)
        self.lamp_output = math.nan if dark else self.lamp.output()
        self.arms.require_held()
        self._require_running()
        picture = self.camera.wait_for(
            shot_id,
            shutter_s,
            mark,
            self.rig.camera.file_timeout_s,
            lit=not dark,
            cancelled=self._stopped.is_set,
        )
        # Only now: a picture that arrives after its shot was given up would pass for the next try's.
        if abs(self.lamp_output - 1.0) > self.rig.lamp.monitor_band:
            self.camera.reject(picture, f"the lamp gave {self.lamp_output:.3g} times its light")
            raise Transient(
                f"the lamp gave {self.lamp_output:.3g} times the light of its level",
                where=f"shot {shot_id}",
                todo="see to the lamp, or widen lamp.monitor_band in the rig file",
            )
        return picture

    def _warm_up(self) -> None:
        """Let the lamp burn in once; a stop ends the wait."""
        if self._warm:
            return
        self.lamp.on()
        end = time.monotonic() + self.rig.lamp.warm_up_s
        while (left := end - time.monotonic()) > 0.0:
            self._stopped.wait(min(left, 1.0))
            self._require_running()
        if self.rig.lamp.mode == "LAMP":
            self.lamp.off()
        self._warm = True

    def _guarded(self, action: Callable[[], T]) -> T:
        self._at_work += 1
        try:
            return action()
        except (DeviceLost, Unsafe) as error:
            self.condemn(error)
            raise
        except GonioError:
            # A stop from another thread surfaces in this one as whatever it interrupted: say what it was.
            self._require_running()
            raise
        finally:
            self._at_work -= 1

    def _door_matters(self) -> bool:
        """Tell whether an open door is dangerous: there may be light, or arms move by themselves.

        A machine without its camera is moved by a person who stands beside it; between two poses somebody may
        have to change the sample.
        """
        return self.lamp.armed or (self._measures and self._at_work > 0)

    def _require_running(self) -> None:
        if self._cause is not None:
            raise self._cause
        if self._stopped.is_set():
            raise Refused("the machine was stopped", where=self.rig.name, todo="see why, then run again")


class _Aside:
    """One part's stop in a thread of its own; in this one where the system gives no more threads."""

    def __init__(self, halt: Callable[[], tuple[PartStop, ...]]) -> None:
        self._halt = halt
        self._parts: tuple[PartStop, ...] = ()
        self._thread = threading.Thread(target=self._run, name="stop", daemon=True)
        try:
            self._thread.start()
        except RuntimeError:
            self._run()

    def _run(self) -> None:
        self._parts = self._halt()

    def result(self) -> tuple[PartStop, ...]:
        """Wait for it."""
        if self._thread.is_alive():
            self._thread.join()
        return self._parts


def _attempt(part: str, halt: Callable[[], tuple[PartStop, ...]]) -> tuple[PartStop, ...]:
    try:
        return halt()
    except Exception as error:  # noqa: BLE001 - whatever fails here, the other parts are stopped too
        return (PartStop(part, StopOutcome.UNKNOWN, f"{type(error).__name__}: {error}"),)


def _no_camera(path: Path) -> FrameFacts:
    raise Refused("the machine was opened without its camera", where=str(path), todo="open it with inspect")


def require_port(port: str, what: str, option: str) -> None:
    """Pass only if a port is named.

    Raises
    ------
    BadInput
        If none is.
    """
    if not port:
        raise BadInput(f"no port for the {what}", where="rig", todo=f"give {option} or set it in rig.toml")


def open_machine(rig: Rig, *, inspect: Callable[[Path], FrameFacts] | None = None) -> Machine:
    """Open a machine: lock it, light off, handshake, set-up, torque on without a drop.

    Use it as a context manager: on every exit the light goes off and the arms are stopped.

    Parameters
    ----------
    rig : Rig
    inspect : callable, optional
        Path -> what a frame says of itself, as `capture.raw.inspect_frame`; raises `BadInput` where it does
        not decode. Without it the machine moves but makes no pictures, and needs no folder for them.

    Raises
    ------
    BadInput, Refused, DeviceLost, Unsafe
        If the machine is not as the rig file says.
    """
    return Machine(rig, inspect)
