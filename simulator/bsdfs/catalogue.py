"""Every model that Mitsuba is given: its terms, and where its light goes, for sampling."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import drjit as dr

from simulator.bsdfs import diffuse, glossy, powers

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from simulator.bsdfs.pair import Pair

    Values = Mapping[str, Any]
    Term = Callable[[Pair, Values], Any]


LARGEST = 1e30
"""Well within single precision, of which a product of scale and lobe has to be a number."""


class Spread(NamedTuple):
    """GGX facets that send light about where a lobe does; their density is exact, whatever the lobe.

    Attributes
    ----------
    along, across : number by channel
        Widths.
    axis_rad : number by channel
        Azimuth of the axis.
    back : bool
        Whether the lobe points back to the light.
    """

    along: Any
    across: Any
    axis_rad: Any = 0.0
    back: bool = False


@dataclass(frozen=True)
class Lobes:
    """Terms of a model at unit scale, in 1/sr.

    Parameters
    ----------
    specular : callable, optional
        Of a pair and the parameters: the term of `ks`.
    spreads : callable
        Of the parameters: `Spread`s that follow the specular term.
    diffuse : callable
        The term of `kd`.
    largest_log : callable
        Of the parameters of one channel: logarithm of the specular term's largest value, where parameters
        within a fit's bounds can make it too large for single precision.
    """

    specular: Term | None = None
    spreads: Callable[[Values], tuple[Spread, ...]] = lambda _: ()
    diffuse: Term = diffuse.lambert
    largest_log: Callable[[Mapping[str, float]], float] = lambda _: 0.0

    def holds(self, parameters: Mapping[str, float]) -> bool:
        """Whether parameters, of one channel, and the lobe that they make are numbers of single precision."""
        sizes = [abs(value) for value in parameters.values() if value != 0.0]
        within = all(1.0 / LARGEST < size < LARGEST for size in sizes)
        return within and self.largest_log(parameters) < math.log(LARGEST)


def _wide(name: str, *, back: bool = False) -> Callable[[Values], tuple[Spread, ...]]:
    """Return facets as wide as a parameter says."""
    return lambda p: (Spread(p[name], p[name], back=back),)


def _of_exponent(per_width2: float, *, back: bool = False) -> Callable[[Values], tuple[Spread, ...]]:
    """Return facets for a power: about Gaussian, of width^2 = 1/(per_width2 exponent) where that is small."""

    def spreads(p: Values) -> tuple[Spread, ...]:
        width = dr.rsqrt(1.0 + per_width2 * p["exponent"])
        return (Spread(width, width, back=back),)

    return spreads


def _of_half_width(p: Values) -> tuple[Spread, ...]:
    width = dr.minimum(dr.tan(p["half_width_rad"]), 1.0)
    return (Spread(width, width),)


def _of_peak_and_flank(p: Values) -> tuple[Spread, ...]:
    """SGD: its peak is alpha wide, its flank sqrt(alpha)."""
    flank = dr.sqrt(p["alpha"])
    return Spread(p["alpha"], p["alpha"]), Spread(flank, flank)


def _of_abc(p: Values) -> tuple[Spread, ...]:
    width = dr.rsqrt(1.0 + 0.5 * p["b"])
    return (Spread(width, width),)


def _of_two_lobes(p: Values) -> tuple[Spread, ...]:
    wide = p["alpha"] * p["widening"]
    return Spread(p["alpha"], p["alpha"]), Spread(wide, wide)


def _of_both_ways(p: Values) -> tuple[Spread, ...]:
    return *_wide("alpha")(p), *_wide("alpha_retro", back=True)(p)


def _of_two_exponents(p: Values) -> tuple[Spread, ...]:
    along, across = (dr.rsqrt(1.0 + 0.5 * p[name]) for name in ("exponent_x", "exponent_y"))
    return (Spread(along, across, p["axis_rad"]),)


def _generalised_cosine(p: Mapping[str, float]) -> float:
    """Lafortune's: the base is at most the larger of 1 and ratio."""
    return p["exponent"] * math.log(max(1.0, p["ratio"]))


def _brushed(along: str, across: str) -> Callable[[Values], tuple[Spread, ...]]:
    return lambda p: (Spread(p[along], p[across], p["axis_rad"]),)


LOBES: dict[str, Lobes] = {
    "abc": Lobes(glossy.abc, _of_abc),
    "ashikhmin-shirley": Lobes(glossy.ashikhmin_shirley, _of_two_exponents, diffuse.below_facets),
    "beckmann": Lobes(glossy.beckmann, _wide("m")),
    "beckmann-anisotropic": Lobes(glossy.beckmann_anisotropic, _brushed("m_x", "m_y")),
    "beckmann-separable": Lobes(glossy.beckmann_separable, _wide("m")),
    "blinn-phong": Lobes(powers.blinn_phong, _of_exponent(0.5)),
    "cook-torrance": Lobes(glossy.cook_torrance, _wide("m")),
    "cook-torrance-1982": Lobes(glossy.cook_torrance_1982, _wide("m")),
    "cook-torrance-conductor": Lobes(glossy.cook_torrance_conductor, _wide("m")),
    "cook-torrance-ggx": Lobes(glossy.cook_torrance_ggx, _wide("alpha")),
    "cook-torrance-schlick": Lobes(glossy.cook_torrance_schlick, _wide("m")),
    "eon": Lobes(diffuse=diffuse.eon),
    "fujii": Lobes(diffuse=diffuse.fujii),
    "ggx": Lobes(glossy.ggx, _wide("alpha")),
    "ggx-anisotropic": Lobes(glossy.ggx_anisotropic, _brushed("alpha_x", "alpha_y")),
    "ggx-conductor": Lobes(glossy.ggx_conductor, _wide("alpha")),
    "ggx-dielectric": Lobes(glossy.ggx_dielectric, _wide("alpha")),
    "ggx-retro": Lobes(glossy.ggx_retro, _of_both_ways),
    "ggx-separable": Lobes(glossy.ggx_separable, _wide("alpha")),
    "ggx-two-lobes": Lobes(glossy.ggx_two_lobes, _of_two_lobes),
    # The mirror direction turns twice as far as a facet.
    "lafortune": Lobes(powers.lafortune, _of_exponent(2.0), largest_log=_generalised_cosine),
    "lafortune-retro": Lobes(
        powers.lafortune_retro, _of_exponent(2.0, back=True), largest_log=_generalised_cosine
    ),
    "lambert": Lobes(),
    "modified-phong": Lobes(powers.modified_phong, _of_exponent(2.0)),
    "oren-nayar": Lobes(diffuse=diffuse.oren_nayar),
    "phong": Lobes(powers.phong, _of_exponent(2.0)),
    "sgd": Lobes(glossy.sgd, _of_peak_and_flank),
    "torrance-sparrow-cosine": Lobes(glossy.torrance_sparrow_cosine, _of_half_width),
    "torrance-sparrow-gauss": Lobes(glossy.torrance_sparrow_gauss, _of_half_width),
    "torrance-sparrow-trowbridge-reitz": Lobes(glossy.torrance_sparrow_trowbridge_reitz, _of_half_width),
    "ward": Lobes(powers.ward, _wide("alpha")),
    "ward-bounded": Lobes(powers.ward_bounded, _wide("alpha")),
    "ward-duer": Lobes(powers.ward_duer, _wide("alpha")),
}
"""By name of the model in `analysis.models`."""
