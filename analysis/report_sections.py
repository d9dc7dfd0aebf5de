"""The sections of a report about one sample, each a piece of HTML."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from analysis import figures
from analysis.appearance import encode_srgb
from analysis.budget import budget
from analysis.style import data_uri
from analysis.table import Row, parameter_rows, rounded

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import xarray as xr
    from numpy.typing import ArrayLike

    from analysis.evaluation import Evaluation
    from analysis.fit import FitResult
    from analysis.report import Measurement, ShownFrame

FAR_PULL = 3.0
"""A parameter whose pull is beyond this is set in red."""

_SYMBOLS = {
    "kd": "k<sub>d</sub>",
    "ks": "k<sub>s</sub>",
    "m": "m",
    "exponent": "n",
    "ior": "index",
    "ks_F0": "k<sub>s</sub>F<sub>0</sub>",
}

_METRICS = {
    "rms_log": "RMS Δ ln(1 + f cos θ<sub>i</sub>)",
    "l2_cos": "RMS Δ f cos θ<sub>i</sub>, sr<sup>−1</sup>",
    "rms_cbrt": "RMS Δ (f cos θ<sub>i</sub>)<sup>1/3</sup>",
    "median_relative": "median |Δf| / f",
    "chi2_dof": "χ² / dof",
}

SHOWN_MODELS = 2
"""Models whose parameters and curves are shown; the goodness of all of them is."""


def facts(items: Mapping[str, str]) -> str:
    """Set names and values as a definition list; nothing for none."""
    if not items:
        return ""
    listed = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in items.items())
    return f'<dl class="facts">{listed}</dl>'


def doubts(said: Sequence[str]) -> str:
    """List what a person should know before believing a page; nothing where there is nothing."""
    if not said:
        return ""
    items = "".join(f"<li>{escape(doubt)}</li>" for doubt in said)
    return f"<section><h2>Before you believe it</h2><ul>{items}</ul></section>"


def table(head: Sequence[str], rows: Sequence[Sequence[str]], *, caption: str = "") -> str:
    """Set a table; cells are HTML, a row whose first cell is not empty begins a group."""
    header = "".join(f"<th>{cell}</th>" for cell in head)
    lines = []
    for index, row in enumerate(rows):
        begins = ' class="first"' if index and row[0] else ""
        lines.append(f"<tr{begins}>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>")
    title = f"<caption>{caption}</caption>" if caption else ""
    return (
        f'<div class="scroll"><table>{title}<thead><tr>{header}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def number(value: float | None, form: str = ".3g") -> str:
    """Format a number with a true minus sign; a dash for none."""
    if value is None or not np.isfinite(value):
        return "–"
    return format(value, form).replace("-", "−")


def rows_of(measurement: Measurement, fitted: FitResult, truth: Mapping[str, ArrayLike] | None) -> list[Row]:
    """List a fit's numbers, labelled by the measurement's channels."""
    return parameter_rows(fitted, figures.channel_names(measurement.samples), truth)


def parameters(measurement: Measurement) -> str:
    """Set the parameters of all fits, their goodness, and the rendered sphere."""
    tables = [
        _parameter_table(measurement, fitted, measurement.truth if index == 0 else None)
        for index, fitted in enumerate(measurement.fits[:SHOWN_MODELS])
    ]
    sphere = ""
    if measurement.sphere_png is not None:
        name = escape(measurement.fits[0].model.NAME)
        sphere = (
            f'<figure><img alt="Sphere rendered with the fitted {name} model" '
            f'src="{data_uri(measurement.sphere_png, "image/png")}">'
            f"<figcaption>A sphere with the fitted {name} model, rendered by Mitsuba under a small lamp and "
            "a dim sky.</figcaption></figure>"
        )
    pair = f'<div class="pair"><div>{"".join(tables)}</div>{sphere}</div>'
    return f"<h3>Parameters</h3>{pair}{_metrics_table(measurement.fits)}"


def colours(measurement: Measurement) -> str:
    """Set the colours of all fits as a spectrophotometer of 45 deg to normal sees them (CIE 15:2004)."""
    if "xyz_of_channels" not in measurement.samples.attrs or not measurement.fits:
        return ""
    to_xyz, to_srgb = (
        np.reshape(measurement.samples.attrs[name], (3, 3))
        for name in ("xyz_of_channels", "linear_srgb_of_channels")
    )
    wi, wo = np.array([[np.sqrt(0.5), 0.0, np.sqrt(0.5)]]), np.array([[0.0, 0.0, 1.0]])
    rows = []
    for fitted in measurement.fits[:SHOWN_MODELS]:
        factor = np.pi * fitted.model.evaluate(wi, wo)[0]
        shown = encode_srgb(to_srgb @ factor)
        swatch = "#" + "".join(f"{round(255.0 * value):02x}" for value in shown)
        rows.append(
            [
                escape(fitted.model.NAME),
                *(number(value, ".4f") for value in to_xyz @ factor),
                f'<span style="background:{swatch}">&emsp;&emsp;</span> {swatch}',
            ]
        )
    lamp = escape(str(measurement.samples.attrs["colour_lamp"]))
    caption = f"Reflectance factor lit at 45°, seen from the normal, under {lamp}; a perfect white has Y = 1."
    return f"<h3>Colour</h3>{table(['', 'X', 'Y', 'Z', 'sRGB'], rows, caption=caption)}"


def _parameter_table(
    measurement: Measurement, fitted: FitResult, truth: Mapping[str, ArrayLike] | None
) -> str:
    rows = rows_of(measurement, fitted, truth)
    known = any(row.true is not None for row in rows)
    body, previous = [], ""
    for row in rows:
        value, u = rounded(row.value, row.u)
        cells = [_symbol(row.name) if row.name != previous else "", escape(row.channel)]
        relative = 100 * row.u / abs(row.value) if row.value else None
        cells += [number(row.true, ".6g")] if known else []
        cells += [value, u or "–", number(relative, ".2g")]
        cells += [_pull(row)] if known else []
        body.append(cells)
        previous = row.name
    head = ["Parameter", "", *(["True"] if known else []), "Recovered" if known else "Value", "u", "u, %"]
    caption = escape(fitted.model.NAME) + (f": {escape(fitted.message)}" if fitted.message else "")
    return table([*head, *(["Pull"] if known else [])], body, caption=caption)


def _pull(row: Row) -> str:
    text = number(row.pull, "+.2f")
    return f'<b class="far">{text}</b>' if row.pull is not None and abs(row.pull) > FAR_PULL else text


def _symbol(name: str) -> str:
    return f'<i class="v">{_SYMBOLS[name]}</i>' if name in _SYMBOLS else escape(name)


def _metrics_table(fits: Sequence[FitResult]) -> str:
    names = [name for name in _METRICS if any(name in fitted.metrics for fitted in fits)]
    rows = [
        [escape(fitted.model.NAME), *(number(fitted.metrics.get(name)) for name in names)] for fitted in fits
    ]
    return table(["Goodness of fit", *(_METRICS[name] for name in names)], rows)


def picture(svg: bytes, alt: str, caption: str) -> str:
    """Set a figure with its caption, which is HTML."""
    source = data_uri(svg, "image/svg+xml")
    return f'<figure><img alt="{escape(alt)}" src="{source}"><figcaption>{caption}</figcaption></figure>'


def coverage(samples: xr.Dataset) -> str:
    """Show where light and camera stood."""
    poses = np.unique(samples["pose"].to_numpy()).size if "pose" in samples else 0
    from_poses = f" from {poses} poses" if poses else ""
    return "<h3>Pose coverage</h3>" + picture(
        figures.coverage(samples),
        "Polar plots of light and camera directions",
        f"{samples.sizes['sample']} direction pairs{from_poses}. The plots look down on the sample: the "
        "centre is its normal, the rim the horizon, 0° its mark. Each image of the flat sample gives a "
        "patch of directions.",
    )


def frame(shown: ShownFrame) -> str:
    """Show one merged frame with its noise and flags."""
    image = shown.image
    return "<h3>One merged frame</h3>" + picture(
        figures.frame(image.radiance, image.variance, image.flags, shown.channel),
        "Radiance, relative noise and flags of one merged frame",
        f"{escape(shown.caption)}. Radiance is the mean of each quad's sites in the camera's own channels, "
        "sRGB-encoded, not demosaiced. Noise is the merge's relative standard uncertainty, the root mean "
        f"square over each quad's pixels; pale where it exceeds {figures.DARK_PERCENT:g} %.",
    )


def lobes(measurement: Measurement) -> str:
    """Show f_r in the plane of incidence with the fitted curves; nothing without in-plane scans."""
    samples = measurement.samples
    if not figures.incidences(samples):
        return ""
    names = figures.channel_names(samples)
    channel = names.index("G") if "G" in names else 0
    models = {fitted.model.NAME: fitted.model for fitted in measurement.fits[:SHOWN_MODELS]}
    in_plane, near = np.rad2deg([figures.IN_PLANE_RAD, figures.NEAR_INCIDENCE_RAD])
    return "<h3>Lobes in the plane of incidence</h3>" + picture(
        figures.lobes(samples, models, channel),
        "BRDF over camera angle in the plane of incidence",
        f"Channel {escape(names[channel])}. Points: bins within {in_plane:.2g}° of the plane and "
        f"{near:.2g}° of the angle of incidence, with bars of U (k = 2) from noise, white, reference and "
        "binning. Lines: the fitted models at that angle.",
    )


def quality(measurement: Measurement, evaluation: Evaluation) -> str:
    """Show residuals, pulls, and where the uncertainty comes from."""
    samples = measurement.samples
    parts = [
        "<h3>Residuals</h3>",
        picture(
            figures.residuals(samples, evaluation),
            "Residuals over half-vector angle and histogram of pulls",
            f"Samples against the fitted {escape(measurement.fits[0].model.NAME)}. A pull is a residual over "
            "the stated uncertainty of everything that scatters it (noise, white, binning, pose); the "
            "white's reflectance moves all samples together and is not in it.",
        ),
    ]
    if evaluation.columns:
        parts += [
            "<h3>Uncertainty budget</h3>",
            picture(
                figures.budget(samples, evaluation),
                "Relative standard uncertainty by source",
                "Median relative standard uncertainty of a sample by source. <i>noise</i> and <i>binning</i> "
                "are independent; <i>white</i> is shared where samples share a white bin; <i>pose</i> (the "
                "encoders' resolution) by all pixels of a pose; <i>reference</i> (the white's reflectance) "
                "by everything.",
            ),
            _budget_table(evaluation),
        ]
    return "".join(parts)


def _budget_table(evaluation: Evaluation) -> str:
    fitted = np.abs(evaluation.fitted)
    total = sum((column**2 for column in evaluation.columns.values()), np.zeros(fitted.shape))
    rows = []
    for name, column in evaluation.columns.items():
        with np.errstate(invalid="ignore", divide="ignore"):
            percent, share = 100 * column / fitted, 100 * column**2 / total
        quantiles = np.nanpercentile(percent, [5, 50, 95])
        rows.append(
            [
                escape(name),
                *(number(float(q), ".2g") for q in quantiles),
                number(float(np.nanmean(share)), ".0f"),
            ]
        )
    head = ["Source", "5th percentile of u / f, %", "median, %", "95th percentile, %", "share of variance, %"]
    return table(head, rows)


def pixels(measurement: Measurement) -> str:
    """Show the exposures used, and how many pixels and values were flagged or dropped."""
    counts = _counts(measurement.samples)
    if not measurement.exposure_s:
        return f"<h3>Flags</h3>{counts}" if counts else ""
    drawn = picture(
        figures.exposures(measurement.exposure_s),
        "Histogram of exposures",
        "Exposures of all frames by pass, each chosen from what the sensor had seen.",
    )
    return f"<h3>Exposures and flags</h3>{drawn}{counts}"


def _counts(samples: xr.Dataset) -> str:
    tables = []
    for prefix, label in (("pixels_", "Pixels of the sample"), ("dropped_", "Values of bins dropped")):
        rows = [
            [escape(name.removeprefix(prefix).replace("_", " ")), str(int(count))]
            for name, count in samples.attrs.items()
            if name.startswith(prefix)
        ]
        tables.append(table([label, "Count"], rows) if rows else "")
    return f'<div class="side">{"".join(tables)}</div>' if any(tables) else ""


def uncertainty(measurement: Measurement) -> str:
    """Show what the uncertainty of a sample and of the mean of all consists of; nothing for none stated."""
    model = measurement.fits[0].model if measurement.fits else None
    lines = budget(measurement.samples, model)
    if not lines:
        return ""
    rows = [
        [
            escape(line.name),
            escape(line.correlation.value),
            number(100.0 * line.of_sample, ".2g"),
            number(100.0 * line.share_of_sample, ".0f"),
            number(100.0 * line.of_session, ".2g"),
            number(100.0 * line.share_of_session, ".0f"),
        ]
        for line in lines
    ]
    head = ["Error", "shared", "u of a sample / %", "its share / %", "u of the mean / %", "its share / %"]
    single = max(lines, key=lambda line: line.share_of_sample)
    caption = (
        f"A single sample is limited by the {escape(single.name)} (medians over all samples), the mean of "
        f"all by the {escape(lines[0].name)}. Shares are of the variance. What is shared "
        "does not average out."
    )
    return "<h3>What dominates</h3>" + table(head, rows, caption=caption)
