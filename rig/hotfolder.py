"""A camera that is triggered by the lamp controller and whose RAW files arrive in a folder.

Whose file it is, is proved, not assumed: it is new, its size is stable, it decodes, and camera, exposure,
light and (where it carries one) the shot's name match. Everything else is a stray, with the reason.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, TypeAlias

from rig.errors import BadInput, DeviceLost, Refused, Transient

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

POLL_S = 0.005
"""Pause between two looks into the folder."""

CLOCK_SLACK_S = 2.0
"""How much older than the trigger a file's time may read: other clocks, coarse file systems."""

EXPOSURE_RATIO = 2.0 ** (1.0 / 6.0)
"""Cameras round exposure times; half a third-stop apart is still the same step, more is another one."""

Entry: TypeAlias = tuple[str, int, int]
"""A file as it was: name, size in bytes, time of its last change in nanoseconds."""

RAW_SUFFIXES = frozenset(
    {".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".pef", ".raf", ".raw", ".rw2", ".tif", ".tiff"}
)
PARTIAL_SUFFIXES = frozenset({".part", ".partial", ".tmp", ".crdownload", ".lock"})


class FrameFacts(Protocol):
    """What a file says of itself; None where it says nothing."""

    @property
    def camera_serial(self) -> str | None:
        """Serial number of the camera."""

    @property
    def shutter_s(self) -> float | None:
        """How long the shutter was open."""

    @property
    def lit(self) -> bool | None:
        """Whether the lamp was on."""

    @property
    def shot_id(self) -> str | None:
        """Name of the shot."""


@dataclass(frozen=True, slots=True)
class Mark:
    """The folder at the moment of a trigger: what was there already cannot be its picture."""

    files: frozenset[Entry]
    wall_s: float


@dataclass(frozen=True, slots=True)
class Stray:
    """A file that is not the picture waited for."""

    path: Path
    reason: str


@dataclass(frozen=True, slots=True)
class _Wanted:
    shot_id: str
    shutter_s: float
    lit: bool | None
    mark: Mark


@dataclass(frozen=True, slots=True)
class _Look:
    """What one wait has seen so far."""

    wanted: _Wanted
    sizes: dict[str, Entry] = field(default_factory=dict)
    unreadable: dict[Entry, tuple[Path, str]] = field(default_factory=dict)
    strays: list[Stray] = field(default_factory=list)


class HotFolder:
    """The folder into which one camera's files fall.

    Parameters
    ----------
    folder : Path
        Where they fall.
    serial : str
        The camera's serial number; "" accepts any.
    inspect : callable
        Path -> facts of a frame; raises `BadInput` where it does not decode.
    on_stray : callable, optional
        Told of every stray, once.
    """

    def __init__(
        self,
        folder: Path,
        serial: str,
        inspect: Callable[[Path], FrameFacts],
        on_stray: Callable[[Stray], None] | None = None,
    ) -> None:
        self.folder, self.serial = folder, serial
        self.on_stray = on_stray
        self._inspect = inspect
        self._known: set[Entry] = set()
        """Files that were there before the first shot, were pictures, or have been reported."""
        self._marked = False

    def require(self) -> None:
        """Pass only if the folder is there.

        Raises
        ------
        BadInput
            If it is not.
        """
        if not self.folder.is_dir():
            raise BadInput(
                "no such folder for the camera's files",
                where=str(self.folder),
                todo="make it, or name another with --frames",
            )

    def mark(self) -> Mark:
        """Remember what is there, right before a trigger; what came unasked since the last one is a stray."""
        entries = list(self._entries())
        if not self._marked:
            self._known.update(entry for _, entry in entries)
            self._marked = True
        for path, entry in entries:
            if entry not in self._known:
                self._report(path, entry, "came when no picture was waited for")
        return Mark(frozenset(entry for _, entry in entries), time.time())

    def wait_for(
        self,
        shot_id: str,
        shutter_s: float,
        newer_than: Mark,
        timeout_s: float,
        *,
        lit: bool | None = None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Path:
        """Wait for the picture of one shot.

        Parameters
        ----------
        shot_id : str
            The shot's name, compared where the file carries one.
        shutter_s : float
            How long the shutter was open, compared to a sixth of a stop where the file carries it.
        newer_than : Mark
            The folder before the trigger.
        timeout_s : float
            Deadline.
        lit : bool, optional
            Whether the lamp was on, compared where the file carries it.
        cancelled : callable
            Asked at every look; true ends the waiting.

        Returns
        -------
        Path
            A complete, decodable file in the folder.

        Raises
        ------
        Transient
            If something arrived, but not the picture; the shot can be made again.
        DeviceLost
            If nothing arrived: the camera is off, or not triggered.
        Refused
            If the waiting was cancelled.
        """
        look = _Look(_Wanted(shot_id, shutter_s, lit, newer_than))
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if cancelled():
                raise Refused("the machine was stopped", where=f"shot {shot_id}", todo="run again")
            picture = self._look(look)
            if picture is not None:
                return picture
            time.sleep(POLL_S)
        self._report_unreadable(look)
        raise self._nothing(shot_id, timeout_s, look.strays)

    def reject(self, picture: Path, reason: str) -> None:
        """Report a picture that arrived as it should, and is none for another reason."""
        if self.on_stray is not None:
            self.on_stray(Stray(picture, reason))

    def _look(self, look: _Look) -> Path | None:
        """Look once: report what does not belong, return the picture if it is there."""
        picture: Path | None = None
        for path, entry in self._arrivals(look):
            try:
                facts = self._inspect(path)
            except (BadInput, OSError) as error:
                look.unreadable[entry] = (path, str(error))  # it may still grow, and is then another entry
                continue
            reason = self._mismatch(facts, entry, look.wanted)
            if not reason and picture is None:
                picture = path
                self._known.add(entry)
            else:
                look.strays.append(self._report(path, entry, reason or "a second picture of the same shot"))
        return picture

    def _entries(self) -> Iterator[tuple[Path, Entry]]:
        try:
            with os.scandir(self.folder) as entries:
                for entry in entries:
                    path = self.folder / entry.name
                    suffix = path.suffix.lower()
                    if entry.name.startswith(".") or suffix in PARTIAL_SUFFIXES or not entry.is_file():
                        continue
                    try:
                        status = path.stat()  # entry.stat() shows stale sizes on Windows
                    except FileNotFoundError:
                        continue  # moved away between two system calls
                    yield path, (entry.name, status.st_size, status.st_mtime_ns)
        except OSError as error:
            raise DeviceLost(
                f"the folder cannot be read ({error.strerror})",
                where=str(self.folder),
                todo="check the share or disk that it lies on",
            ) from error

    def _arrivals(self, look: _Look) -> Iterator[tuple[Path, Entry]]:
        """Yield new files whose size did not change between two looks."""
        for path, entry in list(self._entries()):
            if entry in look.wanted.mark.files or entry in self._known or entry in look.unreadable:
                continue
            if look.sizes.get(entry[0]) == entry and entry[1] > 0:
                yield path, entry
            look.sizes[entry[0]] = entry

    def _mismatch(self, facts: FrameFacts, entry: Entry, wanted: _Wanted) -> str:
        if entry[2] * 1e-9 < wanted.mark.wall_s - CLOCK_SLACK_S:
            return "older than the trigger"
        if self.serial and facts.camera_serial and facts.camera_serial != self.serial:
            return f"of camera {facts.camera_serial}, expected {self.serial}"
        if facts.shot_id and facts.shot_id != wanted.shot_id:
            return f"of shot {facts.shot_id}, expected {wanted.shot_id}"
        if facts.lit is not None and wanted.lit is not None and facts.lit != wanted.lit:
            return f"taken {'lit' if facts.lit else 'dark'}, expected the opposite"
        ratio = facts.shutter_s / wanted.shutter_s if facts.shutter_s else 1.0
        if not 1.0 / EXPOSURE_RATIO <= ratio <= EXPOSURE_RATIO:
            return f"exposed {facts.shutter_s:g} s, expected {wanted.shutter_s:g} s"
        return ""

    def _report(self, path: Path, entry: Entry, reason: str) -> Stray:
        self._known.add(entry)
        stray = Stray(path, reason)
        if self.on_stray is not None:
            self.on_stray(stray)
        return stray

    def _report_unreadable(self, look: _Look) -> None:
        for entry, (path, error) in look.unreadable.items():
            still_there = path.is_file() and path.stat().st_size == entry[1]
            if still_there:
                is_raw = path.suffix.lower() in RAW_SUFFIXES
                reason = f"does not decode: {error}" if is_raw else "not a RAW file"
                look.strays.append(self._report(path, entry, reason))

    def _nothing(self, shot_id: str, timeout_s: float, strays: list[Stray]) -> Transient | DeviceLost:
        where = f"{self.folder}, shot {shot_id}"
        if strays:
            listed = "; ".join(f"{stray.path.name} {stray.reason}" for stray in strays[:3])
            return Transient(
                f"its picture did not arrive within {timeout_s:g} s, but {listed}",
                where=where,
                todo="shoot again",
            )
        return DeviceLost(
            f"no file arrived within {timeout_s:g} s",
            where=where,
            todo="check that the camera is on, triggered, and saves into this folder",
        )
