"""The report's figures: each function draws one and returns it as SVG."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.appearance import encode_srgb
from analysis.evaluation import view_angles
from analysis.style import ACCENT, FAINT, INK, SERIES, channel_colour, figure, to_svg

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.ticker import Locator
    from numpy.typing import NDArray

    from analysis.evaluation import Evaluation
    from analysis.models.base import Model

    Float = NDArray[np.float64]

IN_PLANE_RAD = np.deg2rad(0.25)
NEAR_INCIDENCE_RAD = np.deg2rad(0.25)
MAX_LOBES = 5
DARK_PERCENT = 30.0
DARK = "#e3e7ea"
FLAG_COLOURS = ("#b3352b", "#c9d2d8", "#2f7d4f", "#b5790a", "#6b4a8e", "#3f8f95")
MAX_POINTS = 12_000
WIDTH_IN = 7.2


def channel_names(samples: xr.Dataset) -> list[str]:
    """Give the channels' labels of a sample table: names, wavelengths, or numbers."""
    if "channel" in samples.coords:
        return [str(name) for name in samples["channel"].to_numpy()]
    if "wavelength_nm" in samples:
        return [f"{wavelength:g} nm" for wavelength in np.atleast_1d(samples["wavelength_nm"].to_numpy())]
    return [str(index) for index in range(samples.sizes["channel"])]


def coverage(samples: xr.Dataset) -> bytes:
    """Draw where light and camera stood: two views of the hemisphere from above, one dot per sample."""
    with figure(WIDTH_IN, 3.5) as drawn:
        panels = drawn.subplots(1, 2, subplot_kw={"projection": "polar"})
        for axes, name, title in zip(
            panels, ("wi", "wo"), ("Light, $\\omega_i$", "Camera, $\\omega_o$"), strict=True
        ):
            direction = samples[name].to_numpy()
            theta_deg = np.rad2deg(np.arctan2(np.hypot(direction[:, 0], direction[:, 1]), direction[:, 2]))
            phi = np.arctan2(direction[:, 1], direction[:, 0])
            axes.plot(phi, theta_deg, ".", ms=1.6, color=INK, alpha=0.35, mec="none", rasterized=True)
            axes.set_rlim(0, 90)
            axes.set_rgrids([30, 60, 90], ["30°", "60°", ""], angle=22.5, fontsize=8, color=FAINT)
            axes.set_thetagrids(range(0, 360, 45), fontsize=8)
            axes.spines["polar"].set_color(FAINT)
            axes.set_title(title, pad=14)
        return to_svg(drawn)


def frame(radiance: Float, variance: Float, flags: NDArray[np.integer], channel: NDArray[np.intp]) -> bytes:
    """Draw one merged frame: its picture, its relative noise, its flags.

    Parameters
    ----------
    radiance, variance : (H, W) float
        Counts per second, and their variance.
    flags : (H, W) int
        Bits of `capture.merge.Flag`.
    channel : (H, W) int
        Colour channel of each pixel; two-by-two quads become one picture element.
    """
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm

    noise_percent = _relative_noise_percent(radiance, variance)
    noise_percent[~(noise_percent < DARK_PERCENT)] = np.nan
    shown = noise_percent[np.isfinite(noise_percent)]
    low, high = np.percentile(shown, [1, 97]) if shown.size else (0.1, 10.0)
    high = max(high, 1.5 * low)
    with figure(WIDTH_IN, 2.35) as drawn:
        panels = drawn.subplots(1, 3)
        panels[0].imshow(_picture(radiance, channel), interpolation="nearest")
        panels[0].set_title("Radiance")
        colours = colormaps["cividis"].with_extremes(bad=DARK)
        image = panels[1].imshow(
            noise_percent, cmap=colours, norm=LogNorm(low, high), interpolation="nearest"
        )
        panels[1].set_title("Relative noise, %")
        bar = drawn.colorbar(image, ax=panels[1], shrink=0.72, pad=0.03)
        bar.ax.yaxis.set_major_formatter("{x:g}")
        bar.ax.yaxis.set_minor_formatter("{x:g}" if high < 8 * low else "")
        bar.ax.tick_params(which="both", labelsize=7)
        _draw_flags(panels[2], flags)
        for axes in panels:
            axes.set_xticks([])
            axes.set_yticks([])
            axes.grid(visible=False)
        return to_svg(drawn)


def _quads(values: Float) -> Float:
    """Give a mosaic's quads as (H/2, W/2, 4): row by row within each."""
    rows, cols = values.shape[0] // 2 * 2, values.shape[1] // 2 * 2
    quads: Float = values[:rows, :cols].reshape(rows // 2, 2, cols // 2, 2).swapaxes(1, 2)
    return quads.reshape(rows // 2, cols // 2, 4)


def _relative_noise_percent(radiance: Float, variance: Float) -> Float:
    """Give the relative standard uncertainty of a quad's pixels, their root mean square, in percent."""
    with np.errstate(invalid="ignore", divide="ignore"):
        relative: Float = np.sqrt(np.mean(_quads(variance) / _quads(radiance) ** 2, axis=-1))
    return 100 * relative


def _picture(radiance: Float, channel: NDArray[np.intp]) -> Float:
    """Quads of the mosaic as sRGB-encoded picture elements (H/2, W/2, 3), the 99.5th percentile at white."""
    blocks = _quads(radiance)
    sites = channel[:2, :2].ravel()
    planes = [blocks[..., sites == index].mean(axis=-1) for index in range(int(channel.max()) + 1)]
    linear = np.stack(planes if len(planes) == 3 else planes[:1] * 3, axis=-1)
    scale = np.nanpercentile(linear, 99.5)
    return encode_srgb(linear / max(scale, 1e-300))


def _draw_flags(axes: Axes, flags: NDArray[np.integer]) -> None:
    from matplotlib.lines import Line2D

    from capture.merge import Flag

    axes.imshow(np.full((*flags.shape, 3), 0.955), interpolation="nearest")
    handles = []
    for index, flag in sorted(enumerate(Flag), key=lambda pair: pair[1] is not Flag.UNDER_RANGE):
        row, col = np.nonzero(flags & flag)
        if row.size:
            (handle,) = axes.plot(
                col, row, "s", ms=2.2, mec="none", color=FLAG_COLOURS[index], rasterized=True
            )
            name = str(flag.name).lower().replace("_", " ")
            handles.append(
                Line2D([], [], ls="", marker="s", ms=4, color=handle.get_color(), label=f"{name} {row.size}")
            )
    axes.set_title("Flags" if handles else "Flags: none")
    if handles:
        axes.legend(
            handles=handles,
            loc="upper left",
            bbox_to_anchor=(0, -0.02),
            ncols=2,
            fontsize=7,
            borderpad=0,
            handletextpad=0.1,
            columnspacing=0.8,
        )


def incidences(samples: xr.Dataset) -> list[float]:
    """Choose the angles of incidence whose in-plane scans hold the most camera angles, radians, ascending."""
    view = view_angles(samples["wi"].to_numpy(), samples["wo"].to_numpy())
    in_plane = np.abs(view.off_plane) < IN_PLANE_RAD
    grid = _light_stations(samples, view.theta_i)
    richness = []
    for theta in grid:
        near = in_plane & (np.abs(view.theta_i - theta) < NEAR_INCIDENCE_RAD)
        richness.append(np.unique(np.round(np.rad2deg(view.signed_theta_o[near]) / 2)).size)
    chosen: list[float] = []
    for index in np.argsort(richness, kind="stable")[::-1]:
        apart = all(abs(grid[index] - other) > np.deg2rad(6) for other in chosen)
        if apart and richness[index] >= 4 and len(chosen) < MAX_LOBES:
            chosen.append(float(grid[index]))
    return sorted(chosen)


def _light_stations(samples: xr.Dataset, theta_i: Float) -> Float:
    """Give the angles at which the light stood: each pose's median, else every quarter of a degree."""
    stations: Float = np.deg2rad(np.arange(0.0, 90.0, 0.25))
    if "pose" in samples:
        pose = samples["pose"].to_numpy()
        medians = [np.round(np.median(theta_i[pose == number]), 3) for number in np.unique(pose)]
        stations = np.unique(np.array(medians, dtype=np.float64))
    return stations


def lobes(samples: xr.Dataset, models: Mapping[str, Model], channel: int) -> bytes:
    """Draw f_r over the signed camera angle in the plane of incidence, one colour per angle of incidence.

    Points carry error bars of k = 2; lines are the models, the first solid, others dashed and dotted.
    """
    from matplotlib.lines import Line2D

    view = view_angles(samples["wi"].to_numpy(), samples["wo"].to_numpy())
    value = samples["f_r"].to_numpy()[:, channel]
    u = samples["u_f_r"].to_numpy()[:, channel] if "u_f_r" in samples else np.zeros_like(value)
    chosen = incidences(samples)
    scan = np.deg2rad(np.linspace(-88, 88, 705))
    with figure(WIDTH_IN, 3.6) as drawn:
        axes = drawn.subplots()
        for index, theta in enumerate(chosen):
            near = (np.abs(view.off_plane) < IN_PLANE_RAD) & (
                np.abs(view.theta_i - theta) < NEAR_INCIDENCE_RAD
            )
            near &= np.isfinite(value)
            centre = float(np.mean(view.theta_i[near]))
            angle_deg = np.rad2deg(view.signed_theta_o[near])
            colour = SERIES[index % len(SERIES)]
            axes.errorbar(
                angle_deg, value[near], 2 * u[near], fmt="o", ms=2.8, mew=0, color=colour, elinewidth=0.6,
                alpha=0.8, label=f"$\\theta_i$ = {np.rad2deg(centre):.1f}°",
            )  # fmt: skip
            for style, model in zip(("-", "--", ":", "-."), models.values(), strict=False):
                curve = _in_plane_curve(model, centre, scan, channel)
                seen = (np.rad2deg(scan) > angle_deg.min() - 4) & (np.rad2deg(scan) < angle_deg.max() + 4)
                axes.plot(np.rad2deg(scan[seen]), curve[seen], style, color=colour, lw=1.0)
        axes.axvline(0, color=FAINT, lw=0.6)
        _scale_values(axes, value[np.isfinite(value) & (np.abs(view.off_plane) < IN_PLANE_RAD)])
        axes.set_xlabel(
            "camera angle $\\theta_o$ in the plane of incidence, degrees; positive on the mirror's side"
        )
        axes.set_ylabel("$f_r$, sr$^{-1}$")
        axes.xaxis.set_major_locator(_every(15))
        handles, labels = axes.get_legend_handles_labels()
        for style, name in zip(("-", "--", ":", "-."), models, strict=False):
            handles.append(Line2D([], [], ls=style, color=INK, lw=1.0))
            labels.append(name)
        axes.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.005, 1.0), borderaxespad=0)
        return to_svg(drawn)


def _every(step: float) -> Locator:
    from matplotlib.ticker import MultipleLocator

    return MultipleLocator(step)


def _in_plane_curve(model: Model, theta_i: float, theta_o: Float, channel: int) -> Float:
    wi = np.broadcast_to([np.sin(theta_i), 0.0, np.cos(theta_i)], (theta_o.size, 3))
    wo = np.stack([-np.sin(theta_o), np.zeros_like(theta_o), np.cos(theta_o)], axis=-1)
    values: Float = np.atleast_2d(model.evaluate(wi, wo))
    return values[:, min(channel, values.shape[1] - 1)]


def _scale_values(axes: Axes, values: Float) -> None:
    """Logarithmic where the values span more than a decade and are all positive; from zero otherwise."""
    if values.size and values.min() > 0 and values.max() > 12 * values.min():
        axes.set_yscale("log")
    elif values.size and values.max() - values.min() < 0.2 * np.abs(values).max():
        # Nearly constant: from zero, neither bars nor departures would show.
        margin = max(float(values.max() - values.min()), 0.02 * float(values.max()))
        axes.set_ylim(float(values.min()) - margin, float(values.max()) + margin)
    elif values.size:
        axes.set_ylim(min(0.0, 1.1 * float(values.min())), 1.15 * float(values.max()))


def residuals(samples: xr.Dataset, evaluation: Evaluation) -> bytes:
    """Draw relative residuals over the half vector's angle, and the histogram of pulls."""
    view = view_angles(samples["wi"].to_numpy(), samples["wo"].to_numpy())
    names = channel_names(samples)
    with np.errstate(invalid="ignore", divide="ignore"):
        percent = 100 * evaluation.residual / evaluation.fitted
    step = max(1, percent.shape[0] * percent.shape[1] // MAX_POINTS)
    with figure(WIDTH_IN, 2.9) as drawn:
        left, right = drawn.subplots(1, 2, width_ratios=[1.75, 1])
        for index, name in enumerate(names):
            left.plot(
                np.rad2deg(view.theta_h[::step]), percent[::step, index], ".", ms=1.8, mec="none", alpha=0.45,
                color=channel_colour(name, index), rasterized=True, label=name,
            )  # fmt: skip
        left.axhline(0, color=INK, lw=0.7)
        reach = float(np.nanpercentile(np.abs(percent), 99.5)) * 1.3 if np.isfinite(percent).any() else 1.0
        left.set_ylim(-reach, reach)
        left.set_xlim(left=0)
        left.set_xlabel("half-vector angle $\\theta_h$, degrees")
        left.set_ylabel("(measured − fit) / fit, %")
        left.set_title("Residuals")
        left.legend(markerscale=4, ncols=len(names), loc="upper right", handletextpad=0.1, columnspacing=0.9)
        _draw_pulls(right, evaluation.pull)
        return to_svg(drawn)


def _draw_pulls(axes: Axes, pull: Float) -> None:
    finite = pull[np.isfinite(pull)]
    axes.set_xlabel("pull: residual / stated u")
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.grid(visible=False)
    if not finite.size:
        axes.set_title("Pulls: no stated uncertainty")
        return
    edges = np.linspace(-5, 5, 61)
    axes.hist(np.clip(finite, -5, 5), bins=edges.tolist(), density=True, color=RULE_FILL, edgecolor="none")
    axes.plot(edges, np.exp(-0.5 * edges**2) / np.sqrt(2 * np.pi), color=ACCENT, lw=1.1)
    axes.set_title(f"Pulls: s.d. {np.std(np.clip(finite, -5, 5)):.2f}, N(0, 1) in red")


RULE_FILL = "#c3ccd2"


def budget(samples: xr.Dataset, evaluation: Evaluation) -> bytes:
    """Draw the median relative standard uncertainty by source over the half vector's angle."""
    view = view_angles(samples["wi"].to_numpy(), samples["wo"].to_numpy())
    theta_deg = np.rad2deg(view.theta_h)
    edges = np.linspace(0, max(float(theta_deg.max()), 1.0), 25)
    which = np.clip(np.digitize(theta_deg, edges) - 1, 0, edges.size - 2)
    middle = (edges[1:] + edges[:-1]) / 2
    with figure(WIDTH_IN, 2.7) as drawn:
        axes = drawn.subplots()
        for index, (name, column) in enumerate(evaluation.columns.items()):
            with np.errstate(invalid="ignore", divide="ignore"):
                percent = 100 * column / np.abs(evaluation.fitted)
            medians = np.array([_median(percent[which == k]) for k in range(middle.size)])
            medians[medians <= 0] = np.nan
            axes.plot(middle, medians, "-o", ms=2.6, lw=1.0, color=SERIES[index], label=name)
        axes.set_yscale("log")
        top = axes.get_ylim()[1]
        axes.set_ylim(max(axes.get_ylim()[0], 1e-4 * top), top)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xlim(left=0)
        axes.set_xlabel("half-vector angle $\\theta_h$, degrees")
        axes.set_ylabel("median u / f, %")
        axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), borderaxespad=0)
        return to_svg(drawn)


def _median(values: Float) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else np.nan


def exposures(exposure_s: Mapping[str, Sequence[float]]) -> bytes:
    """Draw how often each exposure was used, by pass."""
    times = sorted({time for values in exposure_s.values() for time in values})
    with figure(WIDTH_IN, 2.2) as drawn:
        axes = drawn.subplots()
        bottom = np.zeros(len(times))
        for index, (name, values) in enumerate(exposure_s.items()):
            counts = np.array([list(values).count(time) for time in times], dtype=float)
            axes.bar(range(len(times)), counts, bottom=bottom, width=0.72, color=SERIES[index], label=name)
            bottom += counts
        axes.set_xticks(
            range(len(times)), [f"{time:.3g}" for time in times], rotation=45 if len(times) > 14 else 0
        )
        axes.set_xlabel("exposure, s")
        axes.set_ylabel("frames")
        axes.grid(visible=False, axis="x")
        axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), borderaxespad=0)
        return to_svg(drawn)
