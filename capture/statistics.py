"""What one frame shows, in a few numbers: all that the choice of the next exposure may look at.

They are journalled with the frame, so that a resumed session decides as the interrupted one would have.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.raw import RawFrame
    from capture.sensor import SensorModel

BRIGHT_PERCENTILE = 99.8
"""What counts as the brightest part: as many pixels stay out as may clip, more than a sensor has hot ones."""

DIM_PERCENTILE = 5.0
"""What counts as the dim part."""

ENOUGH_PIXELS = 250_000
"""Pixels that are looked at in a large frame."""


@dataclass(frozen=True, slots=True)
class ChannelStatistics:
    """One colour channel of a frame, over the sample's pixels, in DN above black.

    Attributes
    ----------
    dim_dn, median_dn, bright_dn : float
        Percentiles 5, 50 and 99.8.
    range_dn : float
        Clip level above black.
    clipped_fraction : float
        Part of the pixels at or above the clip level.
    """

    dim_dn: float
    median_dn: float
    bright_dn: float
    range_dn: float
    clipped_fraction: float


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """One frame, by channel.

    Attributes
    ----------
    channels : tuple of ChannelStatistics
    pixels : int
        Number of pixels looked at.
    """

    channels: tuple[ChannelStatistics, ...]
    pixels: int

    @property
    def brightness(self) -> float:
        """The brightest part over its range, of the channel where that is highest; about 1 when clipped."""
        return max(channel.bright_dn / channel.range_dn for channel in self.channels)

    @property
    def clipped_fraction(self) -> float:
        """Part of the pixels that clip, of the channel where that is highest."""
        return max(channel.clipped_fraction for channel in self.channels)

    @property
    def dim_dn(self) -> float:
        """The dim part, of the channel where that is lowest, in DN above black."""
        return min(channel.dim_dn for channel in self.channels)

    def to_json(self) -> str:
        """Return it as text that `from_json` reads back equal."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> FrameStatistics:
        """Inverse of `to_json`.

        Raises
        ------
        ValueError, KeyError, TypeError
            The text is something else.
        """
        content = json.loads(text)
        return cls(tuple(ChannelStatistics(**channel) for channel in content["channels"]), content["pixels"])


def thinned(
    frame: RawFrame, most_pixels: int = ENOUGH_PIXELS
) -> tuple[RawFrame, NDArray[np.int64], NDArray[np.int64]]:
    """Keep evenly spread 2 x 2 cells of a large frame, enough for percentiles.

    Parameters
    ----------
    frame : RawFrame
    most_pixels : int
        A frame with no more pixels stays whole.

    Returns
    -------
    frame : RawFrame
        With the same mosaic and fewer counts.
    rows, cols : ndarray of int
        Where its rows and columns lie in the whole frame.
    """
    height, width = (size // 2 * 2 for size in frame.counts.shape)
    step = max(1, math.ceil(math.sqrt(height * width / most_pixels)))
    rows, cols = ((np.arange(0, size, 2 * step)[:, None] + np.arange(2)).ravel() for size in (height, width))
    return replace(frame, counts=frame.counts[np.ix_(rows, cols)]), rows, cols


def frame_statistics(
    frame: RawFrame, region: NDArray[np.bool_] | None = None, sensor: SensorModel | None = None
) -> FrameStatistics:
    """Look at one frame.

    Parameters
    ----------
    frame : RawFrame
    region : ndarray of bool, shape (H, W), optional
        The pixels that matter; by default, and where a channel has none of them, all.
    sensor : SensorModel, optional
        Its clip level and black replace what the file claims.

    Returns
    -------
    FrameStatistics
    """
    channels = []
    counted = 0
    for channel in range(len(frame.channels)):
        clip_dn = frame.white_dn if sensor is None else sensor.clip_of_channel(channel)
        values, clipped, black = _pixels(frame, channel, region, clip_dn, sensor)
        dim, median, bright = np.percentile(values, (DIM_PERCENTILE, 50.0, BRIGHT_PERCENTILE))
        channels.append(
            ChannelStatistics(
                float(dim), float(median), float(bright), float(clip_dn - black), float(np.mean(clipped))
            )
        )
        counted += values.size
    return FrameStatistics(tuple(channels), counted)


def _pixels(
    frame: RawFrame,
    channel: int,
    region: NDArray[np.bool_] | None,
    clip_dn: float,
    sensor: SensorModel | None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], float]:
    """Collect one channel's counts above black, which of them clip, and its highest black level."""
    black_dn = frame.black_dn
    if sensor is not None and sensor.black_dn is not None:
        black_dn = np.reshape(sensor.black_dn, (2, 2))
    places = [(row, col) for row in (0, 1) for col in (0, 1) if frame.cfa[row, col] == channel]
    for wanted in (region, None):
        values, clipped = [], []
        for row, col in places:
            counts = frame.counts[row::2, col::2]
            counts = counts.ravel() if wanted is None else counts[wanted[row::2, col::2]]
            values.append(counts.astype(np.float64) - black_dn[row, col])
            clipped.append(counts >= clip_dn)
        if sum(part.size for part in values):
            break
    highest = max(float(black_dn[row, col]) for row, col in places)
    return np.concatenate(values), np.concatenate(clipped), highest
