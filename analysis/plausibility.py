"""Samples whose numbers cannot be what their units say: refused before a fit makes parameters of them.

Each test rests on something that no surface does: vectors that point somewhere have length 1; a surface sends
back no ten times the light that it gets; noise larger than a value makes it negative now and then; and no
level steps by exactly a hundred, or exactly pi, from one part of the samples to the rest while each part is
even in itself.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis import uncertainty
from analysis.models.base import Geometry
from rig.errors import BadInput

if TYPE_CHECKING:
    from analysis.observations import Observations

Array = NDArray[np.float64]

UNIT = 1e-3
"""Deviation of a length from 1 that no rounding explains."""
OFF_TOP_RAD, NOT_GRAZING = np.radians(20.0), 0.5
"""Samples that far from the mirror direction, with both cosines above, lie beside the highlight."""
ENOUGH = 2000
"""Samples, evenly taken, that levels are looked for in."""
FEWEST = 10
"""Samples that a level is taken from."""
MOST_ALBEDO = 10.0
"""pi f_r beside the highlight beyond which f_r is in another unit: a white surface has 1."""
LARGE_NOISE = 2.0
"""Median uncertainty over value from which on the signs of the values are looked at."""
FEWEST_NEGATIVE = 20.0
"""Negative values that the uncertainties must predict before the absence of nearly all of them tells."""
SELDOM = 0.1
"""Share of the predicted negative values below which the uncertainties are not those of these values."""
STEPS = {"pi": np.pi, "100": 100.0, "1000": 1000.0, "(180/pi)^2": np.square(np.degrees(1.0))}
"""Factors between units that laboratories confuse: radiance factor, per cent, per mille, square degrees."""
OF_COLOUR = 10.0
"""Ratio of two channels up to which a tinted metal explains it."""
STEP_SLACK, EVEN = 0.02, 0.05
"""Deviation of a step's logarithm from such a factor's, and scatter of levels on either side of it."""


def require_plausible(data: Observations) -> None:
    """Refuse samples in units that they do not state.

    Parameters
    ----------
    data : Observations
        What a fit would use.

    Raises
    ------
    BadInput
        Saying what is wrong, by what evidence, and what would be needed.
    """
    _require_noise(data)
    every = slice(None, None, max(1, len(data.wi) // ENOUGH))
    few = replace(data, wi=data.wi[every], wo=data.wo[every], f_r=data.f_r[every], used=data.used[every])
    beside = _beside_the_highlight(few)
    _require_albedo(few, beside)
    _require_one_unit(few, beside)


def require_unit_vectors(wi: Array, wo: Array) -> None:
    """Refuse directions that are not unit vectors, where they are not missing altogether.

    Raises
    ------
    BadInput
        Naming the first.
    """
    for name, direction in (("wi", wi), ("wo", wo)):
        length = np.linalg.norm(direction, axis=-1)
        wrong = np.flatnonzero(np.isfinite(length) & (np.abs(length - 1.0) > UNIT))
        if wrong.size:
            raise BadInput(
                f"sample {wrong[0]} has length {length[wrong[0]]:.4g}, not 1",
                where=name,
                todo="give unit vectors from the surface, neither angles nor positions",
            )


def _beside_the_highlight(data: Observations) -> NDArray[np.bool_]:
    tilt = np.arctan(np.sqrt(Geometry(data.wi, data.wo).tan2_h[:, 0]))
    return np.asarray((tilt > OFF_TOP_RAD) & (np.minimum(data.wi[:, 2], data.wo[:, 2]) > NOT_GRAZING))


def _require_albedo(data: Observations, beside: NDArray[np.bool_]) -> None:
    for c, name in enumerate(data.channels):
        rows = beside & data.used[:, c]
        if np.count_nonzero(rows) < FEWEST:
            continue
        albedo = np.pi * float(np.median(data.f_r[rows, c]))
        if albedo > MOST_ALBEDO:
            raise BadInput(
                f"f_r beside the highlight is that of an albedo of {albedo:.3g}, and none exceeds 1",
                where=f"channel {name}",
                todo="give f_r in 1/sr, not in %/sr or in counts",
            )


def _require_noise(data: Observations) -> None:
    """Noise of standard deviation u makes a value f negative with probability Phi(-f/u)."""
    if not data.stated:
        return
    from scipy.special import ndtr

    own = uncertainty.independent(data.samples) + np.zeros_like(data.f_r)
    for c, name in enumerate(data.channels):
        rows = data.used[:, c] & (own[:, c] > 0.0)
        f, u = data.f_r[rows, c], own[rows, c]
        predicted = float(np.sum(ndtr(-np.abs(f) / u)))
        found = int(np.count_nonzero(f < 0.0))
        if np.median(u / np.maximum(np.abs(f), 1e-300)) > LARGE_NOISE and predicted >= FEWEST_NEGATIVE:
            if found >= SELDOM * predicted:
                continue
            raise BadInput(
                f"the uncertainties exceed the values, and {found} of {predicted:.0f} that this would make "
                "negative are",
                where=f"channel {name}",
                todo="give standard uncertainties in 1/sr, not in % or as k = 2 of another column",
            )


def _require_one_unit(data: Observations, beside: NDArray[np.bool_]) -> None:
    """Look for a step by such a factor between incidences of a channel, or between channels."""
    _, light = np.unique(np.round(data.wi, 4), axis=0, return_inverse=True)
    light = light.ravel()
    for c, name in enumerate(data.channels):
        rows = np.flatnonzero(beside & data.used[:, c] & (data.f_r[:, c] > 0.0))
        step = _step_between(_levels(light[rows], np.log(np.maximum(data.f_r[rows, c], 1e-300))))
        if step is not None:
            raise BadInput(
                f"f_r steps by a factor of {step} from some incidences to the others, and not within either",
                where=f"channel {name}",
                todo="give all samples in 1/sr",
            )
    both = np.all(data.used & (data.f_r > 0.0), axis=1)
    if np.count_nonzero(both) < FEWEST:
        return
    ratio = np.log(data.f_r[both]) - np.log(data.f_r[both][:, :1])
    for c, name in enumerate(data.channels):
        # Surfaces colour their body and not their highlight: a ratio that is the same everywhere is a unit.
        apart = abs(float(np.median(ratio[:, c])))
        step = _named_step(apart) if apart > np.log(OF_COLOUR) else None
        if step is not None and np.std(ratio[:, c]) < EVEN and _has_highlight(data, both):
            raise BadInput(
                f"f_r and that of channel {data.channels[0]} differ by a factor of {step} in every direction",
                where=f"channel {name}",
                todo="give all channels in 1/sr",
            )


def _levels(light: NDArray[np.intp], log_f: Array) -> Array:
    """Median of ln f by number of the light's direction, of those with enough samples."""
    counts = np.bincount(light)
    return np.array([np.median(log_f[light == each]) for each in np.flatnonzero(counts >= FEWEST)])


def _step_between(levels: Array) -> str | None:
    """Name the factor between two even groups of levels, at least two in each."""
    if len(levels) < 4:
        return None
    ordered = np.sort(levels)
    gap = int(np.argmax(np.diff(ordered))) + 1
    low, high = ordered[:gap], ordered[gap:]
    if min(len(low), len(high)) < 2 or max(np.std(low), np.std(high)) > EVEN:
        return None
    return _named_step(float(np.median(high) - np.median(low)))


def _named_step(log_step: float) -> str | None:
    return next((name for name, factor in STEPS.items() if abs(log_step - np.log(factor)) < STEP_SLACK), None)


def _has_highlight(data: Observations, rows: NDArray[np.bool_]) -> bool:
    """Whether values of the first channel spread as a highlight's do, which no body colour scales."""
    f = data.f_r[rows, 0]
    return bool(np.max(f) > 3.0 * np.median(f))
