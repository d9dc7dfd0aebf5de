"""The estimator of the merge on one small block of pixels, in buffers that fit the processor's cache.

With x_i the signal of frame i, t_i its exposure, S = K (L + d) the shot-noise variance per second of exposure
and phi_i = floor_i / t_i, the variance of x_i is t_i (S + phi_i). The maximum-likelihood estimate is the mean
of the rates x_i / t_i with the weights

    a_i = w_i t_i / (S + phi_i)

(Granados et al. 2010, eq. 9); the Poisson estimate has a_i = w_i t_i (Hanji et al. 2020, eq. 6). The rates
are taken relative to the Poisson estimate: their sums then lose no digits, in single precision either.

Frames that are nowhere near the clip level in a block have no weights there, frames that are clipped all over
it do not enter, and only the blocks between take the longer way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from capture.flags import Flag
from capture.frames import any_in_cell

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from capture.clip import Ramp

SUSPECT_ERROR = 0.02
"""How much too low a sample beside a clipped one reads (blooming, crosstalk): 1.2 to 2.8 % on one CCD."""

_TINY = 1e-30


@dataclass(frozen=True, eq=False)
class Rules:
    """What is the same for all blocks of a merge.

    Attributes
    ----------
    exposure_s : tuple of float
        Exposure time of each frame.
    floor_dn2 : tuple of float
        Variance without light of each frame: read, rounding and dark-frame noise.
    gain_dn_per_e : float
        DN per electron.
    common_dn2 : tuple of float
        Variances shared by all frames: of the bias, of bias and rate, of the rate.
    shortest : tuple of int
        The frames of the shortest exposure.
    iterations : int
        Fixed-point iterations of the maximum-likelihood weights; 0 leaves the Poisson estimate.
    limits : ndarray
        Chi-square that n samples exceed by chance too rarely to believe, by n.
    """

    exposure_s: tuple[float, ...]
    floor_dn2: tuple[float, ...]
    gain_dn_per_e: float
    common_dn2: tuple[float, float, float]
    shortest: tuple[int, ...]
    iterations: int
    limits: NDArray[np.float64]


class Outputs(NamedTuple):
    """Where the results of a block go: each (H, W); `flags` zero before; the last two None if unwanted."""

    radiance: NDArray[np.floating]
    variance: NDArray[np.floating]
    flags: NDArray[np.uint8]
    chi_square: NDArray[np.floating] | None
    samples: NDArray[np.unsignedinteger] | None


class _Sample(NamedTuple):
    """One frame's samples: signal (later: rate above the first estimate) and weight, None where all are 1."""

    signal: Any
    weight: Any
    exposure_s: float
    floor_dn2: float


class _Spare(NamedTuple):
    """Buffers of one block, each (H, W)."""

    first: Any
    chi_square: Any
    shot: Any
    top: Any
    bottom: Any
    factor: Any
    part: Any


class _Buffers(NamedTuple):
    """All buffers, cut to one shape of blocks."""

    signals: list[Any]
    weights: list[Any]
    spare: _Spare


class BlockMerger:
    """Merges blocks, one after the other, in buffers of its own: one for each thread.

    Parameters
    ----------
    rules : Rules
    ramp : Ramp
        Weights near the clip level, for the largest block.
    shape : tuple of int
        Rows and columns of the largest block.
    dtype : numpy dtype
        float32 or float64: of the buffers.
    """

    def __init__(
        self, rules: Rules, ramp: Ramp, shape: tuple[int, int], dtype: np.dtype[np.floating]
    ) -> None:
        self._rules, self._ramp = rules, ramp
        number, pixels = len(rules.exposure_s), shape[0] * shape[1]
        self._signals = np.empty((number, pixels), dtype)
        self._weights = np.empty((number, pixels), dtype)
        self._spare = np.empty((len(_Spare._fields), pixels), dtype)
        self._views: dict[tuple[int, ...], _Buffers] = {}

    def merge(
        self, counts: Sequence[NDArray[Any]], levels: Sequence[NDArray[Any]], rate: NDArray[Any], out: Outputs
    ) -> None:
        """Merge one block.

        Parameters
        ----------
        counts : sequence of ndarray, each (H, W)
            The frames' counts; the block begins at an even row and column.
        levels : sequence of ndarray, each (H, W) or (1, 1)
            Dark level of each frame.
        rate : ndarray, shape (H, W) or (1, 1)
            Dark signal per second; its shot noise is noise.
        out : Outputs
        """
        buffers = self._buffers(out.flags.shape)
        samples, number = self._samples(counts, levels, out.flags, buffers)
        first, chi_square, shot, top, bottom, factor, part = buffers.spare
        total = _poisson(samples, first, bottom, part)
        for sample in samples:
            signal = sample.signal
            signal *= 1.0 / sample.exposure_s
            signal -= first
        rules = self._rules
        if rules.iterations:
            radiance = first
            for left in reversed(range(rules.iterations)):
                _shot(radiance, rules.gain_dn_per_e, rate, shot)
                _weighted_step(samples, shot, factor, (bottom, top) if left else (bottom, top, chi_square))
                np.divide(top, bottom, out=top)
                radiance = np.add(first, top, out=part)
            out.radiance[:] = radiance
            # The sum of squares is about the first estimate: about the last, it is less by the shift's part.
            top *= top
            top *= bottom
            chi_square -= top
            _weighted_variance(samples, shot, bottom, (factor, part), out.variance)
            total = bottom
        else:
            _shot(first, rules.gain_dn_per_e, rate, shot)
            _poisson_chi_square(samples, shot, factor, part, chi_square)
            _poisson_variance(samples, shot, total, (part, top, factor), out.variance)
            out.radiance[:] = first
        self._add_common(samples, shot, total, (factor, part), out)
        self._set_flags(chi_square, number, part, out)
        if out.chi_square is not None:
            np.maximum(chi_square, 0.0, out=out.chi_square)
        if out.samples is not None:
            out.samples[:] = number

    def _buffers(self, shape: tuple[int, ...]) -> _Buffers:
        if shape not in self._views:
            self._views[shape] = _Buffers(
                [row[: shape[0] * shape[1]].reshape(shape) for row in self._signals],
                [row[: shape[0] * shape[1]].reshape(shape) for row in self._weights],
                _Spare(*(row[: shape[0] * shape[1]].reshape(shape) for row in self._spare)),
            )
        return self._views[shape]

    def _samples(
        self,
        counts: Sequence[NDArray[Any]],
        levels: Sequence[NDArray[Any]],
        flags: NDArray[np.uint8],
        buffers: _Buffers,
    ) -> tuple[list[_Sample], NDArray[np.uint16] | int]:
        """Take the samples of frames with any weight in the block; count those of each pixel."""
        ramp, rules = self._ramp, self._rules
        samples: list[_Sample] = []
        indices: list[int] = []
        mixed = False
        for index, frame in enumerate(counts):
            signal = buffers.signals[index]
            np.copyto(signal, frame, casting="unsafe")
            near = np.maximum.reduce(signal, axis=None) >= ramp.lowest_start
            if near and np.minimum.reduce(signal, axis=None) >= ramp.highest_end:
                continue
            weight = None
            if near:
                weight = buffers.weights[index]
                ramp.weights(signal, out=weight)
                self._reject_neighbours(signal, weight, flags)
                mixed = True
            signal -= levels[index]
            samples.append(_Sample(signal, weight, rules.exposure_s[index], rules.floor_dn2[index] + _TINY))
            indices.append(index)
        if not mixed and samples:
            return samples, len(samples)
        if (flags & np.uint8(Flag.NEIGHBOUR_CLIPPED)).any():
            self._readmit(counts, samples, indices, flags)
        number = np.zeros(flags.shape, np.uint16)
        for sample in samples:
            number += 1 if sample.weight is None else sample.weight > 0.0
        lost = number == 0
        if lost.any():
            flags |= _bits(lost, Flag.OVER_RANGE)
            by_index = dict(zip(indices, samples, strict=True))
            for index in rules.shortest:
                if index not in by_index:
                    by_index[index] = self._clipped_sample(index, counts[index], levels[index], buffers)
                weight = by_index[index].weight
                if weight is not None:
                    weight[lost] = 1.0
            samples = [by_index[index] for index in sorted(by_index)]
        return [sample for sample in samples if sample.weight is None or sample.weight.any()], number

    def _reject_neighbours(self, counts: Any, weight: Any, flags: NDArray[np.uint8]) -> None:
        clipped = self._ramp.clipped(counts)
        if clipped.any():
            near = any_in_cell(clipped)
            flags |= _bits(near & (weight > 0.0), Flag.NEIGHBOUR_CLIPPED)
            weight *= ~near

    def _readmit(
        self,
        counts: Sequence[NDArray[Any]],
        samples: list[_Sample],
        indices: list[int],
        flags: NDArray[np.uint8],
    ) -> None:
        """Take samples beside clipped ones back where the others alone tell less than these may be wrong."""
        rows, cols = np.nonzero(flags & np.uint8(Flag.NEIGHBOUR_CLIPPED))
        signal, floor = np.zeros(rows.size), np.zeros(rows.size)
        for sample in samples:
            weight = 1.0 if sample.weight is None else sample.weight[rows, cols]
            signal += sample.signal[rows, cols] * weight
            floor += sample.floor_dn2 * weight
        np.maximum(signal, 0.0, out=signal)
        poor = signal**2 * SUSPECT_ERROR**2 <= self._rules.gain_dn_per_e * signal + floor
        if not poor.any():
            return
        rows, cols = rows[poor], cols[poor]
        flags[rows, cols] |= np.uint8(Flag.NEAR_CLIPPED_USED)
        for index, sample in zip(indices, samples, strict=True):
            if sample.weight is not None:
                own = self._ramp.weights(counts[index].astype(sample.weight.dtype))
                sample.weight[rows, cols] = own[rows, cols]

    def _clipped_sample(
        self, index: int, counts: NDArray[Any], level: NDArray[Any], buffers: _Buffers
    ) -> _Sample:
        """Take the samples of a frame that is clipped all over the block, without weight."""
        signal, weight = buffers.signals[index], buffers.weights[index]
        np.subtract(counts, level, out=signal, casting="unsafe")
        weight[:] = 0.0
        floor = self._rules.floor_dn2[index] + _TINY
        return _Sample(signal, weight, self._rules.exposure_s[index], floor)

    def _add_common(
        self, samples: list[_Sample], shot: Any, bottom: Any, spare: tuple[Any, Any], out: Outputs
    ) -> None:
        """Add what errors shared by all frames' darks do to the variance.

        An error b + r t of all darks moves the estimate by b sum(a / t) / sum(a) + r.
        """
        bias_bias, bias_rate, rate_rate = self._rules.common_dn2
        if not (bias_bias or rate_rate):
            return
        factor, lever = spare
        lever[:] = 0.0
        for sample in samples:
            if self._rules.iterations:
                np.add(shot, sample.floor_dn2 / sample.exposure_s, out=factor)
                np.reciprocal(factor, out=factor)
            else:
                factor[:] = 1.0
            if sample.weight is not None:
                factor *= sample.weight
            lever += factor
        lever /= bottom
        np.multiply(lever, bias_bias, out=factor)
        factor += 2.0 * bias_rate
        factor *= lever
        factor += rate_rate
        np.add(out.variance, factor, out=out.variance)

    def _set_flags(self, chi_square: Any, number: Any, part: Any, out: Outputs) -> None:
        np.sqrt(out.variance, out=part)
        under = np.less(out.radiance, part)
        if under.any():
            under &= (out.flags & np.uint8(Flag.OVER_RANGE)) == 0
            np.bitwise_or(out.flags, _bits(under, Flag.UNDER_RANGE), out=out.flags)
        limits = self._rules.limits
        least = limits[number] if isinstance(number, int) else limits[2:].min(initial=np.inf)
        if np.maximum.reduce(chi_square, axis=None) <= least:
            return
        # Few pixels pass the limit of two samples, the lowest: only these are looked up by their number.
        places = np.flatnonzero(chi_square > least)
        if not isinstance(number, int):
            places = places[chi_square.ravel()[places] > limits[number.ravel()[places]]]
        rows, cols = np.unravel_index(places, chi_square.shape)
        out.flags[rows, cols] |= np.uint8(Flag.INCONSISTENT)


def _bits(where: NDArray[np.bool_], flag: Flag) -> NDArray[np.uint8]:
    """Set a bit where a mask is set; a multiplication is much quicker than indexing by a mask."""
    return where.view(np.uint8) * np.uint8(flag)


def _poisson(samples: list[_Sample], radiance: Any, bottom: Any, part: Any) -> Any:
    """Put sum(w x) / sum(w t) into `radiance`; return the denominator, a number where no weight differs."""
    total: Any = sum(sample.exposure_s for sample in samples if sample.weight is None)
    started = False
    for sample in samples:
        value = sample.signal
        if sample.weight is not None:
            value = np.multiply(value, sample.weight, out=part)
        if started:
            radiance += value
        else:
            radiance[:] = value
            started = True
    if any(sample.weight is not None for sample in samples):
        bottom[:] = total
        for sample in samples:
            if sample.weight is not None:
                bottom += np.multiply(sample.weight, sample.exposure_s, out=part)
        total = bottom
    radiance /= total
    return total


def _shot(radiance: Any, gain: float, rate: NDArray[Any], out: Any) -> None:
    """Variance per second of exposure: gain times signal, never negative."""
    np.maximum(radiance, 0.0, out=out)
    if rate.size > 1 or rate.any():
        out += rate
    out *= gain


def _weight(sample: _Sample, shot: Any, factor: Any) -> None:
    """Put a = w t / (S + phi) into `factor`."""
    np.add(shot, sample.floor_dn2 / sample.exposure_s, out=factor)
    np.divide(sample.exposure_s, factor, out=factor)
    if sample.weight is not None:
        factor *= sample.weight


def _weighted_step(samples: list[_Sample], shot: Any, factor: Any, sums: tuple[Any, ...]) -> None:
    """Sum a, a times the rate, and, where there is a third sum, a times the rate's square."""
    for first, sample in enumerate(samples):
        _weight(sample, shot, factor)
        for order, into in enumerate(sums):
            if order:
                factor *= sample.signal
            if first:
                np.add(into, factor, out=into)
            else:
                into[:] = factor


def _weighted_variance(
    samples: list[_Sample], shot: Any, bottom: Any, spare: tuple[Any, Any], out: Any
) -> None:
    """Sum of w a over the squared sum of a: the variance of the rate u is w / a."""
    if all(sample.weight is None for sample in samples):
        np.reciprocal(bottom, out=out)
        return
    factor, spread = spare
    spread[:] = 0.0
    for sample in samples:
        _weight(sample, shot, factor)
        if sample.weight is not None:
            factor *= sample.weight
        spread += factor
    spread /= bottom
    np.divide(spread, bottom, out=out)


def _poisson_chi_square(samples: list[_Sample], shot: Any, factor: Any, part: Any, squares: Any) -> None:
    """Sum of w (x - L t)^2 / v."""
    for first, sample in enumerate(samples):
        into = part if first else squares
        np.multiply(sample.signal, sample.signal, out=into)
        _weight(sample, shot, factor)
        into *= factor
        if first:
            squares += part


def _poisson_variance(
    samples: list[_Sample], shot: Any, total: Any, spare: tuple[Any, Any, Any], out: Any
) -> None:
    """Sum of w^2 v over the squared sum of w t."""
    square, of_light, of_floor = spare
    whole = [sample for sample in samples if sample.weight is None]
    light = sum(sample.exposure_s for sample in whole)
    floor = sum(sample.floor_dn2 for sample in whole)
    if len(whole) == len(samples):
        np.multiply(shot, light / total**2, out=square)
        np.add(square, floor / total**2, out=out)
        return
    of_light[:], of_floor[:] = light, floor
    for sample in samples:
        if sample.weight is not None:
            np.multiply(sample.weight, sample.weight, out=square)
            square *= sample.exposure_s
            of_light += square
            square *= sample.floor_dn2 / sample.exposure_s
            of_floor += square
    of_light *= shot
    of_light += of_floor
    of_light /= total
    np.divide(of_light, total, out=out)
