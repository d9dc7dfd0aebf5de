"""Fits of real files with known numbers, and what a thousand replicas of a fit cost beside one.

The files are Cornell's garnet red paint, on a grid of 10 deg, all samples at 550 nm, and the black anodised
aluminium EC1 of an RT-300S, blank subtracted and floor shifted as published. Loss and number are the RMS
difference of ln(1 + f cos theta_i).
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.bootstrap import bootstrap
from analysis.fit import fit
from analysis.samples import read, select
from benchmarks.fit_plain import DATA, materials, our_fit
from benchmarks.rows import row

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

PAINT_BARS = {"ggx": 0.0055, "cook-torrance": 0.0104}
COATING_BARS = {"ggx": 0.0068, "cook-torrance": 0.0083}
COATING = "ANOPLATE_AnoBlack_EC1_Alum6061_v1o0_20251115.xls"
BLANK = "blank_v2o0_20250911.xls"
REPLICATED, REPLICAS, REPLICAS_BAR = 2500, 1000, 300.0
REPEATS = 5


def paint() -> xr.Dataset:
    """Garnet red at 550 nm."""
    return select(read(DATA / "cornell" / "garnet_red.brdf"), wavelength_nm=[550.0])


def coating() -> xr.Dataset:
    """EC1 without its blank."""
    raw = DATA / "rt300s" / "raw"
    return read(raw / COATING, blank=raw / BLANK)


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Fit; see the module."""
    del plots
    rows = []
    for label, samples, bars in (
        ("garnet red 550 nm", paint(), PAINT_BARS),
        ("RT-300S EC1", coating(), COATING_BARS),
    ):
        rows += [
            row(f"{label}, {name}: RMS of ln(1 + f cos)", our_fit(samples, name).rms, "", bar)
            for name, bar in bars.items()
        ]
    return [*rows, _replicas(next(iter(materials().values())))]


def _replicas(samples: xr.Dataset) -> dict[str, Any]:
    """Cost of converged bootstrap replicas, in units of one fit."""
    every = np.linspace(0, samples.sizes["sample"] - 1, REPLICATED).astype(int)
    few = samples.isel(sample=every, channel=[1])
    result = fit(few, "ggx", loss="log")
    one = min(our_fit(few, "ggx").seconds for _ in range(REPEATS))
    begin = time.process_time()
    bootstrap(result, REPLICAS)
    cost = (time.process_time() - begin) / one
    return row(f"{REPLICAS} replicas of {REPLICATED} samples over one fit", cost, "x", REPLICAS_BAR)
