"""Forms that Mitsuba is given as meshes: a cylinder, a part of a sphere that mirrors, a machine's solids."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from rig.placement import Shape
    from simulator.light.scene import SphericalMirror
    from simulator.mounting import Mounting

Array = NDArray[np.float64]

FACETS = 2048
"""Of a cylinder: it lies within 1.2e-6 of its radius."""
RINGS, TURNS = 96, 256
"""Of a spherical mirror: a hemisphere lies within 8e-5 of its radius."""


def tube(mi: Any, mounting: Mounting, half_length_mm: float, bsdf: Any) -> Any:
    """Return a cylinder of facets so narrow that they err by less than single precision.

    Mitsuba's own, vectorised, meets rays 1e-3 mm beside itself, and shadows itself by a tenth.
    """
    turn = np.linspace(0.0, 2.0 * math.pi, FACETS, endpoint=False)
    axis = np.array([math.cos(mounting.axis_rad), math.sin(mounting.axis_rad), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    outwards = np.outer(np.cos(turn), up) + np.outer(np.sin(turn), np.cross(up, axis))
    ring = mounting.radius_mm * (outwards - up)
    corners = np.concatenate([ring - half_length_mm * axis, ring + half_length_mm * axis])
    corners = corners @ mounting.rotation.T + [0.0, 0.0, mounting.height_mm]
    first = np.arange(FACETS)
    following = np.roll(first, -1)
    faces = np.concatenate(
        [
            np.stack([first, first + FACETS, following], axis=-1),
            np.stack([following, first + FACETS, following + FACETS], axis=-1),
        ]
    )
    return mesh(mi, "sample", bsdf, corners, faces)


def spherical_mirror(mi: Any, name: str, mirror: SphericalMirror, bsdf: Any) -> Any:
    """Return a part of a sphere, of facets that know its normals.

    Where corners have the sphere's normals, a facet's point has the normal of the sphere above it: only the
    place is off, by the height of the facet's middle below the sphere.
    """
    # Rings are evenly spaced in the angle from the middle.
    most = math.asin(mirror.rim_mm / abs(mirror.radius_mm))
    angles = most * np.linspace(0.0, 1.0, RINGS + 1)[1:]
    share = (1.0 - np.cos(angles)) / (1.0 - math.cos(most))
    u, v = (grid.ravel() for grid in np.meshgrid(share, np.arange(TURNS) / TURNS, indexing="ij"))
    corners, normals = mirror.at(np.append(0.0, u), np.append(0.0, v))
    turn = np.arange(TURNS)
    following = np.roll(turn, -1)
    faces = [np.stack([np.zeros_like(turn), 1 + turn, 1 + following], axis=-1)]
    for ring in range(RINGS - 1):
        inner, outer = 1 + ring * TURNS, 1 + (ring + 1) * TURNS
        faces += [
            np.stack([inner + turn, outer + turn, inner + following], axis=-1),
            np.stack([inner + following, outer + turn, outer + following], axis=-1),
        ]
    return mesh(mi, name, bsdf, corners, np.concatenate(faces), normals)


def mesh(  # noqa: PLR0917 - what a mesh is made of
    mi: Any, name: str, bsdf: Any, corners: Array, faces: NDArray[np.intp], normals: Array | None = None
) -> Any:
    """Return a mesh: corners (V, 3) and perhaps normals there, faces (F, 3) counterclockwise from outside."""
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    mesh = mi.Mesh(name, len(corners), len(faces), properties, has_vertex_normals=normals is not None)
    parameters = mi.traverse(mesh)
    values: dict[str, NDArray[Any]] = {"vertex_positions": corners, "faces": faces}
    if normals is not None:
        values["vertex_normals"] = normals
    for key, numbers in values.items():
        kind = type(parameters[key])
        parameters[key] = kind(numbers.ravel().tolist())
    parameters.update()
    return mesh


def solid_mesh(shape: Shape, turns: int, lengths: int) -> tuple[Array, NDArray[np.intp]]:
    """Return a machine's solid as triangles, in its own coordinates.

    Parameters
    ----------
    shape : Shape
    turns, lengths : int
        Facets round what is round, and along each edge.

    Returns
    -------
    corners : ndarray, shape (V, 3)
        On its surface.
    faces : ndarray of int, shape (F, 3)
        Counterclockwise from outside.
    """
    if shape.kind == "box":
        return _box(shape.half_mm, max(1, lengths // 2))
    half, disc, ball = shape.half_mm[2], shape.disc_mm, shape.ball_mm
    along = np.linspace(-half, half, lengths + 1) if half > 0.0 else np.zeros(1)
    # The outline in the half plane (distance from the axis, height), from the bottom up.
    outline = [np.column_stack([np.full(len(along), disc + ball), along])]
    if disc > 0.0:
        rim = np.linspace(0.0, disc, max(2, lengths // 2))[:-1]
        outline = [
            np.column_stack([rim, np.full(len(rim), -half)]),
            *outline,
            np.column_stack([rim[::-1], np.full(len(rim), half)]),
        ]
    else:
        bend = np.linspace(0.0, 0.5 * math.pi, max(3, turns // 4) + 1)
        cap = np.column_stack([ball * np.cos(bend[1:]), half + ball * np.sin(bend[1:])])
        outline = [cap[::-1] * [1.0, -1.0], *outline, cap]
    return _lathe(np.concatenate(outline), turns)


def _lathe(outline: Array, turns: int) -> tuple[Array, NDArray[np.intp]]:
    """Turn an outline (K, 2) that begins and ends on the axis about z."""
    angle = 2.0 * math.pi * np.arange(turns) / turns
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    corners = [np.column_stack([radius * ring, np.full(turns, height)]) for radius, height in outline]
    first = np.arange(turns)
    following = np.roll(first, -1)
    faces = []
    for row in range(len(outline) - 1):
        below, above = row * turns, (row + 1) * turns
        if row < len(outline) - 2:
            faces.append(np.stack([below + first, above + following, above + first], axis=-1))
        if row > 0:
            faces.append(np.stack([below + first, below + following, above + following], axis=-1))
        if row == len(outline) - 2:
            faces[-1] = np.stack([below + first, below + following, above + first], axis=-1)
    return np.concatenate(corners), np.concatenate(faces)


def _box(half_mm: tuple[float, float, float], parts: int) -> tuple[Array, NDArray[np.intp]]:
    """Return a box whose faces are cut into parts by parts rectangles."""
    steps = np.linspace(-1.0, 1.0, parts + 1)
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    cell = (np.arange(parts)[:, None] * (parts + 1) + np.arange(parts)).ravel()
    quad = np.stack([cell, cell + parts + 1, cell + parts + 2, cell + 1], axis=-1)
    corners: list[Array] = []
    faces: list[NDArray[np.intp]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            side = np.zeros((len(u), 3))
            side[:, axis], side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = sign, u, v
            offset = len(corners) * len(u)
            turned = quad if sign > 0.0 else quad[:, ::-1]
            corners.append(side * half_mm)
            faces += [offset + turned[:, [0, 1, 2]], offset + turned[:, [0, 2, 3]]]
    return np.concatenate(corners), np.concatenate(faces)
