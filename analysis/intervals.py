"""Profile-likelihood intervals: how far a parameter can go while all others make the best of it.

Where a loss is curved the interval of value plus or minus two standard uncertainties is not one of 95 %. The
profile is: with one parameter held, the others are fitted anew, and the interval ends where the cost has
risen by what the level allows (Venzon & Moolgavkar 1988), on Student's t where residuals had to tell the
uncertainty. Errors that samples share, and residuals that are
not of one size, enter through the ratio of the fit's standard uncertainty to that of plain least squares
(Kent 1982): the cost may rise by its square times as much.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.descent import descend
from analysis.equations import Linearised

if TYPE_CHECKING:
    from analysis.fit import FitResult
    from analysis.state import Block

Array = NDArray[np.float64]

LEVEL = 0.95
ROUNDS = 6
"""Trials of each end: the profile is nearly a parabola, and each trial is a secant's step."""
CLOSE = 1e-3
"""Distance of an end from its level, in standard uncertainties, at which it is found."""
TOLERANCE, MOST_STEPS = 1e-9, 100
MOST_FREEDOM = 1e9
WIDEST = 20.0
"""An end further off than this, in standard uncertainties, is not there."""


def profile_intervals(result: FitResult, level: float = LEVEL, *, scales: bool = True) -> dict[str, Array]:
    """Find an interval for each parameter of a fit.

    Parameters
    ----------
    result : FitResult
        Of `analysis.fit.fit`.
    level : float
        Probability that the interval holds the truth, if the model does.
    scales : bool
        Whether kd and ks have theirs too: with dozens of channels they take minutes.

    Returns
    -------
    dict of str to ndarray, shape (2,) or (C, 2)
        Low and high end by parameter. An end that is a bound is given as the bound; the interval of a
        parameter that the samples do not determine goes from bound to bound.
    """
    from scipy.special import stdtrit

    # An infinite number of degrees of freedom is not taken by all releases.
    freedom = np.minimum(result.state.freedom, MOST_FREEDOM)
    quantile = np.asarray(stdtrit(freedom, 0.5 + 0.5 * level))
    ends = np.empty((len(result.names), 2))
    for block in result.state.blocks:
        own = result.state.layout.rows_of(block.channels)
        ends[own] = _Profile(result, block).intervals(quantile[own], scales=scales)
    found = {}
    for name in result.parameters:
        rows = [i for i, (other, _) in enumerate(result.names) if other == name]
        found[name] = ends[rows].reshape(*np.shape(result.parameters[name]), 2)
    return {name: each for name, each in found.items() if scales or name not in {"kd", "ks"}}


class _Profile:
    """Channels that share their shapes, with coordinates (the shapes', kd and ks) that can each be held."""

    def __init__(self, result: FitResult, block: Block) -> None:
        self._problem, best = block.problem, block.solution
        loss = block.loss.by_channel()
        size = Linearised(block.problem, loss).size(block.problem.terms(best.shapes[None]).lobe)[0]
        self._equations = Linearised(block.problem, loss, fixed_size=size)
        low, high = block.problem.bounds()
        scales = 2 * block.problem.channels
        self._low = np.concatenate([low, np.zeros(scales)])
        self._high = np.concatenate([high, np.full(scales, np.inf)])
        self._best = np.concatenate([best.shapes, best.kd, size * best.ks])
        # Coordinates per natural unit.
        values = block.natural()
        steps = [1.0 / p.coordinate.slope(float(values[p.name])) for p in block.problem.shapes]
        units = np.concatenate([steps, np.ones(block.problem.channels), size])
        rows = result.state.layout.rows_of(block.channels)
        self._count, u = len(rows), np.sqrt(np.diag(result.covariance))
        self._u = np.full(len(self._best), np.inf)
        self._u[: len(rows)] = u[rows]
        self._u *= units
        self._per_unit = np.full(len(self._best), np.nan)
        self._per_unit[: len(rows)] = result.state.rise[rows]

    def intervals(self, quantile: Array, *, scales: bool) -> Array:
        """Both ends of all coordinates, or of the shapes alone, as natural values (shapes, kd, ks; 2)."""
        known = np.isfinite(self._u) & (self._u > 0.0) & np.isfinite(self._per_unit)
        if not scales:
            known[len(self._problem.shapes) :] = False
        held = np.flatnonzero(known)
        ends = np.stack([self._low, self._high], axis=1)
        for side, sign in ((0, -1.0), (1, 1.0)) if held.size else ():
            ends[held, side] = self._ends(held, sign, quantile[held])
        return self._natural(ends)[: self._count]

    def _ends(self, held: NDArray[np.intp], sign: float, quantile: Array) -> Array:
        """Find where the root of the rise of the cost is the quantile, by secants from the centre."""
        x = np.tile(self._best, (len(held), 1))
        rows = np.arange(len(held))
        centre, u, unit = self._best[held], self._u[held], self._per_unit[held]
        limit = (self._low if sign < 0.0 else self._high)[held]
        away = quantile.copy()
        inner, inner_root = np.zeros(len(held)), np.zeros(len(held))
        base = self._cost(x[:1])[0]
        for _ in range(ROUNDS):
            target = np.clip(centre + sign * away * u, self._low[held], self._high[held])
            x[rows, held] = target
            low, high = np.tile(self._low, (len(held), 1)), np.tile(self._high, (len(held), 1))
            low[rows, held] = high[rows, held] = target
            found = descend(
                self._equations.all_parameters, x, (low, high), tolerance=TOLERANCE, most=MOST_STEPS
            )
            x = found.x
            root = np.sqrt(2.0 * np.maximum(found.cost - base, 0.0)) / unit
            done = (np.abs(root - quantile) < CLOSE) | ((target == limit) & (root < quantile))
            if done.all():
                break
            reached = np.abs(target - centre) / u
            slope = (root - inner_root) / np.where(reached != inner, reached - inner, 1.0)
            step = (quantile - root) / np.where(slope > 0.0, slope, 1.0)
            inner, inner_root = np.where(done, inner, reached), np.where(done, inner_root, root)
            away = np.where(done, away, np.clip(reached + step, 0.05 * quantile, WIDEST))
        end = centre + sign * away * u
        end = np.where(away >= WIDEST, limit, end)
        return np.clip(end, self._low[held], self._high[held])

    def _cost(self, x: Array) -> Array:
        return self._equations.all_parameters(x, np.arange(len(x))).cost

    def _natural(self, ends: Array) -> Array:
        """Turn ends in coordinates (P, 2) into natural values."""
        shapes, channels = len(self._problem.shapes), self._problem.channels
        values = ends.copy()
        for i, each in enumerate(self._problem.natural(ends[:shapes].T).values()):
            values[i] = each
        size = self._equations.size(np.zeros((1, 1)))[0]
        values[shapes + channels :] /= size[:, None]
        return values
