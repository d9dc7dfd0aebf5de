"""The models' formulas a second time, as their sources print them, in as many digits as mpmath is told.

Nothing here is rearranged against cancellation: digits make up for that. `benchmarks.models_digits` and the
tests compare the models with these.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import mpmath as mp

if TYPE_CHECKING:
    from collections.abc import Callable

    Formula = Callable[[SimpleNamespace, SimpleNamespace], Any]

DIGITS = 50


def geometry(wi: Any, wo: Any) -> SimpleNamespace:
    """Return angles of one pair of directions, each direction normalised first.

    Parameters
    ----------
    wi, wo : array_like, shape (3,)
        Directions to light and camera, unit as far as doubles can be.
    """
    light, eye = _unit([mp.mpf(float(x)) for x in wi]), _unit([mp.mpf(float(x)) for x in wo])
    total = [a + b for a, b in zip(light, eye, strict=True)]
    half = _unit(total)
    return SimpleNamespace(
        light=light,
        eye=eye,
        half=half,
        cos_i=light[2],
        cos_o=eye[2],
        cos_h=half[2],
        cos_d=mp.mpf(1) if light == eye else _dot(eye, half),  # where f is 0, not the last digit's rounding
        cos_mirror=_dot([-light[0], -light[1], light[2]], eye),
        sideways=light[0] * eye[0] + light[1] * eye[1],
        sum_length=mp.sqrt(_dot(total, total)),
    )


def _dot(a: list[Any], b: list[Any]) -> Any:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _unit(vector: list[Any]) -> list[Any]:
    length = mp.sqrt(_dot(vector, vector))
    return [x / length for x in vector]


def _tan2(cosine: Any) -> Any:
    return 1 / cosine**2 - 1


def _over_lambert(lobe: Formula) -> Formula:
    return lambda g, p: p.kd / mp.pi + p.ks * lobe(g, p)


# Reflectance


def _schlick(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Schlick 1994, equation 15."""
    return p.f0 + (1 - p.f0) * (1 - g.cos_d) ** 5


def _dielectric(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Cook & Torrance 1982, the second of the lecture's forms."""
    c, root = g.cos_d, mp.sqrt(p.ior**2 + g.cos_d**2 - 1)
    ratio = (c * (root + c) - 1) / (c * (root - c) + 1)
    return ((root - c) / (root + c)) ** 2 / 2 * (1 + ratio**2)


def _conductor(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Fresnel's amplitudes of a boundary to a complex index."""
    index = mp.mpc(p.eta, p.k)
    root = mp.sqrt(index * index - 1 + g.cos_d**2)
    senkrecht = (g.cos_d - root) / (g.cos_d + root)
    parallel = (index**2 * g.cos_d - root) / (index**2 * g.cos_d + root)
    return (abs(senkrecht) ** 2 + abs(parallel) ** 2) / 2


# Distributions and masking


def _ggx(g: SimpleNamespace, width: Any) -> Any:
    """Walter et al. 2007, equation 33."""
    return width**2 / (mp.pi * g.cos_h**4 * (width**2 + _tan2(g.cos_h)) ** 2)


def _beckmann(g: SimpleNamespace, width: Any) -> Any:
    """Walter et al. 2007, equation 25."""
    return mp.exp(-_tan2(g.cos_h) / width**2) / (mp.pi * width**2 * g.cos_h**4)


def _lambda_ggx(run: Any) -> Any:
    """Heitz 2014, equation 72, of 1/a."""
    return (mp.sqrt(1 + run**2) - 1) / 2


def _lambda_beckmann(run: Any) -> Any:
    """Heitz 2014, equation 66, of 1/a."""
    if run == 0:
        return mp.mpf(0)
    return (mp.exp(-1 / run**2) * run / mp.sqrt(mp.pi) - mp.erfc(1 / run)) / 2


LAMBDA = {_ggx: _lambda_ggx, _beckmann: _lambda_beckmann}


def _grooves(g: SimpleNamespace) -> Any:
    """V-groove masking: Torrance & Sparrow 1967, Blinn 1977."""
    return min(mp.mpf(1), 2 * g.cos_h * g.cos_o / g.cos_d, 2 * g.cos_h * g.cos_i / g.cos_d)


def _smith(g: SimpleNamespace, density: Any, width: Any, *, separable: bool = False) -> Any:
    """Heitz 2014, equations 98 (separable) and 99 (heights correlated)."""
    one, two = (LAMBDA[density](width * mp.sqrt(_tan2(cosine))) for cosine in (g.cos_i, g.cos_o))
    return 1 / ((1 + one) * (1 + two)) if separable else 1 / (1 + one + two)


def _microfacet(density: Any, masking: str, reflectance: Formula, width: str) -> Formula:
    """Walter et al. 2007, equation 20."""

    def lobe(g: SimpleNamespace, p: SimpleNamespace) -> Any:
        w = getattr(p, width)
        shade = (
            _grooves(g) if masking == "grooves" else _smith(g, density, w, separable=masking == "separable")
        )
        return density(g, w) * shade * reflectance(g, p) / (4 * g.cos_i * g.cos_o)

    return lobe


def _cook_torrance_1982(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Cook & Torrance 1982, as the lecture has it."""
    density = mp.exp(-_tan2(g.cos_h) / p.m**2) / (p.m**2 * g.cos_h**4)
    return density * _grooves(g) * _dielectric(g, p) / (mp.pi * g.cos_i * g.cos_o)


def _two_lobes(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    narrow, wide = (
        _ggx(g, alpha) * _smith(g, _ggx, alpha) / (4 * g.cos_i * g.cos_o)
        for alpha in (p.alpha, p.alpha * p.widening)
    )
    return ((1 - p.share) * narrow + p.share * wide) * _schlick(g, p)


def _with_retro(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """GGX, and GGX about the back vector (Belcour, Barla & Pacanowski 2014)."""
    back = _unit([g.light[0] - g.eye[0], g.light[1] - g.eye[1], g.light[2] + g.eye[2]])
    mirrored = SimpleNamespace(**{**vars(g), "cos_h": back[2]})
    forth = _ggx(g, p.alpha) * _smith(g, _ggx, p.alpha) * _schlick(g, p)
    retro = _ggx(mirrored, p.alpha_retro) * _smith(g, _ggx, p.alpha_retro)
    return ((1 - p.share) * forth + p.share * retro) / (4 * g.cos_i * g.cos_o)


def turned(vector: list[Any], axis: Any) -> tuple[Any, Any]:
    """Components along and across an axis in the surface."""
    c, s = mp.cos(axis), mp.sin(axis)
    return c * vector[0] + s * vector[1], c * vector[1] - s * vector[0]


def _anisotropic(density: Any, first: str, second: str) -> Formula:
    """Heitz 2014, section 5.3, heights correlated."""

    def lobe(g: SimpleNamespace, p: SimpleNamespace) -> Any:
        widths = getattr(p, first), getattr(p, second)
        slopes = (x / g.cos_h for x in turned(g.half, p.axis_rad))
        steep = sum((slope / width) ** 2 for slope, width in zip(slopes, widths, strict=True))
        peak = 1 / (mp.pi * widths[0] * widths[1] * g.cos_h**4)
        facets = peak / (1 + steep) ** 2 if density is _ggx else peak * mp.exp(-steep)
        shade = mp.mpf(1)
        for v in (g.light, g.eye):
            along, across = turned(v, p.axis_rad)
            run = mp.sqrt((widths[0] * along) ** 2 + (widths[1] * across) ** 2) / v[2]
            shade += LAMBDA[density](run)
        return _schlick(g, p) * facets / shade / (4 * g.cos_i * g.cos_o)

    return lobe


# Peak-normalised distributions


def _torrance_sparrow(distribution: Callable[[Any, Any], Any]) -> Formula:
    def lobe(g: SimpleNamespace, p: SimpleNamespace) -> Any:
        return distribution(g.cos_h, p.half_width_rad) * _grooves(g) * _dielectric(g, p) / (g.cos_i * g.cos_o)

    return lobe


def _cosine_power(cos_h: Any, beta: Any) -> Any:
    """Blinn 1977, D1."""
    return cos_h ** (-mp.log(2) / mp.log(mp.cos(beta)))


def _gauss(cos_h: Any, beta: Any) -> Any:
    """Blinn 1977, D2."""
    return mp.exp(-((mp.acos(min(cos_h, mp.mpf(1))) * mp.sqrt(mp.log(2)) / beta) ** 2))


def _trowbridge_reitz(cos_h: Any, beta: Any) -> Any:
    """Blinn 1977, D3."""
    c2 = (mp.cos(beta) ** 2 - 1) / (mp.cos(beta) ** 2 - mp.sqrt(2))
    return (c2 / (cos_h**2 * (c2 - 1) + 1)) ** 2


def _abc(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Löw et al. 2012, microfacet form."""
    density = 1 / (1 + p.b * (1 - g.cos_h)) ** p.c
    return _dielectric(g, p) * _grooves(g) * density / (mp.pi * g.cos_i * g.cos_o)


def sgd_masking(cosine: Any, p: SimpleNamespace) -> Any:
    """Bagher, Soler & Holzschuch 2012: the masking of one direction."""
    beyond = max(mp.acos(min(cosine, mp.mpf(1))) - p.theta0_rad, mp.mpf(0))
    return max(mp.mpf(0), 1 + p.lam * (1 - mp.exp(p.c * beyond**p.k)))


def sgd_reflectance(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Bagher, Soler & Holzschuch 2012: the reflectance of facets."""
    return p.f0 - g.cos_d * p.f1 + (1 - p.f0) * (1 - g.cos_d) ** 5


def _sgd(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Bagher, Soler & Holzschuch 2012, D without its norm and 1 at its peak."""
    tan2 = _tan2(g.cos_h)
    density = mp.exp(-(p.alpha**2 + tan2) / p.alpha) / (p.alpha**2 + tan2) ** p.p / g.cos_h**4
    peak = mp.exp(-p.alpha) / p.alpha ** (2 * p.p)
    masked = sgd_masking(g.cos_i, p) * sgd_masking(g.cos_o, p)
    return sgd_reflectance(g, p) * density / peak * masked / (4 * g.cos_i * g.cos_o)


# Lobes without facets


def _phong(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """As the lecture has it, over N.L."""
    return max(g.cos_mirror, mp.mpf(0)) ** p.exponent / g.cos_i


def _modified_phong(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Lafortune & Willems 1994, equation 3."""
    return (p.exponent + 2) / (2 * mp.pi) * max(g.cos_mirror, mp.mpf(0)) ** p.exponent


def _blinn_phong(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Blinn 1977, with the norm of Giesen 2009."""
    n = p.exponent
    return (n + 2) * (n + 4) / (8 * mp.pi * (mp.power(2, -n / 2) + n)) * g.cos_h**n


def lafortune_base(g: SimpleNamespace, p: SimpleNamespace, sign: int) -> Any:
    """Lafortune et al. 1997, equation 9, before the exponent."""
    return sign * g.sideways + p.ratio * g.cos_i * g.cos_o


def _lafortune(sign: int) -> Formula:
    return lambda g, p: max(lafortune_base(g, p, sign), mp.mpf(0)) ** p.exponent


def _ward(denominator: Callable[[SimpleNamespace], Any]) -> Formula:
    """Ward 1992, equation 4, over a denominator."""

    def lobe(g: SimpleNamespace, p: SimpleNamespace) -> Any:
        return mp.exp(-_tan2(g.cos_h) / p.alpha**2) / (mp.pi * p.alpha**2 * denominator(g))

    return lobe


def _ashikhmin_shirley(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Ashikhmin & Shirley 2000, equations 4 and 5."""
    along, across = turned(g.half, p.axis_rad)
    square = along**2 + across**2
    power = (p.exponent_x * along**2 + p.exponent_y * across**2) / square if square else mp.mpf(0)
    lobe = mp.sqrt((p.exponent_x + 1) * (p.exponent_y + 1)) / (8 * mp.pi) * g.cos_h**power
    lobe *= _schlick(g, p) / (g.cos_d * max(g.cos_i, g.cos_o))
    below = 28 / (23 * mp.pi) * (1 - p.f0) * (1 - (1 - g.cos_i / 2) ** 5) * (1 - (1 - g.cos_o / 2) ** 5)
    return p.kd * below + p.ks * lobe


# Diffuse


def _oren_nayar(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Oren & Nayar 1994, equation 30, by angles."""
    square = p.sigma_rad**2
    level = 1 - square / (square + mp.mpf("0.33")) / 2
    rise = mp.mpf("0.45") * square / (square + mp.mpf("0.09"))
    theta_i, theta_o = (mp.acos(min(c, mp.mpf(1))) for c in (g.cos_i, g.cos_o))
    sines = mp.sin(theta_i) * mp.sin(theta_o)
    cos_phi = g.sideways / sines if sines > 0 else mp.mpf(0)
    larger, smaller = max(theta_i, theta_o), min(theta_i, theta_o)
    return p.kd / mp.pi * (level + rise * max(mp.mpf(0), cos_phi) * mp.sin(larger) * mp.tan(smaller))


def _fujii(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Fujii 2012 in the notation of Portsmouth, Kutz & Hill 2025."""
    ratio = g.sideways / max(g.cos_i, g.cos_o) if g.sideways > 0 else g.sideways
    level = 1 / (1 + (mp.mpf(1) / 2 - 2 / (3 * mp.pi)) * p.roughness)
    return p.kd / mp.pi * level * (1 + p.roughness * ratio)


def _fujii_albedo(cosine: Any, roughness: Any) -> Any:
    """Portsmouth, Kutz & Hill 2025, listing 1: E of `_fujii` at kd = 1."""
    level = 1 / (1 + (mp.mpf(1) / 2 - 2 / (3 * mp.pi)) * roughness)
    theta = mp.acos(min(cosine, mp.mpf(1)))
    sine = mp.sin(theta)
    rise = sine * (theta - sine * cosine) + mp.mpf(2) / 3 * (sine / cosine * (1 - sine**3) - sine)
    return level + roughness * level / mp.pi * rise


def _eon(g: SimpleNamespace, p: SimpleNamespace) -> Any:
    """Portsmouth, Kutz & Hill 2025, listing 1, with one of the two kd of the second term a shape."""
    level = 1 / (1 + (mp.mpf(1) / 2 - 2 / (3 * mp.pi)) * p.roughness)
    mean = level * (1 + (mp.mpf(2) / 3 - 28 / (15 * mp.pi)) * p.roughness)
    if mean == 1:
        return _fujii(g, p)
    returned = p.facet_albedo * mean / (1 - p.facet_albedo * (1 - mean))
    lost = (1 - _fujii_albedo(g.cos_i, p.roughness)) * (1 - _fujii_albedo(g.cos_o, p.roughness))
    return _fujii(g, p) + p.kd / mp.pi * returned * lost / (1 - mean)


LOBES: dict[str, Formula] = {
    "phong": _phong,
    "modified-phong": _modified_phong,
    "blinn-phong": _blinn_phong,
    "lafortune": _lafortune(-1),
    "lafortune-retro": _lafortune(1),
    "ward": _ward(lambda g: 4 * mp.sqrt(g.cos_i * g.cos_o)),
    "ward-duer": _ward(lambda g: 4 * g.cos_i * g.cos_o),
    "ward-bounded": _ward(lambda g: (g.cos_i + g.cos_o) ** 4 / g.sum_length**2),
    "torrance-sparrow-cosine": _torrance_sparrow(_cosine_power),
    "torrance-sparrow-gauss": _torrance_sparrow(_gauss),
    "torrance-sparrow-trowbridge-reitz": _torrance_sparrow(_trowbridge_reitz),
    "cook-torrance-1982": _cook_torrance_1982,
    "cook-torrance": _microfacet(_beckmann, "grooves", _dielectric, "m"),
    "cook-torrance-schlick": _microfacet(_beckmann, "grooves", _schlick, "m"),
    "cook-torrance-conductor": _microfacet(_beckmann, "grooves", _conductor, "m"),
    "cook-torrance-ggx": _microfacet(_ggx, "grooves", _schlick, "alpha"),
    "beckmann": _microfacet(_beckmann, "correlated", _schlick, "m"),
    "beckmann-separable": _microfacet(_beckmann, "separable", _schlick, "m"),
    "ggx": _microfacet(_ggx, "correlated", _schlick, "alpha"),
    "ggx-separable": _microfacet(_ggx, "separable", _schlick, "alpha"),
    "ggx-dielectric": _microfacet(_ggx, "correlated", _dielectric, "alpha"),
    "ggx-conductor": _microfacet(_ggx, "correlated", _conductor, "alpha"),
    "ggx-two-lobes": _two_lobes,
    "ggx-retro": _with_retro,
    "ggx-anisotropic": _anisotropic(_ggx, "alpha_x", "alpha_y"),
    "beckmann-anisotropic": _anisotropic(_beckmann, "m_x", "m_y"),
    "abc": _abc,
    "sgd": _sgd,
}
"""Lobes at unit scale, over Lambert's term."""

FORMULAS: dict[str, Formula] = {
    **{name: _over_lambert(lobe) for name, lobe in LOBES.items()},
    "lambert": lambda g, p: p.kd / mp.pi,  # noqa: ARG005 - the same in all directions
    "oren-nayar": _oren_nayar,
    "fujii": _fujii,
    "eon": _eon,
    "ashikhmin-shirley": _ashikhmin_shirley,
}
"""f_r of every model: of `geometry` and of the parameters by name, as mpmath's numbers."""
