"""From scattered samples to the grid of a format, and what that loses.

Isotropic: a pair of directions is told by the light's polar angle and the half vector's place on a disc, with
radius sqrt(2 theta_h / pi) and azimuth relative to the light. Values are divided by their median along
theta_h before they are interpolated linearly, so that a narrow peak costs no more than a wide one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.angles import direction_to_spherical, half_vector
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

FEWEST_SAMPLES = 16
MOST_LAYERS = 64
SAME_ANGLE_RAD = 1e-4
PROFILE_BINS = 48


class Usable(NamedTuple):
    """Samples that can be exported: directions (N, 3) above the surface and finite f_r (N, C)."""

    wi: Array
    wo: Array
    f_r: Array


def usable(samples: xr.Dataset) -> Usable:
    """Choose the samples without flags whose directions and values are whole.

    Raises
    ------
    BadInput
        If fewer than 16 remain.
    """
    wi, wo, f_r = (samples[name].to_numpy() for name in ("wi", "wo", "f_r"))
    flags = samples["flags"].to_numpy() if "flags" in samples else np.zeros(f_r.shape, dtype=int)
    good = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0) & np.isfinite(f_r).all(-1) & (flags == 0).all(-1)
    if good.sum() < FEWEST_SAMPLES:
        raise BadInput(
            f"only {good.sum()} samples can be used, {FEWEST_SAMPLES} are needed",
            where="samples",
            todo="measure more directions, or write a table of samples",
        )
    return Usable(wi[good], wo[good], f_r[good])


class Scattered:
    """Linear interpolation between scattered samples of an isotropic surface.

    Parameters
    ----------
    given : Usable
        The samples. Where all lie on one side of the plane of incidence the other side mirrors them.

    Raises
    ------
    BadInput
        If the samples lie in one plane, so that nothing is known beside it.
    """

    def __init__(self, given: Usable) -> None:
        theta_i, place = _coordinates(given.wi, given.wo)
        self._radii, self._profile = _profile(np.hypot(*place.T), np.abs(given.f_r).mean(-1))
        ratio = given.f_r / self.profile(np.hypot(*place.T))[:, None]
        if (place[:, 1] >= -1e-9).all() or (place[:, 1] <= 1e-9).all():
            theta_i, ratio = np.concatenate([theta_i, theta_i]), np.concatenate([ratio, ratio])
            place = np.concatenate([place, place * [1.0, -1.0]])
        layer = np.round(theta_i / SAME_ANGLE_RAD).astype(int)
        known, counts = np.unique(layer, return_counts=True)
        self.layers = 0 < known.size <= MOST_LAYERS and counts.min() >= FEWEST_SAMPLES
        if self.layers:
            self.theta_i = np.array([theta_i[layer == one].mean() for one in known])
            self._pieces = [_Piece(place[layer == one], ratio[layer == one]) for one in known]
        else:
            self.theta_i = np.linspace(0.0, theta_i.max(), 25)
            self._pieces = [_Piece(np.column_stack([theta_i, place]), ratio)]

    def profile(self, radius: Array) -> Array:
        """Median value along the half vector's radius sqrt(2 theta_h / pi), always positive."""
        return np.exp(np.interp(radius, self._radii, self._profile))

    def __call__(self, wi: Array, wo: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Interpolate.

        Parameters
        ----------
        wi, wo : ndarray, shape (N, 3)
            Unit directions; the camera may lie below the surface, where the nearest sample's value is taken.

        Returns
        -------
        f_r : ndarray, shape (N, C)
            1/sr.
        outside : ndarray of bool, shape (N,)
            Whether the directions lie outside of the samples.
        """
        theta_i, place = _coordinates(wi, wo)
        ratio, outside = (
            self._between(theta_i, place)
            if self.layers
            else self._pieces[0](np.column_stack([theta_i, place]))
        )
        return ratio * self.profile(np.hypot(*place.T))[:, None], outside

    def _between(self, theta_i: Array, place: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Blend the two layers around each of the light's polar angles."""
        last = len(self._pieces) - 1
        below = np.clip(np.searchsorted(self.theta_i, theta_i + SAME_ANGLE_RAD, side="right") - 1, 0, last)
        above = np.minimum(below + 1, last)
        span = np.where(above > below, self.theta_i[above] - self.theta_i[below], 1.0)
        upper = np.clip((theta_i - self.theta_i[below]) / span, 0.0, 1.0)
        upper[upper * span < SAME_ANGLE_RAD] = 0.0
        ratio, outside = None, np.zeros(len(place), dtype=bool)
        for index, weight in ((below, 1.0 - upper), (above, upper)):
            for layer in np.unique(index[weight > 0.0]):
                rows = np.flatnonzero((index == layer) & (weight > 0.0))
                value, beyond = self._pieces[layer](place[rows])
                ratio = np.zeros((len(place), value.shape[1])) if ratio is None else ratio
                ratio[rows] += weight[rows, None] * value
                outside[rows] |= beyond
        assert ratio is not None  # noqa: S101 - every row has a weight
        return ratio, outside


class _Piece:
    """Linear interpolation on a Delaunay mesh; outside of it the nearest sample."""

    def __init__(self, place: Array, ratio: Array) -> None:
        from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
        from scipy.spatial import QhullError

        try:
            self._inside = LinearNDInterpolator(place, ratio)
        except QhullError:
            raise BadInput(
                "lie in one plane: nothing is known beside it",
                where="samples",
                todo="measure out of the plane too, or write a table of samples",
            ) from None
        self._nearest = NearestNDInterpolator(place, ratio)

    def __call__(self, place: Array) -> tuple[Array, NDArray[np.bool_]]:
        value = np.asarray(self._inside(place))
        outside = np.isnan(value).any(-1)
        if outside.any():
            value[outside] = self._nearest(place[outside])
        return value, outside


def _coordinates(wi: Array, wo: Array) -> tuple[Array, Array]:
    """Light's polar angle (N,) and the half vector's place on the disc (N, 2)."""
    theta_i, phi_i = direction_to_spherical(wi)
    theta_h, phi_h = direction_to_spherical(half_vector(wi, wo))
    radius, phi = np.sqrt(theta_h * (2.0 / np.pi)), phi_h - phi_i
    return theta_i, np.stack([radius * np.cos(phi), radius * np.sin(phi)], axis=-1)


def _profile(radius: Array, value: Array) -> tuple[Array, Array]:
    """Radii and the logarithms of the median value around each."""
    edges = np.linspace(0.0, radius.max() + 1e-9, PROFILE_BINS + 1)
    bin_of = np.clip(np.searchsorted(edges, radius, side="right") - 1, 0, PROFILE_BINS - 1)
    filled = np.unique(bin_of)
    radii = np.array([np.median(radius[bin_of == one]) for one in filled])
    medians = np.array([np.median(value[bin_of == one]) for one in filled])
    floor = max(1e-6 * medians.max(), np.finfo(float).tiny)
    return radii, np.log(np.maximum(medians, floor))
