"""The plugin `gonio-placed`: a BSDF on a sample that has axes, a relief, an edge and a pattern.

Mitsuba turns directions into frames that follow a shape's parametrisation: a disk's run outwards from the
centre. A sample has its own axes, wherever it is curved, and what lies on it is seen along its normal. This
is `simulator.light.sample_shapes` a second time, in single precision.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from simulator.bsdfs import MOUNTINGS
from simulator.mounting import Form, PatternKind
from simulator.patterns import read_picture, relief_waves


def placed_bsdf(mi: Any) -> type:  # noqa: C901 - a class, made where its base is known
    """Make the class for Mitsuba's current variant.

    Its properties are `of`, a BSDF; `other`, a second one, where there is a pattern; `mounting`, a key of
    `MOUNTINGS`; and `radius`, of the sample's disc.
    """

    class Placed(mi.BSDF):  # type: ignore[misc, name-defined, unused-ignore]
        """A BSDF in the axes of the sample, black beyond its disc."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.of = props["of"]
            self.other: Any = props["other"] if "other" in props else None  # noqa: SIM401 - no `get` there
            self.mounting = MOUNTINGS[props["mounting"]]
            self.to_scene = mi.Transform4f(self.mounting.to_scene.tolist())
            self.to_sample = self.to_scene.inverse()
            self.radius = props["radius"]
            relief, pattern = self.mounting.relief, self.mounting.pattern
            self.waves = [] if relief is None else relief_waves(relief).tolist()
            self.picture = None
            if pattern is not None and pattern.kind is PatternKind.IMAGE:
                bitmap = mi.Bitmap(read_picture(pattern.file).astype("float32"))
                self.picture = mi.load_dict(
                    {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}
                )
            flags = self.of.flags() if self.other is None else self.of.flags() | self.other.flags()
            self.m_components, self.m_flags = [flags], flags

        def traverse(self, callback: Any) -> None:
            callback.put("of", self.of, mi.ParamFlags.Differentiable)
            if self.other is not None:
                callback.put("other", self.other, mi.ParamFlags.Differentiable)

        def _place(self, si: Any) -> tuple[Any, Any]:
            place = self.to_sample @ mi.Point3f(si.p)
            normal = self._normal(si, place)
            if self.waves:
                along, across = _tangents(mi, normal, 0.0)
                for slope_x, slope_y, wave_x, wave_y, phase in self.waves:
                    size = dr.cos(wave_x * place.x + wave_y * place.y + phase)
                    normal -= size * (slope_x * along + slope_y * across)
                normal = dr.normalize(normal)
            axes = _Axes(self, si, *_tangents(mi, normal, self.mounting.turn_rad), normal)
            return place, axes

        def _normal(self, si: Any, place: Any) -> Any:
            if self.mounting.form is not Form.CYLINDER:
                return dr.normalize(self.to_sample @ mi.Vector3f(si.n))
            # The mesh has facets.
            axis = mi.Vector3f(dr.cos(self.mounting.axis_rad), dr.sin(self.mounting.axis_rad), 0.0)
            out = mi.Vector3f(place.x, place.y, place.z + self.mounting.radius_mm)
            return dr.normalize(out - dr.dot(out, axis) * axis)

        def _inside(self, place: Any) -> Any:
            return dr.square(place.x) + dr.square(place.y) <= dr.square(self.radius)

        def _weight(self, si: Any, place: Any) -> Any:
            """Share of the second material."""
            pattern: Any = self.mounting.pattern
            if self.picture is not None:
                at = mi.SurfaceInteraction3f(si)
                u, v = 0.5 + 0.5 * place.x / self.radius, 0.5 - 0.5 * place.y / self.radius
                at.uv = mi.Point2f(u, v)
                return mi.Color3f(self.picture.eval(at))
            if pattern.kind is PatternKind.CHECKER:
                cell = dr.floor(place.x / pattern.side_mm) + dr.floor(place.y / pattern.side_mm)
                return mi.Color3f(cell - 2.0 * dr.floor(0.5 * cell))
            along = place.x * dr.cos(pattern.along_rad) + place.y * dr.sin(pattern.along_rad)
            return mi.Color3f(dr.clip(0.5 + 0.5 * along / self.radius, 0.0, 1.0))

        def eval(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            place, axes = self._place(si)
            lit = active & (si.wi.z > 0.0) & (wo.z > 0.0) & self._inside(place)
            turned, light = axes.turned(si), axes.inward(wo)
            value = self.of.eval(context, turned, light, lit)
            if self.other is not None:
                value += self._weight(si, place) * (self.other.eval(context, turned, light, lit) - value)
            return dr.select(lit, value, 0.0)

        def pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            place, axes = self._place(si)
            turned, light = axes.turned(si), axes.inward(wo)
            density = self.of.pdf(context, turned, light, active)
            if self.other is not None:
                share = dr.mean(self._weight(si, place))
                density += share * (self.other.pdf(context, turned, light, active) - density)
            return dr.select(active & (wo.z > 0.0), density, 0.0)

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

        def sample(
            self, context: Any, si: Any, sample1: Any, sample2: Any, active: Any = True
        ) -> tuple[Any, Any]:
            place, axes = self._place(si)
            turned = axes.turned(si)
            if self.other is None:
                found, weight = self.of.sample(context, turned, sample1, sample2, active)
            else:
                found, weight = self._sample_both(
                    context, turned, self._weight(si, place), (sample1, sample2), active
                )
            found.wo = axes.outward(found.wo)
            usable = active & (si.wi.z > 0.0) & (found.wo.z > 0.0) & self._inside(place)
            return found, dr.select(usable, weight, 0.0)

        def _sample_both(
            self, context: Any, turned: Any, weight: Any, samples: tuple[Any, Any], active: Any
        ) -> tuple[Any, Any]:
            """Draw from one of the two, by their shares."""
            sample1, sample2 = samples
            share = dr.mean(weight)
            second = sample1 < share
            least = 1e-6
            again = dr.select(
                second,
                sample1 / dr.maximum(share, least),
                (sample1 - share) / dr.maximum(1.0 - share, least),
            )
            own, own_value = self.of.sample(context, turned, again, sample2, active)
            other, other_value = self.other.sample(context, turned, again, sample2, active)
            found = dr.select(second, other, own)
            mirror = mi.has_flag(found.sampled_type, mi.BSDFFlags.Delta)
            own_pdf, other_pdf = (b.pdf(context, turned, found.wo, active) for b in (self.of, self.other))
            density = own_pdf + share * (other_pdf - own_pdf)
            own_f, other_f = (b.eval(context, turned, found.wo, active) for b in (self.of, self.other))
            value = (own_f + weight * (other_f - own_f)) / dr.select(density > 0.0, density, 1.0)
            # A mirror is drawn with the probability of its part, and carries its part.
            part = dr.select(second, share, 1.0 - share)
            mirrored = dr.select(second, weight * other_value, (1.0 - weight) * own_value)
            mirrored /= dr.maximum(part, least)
            found.pdf = dr.select(mirror, found.pdf * part, density)
            return found, dr.select(mirror, mirrored, dr.select(density > 0.0, value, 0.0))

        def to_string(self) -> str:
            return f"Placed[{self.of}, {self.mounting}]"

    class _Axes:
        """Between Mitsuba's frame at a point and the material's."""

        def __init__(self, placed: Any, si: Any, along: Any, across: Any, normal: Any) -> None:
            self._placed, self._si = placed, si
            self._rows = along, across, normal

        def inward(self, direction: Any) -> Any:
            own = self._placed.to_sample @ mi.Vector3f(self._si.to_world(direction))
            return dr.normalize(mi.Vector3f(*(dr.dot(row, own) for row in self._rows)))

        def outward(self, direction: Any) -> Any:
            along, across, normal = self._rows
            own = along * direction.x + across * direction.y + normal * direction.z
            return self._si.to_local(self._placed.to_scene @ mi.Vector3f(own))

        def turned(self, si: Any) -> Any:
            turned = mi.SurfaceInteraction3f(si)
            turned.wi = self.inward(si.wi)
            return turned

    return Placed


def _tangents(mi: Any, normal: Any, turn_rad: float) -> tuple[Any, Any]:
    axis = mi.Vector3f(dr.cos(turn_rad), dr.sin(turn_rad), 0.0)
    along = dr.normalize(axis - dr.dot(axis, normal) * normal)
    return along, dr.cross(normal, along)
