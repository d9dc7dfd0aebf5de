"""The frames that characterise a sensor, shot with the machine: darks, flats on the white, far too long ones.

Exposure is what varies, at one pose and one level of the lamp: its controller times exposures better than a
level could be set. The levels are walked up, then down, then up again, so that a lamp that drifts makes the
two frames of a pair differ, which is taken out, but not the line of signal over exposure bend.

Where the sensor saturates is found by looking, not from metadata: a frame four times as long that is not
four times as bright.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.examine import Examiner
from capture.exposure import Shutter
from capture.feasible import feasible
from capture.guards import require_disk
from capture.raw import read_raw
from capture.sensor_recipe import Recipe
from capture.store import full_disk_in_one_line, write_durably
from rig.errors import BadInput, Refused, Transient
from rig.kinematics import Kinematics
from rig.machine import open_machine

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from capture.wishes import Wishes
    from rig.description import Rig
    from rig.machine import Machine

FRAMES_FOLDER = "frames"
LOG_FILE = "frames.jsonl"
"""One line for each frame: name, SHA-256, exposure, light, the lamp's output and temperature."""

POSES_DEG = ((30, 0), (45, 0), (20, 0), (60, 0), (0, 30), (0, 45), (30, 30), (45, 45))
"""Light's and camera's angle from the white's normal, in opposite directions; the first that is possible."""

TRIES = 3
"""Of one exposure, where a fault passes."""

_FIRST_S = 0.02
_STEP = 4.0
_STILL_LINEAR = 0.85
_LEAST_LIGHT_DN = 50.0
_PERCENTILE = 99.0
_BYTES_PER_PIXEL = 2


@dataclass(frozen=True)
class ShotFrames:
    """Where the frames are.

    Attributes
    ----------
    folder : Path
    complete : bool
        False where the person ended it early.
    lamp_temperature_deg_c : float
        Of the lamp head before the first exposure; NaN where none was made.
    """

    folder: Path
    complete: bool
    lamp_temperature_deg_c: float


def shoot_sensor(rig: Rig, folder: Path, wishes: Wishes, recipe: Recipe | None = None) -> ShotFrames:
    """Shoot all frames that characterise the sensor of a machine.

    Parameters
    ----------
    rig : Rig
        With the ports to use.
    folder : Path
        Gets `FRAMES_FOLDER` and `LOG_FILE`; made where it is missing.
    wishes : Wishes
        Progress, questions, interruption.
    recipe : Recipe, optional
        What to shoot.

    Returns
    -------
    ShotFrames

    Raises
    ------
    Refused
        No pose of the white is possible, nobody can mount it, the white is too bright or too dark, the disk
        is too small.
    GonioError
        From the machine, which is then stopped.
    """
    recipe = recipe or Recipe()
    angles_rad = _white_pose(rig)
    pixels = rig.camera.width_px * rig.camera.height_px
    flats = 2 * recipe.most_pairs * (recipe.levels + len(recipe.over))
    require_disk(folder, pixels * _BYTES_PER_PIXEL * (flats + recipe.biases + 3 * recipe.darks))
    station = _white_station(rig, wishes)
    if not rig.stations and "white" not in wishes.mounted and not _mounted(wishes):
        return ShotFrames(folder, complete=False, lamp_temperature_deg_c=math.nan)
    (folder / FRAMES_FOLDER).mkdir(parents=True, exist_ok=True)
    with open_machine(rig, inspect=Examiner(rig, None).inspect) as machine:
        wishes.controls.on_abort(machine.stop)
        temperature = machine.lamp.temperature_deg_c()
        machine.move(angles_rad, station)
        complete = _Shooting(machine, folder, wishes, Shutter.of(rig)).carry_out(recipe)
        return ShotFrames(folder, complete, temperature)


def _white_pose(rig: Rig) -> list[float]:
    """Angles of the first pose of the list that the machine can take."""
    theta = np.deg2rad(np.array(POSES_DEG, dtype=np.float64))
    zero = np.zeros(len(theta))
    wi = np.column_stack([np.sin(theta[:, 0]), zero, np.cos(theta[:, 0])])
    wo = np.column_stack([-np.sin(theta[:, 1]), zero, np.cos(theta[:, 1])])
    found = feasible(Kinematics(rig), wi, wo)
    if not len(found.taken):
        reasons = "; ".join(found.counts)
        raise Refused(
            f"the machine can look at the white in none of {len(theta)} poses: {reasons}",
            where="rig",
            todo="see gonio rig show, or shoot the frames by hand and give --frames-from",
        )
    return [float(angle) for angle in found.angles_rad[0]]


def _white_station(rig: Rig, wishes: Wishes) -> str | None:
    if not rig.stations:
        if "white" not in wishes.mounted and wishes.mount is None:
            raise Refused(
                "nobody can be asked to mount the white reference",
                where="gonio calibrate sensor",
                todo="mount it and say so with --mounted white",
            )
        return None
    station = next((name for name, each in rig.stations.items() if each.kind == "white"), None)
    if station is None:
        raise Refused("the wheel has no white", where="rig.stations", todo="give one of them kind = 'white'")
    return station


def _mounted(wishes: Wishes) -> bool:
    return wishes.mount is not None and wishes.mount("white", "the white reference")


class _Ended(Exception):  # noqa: N818 - no error: the person asked for it
    """The person ended it after the frame under way."""


class _Shooting:
    """An open machine that looks at the white."""

    def __init__(self, machine: Machine, folder: Path, wishes: Wishes, shutter: Shutter) -> None:
        self._machine, self._folder, self._wishes, self._shutter = machine, folder, wishes, shutter
        self._shots = 0

    def carry_out(self, recipe: Recipe) -> bool:
        """Shoot everything; whether it came to its end."""
        try:
            black = self._counts(self._shoot("look", self._shutter.times_s[0], lit=False))
            full_s, lit_pixels = self._find_saturation(black)
            self._all(recipe, full_s, lit_pixels)
        except _Ended:
            return False
        return True

    def _all(self, recipe: Recipe, full_s: float, lit_pixels: int) -> None:
        flats = recipe.flat_times_s(self._shutter, full_s)
        darks = recipe.dark_times_s(self._shutter, flats[-1])
        pairs = recipe.pairs(lit_pixels)
        numbers = [recipe.biases] + [recipe.darks] * (len(darks) - 1)
        total, done = sum(numbers) + 2 * pairs * len(flats), 0
        for level, (exposure_s, number) in enumerate(zip(darks, numbers, strict=True)):
            for index in range(number):
                self._keep(f"dark-{level:02}-{index:02}", exposure_s, lit=False)
                done += 1
                self._wishes.progress(done, total, f"dark {exposure_s:g} s")
        for walk in range(2 * pairs):
            levels = range(len(flats)) if walk % 2 == 0 else reversed(range(len(flats)))
            for level in levels:
                self._keep(f"flat-{level:02}-{walk:02}", flats[level], lit=True)
                done += 1
                self._wishes.progress(done, total, f"flat {flats[level]:g} s")

    def _find_saturation(self, black: NDArray[Any]) -> tuple[float, int]:
        """Exposure at which the brightest part saturates, and how many pixels are lit."""
        seen: dict[float, NDArray[Any]] = {}

        def light(exposure_s: float) -> tuple[float, float]:
            time = self._shutter.at_most(exposure_s)
            if time not in seen:
                seen[time] = self._counts(self._shoot("look", time, lit=True)) - black
            return time, float(np.percentile(seen[time], _PERCENTILE))

        longer_s, longer = light(_FIRST_S)
        while True:
            shorter_s, shorter = light(longer_s / _STEP)
            if shorter_s == longer_s:
                raise Refused(
                    f"the white saturates within {shorter_s:g} s, the shortest exposure",
                    where="gonio calibrate sensor",
                    todo="lower lamp.level in the rig file, or close the aperture",
                )
            linear = longer > _STILL_LINEAR * shorter * longer_s / shorter_s
            if linear or (shorter < _LEAST_LIGHT_DN and longer < _STEP * _LEAST_LIGHT_DN):
                break
            longer_s, longer = shorter_s, shorter
        while True:
            shorter_s, shorter = longer_s, longer
            longer_s, longer = light(shorter_s * _STEP)
            if longer_s == shorter_s:
                raise Refused(
                    f"the white does not saturate in {longer_s:g} s, the longest exposure",
                    where="gonio calibrate sensor",
                    todo="raise lamp.level in the rig file, or open the aperture",
                )
            dim = shorter < _LEAST_LIGHT_DN
            if not dim and longer < _STILL_LINEAR * shorter * longer_s / shorter_s:
                break
        bright = int(np.count_nonzero(seen[shorter_s] > 0.5 * shorter))
        return shorter_s * longer / shorter, bright

    def _shoot(self, name: str, exposure_s: float, *, lit: bool) -> Path:
        """Make one exposure; a passing fault is tried again."""
        if self._wishes.controls.finish_requested:
            raise _Ended
        self._shots += 1
        shot = f"cal-{self._shots:04}-{name}"
        for _ in range(TRIES - 1):
            try:
                return self._machine.shoot(shot, exposure_s, dark=not lit)
            except Transient as error:
                self._wishes.say(str(error))
        return self._machine.shoot(shot, exposure_s, dark=not lit)

    @staticmethod
    def _counts(path: Path) -> NDArray[Any]:
        """Read a frame that is only looked at, and remove it."""
        counts = read_raw(path).counts.astype(np.float64)
        path.unlink(missing_ok=True)
        return counts

    def _keep(self, name: str, exposure_s: float, *, lit: bool) -> None:
        arrived = self._shoot(name, exposure_s, lit=lit)
        with full_disk_in_one_line(self._folder):
            data = arrived.read_bytes()
            kept = self._folder / FRAMES_FOLDER / f"{name}{arrived.suffix}"
            write_durably(kept, data)
            output = self._machine.lamp_output
            line = {
                "file": f"{FRAMES_FOLDER}/{kept.name}",
                "sha256": hashlib.sha256(data).hexdigest(),
                "exposure_s": exposure_s,
                "lit": lit,
                "lamp_output": output if math.isfinite(output) else None,
                "lamp_temperature_deg_c": self._machine.lamp.temperature_deg_c(),
            }
            with (self._folder / LOG_FILE).open("a", encoding="utf-8") as log:
                log.write(json.dumps(line) + "\n")
            arrived.unlink(missing_ok=True)


def require_serial(rig: Rig, serial: str | None) -> None:
    """Pass only if frames are of the machine's camera; what is not stated cannot contradict.

    Raises
    ------
    BadInput
        They are of another.
    """
    if rig.camera.serial and serial and rig.camera.serial != serial:
        raise BadInput(
            f"the frames are of camera {serial}, the rig file names {rig.camera.serial}",
            where="camera.serial",
            todo="give frames of the machine's camera, or correct the rig file",
        )
