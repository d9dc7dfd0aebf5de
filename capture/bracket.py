"""A bracket of files to one merge: times found, darks matched, ratios measured, agreement checked."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from capture.agreement import Agreement, agreement
from capture.bracket_checks import (
    refuse_all_clipped,
    refuse_foreign_calibration,
    refuse_foreign_darks,
    refuse_light_in_darks,
)
from capture.clip import clip_levels
from capture.dark import DarkModel, black_cell, subtrahend, with_hot_pixels
from capture.frames import as_stack, thinning
from capture.merge import Merged, merge_stack
from capture.ratios import ExposureFit, Ratio, fit_exposures, measure_ratios
from capture.raw import PathLike, RawHead, StreamedFrame, open_raw
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from capture.sensor import SensorModel

TIMES = ("auto", "nominal", "fitted")
"""Which exposure times a merge uses: "auto" takes the fitted ones where the frames refute the nominal."""

_NAME = re.compile(r"(?:^|[_\-. ])(\d+(?:\.\d+)?)(us|ms|s)(?=[_\-. ]|$)", re.IGNORECASE)
_UNITS_S = {"us": 1e-6, "ms": 1e-3, "s": 1.0}
_CLIP_PIXELS = 2_000_000


@dataclass(frozen=True, eq=False)
class BracketMerge:
    """A merged bracket with all that was found out about it.

    Attributes
    ----------
    frames : tuple of RawHead
        By ascending exposure.
    nominal_s : tuple of float
        Their stated exposure times.
    time_sources : tuple of str
        Where each came from: "file", "file name" or "given".
    used_s : tuple of float
        The times that the merge used.
    times : str
        "nominal" or "fitted".
    ratios : tuple of Ratio
        Measured ratios of neighbouring exposures.
    fit : ExposureFit
        Times that fit these.
    agreement : Agreement
        The frames against the merge.
    dark : DarkModel or None
        The darks' model.
    dark_time_sources : tuple of str
        Where each dark frame's exposure time came from.
    merged : Merged
        Radiance, variance, flags.
    """

    frames: tuple[RawHead, ...]
    nominal_s: tuple[float, ...]
    time_sources: tuple[str, ...]
    used_s: tuple[float, ...]
    times: str
    ratios: tuple[Ratio, ...]
    fit: ExposureFit
    agreement: Agreement
    dark: DarkModel | None
    dark_time_sources: tuple[str, ...]
    merged: Merged


def exposure_from_name(path: PathLike) -> float | None:
    """Exposure time that a file's name states, as in `disks_450nm_0250ms.dng`; None where it states none.

    Parameters
    ----------
    path : path
        Only its name is looked at.

    Returns
    -------
    float or None
        Seconds.
    """
    found = _NAME.findall(Path(path).stem)
    if len(found) != 1:
        return None
    number, unit = found[0]
    return float(number) * _UNITS_S[unit.lower()] or None


def timed_frames(
    files: Sequence[PathLike], exposure_s: Sequence[float] | None = None
) -> tuple[list[StreamedFrame], list[float], list[str]]:
    """Open frames and find their exposure times: as given, else from the file, else from its name.

    Parameters
    ----------
    files : sequence of path
        RAW files.
    exposure_s : sequence of float, optional
        Times in seconds, one per file.

    Returns
    -------
    frames : list of StreamedFrame
    exposure_s : list of float
    sources : list of str
        "given", "file" or "file name" for each.

    Raises
    ------
    BadInput
        A file cannot be read, no time is to be found, or there is another number of times than of files.
    """
    if exposure_s is not None and len(exposure_s) != len(files):
        what = f"{len(exposure_s)} exposure times for {len(files)} files"
        raise BadInput(what, where="--exposure-s", todo="give one per file, in order")
    frames, times, sources = [], [], []
    for index, file in enumerate(files):
        frame = open_raw(file)
        choices = {
            "given": exposure_s[index] if exposure_s is not None else None,
            "file": frame.exposure_s,
            "file name": exposure_from_name(file),
        }
        source = next((name for name, seconds in choices.items() if seconds is not None), None)
        if source is None:
            what = "neither the file nor its name states an exposure time"
            raise BadInput(what, where=str(file), todo="give --exposure-s, one time per file")
        frames.append(frame)
        times.append(float(choices[source] or 0.0))
        sources.append(source)
    return frames, times, sources


def merge_bracket(
    files: Sequence[PathLike],
    *,
    dark_files: Sequence[PathLike] = (),
    sensor: SensorModel | None = None,
    hot: NDArray[np.bool_] | None = None,
    exposure_s: Sequence[float] | None = None,
    times: str = "auto",
    truncated: bool = False,
    chi_square: bool = False,
) -> BracketMerge:
    """Merge the files of one bracket.

    Parameters
    ----------
    files : sequence of path
        RAW files of one scene by one camera.
    dark_files : sequence of path
        Dark frames; those of a frame's own exposure are preferred, others are interpolated in time.
    sensor : SensorModel, optional
        Noise model; without it the merge is Poisson.
    hot : ndarray of bool, shape (H, W), optional
        Hot pixels that are known, besides those that the darks show.
    exposure_s : sequence of float, optional
        Exposure times of `files`, where the files carry none or wrong ones.
    times : str
        One of `TIMES`.
    truncated : bool
        Whether the camera cuts its counts to whole steps instead of rounding them.
    chi_square : bool
        Whether to return the map of how well the frames agree.

    Returns
    -------
    BracketMerge

    Raises
    ------
    BadInput
        Files or times that cannot be used, a calibration or darks of another camera or setting, darks with
        light in them, or frames that are clipped everywhere.
    """
    if times not in TIMES:
        raise BadInput(f"times is {times!r}", todo=f"give one of {', '.join(TIMES)}")
    frames, seconds, sources = timed_frames(files, exposure_s)
    order = sorted(range(len(frames)), key=lambda index: seconds[index])
    frames = [frames[index] for index in order]
    seconds = [seconds[index] for index in order]
    sources = [sources[index] for index in order]
    stack = as_stack(frames, seconds)
    if sensor is not None:
        refuse_foreign_calibration(sensor, frames[0])
    dark, dark_sources = None, list[str]()
    if dark_files:
        dark_frames, dark_times, dark_sources = timed_frames(dark_files)
        refuse_foreign_darks(frames, dark_frames)
        dark = DarkModel.from_frames(dark_frames, dark_times)
        refuse_light_in_darks(
            dark, stack, [replace(f, exposure_s=s) for f, s in zip(dark_frames, dark_times, strict=True)]
        )
    levels = with_hot_pixels(subtrahend(dark, stack, sensor, truncated=truncated), hot, stack)
    clip = clip_levels(stack.thinned(thinning(stack.shape, _CLIP_PIXELS)), black_cell(levels), sensor)
    ratios = measure_ratios(stack, levels, clip)
    fit = fit_exposures(stack.exposure_s, ratios)
    fitted = times == "fitted" or (times == "auto" and fit.significant)
    if fitted:
        stack = replace(stack, exposure_s=fit.exposure_s)
    merged = merge_stack(stack, levels, sensor, chi_square=chi_square)
    refuse_all_clipped(merged, stack)
    return BracketMerge(
        frames=tuple(frames),
        nominal_s=tuple(seconds),
        time_sources=tuple(sources),
        used_s=stack.exposure_s,
        times="fitted" if fitted else "nominal",
        ratios=ratios,
        fit=fit,
        agreement=agreement(stack, levels, merged),
        dark=dark,
        dark_time_sources=tuple(dark_sources),
        merged=merged,
    )
