"""A session's page: one self-contained HTML file with figures, tables and the numbers' provenance.

Everything is inside the file: no script, no link to the outside. The same inputs give the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING

from analysis import report_sections as sections
from analysis.evaluation import evaluate_fit
from rig.files import whole_file

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import numpy as np
    import xarray as xr
    from numpy.typing import ArrayLike, NDArray

    from analysis.fit import FitResult
    from analysis.measurement import Image

_FOOTER = (
    "Uncertainties are standard (k = 1) unless U (k = 2) is said. f<sub>r</sub> in sr<sup>−1</sup>, without "
    "cosine. θ from the sample's normal, φ from its mark. Roughness is the distribution's own parameter."
)


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

    Raises
    ------
    BadInput, Refused
        The file cannot be written, or the disk is full; an earlier page stays.
    """
    page = build_page(title, measurements, lead=lead, facts=facts or {})
    with whole_file(path) as file:
        file.write_text(page, encoding="utf-8")


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
        facts=sections.facts(facts),
        nav=f"<nav>{''.join(links)}</nav>" if len(links) > 1 else "",
        body=summary + "\n".join(_section(n, m) for n, m in enumerate(measurements, 1)),
        footer=_FOOTER,
    )


def _summary(measurements: Sequence[Measurement]) -> str:
    rows = []
    for measurement in measurements:
        for fitted in measurement.fits[:1]:
            pulls = [row.pull for row in sections.rows_of(measurement, fitted, measurement.truth)]
            largest = max((abs(pull) for pull in pulls if pull is not None), default=None)
            rows.append(
                [
                    escape(measurement.title),
                    escape(fitted.model.NAME),
                    str(measurement.samples.sizes["sample"]),
                    sections.number(fitted.metrics.get("rms_log")),
                    sections.number(fitted.metrics.get("median_relative")),
                    sections.number(largest, ".2f"),
                ]
            )
    head = ["Sample", "Model", "Directions", "RMS Δ ln(1 + f cos)", "Median |Δf| / f", "Largest |pull|"]
    return sections.table(head, rows) if rows else ""


def _section(number: int, measurement: Measurement) -> str:
    parts = [
        f'<section id="sample-{number}"><h2>{escape(measurement.title)}</h2>',
        sections.facts(measurement.facts),
        sections.parameters(measurement) + sections.colours(measurement) if measurement.fits else "",
        sections.coverage(measurement.samples),
        sections.frame(measurement.frame) if measurement.frame is not None else "",
        sections.lobes(measurement),
    ]
    if measurement.fits:
        evaluation = evaluate_fit(measurement.samples, measurement.fits[0].model)
        parts.append(sections.quality(measurement, evaluation))
    parts += [sections.uncertainty(measurement), sections.pixels(measurement), "</section>"]
    return "\n".join(part for part in parts if part)
