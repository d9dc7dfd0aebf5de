"""Pictures of one fit: the plane of incidence, residuals over theta_h and theta_d, what holds its shapes."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation import view_angles
from analysis.factored_fit import FactoredFit
from analysis.profiles import profile
from analysis.ranking import data_of
from analysis.style import ACCENT, FAINT, INK, SERIES, channel_colour, figure
from rig.angles import half_difference

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

    from analysis.comparison import Candidate
    from analysis.fit import FitResult
    from analysis.ranking import AnyFit

Float = NDArray[np.float64]

WIDTH_IN, PANEL_IN, LOWER_IN = 9.6, 2.0, 3.3
MOST_INCIDENCES, COLUMNS = 6, 3
FEWEST_IN_PLANE = 4
APART_RAD = np.radians(5.0)
"""Shown incidences differ at least by this."""
TOLERANCES_DEG = (0.25, 1.0, 2.5, 5.0)
"""How far samples may lie off the plane and the incidence to be shown: the first that shows enough."""
SHOWN_CHANNELS = 3
CELLS = 44
RESIDUALS = {"log": "ln(1 + f cos θ$_i$)", "cbrt": "(f cos θ$_i$)$^{1/3}$", "l2": "f cos θ$_i$, sr$^{-1}$"}
SHOWN_SHAPES = 4
BLUE_TO_NM, GREEN_TO_NM = 495.0, 585.0
CHI2_95 = 3.841
"""Quantile of chi-square with one degree of freedom."""
SYMBOLS = {"alpha": "α", "f0": "F$_0$", "sigma_rad": "σ, rad", "half_width_rad": "half-width, rad"}


def draw(path: Path, candidate: Candidate, channels: Sequence[str], *, title: str) -> None:
    """Draw a fit's picture.

    Parameters
    ----------
    path : Path
        PNG file to write.
    candidate : Candidate
        The fit and its cross-validation.
    channels : sequence of str
        Labels of its channels.
    title : str
        What the samples are of.
    """
    result = candidate.result
    geometry, _ = data_of(result)
    stations, tolerance_deg = incidences(geometry.wi, geometry.wo)
    rows = -(-len(stations) // COLUMNS) or 1
    with figure(WIDTH_IN, 0.45 + rows * PANEL_IN + LOWER_IN) as drawn:
        heights = [rows * PANEL_IN + 0.35, LOWER_IN]
        upper, lower = drawn.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
        _draw_scans(upper, result, channels, stations, tolerance_deg)
        left, right = lower.subfigures(1, 2, squeeze=False, width_ratios=[1.1, 1.0])[0]
        _draw_map(left, result)
        if isinstance(result, FactoredFit):
            _draw_tables(right, result, channels)
        else:
            _draw_profiles(right, result)
        score = "" if np.isnan(candidate.cross_validation) else f", left out {candidate.cross_validation:.3g}"
        rms = np.sqrt(np.sum(np.square(_residuals(result))) / result.count)
        what = f"{title}: {result.model.NAME}, {result.count} data"
        drawn.suptitle(
            f"{what}, RMS residual {rms:.3g} ({result.loss}){score}", x=0.01, ha="left", fontsize=11
        )
        drawn.savefig(path, dpi=110, metadata={"Software": None})


def incidences(wi: Float, wo: Float) -> tuple[list[float], float]:
    """Choose angles of incidence that have scans in the plane of incidence.

    Parameters
    ----------
    wi, wo : ndarray, shape (N, 3)
        Unit directions.

    Returns
    -------
    stations : list of float
        In radians, ascending, at most `MOST_INCIDENCES`.
    tolerance_deg : float
        How far samples lie off plane and incidence.
    """
    view = view_angles(wi, wo)
    best: tuple[list[float], float] = [], TOLERANCES_DEG[0]
    for tolerance_deg in TOLERANCES_DEG:
        found = _stations(view.theta_i[_near_plane(view.off_plane, tolerance_deg)], np.radians(tolerance_deg))
        if len(found) > len(best[0]):
            best = found, tolerance_deg
        if len(found) >= COLUMNS:
            break
    return best


def _near_plane(off_plane: Float, tolerance_deg: float) -> NDArray[np.bool_]:
    return np.asarray(np.abs(off_plane) < np.radians(tolerance_deg))


def _stations(theta_i: Float, tolerance: float) -> list[float]:
    """Angles with enough samples about them, spread over the range."""
    chosen: list[float] = []
    for theta in np.unique(np.round(theta_i, 4)):
        near = theta_i[np.abs(theta_i - theta) < tolerance]
        apart = not chosen or theta - chosen[-1] > max(APART_RAD, 2.0 * tolerance)
        if near.size >= FEWEST_IN_PLANE and apart:
            chosen.append(float(np.median(near)))
    every = np.unique(np.linspace(0, len(chosen) - 1, min(len(chosen), MOST_INCIDENCES)).round().astype(int))
    return [chosen[i] for i in every] if chosen else []


def _shown(channels: Sequence[str]) -> list[int]:
    """Channels that are drawn: all of a few, else the ends and the middle."""
    every = np.linspace(0, len(channels) - 1, min(len(channels), SHOWN_CHANNELS))
    return sorted({round(float(i)) for i in every})


def _colour(channel: str, index: int) -> str:
    """Colour of a channel; a wavelength's is about what it looks like."""
    found = re.match(r"(\d+(?:\.\d+)?) ?nm$", channel)
    if found is None:
        return channel_colour(channel, index)
    nm = float(found[1])
    return channel_colour("B" if nm < BLUE_TO_NM else "G" if nm < GREEN_TO_NM else "R", index)


def _draw_scans(
    place: SubFigure, result: AnyFit, channels: Sequence[str], stations: list[float], tolerance_deg: float
) -> None:
    if not stations:
        place.text(0.5, 0.5, "no scans in the plane of incidence", ha="center", color=FAINT)
        return
    geometry, loss = data_of(result)
    view, near = view_angles(geometry.wi, geometry.wo), np.radians(tolerance_deg)
    in_plane = _near_plane(view.off_plane, tolerance_deg)
    rows = -(-len(stations) // COLUMNS)
    panels = place.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False).ravel()
    scan = np.radians(np.linspace(-88.0, 88.0, 529))
    seen: list[Float] = []
    for axes, theta in zip(panels, stations, strict=False):
        at = in_plane & (np.abs(view.theta_i - theta) < near)
        for index in _shown(channels):
            colour = _colour(channels[index], index)
            used = at & loss.used[:, index]
            value = loss.data[used, index]
            seen.append(value)
            axes.plot(
                np.degrees(view.signed_theta_o[used]), value, "o", ms=3.0, mew=0, color=colour, alpha=0.7
            )
            axes.plot(np.degrees(scan), _curve(result, theta, scan)[:, index], color=colour, lw=1.0)
        axes.axvline(np.degrees(theta), color=FAINT, lw=0.6, ls=":")
        axes.set_title(f"θ$_i$ = {np.degrees(theta):.3g}°", pad=3)
    for axes in panels[len(stations) :]:
        axes.set_visible(False)
    _scale(panels[0], np.concatenate(seen))
    for number, axes in enumerate(panels[: len(stations)]):
        axes.set_xlim(-90, 90)
        axes.set_xticks(np.arange(-90, 91, 45))
        axes.tick_params(labelbottom=number + COLUMNS >= len(stations))
        if number % COLUMNS == 0:
            axes.set_ylabel("f$_r$, sr$^{-1}$")
        if number + COLUMNS >= len(stations):
            axes.set_xlabel("θ$_o$ in the plane, °")
    if len(channels) > 1:
        for index in _shown(channels):
            panels[0].plot([], [], color=_colour(channels[index], index), label=channels[index])
        panels[0].legend(loc="upper left", fontsize=7.5, handlelength=1.2)
    place.suptitle(
        f"Plane of incidence: dots measured (within {tolerance_deg:g}°), lines fitted, dotted the mirror "
        "direction; light at negative angles",
        x=0.01, ha="left", fontsize=8.5, color=INK,
    )  # fmt: skip


def _curve(result: AnyFit, theta_i: float, theta_o: Float) -> Float:
    wi = np.broadcast_to([np.sin(theta_i), 0.0, np.cos(theta_i)], (theta_o.size, 3))
    wo = np.stack([-np.sin(theta_o), np.zeros_like(theta_o), np.cos(theta_o)], axis=-1)
    channels = data_of(result)[1].data.shape[1]
    return np.broadcast_to(result.model.evaluate(wi, wo), (theta_o.size, channels))


def _scale(axes: Axes, values: Float) -> None:
    """Logarithmic where positive values span more than a decade; room around what was measured."""
    positive = values[values > 0.0]
    if positive.size > 0.9 * values.size and positive.max() > 10.0 * np.percentile(positive, 2.0):
        axes.set_yscale("log")
        axes.set_ylim(0.5 * np.percentile(positive, 1.0), 2.5 * positive.max())
    else:
        margin = 0.08 * max(float(np.ptp(values)), 0.1 * float(np.abs(values).max()))
        axes.set_ylim(values.min() - margin, values.max() + 2.0 * margin)


def _residuals(result: AnyFit) -> Float:
    """Fit, as the instrument sees it, minus samples in the loss's measure, (N, C); 0 where unused."""
    geometry, loss = data_of(result)
    if isinstance(result, FactoredFit):
        return loss.residual(result.model.evaluate(geometry.wi, geometry.wo))
    f = np.empty(loss.data.shape)
    for block in result.state.blocks:
        best = block.solution
        terms = block.problem.terms(best.shapes[None])
        f[:, list(block.channels)] = terms.values(best.kd[None], best.ks[None])[0].T
    return loss.residual(f)


def _draw_map(place: SubFigure, result: AnyFit) -> None:
    """Draw the mean residual in cells of theta_h and theta_d; signed, so that what scatters fades."""
    geometry, loss = data_of(result)
    theta_h, _, theta_d, _ = half_difference(geometry.wi, geometry.wo)
    residual, used = -_residuals(result), loss.used
    row, channel = np.nonzero(used)
    value = residual[row, channel]
    axes = place.subplots()
    reach = float(np.percentile(np.abs(value), 99.0)) or 1.0
    edges = np.linspace(0.0, 90.0, CELLS + 1)
    count, _, _ = np.histogram2d(np.degrees(theta_h[row]), np.degrees(theta_d[row]), bins=[edges, edges])
    total, _, _ = np.histogram2d(
        np.degrees(theta_h[row]), np.degrees(theta_d[row]), bins=[edges, edges], weights=value
    )
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    image = axes.pcolormesh(edges, edges, mean.T, cmap="RdBu_r", vmin=-reach, vmax=reach, rasterized=True)
    place.colorbar(image, ax=axes, shrink=0.9, pad=0.02)
    axes.set_xlabel("half-vector angle θ$_h$, °")
    axes.set_ylabel("difference angle θ$_d$, °")
    axes.set_xticks(np.arange(0, 91, 15))
    axes.set_yticks(np.arange(0, 91, 15))
    axes.set_facecolor("#f1f3f4")
    of = RESIDUALS.get(result.loss, "")
    what = f"of {of}" if of else "in standard uncertainties"
    axes.set_title(f"Measured minus fitted, mean of each cell,\n{what}")


def _draw_profiles(place: SubFigure, result: FitResult) -> None:
    """Draw how chi-square rises when a shape is held off its best value, beside the parabola of its u."""
    profiles = [each for each in (profile(result, row) for row in _shape_rows(result)) if each is not None]
    if not profiles:
        place.text(0.5, 0.5, "no shape is determined by the samples", ha="center", color=FAINT)
        return
    columns = 1 if len(profiles) == 1 else 2
    panels = place.subplots(-(-len(profiles) // columns), columns, squeeze=False, sharey=True).ravel()
    for axes, each in zip(panels, profiles, strict=False):
        axes.plot(each.values, each.rise, color=SERIES[0])
        axes.plot(each.values, np.square((each.values - each.best) / each.u), "--", color=FAINT, lw=0.9)
        axes.axhline(CHI2_95, color=ACCENT, lw=0.8)
        axes.axvline(each.best, color=INK, lw=0.6, ls=":")
        axes.set_ylim(0.0, 9.5)
        axes.set_xlabel(SYMBOLS.get(each.name, each.name))
        axes.locator_params(axis="x", nbins=4)
        axes.ticklabel_format(axis="x", useOffset=False)
    for axes in panels[len(profiles) :]:
        axes.set_visible(False)
    for axes in panels[: len(profiles) : columns]:
        axes.set_ylabel("rise of χ²")
    place.suptitle(
        "Profiles of the shapes; dashed from u, red the 95 % level", x=0.02, ha="left", fontsize=10
    )


def _shape_rows(result: FitResult) -> list[int]:
    """Rows of the covariance that are shapes, as many as are shown."""
    return [i for i, (name, _) in enumerate(result.names) if name not in {"kd", "ks"}][:SHOWN_SHAPES]


def _draw_tables(place: SubFigure, result: FactoredFit, channels: Sequence[str]) -> None:
    """Draw the factors, with bands of two standard uncertainties."""
    upper, lower = place.subplots(2, 1)
    density, reflectance = result.tables["D"], result.tables["F"]
    band = np.exp(2.0 * np.minimum(density.relative_u, 5.0))
    value = np.maximum(density.value, 1e-12)
    upper.fill_between(density.theta_deg, value / band, value * band, color=SERIES[0], alpha=0.2, lw=0)
    upper.semilogy(density.theta_deg, value, color=SERIES[0])
    upper.set_ylim(max(0.3 * value[density.theta_deg < 80.0].min(), 1e-5 * value.max()), 3.0 * value.max())
    upper.set_xlabel("half-vector angle θ$_h$, °")
    upper.set_ylabel("D, sr$^{-1}$")
    for index in _shown(channels):
        colour, u = _colour(channels[index], index), reflectance.relative_u[:, index]
        value, band = reflectance.value[:, index], np.exp(2.0 * np.minimum(u, 5.0))
        lower.fill_between(reflectance.theta_deg, value / band, value * band, color=colour, alpha=0.15, lw=0)
        lower.plot(reflectance.theta_deg, value, color=colour)
    _scale(lower, reflectance.value.ravel())
    lower.set_xlabel("difference angle θ$_d$, °")
    lower.set_ylabel("k$_s$ F")
    for axes in (upper, lower):
        axes.set_xlim(0, 90)
        axes.set_xticks(np.arange(0, 91, 15))
    place.suptitle("Tables, with bands of two standard uncertainties", x=0.02, ha="left", fontsize=10)
