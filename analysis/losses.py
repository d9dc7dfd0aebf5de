"""What a fit makes small: a residual per datum, linear or not in f, and its slope.

Let f be the model's BRDF, d the datum, x = cos(theta_i), s the standard uncertainty:

======== ============================ ====================================================
name     residual                     use
======== ============================ ====================================================
chi2     (f - d) / s                  the default where samples carry uncertainties
log      ln(1 + f x) - ln(1 + d x)    the default elsewhere (Low et al. 2012); the best to look
                                      at of those in BRDF space (Kavoosighafi et al. 2025)
cbrt     (f x)^(1/3) - (d x)^(1/3)    perceptually best of its family (Fores et al. 2012)
l2       (f - d) x                    the oldest (Ngan et al. 2005); ruled by peaks
======== ============================ ====================================================

A fifth, `robust`, is chi2 or log with weights that gross errors lose: see `analysis.robust`. Data at or below
zero count in all of them: noise around nothing has both signs, and to leave one out would brighten a dark
surface.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable

Array = NDArray[np.float64]

LOSSES = ("chi2", "log", "cbrt", "l2")
ROBUST = "robust"
LOWEST = -0.99
"""ln(1 + v) is taken at no smaller v: a datum this negative is noise, whatever the loss."""
FLAT_CBRT = 1e-4
"""Below this the cube root is continued by its tangent: its slope at zero, infinite, would rule the fit."""


Rows = NDArray[np.intp] | slice
EVERY = slice(None)


@dataclass(frozen=True)
class Loss(ABC):
    """Residuals of a set of data.

    Attributes
    ----------
    name : str
        One of `LOSSES`.
    data : ndarray, shape (N, C)
        Measured f_r in 1/sr, 0 where unused.
    used : ndarray of bool, shape (N, C)
        Which data count.
    root : ndarray, shape (N, C), or None
        Root of a weight with which each residual counts besides; None for 1.
    """

    name: str
    data: Array
    used: NDArray[np.bool_]
    root: Array | None = field(default=None, kw_only=True)

    @property
    @abstractmethod
    def linear(self) -> bool:
        """Whether the residual is linear in f, so that scales can be solved for."""

    @abstractmethod
    def residual(self, f: Array) -> Array:
        """Return residuals of a model's f (N, C), 0 where unused."""

    @abstractmethod
    def slope(self, f: Array) -> Array:
        """Return the derivative of the residual by f at f (N, C), 0 where unused."""

    @abstractmethod
    def by_channel(self, rows: Rows = EVERY) -> Self:
        """Return the loss of some samples with channels first: its arrays are (C, n), and so must f be."""

    def reweighted(self, weights: Array | None) -> Self:
        """Return the loss with the square of each residual counting `weights` (N, C) times; None for once."""
        return replace(self, root=None if weights is None else np.sqrt(weights))

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Which data count for more than nothing, shape (N, C)."""
        return self.used if self.root is None else self.used & (self.root > 0.0)

    def _counted(self, values: Array) -> Array:
        """Residuals or slopes of used data with the root of their weight, 0 for the others."""
        whole = values if self.root is None else values * self.root
        return whole if self._all_used else np.where(self.used, whole, 0.0)

    @cached_property
    def _all_used(self) -> bool:
        return bool(self.used.all())

    def weight(self) -> Array:
        """Return the slope at the data: a linear loss's weight, another's near the solution."""
        return self.slope(self.data)

    def _root_by_channel(self, rows: Rows) -> Array | None:
        return None if self.root is None else _channels_first(self.root, rows)

    def secant(self, f: Array) -> Array:
        """Return the weight with which a linear loss would have this residual at f, 0 where unused."""
        difference = f - self.data
        # Where model and datum agree in half their digits the slope is the better quotient.
        apart = np.abs(difference) > 1e-8 * np.abs(self.data) + 1e-300
        return np.where(apart, self.residual(f) / np.where(apart, difference, 1.0), self.slope(f))


@dataclass(frozen=True)
class Weighted(Loss):
    """A loss linear in f: weight times difference.

    Attributes
    ----------
    weights : ndarray, shape (N, C)
        In sr.
    """

    weights: Array

    @property
    def linear(self) -> bool:
        """Return True."""
        return True

    def residual(self, f: Array) -> Array:
        """Return weight times (f - d)."""
        return self._counted(self.weights * (f - self.data))

    def slope(self, f: Array) -> Array:
        """Return the weight."""
        return self._counted(self.weights) + np.zeros_like(f)

    def by_channel(self, rows: Rows = EVERY) -> Self:
        """Return the loss of some samples with channels first."""
        data, used, weights = (_channels_first(a, rows) for a in (self.data, self.used, self.weights))
        return replace(self, data=data, used=used, weights=weights, root=self._root_by_channel(rows))


@dataclass(frozen=True)
class Transformed(Loss):
    """A loss of T(f cos(theta_i)).

    Attributes
    ----------
    cos_i : ndarray, shape (N, 1)
        Cosine of incidence.
    transform, transform_slope : callable
        T and its derivative.
    """

    cos_i: Array
    transform: Callable[[Array], Array]
    transform_slope: Callable[[Array], Array]

    @property
    def linear(self) -> bool:
        """Return False."""
        return False

    def residual(self, f: Array) -> Array:
        """Return T(f cos) - T(d cos)."""
        return self._counted(self.transform(f * self.cos_i) - self._target)

    @cached_property
    def _target(self) -> Array:
        return self.transform(self.data * self.cos_i)

    def slope(self, f: Array) -> Array:
        """Return T'(f cos) cos."""
        return self._counted(self.transform_slope(f * self.cos_i) * self.cos_i)

    def by_channel(self, rows: Rows = EVERY) -> Self:
        """Return the loss of some samples with channels first."""
        data, used, cos_i = (_channels_first(a, rows) for a in (self.data, self.used, self.cos_i))
        return replace(self, data=data, used=used, cos_i=cos_i, root=self._root_by_channel(rows))


def _channels_first(column: NDArray[Any], rows: Rows) -> NDArray[Any]:
    return np.ascontiguousarray(column[rows].T)


def log_one_plus(v: Array) -> Array:
    """Return ln(1 + v), with v at least `LOWEST`."""
    return np.log1p(np.maximum(v, LOWEST))


def _log_slope(v: Array) -> Array:
    return 1.0 / (1.0 + np.maximum(v, LOWEST))


def _cbrt(v: Array) -> Array:
    tangent = np.cbrt(FLAT_CBRT) + (v - FLAT_CBRT) * np.cbrt(FLAT_CBRT) / (3.0 * FLAT_CBRT)
    return np.where(v < FLAT_CBRT, tangent, np.cbrt(v))


def _cbrt_slope(v: Array) -> Array:
    root = np.cbrt(np.maximum(v, FLAT_CBRT))
    return 1.0 / (3.0 * np.square(root))


def make_loss(
    name: str, data: Array, used: NDArray[np.bool_], cos_i: Array, uncertainty: Array | None
) -> Loss:
    """Make a loss of data.

    Parameters
    ----------
    name : str
        One of `LOSSES`.
    data : ndarray, shape (N, C)
        f_r in 1/sr; unused data may be anything.
    used : ndarray of bool, shape (N, C)
        Which data count.
    cos_i : ndarray, shape (N, 1)
        Cosine of incidence.
    uncertainty : ndarray, shape (N, C), or None
        Standard uncertainty in 1/sr, for chi2.

    Returns
    -------
    Loss

    Raises
    ------
    BadInput
        If the name is unknown, or chi2 is asked of data without (positive) uncertainties.
    """
    clean = np.where(used, data, 0.0)
    match name:
        case "chi2":
            if uncertainty is None:
                raise BadInput(
                    "chi2 needs uncertainties and the samples have none",
                    todo="choose the loss log, cbrt or l2",
                )
            if np.any(uncertainty[used] <= 0.0):
                where = f"sample {int(np.argwhere(used & ~(uncertainty > 0.0))[0][0])}"
                raise BadInput(
                    "its uncertainty is zero",
                    where=where,
                    todo="correct it, or choose the loss log, cbrt or l2",
                )
            return Weighted(name, clean, used, 1.0 / np.where(used, uncertainty, 1.0))
        case "l2":
            return Weighted(name, clean, used, cos_i + np.zeros_like(clean))
        case "log":
            return Transformed(name, clean, used, cos_i, log_one_plus, _log_slope)
        case "cbrt":
            return Transformed(name, clean, used, cos_i, _cbrt, _cbrt_slope)
        case _:
            raise BadInput(f"unknown loss '{name}'", todo=f"choose from {', '.join((*LOSSES, ROBUST))}")
