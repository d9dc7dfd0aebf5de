"""The uncertainty budget: every error as a column of sensitivities with a correlation class.

A component says how far each sample's f_r moves for one standard uncertainty of one input, and which samples
share that error (JCGM 100:2008, 5.2). From these follow the uncertainty of one sample, of any linear
combination of samples, and their covariance; a component that hardly shows in one sample may dominate a
mean, because it does not average out.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from analysis.uncertainty import INDEPENDENT, has_uncertainty, shared_by_pose, shared_in_f

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from numpy.typing import NDArray

    from analysis.instrument import Seen
    from analysis.models.base import Model
    from analysis.uncertainty import SharedError

    Array = NDArray[np.float64]


class Correlation(StrEnum):
    """Who shares an error."""

    RANDOM = "random"
    """Nobody: each sample and channel has its own."""

    FRAME = "per frame"
    """Samples of the same frames, such as those divided by the same pixels of the white."""

    SESSION = "per session"
    """Samples of one session that hold a joint at the same step, or have one stray light in common."""

    CALIBRATION = "per calibration"
    """Samples of all sessions under one calibration: all of them, or all of one place on the white."""


NAMES = {
    "u_noise": "noise of the sample",
    "u_binning": "size of the bins",
    "u_f_r": "as stated",
    "white": "noise of the white",
    "reference": "reflectance of the white",
    "lamp": "drift of the lamp",
    "linearity": "linearity of the sensor",
    "stray": "stray light",
    "flat": "flat field",
    "distortion": "lens distortion",
    "drift": "drift that references found",
}
_CLASSES = {
    "white": Correlation.FRAME,
    "reference": Correlation.CALIBRATION,
    "lamp": Correlation.FRAME,
    "linearity": Correlation.CALIBRATION,
    "stray": Correlation.SESSION,
    "flat": Correlation.CALIBRATION,
    "distortion": Correlation.CALIBRATION,
    "drift": Correlation.SESSION,
}


@dataclass(frozen=True, eq=False)
class Component:
    """One error.

    Attributes
    ----------
    name : str
    correlation : Correlation
    column : ndarray, shape (N, C)
        Change of f_r for one standard uncertainty, 1/sr, with its sign; 0 where there is no value.
    group : ndarray of int, shape (N,)
        Samples with the same number share the error; for random ones without meaning.
    across_channels : bool
        Whether the channels of a group share it too.
    """

    name: str
    correlation: Correlation
    column: Array
    group: NDArray[np.intp]
    across_channels: bool

    def variance_of(self, weights: Array) -> float:
        """Variance of sum(weights * f_r).

        Parameters
        ----------
        weights : ndarray, shape (N, C)

        Returns
        -------
        float
            In the unit of f_r squared.
        """
        moved = weights * self.column
        if self.correlation is Correlation.RANDOM:
            return float(np.sum(moved**2))
        if self.across_channels:
            moved = moved.sum(axis=1, keepdims=True)
        sums = np.zeros((int(self.group.max(initial=0)) + 1, moved.shape[1]))
        np.add.at(sums, self.group, moved)
        return float(np.sum(sums**2))

    def draw(self, rng: np.random.Generator) -> Array:
        """Draw one error of every sample from normal distributions, shape (N, C)."""
        count, channels = self.column.shape
        if self.correlation is Correlation.RANDOM:
            return np.asarray(self.column * rng.standard_normal((count, channels)))
        groups = int(self.group.max(initial=0)) + 1
        size = rng.standard_normal((groups, 1 if self.across_channels else channels))
        return np.asarray(self.column * size[self.group])


def components(samples: xr.Dataset, model: Model | Seen | None = None) -> list[Component]:
    """List the components of samples.

    Parameters
    ----------
    samples : xarray.Dataset
    model : Model, optional
        With its gradient along the directions the joints' angles become components; without, they are not
        among them.

    Returns
    -------
    list of Component
        Empty where the samples state no uncertainty.
    """
    if not has_uncertainty(samples):
        return []
    count = samples.sizes["sample"]
    everyone = np.zeros(count, dtype=np.intp)
    own = [name for name in INDEPENDENT if name in samples] or ["u_f_r"]
    found = [
        Component(NAMES[name], Correlation.RANDOM, _column(samples[name].to_numpy()), everyone, False)
        for name in own
    ]
    found += [_shared(error, _CLASSES[error.name]) for error in shared_in_f(samples)]
    if model is not None:
        found += [_shared(error, Correlation.SESSION) for error in shared_by_pose(samples, model)]
    return found


def _shared(error: SharedError, correlation: Correlation) -> Component:
    name = NAMES.get(error.name, f"angle of {error.name}")
    return Component(name, correlation, _column(error.column), error.group, error.across_channels)


def _column(values: Array) -> Array:
    return np.where(np.isfinite(values), values, 0.0)


def u_of_samples(parts: Sequence[Component]) -> Array:
    """Combine the standard uncertainties of each sample, shape (N, C), 1/sr."""
    return np.asarray(np.sqrt(np.sum([part.column**2 for part in parts], axis=0)))


def u_of_combination(parts: Sequence[Component], weights: Array) -> float:
    """Combine the standard uncertainty of sum(weights * f_r), in 1/sr.

    Parameters
    ----------
    parts : sequence of Component
    weights : ndarray, shape (N, C)
    """
    return float(np.sqrt(sum(part.variance_of(weights) for part in parts)))


@dataclass(frozen=True)
class BudgetLine:
    """One component in the budget.

    Attributes
    ----------
    name : str
    correlation : Correlation
    of_sample : float
        Median over the samples of its relative standard uncertainty.
    share_of_sample : float
        Median over the samples of its part of the variance.
    of_session : float
        Its relative standard uncertainty of the mean of all samples.
    share_of_session : float
        Its part of that mean's variance.
    """

    name: str
    correlation: Correlation
    of_sample: float
    share_of_sample: float
    of_session: float
    share_of_session: float


def budget(samples: xr.Dataset, model: Model | Seen | None = None) -> list[BudgetLine]:
    """Make the budget of one sample and of the session.

    Parameters
    ----------
    samples : xarray.Dataset
    model : Model, optional
        As for `components`.

    Returns
    -------
    list of BudgetLine
        Largest part of the session's variance first; empty where nothing is stated or no sample has a value.
    """
    parts = components(samples, model)
    f_r = samples["f_r"].to_numpy()
    flags = samples["flags"].to_numpy() if "flags" in samples else np.zeros(f_r.shape, dtype=np.intp)
    used = np.isfinite(f_r) & (flags == 0) & (f_r > 0.0)
    if not parts or not used.any():
        return []
    total = u_of_samples(parts)
    used &= total > 0.0
    weights = used / max(np.count_nonzero(used), 1)
    mean = float(np.sum(weights * np.where(used, f_r, 0.0)))
    variance = sum(part.variance_of(weights) for part in parts)
    lines = []
    for part in parts:
        own = part.variance_of(weights)
        lines.append(
            BudgetLine(
                name=part.name,
                correlation=part.correlation,
                of_sample=float(np.median(np.abs(part.column[used]) / f_r[used])),
                share_of_sample=float(np.median((part.column[used] / total[used]) ** 2)),
                of_session=float(np.sqrt(own)) / mean,
                share_of_session=own / variance,
            )
        )
    return sorted(lines, key=lambda line: -line.share_of_session)
