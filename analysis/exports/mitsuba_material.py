"""A fitted model for Mitsuba 3: its own plugin where the formula is the same, else a `measured` table of it.

Lambert is Mitsuba's `diffuse`. Its rough plugins are other formulas than any fitted here (masking by a
rational approximation and not height-correlated, a diffuse part that knows the interface), so all other
models are evaluated onto a tensor file that lies beside the description; anisotropic ones for lights at
azimuths of half a turn, as they look the same from the other side.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from analysis.appearance import sphere_delta_e
from analysis.exports.colours import to_linear_srgb
from analysis.exports.exported import Exported, compared_directions, relative
from analysis.formats.rgl_resample import SIDES, table_of
from analysis.formats.rgl_table import Table
from analysis.formats.tensor import write_tensors

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from analysis.exports.exported import Reflects

Array = NDArray[np.float64]

NEAR_ENOUGH = 0.01
"""95th percentile of the relative error up to which a table need not be finer, and larger."""


GRAINED_SIDES = SIDES[:2]
"""Sizes of a table with azimuths of the light: 69 and 154 MB."""


def write(
    model: Reflects, path: Path, name: str, channels: Sequence[str], *, isotropic: bool = True
) -> Exported:
    """Write a model; see `analysis.exports.export`."""
    matrix = to_linear_srgb(channels)

    def in_srgb(wi: Array, wo: Array) -> Array:
        f_r = model.evaluate(wi, wo)
        return np.asarray(np.broadcast_to(f_r, (*f_r.shape[:-1], len(matrix))) @ matrix)

    up = np.array([[0.0, 0.0, 1.0]])
    diffuse = np.pi * in_srgb(up, up)[0]
    if name == "lambert" and (diffuse >= 0.0).all() and (diffuse <= 1.0).all():
        _describe(path, {"type": "diffuse", "reflectance": {"type": "rgb", "value": diffuse.tolist()}})
        return Exported("Mitsuba's diffuse, the same formula", (path.name,), 0.0, 0.0, 0.0)
    beside = path.with_suffix(".bsdf")
    wi, wo = compared_directions(isotropic=isotropic)
    true = in_srgb(wi, wo)
    for side in SIDES if isotropic else GRAINED_SIDES:
        tensors = table_of(in_srgb, name, side=side, isotropic=isotropic)
        from_table = _reader(Table(tensors, str(beside)))
        median, p95 = relative(from_table(wi, wo), true)
        if p95 <= NEAR_ENOUGH:
            break
    write_tensors(beside, tensors)
    _describe(path, {"type": "measured", "filename": beside.name})
    delta_e = sphere_delta_e(in_srgb, from_table)["delta_e_mean"]
    return Exported(
        "Mitsuba's measured, a table of the formula", (path.name, beside.name), median, p95, delta_e
    )


def _reader(table: Table) -> Callable[[Array, Array], Array]:
    """Give f_r of a table, without the cosine that it holds."""

    def f_r(wi: Array, wo: Array) -> Array:
        return table.evaluate(wi, wo) / np.where(wo[:, 2:] > 0.0, wo[:, 2:], 1.0)

    return f_r


def _describe(path: Path, bsdf: dict[str, Any]) -> None:
    """Write the description as a dictionary for `load_dict`, or as XML."""
    if path.suffix.lower() == ".json":
        path.write_text(json.dumps(bsdf, indent=2), encoding="utf-8")
        return
    root = ET.Element("bsdf", version="3.0.0", type=bsdf["type"], id="gonio")
    if "filename" in bsdf:
        ET.SubElement(root, "string", name="filename", value=bsdf["filename"])
    else:
        value = " ".join(f"{part:.9g}" for part in bsdf["reflectance"]["value"])
        ET.SubElement(root, "rgb", name="reflectance", value=value)
    ET.indent(root)
    path.write_text(ET.tostring(root, encoding="unicode") + "\n", encoding="utf-8")
