"""What microfacet lobes are made of: distribution of slopes, masking and shadowing.

Sources and equations are those of `analysis.models.microfacet` and `analysis.models.anisotropic`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from simulator.bsdfs.pair import SMALLEST

if TYPE_CHECKING:
    from collections.abc import Callable

    from simulator.bsdfs.pair import Pair


def beckmann(pair: Pair, m: Any) -> Any:
    """Beckmann's distribution, normalised to a projected area of 1."""
    m2 = m * m
    # The exponential first: what it makes zero, the rest must not make infinite times zero.
    return dr.exp(-pair.tan2_h / m2) / (dr.pi * m2) * dr.square(1.0 + pair.tan2_h)


def ggx(pair: Pair, alpha: Any) -> Any:
    """GGX distribution, normalised to a projected area of 1."""
    return dr.square(alpha * (1.0 + pair.tan2_h) / (alpha * alpha + pair.tan2_h)) / dr.pi


def turned(x: Any, y: Any, axis: Any) -> tuple[Any, Any]:
    """Components along and across an axis."""
    s, c = dr.sin(axis), dr.cos(axis)
    return c * x + s * y, c * y - s * x


def _steepness(pair: Pair, widths: tuple[Any, Any], axis: Any) -> Any:
    along, across = turned(*pair.tangents, axis)
    return dr.square(along / widths[0]) + dr.square(across / widths[1])


def ggx_of_two_widths(pair: Pair, widths: tuple[Any, Any], axis: Any) -> Any:
    """GGX distribution of a width along and one across an axis."""
    ratio = (1.0 + pair.tan2_h) / (1.0 + _steepness(pair, widths, axis))
    return ratio * ratio / (dr.pi * widths[0] * widths[1])


def beckmann_of_two_widths(pair: Pair, widths: tuple[Any, Any], axis: Any) -> Any:
    """Beckmann's distribution of a width along and one across an axis."""
    density = dr.exp(-_steepness(pair, widths, axis)) / (dr.pi * widths[0] * widths[1])
    return density * dr.square(1.0 + pair.tan2_h)


def smith_ggx(cosine: Any, run2: Any) -> Any:
    """Return cos (1 + Lambda) of GGX; `run2` is the square of width times sine."""
    return 0.5 * (cosine + dr.sqrt(cosine * cosine + run2))


def smith_beckmann(cosine: Any, run2: Any) -> Any:
    """Return cos (1 + Lambda) of Beckmann's distribution; as `smith_ggx`."""
    run = dr.maximum(dr.sqrt(run2), SMALLEST)
    a = cosine / run
    return 0.5 * (cosine * (1.0 + dr.erf(a)) + run * dr.exp(-a * a) / dr.sqrt(dr.pi))


def runs(pair: Pair, width: Any) -> tuple[Any, Any]:
    """Squares of width times sine, of light and camera."""
    return width * width * pair.sin2_i, width * width * pair.sin2_o


def runs_of_two_widths(pair: Pair, widths: tuple[Any, Any], axis: Any) -> tuple[Any, Any]:
    """Squares of the width along each direction's azimuth times its sine."""

    def run2(direction: Any) -> Any:
        along, across = turned(direction.x, direction.y, axis)
        return dr.square(widths[0] * along) + dr.square(widths[1] * across)

    return run2(pair.light), run2(pair.camera)


def correlated(pair: Pair, smith: Callable[[Any, Any], Any], run2: tuple[Any, Any]) -> Any:
    """G / ((N.L)(N.E)) of Smith's model with heights correlated."""
    excess = smith(pair.cos_i, run2[0]) - pair.cos_i
    return 1.0 / (pair.cos_o * excess + pair.cos_i * smith(pair.cos_o, run2[1]))


def separable(pair: Pair, smith: Callable[[Any, Any], Any], run2: tuple[Any, Any]) -> Any:
    """G / ((N.L)(N.E)) of Smith's model with masking and shadowing independent."""
    return 1.0 / smith(pair.cos_i, run2[0]) / smith(pair.cos_o, run2[1])


def grooves(pair: Pair) -> Any:
    """G / ((N.L)(N.E)) for V-shaped grooves."""
    grooved = 2.0 * pair.cos_h / (pair.cos_d * pair.larger_cosine)
    return dr.minimum(1.0 / (pair.cos_i * pair.cos_o), grooved)


def ggx_mirrors(pair: Pair, alpha: Any) -> Any:
    """D G / (4 (N.L)(N.E)) of GGX facets that are perfect mirrors, heights correlated."""
    return 0.25 * ggx(pair, alpha) * correlated(pair, smith_ggx, runs(pair, alpha))
