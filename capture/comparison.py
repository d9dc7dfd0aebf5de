"""Two sets of frames of one place, compared channel by channel over the sample's pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from capture.merge import Flag, merge
from capture.raw import read_raw
from capture.statistics import thinned
from rig.pixels import pixel_geometry

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from capture.sensor import SensorModel
    from rig.description import Rig

COVERAGE = 2.0
"""Standard uncertainties by which a step must exceed the tolerance to be refused."""

_SATURATED = Flag.OVER_RANGE | Flag.NEIGHBOUR_CLIPPED | Flag.NEAR_CLIPPED_USED | Flag.HOT


@dataclass(frozen=True, slots=True)
class Step:
    """Light of a pose now over what it was, by channel.

    Attributes
    ----------
    channels : tuple of str
    ratio, u_ratio : tuple of float
        Ratio of the means over the sample and its standard uncertainty, of noise only.
    """

    channels: tuple[str, ...]
    ratio: tuple[float, ...]
    u_ratio: tuple[float, ...]

    def by_lamp(self, lamp_ratio: float, u_lamp: float) -> Step:
        """Take out what the lamp's photodiode saw, to its relative standard uncertainty."""
        ratios = tuple(ratio / lamp_ratio for ratio in self.ratio)
        rows = zip(ratios, self.u_ratio, strict=True)
        return Step(self.channels, ratios, tuple(math.hypot(u / lamp_ratio, r * u_lamp) for r, u in rows))

    def beyond(self, tolerance: float) -> tuple[str, ...]:
        """Channels that have certainly changed by more than a share: |ratio - 1| - 2 u > tolerance."""
        rows = zip(self.channels, self.ratio, self.u_ratio, strict=True)
        return tuple(name for name, ratio, u in rows if abs(ratio - 1.0) - COVERAGE * u > tolerance)

    def told(self) -> str:
        """Write it for a person: `G 1.034 +- 0.001`."""
        rows = zip(self.channels, self.ratio, self.u_ratio, strict=True)
        told = ", ".join(f"{name} {ratio:.4f} +- {u:.4f}" for name, ratio, u in rows)
        return told or "nothing that can be compared"


@dataclass(frozen=True)
class FrameSet:
    """Frames of one place.

    Attributes
    ----------
    files : tuple of Path
    exposure_s : tuple of float
    """

    files: tuple[Path, ...]
    exposure_s: tuple[float, ...]


@dataclass(frozen=True)
class Comparison:
    """How frames of one place are compared.

    Attributes
    ----------
    rig : Rig
    angles_rad : tuple of float
        Where the arms stood.
    sensor : SensorModel, optional
    """

    rig: Rig
    angles_rad: tuple[float, ...]
    sensor: SensorModel | None

    def ratio(self, before: FrameSet, now: FrameSet) -> Step:
        """Compare two sets of frames with the same exposures.

        The ratio is r = sum L_now / sum L_before over the pixels of a channel that see the sample and clip in
        neither set, with u(r)^2 = (sum v_now + r^2 sum v_before) / (sum L_before)^2 from the variances v of
        the merges. What both sets share, such as the darks and the sensor's inequality, cancels. Only
        channels that could be compared are told; none where every pixel clips or there is no light.
        """
        ratios = {}
        for name, ((light, noise), (light_now, noise_now)) in self._sums(before, now).items():
            if light > 0.0:
                ratio = light_now / light
                ratios[name] = (ratio, math.sqrt(noise_now + ratio**2 * noise) / light)
        return _step(ratios)

    def offset(self, before: FrameSet, now: FrameSet, light: FrameSet, lamp_ratio: float = 1.0) -> Step:
        """Compare two sets of frames that should be dark, by the light that they are taken off.

        The ratio is 1 + (sum L_now / lamp_ratio - sum L_before) / sum L_light: the error that their
        difference makes of the light's.
        """
        ratios = {}
        for name, sums in self._sums(before, now, light).items():
            (dark, noise), (dark_now, noise_now), (bright, _) = sums
            if bright > 0.0:
                change = (dark_now / lamp_ratio - dark) / bright
                ratios[name] = (1.0 + change, math.sqrt(noise_now / lamp_ratio**2 + noise) / bright)
        return _step(ratios)

    def _sums(self, *sets: FrameSet) -> dict[str, list[tuple[float, float]]]:
        """Light and its variance by channel and set, over the pixels that clip in none."""
        small = [[thinned(read_raw(path)) for path in one.files] for one in sets]
        frame, rows, cols = small[0][0]
        seen = pixel_geometry(self.rig, self.angles_rad, rows=rows, cols=cols).on_sample
        merged = [
            merge([thin[0] for thin in frames], one.exposure_s, sensor=self.sensor)
            for frames, one in zip(small, sets, strict=True)
        ]
        for each in merged:
            seen = seen & ((each.flags & np.uint8(_SATURATED)) == 0)
        height, width = frame.counts.shape
        channel = frame.cfa[np.arange(height)[:, None] % 2, np.arange(width)[None, :] % 2]
        sums = {}
        for index, name in enumerate(frame.channels):
            pixels: NDArray[np.bool_] = seen & (channel == index)
            sums[name] = [
                (
                    float(np.sum(each.radiance[pixels], dtype=float)),
                    float(np.sum(each.variance[pixels], dtype=float)),
                )
                for each in merged
            ]
        return sums


def _step(ratios: dict[str, tuple[float, float]]) -> Step:
    return Step(tuple(ratios), tuple(r for r, _ in ratios.values()), tuple(u for _, u in ratios.values()))
