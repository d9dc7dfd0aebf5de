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

from analysis.models.base import Geometry
from analysis.problem import Problem
from rig.angles import from_half_difference

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from analysis.layout import Layout
    from analysis.losses import Loss
    from analysis.models.base import Parameter
    from analysis.state import Block

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
BELOW_INSTRUMENT = 0.25
"""Half-width of a lobe, as a share of the angle by which the instrument blurs it, below which the width is
lost: the two add in squares, and the rule of nodes no longer meets the lobe."""
NEAR_TOP_RAD = np.radians(20.0)
"""Angle of the half vector to the normal within which the grid's step counts."""
GROUPS = 8
"""Directions of light that the grid's step is taken from."""
SAME_LIGHT = 1.0 - 1e-12
"""Cosine between two directions of light, 1e-6 rad apart, from which on they are one."""
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
    OUTLIERS = "outliers"
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
    channel : int or None
        Which channel alone it is about.
    """

    kind: Kind
    parameters: tuple[str, ...]
    text: str
    channel: int | None = None


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
        that nowhere falls so far, 0 where there is none.
    """
    if not problem.has_lobe or not problem.shapes:
        return 0.0
    theta_h = np.concatenate([[0.0], np.geomspace(1e-4, 1.5, 400)])
    widths = []
    for phi_h in (0.0, 0.5 * np.pi):
        # The light moves at right angles to the half vector's tilt, so that no cosine changes fast.
        wi, wo = from_half_difference(theta_h, phi_h, np.radians(20.0), 0.5 * np.pi)
        lobe = Problem(problem.model, Geometry(wi, wo), 1).terms(shapes[None]).lobe[0]
        below = np.flatnonzero(lobe < 0.5 * lobe[0])
        widths.append(float(theta_h[below[0]]) if below.size else 0.5 * np.pi)
    return min(widths)


def about_the_lobe(block: Block, width: float, label: tuple[int, str] | None = None) -> list[Caution]:
    """Say whether there is a lobe, and whether samples lie on enough of it.

    A lobe narrower than the samples' grid is seen at its top alone, or on the tail that the model's formula
    gives it. Its width then comes from nowhere, with a small uncertainty.

    Parameters
    ----------
    block : Block
        Channels that share their shapes.
    width : float
        Of `half_width`.
    label : (int, str), optional
        Number and name of the channel, where the others have shapes of their own.

    Returns
    -------
    list of Caution
    """
    problem, solution = block.problem, block.solution
    channel, of = _named(label)
    if not problem.has_lobe or not problem.shapes:
        return []
    if not np.any(solution.ks > 0.0):
        return [Caution(Kind.NO_LOBE, ("ks",), f"{of}the samples show no specular lobe", channel)]
    name = problem.shapes[0].name
    used = np.any(block.loss.counted, axis=1)
    wi, wo = problem.geometry.wi[used], problem.geometry.wo[used]
    theta_h = np.arctan(np.sqrt(problem.geometry.tan2_h[used, 0]))
    blur = 0.0 if problem.spread is None else problem.spread.instrument.half_vector_rad
    # What the samples must resolve is the lobe as the instrument widens it.
    seen = float(np.hypot(width, blur))
    inside = np.unique(np.round(theta_h[theta_h < seen] / (RESOLVED * seen))).size
    step = grid_step(wi, wo, theta_h)
    falls = f"the lobe falls to half within {np.degrees(width):.2g} deg"
    if inside < FEWEST_INSIDE:
        samples = f"the samples have {inside} distinct half vector(s) there"
    elif seen < NARROWEST * step:
        samples = f"the directions are {np.degrees(step):.2g} deg apart"
    elif width < BELOW_INSTRUMENT * blur:
        samples = f"source and receiver move the half vector by {np.degrees(blur):.2g} deg"
    else:
        return []
    text = f"{of}{falls} and {samples}: {name} is not to be trusted"
    return [Caution(Kind.NARROW_LOBE, (name,), text, channel)]


def _named(label: tuple[int, str] | None) -> tuple[int | None, str]:
    """Return a channel's number and the beginning of a sentence about it."""
    return (None, "") if label is None else (label[0], f"{label[1]}: ")


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
    picks = np.unique(np.linspace(0, len(near) - 1, GROUPS).astype(int))
    for same in (wi @ wi[picks].T > SAME_LIGHT).T:
        group = np.unique(np.round(wo[same], 6), axis=0)
        if 3 <= len(group) <= 1000:
            cosine = group @ group.T
            np.fill_diagonal(cosine, -1.0)
            steps.append(np.median(np.sqrt(np.maximum(2.0 - 2.0 * cosine.max(axis=1), 0.0))))
    return float(2.0 * np.arcsin(0.5 * np.median(steps))) if steps else 0.0


def about_shapes(
    layout: Layout,
    shapes: Sequence[Parameter],
    values: Mapping[str, Array],
    u: Mapping[str, Array],
    *,
    on_bound: NDArray[np.bool_],
    channels: Sequence[str],
) -> list[Caution]:
    """Say which shapes the samples leave open.

    Parameters
    ----------
    layout : Layout
        Rows of the parameters.
    shapes : sequence of Parameter
        The model's shapes.
    values, u : mapping of str to ndarray
        Parameters by name, and their standard uncertainty.
    on_bound : ndarray of bool, shape (P,)
        Which rows ended on a bound.
    channels : sequence of str
        Names of the channels.

    Returns
    -------
    list of Caution
    """
    known, cautions = {parameter.name: parameter for parameter in shapes}, []
    for row, (name, c) in enumerate(layout.names[: -len(layout.scales) * layout.channels]):
        value, spread = (float(np.ravel(each[name])[c or 0]) for each in (values, u))
        _, of = _named(None if c is None else (c, channels[c]))
        only = f": of {name} and ks only ks_F0 is meaningful" if name in NORMAL_REFLECTANCE else ""
        if on_bound[row]:
            text = f"{of}{name} ended on the bound {value:.4g} and is not determined{only}"
            cautions.append(Caution(Kind.AT_BOUND, (name,), text, c))
        elif not spread / abs(known[name].coordinate.slope(value)) < UNDETERMINED:
            text = f"{of}{name} is not identifiable from these samples{only}"
            cautions.append(Caution(Kind.NOT_DETERMINED, (name,), text, c))
    return cautions


def one_each(shapes: list[Caution], lobes: list[Caution]) -> list[Caution]:
    """Of two cautions about one parameter keep the one that says why: the bound, then the lobe."""
    bound = {(c.parameters, c.channel) for c in shapes if c.kind is Kind.AT_BOUND}
    lobes = [c for c in lobes if (c.parameters, c.channel) not in bound]
    told = {(c.parameters, c.channel) for c in lobes}
    return [*(c for c in shapes if (c.parameters, c.channel) not in told), *lobes]


def about_scales(layout: Layout, search: Array, natural: Array) -> list[Caution]:
    """Say which scales trade: kd for ks under a lobe like Lambert's, ks for the facets' reflectance.

    Parameters
    ----------
    layout : Layout
        Rows of both matrices.
    search, natural : ndarray, shape (P, P)
        Covariance in search coordinates (kd and the specular part's size, at fixed shapes' effect on it)
        and of the parameters themselves.

    Returns
    -------
    list of Caution
    """
    if "ks" not in layout.scales:
        return []
    channels, cautions = range(layout.channels), []
    worst = min(_correlation(search, layout.row("kd", c), layout.row("ks", c)) for c in channels)
    if worst < -ALIKE:
        text = f"the lobe is so broad that kd and ks trade (correlation {worst:.3f}): only their sum is known"
        cautions.append(Caution(Kind.KD_KS, ("kd", "ks"), text))
    for name in NORMAL_REFLECTANCE:
        if name in layout.shapes:
            worst = min(_correlation(natural, layout.row(name, c), layout.row("ks", c)) for c in channels)
            if worst < -TRADE:
                text = f"ks and {name} trade (correlation {worst:.4f}): only ks_F0 is meaningful"
                cautions.append(Caution(Kind.KS_F0, ("ks", name), text))
    return cautions


def about_outliers(loss: Loss) -> list[Caution]:
    """Say how many data a robust fit set aside."""
    used, aside = int(loss.used.sum()), int((loss.used & ~loss.counted).sum())
    if not aside:
        return []
    text = f"{aside} of {used} data lie far off the model and were set aside"
    return [Caution(Kind.OUTLIERS, (), text)]


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
