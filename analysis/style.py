"""How the report's figures look and become text for a page: one place for colours, sizes, encoding."""

from __future__ import annotations

import base64
import io
import re
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure

INK = "#1d2327"
FAINT = "#8a9399"
RULE = "#d5dadd"
ACCENT = "#8c2d19"
CHANNEL_COLOURS = {"R": "#b3352b", "G": "#2f7d4f", "B": "#2b5fa5", "mono": "#3c4449"}
SERIES = ("#2b5fa5", "#b3352b", "#2f7d4f", "#b5790a", "#6b4a8e", "#3f8f95", "#8a5a3c", "#3c4449")

_STYLE: dict[str, Any] = {
    "font.family": "serif",
    "font.serif": ["STIXGeneral", "DejaVu Serif"],
    "mathtext.fontset": "stix",
    "font.size": 9.5,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.titlepad": 7.0,
    "axes.labelsize": 9.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": RULE,
    "grid.linewidth": 0.5,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "xtick.direction": "out",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.2,
    "figure.dpi": 100,
    "savefig.dpi": 200,
    "svg.hashsalt": "gonio",
    "svg.fonttype": "path",
}


@contextmanager
def figure(width_in: float, height_in: float) -> Iterator[Figure]:
    """Give an empty figure in the report's style; drawing belongs inside the block."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(cast("Any", _STYLE)):
        drawn = Figure(figsize=(width_in, height_in), layout="constrained")
        FigureCanvasAgg(drawn)
        yield drawn


def to_svg(drawn: Figure) -> bytes:
    """Encode a figure as SVG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    drawn.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return _number_ids(buffer.getvalue().decode("utf-8")).encode("utf-8")


def _number_ids(svg: str) -> str:
    """Replace the hashed ids, some of which vary from run to run, by numbers in their order."""
    hashed = dict.fromkeys(re.findall(r'\bid="([mpC]?[0-9a-f]{10}(?:_\d+_[0-9a-f]{10})?)"', svg))
    names = {name: f"n{index}" for index, name in enumerate(hashed)}
    return re.sub(r'(?<=id=")[^"]+|(?<=#)[^")]+', lambda found: names.get(found[0], found[0]), svg)


def data_uri(content: bytes, kind: str) -> str:
    """Wrap an image as a data URI; `kind` is its media type, for example image/png."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def channel_colour(name: str, index: int) -> str:
    """Colour of a channel: its own for R, G, B and mono, else the next of the series."""
    return CHANNEL_COLOURS.get(name, SERIES[index % len(SERIES)])
