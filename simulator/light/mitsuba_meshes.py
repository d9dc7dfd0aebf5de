"""Forms that Mitsuba is given as meshes: a cylinder, and a part of a sphere that mirrors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
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
    return _mesh(mi, "sample", bsdf, corners, faces)


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
    return _mesh(mi, name, bsdf, corners, np.concatenate(faces), normals)


def _mesh(  # noqa: PLR0917 - what a mesh is made of
    mi: Any, name: str, bsdf: Any, corners: Array, faces: NDArray[np.intp], normals: Array | None = None
) -> Any:
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
