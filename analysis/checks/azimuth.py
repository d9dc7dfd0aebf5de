"""Whether the azimuth is counted from the plane of incidence: the turn that makes both sides of it alike.

A surface that is the same on both sides of the plane of incidence shows f(theta_i, theta_o, phi) = f(theta_i,
theta_o, -phi). Where the azimuth between light and view has an offset d, sample and image lie at phi and
2 d - phi. The difference of ln(f + f0) between both, f0 being a tenth of the median value, is smallest at the
offset; what no sample gives is taken from a plane through its neighbours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.checks.finding import Finding, judged, not_tested
from analysis.checks.neighbours import DARK
from analysis.pairing import LARGEST_THETA, Array, Indices, Usable, isotropic_key

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

NAME, QUANTITY = "azimuth offset", "turn of the azimuth that makes both sides of the plane alike, deg"
LIMITS = (2.0, float("inf"))
LARGEST_DEG, STEP_DEG = 20.0, 1.0
MOST, FEWEST = 800, 40
"""Samples that are compared with their images: of more some are drawn."""
ASIDE = 0.02
"""Sines of azimuth and polar angle that a sample lies at least beside the plane of incidence."""
LEAST_SHARE, REACH = 0.25, 1.5
"""Share of samples that need a neighbour at their image, and how near, in usual distances of neighbours."""
BETTER = 0.7
"""Share of the difference that an offset must not leave, to be one."""
NEIGHBOURS, RIDGE, NEARNESS = 8, 1e-3, 1e-4
LARGEST_DIFFERENCE = 1.0
"""In ln f: what a difference counts at most."""


def azimuth_offset(usable: Usable) -> Finding:
    """Look for the offset of the azimuth that explains what mirrored samples differ by."""
    from scipy.spatial import cKDTree

    value = np.median(usable.f_r, axis=1) if usable.f_r.size else np.zeros(0)
    largest = np.maximum(usable.theta_i, usable.theta_o)
    kept = np.flatnonzero((value > 0.0) & (largest <= LARGEST_THETA))
    log_f = np.log(value[kept] + DARK * np.median(value[kept])) if len(kept) else value
    chosen = _beside(usable, kept)
    if len(chosen) < FEWEST:
        return not_tested(
            NAME, QUANTITY, LIMITS, len(chosen), "too few samples beside the plane of incidence"
        )
    known = cKDTree(_places(usable, kept, usable.turn[kept]))
    rows = kept[chosen]
    near = known.query(_places(usable, rows, -usable.turn[rows]))[0]
    usual = float(np.median(known.query(known.data[chosen], k=3)[0][:, 2]))
    inside = near <= REACH * usual
    if np.count_nonzero(inside) < max(FEWEST, LEAST_SHARE * len(chosen)):
        return not_tested(
            NAME, QUANTITY, LIMITS, int(inside.sum()), "views lie on one side of the plane only"
        )
    chosen, rows = chosen[inside], rows[inside]

    def difference(offset_deg: float) -> float:
        image = _places(usable, rows, 2.0 * np.radians(offset_deg) - usable.turn[rows])
        apart = np.abs(log_f[chosen] - _between(known, log_f, image))
        return float(np.mean(np.minimum(apart, LARGEST_DIFFERENCE)))

    offsets = np.arange(-LARGEST_DEG, LARGEST_DEG + 0.5 * STEP_DEG, STEP_DEG)
    apart = np.array([difference(offset) for offset in offsets])
    best, without = int(np.argmin(apart)), float(apart[len(offsets) // 2])
    offset = float(offsets[best]) if apart[best] < BETTER * without else 0.0
    return judged(
        NAME,
        QUANTITY,
        abs(offset),
        LIMITS,
        len(chosen),
        meaning="azimuths do not count from the plane of incidence, or the sample is tilted or anisotropic",
        where=f"turning views by {-offset:+g} deg takes the difference of both sides from {without:.2g} "
        f"to {apart[best]:.2g} in ln f",
    )


def _beside(usable: Usable, kept: Indices) -> Indices:
    """Return which of the kept samples are compared: they lie beside the plane of incidence."""
    low = np.minimum(np.sin(usable.theta_i[kept]), np.sin(usable.theta_o[kept]))
    beside = np.flatnonzero(np.abs(np.sin(usable.turn[kept])) * low > ASIDE)
    if len(beside) > MOST:
        beside = np.sort(np.random.default_rng(0).choice(beside, MOST, replace=False))
    return beside


def _places(usable: Usable, rows: Indices, turn: Array) -> Array:
    return isotropic_key(usable.theta_i[rows], usable.theta_o[rows], turn)


def _between(known: cKDTree, log_f: Array, places: Array) -> Array:
    """Return what planes through the neighbours of places have there, the nearest counting most."""
    distance, near = known.query(places, k=NEIGHBOURS)
    reach = np.maximum(distance[:, -1:], np.finfo(np.float64).tiny)
    columns = np.concatenate(
        [np.ones((*near.shape, 1)), (known.data[near] - places[:, None]) / reach[..., None]], axis=2
    )
    weight = 1.0 / (np.square(distance / reach) + NEARNESS)
    weighted = np.swapaxes(columns * (weight / weight.sum(axis=1, keepdims=True))[..., None], 1, 2)
    penalty = RIDGE * np.eye(columns.shape[2])
    penalty[0, 0] = 0.0
    plane = np.linalg.solve(weighted @ columns + penalty, weighted @ log_f[near][..., None])
    return np.asarray(np.clip(plane[:, 0, 0], log_f[near].min(axis=1), log_f[near].max(axis=1)))
