"""Diffuse terms that are not Lambert's, at unit scale, in 1/sr."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from analysis.models.eon import MEAN_LOSS
from analysis.models.oren_nayar import LOSS
from simulator.bsdfs.pair import expm1, log1p

if TYPE_CHECKING:
    from collections.abc import Mapping

    from simulator.bsdfs.pair import Pair


def lambert(_pair: Pair, _p: Mapping[str, Any]) -> Any:
    """1/pi."""
    return dr.inv_pi


def oren_nayar(pair: Pair, p: Mapping[str, Any]) -> Any:
    """Oren and Nayar's qualitative model."""
    square = dr.square(p["sigma_rad"])
    towards = dr.maximum(pair.tangential_dot, 0.0) / pair.larger_cosine
    level, rise = 1.0 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)
    return (level + rise * towards) * dr.inv_pi


def fujii(pair: Pair, p: Mapping[str, Any]) -> Any:
    """Fujii's; 1 + s, which cancels where both graze from opposite sides, as a sum of squares."""
    r, dot, h = p["roughness"], pair.tangential_dot, pair.half
    squares = h.x * h.x + h.y * h.y + dr.square(pair.cos_i) + dr.square(pair.cos_o)
    forward = dot > 0.0
    raised = dr.select(forward, 1.0 + dot / pair.larger_cosine, 0.5 * squares)
    return ((1.0 - r) + r * raised) / (1.0 + LOSS * r) * dr.inv_pi


def eon(pair: Pair, p: Mapping[str, Any]) -> Any:
    """Fujii's with the light that goes between facets."""
    r, a = p["roughness"], p["facet_albedo"]
    entering, mean = 1.0 + LOSS * r, 1.0 + (LOSS - MEAN_LOSS) * r
    returned = a * mean / (entering - a * r * MEAN_LOSS) * (r / entering)
    lost = _lost(pair.cos_i, pair.sin2_i) * _lost(pair.cos_o, pair.sin2_o) / MEAN_LOSS
    return fujii(pair, p) + returned * lost * dr.inv_pi


def _lost(cosine: Any, sine2: Any) -> Any:
    """Light that leaves a facet for another; as `analysis.models.eon` has it."""
    sine = dr.sqrt(sine2)
    level = (0.5 * dr.pi - 2.0 / 3.0) * cosine * cosine / (1.0 + sine)
    rest = sine * cosine * cosine * cosine * (sine + 2.0) / (3.0 * dr.square(1.0 + sine))
    return (level + sine * dr.atan2(cosine, sine) - rest) * dr.inv_pi


def below_facets(pair: Pair, p: Mapping[str, Any]) -> Any:
    """Ashikhmin and Shirley's, which gives way to the lobe."""
    return 28.0 / 23.0 * dr.inv_pi * (1.0 - p["f0"]) * _entered(pair.cos_i) * _entered(pair.cos_o)


def _entered(cosine: Any) -> Any:
    """1 - (1 - cos/2)^5, without loss at grazing angles."""
    return -expm1(5.0 * log1p(-0.5 * cosine))
