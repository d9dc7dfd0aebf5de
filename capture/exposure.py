"""Which exposure comes next, from what the sensor saw.

Pure, and fed from the journal alone: the statistics of verified frames of this pose, and of the pose before
it at the same station. So a resumed session takes the frames that the interrupted one would have taken.

A pose needs one frame when the prediction is right and the range of its brightness is small. A frame whose
brightest part clips asks for a shorter one, a dark one for a longer one. Where anything between the dim and
the brightest part is seen below the wanted signal-to-noise ratio, the bracket that mends it in the fewest
frames, or in the least time, is worked out (`capture.bracketing`), its shortest frame is taken, and the rest
is worked out anew from what that shows. The variance of a count y above black is K y plus a floor (see
`capture.sensor`).
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from capture.bracketing import Camera, Objective, Scene, plan_bracket
from capture.clip import RAMP_START
from capture.records import NO_FLAG, PoseFlag

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.sensor import SensorModel
    from capture.statistics import FrameStatistics
    from rig.description import Rig

CLIPPED_TOLERATED = 0.002
"""Part of the pixels that may clip: hot ones do at long exposures, whatever the light."""

ENOUGH = 0.35
"""Brightest part over the range from which a frame is bright enough."""

ENOUGH_BESIDE_LONGER = 0.1
"""The same beside a longer frame that shows the rest: only the clipped part depends on this one."""

WANTED = 0.6
"""Brightest part over the range that a prediction aims at: 2/3 of a stop to either side are fine."""

MOSTLY_CLIPPED = 0.5
"""Part of the pixels from which a clipped frame shows next to nothing."""

SHORTENING = ((MOSTLY_CLIPPED, 16.0), (0.05, 8.0), (0.0, 4.0))
"""How many times shorter the next frame is, by the part of the pixels that clip."""

LARGEST_STEP = 64.0
"""No frame is more than this many times longer than what it was concluded from."""


@dataclass(frozen=True)
class Shutter:
    """The exposure times that a camera takes.

    Attributes
    ----------
    shortest_s, longest_s : float
    steps_per_stop : int
        Times per factor of two.
    """

    shortest_s: float
    longest_s: float
    steps_per_stop: int = 3

    @classmethod
    def of(cls, rig: Rig) -> Shutter:
        """Shutter of a machine's camera."""
        camera = rig.camera
        return cls(camera.shortest_exposure_s, camera.longest_exposure_s, camera.exposure_steps_per_stop)

    @cached_property
    def times_s(self) -> tuple[float, ...]:
        """All times, shortest first, four digits each: what the controller is told is what is recorded."""
        steps = math.floor(math.log2(self.longest_s / self.shortest_s) * self.steps_per_stop + 1e-9)
        times = (self.shortest_s * 2.0 ** (step / self.steps_per_stop) for step in range(steps + 1))
        return tuple(sorted({float(f"{time_s:.4g}") for time_s in times}))

    def at_most(self, wanted_s: float) -> float:
        """Longest time not above the wanted one; the shortest of all where there is none."""
        place = bisect.bisect_right(self.times_s, wanted_s * (1.0 + 1e-6))
        return self.times_s[max(place - 1, 0)]

    def below(self, limit_s: float) -> float:
        """Longest time below a limit; the shortest of all where there is none."""
        return self.times_s[max(bisect.bisect_left(self.times_s, limit_s * (1.0 - 1e-6)) - 1, 0)]


@dataclass(frozen=True, slots=True)
class Noise:
    """Variance of a count y above black: gain_dn_per_e * y + floor_dn2.

    The defaults stand for a camera that nobody has calibrated: an electron a count, few of read noise.
    """

    gain_dn_per_e: float = 1.0
    floor_dn2: float = 16.0

    @classmethod
    def of(cls, sensor: SensorModel | None) -> Noise:
        """Noise of a calibrated sensor, or the defaults."""
        return cls() if sensor is None else cls(sensor.gain_dn_per_e, sensor.floor_variance_dn2)

    def snr(self, signal_dn: float) -> float:
        """Signal-to-noise ratio of a count above black; 0 where there is no signal."""
        if signal_dn <= 0.0:
            return 0.0
        return signal_dn / math.sqrt(self.gain_dn_per_e * signal_dn + self.floor_dn2)

    def signal_dn(self, snr: float) -> float:
        """Count above black that has a signal-to-noise ratio: the root of y^2 = snr^2 (K y + floor)."""
        half = 0.5 * snr**2 * self.gain_dn_per_e
        return half + math.sqrt(half**2 + snr**2 * self.floor_dn2)


@dataclass(frozen=True, slots=True)
class Target:
    """What a plan asks of exposures.

    Attributes
    ----------
    snr : float
        Signal-to-noise ratio from the dim to the brightest part.
    first_s : float
        First exposure of a pass.
    max_frames : int
        For one pose.
    objective : Objective
        What is spared: frames, or time.
    """

    snr: float
    first_s: float
    max_frames: int
    objective: Objective = Objective.FRAMES


@dataclass(frozen=True, slots=True)
class Observation:
    """One verified frame: its exposure, and what it showed."""

    exposure_s: float
    statistics: FrameStatistics

    @property
    def clipped(self) -> bool:
        """Whether more clips than hot pixels."""
        return self.statistics.clipped_fraction > CLIPPED_TOLERATED


@dataclass(frozen=True, slots=True)
class Chooser:
    """Chooses exposures for one camera and one plan.

    Attributes
    ----------
    shutter : Shutter
    target : Target
    noise : Noise
    """

    shutter: Shutter
    target: Target
    noise: Noise = Noise()

    def next_exposure(
        self, history: Sequence[Observation], previous: Sequence[Observation] = ()
    ) -> float | None:
        """Decide on the next frame of a pose.

        Parameters
        ----------
        history : sequence of Observation
            The frames of this pose so far, in their order.
        previous : sequence of Observation
            The frames of the pose before, at the same station; empty for the first.

        Returns
        -------
        float or None
            Exposure in seconds, one of the shutter's times; None when the pose has what it needs, or nothing
            more can be had.
        """
        if not history:
            return self.shutter.at_most(self._predicted_s(previous))
        if len(history) >= self.target.max_frames:
            return None
        wanted_s = self._wanted_s(history)
        if wanted_s is None or wanted_s in {seen.exposure_s for seen in history}:
            return None
        return wanted_s

    def flags(self, history: Sequence[Observation]) -> PoseFlag:
        """Tell what the frames of a finished pose could not reach."""
        clear = _longest_clear(history)
        if clear is None:
            return PoseFlag.OVER_RANGE
        flags = NO_FLAG
        if clear.statistics.brightness < self._enough(history, clear):
            flags |= PoseFlag.UNDER_RANGE
        low = clear.statistics.dim_dn / clear.exposure_s
        reached = math.hypot(*(self.noise.snr(low * seen.exposure_s) for seen in history))
        # Noise moves the percentile.
        if reached < self.target.snr * 0.8:
            flags |= PoseFlag.NOISY
        return flags

    def _predicted_s(self, previous: Sequence[Observation]) -> float:
        if not previous:
            return self.target.first_s
        clear = _longest_clear(previous)
        if clear is None:
            shortest = min(previous, key=lambda seen: seen.exposure_s)
            return shortest.exposure_s / _shortening(shortest)
        return self._lengthened_s(clear)

    def _wanted_s(self, history: Sequence[Observation]) -> float | None:
        clear = _longest_clear(history)
        if clear is None:
            shortest = min(history, key=lambda seen: seen.exposure_s)
            return self.shutter.at_most(shortest.exposure_s / _shortening(shortest))
        if clear.statistics.brightness < self._enough(history, clear):
            clipped_s = min((seen.exposure_s for seen in history if seen.clipped), default=math.inf)
            limit_s = self.shutter.below(clipped_s) if math.isfinite(clipped_s) else math.inf
            longer_s = self.shutter.at_most(min(self._lengthened_s(clear), limit_s))
            if longer_s > clear.exposure_s:
                return longer_s
        return self._for_dim_part_s(history, clear)

    def _for_dim_part_s(self, history: Sequence[Observation], clear: Observation) -> float | None:
        """Shortest frame that is still to be taken, where the range is not seen well enough."""
        statistics = clear.statistics
        range_dn = min(channel.range_dn for channel in statistics.channels)
        high = min(statistics.brightness, RAMP_START) * range_dn / clear.exposure_s
        unclipped = (each for each in history if each.statistics.dim_dn < RAMP_START * range_dn)
        seen = max(unclipped, key=lambda each: each.exposure_s, default=clear)
        low = max(seen.statistics.dim_dn, 1.0) / seen.exposure_s
        if high <= 0.0:
            return None
        plan = plan_bracket(
            Scene(min(low, high), high, self.target.snr),
            Camera(self.shutter, self.noise, range_dn),
            self.target.objective,
            taken_s=[each.exposure_s for each in history],
            max_frames=self.target.max_frames - len(history),
        )
        if not plan.exposures_s:
            return None
        longest_s = max(each.exposure_s for each in history)
        return self.shutter.at_most(min(plan.exposures_s[0], LARGEST_STEP * longest_s))

    def _enough(self, history: Sequence[Observation], clear: Observation) -> float:
        longer = any(
            seen.exposure_s > clear.exposure_s and seen.statistics.clipped_fraction < MOSTLY_CLIPPED
            for seen in history
        )
        return ENOUGH_BESIDE_LONGER if longer else ENOUGH

    def _lengthened_s(self, clear: Observation) -> float:
        """Exposure that brings the brightest part to where it is wanted."""
        return clear.exposure_s * min(WANTED / max(clear.statistics.brightness, 1e-9), LARGEST_STEP)


def _longest_clear(history: Sequence[Observation]) -> Observation | None:
    clear = [seen for seen in history if not seen.clipped]
    return max(clear, key=lambda seen: seen.exposure_s, default=None)


def _shortening(seen: Observation) -> float:
    fraction = seen.statistics.clipped_fraction
    return next(factor for least, factor in SHORTENING if fraction >= least)
