"""Covariance of a fit: from the normal equations at its end to the parameters that people know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis import uncertainty
from analysis.jacobian import search_jacobian
from analysis.models.fresnel import normal_reflectance, normal_reflectance_slope

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from analysis.jacobian import SearchJacobian
    from analysis.layout import Layout
    from analysis.losses import Loss
    from analysis.problem import Problem
    from analysis.solver import Solution
    from analysis.state import Block

Array = NDArray[np.float64]

LEAST_FREE = 1e-3
"""Share of a datum's error that its residual must keep to say how large that error is."""


@dataclass(frozen=True)
class Assembled:
    """A fit of all channels, differentiated.

    Attributes
    ----------
    f : ndarray, shape (N, C)
        The model.
    columns : ndarray, shape (N, C, P)
        Its derivatives by the search coordinates, in the order of the layout.
    natural : ndarray, shape (P, P)
        Derivatives of the parameters by the search coordinates.
    """

    f: Array
    columns: Array
    natural: Array


def assemble(layout: Layout, blocks: Sequence[Block]) -> Assembled:
    """Differentiate blocks of channels and put the parts where the layout wants them."""
    count, total = len(blocks[0].loss.data), len(layout.names)
    f, columns = np.empty((count, layout.channels)), np.zeros((count, layout.channels, total))
    natural = np.zeros((total, total))
    for block in blocks:
        solution = block.solution
        derivative = search_jacobian(
            block.problem, block.loss.weight(), solution.shapes, solution.kd, solution.ks
        )
        channels, rows = np.array(block.channels), layout.rows_of(block.channels)
        f[:, channels] = derivative.f
        columns[:, channels[:, None], rows] = derivative.columns
        natural[np.ix_(rows, rows)] = to_natural(block.problem, solution, derivative)
    return Assembled(f, columns, natural)


class NormalEquations:
    """The normal equations at the solution, in search coordinates scaled to columns of length 1."""

    def __init__(self, whole: Assembled, goal: Loss, undetermined: NDArray[np.bool_]) -> None:
        columns = goal.slope(whole.f)[..., None] * whole.columns
        flat = columns.reshape(-1, columns.shape[-1])
        length = np.sqrt(np.einsum("np,np->p", flat, flat))
        self._free = (length > 0.0) & ~undetermined
        self._length = length[self._free]
        scaled = columns[..., self._free] / self._length
        flat = scaled.reshape(-1, scaled.shape[-1])
        normal = flat.T @ flat
        self.condition = float(np.linalg.cond(normal))
        # Not the inverse: a direction without information must come out large, not fail.
        self._inverse = np.linalg.pinv(normal, rcond=1e-14, hermitian=True)
        self._weight = goal.weight()
        self._scores = scaled * self._weight[..., None]

    def covariance(self, own: Array, shared: list[uncertainty.SharedError]) -> Array:
        """Sandwich covariance; infinite where there is no information."""
        return self._full(self._inverse @ uncertainty.meat(self._scores, own, shared) @ self._inverse)

    def inverse(self) -> Array:
        """Covariance for independent residuals of standard deviation 1."""
        return self._full(self._inverse)

    def leverages(self) -> Array:
        """Return each datum's share in its own fitted value: diag(J (J^T J)^-1 J^T), 0 to 1, shape (N, C)."""
        found = np.zeros_like(self._weight)
        for c, weight in enumerate(self._weight.T):
            scores = self._scores[:, c]
            square = np.einsum("np,np->n", scores @ self._inverse, scores)
            np.divide(square, np.square(weight), out=found[:, c], where=weight > 0.0)
        return found

    def _full(self, scaled: Array) -> Array:
        full = np.zeros((len(self._free), len(self._free)))
        full[np.ix_(self._free, self._free)] = scaled / np.outer(self._length, self._length)
        full[~self._free, ~self._free] = np.inf
        return full


def residual_sizes(residual: Array, leverages: Array, scatter: Array) -> Array:
    """Let each residual state the standard deviation of its own error.

    These are the sizes of HC3 (MacKinnon & White 1985, in the form of Davidson & MacKinnon 1993):
    |r| / (1 - h), the residual that a datum would have from a fit without it. In a sandwich they need not be
    of one size, nor of a known law: noise may grow with the signal.

    Parameters
    ----------
    residual : ndarray, shape (N, C)
        Residuals at the solution.
    leverages : ndarray, shape (N, C)
        See `NormalEquations.leverages`.
    scatter : ndarray, shape (N, C)
        Standard deviation for data that the fit meets whatever they are: their residuals say nothing.

    Returns
    -------
    ndarray, shape (N, C)
        Standard deviations in the unit of the residuals.
    """
    free = 1.0 - leverages
    return np.where(free > LEAST_FREE, np.abs(residual) / np.maximum(free, LEAST_FREE), scatter)


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


def transform(jacobian: Array, covariance: Array) -> Array:
    """J V J^T; the variance of all that hangs on something undetermined is infinite."""
    undetermined = np.isinf(np.diag(covariance))
    result = jacobian @ np.where(np.isinf(covariance), 0.0, covariance) @ jacobian.T
    hanging = np.any(jacobian[:, undetermined] != 0.0, axis=1)
    result[hanging, hanging] = np.inf
    return np.asarray(result)


def derived(
    layout: Layout, values: Mapping[str, Array], natural: Array, search: Array
) -> dict[str, tuple[Array, Array]]:
    """Derive ks F0 for models with a reflectance of facets, with its uncertainty.

    Parameters
    ----------
    layout : Layout
        Rows of both matrices.
    values : mapping of str to ndarray
        Parameters by name.
    natural : ndarray, shape (P, P)
        Derivatives of the parameters by the search coordinates.
    search : ndarray, shape (P, P)
        Covariance in search coordinates.

    Returns
    -------
    dict of str to (ndarray, ndarray)
        `ks_F0` and its standard uncertainty, each (C,); empty for other models.
    """
    if "ior" in values:
        name, reflectance = "ior", normal_reflectance(values["ior"])
        slope = normal_reflectance_slope(values["ior"])
    elif "f0" in values:
        name, reflectance, slope = "f0", values["f0"], np.ones(())
    else:
        return {}
    ks = values["ks"]
    reflectance, slope = (np.broadcast_to(each, ks.shape) for each in (reflectance, slope))
    # Along the search coordinates: ks and ior each vary widely, their product hardly.
    gradients = np.array(
        [
            reflectance[c] * natural[layout.row("ks", c)] + ks[c] * slope[c] * natural[layout.row(name, c)]
            for c in range(layout.channels)
        ]
    )
    # An ior held on its bound is taken as it is: ks F0 hardly depends on it.
    known = np.where(np.isinf(search), 0.0, search)
    variance = np.einsum("cp,pq,cq->c", gradients, known, gradients)
    return {"ks_F0": (ks * reflectance, np.sqrt(np.maximum(variance, 0.0)))}
