"""Bootstrap of a fit: samples, or whole groups of them, drawn anew with replacement, all replicas at once.

It needs no formula for the covariance and no linear model, and shows what linear propagation cannot: skewed
and bounded distributions, and what a few samples decide. Drawn by groups (the samples of a pose, or of an
incidence) it holds where errors are shared within them (Davison & Hinkley 1997, section 2.4 and 3.8).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.descent import descend
from analysis.equations import Linearised
from rig.errors import BadInput

if TYPE_CHECKING:
    from analysis.fit import FitResult
    from analysis.state import Block

Array = NDArray[np.float64]

FEWEST_GROUPS = 8
TOLERANCE, MOST_STEPS = 1e-8, 60
TOGETHER = 60_000
"""Data of replicas that are fitted together: what fits a processor's cache."""


@dataclass(frozen=True, eq=False)
class Replicas:
    """Parameters of R replicas of a fit.

    Attributes
    ----------
    parameters : dict of str to ndarray
        By name, shape (R,) where channels share the parameter, else (R, C).
    """

    parameters: dict[str, Array]

    def u(self) -> dict[str, Array]:
        """Return the standard deviation of each parameter over the replicas."""
        return {name: np.std(values, axis=0, ddof=1) for name, values in self.parameters.items()}

    def interval(self, level: float = 0.95) -> dict[str, Array]:
        """Percentile interval of each parameter: shape (2,) or (C, 2)."""
        tails = [0.5 - 0.5 * level, 0.5 + 0.5 * level]
        return {
            name: np.moveaxis(np.quantile(values, tails, axis=0), 0, -1)
            for name, values in self.parameters.items()
        }


def bootstrap(
    result: FitResult, count: int = 1000, *, groups: ArrayLike | None = None, seed: int = 0
) -> Replicas:
    """Fit replicas of a fit's samples, each from the fit itself to convergence.

    Parameters
    ----------
    result : FitResult
        Of `analysis.fit.fit`.
    count : int
        Number R of replicas.
    groups : array_like of int, shape (N,), optional
        Samples with the same number are drawn together; by default each alone. N counts the samples that
        the fit used.
    seed : int
        Of the random draws.

    Returns
    -------
    Replicas

    Raises
    ------
    BadInput
        If the groups do not belong to the samples, or are too few to be drawn from.
    """
    state = result.state
    samples = len(state.problem.geometry.wi)
    numbers = _dense(groups, samples)
    random = np.random.default_rng(seed)
    kinds = int(numbers.max()) + 1
    at_once = max(1, TOGETHER // (samples * state.problem.channels))
    parts = []
    for first in range(0, count, at_once):
        replicas = min(at_once, count - first)
        drawn = random.multinomial(kinds, np.full(kinds, 1.0 / kinds), size=replicas)
        counts = drawn[:, numbers].astype(np.float64)
        part = np.empty((replicas, len(result.names)))
        for block in state.blocks:
            part[:, state.layout.rows_of(block.channels)] = _fitted(block, counts)
        parts.append(part)
    natural = np.concatenate(parts)
    names = [name for name, _ in result.names]
    return Replicas(
        {
            name: natural[:, [i for i, other in enumerate(names) if other == name]].reshape(
                count, *np.shape(result.parameters[name])
            )
            for name in result.parameters
        }
    )


def _dense(groups: ArrayLike | None, samples: int) -> NDArray[np.intp]:
    if groups is None:
        return np.arange(samples)
    given = np.asarray(groups)
    if given.shape != (samples,):
        raise BadInput(
            f"{given.shape} group numbers for {samples} samples",
            where="bootstrap",
            todo="give one number for each sample that the fit used",
        )
    numbers = np.unique(given, return_inverse=True)[1].astype(np.intp)
    if numbers.max() + 1 < FEWEST_GROUPS:
        raise BadInput(
            f"{int(numbers.max()) + 1} groups are too few to draw from",
            where="bootstrap",
            todo=f"use at least {FEWEST_GROUPS}",
        )
    return numbers


def _fitted(block: Block, counts: Array) -> Array:
    """Fit replicas with counts (R, N); natural parameters (R, shapes, kd by channel, ks by channel)."""
    problem, best = block.problem, block.solution
    loss = block.loss.by_channel()
    size = Linearised(problem, loss).size(problem.terms(best.shapes[None]).lobe)[0]
    equations = Linearised(problem, loss, counts=counts)
    low, high = problem.bounds()
    scales = 2 * problem.channels
    start = np.concatenate([best.shapes, best.kd, size * best.ks])
    x = descend(
        equations.all_parameters,
        np.tile(start, (len(counts), 1)),
        (np.concatenate([low, np.zeros(scales)]), np.concatenate([high, np.full(scales, np.inf)])),
        tolerance=TOLERANCE,
        most=MOST_STEPS,
    ).x
    shapes, kd, s = equations.unpack(x)
    columns = [*(value[:, None] for value in problem.natural(shapes).values()), kd]
    if problem.has_lobe:
        columns.append(s / equations.size(problem.terms(shapes).lobe))
    return np.hstack(columns)
