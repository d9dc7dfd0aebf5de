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

from analysis.fit import fit
from analysis.models import MODELS
from analysis.models.base import Coordinate, Geometry, Kind
from analysis.samples import read
from analysis.style import SERIES, figure
from benchmarks.rows import row
from gonio.output import Progress
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    from analysis.models.base import Model, Parameter

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
DRAWN = ("blinn-phong", "ward-duer", "cook-torrance", "cook-torrance-schlick", "ggx")
"""Models in the plot."""
MANY_SHAPES = 3
"""From so many shapes on the box is searched: its price is shown, on fewer samples."""
THINNED = 4
"""Every which sample of these."""
BARS = {"ggx": 0.0280, "cook-torrance-schlick": 0.0330}
"""Median RMS of ln(1 + f cos) over the materials."""
SPEED_BAR = 10.0
SAME = 1.0001
"""Median RMS over the plain fit's that counts as the same: the searches stop at 1e-8 of the cost."""
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
    value = parameter.default
    if parameter.name.endswith("exponent"):
        value = 2.0 / width**2
    elif parameter.coordinate is Coordinate.LOG:
        value = width
    return parameter.coordinate.forward(float(np.clip(value, *parameter.bounds)))


def our_fit(samples: xr.Dataset, name: str) -> Outcome:
    """Fit with `analysis.fit.fit`."""
    begin = time.process_time()
    result = fit(samples, name, loss="log")
    return Outcome(result.goodness["rms_log"], time.process_time() - begin)


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


def compared() -> dict[str, int]:
    """Return the models that the plain fit has too, a lobe over Lambert's term: name, number of shapes."""
    shapes = {
        name: sum(p.kind is Kind.SHAPE for p in model.PARAMETERS)
        for name, model in MODELS.items()
        if model.LAMBERT_TERM
    }
    return {name: number for name, number in shapes.items() if number}


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Measure and compare; see the module."""
    sets = list(materials().values())
    few = [samples.isel(sample=slice(None, None, THINNED)) for samples in sets]
    rows: list[dict[str, Any]] = []
    sides: dict[str, tuple[list[Outcome], list[Outcome]]] = {}
    models = compared()
    progress = Progress("models", len(models))
    for name, shapes in models.items():
        if shapes < MANY_SHAPES:
            sides[name] = side_by_side(sets, name)
            rows += _compared(name, *sides[name])
        else:
            ours, plain = side_by_side(few, name)
            label = f"{name}, {shapes} shapes, every {THINNED}th sample"
            rows += [_same(label, ours, plain), _speed(label, ours, plain, None)]
        progress(note=name)
    if plots is not None:
        draw(plots / "fit.png", {name: sides[name] for name in DRAWN})
    return rows


def _compared(name: str, ours: list[Outcome], plain: list[Outcome]) -> list[dict[str, Any]]:
    worst = max(our.rms / other.rms for our, other in zip(ours, plain, strict=True))
    seconds = float(np.mean([each.seconds for each in ours]))
    return [
        row(f"{name}: median RMS of ln(1 + f cos)", _median(ours), "", BARS.get(name)),
        _same(name, ours, plain),
        row(f"{name}: RMS over the plain fit's, worst material", worst, "x", SAME),
        row(f"{name}: CPU time of a material", 1e3 * seconds, "ms"),
        _speed(name, ours, plain, SPEED_BAR),
    ]


def _median(side: list[Outcome]) -> float:
    return float(np.median([each.rms for each in side]))


def _same(label: str, ours: list[Outcome], plain: list[Outcome]) -> dict[str, Any]:
    return row(f"{label}: median RMS over the plain fit's", _median(ours) / _median(plain), "x", SAME)


def _speed(label: str, ours: list[Outcome], plain: list[Outcome], bar: float | None) -> dict[str, Any]:
    ratio = sum(each.seconds for each in plain) / sum(each.seconds for each in ours)
    return row(f"{label}: the plain fit's CPU time over it", ratio, "x", bar, at_least=True)


def draw(path: Path, sides: dict[str, tuple[list[Outcome], list[Outcome]]]) -> None:
    """Draw error against time: a dot for each material, ours filled, the plain fit's open; medians large."""
    from matplotlib.lines import Line2D

    with figure(7.2, 4.0) as drawn:
        axes = drawn.subplots()
        for colour, (ours, plain) in zip(SERIES, sides.values(), strict=False):
            for side, face in ((ours, colour), (plain, "none")):
                seconds, rms = [o.seconds for o in side], [o.rms for o in side]
                axes.plot(seconds, rms, "o", ms=2.6, color=colour, mfc=face, mew=0.5, alpha=0.5)
                axes.plot(np.median(seconds), np.median(rms), "o", ms=8.0, color=colour, mfc=face, mew=1.3)
            medians = [[np.median([getattr(o, key) for o in side]) for side in (ours, plain)] for key in
                       ("seconds", "rms")]  # fmt: skip
            axes.plot(*medians, color=colour, lw=0.7)
        axes.set(xscale="log", yscale="log")
        axes.set_xlabel("CPU time of a fit with all its starts, s")
        axes.set_ylabel("RMS of ln(1 + f cos θ$_i$)")
        axes.set_title(
            "Error against time, 20 materials: filled gonio, open a plain scipy fit, large the median"
        )
        handles = [Line2D([], [], ls="", marker="o", color=c) for c, _ in zip(SERIES, sides, strict=False)]
        axes.legend(handles, list(sides), loc="upper left", bbox_to_anchor=(1.005, 1.0), borderaxespad=0)
        drawn.savefig(path, dpi=110, metadata={"Software": None})
