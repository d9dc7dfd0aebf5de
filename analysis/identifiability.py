"""What the samples cannot tell: parameters that trade for one another, and lobes that fall between samples.

A covariance speaks of noise alone. It is small for a width that a grid never resolved, and it says nothing of
the form that the lobe might have had between two samples. The checks here look at the geometry too.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.equations import Problem
from analysis.models.base import Geometry
from rig.angles import from_half_difference

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from analysis.losses import Loss
    from analysis.solver import Solution

Array = NDArray[np.float64]

UNDETERMINED = 0.5
"""Relative standard uncertainty of a shape (of ior - 1) from which on the samples do not determine it."""
ALIKE = 0.95
"""Correlation of kd and the specular part's size from which on they trade."""
TRADE = 0.98
"""Correlation of ks and the facets' reflectance from which on only their product is known."""
RESOLVED = 0.2
"""Share of a lobe's half-width by which half vectors must differ to count as two."""
FEWEST_INSIDE = 2
"""Distinct half vectors that must lie within the half-width: the top, and one on the flank."""
NARROWEST = 0.42
"""Half-width of a lobe, in steps of the grid of directions, that a grid still resolves: half a step moves the
half vector by a quarter to a half of it."""
NEAR_TOP_RAD = np.radians(20.0)
"""Angle of the half vector to the normal within which the grid's step counts."""
GROUPS = 8
"""Directions of light that the grid's step is taken from."""
MISFIT = 2.0
"""Chi-square per degree of freedom from which on model or uncertainties do not describe the samples."""
NORMAL_REFLECTANCE = ("ior", "f0")
"""Parameters that set the reflectance of facets at normal incidence."""


class Kind(StrEnum):
    """What is the matter."""

    AT_BOUND = "at-bound"
    NOT_DETERMINED = "not-determined"
    NARROW_LOBE = "narrow-lobe"
    NO_LOBE = "no-lobe"
    KD_KS = "kd-ks"
    KS_F0 = "ks-f0"
    MISFIT = "misfit"


@dataclass(frozen=True)
class Caution:
    """Something that a person should know before using a fit's numbers.

    Attributes
    ----------
    kind : Kind
        For scripts.
    parameters : tuple of str
        Which parameters it is about; empty for the whole fit.
    text : str
        For people.
    """

    kind: Kind
    parameters: tuple[str, ...]
    text: str


def half_width(problem: Problem, shapes: Array) -> float:
    """Angle of the half vector to the normal, in radians, at which a lobe falls to half of its top.

    Parameters
    ----------
    problem : Problem
        The model; its directions do not matter.
    shapes : ndarray, shape (S,)
        Shapes in search coordinates.

    Returns
    -------
    float
        The smaller one of two planes, at an angle of 20 deg between half vector and light; pi/2 for a lobe
        that nowhere falls so far.
    """
    theta_h = np.concatenate([[0.0], np.geomspace(1e-4, 1.5, 400)])
    widths = []
    for phi_h in (0.0, 0.5 * np.pi):
        # The light moves at right angles to the half vector's tilt, so that no cosine changes fast.
        wi, wo = from_half_difference(theta_h, phi_h, np.radians(20.0), 0.5 * np.pi)
        lobe = Problem(problem.model, Geometry(wi, wo), 1).terms(shapes[None]).lobe[0]
        below = np.flatnonzero(lobe < 0.5 * lobe[0])
        widths.append(float(theta_h[below[0]]) if below.size else 0.5 * np.pi)
    return min(widths)


def about_the_lobe(problem: Problem, loss: Loss, solution: Solution) -> list[Caution]:
    """Say whether there is a lobe, and whether samples lie on enough of it.

    A lobe narrower than the samples' grid is seen at its top alone, or on the tail that the model's formula
    gives it. Its width then comes from nowhere, with a small uncertainty.

    Parameters
    ----------
    problem : Problem
        Directions and model.
    loss : Loss
        The data, arrays (N, C).
    solution : Solution
        The fit.

    Returns
    -------
    list of Caution
    """
    if not problem.has_lobe or not problem.shapes:
        return []
    if not np.any(solution.ks > 0.0):
        return [Caution(Kind.NO_LOBE, ("ks",), "the samples show no specular lobe")]
    name = problem.shapes[0].name
    width = half_width(problem, solution.shapes)
    used = np.any(loss.used, axis=1)
    wi, wo = problem.geometry.wi[used], problem.geometry.wo[used]
    theta_h = np.arctan(np.sqrt(problem.geometry.tan2_h[used, 0]))
    inside = np.unique(np.round(theta_h[theta_h < width] / (RESOLVED * width))).size
    step = grid_step(wi, wo, theta_h)
    falls = f"the lobe falls to half within {np.degrees(width):.2g} deg"
    if inside < FEWEST_INSIDE:
        samples = f"the samples have {inside} distinct half vector(s) there"
    elif width < NARROWEST * step:
        samples = f"the directions are {np.degrees(step):.2g} deg apart"
    else:
        return []
    return [Caution(Kind.NARROW_LOBE, (name,), f"{falls} and {samples}: {name} is not to be trusted")]


def grid_step(wi: Array, wo: Array, theta_h: Array) -> float:
    """Return the typical step between directions to the camera around the mirror direction.

    Parameters
    ----------
    wi, wo : ndarray, shape (N, 3)
        Unit directions.
    theta_h : ndarray, shape (N,)
        Angle between half vector and normal, in radians.

    Returns
    -------
    float
        Median angle to the nearest neighbour among samples with the same light, in radians; 0 where
        directions of light do not repeat, so that there is no grid.
    """
    near = np.flatnonzero(theta_h < NEAR_TOP_RAD)
    if not near.size:
        return 0.0
    wi, wo = wi[near], wo[near]
    steps = []
    for pick in np.unique(np.linspace(0, len(near) - 1, GROUPS).astype(int)):
        group = np.unique(np.round(wo[np.max(np.abs(wi - wi[pick]), axis=1) < 1e-6], 6), axis=0)
        if 3 <= len(group) <= 1000:
            distance = np.linalg.norm(group[:, None] - group[None], axis=-1)
            np.fill_diagonal(distance, np.inf)
            steps.append(np.median(distance.min(axis=1)))
    return float(2.0 * np.arcsin(0.5 * np.median(steps))) if steps else 0.0


def about_shapes(
    problem: Problem, values: Mapping[str, Array], u: Mapping[str, Array], on_bound: Iterable[bool]
) -> list[Caution]:
    """Say which shapes the samples leave open.

    Parameters
    ----------
    problem : Problem
        The model.
    values, u : mapping of str to ndarray
        Parameters by name, and their standard uncertainty.
    on_bound : iterable of bool
        Whether each shape ended on a bound.

    Returns
    -------
    list of Caution
    """
    cautions = []
    for parameter, bound in zip(problem.shapes, on_bound, strict=True):
        name = parameter.name
        value, spread = float(values[name]), float(u[name])
        only = f": of {name} and ks only ks_F0 is meaningful" if name in NORMAL_REFLECTANCE else ""
        if bound:
            text = f"{name} ended on the bound {value:.4g} and is not determined{only}"
            cautions.append(Caution(Kind.AT_BOUND, (name,), text))
        elif not spread / abs(parameter.coordinate.slope(value)) < UNDETERMINED:
            text = f"{name} is not identifiable from these samples{only}"
            cautions.append(Caution(Kind.NOT_DETERMINED, (name,), text))
    return cautions


def about_scales(names: Sequence[tuple[str, int | None]], search: Array, natural: Array) -> list[Caution]:
    """Say which scales trade: kd for ks under a lobe like Lambert's, ks for the facets' reflectance.

    Parameters
    ----------
    names : sequence of (str, int or None)
        Parameter and channel of each row.
    search, natural : ndarray, shape (P, P)
        Covariance in search coordinates (kd and the specular part's size, at fixed shapes' effect on it)
        and of the parameters themselves.

    Returns
    -------
    list of Caution
    """
    rows = {name: i for i, name in enumerate(names)}
    channels = [c for name, c in names if name == "ks"]
    cautions = []
    alike = [_correlation(search, rows["kd", c], rows["ks", c]) for c in channels]
    worst = min(alike, default=0.0)
    if worst < -ALIKE:
        text = f"the lobe is so broad that kd and ks trade (correlation {worst:.3f}): only their sum is known"
        cautions.append(Caution(Kind.KD_KS, ("kd", "ks"), text))
    for name in NORMAL_REFLECTANCE:
        if (name, None) in rows:
            trade = [_correlation(natural, rows[name, None], rows["ks", c]) for c in channels]
            worst = min(trade, default=0.0)
            if worst < -TRADE:
                text = f"ks and {name} trade (correlation {worst:.4f}): only ks_F0 is meaningful"
                cautions.append(Caution(Kind.KS_F0, ("ks", name), text))
    return cautions


def about_misfit(metrics: Mapping[str, float]) -> list[Caution]:
    """Say whether the residuals are what the uncertainties promise; metrics as of `analysis.metrics`."""
    chi2 = metrics.get("chi2_dof", 0.0)
    if not chi2 > MISFIT:
        return []
    text = f"residuals exceed the stated uncertainties {np.sqrt(chi2):.1f} times: u does not cover this"
    return [Caution(Kind.MISFIT, (), text)]


def correlation_matrix(covariance: Array) -> Array:
    """Scale a covariance (P, P) to a diagonal of ones; NaN where the variance is infinite or zero."""
    variance = np.diag(covariance)
    known = np.isfinite(variance) & (variance > 0.0)
    u = np.sqrt(np.where(known, variance, np.nan))
    return np.asarray(np.where(np.isfinite(covariance), covariance, np.nan) / np.outer(u, u))


def _correlation(covariance: Array, first: int, second: int) -> float:
    """Correlation of two parameters; 0 where there is none."""
    pair = np.ix_([first, second], [first, second])
    value = correlation_matrix(covariance[pair])[0, 1]
    return float(value) if np.isfinite(value) else 0.0
