"""Two directions, and what lobes need of them, without loss of digits: `analysis.models.geometry` in float32.

Values are floats in the scalar variant and Dr.Jit's arrays in others.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import drjit as dr

SMALLEST = 1e-18
"""Cosines smaller than this are taken as this, so that a product of two is a normal number."""
STEEPEST = 1e9
"""Tangents are cut off here, far beyond the last angle at which any lobe is above zero: their fourth powers
are finite."""


class Pair:
    """A light and a camera above the horizon.

    Parameters
    ----------
    light, camera : mitsuba.Vector3f
        Unit directions to the light and to the camera, in the frame of the surface.
    """

    def __init__(self, light: Any, camera: Any) -> None:
        self.light = light
        self.camera = camera

    @cached_property
    def cos_i(self) -> Any:
        """N.L, at least `SMALLEST`."""
        return dr.maximum(self.light.z, SMALLEST)

    @cached_property
    def cos_o(self) -> Any:
        """N.E, at least `SMALLEST`."""
        return dr.maximum(self.camera.z, SMALLEST)

    @cached_property
    def larger_cosine(self) -> Any:
        """The larger of N.L and N.E."""
        return dr.maximum(self.cos_i, self.cos_o)

    @cached_property
    def sin2_i(self) -> Any:
        """Squared sine of the light's angle, from components."""
        return dr.square(self.light.x) + dr.square(self.light.y)

    @cached_property
    def sin2_o(self) -> Any:
        """Squared sine of the camera's angle, from components."""
        return dr.square(self.camera.x) + dr.square(self.camera.y)

    @cached_property
    def tangential_dot(self) -> Any:
        """sin(theta_i) sin(theta_o) cos(phi_i - phi_o): the dot product in the surface."""
        high, low = sum_of_products((self.light.x, self.camera.x), (self.light.y, self.camera.y))
        return high + low

    @cached_property
    def sin2_d(self) -> Any:
        """Squared sine of the angle between E (or L) and H: a quarter of |L - E|^2."""
        return 0.25 * dr.squared_norm(self.light - self.camera)

    @cached_property
    def half(self) -> Any:
        """L + E, not normalised, both taken at their exact length of 1.

        Near the mirror direction its sideways components are small differences, in which the last digit of
        the directions' own lengths is the first to show.
        """
        own = surplus(self.light) * self.light + surplus(self.camera) * self.camera
        return self.light + self.camera - own

    @cached_property
    def half_length(self) -> Any:
        """|L + E|, at least `SMALLEST`."""
        return dr.maximum(dr.norm(self.half), SMALLEST)

    @cached_property
    def cos_h(self) -> Any:
        """N.H."""
        return self.half.z / self.half_length

    @cached_property
    def cos_d(self) -> Any:
        """E.H = L.H: half the length of L + E, which does not cancel where E is near -L."""
        return 0.5 * self.half_length

    @cached_property
    def tangents(self) -> tuple[Any, Any]:
        """Slopes H_x / H_z and H_y / H_z of the facet that mirrors."""
        h = self.half
        x, y = h.x / h.z, h.y / h.z
        return tuple(dr.maximum(dr.minimum(t, STEEPEST), -STEEPEST) for t in (x, y))

    @cached_property
    def tan2_h(self) -> Any:
        """Squared tangent of the half vector's angle to the normal, from components."""
        x, y = self.half.x / self.half.z, self.half.y / self.half.z
        return dr.minimum(dr.square(x) + dr.square(y), STEEPEST**2)

    @cached_property
    def log_mirror(self) -> tuple[Any, Any]:
        """Whether R.E > 0, R the mirror direction of L, and its natural logarithm; 0 where it is not.

        Near the mirror direction from 1 - |R - E|^2/2, as a large exponent multiplies this logarithm; away
        from it, where R.E cancels, from the dot product in twice the digits.
        """
        light, camera = self.light, self.camera
        x, y, z = light.x + camera.x, light.y + camera.y, light.z - camera.z
        missing = 0.5 * (x * x + y * y + z * z)
        near = missing < 0.5
        lit, far = log_of_sum((-light.x, camera.x), (-light.y, camera.y), (light.z, camera.z))
        far -= self.log_lengths
        return near | lit, dr.select(near, log1p(dr.select(near, -missing, 0.0)), far)

    @cached_property
    def log_lengths(self) -> Any:
        """Logarithm of |L| |E|, by whose last digit a dot product is too large: an exponent multiplies it."""
        return surplus(self.light) + surplus(self.camera)

    @cached_property
    def retro(self) -> Pair:
        """The same pair with the camera mirrored about the normal: there H is N where E is L."""
        x, y, z = self.camera.x, self.camera.y, self.camera.z
        return Pair(self.light, type(self.camera)(-x, -y, z))


def log1p(x: Any) -> Any:
    """log(1 + x) without loss for small x (Kahan; Goldberg 1991, theorem 4): Dr.Jit has none."""
    u = 1.0 + x
    same = u == 1.0
    return dr.select(same, x, dr.log(u) * (x / dr.select(same, 1.0, u - 1.0)))


def expm1(x: Any) -> Any:
    """exp(x) - 1 without loss for small x (Kahan; Higham 2002, section 1.14.1), for x > -50 or so."""
    u = dr.exp(x)
    same = u == 1.0
    return dr.select(same, x, (u - 1.0) * (x / dr.select(same, 1.0, dr.log(u))))


def sum_of_products(*pairs: tuple[Any, Any]) -> tuple[Any, Any]:
    """Sum of products in twice the digits (Ogita, Rump & Oishi 2005, algorithm Dot2): value and rest."""
    # One type for all: a double of the scalar variant, met by single precision, would lose its rest unseen.
    kind: Any = dr.expr_t(*(factor for pair in pairs for factor in pair))
    if kind is float:  # a double has twice the digits, and needs no help
        return sum(a * b for a, b in pairs), 0.0
    total, rest = kind(0.0), kind(0.0)
    for a, b in ((kind(first), kind(second)) for first, second in pairs):
        product = a * b
        summed = total + product
        back = summed - total
        rest = rest + dr.fma(a, b, -product) + ((total - (summed - back)) + (product - back))
        total = summed
    return total, rest


def log_of_sum(*pairs: tuple[Any, Any]) -> tuple[Any, Any]:
    """Whether a sum of products is above zero, and its natural logarithm; 0 where it is not."""
    high, low = sum_of_products(*pairs)
    # Where terms cancel, the rest may be as large as the value or larger: it is taken in first.
    total = high + low
    taken = total - high
    rest = (high - (total - taken)) + (low - taken)
    lit = total > 0.0
    safe = dr.select(lit, total, 1.0)
    return lit, dr.log(safe) + dr.select(lit, rest, 0.0) / safe


def surplus(direction: Any) -> Any:
    """Part of a direction that it is too long: |d| - 1 over |d|."""
    high, low = sum_of_products((-1.0, 1.0), *((component, component) for component in direction))
    # (sqrt(1 + e) - 1)/sqrt(1 + e) of an excess e of single precision's last digit.
    return 0.5 * (high + low)
