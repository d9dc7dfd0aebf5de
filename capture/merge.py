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

The frames are worked through in blocks that fit the processor's cache, on two threads, in float64 up to
`WIDE_PIXELS` pixels (`capture.block`) and in float32 above, where rounding (1e-6) is far below any noise;
large frames of integers by compiled code (`capture.compiled`). The result does not depend on the blocks or
the threads. Large files are read by bands of rows, so that more frames need no more memory.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from capture.bands import Source, merge_bands
from capture.block import SUSPECT_ERROR, Outputs, Rules
from capture.clip import Ramp, clip_levels
from capture.dark import Dark, Subtrahend, black_cell, subtrahend
from capture.flags import Flag
from capture.frames import Frames, Stack, any_in_cell, as_stack, over, thin, thinning
from capture.noise import Noise, measured_noise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from capture.sensor import SensorModel

_LOG = logging.getLogger("gonio.capture.merge")

WIDE_PIXELS = 4_000_000
_BLOCK_SAMPLES = 150 * 1024  # of all frames: three buffers of float32 within a cache of two megabytes
_SAMPLE_PIXELS = 30_000
_ITERATIONS = 2
THREADS = 2
"""Threads that merge large frames; more find no work while memory is waited for."""

_INCONSISTENT_P = 1e-6

__all__ = ["POISSON_NOTE", "SUSPECT_ERROR", "Flag", "MergeReport", "Merged", "merge", "merge_stack"]

POISSON_NOTE = "no noise model of the sensor: merged with Poisson weights"


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

    It unpacks to these three; `report` says how the merge was done. Where it was asked for, `chi_square`
    holds the weighted sum of squared residuals over their variances, and `samples` how many of them had any
    weight, each of shape (H, W); else they are None.
    """

    report: MergeReport
    chi_square: NDArray[np.floating] | None
    samples: NDArray[np.uint16] | None


def merge(
    frames: Frames,
    exposure_s: float | Sequence[float] | np.ndarray | None,
    *,
    dark: Dark = None,
    sensor: SensorModel | None = None,
    chi_square: bool = False,
    out: Merged | None = None,
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
    chi_square : bool
        Whether to return the map of how well the frames agree.
    out : Merged, optional
        An earlier result for frames of this size that is no longer needed: its arrays are written over, which
        saves a third of the time of large frames, for memory is slow to get.

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
    levels = subtrahend(dark, stack, sensor)
    return merge_stack(stack, levels, sensor, chi_square=chi_square, reuse=out)


def merge_stack(
    stack: Stack,
    dark: Subtrahend,
    sensor: SensorModel | None = None,
    *,
    chi_square: bool = False,
    reuse: Merged | None = None,
) -> Merged:
    """Merge checked frames with the darks that belong to them; see `merge`, whose `out` is `reuse`."""
    step = thinning(stack.shape, _SAMPLE_PIXELS)
    part = stack if sensor is not None else stack.thinned(step)  # a calibrated sensor asks nothing of them
    clip = clip_levels(part, black_cell(dark), sensor)
    if sensor is not None:
        noise = Noise(sensor.gain_dn_per_e, sensor.floor_variance_dn2, "sensor model")
    else:
        noise = _noise_of_frames(part, dark, clip, step)
        _LOG.info(POISSON_NOTE)
    order = sorted(range(len(stack.counts)), key=lambda index: stack.exposure_s[index])
    source = Source(
        counts=tuple(stack.counts[index] for index in order),
        level_dn=tuple(dark.level_dn[index] for index in order),
        rate_dn_per_s=dark.rate_dn_per_s,
        hot=dark.hot,
        clip_dn=clip,
        black_dn=black_cell(dark),
    )
    rules = Rules(
        exposure_s=tuple(stack.exposure_s[index] for index in order),
        floor_dn2=tuple(noise.floor_dn2 + dark.variance_dn2[index] for index in order),
        gain_dn_per_e=noise.gain_dn_per_e,
        common_dn2=dark.common_dn2,
        shortest=len(stack.shortest),
        iterations=_ITERATIONS if sensor is not None else 0,
        limits=_chi_square_limits(len(stack.counts)),
    )
    out = _outputs(stack.shape, reuse, chi_square=chi_square)
    merge_bands(source, rules, out, block_samples=_BLOCK_SAMPLES, threads=THREADS)
    merged = Merged(out.radiance, out.variance, out.flags)
    merged.chi_square, merged.samples = out.chi_square, out.samples
    merged.report = MergeReport(
        estimator="poisson" if sensor is None else "maximum likelihood",
        note=POISSON_NOTE if sensor is None else "",
        noise=noise,
        clip_dn=tuple(float(level) for level in clip.ravel()),
        exposure_s=stack.exposure_s,
        dark_matched=dark.matched,
    )
    return merged


def _noise_of_frames(part: Stack, dark: Subtrahend, clip: NDArray[np.float64], step: int) -> Noise:
    """Gain and floor from frames thinned by a step, or unit gain where they do not show it."""
    least = part.quantisation_step_dn**2 / 12.0
    counts = [frame.astype(np.float64) for frame in part.arrays()]
    ramp = Ramp(clip, black_cell(dark), part.shape, np.dtype(np.float64))
    usable = np.stack([(ramp.weights(frame) >= 1.0) & ~any_in_cell(ramp.clipped(frame)) for frame in counts])
    if dark.hot is not None:
        usable &= ~thin(dark.hot, step)
    levels = [over(thin(level, step), part.shape) for level in dark.level_dn]
    signal = np.stack([frame - level for frame, level in zip(counts, levels, strict=True)])
    number = len(counts)
    times = np.asarray(part.exposure_s)
    found = measured_noise(signal.reshape(number, -1), usable.reshape(number, -1), times, least)
    return found or Noise(1.0, least, "assumed")


def _outputs(shape: tuple[int, int], reuse: Merged | None, *, chi_square: bool) -> Outputs:
    """Arrays for the results: those of an earlier merge where they fit."""
    dtype: np.dtype[np.floating] = np.dtype(np.float64 if math.prod(shape) <= WIDE_PIXELS else np.float32)
    maps = (
        np.empty(shape, dtype) if chi_square else None,
        np.empty(shape, np.uint16) if chi_square else None,
    )
    if reuse is None or reuse.radiance.shape != shape or reuse.radiance.dtype != dtype:
        return Outputs(np.empty(shape, dtype), np.empty(shape, dtype), np.zeros(shape, np.uint8), *maps)
    reuse.flags[:] = 0
    return Outputs(reuse.radiance, reuse.variance, reuse.flags, *maps)


def _chi_square_limits(frames: int) -> NDArray[np.float64]:
    """Sum of squares that n samples exceed with `_INCONSISTENT_P`, for n = 0 to `frames`."""
    from scipy.special import chdtri

    limits = np.full(frames + 1, np.inf)
    limits[2:] = chdtri(np.arange(1, frames), _INCONSISTENT_P)
    return limits
