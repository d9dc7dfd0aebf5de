"""The page of `gonio calibrate colour`: the chart as measured and as it should look; one file."""

from __future__ import annotations

from html import escape
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING

import numpy as np

from analysis import report_sections as sections
from analysis.appearance import encode_srgb
from analysis.colour_chart import COLUMNS, ROWS
from analysis.style import figure, to_svg
from rig.files import whole_file

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from analysis.colour_calibration import ChartColours, ColourCalibration
    from analysis.colour_chart import ChartReading

WIDTH_IN, HEIGHT_IN = 7.2, 4.9
LEAD = "What a chart of known reflectances says of this camera's colours."
FOOTER = (
    "Colour differences are CIEDE2000. Patches were left out one at a time: the differences are those of "
    "colours that the fit has not seen. BRDFs stay in the camera's bands; XYZ and sRGB are derived."
)


def write_colour_page(
    path: Path,
    calibration: ColourCalibration,
    colours: ChartColours,
    reading: ChartReading,
    *,
    names: Sequence[str],
    doubts: Sequence[str],
) -> None:
    """Write the page.

    Parameters
    ----------
    path : Path
        File to write; its folder exists.
    calibration, colours, reading
        What was found.
    names : sequence of 24 str
        Of the patches.
    doubts : sequence of str
        What a person should know before believing it.

    Raises
    ------
    BadInput, Refused
        The page cannot be written, or the disk is full; an earlier page stays.
    """
    template = Template(files("analysis").joinpath("report.html").read_text(encoding="utf-8"))
    page = template.substitute(
        title=escape(f"Colours of {calibration.camera or 'a camera'}"),
        lead=LEAD,
        facts=sections.facts(_facts(calibration, colours, reading)),
        nav="",
        body="\n".join(
            [
                sections.doubts(doubts),
                _picture(calibration, colours),
                _fits(colours),
                _patches(calibration, colours, names),
            ]
        ),
        footer=FOOTER,
    )
    with whole_file(path) as file:
        file.write_text(page, encoding="utf-8")


def _facts(calibration: ColourCalibration, colours: ChartColours, reading: ChartReading) -> dict[str, str]:
    uneven = np.abs(colours.slopes).max()
    return {
        "Date": calibration.date,
        "Channels": ", ".join(calibration.channels),
        "Colours under": calibration.lamp,
        "Chart": f"{reading.order}, agrees with its reference to {reading.agreement:.3f}",
        "Uneven light, taken off": f"{100.0 * uneven:.0f} % across the chart",
        "Left-out patches": f"ΔE00 {calibration.delta_e_mean:.2f}, at most {calibration.delta_e_max:.2f}",
    }


def _picture(calibration: ColourCalibration, colours: ChartColours) -> str:
    from matplotlib.patches import Rectangle

    found = calibration.linear_srgb(colours.values)
    known = colours.reference_xyz @ calibration.xyz_to_linear_srgb().T
    shown = [encode_srgb(each) for each in (known, found)]
    with figure(WIDTH_IN, HEIGHT_IN) as drawn:
        axes = drawn.add_subplot()
        for number, (outer, inner) in enumerate(zip(*shown, strict=True)):
            column, row = number % COLUMNS, ROWS - 1 - number // COLUMNS
            axes.add_patch(Rectangle((column + 0.04, row + 0.04), 0.92, 0.92, color=outer))
            axes.add_patch(Rectangle((column + 0.25, row + 0.25), 0.5, 0.5, color=inner))
        axes.set(xlim=(0, COLUMNS), ylim=(0, ROWS), aspect="equal")
        axes.axis("off")
        svg = to_svg(drawn)
    caption = "Each patch as its reference says, and in its middle as measured, both in sRGB."
    return f"<section><h2>The chart</h2>{sections.picture(svg, 'chart', caption)}</section>"


def _fits(colours: ChartColours) -> str:
    rows = [
        (
            "matrix" if fit.degree == 1 else f"root polynomial of degree {fit.degree}",
            sections.number(float(np.median(fit.left_out)), ".2f"),
            sections.number(float(fit.left_out.mean()), ".2f"),
            sections.number(float(fit.left_out.max()), ".2f"),
            sections.number(float(fit.delta_e.mean()), ".2f"),
        )
        for fit in colours.fits
    ]
    caption = "ΔE00 of patches that were left out: median, mean, largest; last, of all patches fitted."
    head = ("correction", "median", "mean", "largest", "fitted")
    return f"<section><h2>Corrections</h2>{sections.table(head, rows, caption=caption)}</section>"


def _patches(calibration: ColourCalibration, colours: ChartColours, names: Sequence[str]) -> str:
    rows = [
        (
            escape(name),
            *(sections.number(float(value), ".4f") for value in values),
            *(sections.number(float(value), ".4f") for value in xyz),
            sections.number(float(left_out), ".2f"),
        )
        for name, values, xyz, left_out in zip(
            names, colours.values, calibration.xyz(colours.values), colours.matrix.left_out, strict=True
        )
    ]
    head = ("patch", *(escape(name) for name in calibration.channels), "X", "Y", "Z", "ΔE00")
    return f"<section><h2>Patches</h2>{sections.table(head, rows)}</section>"
