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
from analysis.models.microfacet import beckmann, ggx
from analysis.samples import read
from analysis.style import SERIES, figure
from rig.angles import spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    from analysis.models.base import Model

    Array = NDArray[np.float64]

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
ANGLES_DEG = (0.0, 30.0, 60.0, 80.0, 85.0)
"""Incidences of the tables of albedo."""
SHOWN_DEG = (10.0, 45.0, 75.0)
"""Incidences of the figures."""
STEEPEST_DEG = 80.0
PAIRS = 4000
NODES = 160
FACTORED_TARGET = 0.55
RECIPROCITY_TARGET = 1e-9
ALBEDO_TARGET = 1.002
"""The quadrature's own error is below 0.002 for the shapes that `_shapes` draws."""


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Measure every model; rows as `gonio bench` prints them."""
    rows = [_row(f"projected area of {name}", area, "", None) for name, area in projected_areas().items()]
    for row in rows:
        row["target"], row["ok"] = 1.0, abs(row["value"] - 1.0) < 1e-9
    for name, model in MODELS.items():
        bound = RECIPROCITY_TARGET if model.RECIPROCAL else None
        rows.append(_row(f"{name}: asymmetry", reciprocity(model), "", bound))
        bound = ALBEDO_TARGET if model.CONSERVES else None
        rows.append(_row(f"{name}: largest albedo of a term", largest_albedo(model), "", bound))
        rows.append(_row(f"{name}: evaluation with derivatives", nanoseconds(model), "ns/sample", None))
    rows += _factored_rows()
    if plots is not None:
        draw_all(plots)
    return rows


def _factored_rows() -> list[dict[str, Any]]:
    """Compare the factored model with the GGX it starts from, on all samples of the stand-ins."""
    pairs_of_rms = np.array([factored_against_ggx(samples) for samples in stand_ins(1).values()])
    ggx_median, median = np.median(pairs_of_rms, axis=0)
    worst = float(np.max(pairs_of_rms[:, 1] / pairs_of_rms[:, 0]))
    return [
        _row(
            "factored: median RMS of ln(1 + f cos) over GGX's",
            float(median / ggx_median),
            "",
            FACTORED_TARGET,
        ),
        _row("factored: largest RMS over GGX's of any material", worst, "", 1.0),
        _row("factored: median RMS of ln(1 + f cos)", float(median), "", None),
        _row("ggx: median RMS of ln(1 + f cos)", float(ggx_median), "", None),
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


def _row(name: str, value: float, unit: str, target: float | None) -> dict[str, Any]:
    ok = target is None or value <= target
    return {"name": name, "value": value, "unit": unit, "target": target, "ok": ok}


def projected_areas() -> dict[str, float]:
    """Integral of D cos over the hemisphere, for the normalised distributions, widths 0.01 to 2."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    q = 0.5 * (nodes + 1.0)
    areas = {}
    for name, density in (("GGX", ggx), ("Beckmann", beckmann)):
        worst = 1.0
        for width in (0.01, 0.1, 0.5, 1.0, 2.0):
            tan2 = width**2 * q / (1.0 - q)
            value = density(tan2, np.asarray(width))[0]
            # cos^4 takes D from solid angle to slopes; the last factor is d(tan^2)/dq.
            area = 0.5 * weights @ (np.pi * value / np.square(1.0 + tan2) * width**2 / np.square(1.0 - q))
            worst = max(worst, float(area), key=lambda value: abs(value - 1.0))
        areas[name] = worst
    return areas


def pairs(seed: int = 0) -> tuple[Array, Array]:
    """Directions to light and camera up to 80 deg, a third of the cameras about the mirror direction."""
    random = np.random.default_rng(seed)
    theta = np.radians(random.uniform(0.0, STEEPEST_DEG, (2, PAIRS)))
    phi = random.uniform(-np.pi, np.pi, (2, PAIRS))
    theta[1, ::3] = theta[0, ::3]
    phi[1, ::3] = phi[0, ::3] + np.pi + random.normal(0.0, 0.1, phi[1, ::3].shape)
    return spherical_to_direction(theta[0], phi[0]), spherical_to_direction(theta[1], phi[1])


def reciprocity(model: type[Model]) -> float:
    """Largest relative change of f_r when light and camera change places, default shape."""
    wi, wo = pairs()
    forth, back = model().evaluate(wi, wo), model().evaluate(wo, wi)
    return float(np.max(np.abs(forth - back) / np.maximum(np.maximum(forth, back), 1e-300)))


def _hemisphere() -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    mu, weight = 0.5 * (nodes + 1.0), 0.5 * weights
    phi = (np.arange(NODES) + 0.5) * 2.0 * np.pi / NODES
    theta, around = np.meshgrid(np.arccos(mu), phi, indexing="ij")
    directions = spherical_to_direction(theta.ravel(), around.ravel())
    return directions, np.repeat(weight * mu, NODES) * 2.0 * np.pi / NODES


def albedo(model: Model, theta_deg: float) -> float:
    """Directional albedo of a model for light from an angle, default azimuth."""
    wo, weight = _hemisphere()
    wi = spherical_to_direction(np.radians(theta_deg), np.asarray(0.4))
    return float(weight @ model.evaluate(wi, wo)[:, 0])


def _shapes(model: type[Model], random: np.random.Generator) -> dict[str, float]:
    """Shapes within the bounds, wide enough for the quadrature."""
    drawn = {}
    for p in model.PARAMETERS:
        if p.kind is not Kind.SHAPE:
            continue
        low, high = p.bounds
        if p.name in {"m", "half_width_rad"} or p.name.startswith(("alpha", "m_")):
            low = 0.1
        if p.name.startswith("exponent"):
            high = 200.0
        low, high = p.coordinate.forward(low), p.coordinate.forward(high)
        drawn[p.name] = float(np.clip(p.coordinate.inverse(random.uniform(low, high)), *p.bounds))
    return drawn


def largest_albedo(model: type[Model], draws: int = 6) -> float:
    """Largest directional albedo of a term at unit scale, over shapes and incidences."""
    random = np.random.default_rng(7)
    scales = [p.name for p in model.PARAMETERS if p.kind is not Kind.SHAPE]
    tried = scales[1:] if len(scales) > 1 and model.LAMBERT_TERM else scales
    largest = 0.0
    for _ in range(draws):
        shape = _shapes(model, random)
        for scale in tried:
            one = model(**{name: float(name == scale) for name in scales}, **shape)
            largest = max(largest, *(albedo(one, theta) for theta in ANGLES_DEG))
    return largest


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
