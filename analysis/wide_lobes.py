"""A lobe so wide that it shares its shape with the diffuse term, and what that costs.

Beyond a slope of about one half the facets face nearly everywhere, and a dielectric's lobe on top of
Lambert's term differs from it by its masking and its reflectance at grazing angles alone. Good samples may
still tell both apart, and then kd and ks are right only as far as the model's formula is, there. The
correlation of the two scales does not show it, since the other shapes share in the trade: the half-width of
the lobe does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.descent import descend
from analysis.equations import Linearised
from analysis.identifiability import Caution, Kind, correlation_matrix
from analysis.solver import FEW, thinned

if TYPE_CHECKING:
    from analysis.covariance import NormalEquations
    from analysis.layout import Layout
    from analysis.state import Block

Array = NDArray[np.float64]

WIDE_RAD = np.radians(30.0)
"""Half-width of a lobe, as the half vector's angle to the normal, from which on it is wide: that of GGX at
alpha = 0.53, of Beckmann's distribution at m = 0.46."""
ALIKE = 0.5
"""Cosine between what kd and what ks do to the residuals from which on they have a shape in common: a lobe
away from the normal has no half-width there."""
TOLERANCE, MOST_STEPS = 1e-4, 30


def about_wide_lobes(
    layout: Layout, block: Block, width: float, normal: NormalEquations, covariance: Array
) -> list[Caution]:
    """Say that a lobe is like Lambert's, how the scales correlate, and what the diffuse term is good for.

    Parameters
    ----------
    layout : Layout
        Rows of the arrays.
    block : Block
        Channels that share their shapes.
    width : float
        Of `analysis.identifiability.half_width`.
    normal : NormalEquations
        Of the fit.
    covariance : ndarray, shape (P, P)
        Of the parameters.

    Returns
    -------
    list of Caution
        None, or the one about the channel whose kd suffers most.
    """
    if width < WIDE_RAD:
        return []
    pairs = [(layout.row("kd", c), layout.row("ks", c)) for c in block.channels]
    pairs = [pair for pair, ks in zip(pairs, block.solution.ks, strict=True) if ks > 0.0]
    if not any(normal.cosines[pair] > ALIKE for pair in pairs):
        return []
    kd, ks = max(pairs, key=lambda pair: float(normal.inflation[pair[0]]))
    correlation = correlation_matrix(covariance)[kd, ks]
    trade = f"correlation {correlation:.2f}, " if np.isfinite(correlation) else ""
    text = (
        f"the lobe falls to half only at {np.degrees(width):.0f} deg, so wide that it shares its shape with "
        f"the diffuse term: kd and ks trade ({trade}u of kd {normal.inflation[kd]:.1f} times that beside a "
        f"known lobe); without kd the residual grows {without_diffuse(block):.3g} times"
    )
    return [Caution(Kind.KD_KS, ("kd", "ks"), text)]


def without_diffuse(block: Block) -> float:
    """Return the residual of the best fit that is found without a diffuse term, over that with it.

    Parameters
    ----------
    block : Block
        A fit.

    Returns
    -------
    float
        Ratio of root-mean-square residuals, in the measure of the loss; 1 for a fit without residuals.
    """
    problem, best, loss = block.problem, block.solution, block.loss.by_channel()
    size = Linearised(problem, loss).size(problem.terms(best.shapes[None]).lobe)[0]
    low, high = problem.bounds()
    dark, bright = np.zeros(problem.channels), np.full(problem.channels, np.inf)
    bounds = np.concatenate([low, dark, dark]), np.concatenate([high, dark, bright])
    x = np.concatenate([best.shapes, dark, size * best.ks])[None]
    # The way is long, and most of it can be gone on few samples.
    for some in (thinned(problem, block.loss, FEW), (problem, loss)):
        equations = Linearised(*some, fixed_size=size)
        x, cost = descend(equations.all_parameters, x, bounds, tolerance=TOLERANCE, most=MOST_STEPS)
    return float(np.sqrt(cost[0] / best.cost)) if best.cost > 0.0 else 1.0
