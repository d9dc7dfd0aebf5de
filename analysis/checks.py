"""Checks of BRDF samples: what physics or arithmetic says about a file, before anybody believes it.

Each check gives a number, its thresholds, a verdict, what it may mean and where to look. A check that the
samples do not allow says so instead of passing. Relative differences are |a - b| / max(|a|, |b|), medians
over pairs and channels. Pairs are found by direction; where no exact reciprocal pair exists the sample is
taken as isotropic and the finding says so. Angles beyond 85 deg are left out of the comparisons.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from analysis.pairing import (
    FEWEST_PAIRS,
    SAME_RAD,
    Array,
    Indices,
    Pairs,
    Usable,
    incidences,
    isotropic_key,
    once,
    paired_by,
    reciprocal_pairs,
    relative_difference,
    usable_samples,
    within_reach,
)
from rig.angles import spherical_to_direction, wrap

if TYPE_CHECKING:
    import xarray as xr

COPY_RAD = 1e-6
LARGEST_INCIDENCE_DEG = 75.0
"""Beyond it a mirror peak is cut by the horizon and an integral means little."""
SINGLE_SAMPLE = 0.1
"""Share of an integral on one sample above which the peak is taken as not resolved."""
ALBEDO_COVERAGE = 0.5
HELPS = 0.5
"""A cosine is suspected where taking it out leaves less than this share of the violation."""


class Verdict(Enum):
    """What a check says; in order of gravity."""

    PASS = "pass"  # noqa: S105 - a verdict, no password
    NOT_TESTED = "not tested"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True)
class Finding:
    """One check's outcome.

    Attributes
    ----------
    name, quantity : str
        The check, and what its number is.
    value : float
        The number; NaN where not tested.
    warn, fail : float
        The verdict is worse where the number exceeds these.
    count : int
        Pairs or samples behind the number.
    verdict : Verdict
        The outcome.
    meaning, where : str
        What it may mean, and where to look.
    """

    name: str
    quantity: str
    value: float
    warn: float
    fail: float
    count: int
    verdict: Verdict
    meaning: str = ""
    where: str = ""


def check(samples: xr.Dataset) -> list[Finding]:
    """Run every check.

    Parameters
    ----------
    samples : xarray.Dataset
        Samples, see `analysis.samples`.

    Returns
    -------
    list of Finding
        One for each check, in a fixed order.
    """
    usable = usable_samples(samples)
    reciprocal = reciprocal_pairs(usable)
    return [
        _reciprocity(usable, reciprocal),
        _energy(usable),
        _mirror_symmetry(usable),
        _isotropy(usable),
        *_repeats(usable),
        _negatives(usable),
        _clipped(samples),
        _coverage(usable),
        _noise(usable, reciprocal),
    ]


def worst(findings: list[Finding]) -> Verdict:
    """Return the gravest verdict; what was not tested counts as passed."""
    order = [Verdict.PASS, Verdict.NOT_TESTED, Verdict.WARN, Verdict.FAIL]
    gravest = max((finding.verdict for finding in findings), key=order.index, default=Verdict.PASS)
    return Verdict.PASS if gravest is Verdict.NOT_TESTED else gravest


def _judged(
    name: str,
    quantity: str,
    value: float,
    limits: tuple[float, float],
    count: int,
    *,
    meaning: str,
    where: str,
) -> Finding:
    """Compare a number with its thresholds; the meaning is told only where it exceeds one."""
    warn, fail = limits
    verdict = Verdict.FAIL if value > fail else Verdict.WARN if value > warn else Verdict.PASS
    told = ("", "") if verdict is Verdict.PASS else (meaning, where)
    return Finding(name, quantity, value, warn, fail, count, verdict, *told)


def _not_tested(name: str, quantity: str, limits: tuple[float, float], count: int, why: str) -> Finding:
    return Finding(name, quantity, float("nan"), *limits, count, Verdict.NOT_TESTED, why)


def _median_by_channel(difference: Array) -> float:
    return float(np.median(difference)) if difference.size else float("nan")


def _reciprocity(usable: Usable, pairs: Pairs) -> Finding:
    name, quantity, limits = "reciprocity", "median difference of reciprocal pairs", (0.10, 0.30)
    first, second, strict = pairs
    if len(first) < FEWEST_PAIRS:
        why = f"only {len(first)} pairs with light and view exchanged"
        return _not_tested(name, quantity, limits, len(first), why)
    a, b = usable.f_r[first], usable.f_r[second]
    difference = relative_difference(a, b)
    value = _median_by_channel(difference)
    worst_pair = int(np.argmax(np.median(difference, axis=1)))
    meaning = "light and view may be exchanged or mirrored, an angle may have an offset, or noise is large"
    for text, power in (
        ("a factor cos(theta_o) seems to be inside", -1),
        ("values seem to be divided by cos(theta_o)", 1),
    ):
        cos_a, cos_b = (np.cos(usable.theta_o[index])[:, None] ** power for index in (first, second))
        without = _median_by_channel(relative_difference(a * cos_a, b * cos_b))
        if without < HELPS * value:
            meaning = f"{text}: without it {without:.1%}"
    if not strict:
        meaning += "; isotropy assumed"
    return _judged(
        name, quantity, value, limits, len(first), meaning=meaning, where=_place(usable, first[worst_pair])
    )


def _place(usable: Usable, index: np.intp | int) -> str:
    theta_i, theta_o, turn = (np.degrees(x[index]) for x in (usable.theta_i, usable.theta_o, usable.turn))
    return f"theta_i {theta_i:.1f}, theta_o {theta_o:.1f}, azimuth between them {turn:.1f} deg"


def _albedo(usable: Usable, chosen: Indices) -> tuple[float, float, float]:
    """Integrate f_r over the projected hemisphere, linear between samples, both sides of the plane alike.

    Returns the largest channel's albedo over what the samples enclose, the share of the projected hemisphere
    that this is, and the largest share of the integral that hangs on one sample.
    """
    from scipy.spatial import Delaunay, QhullError

    views = spherical_to_direction(usable.theta_o[chosen], np.abs(usable.turn[chosen]))[:, :2]
    points, first = np.unique(
        np.round(np.concatenate([views, views * [1.0, -1.0]]), 9), axis=0, return_index=True
    )
    try:
        triangles = Delaunay(points).simplices
    except (QhullError, ValueError):
        return float("nan"), 0.0, 1.0
    corners = points[triangles]
    side_a, side_b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(side_a[:, 0] * side_b[:, 1] - side_a[:, 1] * side_b[:, 0])
    values = np.concatenate([usable.f_r[chosen]] * 2)[first]
    owned = np.bincount(triangles.ravel(), np.repeat(area / 3.0, 3), len(points))
    parts = values * owned[:, None]
    albedo = parts.sum(axis=0)
    channel = int(np.argmax(albedo))
    single = float(parts[:, channel].max() / albedo[channel]) if albedo[channel] > 0.0 else 1.0
    return float(albedo[channel]), float(area.sum() / np.pi), single


def _energy(usable: Usable) -> Finding:
    """Compare directional albedo with 1; only what the samples enclose is counted, so it is a lower bound."""
    name, limits = "energy", (1.0, 1.02)
    best, at, coverage, single, covered, tested = -np.inf, 0.0, 0.0, 0.0, 0.0, 0
    for incidence, chosen in incidences(usable):
        if incidence > LARGEST_INCIDENCE_DEG or len(chosen) < 4:
            continue
        albedo, share, hanging = _albedo(usable, chosen)
        covered = max(covered, share)
        if share < ALBEDO_COVERAGE:
            continue
        tested += 1
        if albedo > best:
            best, at, coverage, single = albedo, incidence, share, hanging
    if not tested:
        why = f"samples enclose at most {covered:.0%} of the projected hemisphere: no albedo can be told"
        return _not_tested(name, "largest directional albedo", limits, 0, why)
    quantity = f"largest directional albedo, over {coverage:.0%} of the projected hemisphere"
    place = f"incidence near {at:g} deg"
    if single > SINGLE_SAMPLE and best > limits[0]:
        why = f"{single:.0%} of the integral hangs on one sample: the peak is narrower than the grid"
        return Finding(name, quantity, best, *limits, tested, Verdict.WARN, why, place)
    meaning = "more light leaves than arrives: the scale, the reference or a cosine is wrong"
    return _judged(name, quantity, best, limits, tested, meaning=meaning, where=place)


def _compared(
    name: str,
    quantity: str,
    limits: tuple[float, float],
    usable: Usable,
    pairs: tuple[Indices, Indices],
    *,
    meaning: str,
    why_not: str,
) -> Finding:
    first, second = pairs
    if len(first) < FEWEST_PAIRS:
        return _not_tested(name, quantity, limits, len(first), why_not)
    difference = relative_difference(usable.f_r[first], usable.f_r[second])
    place = _place(usable, first[int(np.argmax(np.median(difference, axis=1)))])
    return _judged(
        name, quantity, _median_by_channel(difference), limits, len(first), meaning=meaning, where=place
    )


def _mirror_symmetry(usable: Usable) -> Finding:
    # In the plane of incidence, and where light or view stand on the normal, a sample is its own image.
    aside = np.abs(np.sin(usable.turn)) * np.minimum(np.sin(usable.theta_i), np.sin(usable.theta_o)) > 0.05
    return _compared(
        "mirror symmetry",
        "median difference across the plane of incidence",
        (0.10, 0.30),
        usable,
        paired_by(usable, -usable.turn, aside),
        meaning="the sample is tilted or anisotropic, or the azimuth has an offset",
        why_not="too few samples on both sides of the plane of incidence",
    )


def _isotropy(usable: Usable) -> Finding:
    """Compare geometries that differ by a turn of the sample only."""
    from scipy.spatial import cKDTree

    key = isotropic_key(usable.theta_i, usable.theta_o, usable.turn)
    away = np.minimum(usable.theta_i, usable.theta_o) > np.radians(2.0)
    inside = np.flatnonzero(away)
    neighbours = min(8, len(inside))
    pairs = (np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp))
    if neighbours > 1:
        _, index = cKDTree(key[inside]).query(
            key[inside], k=neighbours, distance_upper_bound=SAME_RAD, workers=1
        )
        row, column = np.nonzero(index[:, 1:] < len(inside))
        first, second = once(inside[row], inside[index[:, 1:][row, column]])
        keep = within_reach(usable, first, second)
        keep &= np.abs(wrap(usable.phi_i[first] - usable.phi_i[second])) > np.radians(5.0)
        pairs = first[keep], second[keep]
    return _compared(
        "isotropy",
        "median difference when the sample is turned",
        (0.10, float("inf")),
        usable,
        pairs,
        meaning="the sample is anisotropic or not uniform: isotropic models will not fit",
        why_not="the light has one azimuth only, or no geometry is repeated at another one",
    )


def _repeats(usable: Usable) -> tuple[Finding, Finding]:
    """Look at poses that occur more than once: copies of a row, and honest repeats."""
    from scipy.spatial import cKDTree

    pairs = np.zeros((0, 2), dtype=np.intp)
    if len(usable.wi):
        directions = np.concatenate([usable.wi, usable.wo], axis=1)
        distance, index = cKDTree(directions).query(directions, k=2)
        near = np.flatnonzero(distance[:, 1] <= COPY_RAD)
        pairs = np.stack(once(near, index[near, 1].astype(np.intp)), axis=1)
    same = (usable.f_r[pairs[:, 0]] == usable.f_r[pairs[:, 1]]).all(axis=1)
    copies, repeats = pairs[same], pairs[~same]
    share = len(copies) / max(len(usable.wi), 1)
    duplicates = _judged(
        "duplicates",
        "share of samples that are copies of another",
        share,
        (0.0, 0.5),
        len(copies),
        meaning="rows were exported twice: they count double in a fit",
        where=_place(usable, copies[0, 0]) if len(copies) else "",
    )
    repeatability = _compared(
        "repeatability",
        "median difference of repeated poses",
        (0.05, 0.20),
        usable,
        (repeats[:, 0], repeats[:, 1]),
        meaning="lamp, camera or sample changed between repeats: the uncertainty is at least this",
        why_not="too few poses are repeated",
    )
    return duplicates, repeatability


def _negatives(usable: Usable) -> Finding:
    negative = usable.f_r < 0.0
    share = float(negative.mean()) if negative.size else 0.0
    lowest = int(np.argmin(usable.f_r.min(axis=1))) if negative.any() else 0
    return _judged(
        "negatives",
        "share of negative values",
        share,
        (0.001, 0.10),
        int(np.count_nonzero(negative)),
        meaning="noise about a dark sample, or too much was subtracted: keep them, with their uncertainty",
        where=_place(usable, lowest) if negative.any() else "",
    )


def _clipped(samples: xr.Dataset) -> Finding:
    """Count values that all equal the smallest: a floor that somebody put there. Flagged ones count."""
    values = samples["f_r"].to_numpy()
    finite = values[np.isfinite(values)]
    floor = float(finite.min()) if finite.size else 0.0
    count = int(np.count_nonzero(finite == floor))
    # One smallest value is no floor, and a constant is a model, not a clipped measurement.
    clipped = count if count >= 3 and np.any(finite != floor) else 0
    return _judged(
        "clipped values",
        "share of values that equal the smallest",
        clipped / max(finite.size, 1),
        (0.01, 0.20),
        clipped,
        meaning=f"values were clipped at {floor:g}, or a model ends there: dark samples may be biased",
        where=f"f_r = {floor:g}",
    )


def _coverage(usable: Usable) -> Finding:
    """Return the largest hole: how far a view within 80 deg can be from a sample, at the best incidence."""
    from scipy.spatial import cKDTree

    name, quantity, limits = (
        "coverage",
        "largest hole of the views at the best-covered incidence, deg",
        (20.0, float("inf")),
    )
    if not len(usable.wi):
        return _not_tested(name, quantity, limits, 0, "no usable samples")
    theta, turn = np.meshgrid(np.radians(np.arange(0.0, 81.0, 4.0)), np.radians(np.arange(0.0, 181.0, 6.0)))
    wanted = spherical_to_direction(theta.ravel(), turn.ravel())
    smallest, place = np.inf, ""
    for incidence, chosen in incidences(usable):
        views = spherical_to_direction(usable.theta_o[chosen], np.abs(usable.turn[chosen]))
        distance, _ = cKDTree(views).query(wanted)
        hole = int(np.argmax(distance))
        size = float(np.degrees(2.0 * np.arcsin(min(distance[hole] / 2.0, 1.0))))
        if size < smallest:
            smallest = size
            at_theta, at_turn = np.degrees(theta.ravel()[hole]), np.degrees(turn.ravel()[hole])
            place = f"incidence near {incidence:g}: about theta_o {at_theta:.0f}, azimuth {at_turn:.0f} deg"
    in_plane = bool(np.all(np.abs(np.sin(usable.turn)) * np.sin(usable.theta_o) < 0.02))
    meaning = "in the plane of incidence only: no albedo" if in_plane else "views are missing there"
    return _judged(name, quantity, smallest, limits, len(usable.wi), meaning=meaning, where=place)


def _noise(usable: Usable, pairs: Pairs) -> Finding:
    """Compare the scatter of reciprocal pairs with the stated uncertainty."""
    name, quantity, limits = "noise", "scatter of reciprocal pairs over stated uncertainty", (2.0, 5.0)
    first, second, _ = pairs
    if usable.u is None:
        return _not_tested(name, quantity, limits, 0, "the file states no uncertainty")
    if len(first) < FEWEST_PAIRS:
        return _not_tested(name, quantity, limits, len(first), "too few reciprocal pairs")
    total = np.hypot(usable.u[first], usable.u[second])
    residual = np.abs(usable.f_r[first] - usable.f_r[second]) / np.where(total > 0.0, total, np.inf)
    # 1.4826 times the median of |z| is the standard deviation of a normal distribution.
    value = float(1.4826 * np.median(residual))
    place = _place(usable, first[int(np.argmax(np.median(residual, axis=1)))])
    return _judged(
        name, quantity, value, limits, len(first), meaning="the stated uncertainty is too small", where=place
    )
