"""What the finite lamp and the finite aperture make of a lobe: its mean over both discs.

A laboratory measures no f_r of two directions but its mean over the directions of a source and of a receiver,
weighted with both cosines: the irradiance of a source of even radiance, and the flux through an evenly open
aperture. Where the lobe is wide beside both discs the mean is the value at their centres; a lobe as narrow as
they are looks as wide as they are.

The mean is a sum over products of nodes on both discs: Gauss-Legendre points in the square of the radius and
4 n azimuths, on the plane that keeps areas, exact for polynomials of degree 4 n - 1 on each disc
(Stroud 1971, section 2.6).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.models.base import Geometry, Lobe

if TYPE_CHECKING:
    import xarray as xr

    from analysis.models.base import Model

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]

TOGETHER = 100_000
"""Pairs of nodes that a model is evaluated for at once."""


@dataclass(frozen=True)
class Instrument:
    """Angular radii of source and receiver as seen from the sample, in radians; 0 for a point."""

    source_rad: float
    receiver_rad: float

    @property
    def half_vector_rad(self) -> float:
        """Root of the mean squared angle by which both discs together move the half vector."""
        return float(np.sqrt(0.125 * (self.source_rad**2 + self.receiver_rad**2)))


def instrument_of(samples: xr.Dataset) -> Instrument | None:
    """Return the discs whose solid angles samples state; None where they state neither.

    One that is not stated is taken as a point.
    """
    radii = []
    for name in ("source_solid_angle_sr", "receiver_solid_angle_sr"):
        solid_angle_sr = float(samples.attrs.get(name, np.nan))
        known = np.isfinite(solid_angle_sr) and solid_angle_sr > 0.0
        # A cap of half angle a: 2 pi (1 - cos a) = 4 pi sin^2(a/2).
        radii.append(2.0 * np.arcsin(np.sqrt(min(solid_angle_sr / (4.0 * np.pi), 0.5))) if known else 0.0)
    return Instrument(*radii) if any(radii) else None


@cache
def disc_nodes(order: int) -> tuple[Array, Array]:
    """Return nodes (K, 2) on the unit disc and their weights (K,), which sum to 1.

    Parameters
    ----------
    order : int
        n: K = 4 n^2 nodes, exact for polynomials of degree 4 n - 1. 0 is the centre alone.
    """
    if order == 0:
        return np.zeros((1, 2)), np.ones(1)
    points, weights = np.polynomial.legendre.leggauss(order)
    radius = np.sqrt(0.5 * (1.0 + points))
    count = 4 * order
    # Rings turned against one another meet more of the azimuths.
    azimuth = 2.0 * np.pi / count * (np.arange(count) + 0.5 * (np.arange(order)[:, None] % 2))
    nodes = radius[:, None, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    return nodes.reshape(-1, 2), np.repeat(0.5 * weights / count, count)


def around(axis: Array, radius_rad: float, order: int) -> tuple[Array, Array]:
    """Return `disc_nodes` on caps about axes (N, 3): directions (K, N, 3) and weights (K,)."""
    nodes, weights = disc_nodes(order if radius_rad > 0.0 else 0)
    # Lambert's equal-area plane: the chord is 2 sin(a/2), and cos a = 1 - chord^2/2.
    plane = 2.0 * np.sin(0.5 * radius_rad) * nodes
    square = np.sum(np.square(plane), axis=1)
    along, across = 1.0 - 0.5 * square, np.sqrt(1.0 - 0.25 * square)[:, None] * plane
    # A frame about each axis, stable everywhere above the horizon (Duff et al. 2017).
    a = -1.0 / (1.0 + axis[:, 2])
    b = axis[:, 0] * axis[:, 1] * a
    first = np.stack([1.0 + np.square(axis[:, 0]) * a, b, -axis[:, 0]], axis=-1)
    second = np.stack([b, 1.0 + np.square(axis[:, 1]) * a, -axis[:, 1]], axis=-1)
    tilted = across[:, 0, None, None] * first + across[:, 1, None, None] * second
    return along[:, None, None] * axis + tilted, weights


@dataclass(frozen=True, eq=False)
class Spread:
    """The samples of a problem at which the model's mean over both discs is taken.

    Attributes
    ----------
    instrument : Instrument
        The discs.
    wi, wo : ndarray, shape (N, 3)
        Directions to their centres, of all samples.
    rows : ndarray of bool, shape (N,)
        Where the mean is taken; elsewhere the value at the centres is.
    order : int
        Of the rule: see `disc_nodes`.
    """

    instrument: Instrument
    wi: Array
    wo: Array
    rows: Rows
    order: int

    def some(self, rows: NDArray[np.intp]) -> Spread:
        """Return the spread of some of the samples."""
        return replace(self, wi=self.wi[rows], wo=self.wo[rows], rows=self.rows[rows])

    @cached_property
    def _nodes(self) -> list[tuple[Geometry, Array]]:
        """Pairs of nodes, in parts: geometry (k, n) and weights (k, n, 1), whose sum over all parts is 1."""
        wi, wo = self.wi[self.rows], self.wo[self.rows]
        lights, light_weights = around(wi, self.instrument.source_rad, self.order)
        cameras, camera_weights = around(wo, self.instrument.receiver_rad, self.order)
        first, second = (axis.ravel() for axis in np.indices((len(lights), len(cameras))))
        # Nodes below the horizon light nothing and see nothing.
        cosines = np.maximum(lights[..., 2], 0.0)[first] * np.maximum(cameras[..., 2], 0.0)[second]
        weights = (light_weights[first] * camera_weights[second])[:, None] * cosines
        weights /= np.sum(weights, axis=0)
        parts = np.array_split(np.arange(len(first)), max(1, weights.size // TOGETHER))
        return [
            (Geometry(lights[first[part]], cameras[second[part]]), weights[part][..., None]) for part in parts
        ]

    def average(self, model: Model, terms: dict[str, Lobe]) -> dict[str, Lobe]:
        """Put means over both discs where the rows are into a model's terms (N, M)."""
        if not self.rows.any():
            return terms
        sums: dict[str, Lobe] = {}
        for geometry, weights in self._nodes:
            for name, term in model.terms_at(geometry).items():
                value = np.sum(weights * term.value, axis=0)
                slopes = {key: np.sum(weights * slope, axis=0) for key, slope in term.slopes.items()}
                if name in sums:
                    value += sums[name].value
                    slopes = {key: slope + sums[name].slopes[key] for key, slope in slopes.items()}
                sums[name] = Lobe(value, slopes)
        return {
            name: Lobe(
                self._put(term.value, sums[name].value),
                {key: self._put(slope, sums[name].slopes[key]) for key, slope in term.slopes.items()},
            )
            for name, term in terms.items()
        }

    def _put(self, values: Array, means: Array) -> Array:
        values = np.array(np.broadcast_to(values, (len(self.rows), means.shape[-1])))
        values[self.rows] = means
        return values


@dataclass(frozen=True, eq=False)
class Gain:
    """By how much a wide lobe's mean over both discs exceeds its value at their centres: kept fixed.

    What the discs change is so little then that how it changes with the parameters does not matter: a fit
    costs what it costs without an instrument, and the gain is taken again at what it found.

    Attributes
    ----------
    instrument : Instrument
        The discs.
    share : dict of str to ndarray, shape (N, 1)
        For each of the model's terms, the mean over the value, less 1.
    """

    instrument: Instrument
    share: dict[str, Array]

    @classmethod
    def of(cls, model: Model, geometry: Geometry, instrument: Instrument) -> Gain:
        """Take the gain of one set of shapes, to the second order in the discs' radii.

        To that order the discs do not know of one another, and their gains are added.
        """
        wi, wo = geometry.wi, geometry.wo
        every, terms = np.ones(len(wi), dtype=bool), model.terms_at(geometry)
        share = {name: np.zeros((len(wi), 1)) for name in terms}
        for alone in (replace(instrument, source_rad=0.0), replace(instrument, receiver_rad=0.0)):
            for name, mean in Spread(alone, wi, wo, every, 1).average(model, terms).items():
                value = np.broadcast_to(terms[name].value, mean.value.shape)
                # Where a lobe underflows there is nothing to raise.
                share[name] += (
                    np.where(value > 0.0, mean.value / np.where(value > 0.0, value, 1.0), 1.0) - 1.0
                )
        return cls(instrument, share)

    @property
    def beyond(self) -> Gain:
        """The gain with the size of what it leaves out, of fourth order, added."""
        return replace(self, share={name: share + np.square(share) for name, share in self.share.items()})

    def some(self, rows: NDArray[np.intp]) -> Gain:
        """Return the gain of some of the samples."""
        return replace(self, share={name: share[rows] for name, share in self.share.items()})

    def average(self, model: Model, terms: dict[str, Lobe]) -> dict[str, Lobe]:  # noqa: ARG002 - as Spread
        """Raise a model's terms (N, M)."""
        return {
            name: Lobe(
                term.value * (1.0 + self.share[name]),
                {key: slope * (1.0 + self.share[name]) for key, slope in term.slopes.items()},
            )
            for name, term in terms.items()
        }


@dataclass(frozen=True, eq=False)
class Seen:
    """A model as an instrument sees it at the samples of a spread, or at directions close to theirs."""

    model: Model
    spread: Spread

    def evaluate(self, wi: Array, wo: Array) -> Array:
        """Return f_r (N, C) at as many pairs of directions as the spread has."""
        spread, geometry = replace(self.spread, wi=wi, wo=wo), Geometry(wi, wo)
        with np.errstate(under="ignore", over="ignore"):
            terms = spread.average(self.model, self.model.terms_at(geometry))
        total = sum(vars(self.model)[name] * term.value for name, term in terms.items())
        return geometry.finish(total + np.zeros((len(wi), self.model.channels)))
