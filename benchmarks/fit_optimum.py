"""Whether fits find the global optimum: against the best that many random starts ever reach.

Loss is the difference of ln(1 + f cos theta_i), on the 20 MERL stand-ins thinned to 2,000 samples and on two
Cornell paints at 550 nm. Random starts are drawn over the whole box of the shapes, in search coordinates, and
each is followed to its end on all samples, as many together as the cache holds. The gap is our loss over the
best of them, minus one. Nothing is kept between runs.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.fit import fit
from analysis.models import FITTED_MODELS, MODELS
from analysis.models.base import Kind
from analysis.samples import read, select
from analysis.solver import follow
from benchmarks.rows import row
from gonio.output import say
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Iterable

    import xarray as xr

    from analysis.state import State

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
THINNED = 2000
MANY, FEW = 100, 20
THOROUGH = ("ggx", "cook-torrance", "cook-torrance-schlick", "ward-duer", "blinn-phong")
AT_ONCE = 20
"""Starts followed together: more of them do not fit the cache."""
BAR = 0.001


def data_sets() -> dict[str, xr.Dataset]:
    """Read the materials; BadInput where they are not at hand."""
    paths = sorted((DATA / "merl-standins").glob("*.npz"))
    if not paths:
        raise BadInput("the shared measurements are not at hand", where=str(DATA), todo="put them there")
    sets = {}
    for path in paths:
        samples = read(path)
        every = np.linspace(0, samples.sizes["sample"] - 1, THINNED).astype(int)
        sets[path.stem] = samples.isel(sample=every)
    for path in sorted((DATA / "cornell").glob("*.brdf")):
        sets[path.stem] = select(read(path), wavelength_nm=[550.0])
    return sets


def best_of_random(state: State, starts: int, seed: int = 0) -> float:
    """Half the sum of squares that the best of random starts ends with, on all samples."""
    low, high = state.problem.bounds()
    shapes = np.random.default_rng(seed).uniform(low, high, (starts, len(low)))
    batches = (shapes[begin : begin + AT_ONCE] for begin in range(0, starts, AT_ONCE))
    return min(follow(state.problem, state.loss, batch)[0].cost for batch in batches)


def gap(samples: xr.Dataset, name: str, starts: int, seed: int = 0) -> float:
    """Root-mean-square loss of our fit over that of the best random start, minus one."""
    state = fit(samples, name, loss="log").state
    return float(np.sqrt(state.solution.cost / best_of_random(state, starts, seed))) - 1.0


def gaps(sets: dict[str, xr.Dataset], name: str, starts: int) -> dict[str, float]:
    """`gap` for each material."""
    return {material: gap(samples, name, starts) for material, samples in sets.items()}


def models() -> dict[str, int]:
    """Name the models with something to search for, and how many random starts each meets."""
    searched = [name for name in FITTED_MODELS if any(p.kind is Kind.SHAPE for p in MODELS[name].PARAMETERS)]
    return {name: MANY if name in THOROUGH else FEW for name in searched}


def run(plots: Path | None, names: Iterable[str] | None = None) -> list[dict[str, Any]]:
    """Study every model, or those named; see the module."""
    del plots
    sets, begin = data_sets(), time.monotonic()
    rows = []
    for name in names or models():
        starts = models()[name]
        found = gaps(sets, name, starts)
        material = max(found, key=lambda each: found[each])
        label = f"{name}: loss over the best of {starts} random starts, worst of {len(sets)} ({material})"
        rows.append(row(label, 1.0 + found[material], "x", 1.0 + BAR))
        missed = [each for each, value in found.items() if value > BAR]
        say(f"{name}, {time.monotonic() - begin:.0f} s: misses {', '.join(missed) or 'none'}")
    return rows
