"""The plugin `gonio`: a row of the catalogue as a BSDF of Mitsuba.

Mitsuba asks for f_r times the cosine of the light's angle; `wi` of its interactions points to the camera and
the direction asked for points to the light.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from analysis.models import MODELS
from simulator.bsdfs.catalogue import LARGEST, LOBES
from simulator.bsdfs.pair import Pair
from simulator.bsdfs.sampling import Mixture


def closed_form_bsdf(mi: Any) -> type:  # noqa: C901 - a class, made where its base is known
    """Make the class for Mitsuba's current variant, whose types it uses."""

    class ClosedForm(mi.BSDF):  # type: ignore[misc, name-defined, unused-ignore]
        """f_r = kd diffuse + ks specular, zero where light or camera is not above the horizon."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.model = props["model"]
            self.lobes = LOBES[self.model]
            model = MODELS[self.model]
            self.values = {
                parameter.name: mi.Color3f(*(float(props[f"{parameter.name}_{i}"]) for i in range(3)))
                for parameter in model.PARAMETERS
            }
            self._keep_out_of_the_kernel()
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            if not model.ISOTROPIC:
                flags |= mi.BSDFFlags.Anisotropic
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
            pair = Pair(dr.select(lit, wo, up), dr.select(lit, si.wi, up))
            f = self.values["kd"] * self.lobes.diffuse(pair, self.values)
            if self.lobes.specular is not None:
                # Within 1e-18 of the surface some lobes exceed single precision.
                f += self.values["ks"] * dr.minimum(self.lobes.specular(pair, self.values), LARGEST)
            return dr.select(lit, f * pair.light.z, 0.0)

        def _mixture(self) -> Mixture:
            return Mixture(mi, self.lobes.spreads(self.values))

        def pdf(self, _context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self._mixture().density(si.wi, wo, active)

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

        def sample(
            self, context: Any, si: Any, sample1: Any, sample2: Any, active: Any = True
        ) -> tuple[Any, Any]:
            mixture = self._mixture()
            found = mi.BSDFSample3f()
            found.wo = mixture.sample(si.wi, sample1, sample2)
            found.pdf = mixture.density(si.wi, found.wo, active)
            found.eta = 1.0
            found.sampled_type = mi.UInt32(+self.m_flags)
            found.sampled_component = mi.UInt32(0)
            usable = found.pdf > 0.0
            value = self.eval(context, si, found.wo, active) / dr.select(usable, found.pdf, 1.0)
            return found, dr.select(usable, value, 0.0)

        def to_string(self) -> str:
            return f"ClosedForm[{self.model}, {self.values}]"

    return ClosedForm
