"""Lobes of microfacets, at unit scale: a distribution times masking times the facets' reflectance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from simulator.bsdfs import facets
from simulator.bsdfs.fresnel import conductor, dielectric, schlick, shifted_schlick
from simulator.bsdfs.pair import expm1, log1p

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from simulator.bsdfs.pair import Pair

    Values = Mapping[str, Any]


def ggx(pair: Pair, p: Values) -> Any:
    """GGX, Smith's masking with heights correlated, Schlick's F."""
    return facets.ggx_mirrors(pair, p["alpha"]) * schlick(pair, p["f0"])


def ggx_dielectric(pair: Pair, p: Values) -> Any:
    """`ggx` with a dielectric's exact F."""
    return facets.ggx_mirrors(pair, p["alpha"]) * dielectric(pair, p["ior"])


def ggx_conductor(pair: Pair, p: Values) -> Any:
    """`ggx` with a metal's exact F."""
    return facets.ggx_mirrors(pair, p["alpha"]) * conductor(pair, p["eta"], p["k"])


def ggx_separable(pair: Pair, p: Values) -> Any:
    """`ggx` with masking and shadowing independent."""
    masked = facets.separable(pair, facets.smith_ggx, facets.runs(pair, p["alpha"]))
    return 0.25 * facets.ggx(pair, p["alpha"]) * masked * schlick(pair, p["f0"])


def ggx_two_lobes(pair: Pair, p: Values) -> Any:
    """Two widths of `ggx`."""
    narrow = facets.ggx_mirrors(pair, p["alpha"])
    wide = facets.ggx_mirrors(pair, p["alpha"] * p["widening"])
    return ((1.0 - p["share"]) * narrow + p["share"] * wide) * schlick(pair, p["f0"])


def ggx_retro(pair: Pair, p: Values) -> Any:
    """`ggx` and a lobe back to the light."""
    back = facets.ggx_mirrors(pair.retro, p["alpha_retro"])
    return (1.0 - p["share"]) * ggx(pair, p) + p["share"] * back


def ggx_anisotropic(pair: Pair, p: Values) -> Any:
    """`ggx` of two widths."""
    widths, axis = (p["alpha_x"], p["alpha_y"]), p["axis_rad"]
    run2 = facets.runs_of_two_widths(pair, widths, axis)
    density = facets.ggx_of_two_widths(pair, widths, axis)
    return 0.25 * density * facets.correlated(pair, facets.smith_ggx, run2) * schlick(pair, p["f0"])


def beckmann(pair: Pair, p: Values) -> Any:
    """Beckmann's facets, Smith's masking with heights correlated, Schlick's F."""
    return _beckmann(pair, p, facets.correlated)


def beckmann_separable(pair: Pair, p: Values) -> Any:
    """`beckmann` with masking and shadowing independent."""
    return _beckmann(pair, p, facets.separable)


def _beckmann(pair: Pair, p: Values, masking: Callable[..., Any]) -> Any:
    masked = masking(pair, facets.smith_beckmann, facets.runs(pair, p["m"]))
    return 0.25 * facets.beckmann(pair, p["m"]) * masked * schlick(pair, p["f0"])


def beckmann_anisotropic(pair: Pair, p: Values) -> Any:
    """`beckmann` of two widths."""
    widths, axis = (p["m_x"], p["m_y"]), p["axis_rad"]
    run2 = facets.runs_of_two_widths(pair, widths, axis)
    density = facets.beckmann_of_two_widths(pair, widths, axis)
    return 0.25 * density * facets.correlated(pair, facets.smith_beckmann, run2) * schlick(pair, p["f0"])


def cook_torrance_1982(pair: Pair, p: Values) -> Any:
    """Beckmann's facets in V-grooves, exact F, with the published denominator."""
    return facets.beckmann(pair, p["m"]) * facets.grooves(pair) * dielectric(pair, p["ior"])


def cook_torrance(pair: Pair, p: Values) -> Any:
    """`cook_torrance_1982` over four: the denominator of Walter et al. 2007."""
    return 0.25 * cook_torrance_1982(pair, p)


def cook_torrance_schlick(pair: Pair, p: Values) -> Any:
    """`cook_torrance` with Schlick's F."""
    return 0.25 * facets.beckmann(pair, p["m"]) * facets.grooves(pair) * schlick(pair, p["f0"])


def cook_torrance_conductor(pair: Pair, p: Values) -> Any:
    """`cook_torrance` with a metal's exact F."""
    mirrors = 0.25 * facets.beckmann(pair, p["m"]) * facets.grooves(pair)
    return mirrors * conductor(pair, p["eta"], p["k"])


def cook_torrance_ggx(pair: Pair, p: Values) -> Any:
    """`cook_torrance_schlick` with GGX facets."""
    return 0.25 * facets.ggx(pair, p["alpha"]) * facets.grooves(pair) * schlick(pair, p["f0"])


def torrance_sparrow_cosine(pair: Pair, p: Values) -> Any:
    """V-grooves with a power of N.H."""
    power = dr.log(2.0) / log1p(dr.square(dr.tan(p["half_width_rad"])))
    return dr.exp(-power * log1p(pair.tan2_h)) * facets.grooves(pair) * dielectric(pair, p["ior"])


def torrance_sparrow_gauss(pair: Pair, p: Values) -> Any:
    """V-grooves with a Gaussian of the angle of H."""
    tan2 = pair.tan2_h
    # The arc from the smaller of sine and cosine: Dr.Jit's arctangent has one digit less.
    arc = dr.asin(dr.sqrt(dr.minimum(tan2, 1.0) / (1.0 + tan2)))
    angle = dr.select(tan2 < 1.0, arc, 0.5 * dr.pi - arc)
    density = dr.exp(-dr.log(2.0) * dr.square(angle / p["half_width_rad"]))
    return density * facets.grooves(pair) * dielectric(pair, p["ior"])


def torrance_sparrow_trowbridge_reitz(pair: Pair, p: Values) -> Any:
    """V-grooves with the shape of GGX, 1 at its peak."""
    sine2 = dr.square(dr.sin(p["half_width_rad"]))
    c2 = sine2 / ((dr.sqrt(2.0) - 1.0) + sine2)
    density = dr.square(c2 * (1.0 + pair.tan2_h) / (pair.tan2_h + c2))
    return density * facets.grooves(pair) * dielectric(pair, p["ior"])


def ashikhmin_shirley(pair: Pair, p: Values) -> Any:
    """Anisotropic Phong lobe with Schlick's F."""
    n_x, n_y = p["exponent_x"], p["exponent_y"]
    along, across = facets.turned(*pair.tangents, p["axis_rad"])
    # log(N.H) = -log1p(tan^2)/2, and the azimuth's squares are those of the tangents over tan^2.
    tan2 = dr.maximum(pair.tan2_h, 1e-30)
    logarithm = -0.5 * log1p(tan2) / tan2 * (n_x * along * along + n_y * across * across)
    norm = dr.sqrt(n_x + 1.0) * dr.sqrt(n_y + 1.0) / (8.0 * dr.pi)
    return norm * dr.exp(logarithm) / (pair.cos_d * pair.larger_cosine) * schlick(pair, p["f0"])


def abc(pair: Pair, p: Values) -> Any:
    """F G / ((1 + b (1 - N.H))^c pi (N.L)(N.E))."""
    secant = dr.sqrt(1.0 + pair.tan2_h)
    drop = pair.tan2_h / secant / (secant + 1.0)
    density = dr.exp(-p["c"] * log1p(p["b"] * drop))
    return density * facets.grooves(pair) * dielectric(pair, p["ior"]) * dr.inv_pi


def sgd(pair: Pair, p: Values) -> Any:
    """Shifted gamma distribution with its fitted masking."""
    tan2, alpha = pair.tan2_h, p["alpha"]
    peak = dr.exp(-tan2 / alpha - p["p"] * log1p(tan2 / (alpha * alpha)))
    masked = _sgd_masking(pair.cos_i, pair.sin2_i, p) * _sgd_masking(pair.cos_o, pair.sin2_o, p)
    reflected = peak * dr.square(1.0 + tan2) * shifted_schlick(pair, p["f0"], p["f1"])
    return 0.25 * reflected * masked / pair.cos_i / pair.cos_o


def _sgd_masking(cosine: Any, sine2: Any, p: Values) -> Any:
    beyond = dr.maximum(dr.atan2(dr.sqrt(sine2), cosine) - p["theta0_rad"], 1e-30)
    # G is zero long before the exponent reaches 50; the cap keeps what is thrown away finite.
    argument = dr.exp(dr.minimum(dr.log(p["c"]) + p["k"] * dr.log(beyond), dr.log(50.0)))
    return dr.maximum(1.0 - p["lam"] * expm1(argument), 0.0)
