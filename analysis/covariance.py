"""Covariance of a fit: from the normal equations at its end to the parameters that people know."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis import uncertainty

if TYPE_CHECKING:
    from analysis.equations import Problem
    from analysis.jacobian import SearchJacobian
    from analysis.losses import Loss
    from analysis.solver import Solution

Array = NDArray[np.float64]


class NormalEquations:
    """The normal equations at the solution, in search coordinates scaled to columns of length 1."""

    def __init__(self, derivative: SearchJacobian, goal: Loss, undetermined: NDArray[np.bool_]) -> None:
        columns = goal.slope(derivative.f)[..., None] * derivative.columns
        flat = columns.reshape(-1, columns.shape[-1])
        length = np.sqrt(np.einsum("np,np->p", flat, flat))
        self._free = length > 0.0
        self._free[: len(undetermined)] &= ~undetermined
        self._length = length[self._free]
        scaled = columns[..., self._free] / self._length
        flat = scaled.reshape(-1, scaled.shape[-1])
        normal = flat.T @ flat
        self.condition = float(np.linalg.cond(normal))
        # Not the inverse: a direction without information must come out large, not fail.
        self._inverse = np.linalg.pinv(normal, rcond=1e-14, hermitian=True)
        self._scores = scaled * goal.weight()[..., None]

    def covariance(self, own: Array, shared: list[uncertainty.SharedError]) -> Array:
        """Sandwich covariance; infinite where there is no information."""
        return self._full(self._inverse @ uncertainty.meat(self._scores, own, shared) @ self._inverse)

    def inverse(self) -> Array:
        """Covariance for independent residuals of standard deviation 1."""
        return self._full(self._inverse)

    def _full(self, scaled: Array) -> Array:
        full = np.zeros((len(self._free), len(self._free)))
        full[np.ix_(self._free, self._free)] = scaled / np.outer(self._length, self._length)
        full[~self._free, ~self._free] = np.inf
        return full


def to_natural(problem: Problem, solution: Solution, derivative: SearchJacobian) -> Array:
    """Jacobian of the natural parameters (shapes, kd, ks) by the search coordinates (shapes, kd, s)."""
    shapes, channels = len(solution.shapes), problem.channels
    count = derivative.columns.shape[-1]
    jacobian = np.eye(count)
    for i, parameter in enumerate(problem.shapes):
        jacobian[i, i] = parameter.coordinate.slope(parameter.coordinate.inverse(solution.shapes[i]))
    for c in range(channels if problem.has_lobe else 0):
        row = shapes + channels + c
        jacobian[row, :shapes] = -solution.ks[c] * derivative.size_slopes[:, c]
        jacobian[row, row] = 1.0 / derivative.size[c]
    return jacobian


def row_names(problem: Problem) -> tuple[tuple[str, int | None], ...]:
    """Name the covariance's rows: parameter, and channel or None where all share it."""
    scales = ["kd", "ks"] if problem.has_lobe else ["kd"]
    shared: list[tuple[str, int | None]] = [(p.name, None) for p in problem.shapes]
    return (*shared, *((name, c) for name in scales for c in range(problem.channels)))


def transform(jacobian: Array, covariance: Array) -> Array:
    """J V J^T; the variance of all that hangs on something undetermined is infinite."""
    undetermined = np.isinf(np.diag(covariance))
    result = jacobian @ np.where(np.isinf(covariance), 0.0, covariance) @ jacobian.T
    hanging = np.any(jacobian[:, undetermined] != 0.0, axis=1)
    result[hanging, hanging] = np.inf
    return np.asarray(result)
