"""What RAW files can and cannot be trusted for, before anything is made of them."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.clip import measured_clip, single_frame_clip
from capture.frames import Stack, thin, thinning
from capture.raw import read_raw
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from capture.raw import PathLike, RawFrame

_SAMPLE_PIXELS = 2_000_000
_FEWEST_CODES = 64
_GAPS = 0.02
"""Part of the codes in the middle of a frame's range that may be missing where all are in use."""

DRIFT_DN = 0.5
"""How far the covered pixels may move between frames, or lie from the stated black level."""


@dataclass(frozen=True)
class FrameFacts:
    """What one file says about itself, and what its counts say.

    Attributes
    ----------
    path : str
        The file.
    camera, serial : str or None
        Make and model, serial number.
    iso, exposure_s, f_number : float or None
        The camera's settings.
    white_balance : tuple of float or None
        Gains of red, green and blue that the camera chose.
    width_px, height_px : int
        Size of the mosaic.
    cfa : tuple of str
        Colours at the four positions of the cell, row by row.
    black_dn : tuple of float
        Black level there, as stated.
    optical_black_dn : tuple of float or None
        Level of the covered pixels there.
    white_dn : float
        Clip level as stated.
    clip_dn : tuple of float or None
        Clip level at each position that this frame alone shows; None where it shows none.
    highest_dn : int
        Highest count.
    bits : int
        Bits that the highest count needs.
    step_dn : int
        Greatest common divisor of the counts below the highest: above 1 where lower bits are not in use.
    missing_codes : float
        Part of the codes in the middle half of the frame's counts that no pixel has, in steps of `step_dn`;
        NaN where there are too few codes to tell.
    linearised : bool
        Whether the counts came through a table or curve of the file.
    """

    path: str
    camera: str | None
    serial: str | None
    iso: float | None
    exposure_s: float | None
    f_number: float | None
    white_balance: tuple[float, ...] | None
    width_px: int
    height_px: int
    cfa: tuple[str, ...]
    black_dn: tuple[float, ...]
    optical_black_dn: tuple[float, ...] | None
    white_dn: float
    clip_dn: tuple[float | None, ...]
    highest_dn: int
    bits: int
    step_dn: int
    missing_codes: float
    linearised: bool


@dataclass(frozen=True)
class Finding:
    """Something to know before these files are merged.

    Attributes
    ----------
    what : str
        In words.
    files : tuple of str
        Which files it is about.
    todo : str
        What to do about it.
    """

    what: str
    files: tuple[str, ...]
    todo: str


@dataclass(frozen=True)
class Inspection:
    """Facts of each file, the clip levels that all show together, and what to know.

    Attributes
    ----------
    frames : tuple of FrameFacts
        In the order given.
    clip_dn : tuple of float or None
        Measured clip level at the four positions of the cell; None where nothing clips, or sizes differ.
    findings : tuple of Finding
        Empty where there is nothing to say.
    """

    frames: tuple[FrameFacts, ...]
    clip_dn: tuple[float | None, ...]
    findings: tuple[Finding, ...]


def inspect_files(files: Sequence[PathLike], exposure_s: Sequence[float | None] | None = None) -> Inspection:
    """Look at RAW files, one after the other.

    Parameters
    ----------
    files : sequence of path
        RAW files.
    exposure_s : sequence of float or None, optional
        Exposure times known from elsewhere, for the files that state none.

    Returns
    -------
    Inspection

    Raises
    ------
    BadInput
        No files, or one of them cannot be read.
    """
    if not files:
        raise BadInput("no files", todo="give at least one")
    facts, samples, hashes = [], [], dict[str, list[str]]()
    times = exposure_s or [None] * len(files)
    for file, seconds in zip(files, times, strict=True):
        frame = read_raw(file)
        digest = hashlib.sha256(frame.counts.tobytes()).hexdigest()
        hashes.setdefault(f"{frame.counts.shape}{digest}", []).append(str(frame.path))
        fact = _facts(frame)
        facts.append(replace(fact, exposure_s=fact.exposure_s or seconds))
        samples.append(thin(frame.counts, thinning(_shape(frame), _SAMPLE_PIXELS)))
    findings = [*_of_one(facts), *_of_copies(hashes.values()), *_of_settings(facts), *_of_drift(facts)]
    return Inspection(tuple(facts), _clip(facts, samples), tuple(findings))


def _shape(frame: RawFrame) -> tuple[int, int]:
    height, width = frame.counts.shape
    return height, width


def _facts(frame: RawFrame) -> FrameFacts:
    numbers = np.bincount(frame.counts.ravel())
    codes = np.flatnonzero(numbers)
    step = int(np.gcd.reduce(codes[:-1])) or 1  # the highest is where it clips, often between steps
    height, width = _shape(frame)
    covered = frame.optical_black_dn
    return FrameFacts(
        path=str(frame.path),
        camera=frame.camera_model,
        serial=frame.camera_serial,
        iso=frame.iso,
        exposure_s=frame.exposure_s,
        f_number=frame.f_number,
        white_balance=frame.white_balance,
        width_px=width,
        height_px=height,
        cfa=tuple(frame.channels[index] for index in frame.cfa.ravel()),
        black_dn=tuple(float(level) for level in frame.black_dn.ravel()),
        optical_black_dn=None if covered is None else tuple(float(level) for level in covered.ravel()),
        white_dn=frame.white_dn,
        clip_dn=tuple(
            single_frame_clip(frame.counts[row::2, col::2], float(frame.black_dn[row, col]))
            for row in (0, 1)
            for col in (0, 1)
        ),
        highest_dn=int(codes[-1]),
        bits=int(codes[-1]).bit_length(),
        step_dn=step,
        missing_codes=_missing(numbers, step),
        linearised=frame.linearised,
    )


def _missing(numbers: np.ndarray, step: int) -> float:
    """Part of the codes between the quartiles that nothing has, where each would have many."""
    total = np.cumsum(numbers)
    low, high = (int(np.searchsorted(total, part * total[-1])) for part in (0.25, 0.75))
    inside = numbers[low : high + 1 : step]
    if inside.size < _FEWEST_CODES or inside.sum() < 20 * inside.size:
        return math.nan
    return float(np.mean(inside == 0))


def _of_one(facts: Iterable[FrameFacts]) -> list[Finding]:
    findings = []
    for fact in facts:
        where = (fact.path,)
        if fact.linearised:
            what = "its counts came through a linearisation table: steps between codes differ"
            findings.append(Finding(what, where, "switch lossy compression off in the camera"))
        elif fact.missing_codes > _GAPS:
            what = f"{100 * fact.missing_codes:.0f} % of the codes in its middle range are never used"
            findings.append(Finding(what, where, "counts were stretched: do not derive noise from them"))
        if fact.step_dn > 1:
            what = f"its counts are multiples of {fact.step_dn}: lower bits are not in use"
            findings.append(Finding(what, where, "state quantisation_step_dn in the sensor's calibration"))
        if fact.exposure_s is None:
            findings.append(Finding("it states no exposure time", where, "give --exposure-s for the merge"))
        known = [level for level in fact.clip_dn if level is not None]
        if known and min(known) < 0.995 * fact.white_dn:
            what = f"it clips at {min(known):.0f} DN, and states {fact.white_dn:.0f}"
            findings.append(Finding(what, where, "the merge takes the measured level"))
    return findings


def _of_copies(groups: Iterable[list[str]]) -> list[Finding]:
    what, todo = "the same picture under different names", "leave all but one out"
    return [Finding(what, tuple(group), todo) for group in groups if len(group) > 1]


_SETTINGS: tuple[tuple[str, Callable[[FrameFacts], Any], str], ...] = (
    ("camera model", lambda fact: fact.camera, "merge frames of one camera"),
    ("camera serial", lambda fact: fact.serial, "merge frames of one camera"),
    ("size", lambda fact: (fact.width_px, fact.height_px), "merge frames of one crop"),
    ("colour filter layout", lambda fact: fact.cfa, "merge frames of one camera and crop"),
    ("black level", lambda fact: fact.black_dn, "merge frames of one camera at one setting"),
    ("ISO", lambda fact: fact.iso, "switch automatic ISO off"),
    ("aperture", lambda fact: fact.f_number, "change the exposure by time only"),
    ("white balance", lambda fact: fact.white_balance, "harmless here, but switch the automatic off"),
)


def _of_settings(facts: Sequence[FrameFacts]) -> list[Finding]:
    findings = []
    for name, value, todo in _SETTINGS:
        first = next((fact for fact in facts if value(fact) is not None), facts[0])
        silent = tuple(fact.path for fact in facts if value(fact) is None and value(first) is not None)
        differing = tuple(fact.path for fact in facts if value(fact) not in (None, value(first)))
        if differing:
            findings.append(Finding(f"{name} differs from that of {first.path}", differing, todo))
        if silent:
            findings.append(Finding(f"{name} is not stated, unlike in {first.path}", silent, todo))
    return findings


def _of_drift(facts: Sequence[FrameFacts]) -> list[Finding]:
    known = [(fact, np.asarray(fact.optical_black_dn)) for fact in facts if fact.optical_black_dn is not None]
    findings = []
    if known:
        levels = np.stack([level for _, level in known])
        moved = float(np.ptp(levels, axis=0).max())
        if moved > DRIFT_DN:
            what = f"the covered pixels move by {moved:.2f} DN between frames"
            todo = "shoot darks beside each bracket, at one temperature"
            findings.append(Finding(what, tuple(fact.path for fact, _ in known), todo))
    for fact, level in known:
        off = float(np.abs(level - np.asarray(fact.black_dn)).max())
        if off > DRIFT_DN:
            what = f"its covered pixels lie {off:.2f} DN from the black level that it states"
            findings.append(Finding(what, (fact.path,), "merge with darks"))
    return findings


def _clip(facts: Sequence[FrameFacts], samples: list[np.ndarray]) -> tuple[float | None, ...]:
    """Clip levels of a bracket, from its frames together; of frames alone where it is none."""
    times = [fact.exposure_s for fact in facts]
    lowest = tuple(
        min((level for level in levels if level is not None), default=None)
        for levels in zip(*(fact.clip_dn for fact in facts), strict=True)
    )
    stated = [seconds for seconds in times if seconds is not None]
    if len(stated) != len(times) or len({sample.shape for sample in samples}) > 1:
        return lowest
    black = np.reshape(facts[0].black_dn, (2, 2))
    stack = Stack(
        counts=tuple(samples),
        exposure_s=tuple(stated),
        cfa=None,
        channels=(),
        black_dn=black,
        white_dn=facts[0].white_dn,
        quantisation_step_dn=1.0,
        names=tuple(fact.path for fact in facts),
    )
    together = [level for row in measured_clip(stack, black) for level in row]
    return tuple(both if both is not None else one for both, one in zip(together, lowest, strict=True))
