"""The figures of `docs/data.md`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.style import ACCENT, FAINT, INK, SERIES, figure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

WIDTH_IN, HEIGHT_IN = 7.2, 3.4
DOTS_PER_INCH = 110


def draw_errors(
    path: Path, errors: Mapping[str, Mapping[str, Array]], samples: int, target_percent: float
) -> None:
    """Draw the distribution of relative errors, in percent, by table and Mitsuba's variant."""
    with figure(WIDTH_IN, HEIGHT_IN) as drawn:
        axes = drawn.subplots()
        for colour, (name, by_variant) in zip(SERIES, errors.items(), strict=False):
            for style, (variant, error) in zip(("-", ":"), by_variant.items(), strict=False):
                share = (np.arange(len(error)) + 0.5) / len(error)
                axes.plot(np.sort(error), 100.0 * share, style, color=colour, label=f"{name}, {variant}")
        axes.axvline(target_percent, color=ACCENT, lw=0.8)
        axes.axhline(50.0, color=FAINT, lw=0.8)
        axes.set(xscale="log", xlim=(0.01, 30.0), ylim=(0.0, 100.0))
        axes.set_xlabel("relative error off the peak, %")
        axes.set_ylabel("directions with less, %")
        axes.set_title(
            f"Tables from {samples:,} scattered samples by Mitsuba; the median is to lie left of the line"
        )
        axes.legend(loc="upper left", fontsize=7.5)
        _save(drawn, path)


def draw_reciprocity(
    path: Path, published: Mapping[str, float], plain: Mapping[str, float], albedos: Sequence[Array]
) -> None:
    """Draw reciprocity (percent) by material, and known albedos against those from one side of the plane.

    Parameters
    ----------
    path : Path
        Where to.
    published, plain : mapping of str to float
        Median violation as published and without the cosine.
    albedos : sequence of ndarray
        True albedo, that from one side of the plane, its uncertainty.
    """
    with figure(WIDTH_IN, HEIGHT_IN) as drawn:
        left, right = drawn.subplots(1, 2)
        place = np.arange(len(published))
        left.barh(place + 0.2, list(published.values()), 0.36, color=ACCENT, label="as published")
        left.barh(place - 0.2, list(plain.values()), 0.36, color=INK, label="without the cosine")
        left.set_yticks(place, list(published), fontsize=8)
        left.set_xlabel("median reciprocity violation, %")
        left.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=7.5)
        true, found, u = np.array(albedos).T
        right.errorbar(true, found, yerr=u, fmt=".", ms=4, color=INK, ecolor=FAINT, elinewidth=0.7)
        ends = [0.9 * true.min(), 1.1 * true.max()]
        right.plot(ends, ends, color=ACCENT, lw=0.8)
        right.set(xscale="log", yscale="log")
        right.minorticks_off()
        right.set_xlabel("albedo of the whole hemisphere")
        right.set_ylabel("from one side of the plane")
        _save(drawn, path)


def draw_repeatability(path: Path, level: Array, deviation: Array, model: tuple[Array, Array]) -> None:
    """Draw standard deviations between files against the level of their mean, and what is stated of them.

    Parameters
    ----------
    path : Path
        Where to.
    level, deviation : ndarray, shape (N,)
        Of each cell.
    model : tuple of ndarray
        Levels, and the standard deviation that is stated there.
    """
    with figure(WIDTH_IN, HEIGHT_IN) as drawn:
        axes = drawn.subplots()
        axes.loglog(level, deviation, ".", ms=2.0, color=INK, mec="none", alpha=0.4)
        axes.loglog(*model, color=ACCENT)
        axes.set_xlabel("reading RT, mean of the files")
        axes.set_ylabel("standard deviation between files")
        axes.set_title("One sample at three stage angles; the line is what the recipes state of one file")
        _save(drawn, path)


def _save(drawn: Figure, path: Path) -> None:
    drawn.savefig(path, dpi=DOTS_PER_INCH, metadata={"Software": None})
