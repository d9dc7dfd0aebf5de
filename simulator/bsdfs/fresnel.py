"""Reflectance of facets for unpolarised light: `analysis.models.fresnel` in single precision."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from simulator.bsdfs.pair import SMALLEST

if TYPE_CHECKING:
    from simulator.bsdfs.pair import Pair


def dielectric(pair: Pair, ior: Any) -> Any:
    """Return a dielectric's exact F: n^2 - 1 taken out of both amplitudes keeps it right near n = 1."""
    c = pair.cos_d
    contrast = (ior - 1.0) * (ior + 1.0)
    g = dr.maximum(dr.sqrt(contrast + c * c), SMALLEST)
    s, p = g + c, ior * ior * c + g
    brewster = (ior * ior + 1.0) * c * c - 1.0
    r_s = contrast / s / s
    r_p = contrast / p * brewster / p
    return 0.5 * (r_s * r_s + r_p * r_p)


def schlick(pair: Pair, f0: Any) -> Any:
    """F0 + (1 - F0)(1 - E.H)^5, with 1 - cos as sin^2/(1 + cos)."""
    return f0 + (1.0 - f0) * _fifth(departure(pair))


def departure(pair: Pair) -> Any:
    """1 - E.H, without a difference."""
    return pair.sin2_d / (1.0 + pair.cos_d)


def shifted_schlick(pair: Pair, f0: Any, f1: Any) -> Any:
    """F0 - F1 E.H + (1 - F0)(1 - E.H)^5 (Bagher, Soler & Holzschuch 2012)."""
    drop = departure(pair)
    return (f0 - f1) + f1 * drop + (1.0 - f0) * _fifth(drop)


def conductor(pair: Pair, eta: Any, k: Any) -> Any:
    """Return a metal's exact F, index eta + i k: the amplitudes of `dielectric`, squares of complex numbers.

    |r_s|^2 = |n^2 - 1|^2 / |g + c|^4 and |r_p|^2 = |n^2 - 1|^2 |(n^2 + 1) c^2 - 1|^2 / |n^2 c + g|^4.
    """
    c, sine2 = pair.cos_d, pair.sin2_d
    c2 = c * c
    # n^2 and n^2 - 1, whose real parts are differences where k is near: the imaginary part is large there.
    square, real, imaginary = (eta - k) * (eta + k), (eta - 1.0) * (eta + 1.0) - k * k, 2.0 * eta * k
    # From the smaller of sine and cosine: near the critical angle of a small index they cancel against it.
    steep = c2 > 0.5
    g_real, g_imaginary = _root(dr.select(steep, square - sine2, real + c2), imaginary)
    contrast2 = real * real + imaginary * imaginary
    s2 = dr.square(g_real + c) + dr.square(g_imaginary)
    p2 = dr.square(square * c + g_real) + dr.square(imaginary * c + g_imaginary)
    brewster = dr.select(steep, square * c2 - sine2, (square + 1.0) * c2 - 1.0)
    brewster2 = dr.square(brewster) + dr.square(imaginary * c2)
    return 0.5 * (contrast2 / s2 / s2 + contrast2 / p2 * brewster2 / p2)


def _root(real: Any, imaginary: Any) -> tuple[Any, Any]:
    """Square root of a complex number with an imaginary part >= 0; no part by a difference."""
    size = dr.sqrt(real * real + imaginary * imaginary)
    large = dr.maximum(dr.sqrt(0.5 * (size + dr.abs(real))), SMALLEST)
    small = 0.5 * imaginary / large
    positive = real > 0.0
    return dr.select(positive, large, small), dr.select(positive, small, large)


def _fifth(x: Any) -> Any:
    square = x * x
    return square * square * x
