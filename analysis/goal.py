"""From observations and a loss to fitted blocks of channels."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.losses import ROBUST, make_loss
from analysis.models.base import Geometry
from analysis.problem import Problem
from analysis.resolution import resolve
from analysis.robust import minimise_robustly
from analysis.solver import minimise
from analysis.state import Block

if TYPE_CHECKING:
    from analysis.instrument import Instrument
    from analysis.losses import Loss
    from analysis.models.base import Model
    from analysis.observations import Observations
    from analysis.solver import Solution

Array = NDArray[np.float64]


class Goal:
    """A loss of observations, and how channels are grouped.

    Parameters
    ----------
    loss : str or None
        One of `analysis.losses.LOSSES`, or robust; None for chi2 where uncertainties are stated, else log.
    data : Observations
        The data.
    shared : bool
        Whether all channels share their shapes.
    instrument : Instrument, optional
        Source and receiver over which the model is averaged, where that matters.
    """

    def __init__(
        self, loss: str | None, data: Observations, *, shared: bool, instrument: Instrument | None = None
    ) -> None:
        usual = "chi2" if data.stated else "log"
        self.data, self.shared = data, shared
        self.instrument = instrument
        self.robust = loss == ROBUST
        self.base = usual if loss is None or self.robust else loss
        self._geometry = Geometry(data.wi, data.wo)

    def blocks(
        self, model: type[Model], u: Array | None, before: tuple[Block, ...] | None = None
    ) -> tuple[Block, ...]:
        """Fit each group of channels; `before` are fits of nearly the same data."""
        every = tuple(range(self.data.f_r.shape[1]))
        groups = [every] if self.shared else [(c,) for c in every]
        found = []
        for i, group in enumerate(groups):
            loss = self._loss(group, u)
            if before is None:
                block = self._fitted(group, Problem(model, self._geometry, len(group)), loss, None)
            else:
                block = self._fitted(group, before[i].problem, loss, before[i].solution)
            found.append(self._resolved(block, loss))
        return tuple(found)

    def _resolved(self, block: Block, loss: Loss) -> Block:
        """Fit again with the instrument's discs, where they matter."""
        if self.instrument is None:
            return block
        scatter = 1.0 if self.data.stated and self.base == "chi2" else block.residual_scatter()
        problem, solution = resolve(block.problem, block.loss, block.solution, self.instrument, scatter)
        if problem is block.problem:
            return block
        return self._fitted(block.channels, problem, loss, solution)

    def labels(self, block: Block) -> tuple[int, str] | None:
        """Return number and name of the channel whose fit a block is; None where it is that of all."""
        return None if self.shared else (block.channels[0], self.data.channels[block.channels[0]])

    def _loss(self, channels: tuple[int, ...], u: Array | None, name: str | None = None) -> Loss:
        data, at = self.data, list(channels)
        own = None if u is None else u[:, at]
        return make_loss(name or self.base, data.f_r[:, at], data.used[:, at], data.cos_i, own)

    def _fitted(
        self, channels: tuple[int, ...], problem: Problem, loss: Loss, start: Solution | None
    ) -> Block:
        if self.robust:
            calm = loss if self.base == "log" else self._loss(channels, None, "log")
            found = minimise_robustly(problem, loss, calm, start)
            return Block(channels, problem, found.loss, found.solution, found.scatter)
        return Block(channels, problem, loss, minimise(problem, loss, start))

    def whole(self, blocks: tuple[Block, ...], u: Array | None) -> Loss:
        """Return the loss of all channels, with the weights that the blocks ended with."""
        goal = self._loss(tuple(range(self.data.f_r.shape[1])), u)
        if not self.robust:
            return goal
        roots = [block.loss.root for block in blocks if block.loss.root is not None]
        return replace(goal, name=ROBUST, root=np.hstack(roots))
