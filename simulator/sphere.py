"""The picture of a sphere of a material, for a report.

A sphere in black surroundings is convex, so light meets it once (LDE) and no ray need be traced: a distant
lamp, seen as a small bright disc, is a sum over its nodes, and an even dim sky gives the same from every
side, so that its share depends on the angle of view alone. The picture has no noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.angles import spherical_to_direction, unit
from simulator import bsdfs
from simulator.light.reflectance import closed_form_reflectance, mitsuba_reflectance
from simulator.line_words import CHANNELS
from simulator.materials import ClosedFormMaterial, closed_form_material, parse_material
from simulator.variant import load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike

    from simulator.line_words import Value
    from simulator.materials import Material

    Reflectance = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]

Array = NDArray[np.float64]

LAMP_DIRECTION = unit([-0.45, 0.6, 0.65])
LAMP_RADIUS_RAD = 0.06
"""Angular radius of the lamp: what a polished sphere shows of it."""

SKY_RADIANCE = 0.1
"""Radiance of the sky, where the lamp gives a white of albedo 1 that faces it a radiance of 1."""

_FILLED = 0.94
"""Part of the picture's width that the sphere takes."""

_VIEW_ANGLES = 24
_SKY_SHAPE = (48, 64)
_UP = np.array([0.0, 1.0, 0.0])


def render_sphere(
    material: str | Material,
    size_px: int = 256,
    *,
    parameters: Mapping[str, ArrayLike] | None = None,
    variant: str | None = None,
    background: float = 0.0,
) -> Array:
    """Render a sphere, lit from the upper left by a small lamp and evenly by a dim sky.

    Parameters
    ----------
    material : str or Material
        A line of `simulator.materials`, or with `parameters` the name of a model.
    size_px : int
        Width and height of the picture.
    parameters : mapping of str to array_like, shape () or (1,) or (3,), optional
        Parameters of the model, such as a fit's.
    variant : str, optional
        Variant of Mitsuba; by default the fastest that can run.
    background : float
        Radiance around the sphere.

    Returns
    -------
    ndarray, shape (size_px, size_px, 3)
        Linear; 1 is a white of albedo 1 that faces the lamp, highlights are brighter.

    Raises
    ------
    BadInput
        The material is wrong.
    """
    if parameters is not None:
        material = fitted_material(str(material), parameters)
    reflectance = _reflectance(parse_material(material), variant)
    normal, coverage = _sphere_normals(size_px)
    seen = coverage > 0.0
    radiance = _lamp_share(reflectance, normal[seen]) + _sky_share(reflectance, normal[seen])
    picture = np.full((size_px, size_px, CHANNELS), background)
    picture[seen] += coverage[seen, None] * (radiance - background)
    return picture


def fitted_material(model: str, parameters: Mapping[str, ArrayLike]) -> ClosedFormMaterial:
    """Return the material of a model's name and parameters; parameters as in `render_sphere`."""
    values: dict[str, Value] = {}
    for name, given in parameters.items():
        numbers = np.atleast_1d(np.asarray(given, dtype=np.float64))
        values[name] = float(numbers[0]) if numbers.size == 1 else tuple(numbers.tolist())
    return closed_form_material(model, values)


def _reflectance(material: Material, variant: str | None) -> Reflectance:
    mi = load_mitsuba(variant)
    # One call per pair is too slow for a picture where the formula is at hand.
    if material.has_closed_form and (mi.variant().startswith("scalar") or not material.rendered):
        return closed_form_reflectance(material)
    bsdfs.register(mi)
    return mitsuba_reflectance(mi, material)


def _sphere_normals(size_px: int) -> tuple[Array, Array]:
    """See a sphere from +z from afar: normals (size, size, 3), and how much of each pixel it covers."""
    at = (np.arange(size_px) + 0.5) / size_px * 2.0 - 1.0
    x, y = np.meshgrid(at / _FILLED, -at / _FILLED)
    radius = np.hypot(x, y)
    pixel = 2.0 / (size_px * _FILLED)
    coverage = np.clip((1.0 - radius) / pixel + 0.5, 0.0, 1.0)
    # Pixels on the rim take the normal just inside it.
    inward = np.minimum(1.0, (1.0 - 0.5 * pixel) / np.maximum(radius, pixel))
    x, y = x * inward, y * inward
    return np.stack([x, y, np.sqrt(1.0 - x**2 - y**2)], axis=-1), coverage


def _local(normal: Array, direction: Array) -> Array:
    """Turn directions (M, 3) into the frames of normals (N, 3), first axis along parallels: (M, N, 3)."""
    across = unit(np.cross(_UP, normal))
    frame = np.stack([across, np.cross(normal, across), normal], axis=-2)
    return np.asarray(np.einsum("nij,mj->mni", frame, direction))


def _lamp_share(reflectance: Reflectance, normal: Array) -> Array:
    """Radiance (N, 3) by the lamp: a sum over nodes of a disc, which has irradiance pi where it is faced."""
    nodes = _lamp_nodes()
    wo = _local(normal, np.array([[0.0, 0.0, 1.0]]))[0]
    total = np.zeros((len(normal), CHANNELS))
    for wi in _local(normal, nodes):
        lit = wi[:, 2] > 0.0
        total[lit] += reflectance(wi[lit], wo[lit]) * wi[lit, 2:] * (np.pi / len(nodes))
    return total


def _lamp_nodes() -> Array:
    """Directions (M, 3) spread evenly over the lamp's disc: rings of 1, 6 and 12."""
    ring = np.repeat([0.0, 0.5, 0.9], [1, 6, 12]) * LAMP_RADIUS_RAD
    turn = np.concatenate([2.0 * np.pi * np.arange(count) / count for count in (1, 6, 12)])
    spread = spherical_to_direction(ring, turn)
    across = unit(np.cross(_UP, LAMP_DIRECTION))
    frame = np.stack([across, np.cross(LAMP_DIRECTION, across), LAMP_DIRECTION], axis=-1)
    return np.asarray(spread @ frame.T)


def _sky_share(reflectance: Reflectance, normal: Array) -> Array:
    """Radiance (N, 3) by the sky: its radiance times the albedo for each angle of view, interpolated."""
    cosine = (np.arange(_VIEW_ANGLES) + 0.5) / _VIEW_ANGLES
    views = spherical_to_direction(np.arccos(cosine), np.zeros(_VIEW_ANGLES))
    rows, cols = _SKY_SHAPE
    # Equal steps in the square of the sine: every node carries the same projected solid angle.
    sine2, phi = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(cols) + 0.5) / cols * 2.0 * np.pi)
    sky = spherical_to_direction(np.arcsin(np.sqrt(sine2)), phi).reshape(-1, 3)
    wi, wo = np.tile(sky, (_VIEW_ANGLES, 1)), np.repeat(views, len(sky), axis=0)
    albedo = np.pi * reflectance(wi, wo).reshape(_VIEW_ANGLES, -1, CHANNELS).mean(axis=1)
    share = [np.interp(normal[:, 2], cosine, albedo[:, channel]) for channel in range(CHANNELS)]
    return SKY_RADIANCE * np.stack(share, axis=-1)
