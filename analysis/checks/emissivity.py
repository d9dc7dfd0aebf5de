"""The emissivity of the same surface against 1 - albedo, where the samples say what the albedo is.

Of an opaque surface the directional emissivity is 1 less the directional-hemispherical reflectance
(Kirchhoff 1860), and reciprocity lets light and view change places. Samples in one plane say nothing of
the rest of the hemisphere by themselves. Of an isotropic surface, values on both sides of the normal bound
it, and values on one side leave what several descriptions of the rest agree on (`analysis.checks.in_plane`).
Where these lie near together they are used, and elsewhere the comparison is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.checks.finding import Finding, judged, not_tested
from analysis.checks.hemisphere import directional_albedo
from analysis.checks.in_plane import FEWEST_DIRECTIONS, InPlane, Range
from analysis.formats.text import number, read_lines
from analysis.pairing import INCIDENCE_BIN_DEG, Array, Indices, Usable, incidences, usable_from
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

COLUMNS = ("camera_angle_deg", "emissivity_mean", "emissivity_std")
LIMITS = (2.0, 3.0)
ENOUGH = 0.85
"""Share of the projected hemisphere that samples must enclose; the rest is taken as the mean, and its
uncertainty as the same again."""
LARGEST_GAP_DEG = 25.0
WIDEST = 0.1
"""Largest half-width of the bounds of an albedo that is still worth comparing."""
FEWEST_IN_PLANE = 5
OFF_PLANE = 0.02
ONE_SIDE = "the samples lie in the plane of incidence, on one side of the normal"
IMPOSSIBLE = 1.02
"""An albedo beyond this is none: the description is wrong, not the emissivity."""


@dataclass(frozen=True)
class Emissivity:
    """Directional emissivity: angles from the normal in degrees, values, standard uncertainties; all (K,)."""

    theta_deg: Array
    value: Array
    u: Array

    def at(self, theta_deg: float) -> tuple[float, float]:
        """Return value and uncertainty, linear between angles, constant beyond them."""
        order = np.argsort(self.theta_deg)
        value, u = (np.interp(theta_deg, self.theta_deg[order], y[order]) for y in (self.value, self.u))
        return float(value), float(u)


def read_emissivity(text: str, path: Path, material: str | None) -> Emissivity:
    """Return the emissivity that a person gives: one number, or a file.

    Parameters
    ----------
    text : str
        A number, 0 to 1, for all angles.
    path : Path
        Or the same as a file: CSV of `camera_angle_deg`, `emissivity_mean`, `emissivity_std` and `material`.
    material : str, optional
        Which of the file's materials; needed where there are several.

    Returns
    -------
    Emissivity

    Raises
    ------
    BadInput
        If there is neither, a column is missing, a cell is no number, or the material is not there.
    """
    if not path.is_file():
        value = number(text, where="--emissivity")
        if not 0.0 <= value <= 1.0:
            raise BadInput(f"{value:g} is no emissivity", where="--emissivity", todo="give 0 to 1, or a file")
        return Emissivity(np.zeros(1), np.array([value]), np.zeros(1))
    lines = [(n, line.split(",")) for n, line in enumerate(read_lines(path), start=1) if line.strip()]
    head = [name.strip() for name in lines[0][1]] if lines else []
    missing = [name for name in COLUMNS if name not in head]
    if missing:
        raise BadInput(f"has no column {missing[0]}", where=str(path), todo=f"name {', '.join(COLUMNS)}")
    rows: dict[str, list[list[float]]] = {}
    for line, cells in lines[1:]:
        if len(cells) != len(head):
            raise BadInput(f"has {len(cells)} cells, not {len(head)}", where=f"{path}: line {line}")
        row = dict(zip(head, (cell.strip() for cell in cells), strict=True))
        numbers = [number(row[name], where=f"{path}: line {line}, column {name}") for name in COLUMNS]
        rows.setdefault(row.get("material", ""), []).append(numbers)
    chosen = next(iter(rows)) if len(rows) == 1 and material is None else material
    if chosen not in rows:
        raise BadInput(
            f"holds no '{material}'" if material else f"holds {len(rows)} materials",
            where=str(path),
            todo=f"choose with --material one of {', '.join(rows)}",
        )
    return Emissivity(*np.array(rows[chosen]).T)


def emissivity(usable: Usable, known: Emissivity) -> Finding:
    """Compare emissivity and 1 - albedo, angle by angle: the largest difference over its u counts."""
    name, quantity = "emissivity", "largest |emissivity + albedo - 1| over its uncertainty"
    worst, where, tested, reasons = -1.0, "", 0, []
    for theta_deg, found in _albedos(_directions(usable)):
        if isinstance(found, str):
            reasons.append(found)
            continue
        albedo, u_albedo = found
        value, u = known.at(theta_deg)
        tested += 1
        pull = abs(value + albedo - 1.0) / max(float(np.hypot(u, u_albedo)), 1e-6)
        if pull > worst:
            worst = pull
            where = (
                f"at {theta_deg:g} deg: emissivity {value:.3f}, 1 - albedo {1.0 - albedo:.3f}, "
                f"u {np.hypot(u, u_albedo):.3f}"
            )
    if not tested:
        why = max(reasons, key=reasons.count) if reasons else "no direction has samples enough"
        return not_tested(name, quantity, LIMITS, 0, f"refused: {why}")
    meaning = "scale, reference or a cosine is wrong, or the surface is not opaque, or not the same one"
    return judged(name, quantity, worst, LIMITS, tested, meaning=meaning, where=where)


def _directions(usable: Usable) -> list[tuple[float, Usable]]:
    """Return each direction with the samples that share it, seen as light: the side with fewer angles."""
    exchanged = usable._replace(
        wi=usable.wo, wo=usable.wi, theta_i=usable.theta_o, theta_o=usable.theta_i, turn=-usable.turn
    )
    sides = [(each, incidences(each)) for each in (usable, exchanged)]
    each, bins = min(sides, key=lambda side: len(side[1]))
    return [(float(np.degrees(np.mean(each.theta_i[rows]))), _rows(each, rows)) for _, rows in bins]


def _rows(usable: Usable, rows: Indices) -> Usable:
    return Usable(*(None if column is None else column[rows] for column in usable))  # type: ignore[arg-type]


def _albedos(directions: list[tuple[float, Usable]]) -> list[tuple[float, tuple[float, float] | str]]:
    """Return albedo and uncertainty for each direction, or why not."""
    found, modelled = [], None
    for theta_deg, view in directions:
        if len(view.wi) < FEWEST_IN_PLANE:
            albedo: tuple[float, float] | str = "too few samples"
        elif np.ptp(view.theta_i) > np.radians(INCIDENCE_BIN_DEG):
            albedo = "directions differ too much"
        elif np.max(np.abs(np.sin(view.turn)) * np.sin(view.theta_o)) >= OFF_PLANE:
            albedo = _over_the_hemisphere(view)
        elif _spanned(view, lit=True) and _spanned(view, lit=False):
            albedo = _between_the_sides(view)
        elif len(directions) < FEWEST_DIRECTIONS or not _spanned(view, lit=False):
            albedo = (
                "the samples lie in the plane of incidence, on one side of the normal: the rest is unknown"
            )
        else:
            modelled = modelled or InPlane(_together([each for _, each in directions]))
            albedo = _judged_range(modelled.albedo(view))
        found.append((theta_deg, albedo))
    return found


def _over_the_hemisphere(view: Usable) -> tuple[float, float] | str:
    """Integrate between the samples; the part beyond them is taken as their mean."""
    every = np.arange(len(view.wi))
    albedo, share, _ = directional_albedo(view, every)
    if share < ENOUGH:
        return f"samples enclose {share:.0%} of the projected hemisphere"
    half, half_share, _ = directional_albedo(view, every[::2])
    coarse = abs(albedo / share - half / half_share) if half_share > 0.0 else albedo
    return albedo / share, float(np.hypot(albedo / share - albedo, coarse))


def _side(view: Usable, *, lit: bool) -> Indices:
    """Order the samples on the light's side of the normal, or on the other, by their angle from it."""
    side = np.flatnonzero((np.abs(view.turn) < 0.5 * np.pi) == lit)
    return np.asarray(side[np.argsort(view.theta_o[side])])


def _spanned(view: Usable, *, lit: bool) -> bool:
    """Whether one side of the plane has samples from the normal to the horizon without wide gaps."""
    theta = view.theta_o[_side(view, lit=lit)]
    gaps = np.diff(np.concatenate([[0.0], theta, [0.5 * np.pi]]))
    return len(theta) >= FEWEST_IN_PLANE and float(np.max(gaps)) <= np.radians(LARGEST_GAP_DEG)


def _between_the_sides(view: Usable) -> tuple[float, float] | str:
    """Bound the albedo of an isotropic surface by the values on both sides of the normal."""
    theta = np.linspace(0.0, 0.5 * np.pi, 181)
    rows = [_side(view, lit=lit) for lit in (True, False)]
    values = np.stack([np.interp(theta, view.theta_o[row], view.f_r[row].max(axis=1)) for row in rows])
    weight = 2.0 * np.pi * np.sin(theta) * np.cos(theta)
    low, high = (
        float(np.trapezoid(bound * weight, theta)) for bound in (values.min(axis=0), values.max(axis=0))
    )
    if high - low > 2.0 * WIDEST:
        return f"in the plane of incidence only: the albedo lies anywhere in {low:.2f} to {high:.2f}"
    # Anywhere between the bounds alike: a rectangular distribution.
    return 0.5 * (low + high), (high - low) / np.sqrt(12.0)


def _judged_range(albedo: Range) -> tuple[float, float] | str:
    """Return the middle and its uncertainty where that decides something, else why not."""
    if albedo.low > IMPOSSIBLE:
        return (
            f"an isotropic surface with these values would reflect {albedo.low:.2g} to {albedo.high:.2g} "
            "times the light it gets: the surface is not isotropic, or the scale is wrong"
        )
    if albedo.u > WIDEST:
        return f"{ONE_SIDE}: the rest leaves an albedo of {albedo.low:.2f} to {albedo.high:.2f}"
    return albedo.middle, albedo.u


def _together(views: list[Usable]) -> Usable:
    wi, wo, f_r = (np.concatenate(column) for column in zip(*(view[:3] for view in views), strict=True))
    return usable_from(wi, wo, f_r)
