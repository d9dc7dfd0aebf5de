r"""Every convention of directions and angles, stated once.

The sample frame is right-handed: origin on the sample's surface, +z its normal, +x towards the sample's mark.
``wi`` points to the light and ``wo`` to the camera; both are unit vectors that leave the surface. The polar
angle theta runs from +z, the azimuth phi from +x towards +y. Angles are radians; directions are float64
arrays whose last axis is (x, y, z), and every function broadcasts over the axes before it. NaN in gives NaN
out, silently.

Where an angle has no value the functions agree on one, so that each pair of functions is an exact round trip:

* the azimuth of a pole (theta = 0 or pi) is 0, so the azimuth of a half vector along the normal is 0 too;
* ``phi_d`` is 0 where light and camera coincide (theta_d = 0);
* the half vector of opposite directions (wi = -wo) is the unit vector perpendicular to wi that lies closest
  to +z, and +x where wi itself is +z or -z; so at grazing it is +z, as for grazing light reflected by a
  mirror.

Half and difference angles follow Rusinkiewicz (1998), "A new change of variables for efficient BRDF
representation", section 3: the difference direction is wi after the rotations that carry the half vector to
+z, first by -phi_h about +z, then by -theta_h about +y.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]

_CLOSE_TO_OPPOSITE = 0.1
"""Length of wi + wo below which its rounding is removed; above, it is smaller than the tests' 1e-12."""

_OPPOSITE = 1e-15
"""Length of wi + wo below which only rounding is left of it and the directions count as opposite."""


def unit(v: npt.ArrayLike) -> FloatArray:
    """Scale vectors to length one, without overflow or underflow.

    Parameters
    ----------
    v : array_like, shape (..., 3)
        Vectors of any length. A zero, infinite or NaN vector has no direction and gives NaN.

    Returns
    -------
    ndarray, shape (..., 3)
    """
    vectors = np.asarray(v, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore", under="ignore"):
        scaled = vectors / np.max(np.abs(vectors), axis=-1, keepdims=True)
        return np.asarray(scaled / _length(scaled)[..., None])


def spherical_to_direction(theta: npt.ArrayLike, phi: npt.ArrayLike) -> FloatArray:
    """Direction of a polar angle and an azimuth.

    Parameters
    ----------
    theta, phi : array_like, radians
        Broadcast against each other to shape (...).

    Returns
    -------
    ndarray, shape (..., 3)
        Unit vectors.
    """
    theta, phi = np.broadcast_arrays(np.asarray(theta, np.float64), np.asarray(phi, np.float64))
    sin_theta = np.sin(theta)
    return np.stack([sin_theta * np.cos(phi), sin_theta * np.sin(phi), np.cos(theta) + 0.0 * phi], axis=-1)


def direction_to_spherical(w: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Polar angle and azimuth of directions.

    Both come from two-argument arc tangents, so they keep full precision at the poles, where an arc cosine of
    z loses half of the digits.

    Parameters
    ----------
    w : array_like, shape (..., 3)
        Directions; their length does not matter.

    Returns
    -------
    theta : ndarray, shape (...)
        In [0, pi].
    phi : ndarray, shape (...)
        In [-pi, pi]; 0 at the poles.
    """
    x, y, z = _components(w)
    sideways = np.hypot(x, y)
    theta = np.asarray(np.arctan2(sideways, z))
    phi = np.where(sideways == 0.0, 0.0, np.arctan2(y, x))
    return theta, np.where(np.isnan(theta), np.nan, phi)


def half_vector(wi: npt.ArrayLike, wo: npt.ArrayLike) -> FloatArray:
    """Find the unit vector half-way between light and camera.

    Parameters
    ----------
    wi, wo : array_like, shape (..., 3)
        Unit vectors to the light and to the camera; they broadcast.

    Returns
    -------
    ndarray, shape (..., 3)
        For opposite directions see the module's convention.
    """
    wi, wo = np.broadcast_arrays(np.asarray(wi, np.float64), np.asarray(wo, np.float64))
    total = np.asarray(wi + wo)
    close = _dot(total, total) < _CLOSE_TO_OPPOSITE**2
    if np.any(close):
        total[close] = _mend_sum(wi[close], wo[close])
    return unit(total)


def half_difference(
    wi: npt.ArrayLike, wo: npt.ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Half and difference angles of a pair of directions (Rusinkiewicz 1998, section 3).

    Parameters
    ----------
    wi, wo : array_like, shape (..., 3)
        Unit vectors to the light and to the camera; they broadcast.

    Returns
    -------
    theta_h, phi_h, theta_d, phi_d : ndarray, shape (...)
        Radians; theta_h in [0, pi], theta_d in [0, pi/2], azimuths in [-pi, pi].
    """
    wi, wo = np.broadcast_arrays(np.asarray(wi, np.float64), np.asarray(wo, np.float64))
    theta_h, phi_h = direction_to_spherical(half_vector(wi, wo))
    x, y, z = _components(wi)
    cos_phi, sin_phi = np.cos(phi_h), np.sin(phi_h)
    cos_theta, sin_theta = np.cos(theta_h), np.sin(theta_h)
    along = cos_phi * x + sin_phi * y
    _, phi_d = direction_to_spherical(
        np.stack(
            [cos_theta * along - sin_theta * z, cos_phi * y - sin_phi * x, sin_theta * along + cos_theta * z],
            -1,
        )
    )
    # |wi - wo| / |wi + wo| is the tangent of half the angle between them: precise at both ends of the range.
    theta_d = np.asarray(np.arctan2(_length(wi - wo), _length(wi + wo)))
    return theta_h, phi_h, theta_d, np.where(theta_d == 0.0, 0.0, phi_d)


def from_half_difference(
    theta_h: npt.ArrayLike, phi_h: npt.ArrayLike, theta_d: npt.ArrayLike, phi_d: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Directions of half and difference angles, the inverse of `half_difference`.

    Parameters
    ----------
    theta_h, phi_h, theta_d, phi_d : array_like, radians
        Broadcast against each other to shape (...).

    Returns
    -------
    wi, wo : ndarray, shape (..., 3)
        Unit vectors to the light and to the camera.
    """
    theta_h, phi_h, theta_d, phi_d = np.broadcast_arrays(
        *(np.asarray(angle, np.float64) for angle in (theta_h, phi_h, theta_d, phi_d))
    )
    cos_phi, sin_phi = np.cos(phi_h), np.sin(phi_h)
    cos_theta, sin_theta = np.cos(theta_h), np.sin(theta_h)

    def to_sample(d: FloatArray) -> FloatArray:
        x, y, z = _components(d)
        along = cos_theta * x + sin_theta * z
        return np.stack(
            [cos_phi * along - sin_phi * y, sin_phi * along + cos_phi * y, cos_theta * z - sin_theta * x],
            axis=-1,
        )

    difference = spherical_to_direction(theta_d, phi_d)
    return to_sample(difference), to_sample(mirror(difference))


def mirror(w: npt.ArrayLike) -> FloatArray:
    """Directions mirrored about the normal +z: where a flat mirror sends the light that comes from `w`.

    Parameters
    ----------
    w : array_like, shape (..., 3)

    Returns
    -------
    ndarray, shape (..., 3)
    """
    return np.asarray(np.asarray(w, dtype=np.float64) * np.array([-1.0, -1.0, 1.0]))


def rotation(axis: npt.ArrayLike, angle: npt.ArrayLike) -> FloatArray:
    """Rotation matrix, right-handed, about an axis through the origin (Rodrigues 1840).

    Parameters
    ----------
    axis : array_like, shape (..., 3)
        Any length but zero; +y with a positive angle carries +z towards +x.
    angle : array_like, radians
        Broadcast against the axis' leading axes to shape (...).

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Acts on column vectors: ``rotation(axis, angle) @ v``.
    """
    axis = unit(axis)
    angle = np.asarray(angle, dtype=np.float64)[..., None, None]
    x, y, z = _components(axis)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*axis.shape[:-1], 3, 3)
    outer = axis[..., :, None] * axis[..., None, :]
    cosine = np.cos(angle)
    return np.asarray(cosine * np.eye(3) + np.sin(angle) * cross + (1.0 - cosine) * outer)


def turned(w: npt.ArrayLike, angle: npt.ArrayLike) -> FloatArray:
    """Turn directions about the sample's normal.

    Parameters
    ----------
    w : array_like, shape (N, 3)
        Directions.
    angle : array_like, radians, shape (N,) or ()
        Added to the azimuth of each.

    Returns
    -------
    ndarray, shape (N, 3)
    """
    x, y, z = np.asarray(w, dtype=np.float64).T
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)


def wrap(angle: npt.ArrayLike) -> FloatArray:
    """Bring angles into (-pi, pi]; angles that are already inside stay bit for bit what they are.

    Parameters
    ----------
    angle : array_like, radians

    Returns
    -------
    ndarray
        The same shape. NaN and infinite angles give NaN.
    """
    angles = np.asarray(angle, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        turned = angles - 2.0 * np.pi * np.ceil((angles - np.pi) / (2.0 * np.pi))
    # Rounding can carry odd half turns past the upper end, and angles inside off their last digit.
    return np.where((angles > -np.pi) & (angles <= np.pi), angles, np.minimum(turned, np.pi))


def _components(w: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    vectors = np.asarray(w, dtype=np.float64)
    return vectors[..., 0], vectors[..., 1], vectors[..., 2]


def _length(v: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(_dot(v, v)))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _mend_sum(wi: FloatArray, wo: FloatArray) -> FloatArray:
    """Find the direction (N, 3) of wi + wo for nearly opposite directions, where rounding spoils the sum.

    Of unit vectors, the sum is perpendicular to the difference. Rounding breaks that, and the half vector
    would point anywhere; removing the sum's component along the difference restores it.
    """
    total, apart = wi + wo, wi - wo
    with np.errstate(invalid="ignore"):  # zero vectors have no half vector: NaN
        total -= (_dot(total, apart) / _dot(apart, apart))[:, None] * apart
    opposite = _length(total) < _OPPOSITE
    total[opposite] = _perpendicular_towards_normal(wi[opposite])
    return total


def _perpendicular_towards_normal(w: FloatArray) -> FloatArray:
    """Find the unit vector perpendicular to `w` closest to +z; +x where `w` is a pole."""
    x, y, z = _components(w)
    sideways = np.hypot(x, y)
    safe = np.where(sideways == 0.0, 1.0, sideways)
    pole = sideways == 0.0
    return np.stack(
        [
            np.where(pole, 1.0, -z * x / safe),
            np.where(pole, 0.0, -z * y / safe),
            np.where(pole, 0.0, sideways),
        ],
        axis=-1,
    )
