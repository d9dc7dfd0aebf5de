"""Local illumination: ambient light, and the sum over all lights that are not in shadow.

I = I_a k_a + sum over j of v_j I_j pi f_r(L_j, E) (N.L_j), v_j = 0 where light j is in shadow. An intensity
I_j is the radiance of an ideal white diffuser that faces the light (its irradiance over pi), as in courses
on graphics: of Lambert's model I_j k_d N.L_j is left, and of Phong's I_j (k_d N.L_j + k_s (R.E)^n), whose
k_s is pi times that of the BRDF in `analysis.models.phong`. Ambient light stands in for all that comes by
way of other surfaces; it is no part of a BRDF.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rig.errors import BadInput

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from analysis.models.base import Model

    Array = NDArray[np.float64]


def shade(
    model: Model,
    normals: ArrayLike,
    eye: ArrayLike,
    lights: ArrayLike,
    intensities: ArrayLike,
    *,
    lit: ArrayLike | None = None,
    ambient: ArrayLike = 0.0,
    k_ambient: ArrayLike = 1.0,
    tangents: ArrayLike | None = None,
) -> Array:
    """Shade points of a surface.

    Parameters
    ----------
    model : Model
        Reflectance, the same at all points.
    normals : array_like, shape (..., 3)
        Unit normals.
    eye : array_like, shape (3,) or (..., 3)
        Unit direction to the eye, at all points or at each.
    lights : array_like, shape (J, 3) or (J, ..., 3)
        Unit direction to each of J lights, at all points or at each.
    intensities : array_like, shape (J,) or (J, channels)
        Radiance of an ideal white diffuser that faces the light.
    lit : array_like of bool, shape (J, ...), optional
        Whether a light reaches a point; by default no light is in shadow of something else. Points that face
        away are dark in any case.
    ambient, k_ambient : float or array_like, shape (channels,)
        Intensity of the ambient light, and the surface's reflectance for it.
    tangents : array_like, shape (..., 3), optional
        Direction in the surface from which the model counts azimuths; needed by anisotropic models only.

    Returns
    -------
    ndarray, shape (..., channels)
        Radiance towards the eye, in the unit of the intensities; NaN where a direction is.

    Raises
    ------
    BadInput
        If shapes do not agree, an anisotropic model comes without tangents, or one is parallel to its normal.
    """
    normal = np.asarray(normals, dtype=np.float64)
    towards = np.asarray(lights, dtype=np.float64)
    strengths = np.asarray(intensities, dtype=np.float64)
    _check(normal, towards, strengths, lit)
    if tangents is None and not model.ISOTROPIC:
        raise BadInput(f"{model.NAME} is anisotropic", where="tangents", todo="say where azimuths start")
    frame = _frame(normal, None if tangents is None else np.asarray(tangents, dtype=np.float64))
    seen = _into(frame, np.asarray(eye, dtype=np.float64))
    total = np.zeros((*normal.shape[:-1], 1)) + np.asarray(ambient) * np.asarray(k_ambient)
    for j, direction in enumerate(towards):
        wi = _into(frame, direction)
        reflected = np.pi * model.evaluate(wi, seen) * np.maximum(wi[..., 2:], 0.0)
        if lit is not None:
            reflected = np.where(np.asarray(lit, dtype=bool)[j][..., None], reflected, 0.0)
        total = total + strengths[j] * reflected
    return np.asarray(total)


def sphere(size_px: int) -> tuple[Array, NDArray[np.bool_]]:
    """Return normals of a sphere that fills a square picture, seen from +z far away, x right, y up.

    Parameters
    ----------
    size_px : int
        Side of the picture.

    Returns
    -------
    tuple of ndarray
        Normals (size, size, 3), +z outside the sphere, and whether a pixel's centre is on it (size, size).
    """
    across = (np.arange(size_px) + 0.5) / (0.5 * size_px) - 1.0
    x, y = np.meshgrid(across, -across)
    inside = x * x + y * y < 1.0
    z = np.sqrt(np.where(inside, 1.0 - x * x - y * y, 1.0))
    return np.stack([np.where(inside, x, 0.0), np.where(inside, y, 0.0), z], axis=-1), inside


def _check(normals: Array, lights: Array, intensities: Array, lit: ArrayLike | None) -> None:
    for name, value, least in (("normals", normals, 1), ("lights", lights, 2)):
        if value.ndim < least or value.shape[-1] != 3:
            raise BadInput(
                f"needs a last axis of length 3, not shape {value.shape}",
                where=name,
                todo="pass unit directions, of lights one row each",
            )
    if intensities.ndim not in {1, 2} or len(intensities) != len(lights):
        raise BadInput(
            f"has shape {intensities.shape} for {len(lights)} lights",
            where="intensities",
            todo="pass one number, or one per channel, for each light",
        )
    if lit is not None and np.shape(lit)[:1] != (len(lights),):
        raise BadInput(
            f"has shape {np.shape(lit)} for {len(lights)} lights",
            where="lit",
            todo="pass one mask of the points for each light",
        )


def _frame(normals: Array, tangents: Array | None) -> Array:
    """Rows x, y, z of the surface's frame at each point, (..., 3, 3)."""
    if tangents is None:
        # Any direction that is not the normal will do for an isotropic model.
        steep = np.abs(normals[..., 2:]) > 0.7
        tangents = np.where(steep, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    along = tangents - np.sum(tangents * normals, axis=-1, keepdims=True) * normals
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    if np.any(length < 1e-9):
        raise BadInput(
            "a tangent is parallel to its normal", where="tangents", todo="pass directions in the surface"
        )
    along = along / length
    return np.stack(np.broadcast_arrays(along, np.cross(normals, along), normals), axis=-2)


def _into(frame: Array, direction: Array) -> Array:
    return np.asarray(np.einsum("...ij,...j->...i", frame, direction))
