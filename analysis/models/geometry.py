"""Pairs of directions, and what reflectance models need of them, without loss of digits."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.errors import BadInput

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMALLEST = 1e-150
"""Cosines smaller than this are taken as this, so that a product of two is never zero."""


class Geometry:
    """Pairs of directions and what the lobes need of them, each computed once, when first asked for.

    Pairs that are not lit and seen from above (or hold a NaN) are replaced by the normal, so that no formula
    meets an undefined value; `finish` puts zero and NaN back.

    Parameters
    ----------
    wi, wo : array_like, shape (..., 3)
        Unit directions to the light and to the camera, in the sample frame; leading dimensions broadcast.

    Raises
    ------
    BadInput
        If the last axis is not of length 3.
    """

    def __init__(self, wi: ArrayLike, wo: ArrayLike) -> None:
        light, camera = np.asarray(wi, dtype=np.float64), np.asarray(wo, dtype=np.float64)
        for name, direction in (("wi", light), ("wo", camera)):
            if direction.ndim == 0 or direction.shape[-1] != 3:
                raise BadInput(
                    f"directions need a last axis of length 3, not shape {direction.shape}",
                    where=name,
                    todo="pass an array of shape (N, 3)",
                )
        light, camera = np.broadcast_arrays(light, camera)
        self.finite: Mask = np.isfinite(_total(light)) & np.isfinite(_total(camera))
        self.visible: Mask = self.finite & (light[..., 2] > 0.0) & (camera[..., 2] > 0.0)
        self.wi: Array = self._replaced(light)
        self.wo: Array = self._replaced(camera)

    def _replaced(self, direction: Array) -> Array:
        if self.visible.all():
            return direction.copy()
        return np.where(self.visible[..., None], direction, np.array([0.0, 0.0, 1.0]))

    @cached_property
    def cos_i(self) -> Array:
        """N.L, shape (..., 1), at least `SMALLEST`."""
        return np.maximum(self.wi[..., 2:], SMALLEST)

    @cached_property
    def cos_o(self) -> Array:
        """N.E, shape (..., 1), at least `SMALLEST`."""
        return np.maximum(self.wo[..., 2:], SMALLEST)

    @cached_property
    def sin2_i(self) -> Array:
        """Squared sine of the light's angle, from components, shape (..., 1)."""
        return np.square(self.wi[..., 0:1]) + np.square(self.wi[..., 1:2])

    @cached_property
    def sin2_o(self) -> Array:
        """Squared sine of the camera's angle, from components, shape (..., 1)."""
        return np.square(self.wo[..., 0:1]) + np.square(self.wo[..., 1:2])

    @cached_property
    def tangential_dot(self) -> Array:
        """sin(theta_i) sin(theta_o) cos(phi_i - phi_o): the dot product in the surface, shape (..., 1)."""
        return _dot(self.wi[..., :2], self.wo[..., :2])[..., None]

    @cached_property
    def sin2_d(self) -> Array:
        """Squared sine of the angle between E (or L) and H: a quarter of |L - E|^2, shape (..., 1)."""
        apart = self.wi - self.wo
        return 0.25 * _dot(apart, apart)[..., None]

    @cached_property
    def tangents(self) -> tuple[Array, Array]:
        """Slopes H_x / H_z and H_y / H_z of the facet that mirrors, each (..., 1); capped as `tan2_h` is."""
        x, y = (np.clip(self.half[..., i : i + 1] / self.half[..., 2:3], -1e70, 1e70) for i in (0, 1))
        return x, y

    @cached_property
    def retro(self) -> Geometry:
        """The same pairs with the camera mirrored about the normal: there H is N where E is L."""
        return Geometry(self.wi, self.wo * np.array([-1.0, -1.0, 1.0]))

    @cached_property
    def half(self) -> Array:
        """L + E, not normalised, shape (..., 3).

        Where E is near the mirror direction its sideways components are small differences, in which the last
        digit of the directions' own lengths would be the first to show: that is taken out.
        """
        half = self.wi + self.wo
        light, camera = _surplus(self.wi), _surplus(self.wo)
        for axis in range(3):  # a row of three is too short a loop to broadcast over
            half[..., axis] -= light * self.wi[..., axis] + camera * self.wo[..., axis]
        return half

    @cached_property
    def tan2_h(self) -> Array:
        """Squared tangent of the half vector's angle to the normal, shape (..., 1).

        From components and not from 1 - cos^2, which has no correct digit left near the normal. Capped far
        beyond the last angle at which any lobe is above zero.
        """
        x, y, z = self.half[..., 0:1], self.half[..., 1:2], self.half[..., 2:3]
        return np.square(np.minimum(np.hypot(x, y) / z, 1e70))

    @cached_property
    def cos_h(self) -> Array:
        """N.H, shape (..., 1)."""
        return self.half[..., 2:] / self.half_length

    @cached_property
    def half_length(self) -> Array:
        """|L + E|, shape (..., 1), at least `SMALLEST`."""
        tangential = np.hypot(self.half[..., 0:1], self.half[..., 1:2])
        return np.maximum(np.hypot(tangential, self.half[..., 2:3]), SMALLEST)

    @cached_property
    def cos_d(self) -> Array:
        """E.H = L.H, shape (..., 1): half the length of L + E, which does not cancel where E is near -L."""
        return 0.5 * self.half_length

    @cached_property
    def log_mirror(self) -> Array:
        """Natural logarithm of R.E (R the mirror direction of L), -inf where R.E <= 0, shape (..., 1).

        Near the mirror direction from 1 - |R - E|^2/2, as a large exponent multiplies this logarithm; away
        from it, where R.E cancels, from the dot product in twice the digits.
        """
        mirror = self.wi * np.array([-1.0, -1.0, 1.0])
        apart = mirror - self.wo
        square = _dot(apart, apart)
        near = square < 1.0
        logarithm = np.asarray(np.log1p(-0.5 * np.where(near, square, 0.0)))
        logarithm[~near] = _log_dot(mirror[~near], self.wo[~near])
        return logarithm[..., None]

    def finish(self, values: Array) -> Array:
        """Put 0 below the horizon and NaN where a direction was not finite; shape (..., channels)."""
        return np.where(self.visible[..., None], values, np.where(self.finite[..., None], 0.0, np.nan))


@np.errstate(invalid="ignore", over="ignore")
def _total(direction: Array) -> Array:
    """Sum of the components: not finite where one of them is not."""
    return np.asarray(direction[..., 0] + direction[..., 1] + direction[..., 2])


def _dot(a: Array, b: Array) -> Array:
    """Dot product over the last axis."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


_GRID = 1.5 * 2.0**26
"""Adding and subtracting this rounds a number below 1 to multiples of 2^-26, whose squares add up exactly."""


def _surplus(direction: Array) -> Array:
    """1 - 1/length, to all digits where directions are unit but for rounding."""
    coarse = (direction + _GRID) - _GRID
    fine = direction - coarse
    excess = (_dot(coarse, coarse) - 1.0) + _dot(fine, coarse + direction)
    length = np.sqrt(np.maximum(1.0 + excess, SMALLEST))
    return np.asarray(excess / (length * (1.0 + length)))


def _log_dot(a: Array, b: Array) -> Array:
    """Natural logarithm of the dot product over the last axis, -inf where it is not positive."""
    high, low = _dot_twice(a, b)
    lit = high + low > 0.0
    safe = np.where(lit, high, 1.0)
    return np.where(lit, np.log(safe) + np.where(lit, low, 0.0) / safe, -np.inf)


_SPLITTER = 134217729.0  # 2**27 + 1


def _product_twice(a: Array, b: Array) -> tuple[Array, Array]:
    """Exact product as a sum of two doubles (Dekker 1971)."""
    product = a * b
    a_high = _SPLITTER * a - (_SPLITTER * a - a)
    b_high = _SPLITTER * b - (_SPLITTER * b - b)
    a_low, b_low = a - a_high, b - b_high
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def _dot_twice(a: Array, b: Array) -> tuple[Array, Array]:
    """Dot product over the last axis as a sum of two doubles (Ogita, Rump & Oishi 2005, algorithm Dot2)."""
    total, error = _product_twice(a[..., 0], b[..., 0])
    for axis in (1, 2):
        product, product_error = _product_twice(a[..., axis], b[..., axis])
        summed = total + product
        rest = summed - total
        error = error + ((total - (summed - rest)) + (product - rest)) + product_error
        total = summed
    high = total + error
    return high, error - (high - total)
