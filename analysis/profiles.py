"""The profile of a shape: what the fit costs when it is held, and all others make the best of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.descent import descend
from analysis.equations import Linearised

if TYPE_CHECKING:
    from analysis.fit import FitResult

Array = NDArray[np.float64]

REACH = 3.2
"""How far the profile goes to each side, in standard uncertainties."""
POINTS = 15
TOLERANCE, MOST_STEPS = 1e-9, 100


@dataclass(frozen=True, eq=False)
class Profile:
    """One shape's profile.

    Attributes
    ----------
    name : str
        The shape.
    values : ndarray, shape (K,)
        Where it was held, natural values, ascending.
    rise : ndarray, shape (K,)
        Of chi-square, in units where it is 1 at one standard uncertainty of a linear problem.
    best, u : float
        Value and standard uncertainty of the fit.
    """

    name: str
    values: Array
    rise: Array
    best: float
    u: float


def profile(result: FitResult, row: int) -> Profile | None:
    """Profile one shape of a fit.

    Parameters
    ----------
    result : FitResult
        Of `analysis.fit.fit`.
    row : int
        Of the covariance.

    Returns
    -------
    Profile or None
        None where the samples do not determine the shape.
    """
    name, channel = result.names[row]
    u, unit = float(np.sqrt(result.covariance[row, row])), float(result.state.rise[row])
    if not (np.isfinite(u) and u > 0.0 and np.isfinite(unit)):
        return None
    block = next(b for b in result.state.blocks if channel is None or channel in b.channels)
    problem, solution = block.problem, block.solution
    index = [p.name for p in problem.shapes].index(name)
    equations = Linearised(problem, block.loss.by_channel())
    low, high = problem.bounds()
    scales = 2 * problem.channels
    parameter = problem.shapes[index]
    best = parameter.coordinate.inverse(float(solution.shapes[index]))
    step = u / abs(parameter.coordinate.slope(best))
    held = solution.shapes[index] + step * np.linspace(-REACH, REACH, POINTS)
    held = np.unique(np.clip(held, low[index], high[index]))
    size = equations.size(problem.terms(solution.shapes[None]).lobe)[0]
    x = np.tile(np.concatenate([solution.shapes, solution.kd, size * solution.ks]), (len(held) + 1, 1))
    x[:-1, index] = held
    lower = np.tile([*low, *[0.0] * scales], (len(x), 1))
    upper = np.tile([*high, *[np.inf] * scales], (len(x), 1))
    lower[:, index] = upper[:, index] = x[:, index]
    found = descend(equations.all_parameters, x, (lower, upper), tolerance=TOLERANCE, most=MOST_STEPS)
    rise = 2.0 * np.maximum(found.cost[:-1] - found.cost[-1], 0.0) / unit**2
    values = np.array([parameter.coordinate.inverse(float(each)) for each in held])
    return Profile(name if channel is None else f"{name} {channel + 1}", values, rise, best, u)
