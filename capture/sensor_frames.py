"""The frames that characterise a sensor: sorted into darks and flats, and checked before they are used.

What would spoil the result is named, not averaged in: a frame of another camera or another ISO, a dark frame
with light in it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from capture.bracket import exposure_from_name
from capture.dark import SAME_EXPOSURE
from capture.frames import thin, thinning
from capture.raw import read_raw
from rig.errors import BadInput
from rig.hotfolder import RAW_SUFFIXES

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from capture.raw import RawFrame

DARK_WORDS = ("dark", "bias", "blank")
"""A file is a dark frame where it says so itself, or where its name or its folder's holds one of these."""

LIGHT_SIGMAS = 6.0
"""How sure light in a dark frame must be."""

LEAST_LIGHT_DN = 0.25
"""Light in a dark frame below this changes nothing."""

_BLOCK = 16
_PIXELS = 1_000_000


@dataclass(frozen=True)
class Level:
    """Frames of one exposure, in the order in which they were shot (that of their names)."""

    exposure_s: float
    files: tuple[Path, ...]

    @property
    def pairs(self) -> tuple[tuple[Path, Path], ...]:
        """Neighbours two by two; an odd one is left out."""
        return tuple(zip(self.files[::2], self.files[1::2], strict=False))


@dataclass(frozen=True, eq=False)
class SensorFrames:
    """All frames of one characterisation.

    Attributes
    ----------
    darks, flats : tuple of Level
        By ascending exposure.
    first : RawFrame
        Any of them: camera, ISO, mosaic.
    """

    darks: tuple[Level, ...]
    flats: tuple[Level, ...]
    first: RawFrame


@dataclass(frozen=True)
class _Entry:
    path: Path
    exposure_s: float
    dark: bool
    camera: tuple[str | None, str | None]
    iso: float | None
    shape: tuple[int, ...]


def raw_files(folder: Path) -> list[Path]:
    """RAW files in a folder and below it, by name.

    Raises
    ------
    BadInput
        There is no such folder, or no such file in it.
    """
    if not folder.is_dir():
        raise BadInput("no such folder", where=str(folder), todo="give a folder with darks and flats")
    found = sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in RAW_SUFFIXES and not path.name.startswith(".") and path.is_file()
    )
    if not found:
        raise BadInput("no RAW files in it", where=str(folder), todo="give a folder with darks and flats")
    return found


def sort_frames(files: Sequence[Path], root: Path | None = None) -> SensorFrames:
    """Read what files say of themselves, check that they belong together, sort them.

    Parameters
    ----------
    files : sequence of Path
    root : Path, optional
        Names of folders below it count in telling darks from flats.

    Returns
    -------
    SensorFrames

    Raises
    ------
    BadInput
        A file that cannot be read, has no exposure time, or is of another camera, ISO or size than most; no
        darks, no flats.
    """
    entries, first = [], None
    for path in files:
        frame = read_raw(path)
        first = first or frame
        entries.append(_entry(frame, root))
    _require_one("camera", entries, [entry.camera for entry in entries])
    _require_one("ISO", entries, [entry.iso for entry in entries])
    _require_one("size", entries, [entry.shape for entry in entries])
    darks = _levels(entry for entry in entries if entry.dark)
    flats = _levels(entry for entry in entries if not entry.dark)
    if first is None or not darks:
        todo = "shoot some with the lamp off, and put 'dark' into their names or their folder's"
        raise BadInput("no dark frames among the files", todo=todo)
    if not flats:
        raise BadInput("no flat frames among the files", todo="shoot pairs of the evenly lit white")
    return SensorFrames(darks, flats, first)


def _entry(frame: RawFrame, root: Path | None) -> _Entry:
    path = frame.path
    exposure_s = frame.exposure_s if frame.exposure_s is not None else exposure_from_name(path)
    if exposure_s is None:
        what = "neither the file nor its name states an exposure time"
        raise BadInput(what, where=str(path), todo="name it such as flat-01_0250ms.tif")
    words = path.stem if root is None else str(path.relative_to(root).with_suffix(""))
    dark = any(word in words.lower() for word in DARK_WORDS) if frame.lit is None else not frame.lit
    camera = (frame.camera_serial, frame.camera_model)
    return _Entry(path, float(exposure_s), dark, camera, frame.iso, frame.counts.shape)


def _require_one(what: str, entries: Sequence[_Entry], values: Sequence[object]) -> None:
    usual, _ = Counter(values).most_common(1)[0] if values else (None, 0)
    for entry, value in zip(entries, values, strict=True):
        if value != usual:
            raise BadInput(
                f"of another {what} than the other frames: {_text(value)}, not {_text(usual)}",
                where=str(entry.path),
                todo="take it out, or give frames of one camera at one setting",
            )


def _text(value: object) -> str:
    parts = value if isinstance(value, tuple) else (value,)
    return " ".join("unstated" if part is None else f"{part}" for part in parts)


def _levels(entries: Iterable[_Entry]) -> tuple[Level, ...]:
    groups: list[tuple[float, list[Path]]] = []
    for entry in sorted(entries, key=lambda entry: (entry.exposure_s, entry.path)):
        if groups and entry.exposure_s - groups[-1][0] <= SAME_EXPOSURE * entry.exposure_s:
            groups[-1][1].append(entry.path)
        else:
            groups.append((entry.exposure_s, [entry.path]))
    return tuple(Level(exposure_s, tuple(sorted(paths))) for exposure_s, paths in groups)


def require_dark(darks: Sequence[Level], flat: RawFrame) -> None:
    """Pass only if no dark frame holds light.

    Light shows as the pattern of a flat frame, by place and by colour, and as more signal than the other
    darks of its exposure have.

    Parameters
    ----------
    darks : sequence of Level
    flat : RawFrame
        A frame with light, from the same camera.

    Raises
    ------
    BadInput
        Names the frame and the light in it.
    """
    reference = np.median([_blocks(read_raw(path)) for path in darks[0].files], axis=0)
    pattern = _blocks(flat) - reference
    contrast = pattern - pattern.mean()
    power = float(np.sum(contrast**2))
    for level in darks:
        blocks = [_blocks(read_raw(path)) for path in level.files]
        middle = float(np.median([np.median(each) for each in blocks]))
        for path, each in zip(level.files, blocks, strict=True):
            difference = each - reference
            share = float(np.sum((difference - difference.mean()) * contrast)) / power if power else 0.0
            rest = difference - difference.mean() - share * contrast
            light_dn = share * float(pattern.mean())
            noise_dn = float(rest.std()) / np.sqrt(power) * float(pattern.mean()) if power else 0.0
            more_dn = float(np.median(each)) - middle
            spread_dn = float(rest.std())
            if light_dn > max(LIGHT_SIGMAS * noise_dn, LEAST_LIGHT_DN):
                raise _lit(path, light_dn)
            if more_dn > max(LIGHT_SIGMAS * spread_dn, 2.0):
                raise _lit(path, more_dn)


def _lit(path: Path, light_dn: float) -> BadInput:
    return BadInput(
        f"a dark frame with light in it: about {light_dn:.3g} DN",
        where=str(path),
        todo="close the dark room, cover the viewfinder, and shoot the darks again",
    )


def _blocks(frame: RawFrame) -> NDArray[np.float64]:
    """Means over blocks of each position of the cell, without the pixels that stand out."""
    counts = thin(frame.counts, thinning(frame.counts.shape, _PIXELS)).astype(np.float64)
    means = []
    for row in (0, 1):
        for col in (0, 1):
            part = counts[row::2, col::2]
            size = max(1, min(_BLOCK, *part.shape))
            rows, cols = part.shape[0] // size, part.shape[1] // size
            whole = part[: rows * size, : cols * size].reshape(rows, size, cols, size)
            tiles = whole.transpose(0, 2, 1, 3).reshape(rows * cols, size * size)
            middle = np.median(tiles, axis=1, keepdims=True)
            spread = 1.4826 * np.median(np.abs(tiles - middle), axis=1, keepdims=True) + 0.5
            means.append(np.clip(tiles, middle - 4.0 * spread, middle + 4.0 * spread).mean(axis=1))
    return np.concatenate(means)
