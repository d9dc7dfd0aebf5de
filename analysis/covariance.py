"""Covariance of a fit: from the normal equations at its end to the parameters that people know."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
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
    if len(blocks) == 1:
        # All channels share their shapes, and the block's own order is the layout's.
        solution = blocks[0].solution
        derivative = search_jacobian(
            blocks[0].problem, blocks[0].loss.weight(), solution.shapes, solution.kd, solution.ks
        )
        return Assembled(
            derivative.f, derivative.columns, to_natural(blocks[0].problem, solution, derivative)
        )
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
    """The normal equations at the solution, in those search coordinates that the data move.

    Attributes
    ----------
    condition : float
        Condition number of the equations scaled to columns of length 1.
    inflation : ndarray, shape (P,)
        Standard uncertainty of each coordinate over what it would be if the others were known.
    cosines : ndarray, shape (P, P)
        Cosines between what each two coordinates do to the residuals; infinite for what they do not move.
    """

    def __init__(self, whole: Assembled, goal: Loss, undetermined: NDArray[np.bool_]) -> None:
        columns = goal.slope(whole.f)[..., None] * whole.columns
        flat = columns.reshape(-1, columns.shape[-1])
        normal = flat.T @ flat
        length = np.sqrt(np.diag(normal))
        self._free = (length > 0.0) & ~undetermined
        if not self._free.all():
            columns = columns[..., self._free]
        scale = np.outer(length, length)[np.ix_(self._free, self._free)]
        normal = normal[np.ix_(self._free, self._free)] / scale
        self.condition = float(np.linalg.cond(normal))
        # Not the inverse: a direction without information must come out large, not fail.
        inverse = np.linalg.pinv(normal, rcond=1e-14, hermitian=True)
        self.inflation = self.among_all(np.sqrt(np.diag(inverse)), 1.0)
        self.cosines = self._full(normal)
        self._inverse = inverse / scale
        self._weight = goal.weight()
        self._scores = np.multiply(columns, self._weight[..., None], out=columns)

    def covariance(self, own: Array, shared: list[uncertainty.SharedError]) -> Array:
        """Sandwich covariance; infinite where there is no information."""
        return self._full(self._inverse @ uncertainty.meat(self._scores, own, shared) @ self._inverse)

    def inverse(self) -> Array:
        """Covariance for independent residuals of standard deviation 1."""
        return self._full(self._inverse)

    @cached_property
    def influence(self) -> Array:
        """How far an error of f of 1/sr in each datum moves each free coordinate, shape (N C, P')."""
        return np.asarray(self._scores.reshape(-1, self._scores.shape[-1]) @ self._inverse)

    def leverages(self) -> Array:
        """Return each datum's share in its own fitted value: diag(J (J^T J)^-1 J^T), 0 to 1, shape (N, C)."""
        flat = self._scores.reshape(self.influence.shape)
        square = np.square(self._weight)
        share = np.einsum("np,np->n", flat, self.influence).reshape(square.shape)
        return np.asarray(np.divide(share, square, out=share, where=square > 0.0))

    def moved(self, error: Array) -> Array:
        """Return how far errors of f (N, C) move the coordinates (P,); 0 where undetermined."""
        return self.among_all(error.ravel() @ self.influence, 0.0)

    def propagated(self, errors: Array) -> Array:
        """Covariance (P, P) of the coordinates moved by independent errors, as columns (N C, P') of moves."""
        return self._full(errors.T @ errors)

    def among_all(self, known: Array, otherwise: float) -> Array:
        """Put numbers (P',) of the free coordinates among those of all (P,)."""
        every = np.full(len(self._free), otherwise)
        every[self._free] = known
        return every

    def _full(self, among_free: Array) -> Array:
        full = np.zeros((len(self._free), len(self._free)))
        full[np.ix_(self._free, self._free)] = among_free
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
