"""The page of `gonio check`: findings, coverage with its holes, reciprocal pairs, readings; one file each.

Everything is inside the file, as in `analysis.report`.
"""

from __future__ import annotations

from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

import numpy as np

from analysis import report_sections as sections
from analysis.pairing import reciprocal_pairs, relative_difference, usable_samples
from analysis.style import ACCENT, FAINT, INK, data_uri, figure, to_svg
from rig.files import whole_file

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr

    from analysis.checks import Finding
    from analysis.doctor import Diagnosis
    from analysis.pairing import Usable

WIDTH_IN, HEIGHT_IN = 7.2, 3.3
MOST_INCIDENCES = 6
MOST_POINTS = 6000
FEW_POINTS = 300
"""Up to so many are drawn larger."""
SHOWN_READINGS = 6
LEAD = "What physics and arithmetic say of the samples, before anybody believes them."
FOOTER = (
    "Relative differences are |a − b| over the larger of both. Nothing in the files was changed. "
    "θ from the sample's normal; azimuth of the view counted from the light's."
)


def write_check_page(path: Path, checked: Sequence[tuple[str, xr.Dataset, list[Finding], Diagnosis]]) -> None:
    """Write the page.

    Parameters
    ----------
    path : Path
        File to write; its folder exists.
    checked : sequence of (str, Dataset, list of Finding, Diagnosis)
        File, samples, findings, readings; one section each.

    Raises
    ------
    BadInput, Refused
        The page cannot be written, or the disk is full; an earlier page stays.
    """
    template = Template(files("analysis").joinpath("report.html").read_text(encoding="utf-8"))
    page = template.substitute(
        title="Checks of samples",
        lead=LEAD,
        facts="",
        nav="",
        body="\n".join(_section(*each) for each in checked),
        footer=FOOTER,
    )
    with whole_file(path) as file:
        file.write_text(page, encoding="utf-8")


def _section(file: str, samples: xr.Dataset, findings: list[Finding], diagnosis: Diagnosis) -> str:
    from analysis.checks import worst

    usable = usable_samples(samples)
    size = (
        f"{samples.sizes['sample']} samples in {samples.sizes['channel']} channel(s), {len(usable.wi)} usable"
    )
    parts = [
        f"<section><h2>{escape(file)}</h2>",
        sections.facts({"Verdict": worst(findings).value, "Size": size} | _source(file, samples)),
        _findings_table(findings),
        _notes(findings),
        _coverage(usable) if len(usable.wi) else "",
        _reciprocity(usable),
        _readings_table(diagnosis),
        "</section>",
    ]
    return "\n".join(part for part in parts if part)


def _source(file: str, samples: xr.Dataset) -> dict[str, str]:
    """Name what the samples come from, where the file's name does not: one of several materials, a blank."""
    source = str(samples.attrs.get("source", ""))
    return {} if not source or source == Path(file).name else {"Samples": source}


def _findings_table(findings: Sequence[Finding]) -> str:
    rows = []
    for each in findings:
        verdict = escape(each.verdict.value)
        marked = f'<b class="far">{verdict}</b>' if verdict in {"warn", "fail"} else verdict
        limits = (sections.number(limit) for limit in (each.warn, each.fail))
        says = f'<span class="says">{escape(each.quantity)}</span>'
        value = sections.number(each.value, ".4g")
        rows.append([escape(each.name), marked, value, *limits, str(each.count), says])
    head = [
        "Check",
        "Verdict",
        "Number",
        "Warn above",
        "Fail above",
        "From",
        '<span class="says">Number is</span>',
    ]
    return sections.table(head, rows)


def _notes(findings: Sequence[Finding]) -> str:
    items = {each.name: _note(each) for each in findings if each.meaning}
    return "<h3>What it may mean, and where to look</h3>" + sections.facts(items) if items else ""


def _note(finding: Finding) -> str:
    meaning = f"{finding.meaning[:1].upper()}{finding.meaning[1:]}."
    return f"{meaning} Look at {finding.where}." if finding.where else meaning


def _readings_table(diagnosis: Diagnosis) -> str:
    rows = [
        [
            escape(each.reading.name),
            sections.number(each.log_odds, ".1f"),
            sections.number(each.reciprocity),
            sections.number(each.evidence.lobe_rms),
            sections.number(each.evidence.noise_rms),
            f"{each.above_horizon:.0%}",
        ]
        for each in diagnosis.ranked[:SHOWN_READINGS]
    ]
    head = ["Reading", "Log odds", "Reciprocity", "Off the lobe", "Noise", "Above horizon"]
    return f"<h3>Conventions</h3><p>{escape(diagnosis.words.capitalize())}.</p>" + sections.table(head, rows)


def _figure(svg: bytes, alt: str, caption: str) -> str:
    source = data_uri(svg, "image/svg+xml")
    return f'<figure><img alt="{escape(alt)}" src="{source}"><figcaption>{caption}</figcaption></figure>'


def _coverage(usable: Usable) -> str:
    """Draw views by incidence over the hemisphere, the light at the left."""
    from analysis.pairing import incidences

    bins = incidences(usable)
    every = max(1, int(np.ceil(len(bins) / MOST_INCIDENCES)))
    shown = bins[::every]
    columns = min(len(shown), 3)
    rows = int(np.ceil(len(shown) / columns))
    with figure(WIDTH_IN, 2.6 * rows) as drawn:
        panels = drawn.subplots(rows, columns, subplot_kw={"projection": "polar"}, squeeze=False).ravel()
        for axes, (incidence, chosen) in zip(panels, shown, strict=False):
            value = np.log10(np.maximum(np.abs(usable.f_r[chosen]).mean(axis=1), 1e-12))
            axes.scatter(
                usable.turn[chosen], np.degrees(usable.theta_o[chosen]), c=value, s=4, cmap="viridis"
            )
            axes.plot([0.0], [incidence], marker="*", ms=8, color=ACCENT)
            axes.set_rlim(0, 90)
            axes.set_rgrids([30, 60, 90], ["", "60°", ""], fontsize=7, color=FAINT)
            axes.set_thetagrids([0, 90, 180, 270], fontsize=7)
            axes.set_title(f"incidence near {incidence:g}°", pad=10)
        for axes in panels[len(shown) :]:
            axes.set_visible(False)
        svg = to_svg(drawn)
    return "<h3>Coverage</h3>" + _figure(
        svg,
        "Views over the hemisphere by incidence",
        f"Views of {len(shown)} of {len(bins)} incidences, azimuth counted from the light (star); colour is "
        "log f<sub>r</sub>. White is what nobody measured.",
    )


def _reciprocity(usable: Usable) -> str:
    """Draw reciprocal pairs against each other, and where they differ."""
    first, second, _ = reciprocal_pairs(usable)
    if not len(first):
        return ""
    if len(first) > MOST_POINTS:
        keep = np.linspace(0, len(first) - 1, MOST_POINTS).astype(int)
        first, second = first[keep], second[keep]
    a, b = usable.f_r[first].mean(axis=1), usable.f_r[second].mean(axis=1)
    difference = np.median(relative_difference(usable.f_r[first], usable.f_r[second]), axis=1)
    positive = (a > 0.0) & (b > 0.0)
    with figure(WIDTH_IN, HEIGHT_IN) as drawn:
        left, right = drawn.subplots(1, 2)
        if positive.any():
            size = 2.5 if len(a) > FEW_POINTS else 6.0
            left.loglog(a[positive], b[positive], ".", ms=size, color=INK, mec="none", alpha=0.6)
            ends = [min(a[positive].min(), b[positive].min()), max(a[positive].max(), b[positive].max())]
            left.plot(ends, ends, lw=0.8, color=ACCENT)
        left.set_xlabel("$f_r$ of one, sr$^{-1}$")
        left.set_ylabel("$f_r$ of its reciprocal, sr$^{-1}$")
        left.set_title("Reciprocal pairs")
        points = right.scatter(
            np.degrees(usable.theta_i[first]),
            np.degrees(usable.theta_o[first]),
            c=100.0 * difference,
            s=6 if len(a) > FEW_POINTS else 14,
            cmap="magma_r",
            vmin=0.0,
            vmax=max(10.0, float(100.0 * np.percentile(difference, 95))),
        )
        drawn.colorbar(points, ax=right, label="difference, %")
        right.set_xlabel("$\\theta_i$, deg")
        right.set_ylabel("$\\theta_o$, deg")
        right.set_title("Where they differ")
        svg = to_svg(drawn)
    return "<h3>Reciprocity</h3>" + _figure(
        svg,
        "Reciprocal pairs, and their differences over the polar angles",
        f"{len(first)} pairs with light and view exchanged. On the line they agree.",
    )
