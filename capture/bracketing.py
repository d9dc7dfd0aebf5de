"""Brackets that see a whole range of radiance well enough, in the fewest frames or the least time.

A radiance x (in DN/s) seen by frames of exposures t that it does not clip has, merged with the weights of
maximum likelihood,

    SNR^2(x) = sum over t with x t <= limit of (x t)^2 / (K x t + floor)

It grows with x between the radiances limit / t, where one frame after the other drops out. So only those
have to be looked at. The limit is where the merge begins to lower a sample's weight.

The fewest frames come from a greedy choice, which is exact: some frame must see the brightest radiance that
is seen badly, and of all that do, the longest one helps every darker radiance most. The least time is an
integer program, because the conditions are linear in the number of frames of each exposure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from capture.clip import RAMP_START

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.exposure import Noise, Shutter

_TINY = 1e-9
_HALVINGS = 60
MOST_FRAMES = 16


class Objective(StrEnum):
    """What a bracket spares."""

    FRAMES = "frames"
    TIME = "time"


@dataclass(frozen=True)
class Scene:
    """What has to be seen, and how well.

    Attributes
    ----------
    low_dn_per_s, high_dn_per_s : float
        Radiances of the dimmest and the brightest part; 0 < low <= high.
    snr : float
        Signal-to-noise ratio wanted of every radiance between.
    """

    low_dn_per_s: float
    high_dn_per_s: float
    snr: float


@dataclass(frozen=True)
class Camera:
    """What takes the frames.

    Attributes
    ----------
    shutter : Shutter
        The exposures that it has.
    noise : Noise
    range_dn : float
        Clip level above black.
    overhead_s : float
        What every frame takes besides its exposure.
    """

    shutter: Shutter
    noise: Noise
    range_dn: float
    overhead_s: float = 0.3

    @property
    def limit_dn(self) -> float:
        """Signal up to which a sample has its full weight in the merge."""
        return RAMP_START * self.range_dn

    def snr(self, radiance_dn_per_s: float, exposures_s: Sequence[float]) -> float:
        """Signal-to-noise ratio of a radiance in a merge of these exposures; 0 where all clip."""
        return math.sqrt(self._information(radiance_dn_per_s, exposures_s))

    def seconds(self, exposures_s: Sequence[float]) -> float:
        """Time that a bracket takes."""
        return sum(exposures_s) + len(exposures_s) * self.overhead_s

    def _information(self, radiance: float, exposures_s: Sequence[float]) -> float:
        limit = self.limit_dn * (1.0 + _TINY)
        return sum(self._of_signal(radiance * time) for time in exposures_s if radiance * time <= limit)

    def _of_signal(self, signal_dn: float) -> float:
        return self.noise.snr(signal_dn) ** 2

    def brightest_gap(self, scene: Scene, exposures_s: Sequence[float]) -> float | None:
        """Brightest radiance that is seen worse than wanted; None where all are seen well.

        Parameters
        ----------
        scene : Scene
        exposures_s : sequence of float

        Returns
        -------
        float or None
            In DN/s.
        """
        wanted = scene.snr**2 * (1.0 - _TINY)
        drops = {self.limit_dn / time for time in exposures_s}
        inside = sorted((x for x in drops if scene.low_dn_per_s < x < scene.high_dn_per_s), reverse=True)
        uppers = [scene.high_dn_per_s, *inside]
        lowers = [*inside, scene.low_dn_per_s]
        for upper, lower in zip(uppers, lowers, strict=True):
            seen = [time for time in exposures_s if upper * time <= self.limit_dn * (1.0 + _TINY)]
            if self._information(upper, seen) < wanted:
                return upper
            if self._information(lower, seen) < wanted:
                return self._crossing(lower, upper, seen, wanted)
        return None

    def _crossing(self, lower: float, upper: float, seen: Sequence[float], wanted: float) -> float:
        for _ in range(_HALVINGS):
            middle = math.sqrt(lower * upper)
            if self._information(middle, seen) < wanted:
                lower = middle
            else:
                upper = middle
        return upper

    def worst_snr(self, scene: Scene, exposures_s: Sequence[float]) -> float:
        """Smallest signal-to-noise ratio over a scene's range."""
        drops = (self.limit_dn / time * (1.0 + 2.0 * _TINY) for time in exposures_s)
        inside = [x for x in drops if scene.low_dn_per_s < x < scene.high_dn_per_s]
        return min(self.snr(x, exposures_s) for x in (scene.low_dn_per_s, *inside, scene.high_dn_per_s))


@dataclass(frozen=True)
class BracketPlan:
    """Exposures to take.

    Attributes
    ----------
    exposures_s : tuple of float
        Ascending, those taken already not among them.
    worst_snr : float
        Over the scene's range, with those taken already.
    seconds : float
        That they take.
    complete : bool
        Whether the whole range is seen as well as wanted.
    """

    exposures_s: tuple[float, ...]
    worst_snr: float
    seconds: float
    complete: bool


def plan_bracket(
    scene: Scene,
    camera: Camera,
    objective: Objective = Objective.FRAMES,
    *,
    taken_s: Sequence[float] = (),
    max_frames: int = MOST_FRAMES,
) -> BracketPlan:
    """Choose the exposures of a bracket.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    objective : Objective
        The fewest frames, or the least time.
    taken_s : sequence of float
        Exposures that have been taken already.
    max_frames : int
        Of those to choose. Where they do not suffice, or the shutter does not, the brighter part of the
        range is seen well and the plan says that it is not complete.

    Returns
    -------
    BracketPlan
    """
    chosen = _fewest(scene, camera, taken_s, max_frames)
    if objective is Objective.TIME:
        chosen = _quickest(scene, camera, taken_s, max_frames) or chosen
    everything = [*taken_s, *chosen]
    return BracketPlan(
        exposures_s=tuple(sorted(chosen)),
        worst_snr=camera.worst_snr(scene, everything) if everything else 0.0,
        seconds=camera.seconds(chosen),
        complete=camera.brightest_gap(scene, everything) is None,
    )


def _fewest(scene: Scene, camera: Camera, taken_s: Sequence[float], max_frames: int) -> list[float]:
    """Choose greedily; then make the last frame, which takes the most time, as short as the target allows."""
    chosen: list[float] = []
    while (gap := camera.brightest_gap(scene, [*taken_s, *chosen])) is not None and len(chosen) < max_frames:
        exposure_s = camera.shutter.at_most(camera.limit_dn / gap)
        if gap * exposure_s > camera.limit_dn * (1.0 + _TINY):
            break  # even the shortest exposure clips
        chosen.append(exposure_s)
    if chosen and camera.brightest_gap(scene, [*taken_s, *chosen]) is None:
        *others, _ = chosen
        shorter = (time for time in camera.shutter.times_s if time <= chosen[-1])
        chosen[-1] = next(t for t in shorter if camera.brightest_gap(scene, [*taken_s, *others, t]) is None)
    return chosen


def _quickest(scene: Scene, camera: Camera, taken_s: Sequence[float], max_frames: int) -> list[float] | None:
    """Least total time by an integer program; None where there is no solution.

    Unknown are how often each exposure is taken, and whether at all. A used exposure has to leave its drop,
    just above limit / t, to shorter ones that see it well.
    """
    import numpy as np
    from scipy.optimize import Bounds, LinearConstraint, milp

    low, high, limit = scene.low_dn_per_s, scene.high_dn_per_s, camera.limit_dn
    # An exposure that clips even the dimmest part helps nobody.
    times = np.array([time for time in camera.shutter.times_s if time * low <= limit * (1.0 + _TINY)])
    if not times.size:
        return None
    wanted = scene.snr**2
    number = len(times)

    def seen(radiance: float, exposures: np.ndarray, *, dropped: float = math.inf) -> np.ndarray:
        signal = radiance * exposures
        admitted = (signal <= limit * (1.0 + _TINY)) & (exposures < dropped * (1.0 - _TINY))
        variance = camera.noise.gain_dn_per_e * signal + camera.noise.floor_dn2
        return np.where(admitted, signal**2 / variance, 0.0)

    before = np.array(taken_s, dtype=np.float64)
    rows, least = [], []
    for radiance in (low, high):
        rows.append(np.concatenate([seen(radiance, times), np.zeros(number)]))
        least.append(wanted - float(seen(radiance, before).sum()))
    for time, index in [(time, None) for time in before] + [(t, i) for i, t in enumerate(times)]:
        drop = limit / float(time)
        if not low < drop < high:
            continue
        row = np.concatenate([seen(drop, times, dropped=time), np.zeros(number)])
        have = float(seen(drop, before, dropped=time).sum())
        if index is None:
            least.append(wanted - have)
        else:
            row[number + index] = -wanted
            least.append(-have)
        rows.append(row)
    eye = np.eye(number)
    constraints = [
        LinearConstraint(np.array(rows), np.array(least), np.inf),
        LinearConstraint(np.hstack([eye, -max_frames * eye]), -np.inf, 0.0),
        LinearConstraint(np.concatenate([np.ones(number), np.zeros(number)])[np.newaxis], 0.0, max_frames),
    ]
    cost = np.concatenate([times + camera.overhead_s, np.zeros(number)])
    upper = np.concatenate([np.full(number, max_frames), np.ones(number)])
    found = milp(cost, integrality=np.ones(2 * number), bounds=Bounds(0.0, upper), constraints=constraints)
    if found.x is None:
        return None
    counts = np.rint(found.x[:number]).astype(int)
    return [float(time) for time, count in zip(times, counts, strict=True) for _ in range(count)]
