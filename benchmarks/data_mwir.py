"""Mid-infrared tables of another laboratory: what the checks say of the cosine in its published formula.

For each material the reciprocity of the published values and of those without their extra cosine, and the
emissivity measured apart from them against 1 - albedo, where the samples allow an albedo. What one side of
the plane of incidence allows is held against materials whose whole hemisphere is known: RGL and MERL's
stand-ins, seen at the same angles.
"""

from __future__ import annotations

import csv
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.checks import check
from analysis.checks.emissivity import WIDEST, emissivity, read_emissivity
from analysis.checks.finding import Verdict
from analysis.checks.in_plane import InPlane
from analysis.formats.rgl_table import Table
from analysis.formats.scattered import interpolant_of, usable
from analysis.formats.tensor import read_tensors
from analysis.pairing import usable_from, usable_samples
from analysis.samples import read
from benchmarks.data_plots import draw_reciprocity
from benchmarks.rows import row
from gonio.output import say
from rig.angles import spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import xarray as xr
    from numpy.typing import NDArray

    from analysis.checks.finding import Finding
    from analysis.pairing import Usable

    Array = NDArray[np.float64]
    Evaluate = Callable[[Array, Array], Array]

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data" / "mwir"
TABLE_LIGHTS = (15.0, 20.0, 30.0, 40.0, 45.0, 50.0, 60.0, 70.0, 80.0)
KNOWN_VIEWS = (15.0, 30.0, 45.0, 60.0)
RADIANCE, EMISSIVITY = FOLDER / "radiance.csv", FOLDER / "emissivity.csv"


def run(plots: Path | None) -> list[dict[str, Any]]:
    """Check every material; see the module.

    Raises
    ------
    BadInput
        If the data are not at hand.
    """
    if not RADIANCE.is_file():
        raise BadInput("the shared measurements are not at hand", where=str(FOLDER), todo="put them there")
    known = list(_known_albedos())
    if plots is not None:
        both = [
            {
                name: 100.0 * _reciprocity(read(RADIANCE, material=name, as_published=published)).value
                for name in materials()
            }
            for published in (True, False)
        ]
        draw_reciprocity(plots / "mwir.png", *both, known)
    return [*reciprocity_rows(), *emissivity_rows(), *known_rows(known)]


def reciprocity_rows() -> list[dict[str, Any]]:
    """Compare the published values with those without the cosine."""
    rows, caught, cured = [], [], []
    for material in materials():
        published = _reciprocity(read(RADIANCE, material=material, as_published=True))
        plain = _reciprocity(read(RADIANCE, material=material))
        caught.append(published.verdict is Verdict.FAIL and "cos" in published.meaning)
        cured.append(plain.verdict is not Verdict.FAIL)
        rows += [
            row(f"{material}: reciprocity as published, median", 100.0 * published.value, "%"),
            row(f"{material}: reciprocity without the cosine, median", 100.0 * plain.value, "%"),
        ]
    return [
        row(
            "published values that fail for their cosine", 100.0 * np.mean(caught), "%", 100.0, at_least=True
        ),
        row("values without it that do not fail", 100.0 * np.mean(cured), "%", 100.0, at_least=True),
        *rows,
    ]


def _violations(*, published: bool) -> dict[str, float]:
    """Return the median reciprocity violation of each material, in percent."""
    return {
        name: 100.0 * _reciprocity(read(RADIANCE, material=name, as_published=published)).value
        for name in materials()
    }


def emissivity_rows() -> list[dict[str, Any]]:
    """Compare each material's emissivity with 1 - albedo, or say why that is refused."""
    rows, compared, refused = [], 0, 0
    for material in materials():
        known = read_emissivity(str(EMISSIVITY), EMISSIVITY, material)
        found = emissivity(usable_samples(read(RADIANCE, material=material)), known)
        if found.verdict is Verdict.NOT_TESTED:
            refused += bool(found.meaning)
            say(f"  {material}: {found.meaning}")
        else:
            compared += 1
            name = f"{material}: |emissivity + albedo - 1| over u, worst of {found.count} directions"
            rows.append(row(name, found.value, "", found.fail))
    return [
        *rows,
        row("materials whose emissivity is compared with 1 - albedo", compared),
        row("materials where coverage does not allow it, and why is told", refused),
        row("materials in all", compared + refused, "", len(materials()), at_least=True),
    ]


def known_rows(albedos: list[Array]) -> list[dict[str, Any]]:
    """Compare albedos from one side of the plane of incidence with those of whole hemispheres."""
    true, found, u = np.array(albedos).T
    pulls = np.abs(true - found) / u
    return [
        row("albedos known and from one side of the plane: compared", len(pulls)),
        row("their largest difference over u", np.max(pulls), "", 2.0),
        row("root mean square of the differences over u", np.sqrt(np.mean(np.square(pulls))), "", 1.0),
    ]


def _known_albedos() -> Iterator[Array]:
    """Give the true albedo, the one from one side of the plane, and its u, where that is small enough."""
    for evaluate in _known_surfaces():
        usable = _seen_in_plane(evaluate)
        described = InPlane(usable)
        for view in KNOWN_VIEWS:
            chosen = np.isclose(usable.theta_i, np.radians(view))
            found = described.albedo(usable_from(*(column[chosen] for column in usable[:3])))
            if found.u <= WIDEST:
                yield np.array([_whole_albedo(evaluate, np.radians(view)), found.middle, found.u])


def _known_surfaces() -> Iterator[Evaluate]:
    for path in sorted((FOLDER.parent / "rgl").glob("*.bsdf")):
        yield partial(_green_of, Table(read_tensors(path), str(path)))
    for path in sorted((FOLDER.parent / "merl-standins").glob("*.npz")):
        given = interpolant_of(usable(read(path).isel(channel=[1])))
        yield lambda wi, wo, given=given: given(wi, wo).f_r


def _green_of(table: Table, wi: Array, wo: Array) -> Array:
    return np.asarray(table.evaluate(wi, wo)[:, 1:2] / np.maximum(wo[:, 2:], 1e-6))


def _seen_in_plane(evaluate: Evaluate) -> Usable:
    """Evaluate at the angles of the mid-infrared tables: few lights, many views beyond the normal."""
    theta_i, theta_o = (
        grid.ravel() for grid in np.meshgrid(np.radians(TABLE_LIGHTS), np.radians(np.arange(1.0, 86.0)))
    )
    wi, wo = spherical_to_direction(theta_i, 0.0), spherical_to_direction(theta_o, np.pi)
    return usable_from(wi, wo, evaluate(wi, wo))


def _whole_albedo(evaluate: Evaluate, theta_i: float) -> float:
    """Integrate over the hemisphere of views."""
    step, turn = np.radians(1.0), np.radians(4.0)
    theta, phi = np.meshgrid(np.arange(0.5 * step, 0.5 * np.pi, step), np.arange(0.0, 2.0 * np.pi, turn))
    wo = spherical_to_direction(theta.ravel(), phi.ravel())
    wi = np.broadcast_to(spherical_to_direction(theta_i, 0.0), wo.shape)
    weight = (np.sin(theta) * np.cos(theta)).ravel() * step * turn
    return float(np.sum(evaluate(wi, wo)[:, 0] * weight))


def materials() -> list[str]:
    """Names of the materials in the table, in their order."""
    with RADIANCE.open(encoding="utf-8", newline="") as stream:
        return list(dict.fromkeys(line["material"] for line in csv.DictReader(stream)))


def _reciprocity(samples: xr.Dataset) -> Finding:
    return next(finding for finding in check(samples) if finding.name == "reciprocity")
