"""Checks over the hemisphere of views: energy, with the coverage behind it, and holes."""

from __future__ import annotations

import numpy as np

from analysis.checks.finding import Finding, Verdict, judged, not_tested
from analysis.pairing import Indices, Usable, incidences
from rig.angles import spherical_to_direction

LARGEST_INCIDENCE_DEG = 75.0
"""Beyond it a mirror peak is cut by the horizon and an integral means little."""
SINGLE_SAMPLE = 0.1
"""Share of an integral on one sample above which the peak is taken as not resolved."""
ALBEDO_COVERAGE = 0.5


def directional_albedo(usable: Usable, chosen: Indices) -> tuple[float, float, float]:
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


def energy(usable: Usable) -> Finding:
    """Compare directional albedo with 1; only what the samples enclose is counted, so it is a lower bound."""
    name, limits = "energy", (1.0, 1.02)
    best, at, coverage, single, covered, tested = -np.inf, 0.0, 0.0, 0.0, 0.0, 0
    for incidence, chosen in incidences(usable):
        if incidence > LARGEST_INCIDENCE_DEG or len(chosen) < 4:
            continue
        albedo, share, hanging = directional_albedo(usable, chosen)
        covered = max(covered, share)
        if share < ALBEDO_COVERAGE:
            continue
        tested += 1
        if albedo > best:
            best, at, coverage, single = albedo, incidence, share, hanging
    if not tested:
        why = f"samples enclose at most {covered:.0%} of the projected hemisphere: no albedo can be told"
        return not_tested(name, "largest directional albedo", limits, 0, why)
    quantity = f"largest directional albedo, over {coverage:.0%} of the projected hemisphere"
    place = f"incidence near {at:g} deg"
    if single > SINGLE_SAMPLE and best > limits[0]:
        why = f"{single:.0%} of the integral hangs on one sample: the peak is narrower than the grid"
        return Finding(name, quantity, best, *limits, tested, Verdict.WARN, why, place)
    meaning = "more light leaves than arrives: the scale, the reference or a cosine is wrong"
    return judged(name, quantity, best, limits, tested, meaning=meaning, where=place)


def coverage(usable: Usable) -> Finding:
    """Return the largest hole: how far a view within 80 deg can be from a sample, at the best incidence."""
    from scipy.spatial import cKDTree

    name, quantity, limits = (
        "coverage",
        "largest hole of the views at the best-covered incidence, deg",
        (20.0, float("inf")),
    )
    if not len(usable.wi):
        return not_tested(name, quantity, limits, 0, "no usable samples")
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
    return judged(name, quantity, smallest, limits, len(usable.wi), meaning=meaning, where=place)
