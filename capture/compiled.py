"""The merge of integer counts as one compiled pass, for large frames: the same estimates as `capture.block`.

numpy walks over every sample about fifteen times; here a tile of two rows stays in the first cache from its
counts to its flags. The machine code is made once and kept on disk by numba, so this module is imported only
where there is enough to merge to pay for that. All of it stands in one file: numba makes the code anew when
this file changes, not when another does that it calls.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numba
import numpy as np

from capture.block import SUSPECT_ERROR
from capture.flags import Flag
from capture.frames import tile

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from capture.block import Outputs, Rules
    from capture.clip import RampLevels

TILE_COLS = 256
"""Columns of a tile of two rows, even."""

_PIXELS = 2 * TILE_COLS
_TINY = np.float32(1e-30)
_ZERO, _ONE, _TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
_OVER, _UNDER = np.uint8(Flag.OVER_RANGE), np.uint8(Flag.UNDER_RANGE)
_BESIDE, _USED = np.uint8(Flag.NEIGHBOUR_CLIPPED), np.uint8(Flag.NEAR_CLIPPED_USED)
_INCONSISTENT, _NONE = np.uint8(Flag.INCONSISTENT), np.uint8(0)

# Planes of the working memory: sums over the frames, what is the same for all tiles, and for each frame its
# counts, its signal and its weight.
_SUM, _TOTAL, _FIRST, _RADIANCE, _SHOT, _DARK = range(6)
_SQUARE, _FLOOR, _LEVER, _CHI, _NUMBER = range(6, 11)
_END, _SLOPE, _CLIPPED = range(11, 14)
_FRAMES = 14


def _compiled(function: Callable[..., Any]) -> Any:
    """Compile a function when it is first called; keep the code on disk where there is a place for it."""
    options: dict[str, Any] = {
        "nogil": True,
        "error_model": "numpy",
        "fastmath": {"contract", "nsz", "nnan"},
    }
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # neither the installation nor the home can be written
        return numba.njit(**options)(function)


class _Model(NamedTuple):
    """Noise of the frames, ascending exposure: exposure_s and floor_dn2 of each; the rest as in `Rules`."""

    exposure_s: Any
    floor_dn2: Any
    gain: Any
    bias_bias: Any
    bias_rate: Any
    rate_rate: Any
    shortest: Any
    iterations: Any
    limits: Any
    lowest_start: Any
    highest_end: Any
    lowest_clipped: Any


class _Work(NamedTuple):
    """Working memory of a tile: its planes, the largest count of each frame, and its flags."""

    planes: Any
    peaks: Any
    marks: Any


class _Band(NamedTuple):
    """What is read: attributes as the arguments of `RowMerger.merge`."""

    counts: Any
    levels: Any
    rate: Any


class RowMerger:
    """Merges bands of rows, one after the other, in working memory of its own: one for each thread.

    Parameters
    ----------
    rules : Rules
    ramp : RampLevels
        Where the weights fall, and where samples are clipped.
    """

    def __init__(self, rules: Rules, ramp: RampLevels) -> None:
        single = np.float32
        number = len(rules.exposure_s)
        bias_bias, bias_rate, rate_rate = rules.common_dn2
        self._model = _Model(
            np.array(rules.exposure_s, single),
            np.array(rules.floor_dn2, single) + _TINY,
            single(rules.gain_dn_per_e),
            single(bias_bias),
            single(bias_rate),
            single(rate_rate),
            rules.shortest,
            rules.iterations,
            rules.limits.astype(single),
            single(ramp.start.min()),
            single(ramp.end.max()),
            single(ramp.clipped.min()),
        )
        planes = np.zeros((_FRAMES + 3 * number, _PIXELS), single)
        for plane, cell in ((_END, ramp.end), (_SLOPE, ramp.slope), (_CLIPPED, ramp.clipped)):
            planes[plane] = tile(cell, (2, TILE_COLS)).ravel()
        self._work = _Work(planes, np.zeros(number, np.uint16), np.zeros(_PIXELS, np.uint8))

    def merge(
        self, counts: NDArray[np.uint16], levels: NDArray[np.float32], rate: NDArray[np.float32], out: Outputs
    ) -> None:
        """Merge a band of rows, which begins at an even row.

        Parameters
        ----------
        counts : ndarray of uint16, shape (N, H, W)
            The frames' counts.
        levels : ndarray of float32, shape (N, H, W) or (N, 2, TILE_COLS)
            Dark level of each frame, or of each of its tiles.
        rate : ndarray of float32, shape (H, W) or (2, TILE_COLS)
            Dark signal per second, or that of each tile; its shot noise is noise.
        out : Outputs
            Of the band.
        """
        unwanted = np.empty((0, 0), np.float32), np.empty((0, 0), np.uint16)
        wanted = out._replace(
            chi_square=unwanted[0] if out.chi_square is None else out.chi_square,
            samples=unwanted[1] if out.samples is None else out.samples,
        )
        _merge_rows(_Band(counts, levels, rate), self._model, self._work, wanted)


@_compiled
def _merge_rows(band: Any, model: Any, work: Any, out: Any) -> None:
    """Merge all tiles; what is computed of pixels that a tile at an edge has not got goes nowhere."""
    _, height, width = band.counts.shape
    for top in range(0, height, 2):
        for left in range(0, width, TILE_COLS):
            place = (top, left)
            whole, used = _load(band, place, model, work)
            work.marks[:] = 0
            if whole < used:
                _weigh(whole, used, model, work)
            else:
                work.planes[_NUMBER] = used
            _poisson(whole, used, model, work.planes)
            for _ in range(model.iterations - 1):
                _iterate(whole, used, model, work.planes)
            if model.iterations:
                _finish(whole, used, model, work.planes)
            else:
                _poisson_chi_square(whole, used, model, work.planes)
            _mark(model, work.planes, work.marks)
            _store(work.planes[_RADIANCE], out.radiance, place)
            _store(work.planes[_FLOOR], out.variance, place)
            _store(work.marks, out.flags, place)
            if out.chi_square.size:
                _store(work.planes[_CHI], out.chi_square, place)
            if out.samples.size:
                _store(work.planes[_NUMBER], out.samples, place)


@_compiled
def _store(plane: Any, values: Any, corner: tuple[int, int]) -> None:
    top, left = corner
    for row in range(min(2, len(values) - top)):
        target = values[top + row, left : left + TILE_COLS]
        source = plane[row * TILE_COLS : row * TILE_COLS + len(target)]
        for col in range(len(target)):
            target[col] = source[col]


@_compiled
def _load_plane(values: Any, corner: tuple[int, int], plane: Any) -> None:
    """Fill a plane with the values of a tile, which are the same for all tiles or those of its pixels."""
    top, left = (0, 0) if values.shape == (2, TILE_COLS) else corner
    for row in range(min(2, len(values) - top)):
        source = values[top + row, left : left + TILE_COLS]
        target = plane[row * TILE_COLS : row * TILE_COLS + len(source)]
        for col in range(len(source)):
            target[col] = source[col]


@_compiled
def _load(band: Any, corner: tuple[int, int], model: Any, work: Any) -> tuple[int, int]:
    """Fill in counts, their maxima, signals and dark signal.

    Returns how many of the shorter frames are below the ramp all over, and how many frames are of use: the
    longest ones may be clipped all over.
    """
    number, height, width = band.counts.shape
    _load_plane(band.rate, corner, work.planes[_DARK])
    whole = used = number
    for frame in range(number - 1, -1, -1):
        plane, signal = work.planes[_FRAMES + 3 * frame], work.planes[_FRAMES + 3 * frame + 1]
        if height - corner[0] < 2 or width - corner[1] < TILE_COLS:
            plane[:] = _ZERO  # what the tile has not got is not clipped
        _load_plane(band.counts[frame], corner, plane)
        least, most = _extremes(band.counts[frame], corner)
        work.peaks[frame] = most
        if most >= model.lowest_start:
            whole = frame
        if used == frame + 1 and least >= model.highest_end and frame >= model.shortest:
            used = frame
            continue
        _load_plane(band.levels[frame], corner, signal)
        for place in range(_PIXELS):
            signal[place] = plane[place] - signal[place]
    return min(whole, used), used


@_compiled
def _extremes(counts: Any, corner: tuple[int, int]) -> tuple[int, int]:
    top, left = corner
    least = most = counts[top, left]
    for row in range(top, min(top + 2, len(counts))):
        line = counts[row, left : left + TILE_COLS]
        for col in range(len(line)):
            least, most = min(least, line[col]), max(most, line[col])
    return least, most


@_compiled
def _ramp(count: Any, end: Any, slope: Any) -> Any:
    return min(max((end - count) * slope, _ZERO), _ONE)


@_compiled
def _weigh(whole: int, used: int, model: Any, work: Any) -> None:
    """Weights of the frames from `whole` on, and the number of samples that have any."""
    planes, marks = work.planes, work.marks
    end, slope, number = planes[_END], planes[_SLOPE], planes[_NUMBER]
    number[:] = whole
    suspects = False
    for frame in range(whole, used):
        plane, weight = planes[_FRAMES + 3 * frame], planes[_FRAMES + 3 * frame + 2]
        for place in range(_PIXELS):
            weight[place] = _ramp(plane[place], end[place], slope[place])
            number[place] += _ONE if weight[place] > _ZERO else _ZERO
        if work.peaks[frame] >= model.lowest_clipped:
            suspects |= _reject_neighbours(plane, planes[_CLIPPED], weight, number, marks)
    if suspects:
        _readmit(whole, used, model, planes, marks)
    lost = 0
    for place in range(_PIXELS):
        lost += number[place] == _ZERO
    for place in range(_PIXELS if lost else 0):
        if number[place] == _ZERO:  # then no frame is whole
            marks[place] |= _OVER
            for frame in range(model.shortest):  # the shortest exposures' value is a lower bound
                planes[_FRAMES + 3 * frame + 2, place] = _ONE


@_compiled
def _reject_neighbours(plane: Any, clipped: Any, weight: Any, number: Any, marks: Any) -> bool:
    """Take the weight of samples in a cell with a clipped one; return whether there was any to take."""
    found = False
    for left in range(0, TILE_COLS, 2):
        cell = (left, left + 1, left + TILE_COLS, left + TILE_COLS + 1)
        beside = False
        for place in cell:
            beside |= plane[place] >= clipped[place]
        if beside:
            for place in cell:
                if weight[place] > _ZERO:
                    marks[place] |= _BESIDE
                    weight[place] = _ZERO
                    number[place] -= _ONE
                    found = True
    return found


@_compiled
def _readmit(whole: int, used: int, model: Any, planes: Any, marks: Any) -> None:
    """Take samples beside clipped ones back where the others alone tell less than these may be wrong."""
    for place in range(_PIXELS):
        if not marks[place] & _BESIDE:
            continue
        signal = floor = 0.0
        for frame in range(used):
            weight = 1.0 if frame < whole else float(planes[_FRAMES + 3 * frame + 2, place])
            signal += weight * planes[_FRAMES + 3 * frame + 1, place]
            floor += weight * model.floor_dn2[frame]
        signal = max(signal, 0.0)
        if signal * signal * SUSPECT_ERROR**2 > model.gain * signal + floor:
            continue
        marks[place] |= _USED
        planes[_NUMBER, place] = whole
        for frame in range(whole, used):
            weight = _ramp(planes[_FRAMES + 3 * frame, place], planes[_END, place], planes[_SLOPE, place])
            planes[_FRAMES + 3 * frame + 2, place] = weight
            planes[_NUMBER, place] += _ONE if weight > _ZERO else _ZERO


@_compiled
def _lever_variance(lever: Any, model: Any) -> Any:
    """Variance from the errors that all darks share, for a lever sum(a / t) / sum(a)."""
    return (model.bias_bias * lever + _TWO * model.bias_rate) * lever + model.rate_rate


@_compiled
def _poisson(whole: int, used: int, model: Any, planes: Any) -> None:
    """Sum of w x over sum of w t, its variance (sum of w^2 v over the squared sum of w t)."""
    seconds = floor = _ZERO
    for frame in range(whole):
        seconds += model.exposure_s[frame]
        floor += model.floor_dn2[frame]
    total, first, radiance, shot = planes[_TOTAL], planes[_FIRST], planes[_RADIANCE], planes[_SHOT]
    square, variance, lever, chi, dark = (
        planes[_SQUARE],
        planes[_FLOOR],
        planes[_LEVER],
        planes[_CHI],
        planes[_DARK],
    )
    for place in range(_PIXELS):
        first[place] = chi[place] = _ZERO
        total[place] = square[place] = seconds
        variance[place] = floor
        lever[place] = whole
    for frame in range(whole):
        signal = planes[_FRAMES + 3 * frame + 1]
        for place in range(_PIXELS):
            first[place] += signal[place]
    for frame in range(whole, used):
        signal, weight = planes[_FRAMES + 3 * frame + 1], planes[_FRAMES + 3 * frame + 2]
        exposure, rest = model.exposure_s[frame], model.floor_dn2[frame]
        for place in range(_PIXELS):
            first[place] += weight[place] * signal[place]
            total[place] += weight[place] * exposure
            square[place] += weight[place] * weight[place] * exposure
            variance[place] += weight[place] * weight[place] * rest
            lever[place] += weight[place]
    for place in range(_PIXELS):
        inverse = _ONE / total[place]
        first[place] *= inverse
        radiance[place] = first[place]
        shot[place] = model.gain * (max(first[place], _ZERO) + dark[place])
        variance[place] = (variance[place] + shot[place] * square[place]) * inverse * inverse
        variance[place] += _lever_variance(lever[place] * inverse, model)


@_compiled
def _poisson_chi_square(whole: int, used: int, model: Any, planes: Any) -> None:
    first, shot, chi = planes[_FIRST], planes[_SHOT], planes[_CHI]
    for frame in range(used):
        signal, weight = planes[_FRAMES + 3 * frame + 1], planes[_FRAMES + 3 * frame + 2]
        exposure, rest = model.exposure_s[frame], model.floor_dn2[frame]
        if frame < whole:
            for place in range(_PIXELS):
                off = signal[place] - first[place] * exposure
                chi[place] += off * off / (shot[place] * exposure + rest)
        else:
            for place in range(_PIXELS):
                off = signal[place] - first[place] * exposure
                chi[place] += weight[place] * off * off / (shot[place] * exposure + rest)


@_compiled
def _iterate(whole: int, used: int, model: Any, planes: Any) -> None:
    """One fixed-point iteration of the weights a = w t / (S + phi), of rates above the first estimate."""
    total, first, radiance, shot = planes[_TOTAL], planes[_FIRST], planes[_RADIANCE], planes[_SHOT]
    moved, dark = planes[_SUM], planes[_DARK]
    for place in range(_PIXELS):
        shot[place] = model.gain * (max(radiance[place], _ZERO) + dark[place])
        total[place] = moved[place] = _ZERO
    for frame in range(used):
        signal, weight = planes[_FRAMES + 3 * frame + 1], planes[_FRAMES + 3 * frame + 2]
        exposure, rest = model.exposure_s[frame], model.floor_dn2[frame]
        if frame < whole:
            for place in range(_PIXELS):
                reach = exposure / (shot[place] * exposure + rest)  # a / t
                total[place] += reach * exposure
                moved[place] += reach * (signal[place] - first[place] * exposure)
        else:
            for place in range(_PIXELS):
                reach = weight[place] * exposure / (shot[place] * exposure + rest)
                total[place] += reach * exposure
                moved[place] += reach * (signal[place] - first[place] * exposure)
    for place in range(_PIXELS):
        radiance[place] = first[place] + moved[place] / total[place]


@_compiled
def _finish(whole: int, used: int, model: Any, planes: Any) -> None:
    """Last iteration, with the variance sum(w a) / sum(a)^2 and chi-square."""
    total, first, radiance, shot = planes[_TOTAL], planes[_FIRST], planes[_RADIANCE], planes[_SHOT]
    square, variance, lever, chi = planes[_SQUARE], planes[_FLOOR], planes[_LEVER], planes[_CHI]
    moved, dark = planes[_SUM], planes[_DARK]
    for place in range(_PIXELS):
        shot[place] = model.gain * (max(radiance[place], _ZERO) + dark[place])
        total[place] = moved[place] = square[place] = lever[place] = chi[place] = _ZERO
    for frame in range(used):
        signal, weight = planes[_FRAMES + 3 * frame + 1], planes[_FRAMES + 3 * frame + 2]
        exposure, rest = model.exposure_s[frame], model.floor_dn2[frame]
        rate = _ONE / exposure
        if frame < whole:
            for place in range(_PIXELS):
                off = signal[place] - first[place] * exposure
                reach = exposure / (shot[place] * exposure + rest)
                total[place] += reach * exposure
                square[place] += reach * exposure
                lever[place] += reach
                moved[place] += reach * off
                chi[place] += reach * off * off * rate
        else:
            for place in range(_PIXELS):
                off = signal[place] - first[place] * exposure
                reach = weight[place] * exposure / (shot[place] * exposure + rest)
                total[place] += reach * exposure
                square[place] += weight[place] * reach * exposure
                lever[place] += reach
                moved[place] += reach * off
                chi[place] += reach * off * off * rate
    for place in range(_PIXELS):
        inverse = _ONE / total[place]
        step = moved[place] * inverse
        radiance[place] = first[place] + step
        variance[place] = square[place] * inverse * inverse + _lever_variance(lever[place] * inverse, model)
        # The sum of squares is about the first estimate: about the last, it is less by the shift's part.
        chi[place] = max(chi[place] - step * moved[place], _ZERO)


@_compiled
def _mark(model: Any, planes: Any, marks: Any) -> None:
    """Set the flags that follow from the results."""
    radiance, variance, chi, number = planes[_RADIANCE], planes[_FLOOR], planes[_CHI], planes[_NUMBER]
    lowest = model.limits[2:].min() if len(model.limits) > 2 else np.float32(np.inf)
    doubted = 0
    for place in range(_PIXELS):
        dim = (radiance[place] < _ZERO) | (radiance[place] * radiance[place] < variance[place])
        marks[place] |= _UNDER if dim & (marks[place] & _OVER == 0) else _NONE
        doubted += chi[place] > lowest
    if doubted:
        for place in range(_PIXELS):
            if chi[place] > model.limits[int(number[place])]:
                marks[place] |= _INCONSISTENT
