"""The reflectance models: what they promise, measured; figures of their lobes.

`benchmarks.models_page` sets them, and what the classes say of themselves, as a page.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.fit import fit
from analysis.models import MODELS
from analysis.models.base import Geometry, Kind
from analysis.models.factored import estimate
from analysis.samples import read
from analysis.style import SERIES, figure
from benchmarks.models_digits import (
    EXCEPTED_TARGET,
    SLOPE_TARGET,
    VALUE_TARGET,
    Worst,
    directions,
    worst,
)
from benchmarks.models_energy import (
    ALBEDO_TARGET,
    RECIPROCITY_TARGET,
    largest_albedo,
    projected_areas,
    reciprocity,
)
from benchmarks.rows import row
from rig.angles import spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    from analysis.models.base import Model

    Array = NDArray[np.float64]

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
SHOWN_DEG = (10.0, 45.0, 75.0)
"""Incidences of the figures."""
STEEPEST_DEG = 80.0
PAIRS = 4000
FACTORED_TARGET = 0.55
AREA_TARGET = 1e-6
DIGITS_PAIRS, DIGITS_DRAWS, DIGITS_SEED, ALBEDO_DRAWS, RECIPROCITY_DRAWS = 40, 16, 7, 4, 40


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Measure every model; rows as `gonio bench` prints them."""
    rows = [
        row(f"projected area of {name}: distance from 1", abs(area - 1.0), "", AREA_TARGET)
        for name, area in projected_areas().items()
    ]
    for model in MODELS.values():
        rows += _promises(model)
    rows += _factored_rows()
    if plots is not None:
        draw_all(plots)
    return rows


def _promises(model: type[Model]) -> list[dict[str, Any]]:
    """Measure digits, reciprocity, energy and time of one model."""
    name, found = model.NAME, digits(model)
    largest = largest_albedo(model, ALBEDO_DRAWS).albedo
    asymmetry = reciprocity(model, RECIPROCITY_DRAWS)
    return [
        row(f"{name}: relative error of f", found.value, "", VALUE_TARGET),
        row(f"{name}: same, in the named exceptions", found.excepted, "", EXCEPTED_TARGET),
        row(f"{name}: relative error of a derivative", max(found.slopes.values()), "", SLOPE_TARGET),
        row(f"{name}: asymmetry", asymmetry, "", RECIPROCITY_TARGET if model.RECIPROCAL else None),
        row(f"{name}: largest albedo of a term", largest, "", ALBEDO_TARGET if model.CONSERVES else None),
        row(f"{name}: evaluation with derivatives", nanoseconds(model), "ns/sample"),
    ]


def digits(model: type[Model]) -> Worst:
    """Compare a model with 50 digits, as thoroughly as the page of models tells."""
    pairs = directions(DIGITS_PAIRS, DIGITS_SEED)
    return worst(model.NAME, pairs, DIGITS_DRAWS, every=2, seed=DIGITS_SEED)


def _factored_rows() -> list[dict[str, Any]]:
    """Compare the factored model with the GGX it starts from, on all samples of the stand-ins."""
    pairs_of_rms = np.array([factored_against_ggx(samples) for samples in stand_ins(1).values()])
    ggx_median, median = np.median(pairs_of_rms, axis=0)
    worst = float(np.max(pairs_of_rms[:, 1] / pairs_of_rms[:, 0]))
    return [
        row(
            "factored: median RMS of ln(1 + f cos) over GGX's",
            float(median / ggx_median),
            "",
            FACTORED_TARGET,
        ),
        row("factored: largest RMS over GGX's of any material", worst, "", 1.0),
        row("factored: median RMS of ln(1 + f cos)", float(median)),
        row("ggx: median RMS of ln(1 + f cos)", float(ggx_median)),
    ]


def stand_ins(every: int) -> dict[str, xr.Dataset]:
    """Read the MERL stand-ins, every so many samples of each."""
    paths = sorted((DATA / "merl-standins").glob("*.npz"))
    if not paths:
        raise BadInput("the shared measurements are not at hand", where=str(DATA), todo="put them there")
    return {path.stem: read(path).isel(sample=slice(None, None, every)) for path in paths}


def factored_against_ggx(samples: xr.Dataset) -> tuple[float, float]:
    """RMS of ln(1 + f cos) of a GGX fit, and of the tables estimated over it."""
    wi, wo, f_r = (samples[key].to_numpy() for key in ("wi", "wo", "f_r"))
    start = fit(samples, "ggx", loss="log")
    tables = estimate(wi, wo, f_r, start.model)
    cos_i = wi[:, 2:]
    difference = np.log1p(tables.evaluate(wi, wo) * cos_i) - np.log1p(f_r * cos_i)
    return start.metrics["rms_log"], float(np.sqrt(np.nanmean(np.square(difference))))


def pairs(seed: int = 0) -> tuple[Array, Array]:
    """Directions to light and camera up to 80 deg, a third of the cameras about the mirror direction."""
    random = np.random.default_rng(seed)
    theta = np.radians(random.uniform(0.0, STEEPEST_DEG, (2, PAIRS)))
    phi = random.uniform(-np.pi, np.pi, (2, PAIRS))
    theta[1, ::3] = theta[0, ::3]
    phi[1, ::3] = phi[0, ::3] + np.pi + random.normal(0.0, 0.1, phi[1, ::3].shape)
    return spherical_to_direction(theta[0], phi[0]), spherical_to_direction(theta[1], phi[1])


def nanoseconds(model: type[Model]) -> float:
    """Time of value and derivatives of all terms per sample, geometry included, best of three."""
    wi, wo = pairs()
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        with np.errstate(all="ignore"):
            model().terms_at(Geometry(wi, wo))
        best = min(best, time.perf_counter() - start)
    return float(best / PAIRS * 1e9)


def draw_all(folder: Path) -> None:
    """Draw every model's lobes in the plane of incidence."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, model in MODELS.items():
        _draw(model, folder / f"{name}.png")


def _draw(model: type[Model], path: Path) -> None:
    signed = np.radians(np.linspace(-88.0, 88.0, 705))
    scales = {p.name: {"kd": 0.1, "ks": 0.5}[p.name] for p in model.PARAMETERS if p.kind is not Kind.SHAPE}
    with figure(4.4, 2.5) as drawn:
        axes = drawn.add_subplot()
        for theta_deg, colour in zip(SHOWN_DEG, SERIES, strict=False):
            wi = spherical_to_direction(np.radians(theta_deg), np.asarray(np.pi))
            wo = spherical_to_direction(signed, np.zeros_like(signed))
            f = model(**scales).evaluate(wi, wo)[:, 0]
            axes.semilogy(np.degrees(signed), f, color=colour, label=f"{theta_deg:.0f}°")
            axes.axvline(theta_deg, color=colour, linewidth=0.6, linestyle=":")
        axes.set_xlabel("camera's angle / °, light at negative angles")
        axes.set_ylabel("f / sr$^{-1}$")
        axes.set_xticks(np.arange(-90, 91, 30))
        axes.legend(title="incidence", loc="center left", bbox_to_anchor=(1.0, 0.5))
        drawn.savefig(path, dpi=80, metadata={"Software": None})
