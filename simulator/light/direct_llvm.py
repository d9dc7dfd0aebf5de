"""Nodes of the direct light through Mitsuba's BSDFs, vectorised: many poses, pixels and nodes in one launch.

No ray is traced: a flat sample in black surroundings needs none. Poses, lens and nodes are data, and the loop
over nodes is in the kernel, so that a kernel is compiled once for a kind of material.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.materials import load_bsdf

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from simulator.light.direct_view import Extents, Lens, View
    from simulator.light.sparse_rules import Rule
    from simulator.materials import Material

Array = NDArray[np.float64]

ROUNDING = 2e-7
"""Relative error (RMS) of one radiance where f_r does not change with direction."""
STEP_RAD = 4e-8
"""Error (RMS) of a direction in single precision."""
NODE_NUMBERS = 6
"""Two coordinates each on lamp, pixel and pupil."""


class MitsubaNodes:
    """Direct light on a flat sample, all nodes at once.

    Parameters
    ----------
    mi : module
        Mitsuba in an LLVM variant, `simulator.bsdfs` registered.
    material : Material
        What is lit.
    extents : Extents
        Of lamp, pixel and pupil.
    sample_radius_mm : float
        Of the disc that is lit.

    Raises
    ------
    BadInput
        Mitsuba refuses the material.
    """

    rounding = ROUNDING
    step_rad = STEP_RAD

    def __init__(self, mi: Any, material: Material, extents: Extents, sample_radius_mm: float) -> None:
        import drjit as dr

        self._mi = mi
        self._extents = extents
        self._bsdf = load_bsdf(mi, material)
        self._radius_mm = self._data(sample_radius_mm)
        self._lenses: dict[int, tuple[Lens, list[Any]]] = {}
        # Numbers as literals would be compiled in: materials of one kind share a kernel.
        parameters = mi.traverse(self._bsdf)
        for name, value in parameters:
            dr.make_opaque(value)
            parameters[name] = value
        parameters.update()

    def radiance(self, views: Sequence[View], lens: Lens, rule: Rule) -> Array:
        """Mean radiance (P, N, 3) of N pixels for P views; see `Float64Nodes.radiance`."""
        import drjit as dr

        index = dr.arange(self._mi.UInt32, len(views) * len(lens))
        pixels = dr.opaque(self._mi.UInt32, len(lens))
        pose = index // pixels
        # One more than there are: a column of one number would be compiled in.
        rows = np.array([view.numbers for view in (*views, views[0])])
        columns = [self._data(column) for column in rows.T]
        view = _View([dr.gather(self._mi.Float, column, pose) for column in columns], self._mi)
        pixel = index - pose * pixels
        place, across, down = (
            self._mi.Point2f(*(dr.gather(self._mi.Float, column, pixel) for column in columns))
            for columns in self._on_device(lens)
        )
        share = self._share(view, place, across, down)
        seen = share > 0.0
        total = self._sum(view, (place, across, down), rule, seen)
        flat = np.asarray(dr.ravel(dr.select(seen, share * total, 0.0)))
        return flat.reshape(len(views), len(lens), 3).astype(np.float64)

    def _data(self, numbers: ArrayLike) -> Any:
        """Return numbers that kernels read as data and do not compile in."""
        import drjit as dr

        data = self._mi.Float(np.atleast_1d(np.asarray(numbers, dtype=np.float32)))
        dr.make_opaque(data)
        return data

    def _on_device(self, lens: Lens) -> list[list[Any]]:
        """Return places, across and down as columns, sent once."""
        if id(lens) not in self._lenses:
            columns = [[self._data(c) for c in part.T] for part in (lens.places, lens.across, lens.down)]
            # The lens is kept too: its id must not come back for another one.
            self._lenses[id(lens)] = (lens, columns)
        return self._lenses[id(lens)][1]

    def _share(self, view: _View, place: Any, across: Any, down: Any) -> Any:
        """Compute `direct_view.sample_share`."""
        import drjit as dr

        point, w = view.meet(place)
        middle = dr.norm(point)
        centre = middle - self._radius_mm
        above = (w > 0.0) & (view.camera.z > 0.0)
        if not self._extents.pixel:
            return dr.select(above & (centre <= 0.0), 1.0, 0.0)
        steps = (0.5 * self._extents.pixel * across, 0.5 * self._extents.pixel * down)
        ends = [[dr.norm(view.meet(place + sign * step)[0]) for sign in (-1.0, 1.0)] for step in steps]
        a, b = (dr.abs(ahead - behind) for behind, ahead in ends)
        centre += sum((behind - middle) + (ahead - middle) for behind, ahead in ends) / 6.0
        half, flat = 0.5 * (a + b), 0.5 * dr.abs(a - b)
        corner = dr.square(half - dr.abs(centre)) / (2.0 * a * b)
        end = dr.select(centre < 0.0, 1.0 - corner, corner)
        share = dr.select(dr.abs(centre) <= flat, 0.5 - centre / dr.maximum(a, b), end)
        share = dr.select(centre <= -half, 1.0, dr.select(centre >= half, 0.0, share))
        return dr.select(above & dr.isfinite(share), share, 0.0)

    def _sum(self, view: _View, pixel: tuple[Any, Any, Any], rule: Rule, seen: Any) -> Any:
        """Sum over the nodes."""
        import drjit as dr

        mi = self._mi
        if rule.plain:
            return self._node(view, pixel[0], [mi.Float(0.0)] * NODE_NUMBERS, seen)
        columns = [self._data(column) for column in (*rule.nodes.T, rule.weights)]
        count = dr.opaque(mi.UInt32, len(rule.weights))

        def add(k: Any, total: Any) -> tuple[Any, Any]:
            *node, weight = (dr.gather(mi.Float, column, k) for column in columns)
            place, across, down = pixel
            offset = [self._extents.pixel * number for number in node[2:4]]
            value = self._node(view, place + offset[0] * across + offset[1] * down, node, seen)
            return k + 1, total + weight * value

        start = mi.UInt32(0), mi.Color3f(0.0)
        return dr.while_loop(start, lambda k, _: k < count, add, labels=("k", "total"))[1]

    def _node(self, view: _View, place: Any, node: list[Any], seen: Any) -> Any:
        """Radiance of the points of pixels towards a point of the pupil, lit by a point of the lamp."""
        import drjit as dr

        mi = self._mi
        met = view.out_of_focus(*view.meet(place), node[4:])
        point = mi.Vector3f(met.x, met.y, 0.0)
        to_light = view.light + node[0] * view.light_disc[0] + node[1] * view.light_disc[1] - point
        light_squared = dr.squared_norm(to_light)
        wi = to_light * dr.rsqrt(light_squared)
        strength = view.strength / light_squared
        if self._extents.lamp_radius_mm > 0.0:
            strength *= -dr.dot(wi, view.facing)
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(met))
        si.t = 1.0
        si.p = point
        si.n = mi.Normal3f(0.0, 0.0, 1.0)
        si.sh_frame = mi.Frame3f(si.n)
        # As on a square around the sample.
        si.uv = mi.Point2f(0.5 * met.x / self._radius_mm + 0.5, 0.5 * met.y / self._radius_mm + 0.5)
        si.wi = dr.normalize(
            view.camera + node[4] * view.pupil_disc[0] + node[5] * view.pupil_disc[1] - point
        )
        lit = seen & (wi.z > 0.0) & (si.wi.z > 0.0)
        # Mitsuba's value holds the cosine of the light's angle.
        return dr.select(lit, self._bsdf.eval(mi.BSDFContext(), si, wi, lit) * strength, 0.0)


class _View:
    """`direct_view.View` of every pixel, in Mitsuba's types."""

    def __init__(self, numbers: list[Any], mi: Any) -> None:
        self._homography = numbers[:9]
        vectors = [mi.Vector3f(*numbers[start : start + 3]) for start in range(9, 30, 3)]
        self.light, *self.light_disc, self.facing, self.camera = vectors[:5]
        self.pupil_disc = vectors[5:]
        self.strength, self._focus = numbers[-2:]
        self._point = mi.Point2f

    def meet(self, place: Any) -> tuple[Any, Any]:
        """Compute `direct_view.meet`, without its z."""
        h = self._homography
        across, up, w = (h[row] * place.x + h[row + 1] * place.y + h[row + 2] for row in (0, 3, 6))
        return self._point(across / w, up / w), w

    def out_of_focus(self, met: Any, w: Any, node: list[Any]) -> Any:
        """Compute `direct_view.out_of_focus`: w is the slope's -z."""
        import drjit as dr

        off = node[0] * self.pupil_disc[0] + node[1] * self.pupil_disc[1]
        depth = self.camera.z / w
        slope = (self._point(met.x, met.y) - self._point(self.camera.x, self.camera.y)) / depth
        beyond = (self._focus - depth) / (-self._focus * w - off.z)
        moved = met + beyond * (-w * self._point(off.x, off.y) - off.z * slope)
        return dr.select(self._focus > 0.0, moved, met)
