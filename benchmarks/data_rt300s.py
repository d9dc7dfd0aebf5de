"""Other laboratories' data: their published tables from their raw files, reading times, repeatability.

RT-300S: the raw scans of two black coatings and their blank, by the recipes that ship, against the FRED and
Zemax tables that the laboratory published. One function makes the rows of one claim.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.formats.rt300s import read_readings
from analysis.recipes import reduce_files
from analysis.recipes.recipe import load
from analysis.samples import read
from benchmarks.data_plots import draw_repeatability
from benchmarks.rows import row
from rig.angles import direction_to_spherical, wrap
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
RAW, PUBLISHED = DATA / "rt300s" / "raw", DATA / "rt300s" / "published"
BLANK = RAW / "blank_v2o0_20250911.xls"
STEEL = ("NiTE_on_steel_v1o0A_20250915", "NiTE_on_steel_v1o0B_20250916", "NiTE_on_steel_v1o0C_20250916")
SAMPLES = {
    "EC1": ("AnoBlackEC1onAlum", ("ANOPLATE_AnoBlack_EC1_Alum6061_v1o0_20251115",)),
    "NiTE on steel": ("AnoBlackNiTEonSteel", STEEL),
}
FRED_WITHIN = 1e-6
ZEMAX_PART = 0.95
ZEMAX_DIGITS = 4
READ_WITHIN_S = 1.0
REPEATS = 5
SAME_DIRECTION = 1e-6

Cell = tuple[float, float, float]


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Measure; see the module.

    Raises
    ------
    BadInput
        If the data are not at hand.
    """
    if not BLANK.is_file():
        raise BadInput("the shared measurements are not at hand", where=str(DATA), todo="put them there")
    if plots is not None:
        _draw(plots / "rt300s.png")
    return [*fred_rows(), *zemax_rows(), *reading_rows(), *repeatability_rows()]


def fred_rows() -> list[dict[str, Any]]:
    """Count cells of the published FRED tables that the recipe gives within 1e-6."""
    rows = []
    for label, (table, files) in SAMPLES.items():
        ours = dict(_cells(_reduced(files, "rt300s-fred")))
        for half, suffix in (("half circle", ""), ("full circle", "_fullAz")):
            theirs = _cells(read(PUBLISHED / f"{table}{suffix}.txt"))
            off = np.array([abs(ours.get(cell, np.nan) - value) for cell, value in theirs])
            pole = np.array([cell[1] == 0.0 for cell, _ in theirs])
            name = f"RT-300S {label}, FRED {half}"
            rows += [
                row(f"{name}: cells within 1e-6", _percent(off <= FRED_WITHIN), "%", 100.0, at_least=True),
                row(f"{name}: worst cell at theta_s = 0", off[pole].max(), "1/sr", FRED_WITHIN),
            ]
    return rows


def zemax_rows() -> list[dict[str, Any]]:
    """Count cells of the published Zemax tables that the recipe gives to all printed digits."""
    rows = []
    for label, (table, files) in SAMPLES.items():
        theirs = read(PUBLISHED / f"{table}.bsdf")
        ours = _reduced(files, "rt300s-zemax")
        same = zemax_same(ours, theirs)
        rows.append(
            row(
                f"RT-300S {label}, Zemax: cells equal in all digits",
                _percent(same),
                "%",
                100 * ZEMAX_PART,
                at_least=True,
            )
        )
    return rows


def zemax_same(ours: xr.Dataset, theirs: xr.Dataset) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Whether each cell above the horizon is the same number in print; a cell without a value prints as 0."""
    good = ours["flags"].to_numpy()[:, 0] == 0
    directions = [np.hstack([one["wi"].to_numpy(), one["wo"].to_numpy()]) for one in (ours, theirs)]
    apart = np.linalg.norm(directions[1][:, None] - directions[0][good], axis=-1)
    nearest = apart.argmin(axis=1)
    found = apart[np.arange(len(apart)), nearest] < SAME_DIRECTION
    value = np.where(found, ours["f_r"].to_numpy()[good, 0][nearest], 0.0)
    printed = np.array([float(f"{one:.{ZEMAX_DIGITS - 1}e}") for one in value])
    return np.asarray(printed == theirs["f_r"].to_numpy()[:, 0])


def reading_rows() -> list[dict[str, Any]]:
    """Time the reading of one file of ten sheets, the longest of all such files' medians."""
    longest = 0.0
    for name in (name for _, files in SAMPLES.values() for name in files):
        seconds = []
        for _ in range(REPEATS):
            begin = time.process_time()
            read_readings(RAW / f"{name}.xls")
            seconds.append(time.process_time() - begin)
        longest = max(longest, statistics.median(seconds))
    return [row("RT-300S: reading a file of ten sheets, processor time", longest, "s", READ_WITHIN_S)]


def repeatability_rows() -> list[dict[str, Any]]:
    """Compare one sample at three stage angles, and the stated uncertainty with what that allows."""
    reduced = reduce_files([RAW / f"{name}.xls" for name in STEEL], "rt300s", blank=BLANK)
    found = reduced.repeatability
    assert found is not None
    samples = reduced.samples.isel(sample=np.flatnonzero(reduced.samples["flags"].to_numpy()[:, 0] == 0))
    f_r, u_f_r = (samples[name].to_numpy()[:, 0] for name in ("f_r", "u_f_r"))
    cosine = np.pi * samples["wo"].to_numpy()[:, 2]
    floor = found.standard_deviation(f_r * cosine) / cosine / np.sqrt(found.files)
    name = "RT-300S steel A/B/C"
    bands = [
        row(
            f"{name}: repeatability, view {band.low:g} to {band.high:g} deg ({band.dof} dof)",
            100.0 * band.relative,
            "%",
        )
        for band in found.bands
        if band.quantity == "theta_o_deg"
    ]
    over_floor, relative = float(np.min(u_f_r / floor)), float(np.median(u_f_r / np.abs(f_r)))
    return [
        row(f"{name}: repeatability of one file, relative part", 100.0 * found.relative, "%"),
        row(f"{name}: repeatability of one file, part without level", found.additive, "RT"),
        row(f"{name}: degrees of freedom", found.dof),
        *bands,
        row(f"{name}: least u_f_r over its floor", over_floor, "", 1.0 - 1e-9, at_least=True),
        row(f"{name}: median of the stated u_f_r / f_r of the mean", 100.0 * relative, "%"),
    ]


def _draw(path: Path) -> None:
    """Draw how the files of the steel differ, cell by cell, and what the recipes state of one."""
    readings = [read(RAW / f"{name}.xls", blank=BLANK) for name in STEEL]
    cosine = np.pi * readings[0]["wo"].to_numpy()[:, 2]
    good = readings[0]["flags"].to_numpy()[:, 0] == 0
    values = np.stack([each["f_r"].to_numpy()[good, 0] * cosine[good] for each in readings])
    (step,) = [step for step in load("rt300s").step if step.name == "repeatability"]
    level = np.geomspace(max(values.mean(axis=0).min(), step.additive), values.max(), 100)
    stated = np.hypot(step.additive, step.relative * level)
    draw_repeatability(path, values.mean(axis=0), values.std(axis=0, ddof=1), (level, stated))


def _reduced(files: tuple[str, ...], recipe: str) -> xr.Dataset:
    return reduce_files([RAW / f"{name}.xls" for name in files], recipe, blank=BLANK).samples


def _cells(samples: xr.Dataset) -> list[tuple[Cell, float]]:
    """Angles in degrees (light, view, azimuth between them from 0 to 180) and value of each usable sample."""
    good = samples["flags"].to_numpy()[:, 0] == 0
    theta_i, phi_i = direction_to_spherical(samples["wi"].to_numpy()[good])
    theta_o, phi_o = direction_to_spherical(samples["wo"].to_numpy()[good])
    between = np.where(theta_o < SAME_DIRECTION, 0.0, np.abs(wrap(phi_o - phi_i)))
    angles = np.round(np.degrees(np.stack([theta_i, theta_o, between], axis=-1)), 4)
    values = samples["f_r"].to_numpy()[good, 0]
    return [(tuple(cell), float(value)) for cell, value in zip(angles.tolist(), values, strict=True)]


def _percent(good: np.ndarray[Any, np.dtype[np.bool_]]) -> float:
    return 100.0 * float(np.mean(good))
