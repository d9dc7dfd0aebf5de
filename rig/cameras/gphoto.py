"""A camera on USB: settings written and read back, pictures downloaded the moment they are taken.

It stands on libgphoto2 through python-gphoto2, an optional extra. The session stays open for the whole run:
opening a camera takes seconds, a shot does not. The picture goes into the hot folder like anybody else's,
where `rig.hotfolder` proves whose it is; this module only sees to it that it gets there.
"""

from __future__ import annotations

import contextlib
import time
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from rig.errors import BadInput, DeviceLost, Refused, Transient
from rig.hotfolder import EXPOSURE_RATIO

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

SHUTTER_SETTINGS = ("shutterspeed2", "shutterspeed", "exptime")
"""What makers call it; Nikon's first one is not rounded to names."""

BUSY_S, BUSY_POLL_MS = 5.0, 50
"""How long a busy camera is waited for, and how long each look at its events takes at most."""

REOPEN_S, REOPEN_POLL_S = 20.0, 0.5
"""How long a camera that went away may take to come back."""

_NO_MEMORY, _NO_SPACE = -3, -115
_BUSY, _CLAIMED = -110, -53
_GONE = frozenset({-7, -10, -31, -34, -35, -52, -60, -105})
"""Port, timeout, read, write, USB find, lock and model errors: whatever was there no longer answers."""


class Tether:
    """One camera on USB.

    Parameters
    ----------
    serial : str
        Its serial number; "" takes the only one there is.

    Attributes
    ----------
    serial : str
        As the camera says it.
    model : str

    Raises
    ------
    BadInput
        The extra is not installed.
    DeviceLost
        No such camera.
    Refused
        Several cameras and no serial number, or another program holds it.
    """

    def __init__(self, serial: str = "") -> None:
        self._gp = _library()
        self._wanted = serial
        self._camera: Any = None
        self._shutter_s: float | None = None
        self.serial = self.model = ""
        self._open()

    def __enter__(self) -> Tether:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let the camera go; a second time does nothing."""
        camera, self._camera = self._camera, None
        if camera is not None:
            with contextlib.suppress(self._gp.GPhoto2Error):
                camera.exit()

    def shutters_s(self) -> dict[str, float]:
        """Shutter times that the camera offers: its name for each, and seconds."""
        widget = self._shutter(self._config())
        names = [widget.get_choice(place) for place in range(widget.count_choices())]
        times = {name: seconds_of(name) for name in names}
        return {name: seconds for name, seconds in times.items() if seconds is not None}

    def set_shutter(self, exposure_s: float) -> float:
        """Set the shutter to the nearest time that the camera has, and read it back.

        Parameters
        ----------
        exposure_s : float

        Returns
        -------
        float
            The camera's own name for it, in seconds.

        Raises
        ------
        BadInput
            It has none within a sixth of a stop.
        Refused
            The setting does not stick.
        """
        choices = self.shutters_s()
        name = min(choices, key=lambda each: abs(choices[each] / exposure_s - 1.0), default="")
        found = choices.get(name, float("nan"))
        if not 1.0 / EXPOSURE_RATIO <= found / exposure_s <= EXPOSURE_RATIO:
            listed = ", ".join(choices) or "none"
            raise BadInput(
                f"the camera has no shutter time of {exposure_s:g} s", where=self._where(),
                todo=f"set camera.exposure_steps_per_stop and its range to what it has: {listed}",
            )  # fmt: skip
        with self._asked("set the shutter"):
            config = self._camera.get_config()
            self._shutter(config).set_value(name)
            self._camera.set_config(config)
        held = self._shutter(self._config()).get_value()
        if held != name:
            todo = "switch the camera to manual exposure (M)"
            raise Refused(f"the shutter was set to {name} but reads {held}", where=self._where(), todo=todo)
        self._shutter_s = found
        return found

    def shoot(self, exposure_s: float, shot_id: str, folder: Path) -> list[Path]:
        """Take one picture and download all that the camera makes of it.

        Parameters
        ----------
        exposure_s : float
            Shutter time.
        shot_id : str
            Begins the files' names.
        folder : Path
            Where they go; each appears complete.

        Returns
        -------
        list of Path
            One file, or several where the camera also writes a JPEG.

        Raises
        ------
        Transient
            The camera was busy, or went away and came back: the shot can be made again.
        DeviceLost
            It is gone.
        Refused
            Its store is full, or a setting does not stick.
        """
        if self._shutter_s is None or self._shutter_s != self._nearest(exposure_s):
            self.set_shutter(exposure_s)
        try:
            with self._asked("take a picture"):
                first = self._camera.capture(self._gp.GP_CAPTURE_IMAGE)
                places = [(first.folder, first.name), *self._further()]
                return [self._download(*place, shot_id, folder) for place in places]
        except DeviceLost as error:
            self._come_back(error)
            raise Transient(
                "the camera went away and came back", where=self._where(), todo="shoot again"
            ) from error

    # -- the camera's files

    def _further(self) -> Iterator[tuple[str, str]]:
        """Yield files that follow the first, until the camera has nothing more to say."""
        while True:
            kind, data = self._camera.wait_for_event(BUSY_POLL_MS)
            if kind == self._gp.GP_EVENT_FILE_ADDED:
                yield data.folder, data.name
            elif kind in {self._gp.GP_EVENT_TIMEOUT, self._gp.GP_EVENT_CAPTURE_COMPLETE}:
                return

    def _download(self, place: str, name: str, shot_id: str, folder: Path) -> Path:
        """Bring one file here under a name of its own, and free the camera of it."""
        file = self._camera.file_get(place, name, self._gp.GP_FILE_TYPE_NORMAL)
        data = memoryview(file.get_data_and_size())  # the bytes live as long as the file
        # The camera's own name comes again after it was switched off; a shot's second try has the same ID.
        path, again = folder / f"{shot_id}_{name}", 1
        while path.exists():
            again += 1
            path = folder / f"{shot_id}-{again}_{name}"
        hidden = path.with_name(f".{path.name}")
        try:
            hidden.write_bytes(data)
            hidden.replace(path)
        except OSError as error:
            hidden.unlink(missing_ok=True)
            todo = "free some space; the picture is still in the camera"
            raise Refused(error.strerror or "cannot be written", where=str(path), todo=todo) from error
        with contextlib.suppress(self._gp.GPhoto2Error):
            self._camera.file_delete(place, name)  # a protected file stays, and hurts nobody
        return path

    # -- settings

    def _config(self) -> Any:
        with self._asked("tell its settings"):
            return self._camera.get_config()

    def _shutter(self, config: Any) -> Any:
        for name in SHUTTER_SETTINGS:
            with contextlib.suppress(self._gp.GPhoto2Error):
                return config.get_child_by_name(name)
        todo = "switch it to manual exposure (M), or use it as a hotfolder camera"
        raise Refused("the camera's shutter cannot be set over USB", where=self._where(), todo=todo)

    def _nearest(self, exposure_s: float) -> float | None:
        """Return the time in force, if it is the right one for this exposure."""
        held = self._shutter_s
        if held is None or not 1.0 / EXPOSURE_RATIO <= held / exposure_s <= EXPOSURE_RATIO:
            return None
        return held

    # -- coming and going

    def _open(self) -> None:
        """Find the camera by its serial number and begin a session."""
        with self._asked("be found"):
            found = [(str(model), str(port)) for model, port in self._gp.Camera.autodetect()]
        seen = []
        for model, port in found:
            camera = self._session(model, port)
            serial = self._serial_of(camera)
            seen.append(f"{model} {serial}".strip())
            if self._is_wanted(serial) and (self._wanted or len(found) == 1):
                self._camera, self.serial, self.model = camera, serial, model
                return
            camera.exit()
        if len(seen) > 1 and not self._wanted:
            todo = "say which one with camera.serial in the rig file"
            raise Refused(f"{len(seen)} cameras: {', '.join(seen)}", where="USB", todo=todo)
        raise DeviceLost(
            f"no camera {self._wanted}".strip() + (f", but {', '.join(seen)}" if seen else ""),
            where="USB",
            todo="switch it on, connect it, and set it to PTP",
        )

    def _session(self, model: str, port: str) -> Any:
        gp = self._gp
        with self._asked("open"):
            ports, abilities = gp.PortInfoList(), gp.CameraAbilitiesList()
            ports.load()
            abilities.load()
            camera = gp.Camera()
            camera.set_port_info(ports[ports.lookup_path(port)])
            camera.set_abilities(abilities[abilities.lookup_model(model)])
            camera.init()
            return camera

    def _serial_of(self, camera: Any) -> str:
        with contextlib.suppress(self._gp.GPhoto2Error):
            return str(camera.get_config().get_child_by_name("serialnumber").get_value())
        return ""

    def _is_wanted(self, serial: str) -> bool:
        # One maker fills serial numbers up with zeros on USB and not in the file.
        return not self._wanted or serial.lstrip("0") == self._wanted.lstrip("0")

    def _come_back(self, error: DeviceLost) -> None:
        """Open the camera again, with its settings, or raise what was the matter."""
        exposure_s, self._shutter_s = self._shutter_s, None
        self.close()
        deadline = time.monotonic() + REOPEN_S
        while time.monotonic() < deadline:
            try:
                self._open()
            except DeviceLost:
                time.sleep(REOPEN_POLL_S)
                continue
            if exposure_s is not None:
                self.set_shutter(exposure_s)
            return
        raise error

    @contextlib.contextmanager
    def _asked(self, what: str) -> Iterator[None]:
        """Translate the library's errors, which are numbers, into ours."""
        try:
            yield
        except self._gp.GPhoto2Error as error:
            raise self._translated(error, what) from error

    def _translated(self, error: Any, what: str) -> Transient | DeviceLost | Refused:
        code, text = error.code, f"it did not {what}: {error.string} ({error.code})"
        if code == _BUSY:
            self._drain()
            return Transient(text, where=self._where(), todo="shoot again")
        if code == _CLAIMED:
            todo = "end whatever imports pictures there (gvfs, a photo manager), then run again"
            return Refused("another program holds the camera", where=self._where(), todo=todo)
        if code in {_NO_MEMORY, _NO_SPACE}:
            todo = "empty its card, or set its capture target to internal RAM"
            return Refused("the camera's store is full", where=self._where(), todo=todo)
        todo = "check cable, battery and mode dial; then run 'gonio rig check'"
        return DeviceLost(text, where=self._where(), todo=todo)

    def _drain(self) -> None:
        """Hear a busy camera out, until it falls silent."""
        deadline = time.monotonic() + BUSY_S
        with contextlib.suppress(self._gp.GPhoto2Error):
            while time.monotonic() < deadline:
                if self._camera.wait_for_event(BUSY_POLL_MS)[0] == self._gp.GP_EVENT_TIMEOUT:
                    return

    def _where(self) -> str:
        return f"camera {self.model} {self.serial or self._wanted}".strip()


def seconds_of(name: str) -> float | None:
    """Read a camera's name of a shutter time: `1/200`, `0.0100s`, `2.5`, `1/1.3`; None for bulb."""
    text = name.strip().lower().removesuffix("s").replace('"', ".").replace(",", ".").rstrip(".").strip()
    above, slash, below = text.partition("/")
    try:
        seconds = Fraction(above) / Fraction(below) if slash else Fraction(above)
    except (ValueError, ZeroDivisionError):
        return None
    return float(seconds) if seconds > 0 else None


def _library() -> Any:
    try:
        import gphoto2
    except ImportError:
        raise BadInput(
            "python-gphoto2 is not installed", where="camera", todo="pip install 'gonio[gphoto]'"
        ) from None
    return gphoto2
