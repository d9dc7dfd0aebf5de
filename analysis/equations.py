"""The normal equations of a fit: of all parameters, or of the shapes alone with the scales solved for.

Search coordinates. A shape parameter is searched in the coordinate it names (log m, ...). A specular scale is
replaced by s = ks |w lobe|, the size of the specular part of the weighted data: unlike ks it hardly depends
on the shapes, so the long curved valleys of (ks, ior) and of (ks, m) become straight.

All channels share the two terms and their slopes, so no Jacobian is formed: with b_j the lobe, the diffuse
term and the slopes of both, every entry of the normal equations is a sum of the loss's slope squared times
b_j b_k, and those products are made once for all channels. A diffuse term that is the same for all shapes has
no slopes and costs nothing more.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.descent import Equations

if TYPE_CHECKING:
    from analysis.descent import Members
    from analysis.losses import Loss
    from analysis.problem import Problem, Terms

Array = NDArray[np.float64]

DEGENERATE = 1e-12
"""Squared sine between the two scaled columns below which they count as one."""


def solve_scales(weight: Array, data: Array, pair: Array) -> tuple[Array, Array]:
    """Solve for the non-negative scales of both terms, each channel alone.

    Parameters
    ----------
    weight, data : ndarray, shape (..., C, N)
        Weights (0 for unused data) and data.
    pair : ndarray, shape (..., 2, N)
        Diffuse term and lobe at unit scale (`Terms.pair`); the lobe is zero for a model without.

    Returns
    -------
    tuple of ndarray, shape (..., C)
        kd and ks.
    """
    squared = np.square(weight)
    return _best_scales(_gram(pair, squared), _against(squared * data, pair))


def _best_scales(gram: Array, right: Array) -> tuple[Array, Array]:
    """Non-negative least squares in two unknowns: gram (..., 2, 2), right-hand side (..., 2).

    There are four candidates: both free, either one zero, both zero. The problem is convex, so the free
    solution is taken where it is admissible, else the better of the others.
    """
    dd, ds, ss = gram[..., 0, 0], gram[..., 0, 1], gram[..., 1, 1]
    dt, st = right[..., 0], right[..., 1]
    kd_alone = np.maximum(dt, 0.0) / np.where(dd > 0.0, dd, 1.0)
    ks_alone = np.maximum(st, 0.0) / np.where(ss > 0.0, ss, 1.0)
    determinant = dd * ss - ds * ds
    separable = determinant > DEGENERATE * dd * ss
    safe = np.where(separable, determinant, 1.0)
    kd, ks = (dt * ss - st * ds) / safe, (st * dd - dt * ds) / safe
    free = separable & (kd >= 0.0) & (ks >= 0.0)
    # The objective falls by kd_alone * dt / 2 or ks_alone * st / 2 from that of both zero.
    diffuse_wins = kd_alone * dt >= ks_alone * st
    kd = np.where(free, kd, np.where(diffuse_wins, kd_alone, 0.0))
    ks = np.where(free, ks, np.where(diffuse_wins, 0.0, ks_alone))
    return kd, ks


def _gram(basis: Array, squared: Array) -> Array:
    """Sum squared weights (..., C, N) times products of basis functions (..., K, N): (..., C, K, K)."""
    rows, cols, which = _pairs(basis.shape[-2])
    products = basis[..., rows, :] * basis[..., cols, :]
    return np.asarray(np.matmul(squared, np.swapaxes(products, -1, -2))[..., which])


@cache
def _pairs(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of a symmetric matrix's upper triangle, and where each entry is found among them."""
    rows, cols = np.triu_indices(count)
    which = np.empty((count, count), dtype=np.intp)
    which[rows, cols] = which[cols, rows] = np.arange(len(rows))
    return rows, cols, which


def _against(values: Array, basis: Array) -> Array:
    """Sum values (..., C, N) times basis functions (..., K, N): (..., C, K)."""
    return np.asarray(np.matmul(values, np.swapaxes(basis, -1, -2)))


class Linearised:
    """A problem under a loss, as equations in the search coordinates.

    Parameters
    ----------
    problem : Problem
        Directions and model; S shapes, C channels.
    loss : Loss
        With channels first (`Loss.by_channel`).
    fixed_size : ndarray, shape (C,), optional
        Take s = ks times this, in place of |w lobe|: so that a search can hold ks itself.
    counts : ndarray, shape (R, N), optional
        How often each sample counts, one row for each of R replicas of the problem; the numbers of members
        are then those of replicas.
    """

    def __init__(
        self, problem: Problem, loss: Loss, *, fixed_size: Array | None = None, counts: Array | None = None
    ) -> None:
        self.problem = problem
        self.loss = loss
        self._fixed_size = fixed_size
        self._root = None if counts is None else np.sqrt(counts)
        self._squared = np.square(loss.weight())

    def linear_scales(self, terms: Terms) -> tuple[Array, Array]:
        """Solve for the scales (M, C) under the loss made linear at the data."""
        return solve_scales(np.sqrt(self._squared), self.loss.data, terms.pair())

    def size(self, lobe: Array) -> Array:
        """Return |w lobe| by channel, shape (M, C), for lobes (M, N); 1 where it is 0."""
        if self._fixed_size is not None:
            return np.broadcast_to(self._fixed_size, (len(lobe), len(self._fixed_size)))
        square = np.square(lobe) @ self._squared.T
        return np.sqrt(np.where(square > 0.0, square, 1.0))

    def unpack(self, x: Array) -> tuple[Array, Array, Array]:
        """Split coordinates (M, P) into shapes (M, S), kd (M, C) and s (M, C)."""
        shapes, channels = len(self.problem.shapes), self.problem.channels
        return x[:, :shapes], x[:, shapes : shapes + channels], x[:, shapes + channels :]

    def shapes_alone(self, shapes: Array, members: Members) -> Equations:
        """Equations of the shapes, scales solved for: only for a loss that is linear in f.

        The scales are taken out of the Gauss-Newton equations of all parameters, which is the variable
        projection of Kaufman (1975); scales at zero stay there and take part in nothing.
        """
        del members
        terms = self.problem.terms(shapes)
        kd, ks = self.linear_scales(terms)
        basis = terms.basis()
        residual = self.loss.residual(terms.values(kd, ks))
        gram = _gram(basis, self._squared)
        pull = _against(np.sqrt(self._squared) * residual, basis)
        count = shapes.shape[1]
        mix = _mix(terms, count, kd, ks)
        local = mix @ gram @ np.swapaxes(mix, -1, -2)
        force = np.einsum("mcjk,mck->mcj", mix, pull)
        active = np.stack([ks > 0.0, kd > 0.0], axis=-1)
        cross = local[..., :count, count:] * active[..., None, :]
        taken = _solve_two(local[..., count:, count:], active, np.swapaxes(cross, -1, -2))
        normal = np.sum(local[..., :count, :count] - cross @ taken, axis=1)
        gradient = np.sum(force[..., :count], axis=1)
        return Equations(0.5 * np.einsum("mcn,mcn->m", residual, residual), normal, gradient)

    def all_parameters(self, x: Array, members: Members) -> Equations:
        """Equations of all search coordinates (shapes, kd by channel, s by channel)."""
        shapes, kd, s = self.unpack(x)
        terms = self.problem.terms(shapes)
        size = self.size(terms.lobe)
        if self._fixed_size is None:
            relative = np.matmul(terms.lobe * terms.lobe_slopes, self._squared.T) / np.square(size)
        else:
            relative = np.zeros((len(terms.lobe_slopes), *size.shape))
        # What is common to the channels is taken out of the slopes themselves, where it cancels best.
        common = np.mean(relative, axis=-1)
        terms = terms._replace(lobe_slopes=terms.lobe_slopes - terms.lobe * common[..., None])
        relative = relative - common[..., None]
        ks = s / size
        f = terms.values(kd, ks)
        residual, slope = self.loss.residual(f), self.loss.slope(f)
        if self._root is not None:
            root = self._root[members][:, None, :]
            residual, slope = root * residual, root * slope
        basis = terms.basis()
        gram, pull = _gram(basis, np.square(slope)), _against(slope * residual, basis)
        mix = _mix(terms, shapes.shape[1], kd, ks, relative=relative, size=size)
        local = mix @ gram @ np.swapaxes(mix, -1, -2)
        force = np.einsum("mcjk,mck->mcj", mix, pull)
        normal, gradient = self._assembled(local, force)
        return Equations(0.5 * np.einsum("mcn,mcn->m", residual, residual), normal, gradient)

    def _assembled(self, local: Array, force: Array) -> tuple[Array, Array]:
        """Put each channel's equations in (shapes, s, kd) into those of all coordinates."""
        shapes, channels = len(self.problem.shapes), self.problem.channels
        total = shapes + 2 * channels
        normal, gradient = np.zeros((len(local), total, total)), np.zeros((len(local), total))
        for c in range(channels):
            at = np.array([*range(shapes), shapes + channels + c, shapes + c])
            normal[:, at[:, None], at] += local[:, c]
            gradient[:, at] += force[:, c]
        return normal, gradient


def _mix(
    terms: Terms,
    shapes: int,
    kd: Array,
    ks: Array,
    *,
    relative: Array | None = None,
    size: Array | float = 1.0,
) -> Array:
    """Write derivatives of f by (shapes, s, kd) in terms of `Terms.basis`: (M, C, S + 2, L + 2 + D).

    `relative` (L, M, C) is what a shape's step does to ln |w lobe|, and so to ks while s = ks `size` stays;
    without it ks stays.
    """
    lobes = len(terms.lobe_by)
    mix = np.zeros((*ks.shape, shapes + 2, lobes + 2 + len(terms.diffuse_by)))
    for row, i in enumerate(terms.lobe_by):
        mix[..., i, row] = ks
        if relative is not None:
            mix[..., i, lobes] = -ks * relative[row]
    for row, i in enumerate(terms.diffuse_by):
        mix[..., i, lobes + 2 + row] = kd
    mix[..., shapes, lobes] = 1.0 / size
    mix[..., shapes + 1, lobes + 1] = 1.0
    return mix


def _solve_two(gram: Array, active: NDArray[np.bool_], right: Array) -> Array:
    """Solve the scales' equations (..., 2, 2) for right-hand sides (..., 2, S); inactive ones give 0."""
    both = active[..., :, None] & active[..., None, :]
    masked = np.where(both, gram, 0.0)
    first, second, mixed = masked[..., 0, 0], masked[..., 1, 1], masked[..., 0, 1]
    determinant = first * second - mixed * mixed
    separable = determinant > DEGENERATE * first * second
    safe = np.where(separable, determinant, 1.0)
    inverse = np.zeros_like(masked)
    inverse[..., 0, 0] = np.where(separable, second / safe, _reciprocal(first))
    inverse[..., 1, 1] = np.where(separable, first / safe, np.where(first > 0.0, 0.0, _reciprocal(second)))
    inverse[..., 0, 1] = inverse[..., 1, 0] = np.where(separable, -mixed / safe, 0.0)
    return np.asarray(inverse @ right)


def _reciprocal(value: Array) -> Array:
    return np.where(value > 0.0, 1.0 / np.where(value > 0.0, value, 1.0), 0.0)
