"""A session's page: one self-contained HTML file with figures, tables and the numbers' provenance.

Everything is inside the file: no script, no link to the outside. The same inputs give the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING

import numpy as np

from analysis import figures
from analysis.evaluation import evaluate_fit
from analysis.style import data_uri
from analysis.table import Row, parameter_rows, rounded

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import xarray as xr
    from numpy.typing import ArrayLike, NDArray

    from analysis.evaluation import Evaluation
    from analysis.fit import FitResult
    from analysis.measurement import Image

SVG = "image/svg+xml"
FAR_PULL = 3.0


@dataclass(frozen=True)
class ShownFrame:
    """One merged frame to show.

    Attributes
    ----------
    image : Image
        Radiance, variance, flags.
    channel : (H, W) int
        Colour channel of each pixel.
    caption : str
        Which pose and exposures.
    """

    image: Image
    channel: NDArray[np.intp]
    caption: str


@dataclass(frozen=True)
class Measurement:
    """What the page shows of one sample.

    Attributes
    ----------
    title : str
        The sample's name.
    samples : Dataset
        The reduced samples.
    fits : sequence of FitResult
        Models fitted to them; the first is the one discussed.
    truth : mapping of str to float or (C,), optional
        True parameters of the first model, where the twin made the data.
    frame : ShownFrame, optional
        An HDR frame.
    sphere_png : bytes, optional
        A sphere rendered with the first fit.
    exposure_s : mapping of str to sequence of float
        Exposures used, by pass.
    facts : mapping of str to str
        Whatever identifies the session: name and value, shown as they are.
    """

    title: str
    samples: xr.Dataset
    fits: Sequence[FitResult] = ()
    truth: Mapping[str, ArrayLike] | None = None
    frame: ShownFrame | None = None
    sphere_png: bytes | None = None
    exposure_s: Mapping[str, Sequence[float]] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)


def write_report(
    path: Path,
    title: str,
    measurements: Sequence[Measurement],
    *,
    lead: str = "",
    facts: Mapping[str, str] | None = None,
) -> None:
    """Write the page.

    Parameters
    ----------
    path : Path
        File to write; its folder exists.
    title, lead : str
        Heading, and one sentence under it.
    measurements : sequence of Measurement
        One section each.
    facts : mapping of str to str, optional
        What holds for all of them: machine, its hash, versions.
    """
    path.write_text(build_page(title, measurements, lead=lead, facts=facts or {}), encoding="utf-8")


def build_page(
    title: str, measurements: Sequence[Measurement], *, lead: str, facts: Mapping[str, str]
) -> str:
    """Compose the page as HTML; see `write_report`."""
    template = Template(files("analysis").joinpath("report.html").read_text(encoding="utf-8"))
    links = [f'<a href="#sample-{n}">{escape(m.title)}</a>' for n, m in enumerate(measurements, 1)]
    summary = _summary(measurements) if len(measurements) > 1 else ""
    return template.substitute(
        title=escape(title),
        lead=escape(lead),
        facts=_facts(facts),
        nav=f"<nav>{''.join(links)}</nav>" if len(links) > 1 else "",
        body=summary + "\n".join(_section(n, m) for n, m in enumerate(measurements, 1)),
        footer=(
            "Uncertainties are standard (k = 1) unless U (k = 2) is said. f<sub>r</sub> in sr<sup>−1</sup>, without "
            "cosine. Angles from the sample's normal; &phi; from its mark. Roughness is the distribution's own parameter."
        ),
    )


def _facts(facts: Mapping[str, str]) -> str:
    if not facts:
        return ""
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in facts.items())
    return f'<dl class="facts">{items}</dl>'


def _summary(measurements: Sequence[Measurement]) -> str:
    rows = []
    for measurement in measurements:
        for fitted in measurement.fits[:1]:
            metrics = fitted.metrics
            rows.append(
                f"<tr><td>{escape(measurement.title)}</td><td>{escape(fitted.model.NAME)}</td>"
                f"<td>{measurement.samples.sizes['sample']}</td>"
                + "".join(f"<td>{_metric(metrics, name)}</td>" for name in ("rms_log", "median_relative"))
                + f"<td>{_worst_pull(measurement)}</td></tr>"
            )
    return (
        '<div class="scroll"><table><thead><tr><th>Sample</th><th>Model</th><th>Directions</th><th>RMS ln(1 + f cos)</th>'
        "<th>Median |Δf|/f</th><th>Largest |pull|</th></tr></thead><tbody>"
        + "".join(rows)
        + "</tbody></table></div>"
    )


def _worst_pull(measurement: Measurement) -> str:
    rows = _rows(measurement, measurement.fits[0], measurement.truth)
    pulls = [abs(row.pull) for row in rows if row.pull is not None]
    return f"{max(pulls):.2f}" if pulls else "–"


def _metric(metrics: Mapping[str, float], name: str) -> str:
    value = metrics.get(name)
    return "–" if value is None or not np.isfinite(value) else f"{value:.3g}"


def _rows(measurement: Measurement, fitted: FitResult, truth: Mapping[str, ArrayLike] | None) -> list[Row]:
    return parameter_rows(fitted, figures.channel_names(measurement.samples), truth)


def _section(number: int, measurement: Measurement) -> str:
    samples = measurement.samples
    parts = [f'<section id="sample-{number}"><h2>{escape(measurement.title)}</h2>', _facts(measurement.facts)]
    evaluation = None
    if measurement.fits:
        evaluation = evaluate_fit(samples, measurement.fits[0].model)
        parts.append(_parameters(measurement))
    parts.append(_coverage(samples))
    if measurement.frame is not None:
        parts.append(_frame(measurement.frame))
    parts.append(_lobes(measurement))
    if evaluation is not None:
        parts.append(_quality(measurement, evaluation))
    parts.append(_pixels(measurement))
    parts.append("</section>")
    return "\n".join(part for part in parts if part)


def _parameters(measurement: Measurement) -> str:
    tables = [
        _parameter_table(measurement, fitted, measurement.truth if index == 0 else None)
        for index, fitted in enumerate(measurement.fits)
    ]
    tables.append(_metrics_table(measurement.fits))
    sphere = ""
    if measurement.sphere_png is not None:
        name = escape(measurement.fits[0].model.NAME)
        sphere = (
            f'<figure><img alt="Sphere rendered with the fitted {name} model" '
            f'src="{data_uri(measurement.sphere_png, "image/png")}"><figcaption>A sphere with the fitted '
            f"<span>{name}</span> model, rendered by Mitsuba.</figcaption></figure>"
        )
    return f'<h3>Parameters</h3><div class="pair"><div class="scroll">{"".join(tables)}</div>{sphere}</div>'


def _parameter_table(
    measurement: Measurement, fitted: FitResult, truth: Mapping[str, ArrayLike] | None
) -> str:
    rows = _rows(measurement, fitted, truth)
    known = any(row.true is not None for row in rows)
    head = "<th>Parameter</th><th></th>" + ("<th>True</th>" if known else "") + "<th>Recovered</th><th>u</th>"
    head += "<th>u, %</th>" + ("<th>Pull</th>" if known else "")
    body, previous = [], ""
    for row in rows:
        value, u = rounded(row.value, row.u)
        cells = [
            f"<td>{_symbol(row.name) if row.name != previous else ''}</td>",
            f"<td>{escape(row.channel)}</td>",
        ]
        if known:
            cells.append(f"<td>{'' if row.true is None else f'{row.true:.6g}'}</td>")
        relative = f"{100 * row.u / abs(row.value):.2g}" if row.value and np.isfinite(row.u) else ""
        cells += [f"<td>{value}</td>", f"<td>{u}</td>", f"<td>{relative}</td>"]
        if known:
            far = ' class="far"' if row.pull is not None and abs(row.pull) > FAR_PULL else ""
            cells.append(f"<td{far}>{'' if row.pull is None else f'{row.pull:+.2f}'.replace('-', '−')}</td>")
        first = ' class="first"' if row.name != previous and body else ""
        body.append(f"<tr{first}>{''.join(cells)}</tr>")
        previous = row.name
    note = f"{escape(fitted.model.NAME)}" + (f": {escape(fitted.message)}" if fitted.message else "")
    return f"<table><caption>{note}</caption><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"


_SYMBOLS = {
    "kd": "k<sub>d</sub>",
    "ks": "k<sub>s</sub>",
    "m": "m",
    "exponent": "n, exponent",
    "ior": "index of refraction",
    "ks_F0": "k<sub>s</sub> F<sub>0</sub>",
}


def _symbol(name: str) -> str:
    return f'<i class="v">{_SYMBOLS[name]}</i>' if name in _SYMBOLS else escape(name)


_METRICS = {
    "rms_log": "RMS of Δ ln(1 + f cos θ<sub>i</sub>)",
    "l2_cos": "cosine-weighted RMS, sr<sup>−1</sup>",
    "rms_cbrt": "RMS of Δ (f cos θ<sub>i</sub>)<sup>1/3</sup>",
    "median_relative": "median |Δf| / f",
    "chi2_dof": "χ² per degree of freedom",
}


def _metrics_table(fits: Sequence[FitResult]) -> str:
    names = [name for name in _METRICS if any(name in fitted.metrics for fitted in fits)]
    head = "".join(f"<th>{escape(fitted.model.NAME)}</th>" for fitted in fits)
    body = "".join(
        f"<tr><td>{_METRICS[name]}</td>{''.join(f'<td>{_metric(fitted.metrics, name)}</td>' for fitted in fits)}</tr>"
        for name in names
    )
    return (
        f"<table><thead><tr><th>Goodness of fit</th>{head}</tr></thead><tbody>{body}</tbody></table>"
        if names
        else ""
    )


def _figure(svg: bytes, alt: str, caption: str) -> str:
    return f'<figure><img alt="{escape(alt)}" src="{data_uri(svg, SVG)}"><figcaption>{caption}</figcaption></figure>'


def _coverage(samples: xr.Dataset) -> str:
    poses = np.unique(samples["pose"].to_numpy()).size if "pose" in samples else 0
    from_poses = f" from {poses} poses" if poses else ""
    return "<h3>Pose coverage</h3>" + _figure(
        figures.coverage(samples),
        "Polar plots of light and camera directions",
        f"{samples.sizes['sample']} direction pairs{from_poses}. The plots look down on the sample: the centre is its normal, "
        "the rim the horizon, 0° its mark. Each image of the flat sample gives a patch of directions.",
    )


def _frame(frame: ShownFrame) -> str:
    image = frame.image
    return "<h3>One merged frame</h3>" + _figure(
        figures.frame(image.radiance, image.variance, image.flags, frame.channel),
        "Radiance, relative noise and flags of one merged frame",
        f"{escape(frame.caption)}. Radiance is the mean of each quad's sites in the camera's own channels, sRGB-encoded, "
        "not demosaiced. Noise is the merge's standard uncertainty per pixel; it follows the colour filter's mosaic.",
    )


def _lobes(measurement: Measurement) -> str:
    samples = measurement.samples
    if not figures.incidences(samples):
        return ""
    names = figures.channel_names(samples)
    channel = names.index("G") if "G" in names else 0
    models = {fitted.model.NAME: fitted.model for fitted in measurement.fits[:4]}
    return "<h3>Lobes in the plane of incidence</h3>" + _figure(
        figures.lobes(samples, models, channel),
        "BRDF over camera angle in the plane of incidence",
        f"Channel {escape(names[channel])}. Points: bins within {np.rad2deg(figures.IN_PLANE_RAD):.1f}° of the plane and "
        f"{np.rad2deg(figures.NEAR_INCIDENCE_RAD):.1f}° of the angle of incidence, with bars of U (k = 2) from noise, white, "
        "reference and binning. Lines: the fitted models at that angle.",
    )


def _quality(measurement: Measurement, evaluation: Evaluation) -> str:
    samples = measurement.samples
    parts = [
        "<h3>Residuals</h3>",
        _figure(
            figures.residuals(samples, evaluation),
            "Residuals over half-vector angle and histogram of pulls",
            f"Samples against the fitted {escape(measurement.fits[0].model.NAME)}. A pull is a residual over the stated "
            "uncertainty of everything that scatters it (noise, white, binning, pose); the white's reflectance moves all "
            "samples together and is not in it.",
        ),
    ]
    if evaluation.columns:
        parts += [
            "<h3>Uncertainty budget</h3>",
            _figure(
                figures.budget(samples, evaluation),
                "Relative standard uncertainty by source",
                "Median relative standard uncertainty of a sample by source. <i>noise</i> is independent; <i>white</i> is "
                "shared where samples share a white bin; <i>pose</i> (the encoders' resolution) by all pixels of a pose; "
                "<i>reference</i> (the white's reflectance) by everything.",
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
        low, middle, high = np.nanpercentile(percent, [5, 50, 95])
        rows.append(
            f"<tr><td>{escape(name)}</td><td>{low:.2g}</td><td>{middle:.2g}</td><td>{high:.2g}</td>"
            f"<td>{np.nanmean(share):.0f}</td></tr>"
        )
    return (
        '<div class="scroll"><table><thead><tr><th>Source</th><th>5th percentile, %</th><th>median u / f, %</th>'
        f"<th>95th percentile, %</th><th>mean share of variance, %</th></tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _pixels(measurement: Measurement) -> str:
    counts = _counts(measurement.samples)
    parts = []
    if measurement.exposure_s:
        parts += [
            "<h3>Exposures and flags</h3>",
            _figure(
                figures.exposures(measurement.exposure_s),
                "Histogram of exposures",
                "Exposures of all frames by pass, each chosen from what the sensor had seen.",
            ),
        ]
    elif counts:
        parts.append("<h3>Flags</h3>")
    return "".join(parts) + counts


def _counts(samples: xr.Dataset) -> str:
    groups = {"pixels_": "Sample pixels flagged", "dropped_": "Channel values dropped"}
    rows = []
    for prefix, label in groups.items():
        for name, count in samples.attrs.items():
            if name.startswith(prefix):
                rows.append(
                    f"<tr><td>{label}: {escape(name.removeprefix(prefix).replace('_', ' '))}</td><td>{int(count)}</td></tr>"
                )
    if not rows:
        return ""
    return f"<table><thead><tr><th>What</th><th>Count</th></tr></thead><tbody>{''.join(rows)}</tbody></table>"
