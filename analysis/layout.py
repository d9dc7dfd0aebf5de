"""Which row of a fit's covariance is which parameter, whether channels share the shapes or not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from analysis.problem import Problem

    Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Layout:
    """The parameters of a fit of several channels, in order: shapes, kd by channel, ks by channel.

    Attributes
    ----------
    shapes, scales : tuple of str
        Names.
    channels : int
        Number C of channels.
    shared : bool
        Whether one value of each shape holds for all channels; else each has C rows.
    """

    shapes: tuple[str, ...]
    scales: tuple[str, ...]
    channels: int
    shared: bool

    @cached_property
    def names(self) -> tuple[tuple[str, int | None], ...]:
        """Parameter, and channel or None where all share it, of each of P rows."""
        each = range(self.channels)
        shapes: list[tuple[str, int | None]] = (
            [(name, None) for name in self.shapes]
            if self.shared
            else [(name, c) for name in self.shapes for c in each]
        )
        return (*shapes, *((name, c) for name in self.scales for c in each))

    def row(self, name: str, channel: int) -> int:
        """Row of the parameter that a channel's f depends on."""
        at = (name, None) if self.shared and name in self.shapes else (name, channel)
        return self.names.index(at)

    def rows_of(self, channels: Sequence[int]) -> Rows:
        """Rows of the parameters of some channels that share their shapes, in the order of a layout of these.

        Parameters
        ----------
        channels : sequence of int
            All, where shapes are shared; else one.

        Returns
        -------
        ndarray of int
        """
        shapes = [self.row(name, channels[0]) for name in self.shapes]
        scales = [self.row(name, c) for name in self.scales for c in channels]
        return np.array([*shapes, *scales], dtype=np.intp)


def layout_of(problem: Problem, channels: int, *, shared: bool) -> Layout:
    """Lay out the parameters of a problem's model for a number of channels."""
    scales = ("kd", "ks") if problem.has_lobe else ("kd",)
    return Layout(tuple(p.name for p in problem.shapes), scales, channels, shared)
