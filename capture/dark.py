"""Darks: what a pixel reads without light, how sure that is, and which pixels are hot.

A dark model is bias plus rate times exposure, fitted per pixel to frames of several exposures; where a
frame's own exposure was shot dark, the mean of those frames is used as it is, which also removes what is
not linear in time.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.raw import RawFrame, RawHead, StreamedFrame, read_raw
from rig.errors import BadInput

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.frames import FrameLike, Stack
    from capture.sensor import SensorModel

SAME_EXPOSURE = 1e-3
"""Exposures that differ by less than this fraction are the same."""

HOT_SIGMAS = 6.0
"""How far from its neighbours' dark level a pixel is hot, in robust standard deviations."""

_INNER_SIGMAS = 4.0

DITHERED_DN = 0.3
"""Noise from which on a mean of cut counts is half a step low whatever its level: the error left, of the size
exp(-2 pi^2 s^2) / pi (Widrow, Kollar and Liu 1996), is below 0.06 steps."""

SMALLEST_VARIANCE_DN2 = 1.0 / 12.0
"""Variance of a count's rounding: no dark frame is known better than this over the number of frames."""


@dataclass(frozen=True, eq=False)
class DarkModel:
    """Dark level of one camera, from frames without light.

    Attributes
    ----------
    exposure_s : tuple of float
        The distinct dark exposures, ascending.
    frames : tuple of int
        How many frames each of them had.
    mean_dn : tuple of ndarray of float32, each (H, W)
        Mean dark frame of each of them, black included.
    bias_dn, rate_dn_per_s : ndarray of float32, shape (H, W)
        Weighted least squares of the means over exposure; the rate is 0 where one exposure was shot.
    covariance : ndarray, shape (2, 2)
        Of (bias, rate), per unit of `noise_variance_dn2`; the same for all pixels.
    noise_variance_dn2 : float
        Variance of one dark frame over time, mean over ordinary pixels, quantisation included.
    hot : ndarray of bool, shape (H, W)
        Pixels whose level at any exposure, or whose variance, lies far outside the others'.
    """

    exposure_s: tuple[float, ...]
    frames: tuple[int, ...]
    mean_dn: tuple[NDArray[np.float32], ...]
    bias_dn: NDArray[np.float32]
    rate_dn_per_s: NDArray[np.float32]
    covariance: NDArray[np.float64]
    noise_variance_dn2: float
    hot: NDArray[np.bool_]

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self.hot.shape
        return height, width

    def index_of(self, exposure_s: float) -> int | None:
        """Which of the dark exposures a frame's exposure is; None where it was not shot dark."""
        for index, seconds in enumerate(self.exposure_s):
            if abs(seconds - exposure_s) <= SAME_EXPOSURE * exposure_s:
                return index
        return None

    @classmethod
    def from_frames(cls, frames: Iterable[FrameLike], exposure_s: Sequence[float] | None = None) -> DarkModel:
        """Fit a dark model; files are read one at a time.

        Parameters
        ----------
        frames : iterable of 2-D arrays, RawFrames or paths
            Frames without light, any number of each exposure.
        exposure_s : sequence of float, optional
            Their exposures in seconds, same order; None where the frames carry them.

        Returns
        -------
        DarkModel

        Raises
        ------
        BadInput
            No frames, shapes that differ, NaN, or an exposure that is missing or negative.
        """
        sums = _sums_by_exposure(frames, exposure_s)
        times = tuple(sorted(sums))
        numbers = tuple(sums[seconds].number for seconds in times)
        means = tuple(sums[seconds].mean() for seconds in times)
        freedom = sum(numbers) - len(numbers)
        scatter = sum((sums[seconds].squares() for seconds in times), np.zeros(means[0].shape))
        hot = np.zeros(means[0].shape, dtype=bool)
        for mean, number in zip(means, numbers, strict=True):
            hot |= _outliers(mean, SMALLEST_VARIANCE_DN2 / number)
        noise = SMALLEST_VARIANCE_DN2
        if freedom > 0:
            ordinary = scatter[~hot] if not hot.all() else scatter
            noise = max(noise, float(ordinary.mean()) / freedom)
            hot |= scatter > noise * _chi_square_limit(freedom)
        bias, rate, covariance = _line(times, numbers, means)
        return cls(
            exposure_s=times,
            frames=numbers,
            mean_dn=tuple(mean.astype(np.float32) for mean in means),
            bias_dn=bias.astype(np.float32),
            rate_dn_per_s=rate.astype(np.float32),
            covariance=covariance,
            noise_variance_dn2=noise,
            hot=hot,
        )


class _Sum:
    """Running sums of the frames of one exposure, relative to the first frame so that nothing cancels."""

    def __init__(self, first: NDArray[Any]) -> None:
        self._first = first.astype(np.float64)
        self._sum = np.zeros(first.shape)
        self._squares = np.zeros(first.shape)
        self.number = 0

    def add(self, frame: NDArray[Any]) -> None:
        difference = frame - self._first
        self._sum += difference
        self._squares += difference**2
        self.number += 1

    def mean(self) -> NDArray[np.float64]:
        return self._first + self._sum / self.number

    def squares(self) -> NDArray[np.float64]:
        """Sum of squared deviations from the mean."""
        return np.maximum(self._squares - self._sum**2 / self.number, 0.0)


def _sums_by_exposure(frames: Iterable[FrameLike], exposure_s: Sequence[float] | None) -> dict[float, _Sum]:
    listed = list(frames)
    if not listed:
        raise BadInput("no dark frames", todo="give at least one")
    if exposure_s is not None and len(exposure_s) != len(listed):
        raise BadInput(
            f"{len(exposure_s)} exposure times for {len(listed)} dark frames", todo="give one each"
        )
    sums: dict[float, _Sum] = {}
    shape: tuple[int, ...] | None = None
    for index, item in enumerate(listed):
        frame = read_raw(item) if isinstance(item, str | os.PathLike) else item
        name = str(frame.path) if isinstance(frame, RawHead) else f"dark frame {index}"
        counts = frame.counts[:] if isinstance(frame, RawFrame | StreamedFrame) else np.asarray(frame)
        shape = shape or counts.shape
        if counts.ndim != 2 or counts.shape != shape or not np.isfinite(counts).all():
            what = f"it is {counts.shape} where {shape} and finite counts are needed"
            raise BadInput(what, where=name, todo="give darks of one camera and one crop")
        seconds = exposure_s[index] if exposure_s is not None else getattr(frame, "exposure_s", None)
        if seconds is None or not (math.isfinite(seconds) and seconds >= 0.0):
            what = "it carries no exposure time" if seconds is None else f"its exposure time is {seconds} s"
            raise BadInput(what, where=name, todo="give the exposure times of the darks")
        known = next((t for t in sums if abs(t - seconds) <= SAME_EXPOSURE * max(seconds, t)), None)
        key = float(seconds) if known is None else known
        sums.setdefault(key, _Sum(counts)).add(counts)
    return sums


def _outliers(mean: NDArray[np.float64], known_variance: float) -> NDArray[np.bool_]:
    """Pixels far from the median of their position in the 2 x 2 cell (black differs by position)."""
    far = np.zeros(mean.shape, dtype=bool)
    for row in (0, 1):
        for col in (0, 1):
            part = mean[row::2, col::2]
            if part.size == 0:
                continue
            middle = np.median(part)
            distance = np.abs(part - middle)
            spread = max(1.4826 * float(np.median(distance)), math.sqrt(known_variance))
            # Means of few counts lie on a grid, and so does their median: the mean square within is finer.
            inner = distance[distance <= _INNER_SIGMAS * spread]
            spread = max(float(np.sqrt(np.mean(inner**2))), math.sqrt(known_variance))
            far[row::2, col::2] = distance > HOT_SIGMAS * spread
    return far


def _chi_square_limit(freedom: int) -> float:
    """Chi-square that noise exceeds as rarely as `HOT_SIGMAS` (Wilson and Hilferty 1931)."""
    step = 2.0 / (9.0 * freedom)
    return freedom * (1.0 - step + HOT_SIGMAS * math.sqrt(step)) ** 3


def _line(
    times: tuple[float, ...], numbers: tuple[int, ...], means: tuple[NDArray[np.float64], ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Weighted least squares of bias and rate per pixel; weights are the numbers of frames."""
    weights = np.asarray(numbers, dtype=np.float64)
    if len(times) == 1:
        return means[0], np.zeros_like(means[0]), np.array([[1.0 / weights[0], 0.0], [0.0, 0.0]])
    design = np.column_stack([np.ones(len(times)), times])
    covariance = np.linalg.inv(design.T @ (weights[:, np.newaxis] * design))
    solver = covariance @ (design.T * weights)
    bias = sum((w * mean for w, mean in zip(solver[0], means, strict=True)), np.zeros_like(means[0]))
    rate = sum((w * mean for w, mean in zip(solver[1], means, strict=True)), np.zeros_like(means[0]))
    return bias, rate, covariance


Dark = DarkModel | float | np.ndarray | Sequence[Any] | None
"""What `capture.merge.merge` takes as darks; see there."""


@dataclass(frozen=True, eq=False)
class Subtrahend:
    """The dark level of each frame of a stack, and how uncertain it is.

    Attributes
    ----------
    level_dn : tuple of ndarray, each (H, W), (2, 2) or (1, 1)
        What to subtract from each frame; a cell of 2 x 2 repeats over the mosaic.
    variance_dn2 : tuple of float
        Variance of each level that is independent between frames.
    common_dn2 : tuple of float
        Variances that all frames share: of the bias, of bias and rate, of the rate.
    rate_dn_per_s : ndarray, shape (H, W) or (1, 1)
        Dark signal per second, for its shot noise.
    hot : ndarray of bool, shape (H, W), or None
        Hot pixels; None where no darks tell.
    matched : bool
        Whether every frame has darks of its own exposure.
    """

    level_dn: tuple[NDArray[Any], ...]
    variance_dn2: tuple[float, ...]
    common_dn2: tuple[float, float, float]
    rate_dn_per_s: NDArray[Any]
    hot: NDArray[np.bool_] | None
    matched: bool


def subtrahend(
    dark: Dark, stack: Stack, sensor: SensorModel | None = None, *, truncated: bool = False
) -> Subtrahend:
    """Work out what to subtract from each frame of a stack.

    Parameters
    ----------
    dark : DarkModel, float, ndarray, sequence or None
        As `capture.merge.merge` takes it.
    stack : Stack
        The frames.
    sensor : SensorModel, optional
        Its black level and dark current stand in where there are no darks.
    truncated : bool
        Whether the camera cuts its counts to whole steps; a sensor model that says so is believed too.

    Returns
    -------
    Subtrahend

    Raises
    ------
    BadInput
        Darks that do not fit the frames, or that cannot tell the level at their exposures.
    """
    if isinstance(dark, Sequence) and dark and all(isinstance(d, RawHead | str | os.PathLike) for d in dark):
        dark = DarkModel.from_frames(dark)
    found = _from_model(dark, stack) if isinstance(dark, DarkModel) else _from_levels(dark, stack, sensor)
    if not (truncated or (sensor is not None and sensor.truncated)):
        return found
    if isinstance(dark, DarkModel):
        return half_step_down(found, dark.noise_variance_dn2, stack.quantisation_step_dn)
    measured = dark is None and sensor is not None and sensor.black_dn is not None
    noise = sensor.floor_variance_dn2 if measured and sensor is not None else 0.0
    return half_step_down(found, noise, stack.quantisation_step_dn)


def _from_levels(dark: object, stack: Stack, sensor: SensorModel | None) -> Subtrahend:
    """Levels that are given, or stated by sensor model or files."""
    rate = np.full((1, 1), sensor.dark_current_dn_per_s if sensor else 0.0)
    if dark is None:
        black = sensor.black_dn if sensor is not None else None
        cell = np.reshape(black, (2, 2)) if black is not None else stack.black_dn
        level = np.zeros((1, 1)) if cell is None else np.asarray(cell, dtype=np.float64)
        level = level[:1, :1] if np.all(level == level[0, 0]) else level
        levels = tuple(level + rate * seconds for seconds in stack.exposure_s)
        return Subtrahend(levels, (0.0,) * len(levels), (0.0, 0.0, 0.0), rate, None, matched=False)
    levels, raw_darks = _given_levels(dark, stack)
    variance = sensor.floor_variance_dn2 if sensor is not None and raw_darks else 0.0
    return Subtrahend(levels, (variance,) * len(levels), (0.0, 0.0, 0.0), rate, None, matched=False)


def half_step_down(dark: Subtrahend, noise_variance_dn2: float, step_dn: float) -> Subtrahend:
    """Lower the levels of a camera that cuts its counts to whole steps where others round them.

    Light's own noise spreads the counts of lit pixels over their steps: their mean is half a step low. Darks
    with enough noise are as low, and nothing remains to be done; darks without it stand where they are.

    Parameters
    ----------
    dark : Subtrahend
    noise_variance_dn2 : float
        Of one count without light; 0 where the levels are stated, not measured.
    step_dn : float
        Distance of neighbouring codes.
    """
    if noise_variance_dn2 >= (DITHERED_DN * step_dn) ** 2 + step_dn**2 / 12.0:
        return dark
    half = np.float32(0.5 * step_dn)
    return replace(dark, level_dn=tuple(level - half for level in dark.level_dn))


def with_hot_pixels(dark: Subtrahend, hot: NDArray[np.bool_] | None, stack: Stack) -> Subtrahend:
    """Add the hot pixels of the sensor's calibration to those that the darks show.

    Parameters
    ----------
    dark : Subtrahend
    hot : ndarray of bool, shape (H, W), or None
    stack : Stack
        The frames.

    Raises
    ------
    BadInput
        The map is of another size than the frames.
    """
    if hot is None:
        return dark
    if hot.shape != stack.shape:
        what = f"the calibration's hot pixels are of {hot.shape}, the frames of {stack.shape}"
        raise BadInput(what, where=stack.names[0], todo="calibrate the sensor with the crop that is in use")
    return replace(dark, hot=hot if dark.hot is None else dark.hot | hot)


def _from_model(dark: DarkModel, stack: Stack) -> Subtrahend:
    if dark.shape != stack.shape:
        what = f"the darks are {dark.shape}, the frames {stack.shape}"
        raise BadInput(what, todo="give darks of the same camera and crop")
    rate = np.maximum(dark.rate_dn_per_s, 0.0)
    indices = [dark.index_of(seconds) for seconds in stack.exposure_s]
    known = [index for index in indices if index is not None]
    # Two frames of one exposure share one mean dark: only distinct exposures have independent darks.
    if len(known) == len(indices) and len(set(known)) == len(known):
        levels = tuple(dark.mean_dn[index] for index in known)
        variances = tuple(dark.noise_variance_dn2 / dark.frames[index] for index in known)
        return Subtrahend(levels, variances, (0.0, 0.0, 0.0), rate, dark.hot, matched=True)
    if len(known) == len(indices) and len(set(known)) == 1:
        levels = tuple(dark.mean_dn[index] for index in known)
        shared = dark.noise_variance_dn2 / dark.frames[known[0]]
        return Subtrahend(levels, (0.0,) * len(levels), (shared, 0.0, 0.0), rate, dark.hot, matched=True)
    if len(dark.exposure_s) == 1 and dark.exposure_s[0] > min(stack.exposure_s) * (1.0 + SAME_EXPOSURE):
        what = f"the darks were all shot at {dark.exposure_s[0]:g} s, which not every frame has"
        raise BadInput(what, todo="shoot darks at the frames' exposures, or at two exposures at least")
    levels = tuple(dark.bias_dn + dark.rate_dn_per_s * np.float32(seconds) for seconds in stack.exposure_s)
    bias_bias, bias_rate, rate_rate = (
        dark.noise_variance_dn2 * float(dark.covariance[index]) for index in ((0, 0), (0, 1), (1, 1))
    )
    return Subtrahend(
        levels, (0.0,) * len(levels), (bias_bias, bias_rate, rate_rate), rate, dark.hot, matched=False
    )


def _given_levels(dark: object, stack: Stack) -> tuple[tuple[NDArray[Any], ...], bool]:
    """Dark levels given as numbers or arrays, one for each frame, and whether they are single raw frames."""
    number = len(stack.counts)
    try:
        parts = [np.asarray(part) for part in dark] if isinstance(dark, Sequence) else np.asarray(dark)
        values = np.stack(parts) if isinstance(parts, list) else parts
    except ValueError:
        raise BadInput(
            "the darks differ in shape", todo="give one per frame, all of the frames' shape"
        ) from None
    fits = {0: (), 1: (number,), 2: stack.shape, 3: (number, *stack.shape)}.get(values.ndim)
    if values.shape != fits or not np.issubdtype(values.dtype, np.number):
        what = f"darks of shape {values.shape} ({values.dtype}) do not fit {number} frames of {stack.shape}"
        raise BadInput(
            what, todo="give a number, one number per frame, (H, W), one (H, W) per frame, or a DarkModel"
        )
    if not np.isfinite(values).all():
        raise BadInput("the darks hold NaN or infinite values", todo="give the counts as stored")
    raw_darks = values.ndim == 3 and np.issubdtype(values.dtype, np.integer)
    if values.ndim in {0, 2}:
        return (np.atleast_2d(values),) * number, raw_darks
    return tuple(np.atleast_2d(value) for value in values), raw_darks


def black_cell(dark: Subtrahend) -> NDArray[np.float64]:
    """Median dark level of the first frame at each position of the cell."""
    level = dark.level_dn[0]
    parts = [[level[row::2, col::2] for col in (0, 1)] for row in (0, 1)]
    return np.array(
        [[float(np.median(p)) if p.size else float(np.median(level)) for p in row] for row in parts]
    )
