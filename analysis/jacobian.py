"""Derivatives of a fitted model by the coordinates of its search, whole, for the covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from analysis.problem import Problem, Terms

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SearchJacobian:
    """Derivatives of f by the search coordinates (shapes, then kd by channel, then s by channel).

    Attributes
    ----------
    f : ndarray, shape (N, C)
        The model.
    columns : ndarray, shape (N, C, S + 2 C or S + C)
        df / d coordinate.
    size : ndarray, shape (C,)
        |w lobe|, so that ks = s / size.
    size_slopes : ndarray, shape (S, C)
        Its logarithmic derivative by the shapes' coordinates.
    """

    f: Array
    columns: Array
    size: Array
    size_slopes: Array


def search_jacobian(problem: Problem, weight: Array, shapes: Array, kd: Array, ks: Array) -> SearchJacobian:
    """Differentiate f by the search coordinates.

    Parameters
    ----------
    problem : Problem
        Directions and model.
    weight : ndarray, shape (N, C)
        The weights that define s.
    shapes : ndarray, shape (S,)
        Shapes in search coordinates.
    kd, ks : ndarray, shape (C,)
        Scales.

    Returns
    -------
    SearchJacobian
    """
    terms = problem.terms(shapes[None])
    diffuse, lobe = (term.T for term in (terms.diffuse, terms.lobe))
    size, size_slopes = _size(weight, terms, len(shapes))
    (count, channels), first = weight.shape, len(shapes)
    columns = np.zeros((count, channels, first + (2 if problem.has_lobe else 1) * channels))
    for i, slope in zip(terms.lobe_by, terms.lobe_slopes, strict=True):
        columns[..., i] += ks * (slope.T - lobe * size_slopes[i])
    for i, slope in zip(terms.diffuse_by, terms.diffuse_slopes, strict=True):
        columns[..., i] += kd * slope.T
    for c in range(channels):
        columns[:, c, first + c] = diffuse[:, 0]
        if problem.has_lobe:
            columns[:, c, first + channels + c] = lobe[:, 0] / size[c]
    return SearchJacobian(kd * diffuse + ks * lobe, columns, size, size_slopes)


def _size(weight: Array, terms: Terms, shapes: int) -> tuple[Array, Array]:
    weighted = weight * terms.lobe.T
    square = np.einsum("nc,nc->c", weighted, weighted)
    square = np.where(square > 0.0, square, 1.0)
    relative = np.zeros((shapes, weight.shape[1]))
    for i, slope in zip(terms.lobe_by, terms.lobe_slopes, strict=True):
        relative[i] = np.einsum("nc,nc->c", weighted, weight * slope.T) / square
    return np.sqrt(square), relative
