"""Whether fits find the global optimum: against the best that many random starts ever reach.

Loss is the difference of ln(1 + f cos theta_i), on the 20 MERL stand-ins thinned to 2,000 samples and on two
Cornell paints at 550 nm. Random starts are drawn over the whole box of the shapes, in search coordinates, and
each is followed to its end on all samples. The gap is our loss over the best of them, minus one.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.fit import fit
from analysis.models import FITTED_MODELS
from analysis.samples import read, select
from analysis.solver import follow
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Iterable

    import xarray as xr

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
THINNED = 2000
MANY, FEW = 100, 20
THOROUGH = ("ggx", "cook-torrance", "cook-torrance-schlick", "ward-duer", "blinn-phong")
AT_ONCE = 10
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


def gap(samples: xr.Dataset, name: str, starts: int, seed: int = 0) -> float:
    """Root-mean-square loss of our fit over that of the best random start, minus one."""
    state = fit(samples, name, loss="log").state
    low, high = state.problem.bounds()
    random = np.random.default_rng(seed)
    best = np.inf
    for _ in range(0, starts, AT_ONCE):
        shapes = random.uniform(low, high, (AT_ONCE, len(low)))
        best = min(best, follow(state.problem, state.loss, shapes)[0].cost)
    return float(np.sqrt(state.solution.cost / best)) - 1.0


def worst_gap(sets: dict[str, xr.Dataset], name: str, starts: int) -> tuple[float, str]:
    """Largest gap over the materials, and where."""
    return max((gap(samples, name, starts), material) for material, samples in sets.items())


def models() -> Iterable[tuple[str, int]]:
    """Name the models with something to search for, and how many random starts each meets."""
    return [(name, MANY if name in THOROUGH else FEW) for name in FITTED_MODELS if name != "lambert"]


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Study every model; see the module."""
    del plots
    sets = data_sets()
    rows = []
    for name, starts in models():
        worst, material = worst_gap(sets, name, starts)
        label = f"{name}: worst gap to {starts} starts ({material})"
        rows.append(
            {"name": label, "value": 100.0 * worst, "unit": "%", "target": 100.0 * BAR, "ok": worst <= BAR}
        )
    return rows
