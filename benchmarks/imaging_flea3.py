"""A real camera: seven exposures of two scenes in three bands, with darks of the day, against their merge.

The Flea3 delivers eight bits of twelve. No truth is known; the frames must agree with the merge. A CCD's
pixels beside clipped ones read low: the merge leaves such samples out, and both are shown, the samples and
the merge with and without them. Rows are medians; "before" are all samples of 60 to 240 DN, "after" those
whose 2 x 2 cell holds no clipped sample. Beside it stands what the noise of the frames alone would give, for
the scene of native pixels: the sensor holds few electrons. The camera cuts twelve bits to eight and its darks
are zero: its counts are taken as half a step low, and for comparison as rounded ones.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np

from benchmarks.rows import row
from capture.agreement import RANGE
from capture.block import BlockMerger
from capture.bracket import merge_bracket
from capture.merge import Flag

if TYPE_CHECKING:
    from analysis.colour_chart import ChartReading
    from capture.bracket import BracketMerge

DATA = Path(__file__).resolve().parents[1].parent / "shared" / "data" / "flea3"
SCENES = {"disks": "d1", "colorchecker": "d2"}
BANDS_NM = (450, 550, 650)


def bracket(scene: str, band_nm: int, *, truncated: bool = True) -> BracketMerge:
    """Merge one bracket with the darks of its day."""
    files = sorted((DATA / scene).glob(f"*_{band_nm}nm_*"))
    darks = sorted((DATA / "dark").glob(f"{SCENES[scene]}_*"))
    return merge_bracket(files, dark_files=darks, truncated=truncated)


def chart_in_bands(data: Path) -> tuple[ChartReading, list[ChartReading], np.ndarray]:
    """Read the ColorChecker in all bands at once and in each by itself, with what it should read (24, 3)."""
    from analysis.colour_calibration import VISIBLE_NM, reference_reflectance, typical_response
    from analysis.colour_chart import Picture, picture_of, read_chart

    bad = int(Flag.OVER_RANGE | Flag.HOT)
    planes = []
    for band_nm in BANDS_NM:
        files = sorted((data / "colorchecker").glob(f"*_{band_nm}nm_*"))
        darks = sorted((data / "dark").glob("d2_*"))
        merged = merge_bracket(files, dark_files=darks, truncated=True).merged
        planes.append(
            picture_of(
                merged.radiance.astype(np.float64), merged.flags, np.zeros((2, 2), dtype=np.int64), 1, bad
            )
        )
    values, usable = (
        np.concatenate([getattr(each, name) for each in planes], axis=-1) for name in ("values", "usable")
    )
    _, reflectance = reference_reflectance(VISIBLE_NM)
    expected = reflectance @ typical_response(VISIBLE_NM, BANDS_NM)
    alone = [read_chart(each, expected[:, c : c + 1]) for c, each in enumerate(planes)]
    return read_chart(Picture(values, usable, planes[0].px), expected), alone, expected


def _of_chart() -> list[dict[str, Any]]:
    from scipy.stats import spearmanr

    from analysis.colour_chart import levelled

    reading, alone, expected = chart_in_bands(DATA)
    level, slopes = levelled(reading.values, expected)
    rows = [
        row(
            "ColorChecker: agreement of its order with the reference",
            reading.agreement,
            "",
            0.95,
            at_least=True,
        )
    ]
    for channel, band_nm in enumerate(BANDS_NM):
        name = f"ColorChecker, {band_nm} nm"
        ranks = float(spearmanr(level[:, channel], expected[:, channel]).statistic)
        apart = np.abs(alone[channel].values[:, 0] / reading.values[:, channel] - 1.0)
        rows += [
            row(f"{name}: uneven light along it", 100.0 * float(slopes[0, channel]), "%"),
            row(f"{name}: rank correlation with the reference", ranks, "", 0.98, at_least=True),
            row(f"{name}: found alone, patches apart, median", 100.0 * float(np.median(apart)), "%", 1.0),
        ]
    return rows


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Merge all brackets; see the module."""
    if not DATA.is_dir():
        return [row("Flea3: no data beside the checkout, nothing measured", float("nan"))]
    rows, shifts = [], {}
    for scene in SCENES:
        for band_nm in BANDS_NM:
            merged = bracket(scene, band_nm)
            name = f"{scene} {band_nm} nm"
            overall = merged.agreement.overall
            rows += [
                row(f"{name}: frames against merge, before", 100.0 * overall.median, "%", 1.5),
                row(f"{name}: frames against merge, after", 100.0 * overall.clean_median, "%", 1.0),
            ]
            if scene == "disks":
                rounded = bracket(scene, band_nm, truncated=False).agreement.overall
                rows.append(
                    row(f"{name}: after, if counts were rounded ones", 100.0 * rounded.clean_median, "%")
                )
                rows.append(row(f"{name}: after, by noise alone", 100.0 * expected(merged), "%"))
            hot = 0 if merged.dark is None else int(merged.dark.hot.sum())
            rows.append(row(f"{name}: hot pixels", hot))
            if band_nm == 550 and scene == "disks":
                shifts = beside_clipped(merged)
                rows += _of_shifts(name, shifts)
    rows += _of_chart()
    if plots is not None and shifts:
        _plot(plots / "flea3.png", shifts)
    return rows


def expected(merged: BracketMerge) -> float:
    """Median of |sample / merge - 1| that noise alone gives, for samples with no clipped one beside them."""
    radiance, variance, flags = merged.merged
    noise = merged.merged.report.noise
    usable = ((flags & np.uint8(Flag.OVER_RANGE | Flag.HOT)) == 0) & (radiance > 0.0)
    deviations = []
    rng = np.random.default_rng(0)
    for frame, seconds in zip(merged.frames, merged.used_s, strict=True):
        counts = _counts(frame)
        chosen = (
            usable & (counts >= RANGE[0] * 255.0) & (counts <= RANGE[1] * 255.0) & ~_clipped_beside(counts)
        )
        signal = radiance[chosen] * seconds
        # The frame is part of the merge: what is left of its noise is less by the merge's own.
        left = noise.gain_dn_per_e * signal + noise.floor_dn2 - variance[chosen] * seconds**2
        deviations.append(np.sqrt(np.maximum(left, 0.0)) / signal * np.abs(rng.standard_normal(signal.size)))
    return float(np.median(np.concatenate(deviations)))


def _counts(frame: Any) -> np.ndarray:
    return np.asarray(frame.counts[:], dtype=np.float64)


def beside_clipped(merged: BracketMerge) -> dict[str, Any]:
    """Compare samples beside clipped ones with the merge, and the merge with them with that without."""
    with patch.object(BlockMerger, "_reject_neighbours", lambda *_: None):
        with_them = bracket("disks", 550).merged.radiance
    radiance, flags = merged.merged.radiance, merged.merged.flags
    rejected = (flags & np.uint8(Flag.NEIGHBOUR_CLIPPED)) != 0
    rejected &= (flags & np.uint8(Flag.NEAR_CLIPPED_USED | Flag.OVER_RANGE | Flag.HOT)) == 0
    samples, bins = [], []
    low, high = RANGE[0] * 255.0, RANGE[1] * 255.0
    dark = merged.dark
    for frame, seconds in zip(merged.frames, merged.used_s, strict=True):
        counts = _counts(frame)
        index = None if dark is None else dark.index_of(seconds)
        level = 0.0 if dark is None or index is None else dark.mean_dn[index]
        chosen = rejected & (counts >= low) & (counts <= high) & _clipped_beside(counts)
        if np.count_nonzero(chosen) > 50:
            samples.append(((counts - level) / (radiance * seconds) - 1.0)[chosen])
            bins.append(seconds)
    return {
        "seconds": bins,
        "samples": [100.0 * float(np.median(each)) for each in samples],
        "pixels": int(np.count_nonzero(rejected)),
        "used": int(np.count_nonzero(flags & np.uint8(Flag.NEAR_CLIPPED_USED))),
        "merge": 100.0 * float(np.median((with_them / radiance - 1.0)[rejected])),
        "shift": (100.0 * (with_them / radiance - 1.0))[rejected],
    }


def _clipped_beside(counts: np.ndarray) -> np.ndarray:
    from capture.frames import any_in_cell

    return any_in_cell(counts >= 0.99 * 255.0)


def _of_shifts(name: str, shifts: dict[str, Any]) -> list[dict[str, Any]]:
    rows = [
        row(
            f"{name}: pixels with samples beside clipped green left out",
            shifts["pixels"],
            "",
            1.0,
            at_least=True,
        )
    ]
    rows.append(row(f"{name}: pixels where such samples had to be used, flagged", shifts["used"]))
    rows += [
        row(f"{name}: samples beside clipped green, {seconds:.3g} s, against the merge", value, "%")
        for seconds, value in zip(shifts["seconds"], shifts["samples"], strict=True)
    ]
    rows.append(row(f"{name}: merge with such samples against that without, median", shifts["merge"], "%"))
    return rows


def _plot(path: Path, shifts: dict[str, Any]) -> None:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(6, 3.5), layout="constrained")
        axes = figure.add_subplot()
        axes.hist(np.clip(shifts["shift"], -5.0, 5.0), bins=80)
        axes.axvline(0.0, color="k", linewidth=0.8)
        axes.set_xlabel("merge with samples beside clipped green over that without, minus one / %")
        axes.set_ylabel("pixels")
        figure.savefig(path, dpi=120)
