"""Writes `docs/models.md`: every model's formula, source, limits and lobes, and what was measured of them.

    python -m benchmarks.models_page docs

Formula, source and limits are those of the classes' docstrings, so that they cannot differ from the code.
"""

from __future__ import annotations

import inspect
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from analysis.fit import fit
from analysis.models import DEFAULT_MODELS, FITTED_MODELS, MODELS, factored
from analysis.models.base import Coordinate, Kind
from analysis.models.fresnel import dielectric
from analysis.samples import read, select
from benchmarks.fit_page import kept
from benchmarks.models import (
    ALBEDO_DRAWS,
    DATA,
    DIGITS_DRAWS,
    DIGITS_PAIRS,
    RECIPROCITY_DRAWS,
    STEEPEST_DEG,
    digits,
    draw_all,
    factored_against_ggx,
    nanoseconds,
    stand_ins,
)
from benchmarks.models_digits import EXCEPTED_TARGET, SLOPE_TARGET, VALUE_TARGET, directions
from benchmarks.models_energy import (
    ANGLES_DEG,
    GRAZING_DEG,
    RECIPROCITY_TARGET,
    albedo,
    largest_albedo,
    projected_areas,
    reciprocity,
)

if TYPE_CHECKING:
    from analysis.models.base import Model, Parameter

THINNED = 4
"""Every which sample of a stand-in the table of all models takes."""


def page(folder: Path) -> str:
    """Set the text of models.md."""
    parts = [_HEAD, _overview(), _NOT_RECIPROCAL, _violations(), _ENERGY, _albedos(), _DIGITS, _digits()]
    path = folder / "models.md"
    numbers = kept(path.read_text("utf-8")) if path.is_file() else ""
    parts += [_measured(), f"{numbers}## The models\n"]
    parts += [_section(model) for model in MODELS.values()]
    parts.append(_factored_section())
    draw_all(folder / "models")
    return "\n".join(parts)


_HEAD = f"""# Reflectance models

Written by `python -m benchmarks.models_page docs` from the code: formulas, sources and limits are the
docstrings of `analysis/models`, numbers are measured by the same run.

Every model is f_r = sum of scale times term, in 1/sr and without a cosine. kd scales the diffuse term (1/pi
unless said otherwise), ks the specular one. N, L, E and H are the unit vectors of normal, light, camera and
half vector; alpha, m and the like are the widths of the distribution itself, never a root or a square of
some roughness. Scales are solved for in a fit, shapes are searched between the bounds given here. A new
model is one file in `analysis/models`: its parameters, its term and the term's derivatives. It is found
there by the tables, the tests of properties, `gonio fit` and this page; the one thing to add is its formula
as the source prints it, in `benchmarks/models_exact.py`, which its digits are compared with.

`gonio fit` tries the usual six without being asked:
{", ".join(f"`{name}`" for name in DEFAULT_MODELS)}.
`--all` tries all. *Reciprocal*: light and camera may change places.
*Conserves*: every term reflects at most its scale, so kd + ks <= 1 (with F0 <= 1) is enough for no light to
be created; of the others see the table of albedo.
"""

_NOT_RECIPROCAL = f"""
## Where reciprocity does not hold

Largest difference of f(L, E) and f(E, L) over the larger of both: at the default shape up to
{STEEPEST_DEG:.0f}°, and over {RECIPROCITY_DRAWS} more shapes of the box up to 89.999°. All other models stay
below {RECIPROCITY_TARGET:g} over the same shapes and directions.
"""

_ENERGY = f"""
## Directional albedo

Of the specular term at ks = 1 (of the diffuse term where there is no other), default shape, light from 0 to
85°; then the largest of any term over the default and {ALBEDO_DRAWS} more shapes, corners and inside of the
whole box, up to {GRAZING_DEG}°, with the angle where it was met. Adaptive quadrature, good to 1e-6. A model
that promises to conserve energy stays below 1; of the others what is above 1 is the violation. Where a scale
is no albedo by definition (Phong as published, Lafortune, Torrance-Sparrow, ABC, SGD, Cook-Torrance 1982) the
number says so and nothing else.
"""

_DIGITS = f"""
## Digits

Largest relative errors against the formulas as their sources print them, in 50 digits
(`benchmarks/models_exact.py`): over {len(directions(DIGITS_PAIRS)[0])} pairs of directions (at random, at
the mirror direction, 1e-6 to 0.3 beside it, back to the light, normal incidence and 89.999° on either side
and on both) and {DIGITS_DRAWS} shapes beside the default, corners of the bounds and their inside. Bounds:
{VALUE_TARGET:g} for f, {SLOPE_TARGET:g} for derivatives. Derivatives are compared with central differences in
50 digits, which are as good as a complex step; where one passes through zero, over 1 % of f per value of the
parameter. No warning of numpy is raised, NaN gives NaN.

The exceptions, which the last column holds and the others do not, bound {EXCEPTED_TARGET:g}: differences in
the formula itself that come out below a tenth of their terms, so that the digits are lost in the formula and
not in the program.

- `lafortune`, `lafortune-retro`: the base of the power, near the angle where the lobe ends.
- `sgd`: masking and reflectance, where they end in zero.
- `ashikhmin-shirley`, `beckmann-anisotropic`: the component of H across an axis that it nearly lies on,
  whose square an exponential takes up to 700 times.
- Numbers below 1e-290, which have no twelve digits as doubles, count nowhere.
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
    lines = [f"| model | default, to {STEEPEST_DEG:.0f}° | box, to 89.999° |", "| --- | --- | --- |"]
    for name, model in MODELS.items():
        box = reciprocity(model, RECIPROCITY_DRAWS)
        if not model.RECIPROCAL:
            lines.append(f"| {name} | {reciprocity(model, 0, STEEPEST_DEG):.3g} | {box:.3g} |")
        elif box > RECIPROCITY_TARGET:
            raise AssertionError(f"{name} is called reciprocal and is not: {box}")
    return "\n".join([*lines, ""])


def _albedos() -> str:
    heads = " | ".join(f"{theta:.0f}°" for theta in ANGLES_DEG)
    lines = [f"| model | {heads} | largest | at | promised |", "| --- " * (len(ANGLES_DEG) + 4) + "|"]
    for name, model in MODELS.items():
        scales = [p.name for p in model.PARAMETERS if p.kind is not Kind.SHAPE]
        one = model(**{scale: float(scale == scales[-1]) for scale in scales})
        cells = " | ".join(f"{albedo(one, theta):.4g}" for theta in ANGLES_DEG)
        found = largest_albedo(model, ALBEDO_DRAWS)
        promised = "yes" if model.CONSERVES else "no"
        lines.append(f"| {name} | {cells} | {_number(found.albedo)} | {found.theta_deg:g}° | {promised} |")
    exact = float(dielectric(1.0, 1.5))
    lines.append("")
    lines.append(
        f"The default facets reflect F0 = 0.04 (ior 1.5: {exact:.4f}), so of ks = 1 about that is left."
    )
    lines += [
        "",
        "Projected area of the facets, the integral of D cos over the hemisphere, which is 1 for a",
        "normalised distribution; the worst over the box of widths (of two widths: up to 0.003 by 2). The",
        "three classical D of Torrance-Sparrow, and those of ABC and SGD, are 1 at their peak instead.",
        "",
        "| distribution | area |",
        "| --- | --- |",
    ]
    lines += [f"| {name} | {area:.9f} |" for name, area in projected_areas().items()]
    return "\n".join([*lines, ""])


def _number(value: float) -> str:
    """Four digits, and one more than four nines."""
    return f"{value:.4g}" if value < 0.9999 or value > 1.0001 else f"{value:.7f}"


def _digits() -> str:
    lines = ["| model | f | worst derivative | by | f, excepted |", "| --- | --- | --- | --- | --- |"]
    for name, model in MODELS.items():
        found = digits(model)
        by = max(found.slopes, key=lambda shape: found.slopes[shape])
        excepted = f"{found.excepted:.1e}" if found.excepted else "-"
        lines.append(f"| {name} | {found.value:.1e} | {found.slopes[by]:.1e} | {by} | {excepted} |")
    return "\n".join([*lines, ""])


def _measured() -> str:
    """Set the table of fits to measurements, best first."""
    garnet = select(read(DATA / "cornell" / "garnet_red.brdf"), wavelength_nm=[550.0])
    materials = list(stand_ins(THINNED).values())
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
