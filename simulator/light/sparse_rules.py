"""Quadrature over lamp, pixel and pupil together: sparse combinations of products of well-known rules.

One rule per part, by level: a single node at the centre, then 4, 16, 64, ... nodes. On the discs of lamp and
pupil it is that of Peirce (1957, "Numerical integration over the planar annulus"), of degree 3, 7, 15, ...;
on the pixel's square the product of Gauss-Legendre rules, of the same degrees. Products of the three in all
combinations would cost too much: where two parts hardly move the radiance, their product moves it less by
both factors. So a set of levels is combined as Smolyak (1963) does, each product with the weight of the
combination technique (Griebel, Schneider, Zenger 1992).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.instrument import disc_nodes

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

Array = NDArray[np.float64]

HIGHEST_LEVEL = 5
"""1024 nodes in one part: degree 63, for lobes narrower than a tenth of what is averaged over."""


class Levels(NamedTuple):
    """Levels of the rules on lamp, pixel and pupil; 0 is the centre alone."""

    lamp: int
    pixel: int
    pupil: int

    @property
    def nodes(self) -> int:
        """Nodes of the product."""
        return int(4 ** sum(self))

    def below(self) -> Iterator[tuple[Levels, int]]:
        """Yield those lower by 0 or 1 in each part, with the sign of each in the difference of all."""
        for step in product((0, 1), repeat=len(self)):
            lower = Levels(*(level - one for level, one in zip(self, step, strict=True)))
            if min(lower) >= 0:
                yield lower, (-1) ** sum(step)

    def parents(self) -> Iterator[Levels]:
        """Yield those lower by 1 in one part."""
        for lower, sign in self.below():
            if sign == -1 and sum(lower) == sum(self) - 1:
                yield lower

    def children(self) -> Iterator[Levels]:
        """Yield those higher by 1 in one part."""
        for part, level in enumerate(self):
            if level < HIGHEST_LEVEL:
                yield Levels(*(higher + (place == part) for place, higher in enumerate(self)))


CENTRES = Levels(0, 0, 0)


@dataclass(frozen=True, eq=False)
class Rule:
    """Nodes of all three parts together.

    Attributes
    ----------
    nodes : ndarray, shape (K, 6)
        Two coordinates each on the lamp's unit disc, in the pixel (-1/2 to 1/2: to its right, down) and on
        the pupil's unit disc.
    weights : ndarray, shape (K,)
        They sum to 1; some are negative in a combination.
    """

    nodes: Array
    weights: Array

    @property
    def plain(self) -> bool:
        """Whether it is the centres alone."""
        return len(self.weights) == 1 and not self.nodes.any()


@cache
def product_rule(levels: Levels) -> Rule:
    """Return the product of the three parts' rules."""
    parts = _disc_rule(levels.lamp), _square_rule(levels.pixel), _disc_rule(levels.pupil)
    places = np.indices([len(weights) for _, weights in parts]).reshape(len(parts), -1)
    chosen = list(zip(parts, places, strict=True))
    return Rule(
        np.concatenate([nodes[place] for (nodes, _), place in chosen], axis=1),
        np.prod([weights[place] for (_, weights), place in chosen], axis=0),
    )


@cache
def sparse_rule(levels: frozenset[Levels]) -> Rule:
    """Return the combination of products whose surpluses are those of a set.

    Parameters
    ----------
    levels : frozenset of Levels
        With each, all that are lower in one part.
    """
    used = [(item, weight) for item in sorted(levels) if (weight := combination_weight(item, levels))]
    rules = [(product_rule(item), weight) for item, weight in used]
    return Rule(
        np.concatenate([rule.nodes for rule, _ in rules]),
        np.concatenate([weight * rule.weights for rule, weight in rules]),
    )


def combination_weight(item: Levels, levels: Iterable[Levels]) -> int:
    """Return how often a product is counted in the sum of a set's surpluses."""
    members = set(levels)
    steps = product((0, 1), repeat=len(item))
    return sum(
        (-1) ** sum(step)
        for step in steps
        if Levels(*(level + one for level, one in zip(item, step, strict=True))) in members
    )


def _disc_rule(level: int) -> tuple[Array, Array]:
    """Nodes (4^level, 2) on the unit disc, and their weights."""
    return disc_nodes(0 if level == 0 else 2 ** (level - 1))


@cache
def _square_rule(level: int) -> tuple[Array, Array]:
    """Nodes (4^level, 2) on the square of side 1 around the origin, and their weights."""
    points, weights = np.polynomial.legendre.leggauss(2**level)
    across, down = (axis.ravel() for axis in np.meshgrid(points, points))
    return 0.5 * np.stack([across, down], axis=1), 0.25 * np.outer(weights, weights).ravel()
