"""One question to every material: its f_r for given pairs of directions, whatever computes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from simulator.materials import MitsubaMaterial, load_bsdf

if TYPE_CHECKING:
    from collections.abc import Callable

    from simulator.materials import Material

Array = NDArray[np.float64]


def closed_form_reflectance(material: Material) -> Callable[[Array, Array], Array]:
    """Return a function (wi (N, 3), wo (N, 3)) -> f_r (N, 3) in float64 of a material that has one.

    Raises
    ------
    BadInput
        It has none: only Mitsuba knows it.
    """
    if isinstance(material, MitsubaMaterial):
        raise BadInput("it has no closed form", where=material.spec, todo="ask Mitsuba")
    return material.reflectance()


def material_reflectance(mi: Any, material: Material) -> Callable[[Array, Array], Array]:
    """Return f_r of any material: its closed form where it has one, otherwise what Mitsuba says.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set and `simulator.bsdfs` registered.
    material : Material
        What to evaluate.

    Raises
    ------
    BadInput
        Mitsuba refuses the material.
    """
    if material.has_closed_form:
        return closed_form_reflectance(material)
    return mitsuba_reflectance(mi, material)


def mitsuba_reflectance(mi: Any, material: Material) -> Callable[[Array, Array], Array]:
    """Return a function (wi (N, 3), wo (N, 3)) -> f_r (N, 3) that asks Mitsuba's BSDF, in single precision.

    In scalar mode every pair is a call of its own, about 3 microseconds each.

    Parameters
    ----------
    mi : module
        Mitsuba, its variant set and `simulator.bsdfs` registered.
    material : Material
        What to evaluate.

    Raises
    ------
    BadInput
        Mitsuba refuses the material.
    """
    bsdf = load_bsdf(mi, material)
    ask = _ask_one_by_one if mi.variant().startswith("scalar") else _ask_at_once

    def evaluate(wi: Array, wo: Array) -> Array:
        visible = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
        values = np.zeros((len(wi), 3))
        # Mitsuba's value holds the cosine of the light's angle.
        if visible.any():
            values[visible] = ask(mi, bsdf, wi[visible], wo[visible]) / wi[visible, 2:]
        return values

    return evaluate


def _ask_at_once(mi: Any, bsdf: Any, wi: Array, wo: Array) -> Array:
    si = _interaction(mi)
    si.wi = mi.Vector3f(wo.T.astype(np.float32))
    value = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wi.T.astype(np.float32)))
    return np.broadcast_to(np.asarray(value, dtype=np.float64).T, (len(wi), 3))


def _ask_one_by_one(mi: Any, bsdf: Any, wi: Array, wo: Array) -> Array:
    si, context = _interaction(mi), mi.BSDFContext()
    values = []
    for light, camera in zip(wi.tolist(), wo.tolist(), strict=True):
        si.wi = mi.Vector3f(camera)
        value = bsdf.eval(context, si, mi.Vector3f(light))
        values.append((value[0], value[1], value[2]))
    return np.array(values, dtype=np.float64)


def _interaction(mi: Any) -> Any:
    """Return a point of a flat surface, whose local frame is the sample's."""
    si = mi.SurfaceInteraction3f()
    si.t = 1.0
    si.n = mi.Normal3f(0.0, 0.0, 1.0)
    si.sh_frame = mi.Frame3f(si.n)
    si.uv = mi.Point2f(0.5, 0.5)
    return si
