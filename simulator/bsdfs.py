"""The models of `analysis.models` as BSDFs of Mitsuba, written a second time in Dr.Jit's single precision.

Formulas and sources are those of `analysis.models`; so is the care against cancellation, which counts for
more in single precision. Mitsuba asks for f_r times the cosine of the light's angle; `wi` of its interactions
points to the camera and the direction asked for points to the light.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

PLUGIN = "gonio"

_registered: set[str] = set()


def register(mi: Any) -> None:
    """Make the plugin `gonio` known to Mitsuba's current variant; again does nothing.

    Its properties are `model` and, for each parameter and channel, `<parameter>_<channel>`.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set.
    """
    variant = mi.variant()
    if variant not in _registered:
        bsdf = _closed_form_bsdf(mi)
        mi.register_bsdf(PLUGIN, bsdf)
        _registered.add(variant)


def _log1p(dr: Any, x: Any) -> Any:
    """log(1 + x) without loss for small x (Kahan; Goldberg 1991, theorem 4): Dr.Jit has none."""
    u = 1.0 + x
    return dr.select(u == 1.0, x, dr.log(u) * x / dr.select(u == 1.0, 1.0, u - 1.0))


def _mirror_power(dr: Any, light: Any, camera: Any, exponent: Any) -> Any:
    """(R.E)^exponent, from |R - E|^2 = 2 - 2 R.E: near the peak R.E itself has no digits left."""
    x, y, z = camera.x + light.x, camera.y + light.y, camera.z - light.z
    missing = 0.5 * (x * x + y * y + z * z)
    lit = missing < 1.0
    return dr.select(lit, dr.exp(exponent * _log1p(dr, dr.select(lit, -missing, 0.0))), 0.0)


def _phong(dr: Any, light: Any, camera: Any, p: dict[str, Any]) -> Any:
    return _mirror_power(dr, light, camera, p["exponent"]) / light.z


def _modified_phong(dr: Any, light: Any, camera: Any, p: dict[str, Any]) -> Any:
    return _mirror_power(dr, light, camera, p["exponent"]) * (p["exponent"] + 2.0) / (2.0 * dr.pi)


def _tan2_half(light: Any, camera: Any) -> Any:
    x, y, z = light.x + camera.x, light.y + camera.y, light.z + camera.z
    return (x * x + y * y) / (z * z)


def _blinn_phong(dr: Any, light: Any, camera: Any, p: dict[str, Any]) -> Any:
    n = p["exponent"]
    factor = (n + 2.0) * (n + 4.0) / (8.0 * dr.pi * (dr.exp2(-0.5 * n) + n))
    return factor * dr.exp(-0.5 * n * _log1p(dr, _tan2_half(light, camera)))


def _fresnel(dr: Any, c: Any, n: Any) -> Any:
    contrast = (n - 1.0) * (n + 1.0)
    g = dr.sqrt(contrast + c * c)
    s, p = g + c, n * n * c + g
    r_s = contrast / (s * s)
    r_p = contrast * ((n * n + 1.0) * c * c - 1.0) / (p * p)
    return 0.5 * (r_s * r_s + r_p * r_p)


def _cook_torrance(dr: Any, light: Any, camera: Any, p: dict[str, Any]) -> Any:
    return 0.25 * _cook_torrance_1982(dr, light, camera, p)


def _cook_torrance_1982(dr: Any, light: Any, camera: Any, p: dict[str, Any]) -> Any:
    m2 = p["m"] * p["m"]
    tan2 = _tan2_half(light, camera)
    density = dr.exp(-tan2 / m2) * dr.square(1.0 + tan2) / (dr.pi * m2)
    half = light + camera
    length = dr.norm(half)
    grooved = 4.0 * (half.z / length) / (length * dr.select(light.z > camera.z, light.z, camera.z))
    unshadowed = 1.0 / (light.z * camera.z)
    visibility = dr.select(grooved < unshadowed, grooved, unshadowed)
    return density * visibility * _fresnel(dr, 0.5 * length, p["ior"])


LOBES: dict[str, tuple[tuple[str, ...], Callable[..., Any]]] = {
    "phong": (("kd", "ks", "exponent"), _phong),
    "modified-phong": (("kd", "ks", "exponent"), _modified_phong),
    "blinn-phong": (("kd", "ks", "exponent"), _blinn_phong),
    "cook-torrance": (("kd", "ks", "m", "ior"), _cook_torrance),
    "cook-torrance-1982": (("kd", "ks", "m", "ior"), _cook_torrance_1982),
}
"""Parameters and lobe of each model that Mitsuba does not have; `lambert` is its `diffuse`."""


def _closed_form_bsdf(mi: Any) -> type:
    """Make the class for the current variant, whose types it uses."""
    import drjit as dr

    class ClosedForm(mi.BSDF):  # type: ignore[misc, name-defined, unused-ignore]
        """f_r = kd/pi + ks lobe, zero where light or camera is not above the horizon."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.model = props["model"]
            self.names, self.lobe = LOBES[self.model]
            self.values = {
                name: mi.Color3f(*(float(props[f"{name}_{channel}"]) for channel in range(3)))
                for name in self.names
            }
            self._keep_out_of_the_kernel()
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components, self.m_flags = [flags], flags

        def _keep_out_of_the_kernel(self) -> None:
            """Pass parameters to kernels as data: as literals each value would be compiled anew."""
            for value in self.values.values():
                dr.make_opaque(value)

        def traverse(self, callback: Any) -> None:
            for name, value in self.values.items():
                callback.put(name, value, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:  # noqa: ARG002 - Mitsuba's interface
            self._keep_out_of_the_kernel()

        def eval(self, _context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            lit = (si.wi.z > 0.0) & (wo.z > 0.0) & active
            up = mi.Vector3f(0.0, 0.0, 1.0)
            light, camera = dr.select(lit, wo, up), dr.select(lit, si.wi, up)
            lobe = self.lobe(dr, light, camera, self.values)
            f = self.values["kd"] * dr.inv_pi + self.values["ks"] * lobe
            return dr.select(lit, f * light.z, 0.0)

        def pdf(self, _context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            density = mi.warp.square_to_cosine_hemisphere_pdf(wo)
            return dr.select((si.wi.z > 0.0) & (wo.z > 0.0) & active, density, 0.0)

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

        def sample(
            self, context: Any, si: Any, _sample1: Any, sample2: Any, active: Any = True
        ) -> tuple[Any, Any]:
            # The lamp is sampled directly; what is left for this are smooth, dim surroundings.
            found = mi.BSDFSample3f()
            found.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            found.pdf = self.pdf(context, si, found.wo, active)
            found.eta = 1.0
            found.sampled_type = mi.UInt32(+self.m_flags)
            found.sampled_component = mi.UInt32(0)
            usable = found.pdf > 0.0
            value = self.eval(context, si, found.wo, active) / dr.select(usable, found.pdf, 1.0)
            return found, dr.select(usable, value, 0.0)

        def to_string(self) -> str:
            return f"ClosedForm[{self.model}, {self.values}]"

    return ClosedForm
