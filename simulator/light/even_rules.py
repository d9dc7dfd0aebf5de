"""Points evenly spread over lamp, pixel and pupil at once: for edges, which products of rules do not know."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from simulator.light.sparse_rules import Rule

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@cache
def even_rule(first: int, last: int, seed: int = 0) -> Rule:
    """Return points of the sequence of Sobol (1967), scrambled, so that the first one is not a corner.

    Parameters
    ----------
    first, last : int
        Which, counted from 0; powers of two are the best ends.
    seed : int
        Of the scrambling.
    """
    from scipy.stats.qmc import Sobol

    cube = Sobol(6, rng=np.random.default_rng(seed)).random(last)[first:]
    nodes = np.hstack([_to_disc(cube[:, :2]), cube[:, 2:4] - 0.5, _to_disc(cube[:, 4:])])
    return Rule(nodes, np.full(last - first, 1.0 / (last - first)))


def _to_disc(square: Array) -> Array:
    """Carry the unit square to the unit disc, areas kept."""
    radius, angle = np.sqrt(square[:, 0]), 2.0 * np.pi * square[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
