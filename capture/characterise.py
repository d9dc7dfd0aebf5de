"""A sensor's character from its own frames: darks of several exposures, pairs of flats, frames far too long.

The quantities and symbols are those of EMVA 1288 release 4, as far as frames without a calibrated photon
count allow: there is no quantum efficiency, and sensitivities are in electrons, not photons.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.dark import DarkModel
from capture.linearity import Bend, Linearity, bright_region, fit_bend, fit_linearity
from capture.ptc import PhotonTransfer, TransferPoints, fit_transfer, pair_points, quantisation_step
from capture.raw import read_raw
from capture.saturation import SURELY, Saturation, measure_saturation
from capture.sensor import SensorModel
from capture.sensor_frames import SensorFrames, require_dark
from capture.uniformity import dark_unevenness_dn, relative_unevenness
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

PRNU_FILL = (0.3, 0.7)
"""Flats of this part of the range tell the pixels' inequality."""

_CLEAR_FILL = 0.75
_PERCENTILE = 99.5


@dataclass(frozen=True, eq=False)
class SensorCharacter:
    """What the frames say of a sensor.

    Attributes
    ----------
    camera_serial, camera_model : str or None
    iso : float or None
    channels : tuple of str
    cfa : ndarray of int, shape (2, 2)
    dark : DarkModel
        Bias, dark rate, hot pixels.
    transfer : PhotonTransfer
        Gain and read noise over all channels.
    transfer_of : tuple of PhotonTransfer
        The same of each channel.
    points : TransferPoints
        What they were fitted to.
    linearity : tuple of Linearity
        Of each channel.
    bend : Bend or None
        How the response departs from proportion; None with too few levels.
    saturation : Saturation or None
        None where no frame was long enough.
    nominal_clip_dn : float
        What the files claim.
    prnu : float
        Relative; NaN where no flat could tell.
    dsnu_dn : float
        At the shortest dark exposure, DN; NaN where the darks could not tell.
    dark_current_dn_per_s, u_dark_current_dn_per_s : float
        Mean over ordinary pixels, and its standard uncertainty.
    dark_current_by_variance_e_per_s : float
        From the growth of the variance instead of the mean.
    """

    camera_serial: str | None
    camera_model: str | None
    iso: float | None
    channels: tuple[str, ...]
    cfa: NDArray[np.int64]
    dark: DarkModel
    transfer: PhotonTransfer
    transfer_of: tuple[PhotonTransfer, ...]
    points: TransferPoints
    linearity: tuple[Linearity, ...]
    bend: Bend | None
    saturation: Saturation | None
    nominal_clip_dn: float
    prnu: float
    dsnu_dn: float
    dark_current_dn_per_s: float
    u_dark_current_dn_per_s: float
    dark_current_by_variance_e_per_s: float

    @property
    def black_dn(self) -> tuple[float, float, float, float]:
        """Median bias at the four positions of the cell, row by row."""
        cell = [
            float(self.dark.bias_dn[row::2, col::2][~self.dark.hot[row::2, col::2]].mean(dtype=np.float64))
            for row in (0, 1)
            for col in (0, 1)
        ]
        return (cell[0], cell[1], cell[2], cell[3])

    @property
    def clip_dn(self) -> tuple[float, ...]:
        """Clip level of each channel, black included; the files' where none was measured."""
        if self.saturation is None:
            return (self.nominal_clip_dn,) * len(self.channels)
        return self.saturation.clip_of_channels(self.cfa, len(self.channels))

    @property
    def saturation_e(self) -> float:
        """Saturation capacity in electrons: of the position that saturates first."""
        level = np.nanmin(
            (self.saturation.level_dn if self.saturation is not None else self.nominal_clip_dn)
            - np.reshape(self.black_dn, (2, 2))
        )
        return float(level / self.transfer.gain_dn_per_e)

    @property
    def threshold_e(self) -> float:
        """Absolute sensitivity threshold: electrons at which the signal equals its noise."""
        dark_e = math.sqrt(max(self.transfer.floor_dn2, 0.0)) / self.transfer.gain_dn_per_e
        return math.sqrt(dark_e**2 + 0.25) + 0.5

    def model(self, **more: Any) -> SensorModel:
        """Make the calibration file's content; `more` are further fields of `SensorModel`."""
        line = self.transfer
        return SensorModel(
            gain_dn_per_e=line.gain_dn_per_e,
            read_noise_dn=line.read_noise_dn,
            clip_dn=self.clip_dn,
            black_dn=self.black_dn,
            dark_current_dn_per_s=max(self.dark_current_dn_per_s, 0.0),
            quantisation_step_dn=line.quantisation_step_dn,
            camera_serial=self.camera_serial,
            camera_model=self.camera_model,
            iso=self.iso,
            u_gain_dn_per_e=line.u_gain_dn_per_e,
            u_read_noise_dn=line.u_read_noise_dn,
            bend=None if self.bend is None else self.bend.coefficients,
            bend_range_dn=None if self.bend is None else self.bend.range_dn,
            bend_error=None if self.bend is None else self.bend.error,
            linearity_error=max((each.error for each in self.linearity), default=None),
            prnu=self.prnu if math.isfinite(self.prnu) else None,
            **more,
        )


def characterise(
    frames: SensorFrames, progress: Callable[[str], None] = lambda _note: None
) -> SensorCharacter:
    """Work out a sensor's character.

    Frames are read one or two at a time.

    Parameters
    ----------
    frames : SensorFrames
    progress : callable
        Told what is under way.

    Returns
    -------
    SensorCharacter

    Raises
    ------
    BadInput
        A dark frame with light in it, or too few frames: one exposure of darks, no pairs, no light.
    """
    progress("darks")
    dark = DarkModel.from_frames(
        [path for level in frames.darks for path in level.files],
        [level.exposure_s for level in frames.darks for _ in level.files],
    )
    clear = _clearest_flat(frames)
    require_dark(frames.darks, read_raw(clear[0]))
    progress("saturation")
    saturation = _saturation(frames, dark, clear)
    clip = float(np.nanmin(saturation.clip_dn)) if saturation else frames.first.white_dn
    range_dn = clip - float(np.max([dark.bias_dn[row::2, col::2].mean() for row in (0, 1) for col in (0, 1)]))
    progress("pairs")
    pairs = _Pairs(frames, dark, range_dn, clear)
    step = quantisation_step(frames.first.counts)
    transfer = fit_transfer(pairs.points, step)
    channels = len(frames.first.channels)
    of_channels = tuple(fit_transfer(pairs.points.of(channel), step) for channel in range(channels))
    rate, u_rate = _dark_current(dark)
    linearity = tuple(
        fit_linearity(pairs.exposures_s, pairs.signals[:, channel], pairs.clear[:, channel], range_dn)
        for channel in range(channels)
        if np.count_nonzero(pairs.clear[:, channel]) > 2
    )
    return SensorCharacter(
        camera_serial=frames.first.camera_serial,
        camera_model=frames.first.camera_model,
        iso=frames.first.iso,
        channels=frames.first.channels,
        cfa=frames.first.cfa,
        dark=dark,
        transfer=transfer,
        transfer_of=of_channels,
        points=pairs.points,
        linearity=linearity,
        bend=fit_bend(linearity, range_dn),
        saturation=saturation,
        nominal_clip_dn=frames.first.white_dn,
        prnu=float(np.sqrt(np.mean(np.square(pairs.prnu)))) if pairs.prnu else math.nan,
        dsnu_dn=_dsnu(frames, dark),
        dark_current_dn_per_s=rate,
        u_dark_current_dn_per_s=u_rate,
        dark_current_by_variance_e_per_s=_variance_rate(pairs.dark_variances, transfer),
    )


def _clearest_flat(frames: SensorFrames) -> tuple[Path, float]:
    """Brightest flat that surely clips nowhere, and its exposure.

    Its brightest part is below `_CLEAR_FILL` of the largest count in any frame.
    """
    brightest = [float(np.percentile(read_raw(level.files[0]).counts, _PERCENTILE)) for level in frames.flats]
    black = float(np.mean(frames.first.black_dn))
    largest = max(brightest) - black
    fine = [index for index, value in enumerate(brightest) if value - black < _CLEAR_FILL * largest]
    if not fine:
        what = f"all {len(frames.flats)} exposures of the flats are equally bright"
        raise BadInput(what, todo="shoot flats from a twentieth of the range to beyond clipping")
    return frames.flats[fine[-1]].files[0], frames.flats[fine[-1]].exposure_s


def _saturation(frames: SensorFrames, dark: DarkModel, clear: tuple[Path, float]) -> Saturation | None:
    """Saturation from the longest flat, None where nothing in it must be saturated."""
    longest = frames.flats[-1]
    path, seconds = clear
    if longest.exposure_s < SURELY * seconds:
        return None
    rate = (read_raw(path).counts - dark.bias_dn) / seconds
    found = measure_saturation(
        read_raw(longest.files[0]).counts,
        np.where(dark.hot, 0.0, rate),
        dark.bias_dn,
        longest.exposure_s,
    )
    return found if np.isfinite(found.level_dn).all() else None


class _Pairs:
    """One walk over all pairs: points of the transfer line, mean signals, inequality."""

    def __init__(
        self, frames: SensorFrames, dark: DarkModel, range_dn: float, clear: tuple[Path, float]
    ) -> None:
        usable = ~dark.hot
        cfa = frames.first.cfa
        regions = bright_region(read_raw(clear[0]).counts - dark.bias_dn, usable, cfa)
        parts, exposures, signals, clears = [], [], [], []
        self.prnu: list[float] = []
        self.dark_variances: list[tuple[float, float, int]] = []
        """Exposure, mean variance and pixels of each pair of darks."""
        for level in frames.darks:
            for pair in level.pairs:
                a, b = (read_raw(path).counts for path in pair)
                points = pair_points(a, b, dark.bias_dn, cfa, range_dn=range_dn, usable=usable)
                parts.append(points)
                total = int(points.pixels.sum())
                variance = float(np.average(points.variance_dn2, weights=points.pixels))
                self.dark_variances.append((level.exposure_s, variance, total))
        for level in frames.flats:
            signal, clear_now = np.zeros(len(regions)), np.ones(len(regions), dtype=bool)
            for pair in level.pairs:
                a, b = (read_raw(path).counts for path in pair)
                parts.append(pair_points(a, b, dark.bias_dn, cfa, range_dn=range_dn, usable=usable))
                level_dn = dark.bias_dn + dark.rate_dn_per_s * level.exposure_s
                light = (a - level_dn, b - level_dn)
                for channel, region in enumerate(regions):
                    values = np.concatenate([each[region] for each in light])
                    signal[channel] += float(values.mean()) / len(level.pairs)
                    clear_now[channel] &= bool(np.percentile(values, 99.0) < 0.97 * range_dn)
                middle = float(np.percentile(light[0], _PERCENTILE)) / range_dn
                if PRNU_FILL[0] < middle < PRNU_FILL[1]:
                    self.prnu.append(relative_unevenness(light[0], light[1], usable))
            if level.pairs:
                exposures.append(level.exposure_s)
                signals.append(signal)
                clears.append(clear_now)
        if not exposures:
            raise BadInput("no pairs of flats", todo="shoot two flats at least of every exposure")
        self.prnu = [value for value in self.prnu if math.isfinite(value)]
        self.points = TransferPoints.joined(parts)
        self.exposures_s = np.array(exposures)
        self.signals = np.array(signals)
        self.clear = np.array(clears)


def _dark_current(dark: DarkModel) -> tuple[float, float]:
    """Mean rate of ordinary pixels and its uncertainty, DN/s; NaN from one exposure."""
    if len(dark.exposure_s) < 2:
        return math.nan, math.nan
    rates = dark.rate_dn_per_s[~dark.hot].astype(np.float64)
    noise = dark.noise_variance_dn2 * float(dark.covariance[1, 1])
    return float(rates.mean()), math.sqrt((noise + float(rates.var())) / rates.size)


def _variance_rate(variances: list[tuple[float, float, int]], transfer: PhotonTransfer) -> float:
    """Dark current in electrons a second from the growth of the dark variance (EMVA 1288, section 7.2)."""
    if len({seconds for seconds, _, _ in variances}) < 2:
        return math.nan
    seconds, values, pixels = (np.array(column, dtype=np.float64) for column in zip(*variances, strict=True))
    weights = np.sqrt(pixels) / values
    slope = float(np.polyfit(seconds, values, 1, w=weights)[0])
    return slope / transfer.gain_dn_per_e**2


def _dsnu(frames: SensorFrames, dark: DarkModel) -> float:
    files = frames.darks[0].files
    if len(files) < 2:
        return math.nan
    first, second = (
        np.mean([read_raw(path).counts for path in half], axis=0) for half in (files[::2], files[1::2])
    )
    return dark_unevenness_dn(first, second, ~dark.hot)
