"""Fits against a plain scipy fit in the same process: loss and CPU time on 20 measured materials.

The plain fit is what one writes in an afternoon: `scipy.optimize.least_squares` with bounds, logarithms of
widths, a numeric Jacobian, the same loss (differences of ln(1 + f cos theta_i)), all channels sharing the
shapes, and four starts over the range of widths. It computes only what it needs, its directions' products
once. Ours is `analysis.fit.fit` as everybody calls it: starts, fit, covariance, metrics.

Times are CPU times of the process, so that threads count, and a busy machine does not.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.bootstrap import bootstrap
from analysis.fit import fit
from analysis.models import MODELS
from analysis.models.base import Coordinate, Geometry, Kind
from analysis.samples import read, select
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    from analysis.models.base import Model, Parameter

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
COMPARED = ("blinn-phong", "ward-duer", "cook-torrance", "cook-torrance-schlick", "ggx")
BARS = {"ggx": 0.0280, "cook-torrance-schlick": 0.0330}
"""Median RMS of ln(1 + f cos) over the materials."""
PAINT_BARS = {"ggx": 0.0055, "cook-torrance": 0.0104}
SPEED_BAR = 10.0
BOOTSTRAP_SAMPLES, BOOTSTRAP_REPLICAS, BOOTSTRAP_BAR = 2500, 1000, 300.0
PLAIN_STARTS = (0.02, 0.08, 0.25, 0.6)
"""Widths of the lobe, as slopes, from which the plain fit starts."""


@dataclass(frozen=True)
class Outcome:
    """One fit: RMS of ln(1 + f cos theta_i) and CPU seconds."""

    rms: float
    seconds: float


def plain_fit(samples: xr.Dataset, model: type[Model]) -> Outcome:
    """Fit as one does with scipy alone: see the module."""
    from scipy.optimize import least_squares

    begin = time.process_time()
    wi, wo, f_r = (samples[name].to_numpy() for name in ("wi", "wo", "f_r"))
    cos_i, channels = wi[:, 2:], f_r.shape[1]
    geometry, target = Geometry(wi, wo), np.log1p(f_r * cos_i)
    shapes = [p for p in model.PARAMETERS if p.kind is Kind.SHAPE]

    def residual(x: NDArray[np.float64]) -> NDArray[np.float64]:
        kd, ks, free = x[:channels], x[channels : 2 * channels], x[2 * channels :]
        values = {p.name: p.coordinate.inverse(float(v)) for p, v in zip(shapes, free, strict=True)}
        lobe = model(**values).lobe_at(geometry)
        assert lobe is not None
        return (np.log1p((kd / np.pi + ks * lobe.value) * cos_i) - target).ravel()

    low = [0.0] * 2 * channels + [p.coordinate.forward(p.bounds[0]) for p in shapes]
    high = [np.inf] * 2 * channels + [p.coordinate.forward(p.bounds[1]) for p in shapes]
    base = np.pi * np.median(f_r, axis=0)
    costs = []
    with np.errstate(under="ignore", over="ignore"):
        for width in PLAIN_STARTS:
            start = np.concatenate([base, np.full(channels, 0.3), [_start(p, width) for p in shapes]])
            costs.append(least_squares(residual, start, bounds=(low, high)).cost)
    return Outcome(float(np.sqrt(2.0 * min(costs) / f_r.size)), time.process_time() - begin)


def _start(parameter: Parameter, width: float) -> float:
    """Start of a shape: widths at the given one, exponents at theirs, all else at the default."""
    if parameter.name.endswith("exponent"):
        return parameter.coordinate.forward(2.0 / width**2)
    if parameter.coordinate is Coordinate.LOG:
        return parameter.coordinate.forward(width)
    return parameter.coordinate.forward(parameter.default)


def our_fit(samples: xr.Dataset, name: str) -> Outcome:
    """Fit with `analysis.fit.fit`."""
    begin = time.process_time()
    result = fit(samples, name, loss="log")
    return Outcome(result.metrics["rms_log"], time.process_time() - begin)


def side_by_side(materials: list[xr.Dataset], name: str) -> tuple[list[Outcome], list[Outcome]]:
    """Fit every material both ways, in turn: ours, plain."""
    our_fit(materials[0].isel(sample=slice(None, None, 40)), name)
    pairs = [(our_fit(samples, name), plain_fit(samples, MODELS[name])) for samples in materials]
    return [ours for ours, _ in pairs], [plain for _, plain in pairs]


def materials() -> dict[str, xr.Dataset]:
    """Read the 20 MERL stand-ins; BadInput where they are not at hand."""
    paths = sorted((DATA / "merl-standins").glob("*.npz"))
    if not paths:
        raise BadInput("the shared measurements are not at hand", where=str(DATA), todo="put them there")
    return {path.stem: read(path) for path in paths}


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Measure and compare; see the module."""
    sets = list(materials().values())
    rows, points = [], []
    for name in COMPARED:
        ours, plain = side_by_side(sets, name)
        rows += _compared(name, ours, plain)
        points += [(f"{name}, gonio", ours), (f"{name}, plain", plain)]
    if plots is not None:
        _plot(plots / "fit.png", points)
    return [*rows, *_paint(), *_replicas(sets[0])]


def _paint() -> list[dict[str, Any]]:
    """Fit a real paint on a grid of 10 deg, all samples at 550 nm."""
    samples = select(read(DATA / "cornell" / "garnet_red.brdf"), wavelength_nm=[550.0])
    return [
        _row(f"garnet red, {name}: RMS of ln(1 + f cos)", our_fit(samples, name).rms, "", bar)
        for name, bar in PAINT_BARS.items()
    ]


def _replicas(samples: xr.Dataset) -> list[dict[str, Any]]:
    """Cost of converged bootstrap replicas of one fit."""
    every = np.linspace(0, samples.sizes["sample"] - 1, BOOTSTRAP_SAMPLES).astype(int)
    few = samples.isel(sample=every, channel=[1])
    result = fit(few, "ggx", loss="log")
    one = min(our_fit(few, "ggx").seconds for _ in range(5))
    begin = time.process_time()
    bootstrap(result, BOOTSTRAP_REPLICAS)
    cost = (time.process_time() - begin) / one
    label = f"{BOOTSTRAP_REPLICAS} replicas of {BOOTSTRAP_SAMPLES} samples over one fit"
    return [_row(label, cost, "x", BOOTSTRAP_BAR)]


def _compared(name: str, ours: list[Outcome], plain: list[Outcome]) -> list[dict[str, Any]]:
    median, median_plain = (float(np.median([o.rms for o in side])) for side in (ours, plain))
    seconds, seconds_plain = (sum(o.seconds for o in side) / len(side) for side in (ours, plain))
    worst = max(our.rms / other.rms for our, other in zip(ours, plain, strict=True))
    return [
        _row(f"{name}: median RMS of ln(1 + f cos)", median, "", BARS.get(name)),
        _row(f"{name}: the plain fit's", median_plain, "", None),
        _row(f"{name}: worst RMS over the plain fit's", worst, "x", 1.0001),
        _row(f"{name}: a material", 1e3 * seconds, "ms", None),
        _row(f"{name}: speed over the plain fit", seconds_plain / seconds, "x", SPEED_BAR, over=True),
    ]


def _row(name: str, value: float, unit: str, target: float | None, *, over: bool = False) -> dict[str, Any]:
    ok = target is None or (value >= target if over else value <= target)
    return {"name": name, "value": float(value), "unit": unit, "target": target, "ok": bool(ok)}


def _plot(path: Path, points: list[tuple[str, list[Outcome]]]) -> None:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 10}):
        figure = Figure(figsize=(7, 4.5), layout="constrained")
        axes = figure.add_subplot()
        for label, outcomes in points:
            marker = "o" if label.endswith("gonio") else "x"
            axes.loglog([o.seconds for o in outcomes], [o.rms for o in outcomes], marker, label=label)
        axes.set_xlabel("CPU seconds of a fit")
        axes.set_ylabel("RMS of ln(1 + f cos)")
        axes.legend(fontsize=8)
        axes.grid(visible=True, which="both", alpha=0.3)
        figure.savefig(path, dpi=120)
