"""Which nodes a pose needs: levels of the rules on lamp, pixel and pupil, raised where it makes a difference.

The dimension-adaptive search of Gerstner and Griebel (2003, "Dimension-adaptive tensor-product quadrature"),
over three parts. The radiance is a sum of surpluses, one for each product of levels: what that product adds
to all lower ones. Starting at the centres, the product whose surplus is largest is taken in, and those next
above it are looked at, until the surpluses that were looked at and not taken sum to less than the tolerance.
They are the error: what is left out is known, not guessed, but for what lies above it. A part that does not
matter is skipped because its first surplus says so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.light.sparse_rules import CENTRES, Levels

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]

CAUTION = 1.5
"""Times the surpluses that are left out: for those above them, and for pixels that were not looked at."""
NOISE = 3.0
"""Rounding of a surplus in units of one value's: it is a sum of up to eight."""
MOST_NODES = 20_000
"""Of one pixel, after which the search gives up and says how far it came."""


class Search:
    """The search of one pose, on some of its pixels.

    Parameters
    ----------
    parts : sequence of bool
        Whether lamp, pixel and pupil have a size.
    target : float
        RMS error of the pixels relative to their mean radiance at which it stops.
    rounding : float
        That of one product's radiance: surpluses below it are noise, which more nodes do not lower.
    """

    def __init__(self, parts: Sequence[bool], target: float, rounding: float) -> None:
        self._parts = tuple(parts)
        self._target = target
        self._noise = NOISE * rounding
        self._values: dict[Levels, Array] = {}
        self._sizes: dict[Levels, float] = {}
        self._mean = 0.0
        self._count = 1
        # Points have nothing to be searched.
        self.taken: frozenset[Levels] = frozenset() if any(parts) else frozenset({CENTRES})
        self.wanted: tuple[Levels, ...] = (CENTRES,) if any(parts) else ()

    @property
    def error(self) -> float:
        """Estimate of what the levels taken leave out."""
        left = sum(size for levels, size in self._sizes.items() if levels not in self.taken)
        return CAUTION * left

    @property
    def nodes(self) -> int:
        """Nodes of all products taken."""
        return sum(levels.nodes for levels in self.taken)

    def tell(self, values: dict[Levels, Array]) -> None:
        """Take the radiance of the levels that were wanted, and want others or none.

        Parameters
        ----------
        values : dict of Levels to ndarray
            Shape (n, 3): of the pixels that the search looks at, zero beside the sample.
        """
        self._values |= values
        self.wanted = ()
        if CENTRES in values:
            centre = values[CENTRES]
            self._count = max(1, int(np.count_nonzero(centre.any(axis=-1))) * centre.shape[-1])
            self._mean = float(np.sum(np.abs(centre))) / self._count
            self._take(CENTRES)
        for levels in values:
            self._sizes[levels] = self._size(levels)
        while not self.wanted and self.error > self._target:
            open_ = [levels for levels in self._sizes if levels not in self.taken]
            if not open_:
                return
            largest = max(open_, key=self._sizes.__getitem__)
            if self._sizes[largest] <= self._noise or self.nodes + largest.nodes > MOST_NODES:
                return
            self._take(largest)

    def _take(self, levels: Levels) -> None:
        """Take levels in, and want those above them whose others below are in too."""
        self.taken |= {levels}
        self.wanted = tuple(
            child
            for child in levels.children()
            if all(has or level == 0 for has, level in zip(self._parts, child, strict=True))
            and all(parent in self.taken for parent in child.parents())
        )

    def _size(self, levels: Levels) -> float:
        """RMS of a surplus over the pixels lit, relative to their mean radiance."""
        surplus = sum(sign * self._values[lower] for lower, sign in levels.below())
        if self._mean == 0.0:
            return 0.0
        return float(np.sqrt(np.sum(np.square(surplus)) / self._count)) / self._mean
