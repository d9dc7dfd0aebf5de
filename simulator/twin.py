"""Start a twin as a process of its own and have it end with this one."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from typing import TYPE_CHECKING, Any

from rig.errors import DeviceLost
from simulator.light_process import error_from

if TYPE_CHECKING:
    from collections.abc import Mapping
    from os import PathLike
    from pathlib import Path
    from types import TracebackType

    from simulator.materials import Material

_FAREWELL_S = 5.0


class Twin:
    """A twin of the rig in a process of its own, until the `with` block ends or this process dies.

    Parameters
    ----------
    materials : mapping of str to str or Material, optional
        What the stations hold, by station, such as ``{"sample1": "lambert:kd=0.5"}``.
    seed : int
        Decides noise and every hidden truth.
    speed : float
        Motion and exposures run this many times faster than the clock.
    rig : path, optional
        Rig file of the machine to imitate; by default the default machine.
    folder : path, optional
        Where to put everything, and keep it; by default a temporary folder.
    log : bool
        Whether to keep a log of the wires.
    variant : str, optional
        Mitsuba's variant; by default the fastest that works.
    faults : path, optional
        Script of faults, see `simulator.faults`.
    backlash_deg, steady_error_ticks : float
        Flaws of every servo, see `simulator.shaft.Flaws`.
    housing_albedo : float, optional
        Of the walls around the machine; 0 is black; by default what the rig file says.
    tolerance : float, optional
        Error of the light that is allowed, relative to the mean radiance over the sample;
        likewise.

    Attributes
    ----------
    servos, lamp : str
        Ports.
    baud : int
        Of the servos; any works.
    ids : list of int
        Of the servos.
    frames : str
        The hot folder.
    rig : str
        A rig file that fits this twin.

    Raises
    ------
    GonioError
        On entering: a rig file or material that cannot be used, a folder that cannot be written.
    """

    servos: str
    baud: int
    ids: list[int]
    lamp: str
    frames: str
    rig: str

    def __init__(
        self,
        materials: Mapping[str, str | Material] | None = None,
        *,
        seed: int = 0,
        speed: float = 1.0,
        rig: str | PathLike[str] | None = None,
        folder: str | PathLike[str] | None = None,
        log: bool = True,
        variant: str | None = None,
        faults: str | PathLike[str] | None = None,
        backlash_deg: float = 0.0,
        steady_error_ticks: float = 0.0,
        housing_albedo: float | None = None,
        tolerance: float | None = None,
    ) -> None:
        self._arguments = [f"--seed={seed}", f"--speed={speed!r}"]
        for station, material in (materials or {}).items():
            spec = material if isinstance(material, str) else material.spec
            self._arguments.append(f"--station={station}={spec}")
        self._arguments += [f"--rig={rig}"] if rig else []
        self._arguments += [f"--folder={folder}"] if folder else []
        self._arguments += [f"--variant={variant}"] if variant else []
        self._arguments += [f"--faults={faults}"] if faults else []
        self._arguments += [f"--backlash-deg={backlash_deg!r}"]
        self._arguments += [f"--steady-error-ticks={steady_error_ticks!r}"]
        self._arguments += [] if housing_albedo is None else [f"--housing-albedo={housing_albedo!r}"]
        self._arguments += [] if tolerance is None else [f"--tolerance={tolerance!r}"]
        self._arguments += [] if log else ["--no-log"]
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Twin:
        # A session of its own: Ctrl-C is for the client, which must find its rig alive while it tidies up.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "simulator", *self._arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            ready = self._hear()
        except BaseException:
            self.close()
            raise
        if "error" in ready:
            self.close()
            raise error_from(ready["error"])
        self.servos, self.baud, self.ids = ready["servos"], ready["baud"], ready["ids"]
        self.lamp, self.frames, self.rig = ready["lamp"], ready["frames"], ready["rig"]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def pid(self) -> int:
        """The process that serves the wires."""
        return self._running().pid

    @property
    def folder(self) -> Path:
        """The twin's folder."""
        from pathlib import Path

        return Path(self.rig).parent

    def wire_log(self) -> list[dict[str, Any]]:
        """Return everything that has happened so far.

        Returns
        -------
        list of dict
            In order of time. `t` is the monotonic time; `line` is "servos" or "lamp" with `direction` ("in"
            from the client, "out" to it) and `data` (hex), or "state" with `event`: "light" (`on`), "shutter"
            (`open`), "exposed", "aborted", "fault", "frame", "frame_failed", "watchdog", "interlock",
            "client_gone".
        """
        process = self._running()
        if process.stdin:
            process.stdin.write("flush\n")
            process.stdin.flush()
            self._hear()
        lines = (self.folder / "wire.log").read_text(encoding="ascii").splitlines()
        # What the lamp does by itself is noted when the loop gets to it, with the time when it was due.
        return sorted(map(json.loads, lines), key=lambda event: float(event["t"]))

    def close(self) -> None:
        """End the twin; its temporary folder goes with it."""
        if self._process is None:
            return
        process, self._process = self._process, None
        with contextlib.suppress(OSError):
            if process.stdin:
                process.stdin.close()
        try:
            process.wait(_FAREWELL_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout:
            process.stdout.close()

    def _running(self) -> subprocess.Popen[str]:
        if self._process is None:
            raise DeviceLost("the twin is not running", where="twin", todo="use it inside its `with` block")
        return self._process

    def _hear(self) -> dict[str, Any]:
        """Read one line that the process says."""
        process = self._running()
        line = process.stdout.readline() if process.stdout else ""
        if not line:
            raise DeviceLost(
                f"the twin's process has ended with code {process.wait()}",
                where="twin",
                todo="see the lines above",
            )
        record: dict[str, Any] = json.loads(line)
        return record
