"""Which samples of a set may be compared: exchanged, mirrored or repeated directions, found by nearness."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.angles import direction_to_spherical, spherical_to_direction, wrap

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LARGEST_THETA = np.radians(85.0)
SAME_RAD = np.radians(0.5)
FEWEST_PAIRS = 10
INCIDENCE_BIN_DEG = 5.0
OWN = ("u_noise", "u_binning")
"""Uncertainties that are independent from sample to sample."""


class Usable(NamedTuple):
    """Samples without flags: directions, values (N, C), uncertainties or None, and angles in radians.

    `u` is all that is stated; `u_own` the part that is each sample's own, where the file tells it.
    """

    wi: Array
    wo: Array
    f_r: Array
    u: Array | None
    theta_i: Array
    theta_o: Array
    phi_i: Array
    turn: Array
    """Azimuth of view less that of the light, in (-pi, pi]."""
    row: Indices
    """Number of each sample in its file."""
    u_own: Array | None = None


class Pairs(NamedTuple):
    """Indices of paired samples; `strict` where no isotropy was assumed."""

    first: Indices
    second: Indices
    strict: bool


def usable_samples(samples: xr.Dataset) -> Usable:
    """Return the samples without flags whose values are all finite."""
    keep = (samples["flags"].to_numpy() == 0).all(axis=1) & np.isfinite(samples["f_r"].to_numpy()).all(axis=1)
    wi, wo, f_r = (samples[name].to_numpy()[keep] for name in ("wi", "wo", "f_r"))
    stated = next((samples[name] for name in ("u_f_r", "u_repeatability") if name in samples), None)
    u = None if stated is None else stated.to_numpy()[keep]
    usable = usable_from(wi, wo, f_r, u, np.flatnonzero(keep))
    own = [samples[name].to_numpy()[keep] for name in OWN if name in samples]
    if not own and "u_f_r" in samples:
        own = [samples["u_f_r"].to_numpy()[keep]]
    return usable._replace(u_own=np.sqrt(sum(np.square(each) for each in own)) if own else None)


def usable_from(
    wi: Array, wo: Array, f_r: Array, u: Array | None = None, row: Indices | None = None
) -> Usable:
    """Return samples, all of them usable, with their angles."""
    (theta_i, phi_i), (theta_o, phi_o) = direction_to_spherical(wi), direction_to_spherical(wo)
    row = np.arange(len(wi)) if row is None else row
    return Usable(wi, wo, f_r, u, theta_i, theta_o, phi_i, np.asarray(wrap(phi_o - phi_i)), row)


def relative_difference(a: Array, b: Array) -> Array:
    """Return |a - b| over the larger of both sizes; 0 where both are 0."""
    largest = np.maximum(np.abs(a), np.abs(b))
    return np.asarray(np.abs(a - b) / np.where(largest > 0.0, largest, 1.0))


def reciprocal_difference(wi: Array, wo: Array, f_r: Array) -> Array:
    """Return the relative differences (P, C) of the reciprocal pairs among samples."""
    usable = usable_from(wi, wo, f_r)
    first, second, _ = reciprocal_pairs(usable)
    return relative_difference(f_r[first], f_r[second])


def isotropic_key(theta_i: Array, theta_o: Array, turn: Array) -> Array:
    """Place geometries of an isotropic sample so that near ones lie near; the light at azimuth 0."""
    light = np.stack([np.sin(theta_i), np.cos(theta_i)], axis=-1)
    return np.concatenate([light, spherical_to_direction(theta_o, turn)], axis=-1)


def nearest(known: Array, wanted: Array, within: float) -> tuple[Indices, Indices]:
    """Return the indices of wanted points that have a known one near, and of that one."""
    from scipy.spatial import cKDTree

    if not len(known):
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    distance, index = cKDTree(known).query(wanted, distance_upper_bound=within)
    found = np.flatnonzero(np.isfinite(distance))
    return found, index[found].astype(np.intp)


def once(first: Indices, second: Indices) -> tuple[Indices, Indices]:
    """Keep each unordered pair of different samples once."""
    pairs = np.sort(np.stack([first, second], axis=1)[first != second], axis=1)
    unique = np.unique(pairs, axis=0)
    return unique[:, 0], unique[:, 1]


def within_reach(usable: Usable, first: Indices, second: Indices) -> NDArray[np.bool_]:
    """Whether all angles of both samples of a pair are small enough to compare."""
    largest = np.maximum(usable.theta_i, usable.theta_o)
    return np.asarray((largest[first] <= LARGEST_THETA + 1e-9) & (largest[second] <= LARGEST_THETA + 1e-9))


def reciprocal_pairs(usable: Usable) -> Pairs:
    """Pair samples with light and view exchanged.

    Where the light has several azimuths exact pairs are preferred; else, and where these are too few, the
    sample is taken as isotropic.
    """
    tilted = usable.phi_i[usable.theta_i > SAME_RAD]
    if tilted.size and np.any(np.abs(wrap(tilted - tilted[0])) > SAME_RAD):
        known = np.concatenate([usable.wi, usable.wo], axis=1)
        first, second = once(*nearest(known, np.concatenate([usable.wo, usable.wi], axis=1), SAME_RAD))
        reach = within_reach(usable, first, second)
        if np.count_nonzero(reach) >= FEWEST_PAIRS:
            return Pairs(first[reach], second[reach], strict=True)
    # Only the relative azimuth counts, and both sides of the plane of incidence are alike.
    known = isotropic_key(usable.theta_i, usable.theta_o, np.abs(usable.turn))
    wanted = isotropic_key(usable.theta_o, usable.theta_i, np.abs(usable.turn))
    first, second = once(*nearest(known, wanted, SAME_RAD))
    # Near theta_i = theta_o a neighbour on the grid would pass for the partner.
    reach = within_reach(usable, first, second) & (
        np.abs(usable.theta_i - usable.theta_o)[first] > 2.0 * SAME_RAD
    )
    return Pairs(first[reach], second[reach], strict=False)


def paired_by(usable: Usable, turn: Array, chosen: NDArray[np.bool_]) -> tuple[Indices, Indices]:
    """Pair chosen samples with those of the same polar angles whose relative azimuth is `turn`."""
    known = isotropic_key(usable.theta_i, usable.theta_o, usable.turn)
    wanted = isotropic_key(usable.theta_i, usable.theta_o, turn)
    inside = np.flatnonzero(chosen)
    found, index = nearest(known, wanted[inside], SAME_RAD)
    first, second = once(inside[found].astype(np.intp), index)
    keep = within_reach(usable, first, second)
    return first[keep], second[keep]


def incidences(usable: Usable) -> list[tuple[float, Indices]]:
    """Return the bins of incidence that have samples: the middle angle in degrees, and the samples."""
    bins = np.round(np.degrees(usable.theta_i) / INCIDENCE_BIN_DEG).astype(np.intp)
    return [(float(number) * INCIDENCE_BIN_DEG, np.flatnonzero(bins == number)) for number in np.unique(bins)]
