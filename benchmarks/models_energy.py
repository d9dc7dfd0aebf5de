"""What the models promise of energy and reciprocity, measured over the whole box of shapes.

Integrals over the hemisphere are adaptive: a start grid graded towards the mirror direction, the direction
back to the light and the horizon finds lobes down to a microradian, and cells are split until the rules of
two orders agree.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from analysis.models.anisotropic import beckmann_density, ggx_density
from analysis.models.base import Geometry, Kind
from analysis.models.microfacet import beckmann, ggx
from benchmarks.models_digits import FAINTEST, directions, shapes
from rig.angles import spherical_to_direction

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from analysis.models.base import Model

    Array = NDArray[np.float64]
    Integrand = Callable[[Array], Array]

ANGLES_DEG = (0.0, 30.0, 60.0, 80.0, 85.0)
"""Incidences of the tables of albedo."""
GRAZING_DEG = 89.9
ALBEDO_TARGET = 1.0 + 1e-6
RECIPROCITY_TARGET = 1e-12
AZIMUTH = 0.4
"""Of the light, so that it lies on no axis."""
CELL_TOLERANCE = 1e-8
"""Between the two rules in one cell, over the integral where that is above 1; the finer one is far better."""
FINEST = 1e-6
RATIO = 4.0
DEEPEST = 10
LOW, HIGH = (np.polynomial.legendre.leggauss(order) for order in (4, 7))


def integral(integrand: Integrand, theta: float, phi: float) -> float:
    """Integrate over the hemisphere.

    Parameters
    ----------
    integrand : callable
        Takes directions (N, 3), returns values (N,), in 1/sr.
    theta, phi : float
        Direction of the light: where the start grid is fine, and opposite to it.
    """
    cells = _start(theta, phi)
    total = 0.0
    for _ in range(DEEPEST):
        coarse, fine = _rule(integrand, cells, LOW), _rule(integrand, cells, HIGH)
        size = max(1.0, abs(total + float(np.sum(fine))))
        done = np.abs(fine - coarse) <= CELL_TOLERANCE * size
        total += float(np.sum(fine[done]))
        cells = _split(cells[~done])
        if not len(cells):
            return total
    return total + float(np.sum(_rule(integrand, cells, HIGH)))


def _start(theta: float, phi: float) -> Array:
    """Cells (N, 4): low and high polar angle, low and high azimuth."""
    distances = 0.5 * np.pi / RATIO ** np.arange(np.ceil(np.log(0.5 * np.pi / FINEST) / np.log(RATIO)))
    quarters = phi + 0.5 * np.pi * np.arange(5)
    polar = np.concatenate([theta - distances, [theta], theta + distances, 0.5 * np.pi - distances])
    polar = np.unique(np.concatenate([[0.0, 0.5 * np.pi], polar[(polar > 0.0) & (polar < 0.5 * np.pi)]]))
    sideways = np.concatenate([-0.5 * distances, [0.0], 0.5 * distances])
    azimuth = np.unique(np.clip(np.add.outer(quarters, sideways), quarters[0], quarters[-1]))
    low_t, low_p = np.meshgrid(polar[:-1], azimuth[:-1], indexing="ij")
    high_t, high_p = np.meshgrid(polar[1:], azimuth[1:], indexing="ij")
    return np.stack([low_t.ravel(), high_t.ravel(), low_p.ravel(), high_p.ravel()], axis=1)


def _rule(integrand: Integrand, cells: Array, rule: tuple[Array, Array]) -> Array:
    """Gauss's product rule of each cell, (N,)."""
    nodes, weights = rule
    unit, weight = 0.5 * (nodes + 1.0), 0.5 * weights
    wide, long = cells[:, 1:2] - cells[:, 0:1], cells[:, 3:4] - cells[:, 2:3]
    theta = (cells[:, 0:1] + wide * unit)[:, :, None]
    phi = (cells[:, 2:3] + long * unit)[:, None, :]
    values = integrand(spherical_to_direction(theta, phi).reshape(-1, 3))
    values = values.reshape(len(cells), len(unit), len(unit)) * np.sin(theta)
    return np.asarray(np.einsum("cij,i,j->c", values, weight, weight) * wide[:, 0] * long[:, 0])


def _split(cells: Array) -> Array:
    """Quarter cells."""
    low_t, high_t, low_p, high_p = cells.T
    mid_t, mid_p = 0.5 * (low_t + high_t), 0.5 * (low_p + high_p)
    quarters = [
        np.stack([*polar, *azimuth], axis=1)
        for polar in ((low_t, mid_t), (mid_t, high_t))
        for azimuth in ((low_p, mid_p), (mid_p, high_p))
    ]
    return np.concatenate(quarters)


def albedo(model: Model, theta_deg: float) -> float:
    """Directional albedo of a model of one channel, for light from an angle."""
    theta = np.radians(theta_deg)
    # At normal incidence the light has no azimuth, and the start grid can lie along the axis of brushing.
    phi = AZIMUTH if theta > 0.0 or model.ISOTROPIC else float(vars(model)["axis_rad"])
    wi = spherical_to_direction(theta, np.asarray(phi))
    return integral(lambda wo: model.evaluate(wi, wo)[:, 0] * wo[:, 2], theta, phi)


def terms(model: type[Model]) -> list[str]:
    """Return scales of the terms that are not Lambert's, or of Lambert's where there is no other."""
    scales = [p.name for p in model.PARAMETERS if p.kind is not Kind.SHAPE]
    return scales[1:] if len(scales) > 1 and model.LAMBERT_TERM else scales


class Extreme(NamedTuple):
    """Largest directional albedo of a term at unit scale, and where it was met."""

    albedo: float
    theta_deg: float
    shape: dict[str, float]


def largest_albedo(
    model: type[Model], draws: int, angles_deg: tuple[float, ...] = (*ANGLES_DEG, GRAZING_DEG)
) -> Extreme:
    """Measure all terms' albedo at unit scale over `draws` shapes and the default, and over incidences."""
    scales = [p.name for p in model.PARAMETERS if p.kind is not Kind.SHAPE]
    found = Extreme(0.0, 0.0, {})
    for shape in shapes(model, draws):
        for scale in terms(model):
            one = model(**{name: float(name == scale) for name in scales}, **shape)
            for theta_deg in angles_deg:
                found = max(found, Extreme(albedo(one, theta_deg), theta_deg, shape), key=lambda e: e.albedo)
    return found


def reciprocity(model: type[Model], draws: int, steepest_deg: float = 90.0) -> float:
    """Largest relative change of f_r when light and camera change places, over shapes and directions."""
    wi, wo = directions(200)
    lowest = np.cos(np.radians(steepest_deg))
    keep = (wi[:, 2] > lowest) & (wo[:, 2] > lowest)
    wi, wo = wi[keep], wo[keep]
    largest = 0.0
    for shape in shapes(model, draws):
        one = model(**shape)
        forth, back = one.evaluate(wi, wo), one.evaluate(wo, wi)
        change = np.abs(forth - back) / np.maximum(np.maximum(np.abs(forth), np.abs(back)), FAINTEST)
        largest = max(largest, float(np.max(change)))
    return largest


def projected_areas() -> dict[str, float]:
    """Integral of D cos over the hemisphere for each normalised distribution, the worst of its box.

    The three classical distributions of Torrance-Sparrow, ABC's and SGD's are 1 at their peak instead.
    """
    plain = {"GGX": (ggx, (0.001, 0.01, 0.1, 0.5, 1.0, 2.0)), "Beckmann": (beckmann, (0.003, 0.05, 0.5, 3.0))}
    found = {
        name: _worst(_area(_of_slope(density, width)) for width in widths)
        for name, (density, widths) in plain.items()
    }
    pairs = ((0.003, 0.003), (0.003, 2.0), (2.0, 0.003), (0.1, 0.4), (2.0, 2.0))
    for name, turned in (("GGX, anisotropic", ggx_density), ("Beckmann, anisotropic", beckmann_density)):
        found[name] = _worst(_area(_of_slopes(turned, widths)) for widths in pairs)
    return found


def _worst(areas: Iterable[float]) -> float:
    return max(areas, key=lambda area: abs(area - 1.0))


def _area(density: Integrand) -> float:
    return integral(lambda h: density(h) * h[:, 2], 0.0, AZIMUTH)


def _of_slope(density: Callable[[Array, Array], tuple[Array, Array]], width: float) -> Integrand:
    return lambda h: density(Geometry(h, h).tan2_h, np.asarray(width))[0][:, 0]


def _of_slopes(density: Callable[..., Any], widths: tuple[float, float]) -> Integrand:
    """Distribution of two widths, along and across the azimuth of the start grid."""
    along, across = (np.asarray(width) for width in widths)
    return lambda h: density(Geometry(h, h), ("x", "y"), (along, across), np.asarray(AZIMUTH)).value[:, 0]
