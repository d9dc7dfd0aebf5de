"""Checks that compare samples with one another: exchanged, mirrored, turned, repeated."""

from __future__ import annotations

import numpy as np

from analysis.checks.finding import (
    Finding,
    compared,
    far_apart,
    judged,
    median_by_channel,
    not_tested,
    place,
)
from analysis.pairing import (
    FEWEST_PAIRS,
    SAME_RAD,
    Pairs,
    Usable,
    incidences,
    isotropic_key,
    once,
    paired_by,
    relative_difference,
    within_reach,
)
from rig.angles import wrap

COPY_RAD = 1e-6
HELPS = 0.5
"""A cosine is suspected where taking it out leaves less than this share of the violation."""


def reciprocity(usable: Usable, pairs: Pairs) -> Finding:
    """Compare samples with light and view exchanged, and say whether a cosine explains the difference."""
    name, quantity, limits = "reciprocity", "median difference of reciprocal pairs", (0.10, 0.30)
    first, second, strict = pairs
    if len(first) < FEWEST_PAIRS:
        why = f"only {len(first)} pairs with light and view exchanged"
        return not_tested(name, quantity, limits, len(first), why)
    a, b = usable.f_r[first], usable.f_r[second]
    difference = relative_difference(a, b)
    value = median_by_channel(difference)
    worst_pair = int(np.argmax(np.median(difference, axis=1)))
    meaning = "light and view may be exchanged or mirrored, an angle may have an offset, or noise is large"
    for text, power in (
        ("a factor cos(theta_o) seems to be inside", -1),
        ("values seem to be divided by cos(theta_o)", 1),
    ):
        cos_a, cos_b = (np.cos(usable.theta_o[index])[:, None] ** power for index in (first, second))
        without = median_by_channel(relative_difference(a * cos_a, b * cos_b))
        if without < HELPS * value:
            meaning = f"{text}: without it {without:.1%}"
    if not strict:
        meaning += "; isotropy assumed"
    return judged(
        name,
        quantity,
        value,
        limits,
        len(first),
        meaning=meaning,
        where=place(usable, first[worst_pair]),
        samples=far_apart(usable, (first, second), difference, limits),
    )


def levels(usable: Usable, pairs: Pairs) -> Finding:
    """Compare each incidence with the others through reciprocal pairs: a lamp that drifted, a lost gain."""
    name, limits = "levels", (0.25, 0.50)
    quantity = "largest median step of one incidence against its reciprocal pairs"
    first, second, strict = pairs
    size = np.maximum(np.abs(usable.f_r[first]), np.abs(usable.f_r[second]))
    step = (usable.f_r[first] - usable.f_r[second]) / np.where(size > 0.0, size, 1.0)
    largest, count, where, concerned = -1.0, 0, "", first[:0]
    for incidence, chosen in incidences(usable):
        one, other = np.isin(first, chosen), np.isin(second, chosen)
        against = np.concatenate([step[one & ~other], -step[other & ~one]])
        if len(against) < FEWEST_PAIRS:
            continue
        count += 1
        middle = float(np.median(against))
        if abs(middle) > largest:
            largest, concerned = abs(middle), chosen
            where = (
                f"incidence near {incidence:g} deg is {abs(middle):.0%} too {'high' if middle > 0 else 'low'}"
            )
    if not count:
        why = f"no incidence has {FEWEST_PAIRS} reciprocal pairs with others"
        return not_tested(name, quantity, limits, len(first), why)
    meaning = "lamp, gain or exposure changed from one incidence to the next, or a cosine is inside"
    return judged(
        name,
        quantity,
        largest,
        limits,
        count,
        meaning=meaning + ("" if strict else "; isotropy assumed"),
        where=where,
        samples=usable.row[concerned] if largest > limits[0] else None,
    )


def mirror_symmetry(usable: Usable) -> Finding:
    """Compare both sides of the plane of incidence."""
    # In the plane of incidence, and where light or view stand on the normal, a sample is its own image.
    aside = np.abs(np.sin(usable.turn)) * np.minimum(np.sin(usable.theta_i), np.sin(usable.theta_o)) > 0.05
    return compared(
        "mirror symmetry",
        "median difference across the plane of incidence",
        (0.10, 0.30),
        usable,
        paired_by(usable, -usable.turn, aside),
        meaning="the sample is tilted or anisotropic, or the azimuth has an offset",
        why_not="too few samples on both sides of the plane of incidence",
    )


def isotropy(usable: Usable) -> Finding:
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
    return compared(
        "isotropy",
        "median difference when the sample is turned",
        (0.10, float("inf")),
        usable,
        pairs,
        meaning="the sample is anisotropic or not uniform: isotropic models will not fit",
        why_not="the light has one azimuth only, or no geometry is repeated at another one",
    )


def repeats(usable: Usable) -> tuple[Finding, Finding]:
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
    duplicates = judged(
        "duplicates",
        "share of samples that are copies of another",
        share,
        (0.0, 0.5),
        len(copies),
        meaning="rows were exported twice: they count double in a fit",
        where=place(usable, copies[0, 0]) if len(copies) else "",
        samples=usable.row[copies[:, 1]],
    )
    repeatability = compared(
        "repeatability",
        "median difference of repeated poses",
        (0.05, 0.20),
        usable,
        (repeats[:, 0], repeats[:, 1]),
        meaning="lamp, camera or sample changed between repeats: the uncertainty is at least this",
        why_not="too few poses are repeated",
    )
    return duplicates, repeatability


def noise(usable: Usable, pairs: Pairs) -> Finding:
    """Compare the scatter of reciprocal pairs with the stated uncertainty."""
    name, quantity, limits = "noise", "scatter of reciprocal pairs over stated uncertainty", (2.0, 5.0)
    first, second, _ = pairs
    if usable.u is None:
        return not_tested(name, quantity, limits, 0, "the file states no uncertainty")
    if len(first) < FEWEST_PAIRS:
        return not_tested(name, quantity, limits, len(first), "too few reciprocal pairs")
    total = np.hypot(usable.u[first], usable.u[second])
    residual = np.abs(usable.f_r[first] - usable.f_r[second]) / np.where(total > 0.0, total, np.inf)
    # 1.4826 times the median of |z| is the standard deviation of a normal distribution.
    value = float(1.4826 * np.median(residual))
    where = place(usable, first[int(np.argmax(np.median(residual, axis=1)))])
    return judged(
        name,
        quantity,
        value,
        limits,
        len(first),
        meaning="the stated uncertainty is too small",
        where=where,
        samples=far_apart(usable, (first, second), residual, limits),
    )
