"""Frames of one pose to radiance, variance and flags: maximum likelihood on the mosaic.

For one pixel with counts y_i of exposures t_i, x_i = y_i - dark_i has the mean L t_i and the variance

    v_i = K (L + d) t_i + floor_i

with the gain K, the dark rate d, and the read, rounding and dark-frame noise in the floor. The estimate is
the weighted mean L = sum w_i t_i x_i / v_i / sum w_i t_i^2 / v_i: the Poisson estimate sum w x / sum w t
first (Hanji et al. 2020, eq. 6), then two fixed-point iterations of the weights with the sensor's own noise
(Granados et al. 2010, eq. 9), which reach the Cramer-Rao bound at all levels. Without a sensor model the
Poisson estimate stands. w_i falls softly from 1 to 0 towards the clip level, and is 0 beside a clipped
sample of the same 2 x 2 cell. The variance is that of the weights applied; it holds noise only, no
calibration error. Negative values stay.

The frames are worked through in blocks of rows that fit the processor's cache, on two threads, in float64
up to `WIDE_PIXELS` pixels and in float32 above, where rounding (1e-6) is far below any noise. The result
does not depend on the blocks or the threads.
"""

from __future__ import annotations

import logging
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import IntFlag
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from capture.clip import Ramp, clip_levels
from capture.dark import Dark, Subtrahend, black_cell, subtrahend
from capture.estimate import Sample, estimate
from capture.frames import Frames, Stack, any_in_cell, as_stack, thin, thinning
from capture.noise import Noise, measured_noise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from capture.sensor import SensorModel

_LOG = logging.getLogger("gonio.capture.merge")

WIDE_PIXELS = 4_000_000
_BLOCK_PIXELS = 1 << 15
_SAMPLE_PIXELS = 150_000
_ITERATIONS = 2

SUSPECT_ERROR = 0.02
"""How much too low a sample beside a clipped one reads (blooming, crosstalk): 1.2 to 2.8 % on one CCD."""

_INCONSISTENT_P = 1e-6

POISSON_NOTE = "no noise model of the sensor: merged with Poisson weights"


class Flag(IntFlag):
    """What to know about a merged pixel, one bit each."""

    OVER_RANGE = 1
    """Clipped in every frame: the value, from the shortest exposure, is a lower bound."""
    UNDER_RANGE = 2
    """The value is less than its standard deviation."""
    HOT = 4
    """A hot pixel of the darks; its dark level is subtracted, its noise is its own."""
    NEIGHBOUR_CLIPPED = 8
    """In at least one frame another pixel of the 2 x 2 cell was clipped: that frame was left out here."""
    INCONSISTENT = 16
    """The frames disagree by more than their noise: something moved, flickered, or is not linear."""
    NEAR_CLIPPED_USED = 32
    """Such frames had to be used, the rest told less than `SUSPECT_ERROR`: the value may be low by it."""


class _Merged(NamedTuple):
    radiance: NDArray[np.floating]
    variance: NDArray[np.floating]
    flags: NDArray[np.uint8]


@dataclass(frozen=True)
class MergeReport:
    """How a merge was done.

    Attributes
    ----------
    estimator : str
        "maximum likelihood" or "poisson".
    note : str
        One line for the person where there is no sensor model; else empty.
    noise : Noise
        Gain and floor that the variance is of.
    clip_dn : tuple of float
        Clip level at the four positions of the cell, row by row, black included.
    exposure_s : tuple of float
        The exposure times used.
    dark_matched : bool
        Whether every frame had darks of its own exposure.
    """

    estimator: str
    note: str
    noise: Noise
    clip_dn: tuple[float, ...]
    exposure_s: tuple[float, ...]
    dark_matched: bool


class Merged(_Merged):
    """Radiance in DN/s, variance in (DN/s)^2 and `Flag` bits, each of shape (H, W).

    It unpacks to these three; `report` says how the merge was done.
    """

    report: MergeReport


def merge(
    frames: Frames,
    exposure_s: float | Sequence[float] | np.ndarray | None,
    *,
    dark: Dark = None,
    sensor: SensorModel | None = None,
) -> Merged:
    """Merge frames of different exposure into one radiance mosaic.

    Parameters
    ----------
    frames : sequence of 2-D arrays, RawFrames or paths; or ndarray of shape (N, H, W)
        The frames, black included, in any order; mosaics, or monochrome.
    exposure_s : sequence of float or None
        Exposure times in seconds, same order; None where the frames carry them.
    dark : optional
        What to subtract: a `DarkModel`; a number; an (H, W) bias; one number or one (H, W) dark per frame;
        or dark RAW frames or paths, matched by exposure. Integer arrays per frame are taken as single dark
        frames, with the noise of one; floating-point arrays as exact. None: the black level of the sensor
        model or the files, and the sensor model's dark current.
    sensor : SensorModel, optional
        Gain, read noise and clip levels. Without it the weights are Poisson's, the gain is measured from the
        scatter of the frames (1 DN per electron where it cannot be), and the clip levels from the frames.

    Returns
    -------
    Merged
        Radiance (DN/s), variance ((DN/s)^2), flags (uint8).

    Raises
    ------
    BadInput
        Frames, exposure times or darks that cannot be used; see `as_stack` and `subtrahend`.
    """
    stack = as_stack(frames, exposure_s)
    return merge_stack(stack, subtrahend(dark, stack, sensor), sensor)


def merge_stack(stack: Stack, dark: Subtrahend, sensor: SensorModel | None = None) -> Merged:
    """Merge checked frames with the darks that belong to them; see `merge`."""
    step = thinning(stack.shape, _SAMPLE_PIXELS)
    clip = clip_levels(stack.thinned(step), black_cell(dark), sensor)
    if sensor is not None:
        noise = Noise(sensor.gain_dn_per_e, sensor.floor_variance_dn2, "sensor model")
    else:
        noise = _noise_of_frames(stack, dark, clip, step)
        _LOG.info(POISSON_NOTE)
    job = _Job.prepare(stack, dark, clip, noise, iterations=_ITERATIONS if sensor is not None else 0)
    job.run()
    merged = Merged(job.radiance, job.variance, job.flags)
    merged.report = MergeReport(
        estimator="poisson" if sensor is None else "maximum likelihood",
        note=POISSON_NOTE if sensor is None else "",
        noise=noise,
        clip_dn=tuple(float(level) for level in clip.ravel()),
        exposure_s=stack.exposure_s,
        dark_matched=dark.matched,
    )
    return merged


def _noise_of_frames(stack: Stack, dark: Subtrahend, clip: NDArray[np.float64], step: int) -> Noise:
    """Gain and floor from a part of the frames, or unit gain where they do not show it."""
    least = stack.quantisation_step_dn**2 / 12.0
    part = stack.thinned(step)
    counts = [frame.astype(np.float64) for frame in part.counts]
    ramp = Ramp(clip, black_cell(dark), part.shape, np.dtype(np.float64))
    usable = np.stack([(ramp.weights(frame) >= 1.0) & ~any_in_cell(ramp.clipped(frame)) for frame in counts])
    if dark.hot is not None:
        usable &= ~thin(dark.hot, step)
    signal = np.stack([frame - thin(level, step) for frame, level in zip(counts, dark.level_dn, strict=True)])
    number = len(counts)
    times = np.asarray(stack.exposure_s)
    found = measured_noise(signal.reshape(number, -1), usable.reshape(number, -1), times, least)
    return found or Noise(1.0, least, "assumed")


@dataclass
class _Job:
    """One merge: inputs, outputs, and what is the same for all blocks."""

    stack: Stack
    dark: Subtrahend
    ramp: Ramp
    noise: Noise
    iterations: int
    limits: NDArray[np.float64]
    rows_per_block: int
    radiance: NDArray[np.floating]
    variance: NDArray[np.floating]
    flags: NDArray[np.uint8]

    @classmethod
    def prepare(
        cls, stack: Stack, dark: Subtrahend, clip: NDArray[np.float64], noise: Noise, *, iterations: int
    ) -> _Job:
        """Allocate the outputs and fix the block size."""
        rows, cols = stack.shape
        wide = rows * cols <= WIDE_PIXELS
        dtype: np.dtype[np.floating] = np.dtype(np.float64) if wide else np.dtype(np.float32)
        per_block = min(rows + rows % 2, max(2, _BLOCK_PIXELS // cols // 2 * 2))
        return cls(
            stack=stack,
            dark=dark,
            ramp=Ramp(clip, black_cell(dark), (per_block, cols), dtype),
            noise=noise,
            iterations=iterations,
            limits=_chi_square_limits(len(stack.counts)),
            rows_per_block=per_block,
            radiance=np.empty(stack.shape, dtype),
            variance=np.empty(stack.shape, dtype),
            flags=np.zeros(stack.shape, np.uint8),
        )

    def run(self) -> None:
        """Merge all blocks, on two threads where there is more than one block."""
        starts = range(0, self.stack.shape[0], self.rows_per_block)
        blocks = [slice(start, min(start + self.rows_per_block, self.stack.shape[0])) for start in starts]
        workers = min(len(blocks), os.cpu_count() or 1, 2)
        if workers == 1:
            for block in blocks:
                self._merge_block(block)
            return
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(self._merge_block, blocks))

    def _merge_block(self, rows: slice) -> None:
        flags = self.flags[rows]
        samples, number = self._samples(rows, flags)
        rate = _part(self.dark.rate_dn_per_s, rows).astype(self.radiance.dtype, copy=False)
        found = estimate(
            samples, self.noise.gain_dn_per_e, rate, self.dark.common_dn2, iterations=self.iterations
        )
        self.radiance[rows], self.variance[rows] = found.radiance, found.variance
        under = found.radiance < np.sqrt(found.variance)
        under &= (flags & np.uint8(Flag.OVER_RANGE)) == 0
        _set(flags, under, Flag.UNDER_RANGE)
        self._flag_inconsistent(found.chi_square, number, flags)
        if self.dark.hot is not None:
            _set(flags, self.dark.hot[rows], Flag.HOT)

    def _flag_inconsistent(
        self, chi_square: NDArray[np.floating], number: NDArray[np.uint16] | int, flags: NDArray[np.uint8]
    ) -> None:
        # Few pixels pass the limit of two samples, the lowest: only these are looked up by their number.
        rows, cols = np.nonzero(chi_square > self.limits[2:].min(initial=np.inf))
        if rows.size:
            numbers = number if isinstance(number, int) else number[rows, cols]
            beyond = chi_square[rows, cols] > self.limits[numbers]
            flags[rows[beyond], cols[beyond]] |= np.uint8(Flag.INCONSISTENT)

    def _samples(
        self, rows: slice, flags: NDArray[np.uint8]
    ) -> tuple[list[Sample], NDArray[np.uint16] | int]:
        """Return the samples of a block that have any weight, and how many count at each pixel."""
        dtype = self.radiance.dtype
        samples, whole = [], 0
        for index, frame in enumerate(self.stack.counts):
            counts = frame[rows]
            level = counts.astype(dtype)
            weight = None
            if counts.max() >= self.ramp.lowest_start:
                weight = self.ramp.weights(level)
                if weight.any():
                    self._reject_neighbours(level, weight, flags)
            whole += weight is None
            level -= _part(self.dark.level_dn[index], rows).astype(dtype, copy=False)
            floor = self.noise.floor_dn2 + self.dark.variance_dn2[index]
            samples.append(Sample(level, weight, self.stack.exposure_s[index], floor))
        if all(sample.weight is None for sample in samples):
            return samples, whole
        if (flags & np.uint8(Flag.NEIGHBOUR_CLIPPED)).any():
            self._readmit(rows, samples, flags)
        number = np.full(flags.shape, whole, dtype=np.uint16)
        for sample in samples:
            if sample.weight is not None:
                number += sample.weight > 0.0
        lost = number == 0
        if lost.any():
            _set(flags, lost, Flag.OVER_RANGE)
            for index in self.stack.shortest:
                weight = samples[index].weight
                if weight is not None:
                    weight[lost] = 1.0
        return [sample for sample in samples if sample.weight is None or sample.weight.any()], number

    def _reject_neighbours(
        self, level: NDArray[np.floating], weight: NDArray[np.floating], flags: NDArray[np.uint8]
    ) -> None:
        clipped = self.ramp.clipped(level)
        if clipped.any():
            near = any_in_cell(clipped)
            _set(flags, near & (weight > 0.0), Flag.NEIGHBOUR_CLIPPED)
            np.putmask(weight, near, 0.0)

    def _readmit(self, rows: slice, samples: list[Sample], flags: NDArray[np.uint8]) -> None:
        """Take samples beside clipped ones back where the others alone tell less than these may be wrong."""
        signal = sum((sample.weighted(sample.signal_dn) for sample in samples), np.zeros(flags.shape))
        floor = sum(
            (sample.weighted(np.full(flags.shape, sample.floor_dn2)) for sample in samples), np.zeros(())
        )
        variance = self.noise.gain_dn_per_e * np.maximum(signal, 0.0) + floor
        poor = np.maximum(signal, 0.0) ** 2 * SUSPECT_ERROR**2 <= variance
        poor &= (flags & np.uint8(Flag.NEIGHBOUR_CLIPPED)) != 0
        if not poor.any():
            return
        _set(flags, poor, Flag.NEAR_CLIPPED_USED)
        for frame, sample in zip(self.stack.counts, samples, strict=True):
            if sample.weight is not None:
                own = self.ramp.weights(frame[rows].astype(self.radiance.dtype))
                sample.weight[poor] = own[poor]


def _set(flags: NDArray[np.uint8], where: NDArray[np.bool_], flag: Flag) -> None:
    """Set a bit; a multiplication is much quicker than indexing by a mask."""
    flags |= where.view(np.uint8) * np.uint8(flag)


def _part(values: NDArray[Any], rows: slice) -> NDArray[Any]:
    """Rows of a mosaic, or the (1, 1) array that stands for a constant one."""
    return values if values.size == 1 else values[rows]


def _chi_square_limits(frames: int) -> NDArray[np.float64]:
    """Sum of squares that n samples exceed with `_INCONSISTENT_P`, for n = 0 to `frames`."""
    from scipy.special import chdtri

    limits = np.full(frames + 1, np.inf)
    limits[2:] = chdtri(np.arange(1, frames), _INCONSISTENT_P)
    return limits
