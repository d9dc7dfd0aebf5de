"""Samples, the model to meet them, and the model's two terms for many sets of shapes at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.models.base import Geometry, Kind, Parameter

if TYPE_CHECKING:
    from collections.abc import Mapping

    from analysis.instrument import Gain, Spread
    from analysis.models.base import Lobe, Model

Array = NDArray[np.float64]

LARGEST = 1e100
"""Terms and slopes are cut here: beyond all that a search returns to, and their products are still finite."""


class Terms(NamedTuple):
    """The two terms of f at unit scale for M sets of shapes, in 1/sr, 0 where nothing is visible.

    Attributes
    ----------
    diffuse, lobe : ndarray, shape (M, N)
        What kd and ks scale; a diffuse term that no shape moves has shape (1, N), a lobe that is not there is
        zero.
    diffuse_slopes, lobe_slopes : ndarray, shape (D, M, N) and (L, M, N)
        Their derivatives by the search coordinates that move them.
    diffuse_by, lobe_by : tuple of int
        The D and L shapes that these are.
    """

    diffuse: Array
    lobe: Array
    diffuse_slopes: Array
    lobe_slopes: Array
    diffuse_by: tuple[int, ...]
    lobe_by: tuple[int, ...]

    def values(self, kd: Array, ks: Array) -> Array:
        """Return f (M, C, N) for scales (M, C)."""
        return np.asarray(kd[..., None] * self.diffuse[:, None, :] + ks[..., None] * self.lobe[:, None, :])

    def pair(self) -> Array:
        """Return both terms, shape (M, 2, N)."""
        return np.stack([np.broadcast_to(self.diffuse, self.lobe.shape), self.lobe], axis=1)

    def basis(self) -> Array:
        """Return slopes of the lobe, lobe, diffuse term and its slopes, shape (M, L + 2 + D, N)."""
        diffuse = np.broadcast_to(self.diffuse, self.lobe.shape)
        return np.stack([*self.lobe_slopes, self.lobe, diffuse, *self.diffuse_slopes], axis=1)


@dataclass(frozen=True)
class Problem:
    """Samples and the model to meet them.

    Attributes
    ----------
    model : type of Model
        The model.
    geometry : Geometry
        The samples' N pairs of directions.
    channels : int
        Number C of channels.
    spread : Spread or Gain, optional
        Samples at which the mean over the instrument's discs takes the place of the value at their centres.
    """

    model: type[Model]
    geometry: Geometry
    channels: int
    spread: Spread | Gain | None = None

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """The model's shape parameters, in its order."""
        return tuple(p for p in self.model.PARAMETERS if p.kind is Kind.SHAPE)

    @property
    def has_lobe(self) -> bool:
        """Whether there is a specular scale."""
        return any(p.kind is Kind.SPECULAR_SCALE for p in self.model.PARAMETERS)

    def some(self, rows: NDArray[np.intp]) -> Problem:
        """Return the problem of some of the samples."""
        geometry = Geometry(self.geometry.wi[rows], self.geometry.wo[rows])
        spread = None if self.spread is None else self.spread.some(rows)
        return Problem(self.model, geometry, self.channels, spread)

    def natural(self, coordinates: Array) -> dict[str, Array]:
        """Return shapes by name, each (M,), at search coordinates (M, S)."""
        values = {}
        for parameter, column in zip(self.shapes, coordinates.T, strict=True):
            inverse = [parameter.coordinate.inverse(float(x)) for x in column]
            values[parameter.name] = np.clip(np.array(inverse), *parameter.bounds)
        return values

    def terms(self, coordinates: Array) -> Terms:
        """Evaluate both terms at unit scale for many shapes.

        Parameters
        ----------
        coordinates : ndarray, shape (M, S)
            Shapes in search coordinates.

        Returns
        -------
        Terms
        """
        values = self.natural(coordinates)
        with np.errstate(under="ignore", over="ignore"):
            model = self.model(**values)
            found = model.terms_at(self.geometry)
            if self.spread is not None:
                found = self.spread.average(model, found)
        count = len(coordinates)
        diffuse, diffuse_slopes, diffuse_by = self._term(found["kd"], values, count)
        if "ks" in found:
            lobe, lobe_slopes, lobe_by = self._term(found["ks"], values, count)
        else:
            full = (count, len(self.geometry.wi))
            lobe, lobe_slopes, lobe_by = np.zeros(full), np.zeros((0, *full)), ()
        lobe = np.broadcast_to(lobe, (count, lobe.shape[1]))
        return Terms(diffuse, lobe, diffuse_slopes, lobe_slopes, diffuse_by, lobe_by)

    def _term(
        self, term: Lobe, values: Mapping[str, Array], count: int
    ) -> tuple[Array, Array, tuple[int, ...]]:
        """Turn a model's term (N, M) into values (M, N), slopes by search coordinates, and by which."""
        visible = self.geometry.visible
        by = tuple(i for i, parameter in enumerate(self.shapes) if parameter.name in term.slopes)
        slopes = np.empty((len(by), count, len(visible)))
        for row, i in enumerate(by):
            parameter = self.shapes[i]
            per = np.array([parameter.coordinate.slope(value) for value in values[parameter.name]])
            with np.errstate(over="ignore"):
                slope = term.slopes[parameter.name] * per
            slopes[row] = np.where(visible, np.clip(slope, -LARGEST, LARGEST).T, 0.0)
        return np.where(visible, np.minimum(term.value, LARGEST).T, 0.0), slopes, by

    def bounds(self) -> tuple[Array, Array]:
        """Return bounds of the shapes in search coordinates."""
        low, high = (np.array([p.coordinate.forward(p.bounds[side]) for p in self.shapes]) for side in (0, 1))
        return low, high
