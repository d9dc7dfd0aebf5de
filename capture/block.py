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
        Exposure time of each frame, ascending.
    floor_dn2 : tuple of float
        Variance without light of each frame: read, rounding and dark-frame noise.
    gain_dn_per_e : float
        DN per electron.
    common_dn2 : tuple of float
        Variances shared by all frames: of the bias, of bias and rate, of the rate.
    shortest : int
        Number of frames of the shortest exposure.
    iterations : int
        Fixed-point iterations of the maximum-likelihood weights; 0 leaves the Poisson estimate.
    limits : ndarray
        Chi-square that n samples exceed by chance too rarely to believe, by n.
    """

    exposure_s: tuple[float, ...]
    floor_dn2: tuple[float, ...]
    gain_dn_per_e: float
    common_dn2: tuple[float, float, float]
    shortest: int
    iterations: int
    limits: NDArray[np.float64]


class Outputs(NamedTuple):
    """Where the results of a block go: each (H, W); `flags` zero before; the last two None if unwanted."""

    radiance: NDArray[np.floating]
    variance: NDArray[np.floating]
    flags: NDArray[np.uint8]
    chi_square: NDArray[np.floating] | None
    samples: NDArray[np.unsignedinteger] | None


class _Buffers(NamedTuple):
    """All buffers of a merger, cut to one shape of blocks: one row for each frame, and rows for sums."""

    signal: Any
    weight: Any
    factor: Any
    sums: Any


class _Frames(NamedTuple):
    """The frames that enter a block, one row each.

    The first `whole` have no weights; `weight` is w of the others, None where there are none. `signal` is x,
    later the rate above the first estimate; the columns `exposure_s` and `phi` hold t and floor / t; `number`
    is how many samples count at each pixel, or at all.
    """

    whole: int
    signal: Any
    weight: Any
    factor: Any
    exposure_s: Any
    phi: Any
    number: Any


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
        self._rules, self._ramp, self._shortest = rules, ramp, rules.shortest
        number, pixels = len(rules.exposure_s), shape[0] * shape[1]
        self._whole = _Buffers(*(np.empty((rows, pixels), dtype) for rows in (number, number, number, 7)))
        self._number = np.min_scalar_type(number)
        self._views: dict[tuple[int, ...], _Buffers] = {}
        self._exposure_s = np.array(rules.exposure_s, dtype)[:, np.newaxis]
        self._phi = (np.array(rules.floor_dn2, dtype)[:, np.newaxis] + dtype.type(_TINY)) / self._exposure_s

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
        shape = out.flags.shape
        if shape not in self._views:
            self._views[shape] = _Buffers(*(part[:, : shape[0] * shape[1]] for part in self._whole))
        buffers = self._views[shape]
        frames = self._load(counts, levels, out.flags, buffers)
        first, radiance, variance, chi_square, shot, total, part = buffers.sums
        _first_estimate(frames, first, total)
        np.multiply(frames.signal, 1.0 / frames.exposure_s, out=frames.signal)
        np.subtract(frames.signal, first, out=frames.signal)
        np.copyto(radiance, first)
        if self._rules.iterations:
            for _ in range(self._rules.iterations):
                self._shot(radiance, rate, shot)
                _weigh(frames, shot)
                np.add.reduce(frames.factor, axis=0, out=total)
                np.einsum("ij,ij->j", frames.factor, frames.signal, out=part)
                part /= total
                np.add(first, part, out=radiance)
            _weighted_variance(frames, total, variance)
            self._add_common(frames, total, shot, variance)
            # The sum of squares is about the first estimate: about the last, it is less by the shift's part.
            _chi_square(frames, chi_square)
            part *= part
            part *= total
            chi_square -= part
        else:
            self._shot(radiance, rate, shot)
            self._poisson_variance(frames, shot, total, variance)
            _weigh(frames, shot)
            _chi_square(frames, chi_square)
        out.radiance[:] = radiance.reshape(shape)
        out.variance[:] = variance.reshape(shape)
        self._set_flags(radiance, variance, chi_square, frames.number, out.flags)
        if out.chi_square is not None:
            np.maximum(chi_square.reshape(shape), 0.0, out=out.chi_square)
        if out.samples is not None:
            out.samples[:] = frames.number if isinstance(frames.number, int) else frames.number.reshape(shape)

    def _load(
        self,
        counts: Sequence[NDArray[Any]],
        levels: Sequence[NDArray[Any]],
        flags: NDArray[np.uint8],
        buffers: _Buffers,
    ) -> _Frames:
        """Fill the buffers with the frames of a block, but for the longest that are clipped all over it."""
        ramp, shape = self._ramp, flags.shape
        for index, frame in enumerate(counts):
            np.copyto(buffers.signal[index].reshape(shape), frame, casting="unsafe")
        near = np.flatnonzero(np.maximum.reduce(buffers.signal, axis=1) >= ramp.lowest_start)
        rows = len(counts)
        for row in near[::-1]:
            if row < rows - 1 or np.minimum.reduce(buffers.signal[row]) < ramp.highest_end:
                break
            rows -= 1
        if rows and (not near.size or near[0] >= rows):
            self._subtract(levels, rows, buffers, shape)
            return self._frames(rows, rows, rows, buffers)
        rows, whole = max(rows, self._shortest), int(near[0])
        for row in range(whole, rows):
            weight = buffers.weight[row].reshape(shape)
            ramp.weights(buffers.signal[row].reshape(shape), out=weight)
            if row in near:
                self._reject_neighbours(buffers.signal[row].reshape(shape), weight, flags)
        self._subtract(levels, rows, buffers, shape)
        if (flags & np.uint8(Flag.NEIGHBOUR_CLIPPED)).any():
            self._readmit(counts[:rows], whole, buffers, flags)
        weights = buffers.weight[whole:rows]
        number = np.add.reduce((weights > 0.0).view(np.uint8), axis=0, dtype=self._number)
        number += self._number.type(whole)
        lost = number == 0  # then no frame is whole
        if lost.any():
            flags |= _bits(lost.reshape(shape), Flag.OVER_RANGE)
            weights[: self._shortest, lost] = 1.0  # the shortest exposures' value is a lower bound
        return self._frames(rows, whole, number, buffers)

    def _subtract(
        self, levels: Sequence[NDArray[Any]], rows: int, buffers: _Buffers, shape: tuple[int, ...]
    ) -> None:
        if all(level.size == 1 for level in levels):
            column = np.array([level.item() for level in levels[:rows]], buffers.signal.dtype)
            np.subtract(buffers.signal[:rows], column[:, np.newaxis], out=buffers.signal[:rows])
            return
        for signal, level in zip(buffers.signal[:rows], levels, strict=False):
            part = signal.reshape(shape)
            part -= level

    def _frames(self, rows: int, whole: int, number: Any, buffers: _Buffers) -> _Frames:
        return _Frames(
            whole=whole,
            signal=buffers.signal[:rows],
            weight=buffers.weight[whole:rows] if whole < rows else None,
            factor=buffers.factor[:rows],
            exposure_s=self._exposure_s[:rows],
            phi=self._phi[:rows],
            number=number,
        )

    def _reject_neighbours(self, counts: Any, weight: Any, flags: NDArray[np.uint8]) -> None:
        clipped = self._ramp.clipped(counts)
        if clipped.any():
            near = any_in_cell(clipped)
            flags |= _bits(near & (weight > 0.0), Flag.NEIGHBOUR_CLIPPED)
            weight *= ~near

    def _readmit(
        self, counts: Sequence[NDArray[Any]], whole: int, buffers: _Buffers, flags: NDArray[np.uint8]
    ) -> None:
        """Take samples beside clipped ones back where the others alone tell less than these may be wrong."""
        places = np.flatnonzero(flags & np.uint8(Flag.NEIGHBOUR_CLIPPED))
        rows = len(counts)
        weight = np.ones((rows, places.size))
        weight[whole:] = buffers.weight[whole:rows, places]
        signal = np.maximum((weight * buffers.signal[:rows, places]).sum(axis=0), 0.0)
        floor = np.array(self._rules.floor_dn2[:rows]) @ weight
        places = places[signal**2 * SUSPECT_ERROR**2 <= self._rules.gain_dn_per_e * signal + floor]
        if not places.size:
            return
        at = np.unravel_index(places, flags.shape)
        flags[at] |= np.uint8(Flag.NEAR_CLIPPED_USED)
        for row in range(whole, rows):
            own = self._ramp.weights(counts[row].astype(buffers.weight.dtype))
            buffers.weight[row, places] = own[at]

    def _shot(self, radiance: Any, rate: NDArray[Any], out: Any) -> None:
        """Variance per second of exposure: gain times signal, never negative."""
        if np.minimum.reduce(radiance) < 0.0:
            radiance = np.maximum(radiance, 0.0, out=out)
        np.multiply(radiance, self._rules.gain_dn_per_e, out=out)
        if rate.size > 1 or rate.any():
            dark = self._rules.gain_dn_per_e * rate
            out += dark.ravel() if dark.size > 1 else dark[0]

    def _poisson_variance(self, frames: _Frames, shot: Any, total: Any, out: Any) -> None:
        """Sum of w^2 v over the squared sum of w t."""
        exposure_s, floor = frames.exposure_s[:, 0], frames.phi[:, 0] * frames.exposure_s[:, 0]
        whole = frames.whole
        if frames.weight is None:
            np.multiply(shot, 1.0 / exposure_s.sum(), out=out)
            out += floor.sum() / exposure_s.sum() ** 2
            self._add_lever(exposure_s.size / exposure_s.sum(), out)
            return
        square = np.multiply(frames.weight, frames.weight, out=frames.factor[whole:])
        np.einsum("i,ij->j", exposure_s[whole:], square, out=out)
        out += exposure_s[:whole].sum()
        out *= shot
        out += np.einsum("i,ij->j", floor[whole:], square)
        out += floor[:whole].sum()
        out /= total
        out /= total
        self._add_lever((np.add.reduce(frames.weight, axis=0) + whole) / total, out)

    def _add_common(self, frames: _Frames, total: Any, part: Any, out: Any) -> None:
        if any(self._rules.common_dn2):
            np.einsum("i,ij->j", 1.0 / frames.exposure_s[:, 0], frames.factor, out=part)
            part /= total
            self._add_lever(part, out)

    def _add_lever(self, lever: Any, out: Any) -> None:
        """Add what errors shared by all frames' darks do to the variance.

        An error b + r t of all darks moves the estimate by b sum(a / t) / sum(a) + r.
        """
        bias_bias, bias_rate, rate_rate = self._rules.common_dn2
        if bias_bias or rate_rate:
            out += (bias_bias * lever + 2.0 * bias_rate) * lever + rate_rate

    def _set_flags(
        self, radiance: Any, variance: Any, chi_square: Any, number: Any, flags: NDArray[np.uint8]
    ) -> None:
        least = np.minimum.reduce(radiance)
        if least < 0.0 or least * least < np.maximum.reduce(variance):
            under = (radiance < np.sqrt(variance)).reshape(flags.shape)
            under &= (flags & np.uint8(Flag.OVER_RANGE)) == 0
            flags |= _bits(under, Flag.UNDER_RANGE)
        limits = self._rules.limits
        limit = limits[number] if isinstance(number, int) else limits[2:].min(initial=np.inf)
        if np.maximum.reduce(chi_square) <= limit:
            return
        # Few pixels pass the limit of two samples, the lowest: only these are looked up by their number.
        places = np.flatnonzero(chi_square > limit)
        if not isinstance(number, int):
            places = places[chi_square[places] > limits[number[places]]]
        flags[np.unravel_index(places, flags.shape)] |= np.uint8(Flag.INCONSISTENT)


def _bits(where: NDArray[np.bool_], flag: Flag) -> NDArray[np.uint8]:
    """Set a bit where a mask is set; a multiplication is much quicker than indexing by a mask."""
    return where.view(np.uint8) * np.uint8(flag)


def _first_estimate(frames: _Frames, radiance: Any, total: Any) -> None:
    """Put sum(w x) / sum(w t) into `radiance`, and the denominator into `total` where weights differ."""
    exposure_s = frames.exposure_s[:, 0]
    if frames.weight is None:
        np.add.reduce(frames.signal, axis=0, out=radiance)
        radiance *= 1.0 / exposure_s.sum()
        return
    whole = frames.whole
    np.einsum("ij,ij->j", frames.weight, frames.signal[whole:], out=radiance)
    np.einsum("i,ij->j", exposure_s[whole:], frames.weight, out=total)
    if whole:
        radiance += np.add.reduce(frames.signal[:whole], axis=0)
        total += exposure_s[:whole].sum()
    radiance /= total


def _weigh(frames: _Frames, shot: Any) -> None:
    """Put a = w t / (S + phi) into the factors."""
    np.add(shot, frames.phi, out=frames.factor)
    np.divide(frames.exposure_s, frames.factor, out=frames.factor)
    if frames.weight is not None:
        weighed = frames.factor[frames.whole :]
        weighed *= frames.weight


def _weighted_variance(frames: _Frames, total: Any, out: Any) -> None:
    """Sum of w a over the squared sum of a: the variance of a frame's rate is w / a."""
    if frames.weight is None:
        np.reciprocal(total, out=out)
        return
    np.einsum("ij,ij->j", frames.factor[frames.whole :], frames.weight, out=out)
    out += np.add.reduce(frames.factor[: frames.whole], axis=0)
    out /= total
    out /= total


def _chi_square(frames: _Frames, out: Any) -> None:
    """Sum of a u^2, for the rates u above the first estimate, which are squared in place."""
    np.multiply(frames.signal, frames.signal, out=frames.signal)
    np.einsum("ij,ij->j", frames.factor, frames.signal, out=out)
