"""The page of `gonio calibrate sensor`: the data sheet, photon transfer, linearity, darks; one file.

Everything is inside the file, as in `analysis.report`.
"""

from __future__ import annotations

from html import escape
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING

import numpy as np

from analysis import report_sections as sections
from analysis.style import ACCENT, FAINT, INK, channel_colour, figure, to_svg
from capture.linearity import FILL
from capture.ptc import LARGEST_FILL
from capture.sensor_summary import Quantity, quantities
from rig.files import whole_file

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from capture.characterise import SensorCharacter
    from capture.sensor import SensorModel

WIDTH_IN, HEIGHT_IN = 7.2, 3.1
LEAD = "What this camera's own frames say of its sensor."
FOOTER = (
    "Quantities and symbols after EMVA 1288 release 4. Those that need a calibrated photon count (quantum "
    "efficiency, thresholds in photons) are not among them. Uncertainties are standard, k = 1."
)
_BINS = 60


def write_sensor_page(
    path: Path, character: SensorCharacter, model: SensorModel, doubts: Sequence[str]
) -> None:
    """Write the page.

    Parameters
    ----------
    path : Path
        File to write; its folder exists.
    character : SensorCharacter
    model : SensorModel
        What was made of it.
    doubts : sequence of str
        What a person should know before believing it.

    Raises
    ------
    BadInput, Refused
        The page cannot be written, or the disk is full; an earlier page stays.
    """
    template = Template(files("analysis").joinpath("report.html").read_text(encoding="utf-8"))
    parts = [
        sections.doubts(doubts),
        _data_sheet(quantities(character)),
        _channels(character),
        _transfer(character),
        _linearity(character) if character.linearity else "",
        _darks(character),
    ]
    page = template.substitute(
        title=escape(f"Sensor of {character.camera_serial or character.camera_model or 'a camera'}"),
        lead=LEAD,
        facts=sections.facts(_facts(character, model)),
        nav="",
        body="\n".join(part for part in parts if part),
        footer=FOOTER,
    )
    with whole_file(path) as file:
        file.write_text(page, encoding="utf-8")


def _facts(character: SensorCharacter, model: SensorModel) -> dict[str, str]:
    height, width = character.dark.shape
    stated = {
        "Camera": character.camera_model,
        "Serial number": character.camera_serial,
        "ISO": None if character.iso is None else f"{character.iso:g}",
        "Date": model.date,
        "Lamp head": None
        if model.lamp_temperature_deg_c is None
        else f"{model.lamp_temperature_deg_c:.1f} °C",
        "Frame": f"{width} × {height} pixels, {', '.join(character.channels)}",
        "How": model.note,
    }
    return {name: text for name, text in stated.items() if text}


def _data_sheet(items: Sequence[Quantity]) -> str:
    rows = [
        (
            escape(item.name),
            escape(item.symbol),
            sections.number(item.value, ".5g"),
            _u(item.u),
            escape(item.unit),
        )
        for item in items
    ]
    return (
        f"<section><h2>Data sheet</h2>{sections.table(('', 'symbol', 'value', 'u', 'unit'), rows)}</section>"
    )


def _u(value: float | None) -> str:
    return "" if value is None else sections.number(value, ".2g")


def _channels(character: SensorCharacter) -> str:
    rows = [
        (
            escape(name),
            sections.number(each.gain_dn_per_e, ".5g"),
            sections.number(each.u_gain_dn_per_e, ".2g"),
            sections.number(each.read_noise_dn, ".4g"),
            sections.number(clip, ".6g"),
        )
        for name, each, clip in zip(character.channels, character.transfer_of, character.clip_dn, strict=True)
    ]
    caption = "Clip level: six standard deviations below the reading of saturated pixels, black included."
    head = ("channel", "K / DN/e⁻", "u", "read noise / DN", "clip / DN")
    return f"<section><h3>Channels</h3>{sections.table(head, rows, caption=caption)}</section>"


def _transfer(character: SensorCharacter) -> str:
    points, line = character.points, character.transfer
    with figure(WIDTH_IN, HEIGHT_IN) as drawn:
        axes: Sequence[Axes] = drawn.subplots(1, 2)
        top = float(points.mean_dn.max())
        for index, name in enumerate(character.channels):
            mean, variance = _binned(points.of(index).mean_dn, points.of(index).variance_dn2, top)
            colour = channel_colour(name, index)
            axes[0].plot(mean, variance, ".", color=colour, markersize=4, label=name)
            expected = line.gain_dn_per_e * mean + line.floor_dn2
            axes[1].plot(mean, 100.0 * (variance / expected - 1.0), ".", color=colour, markersize=4)
        span = np.array([0.0, top])
        axes[0].plot(span, line.gain_dn_per_e * span + line.floor_dn2, color=INK, linewidth=0.8)
        axes[0].set(xlabel="mean above bias / DN", ylabel="variance over time / DN²")
        axes[0].legend()
        axes[1].axhline(0.0, color=INK, linewidth=0.8)
        axes[1].set(xlabel="mean above bias / DN", ylabel="deviation from the line / %")
        svg = to_svg(drawn)
    caption = (
        f"Photon transfer up to {100 * LARGEST_FILL:.0f} % of the range: {line.points} tiles of pixels, here "
        f"means over bins; χ² per point {line.reduced_chi_square:.3g}."
    )
    return f"<section>{sections.picture(svg, 'photon transfer', caption)}</section>"


def _binned(mean: np.ndarray, variance: np.ndarray, top: float) -> tuple[np.ndarray, np.ndarray]:
    """Means over bins of the signal; empty bins are left out."""
    edges = np.linspace(min(float(mean.min()), 0.0), top * (1.0 + 1e-9), _BINS + 1)
    index = np.digitize(mean, edges)
    used = np.unique(index)
    means = [[values[index == one].mean() for one in used] for values in (mean, variance)]
    return np.array(means[0]), np.array(means[1])


def _linearity(character: SensorCharacter) -> str:
    with figure(WIDTH_IN, HEIGHT_IN) as drawn:
        axes = drawn.subplots()
        for index, (name, each) in enumerate(zip(character.channels, character.linearity, strict=False)):
            axes.plot(
                each.signal_dn,
                100.0 * each.deviation,
                "o-",
                color=channel_colour(name, index),
                markersize=3,
                linewidth=0.7,
                label=name,
            )
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.set(xlabel="mean light signal / DN", ylabel="deviation from a straight line / %")
        axes.legend()
        svg = to_svg(drawn)
    caption = (
        f"Linearity: signal over exposure time between {100 * FILL[0]:.0f} and {100 * FILL[1]:.0f} % of the "
        "range, against the line of least relative deviations. Errors of exposure times are in it."
    )
    return f"<section>{sections.picture(svg, 'linearity', caption)}</section>"


def _darks(character: SensorCharacter) -> str:
    dark = character.dark
    rates = dark.rate_dn_per_s.astype(np.float64)
    with figure(WIDTH_IN, HEIGHT_IN) as drawn:
        axes: Sequence[Axes] = drawn.subplots(1, 2)
        ordinary = ~dark.hot
        levels = [float(mean[ordinary].mean(dtype=np.float64)) for mean in dark.mean_dn]
        axes[0].plot(dark.exposure_s, levels, "o", color=INK, markersize=4)
        axes[0].set(xlabel="exposure / s", ylabel="mean dark level / DN")
        lowest = max(abs(character.dark_current_dn_per_s), 1e-6)
        shown = np.log10(np.maximum(rates, 0.1 * lowest))
        edges = np.linspace(shown.min(), shown.max() + 1e-6, _BINS).tolist()
        axes[1].hist(shown[ordinary], bins=edges, color=FAINT, label="ordinary")
        if dark.hot.any():
            axes[1].hist(shown[dark.hot], bins=edges, color=ACCENT, label="hot")
        axes[1].set_yscale("log")
        axes[1].set(xlabel="dark rate, $\\log_{10}$ of DN/s", ylabel="pixels")
        axes[1].legend()
        svg = to_svg(drawn)
    share = 100.0 * float(dark.hot.mean())
    caption = f"Darks: {sum(dark.frames)} frames; {int(dark.hot.sum())} hot pixels, {share:.2g} %."
    return f"<section>{sections.picture(svg, 'dark level and dark rates', caption)}</section>"
