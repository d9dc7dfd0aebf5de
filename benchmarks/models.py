"""The reflectance models: what they promise, measured; `docs/models.md` with figures of their lobes.

    python -m benchmarks.models docs

writes models.md and models/*.png there: formula, source and limits are those of the classes' docstrings, so
that they cannot differ from the code.
"""

from __future__ import annotations

import inspect
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.fit import fit
from analysis.models import DEFAULT_MODELS, FITTED_MODELS, MODELS, factored
from analysis.models.base import Coordinate, Geometry, Kind
from analysis.models.factored import estimate
from analysis.models.fresnel import dielectric
from analysis.models.microfacet import beckmann, ggx
from analysis.samples import read, select
from analysis.style import SERIES, figure
from rig.angles import spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    from analysis.models.base import Model, Parameter

    Array = NDArray[np.float64]

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
ANGLES_DEG = (0.0, 30.0, 60.0, 80.0, 85.0)
"""Incidences of the tables of albedo."""
SHOWN_DEG = (10.0, 45.0, 75.0)
"""Incidences of the figures."""
STEEPEST_DEG = 80.0
PAIRS = 4000
NODES = 160
THINNED = 4
"""Every which sample of a stand-in the table of all models takes."""
FACTORED_TARGET = 0.55
RECIPROCITY_TARGET = 1e-9
ALBEDO_TARGET = 1.002
"""The quadrature's own error is below 0.002 for the shapes that `_shapes` draws."""


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Measure every model; rows as `gonio bench` prints them."""
    rows = [_row(f"projected area of {name}", area, "", None) for name, area in _projected_areas().items()]
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
    pairs_of_rms = np.array([factored_against_ggx(samples) for samples in _materials(1).values()])
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


def _materials(every: int) -> dict[str, xr.Dataset]:
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


def _projected_areas() -> dict[str, float]:
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


def page(folder: Path) -> str:
    """Set the text of models.md."""
    parts = [_HEAD, _overview(), _NOT_RECIPROCAL, _violations(), _ENERGY, _albedos(), _DIGITS]
    parts += [_measured(), "## The models\n"]
    parts += [_section(model) for model in MODELS.values()]
    parts.append(_factored_section())
    draw_all(folder / "models")
    return "\n".join(parts)


_HEAD = f"""# Reflectance models

Written by `python -m benchmarks.models docs` from the code: formulas, sources and limits are the docstrings
of `analysis/models`, numbers are measured by the same run.

Every model is f_r = sum of scale times term, in 1/sr and without a cosine. kd scales the diffuse term (1/pi
unless said otherwise), ks the specular one. N, L, E and H are the unit vectors of normal, light, camera and
half vector; alpha, m and the like are the widths of the distribution itself, never a root or a square of
some roughness. Scales are solved for in a fit, shapes are searched between the bounds given here. A new
model is one file: its parameters, its term and the term's derivatives; tables, tests of properties,
`gonio fit` and this page take it from the registry.

`gonio fit` tries the usual six without being asked:
{", ".join(f"`{name}`" for name in DEFAULT_MODELS)}.
`--all` tries all that have Lambert's diffuse term. *Reciprocal*: light and camera may change places.
*Conserves*: every term reflects at most its scale, so kd + ks <= 1 (with F0 <= 1) is enough for no light to
be created; of the others see the table of albedo.
"""

_NOT_RECIPROCAL = f"""
## Where reciprocity does not hold

Largest difference of f(L, E) and f(E, L) over the larger of both, over {PAIRS} pairs up to
{STEEPEST_DEG:.0f}°, at the default shape. All models not listed stay below 1e-9.
"""

_ENERGY = """
## Directional albedo

Of the specular term at ks = 1 (of the diffuse term where there is no other), default shape, light from 0 to
85°. The last column is the largest over random shapes within the bounds, as far as a quadrature of the
hemisphere resolves them (widths from 0.1, exponents to 200). Where a scale is no albedo by definition (Phong
as published, Lafortune, Torrance-Sparrow, ABC, Cook-Torrance 1982) the number says so and nothing else.
"""

_DIGITS = """
## Digits

Values agree with 50-digit arithmetic to 1e-12 and derivatives to 1e-10, over the corners and the inside of
the bounds, for directions at random, at the mirror direction and beside it, back to the light, and up to
89.999° (`tests/analysis/test_models*.py`). The exceptions:

- anisotropic models, where H lies within some degrees of an axis: the component across it is a difference,
  and the ratio of the widths (up to 667 here) multiplies what it lost. 1e-8, derivatives 1e-6.
- Lafortune's lobe where its base is below 0.2, for the same reason: the two products cancel.
- `sgd` where its masking or its reflectance, both differences, end in zero.
- numbers below 1e-300, which have no twelve digits.
"""


def _overview() -> str:
    lines = [
        "| model | shapes | reciprocal | isotropic | conserves | ns/sample |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, model in MODELS.items():
        shapes = ", ".join(p.name for p in model.PARAMETERS if p.kind is Kind.SHAPE) or "-"
        flags = (model.RECIPROCAL, model.ISOTROPIC, model.CONSERVES)
        marks = " | ".join("yes" if flag else "**no**" for flag in flags)
        lines.append(f"| [{name}](#{name}) | {shapes} | {marks} | {nanoseconds(model):.0f} |")
    return "\n".join([*lines, ""])


def _violations() -> str:
    lines = ["| model | violation |", "| --- | --- |"]
    lines += [
        f"| {name} | {reciprocity(model):.3g} |" for name, model in MODELS.items() if not model.RECIPROCAL
    ]
    return "\n".join([*lines, ""])


def _albedos() -> str:
    heads = " | ".join(f"{theta:.0f}°" for theta in ANGLES_DEG)
    lines = [f"| model | {heads} | largest |", "| --- " * (len(ANGLES_DEG) + 2) + "|"]
    for name, model in MODELS.items():
        scales = [p.name for p in model.PARAMETERS if p.kind is not Kind.SHAPE]
        one = model(**{scale: float(scale == scales[-1]) for scale in scales})
        cells = " | ".join(f"{albedo(one, theta):.4g}" for theta in ANGLES_DEG)
        lines.append(f"| {name} | {cells} | {largest_albedo(model):.4g} |")
    areas = ", ".join(f"{name} {area:.12f}" for name, area in _projected_areas().items())
    exact = float(dielectric(1.0, 1.5))
    lines += ["", f"Projected area of the normalised distributions (worst of widths 0.01 to 2): {areas}."]
    lines.append(
        f"The default facets reflect F0 = 0.04 (ior 1.5: {exact:.4f}), so of ks = 1 about that is left."
    )
    return "\n".join([*lines, ""])


def _measured() -> str:
    """Set the table of fits to measurements, best first."""
    garnet = select(read(DATA / "cornell" / "garnet_red.brdf"), wavelength_nm=[550.0])
    materials = list(_materials(THINNED).values())
    rows = []
    for name in FITTED_MODELS:
        start = time.process_time()
        rms = [fit(samples, name, loss="log").metrics["rms_log"] for samples in materials]
        seconds = (time.process_time() - start) / len(materials)
        rows.append((float(np.median(rms)), fit(garnet, name, loss="log").metrics["rms_log"], seconds, name))
    tables = float(np.median([factored_against_ggx(samples)[1] for samples in materials]))
    lines = [
        _MEASURED,
        "| model | 20 stand-ins, median | garnet_red 550 nm | s per stand-in |",
        "| --- " * 4 + "|",
    ]
    lines.append(f"| factored | {tables:.4f} | - | - |")
    lines += [
        f"| {name} | {many:.4f} | {one:.4f} | {seconds:.2f} |" for many, one, seconds, name in sorted(rows)
    ]
    return "\n".join([*lines, ""])


_MEASURED = f"""## On measured data

RMS of ln(1 + f cos(theta_i)) of a fit that makes it small: median over 20 MERL materials (published neural
fits of them, every {THINNED}th sample, three channels that share their shapes), and Cornell's red paint at
550 nm, all 1439 samples. Processor time of a fit with all its starts and its covariance, on one core. A low
number is no proof of a good model: see cross-validation in `gonio fit`.
"""


def _factored_section() -> str:
    """Set the model that is no entry of the registry: its tables are no shapes to be searched."""
    text = inspect.cleandoc(factored.__doc__ or "")
    return "\n".join(
        [
            "### factored",
            "",
            text,
            "",
            "In `analysis/models/factored.py`: `estimate(wi, wo, f_r, start)`.",
            "",
        ]
    )


def _section(model: type[Model]) -> str:
    text = _prose(model)
    lines = [f"### {model.NAME}", "", text, ""]
    lines += ["| parameter | kind | bounds of a fit | default | unit |", "| --- | --- | --- | --- | --- |"]
    lines += [_parameter(p) for p in model.PARAMETERS]
    where = inspect.getfile(model).rpartition("analysis")[2].replace("\\", "/")
    lines += ["", f"![lobes of {model.NAME}](models/{model.NAME}.png)", "", f"In `analysis{where}`.", ""]
    return "\n".join(lines)


def _prose(model: type[Model]) -> str:
    """Give what the docstring says before its parameters, reStructuredText's marks turned into Markdown's."""
    text = inspect.cleandoc(model.__doc__ or "").partition("\nParameters\n")[0].strip()
    names = {other.__name__: other.NAME for other in MODELS.values()}
    text = re.sub(r"`(\w+)`", lambda found: f"`{names.get(found[1], found[1])}`", text)
    return text.replace("*", "\\*").replace("|", "\\|")


def _parameter(p: Parameter) -> str:
    low, high = (f"{bound:.4g}" for bound in p.bounds)
    searched = "" if p.kind is not Kind.SHAPE or p.coordinate is Coordinate.LINEAR else f" ({p.coordinate})"
    return f"| {p.name} | {p.kind}{searched} | {low} to {high} | {p.default:.4g} | {p.unit} |"


def main() -> int:
    """Write the page and its figures into the folder named on the command line."""
    if len(sys.argv) != 2:
        print(__doc__)
        return 2
    folder = Path(sys.argv[1])
    (folder / "models.md").write_text(page(folder), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
