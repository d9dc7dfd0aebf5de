"""What each sample should be, by those around it: for outliers, and for noise that is smaller than stated.

Around each sample a plane is laid through ln(f + f0) of its neighbours at nearly the same angles of incidence
and view and azimuth between them (Cleveland 1979: locally weighted regression, robust), f0 being a tenth of
the median value, below which darkness rules. A peak between two samples departs from the plane too, and so do
the samples around it: a sample is an outlier where it departs from the plane and from its neighbours' median
much further than these do themselves, and than nearly all samples of the file do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis.checks.finding import Finding, judged, not_tested, place
from analysis.pairing import LARGEST_THETA, Array, Indices, Usable, isotropic_key

if TYPE_CHECKING:
    from numpy.typing import NDArray

NEIGHBOURS, NEAREST = 12, 8
"""Samples that a plane is laid through, and those of which the median is taken."""
FEWEST = 60
MOST = 20_000
"""Samples that are looked at; of more some are drawn, with all others as their neighbours."""
DARK = 0.1
ROUNDS = 5
BREADTH, RIDGE = 1.5, 0.01
"""Median residuals beyond which a neighbour's pull ends; what keeps planes flat that few points carry."""
LEAST_FACTOR = 3.0
"""No sample is an outlier whose value is less than this times too large or too small."""
FLOOR, LEAST_SCORE, STANDS_OUT = 0.1, 5.0, 3.0
"""Least departure of neighbours; an outlier's score at least; how many times that of nearly all others."""
NEARLY_ALL = 0.98
MAD = 1.4826
LEAST_RESIDUAL = 0.02
SAME_PLACE = 1e-9
OUTLIERS = ("outliers", f"share of samples a factor {LEAST_FACTOR:g} and more off their neighbours")
OVERSTATED = ("overstated noise", "stated uncertainty over scatter among neighbours")


class Surroundings(NamedTuple):
    """What neighbours say of samples.

    Attributes
    ----------
    samples : ndarray of int, shape (M,)
        Those that were looked at.
    departure : ndarray, shape (M,)
        ln(f + f0) less what the plane through the neighbours has there.
    score : ndarray, shape (M,)
        How many times further a sample is off than is usual around it.
    far : ndarray of bool, shape (M,)
        Whether its value is off by more than `LEAST_FACTOR`.
    dark : float
        f0, 1/sr.
    """

    samples: Indices
    departure: Array
    score: Array
    far: NDArray[np.bool_]
    dark: float


def surroundings(usable: Usable) -> Surroundings | None:
    """Compare samples with their neighbours; None where they are too few."""
    from scipy.spatial import cKDTree

    value = np.median(usable.f_r, axis=1) if usable.f_r.size else np.zeros(0)
    kept = np.flatnonzero((np.maximum(usable.theta_i, usable.theta_o) <= LARGEST_THETA) & (value > 0.0))
    if len(kept) < FEWEST:
        return None
    if len(kept) > MOST:
        kept = np.sort(np.random.default_rng(0).choice(kept, MOST, replace=False))
    dark = DARK * float(np.median(value[kept]))
    log_f = np.log(value[kept] + dark)
    places = isotropic_key(usable.theta_i[kept], usable.theta_o[kept], usable.turn[kept])
    distance, near = cKDTree(places).query(places, k=NEIGHBOURS + 1)
    distance, near = distance[:, 1:], near[:, 1:]
    reach = np.maximum(distance[:, -1:, None], SAME_PLACE)
    level, left = _planes((places[near] - places[:, None]) / reach, log_f[near])
    departure = log_f - level
    usual = np.maximum(_second_largest(left), BREADTH * np.median(np.abs(departure)[near], axis=1))
    nearest = log_f[near[:, :NEAREST]]
    middle = np.median(nearest, axis=1)
    simple = log_f - middle
    spread = np.maximum(
        _second_largest(nearest - middle[:, None]), np.median(np.abs(simple)[near[:, :NEAREST]], axis=1)
    )
    score = np.sqrt(np.abs(departure) / np.maximum(usual, FLOOR) * np.abs(simple) / np.maximum(spread, FLOOR))
    far = np.minimum(np.abs(departure), np.abs(simple)) > np.log(LEAST_FACTOR)
    return Surroundings(kept, departure, score, far, dark)


def outliers(usable: Usable, around: Surroundings | None) -> Finding:
    """Name samples far off all of their neighbours: a spark, a wrong exposure, a shadow, a digit lost."""
    name, quantity = OUTLIERS
    limits = (0.0, 0.02)
    if around is None:
        return not_tested(name, quantity, limits, len(usable.wi), f"fewer than {FEWEST} samples above 0")
    limit = max(LEAST_SCORE, STANDS_OUT * float(np.quantile(around.score, NEARLY_ALL)))
    found = np.flatnonzero(around.far & (around.score > limit))
    where = ""
    if found.size:
        most = found[np.argmax(around.score[found])]
        factor = np.exp(np.abs(around.departure[most]))
        side = "large" if around.departure[most] > 0.0 else "small"
        where = f"{place(usable, around.samples[most])}: {factor:.3g} times too {side}"
    return judged(
        name,
        quantity,
        len(found) / len(around.samples),
        limits,
        len(found),
        meaning="single samples are wrong (a shadow, a spark, a lost digit or gain), or flakes glitter",
        where=where,
        samples=usable.row[around.samples[found]],
    )


def overstated(usable: Usable, around: Surroundings | None) -> Finding:
    """Compare the stated uncertainty of single samples with what they scatter by about their neighbours."""
    name, quantity = OVERSTATED
    limits = (2.0, float("inf"))
    if usable.u_own is None:
        return not_tested(name, quantity, limits, 0, "the file states no uncertainty of single samples")
    if around is None:
        return not_tested(name, quantity, limits, len(usable.wi), f"fewer than {FEWEST} samples above 0")
    value = np.median(usable.f_r[around.samples], axis=1) + around.dark
    stated = np.median(usable.u_own[around.samples], axis=1) / value
    scatter = MAD * float(np.median(np.abs(around.departure)))
    # What is curved between samples adds to the scatter, so that the ratio is the least there can be.
    ratio = float(np.median(stated)) / scatter if scatter > 0.0 else float("inf")
    most = int(np.argmax(stated))
    return judged(
        name,
        quantity,
        ratio,
        limits,
        len(around.samples),
        meaning="the stated uncertainty is too large, or samples share it, while fits weigh it as noise; "
        "or values were smoothed, or come from a formula",
        where=f"most at {place(usable, around.samples[most])}",
    )


def _planes(offsets: Array, values: Array) -> tuple[Array, Array]:
    """Lay planes through values (M, K) at offsets (M, K, D); return them at offset 0, and the residuals."""
    columns = np.concatenate([np.ones((*values.shape, 1)), offsets], axis=2)
    penalty = RIDGE * values.shape[1] * np.eye(columns.shape[2])
    penalty[0, 0] = 0.0
    weight, left = np.ones_like(values), values
    level = np.zeros(len(values))
    for _ in range(ROUNDS):
        weighted = np.swapaxes(columns * weight[..., None], 1, 2)
        plane = np.linalg.solve(weighted @ columns + penalty, weighted @ values[..., None])
        left = values - (columns @ plane)[..., 0]
        size = BREADTH * np.median(np.abs(left), axis=1, keepdims=True) + LEAST_RESIDUAL
        weight = 1.0 / np.maximum(np.abs(left) / size, 1.0)
        level = plane[:, 0, 0]
    return level, left


def _second_largest(values: Array) -> Array:
    """Return the second largest size in each row (M, K): the largest may be an outlier itself."""
    return np.asarray(np.partition(np.abs(values), -2, axis=1)[:, -2])
