"""A fit as its solver knows it: what intervals, replicas and comparisons start from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from analysis.layout import Layout
    from analysis.losses import Loss
    from analysis.problem import Problem
    from analysis.solver import Solution

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Block:
    """Channels that share their shapes, and their fit.

    Attributes
    ----------
    channels : tuple of int
        Which of the fit's channels these B are.
    problem : Problem
        Directions and model.
    loss : Loss
        Data and weights, arrays (N, B).
    solution : Solution
        The minimum.
    scatter : ndarray, shape (N, B), or None
        Standard deviation of each residual, where gross errors were told from the others.
    """

    channels: tuple[int, ...]
    problem: Problem
    loss: Loss
    solution: Solution
    scatter: Array | None = None

    def natural(self) -> dict[str, Array]:
        """Return the parameters by name: shapes (), scales (B,)."""
        values = {"kd": self.solution.kd}
        if self.problem.has_lobe:
            values["ks"] = self.solution.ks
        shapes = self.problem.natural(self.solution.shapes[None])
        return values | {name: np.asarray(value[0]) for name, value in shapes.items()}

    def residual_scatter(self) -> Array | float:
        """Return the standard deviation of the residuals: of each, or of all."""
        if self.scatter is not None:
            return self.scatter
        scales = 2 if self.problem.has_lobe else 1
        parameters = len(self.solution.shapes) + scales * len(self.channels)
        free = max(int(self.loss.used.sum()) - parameters, 1)
        return float(np.sqrt(2.0 * self.solution.cost / free))


@dataclass(frozen=True, eq=False)
class State:
    """All channels' fits.

    Attributes
    ----------
    blocks : tuple of Block
        One where the channels share their shapes, else one for each channel.
    layout : Layout
        Rows of the covariance.
    loss : Loss
        Data and weights of all channels, arrays (N, C).
    rise : ndarray, shape (P,)
        Root of twice what the cost rises when a parameter moves by its standard uncertainty and the others
        make the best of it; NaN where the samples do not determine it.
    freedom : ndarray, shape (P,)
        Degrees of freedom of the standard uncertainties; infinite where the samples state theirs.
    """

    blocks: tuple[Block, ...]
    layout: Layout
    loss: Loss
    rise: Array
    freedom: Array

    @property
    def problem(self) -> Problem:
        """The problem of the first block; its directions are those of all."""
        return self.blocks[0].problem

    @property
    def solution(self) -> Solution:
        """The minimum of the first block: of all channels where they share their shapes."""
        return self.blocks[0].solution

    @property
    def cost(self) -> float:
        """Half the sum of squared residuals over all channels."""
        return float(sum(block.solution.cost for block in self.blocks))
