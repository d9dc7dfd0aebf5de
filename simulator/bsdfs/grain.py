"""A frame for samples with a grain: the plugin `gonio-grain`.

Mitsuba turns directions into a frame whose first axis follows the shape's parametrisation, and that of its
disk runs outwards from the centre. A flat sample's own axes are the world's.
"""

from __future__ import annotations

from typing import Any

GRAIN = "gonio-grain"


def grain_bsdf(mi: Any) -> type:
    """Make the class for Mitsuba's current variant; its one property, `of`, is a BSDF."""

    class Grain(mi.BSDF):  # type: ignore[misc, name-defined, unused-ignore]
        """A BSDF whose axes are the world's, on a surface that lies in its xy-plane."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.of = props["of"]
            flags = self.of.flags()
            self.m_components, self.m_flags = [flags], flags

        def traverse(self, callback: Any) -> None:
            callback.put("of", self.of, mi.ParamFlags.Differentiable)

        def _in_the_world(self, si: Any) -> Any:
            turned = mi.SurfaceInteraction3f(si)
            turned.wi = si.to_world(si.wi)
            return turned

        def eval(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.of.eval(context, self._in_the_world(si), si.to_world(wo), active)

        def pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.of.pdf(context, self._in_the_world(si), si.to_world(wo), active)

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            value, density = self.of.eval_pdf(context, self._in_the_world(si), si.to_world(wo), active)
            return value, density

        def sample(
            self, context: Any, si: Any, sample1: Any, sample2: Any, active: Any = True
        ) -> tuple[Any, Any]:
            found, weight = self.of.sample(context, self._in_the_world(si), sample1, sample2, active)
            found.wo = si.to_local(found.wo)
            return found, weight

        def to_string(self) -> str:
            return f"Grain[{self.of}]"

    return Grain
