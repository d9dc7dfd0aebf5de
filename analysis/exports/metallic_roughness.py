"""The nearest metallic-roughness material, as glTF 2.0 or MaterialX.

Khronos, glTF 2.0 specification, appendix B.3: with alpha = roughness^2, F = f0 + (1 - f0) (1 - V.H)^5,

    f = (1 - F) c_diff / pi + F D V,   c_diff = (1 - metallic) colour,   f0 = 0.04 + metallic (colour - 0.04)

D is that of GGX, V its height-correlated masking over 4 (N.L)(N.V).
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from analysis.appearance import sphere_delta_e
from analysis.exports.colours import to_linear_srgb
from analysis.exports.exported import Exported, compared_directions, relative
from analysis.models.ggx import GGX

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from analysis.exports.exported import Reflects

Array = NDArray[np.float64]

DIELECTRIC_F0 = 0.04
STARTS = [(metallic, roughness) for metallic in (0.05, 0.5, 0.95) for roughness in (0.2, 0.4, 0.7)]
SMALLEST_ROUGHNESS = 0.02


@dataclass(frozen=True)
class MetallicRoughness:
    """A material of glTF; colours are linear sRGB."""

    base_color: tuple[float, float, float]
    metallic: float
    roughness: float

    def evaluate(self, wi: Array, wo: Array) -> Array:
        """Evaluate f_r, shape (N, 3), in 1/sr; arguments as in `Model.evaluate`."""
        color = np.array(self.base_color)
        f0 = DIELECTRIC_F0 + self.metallic * (color - DIELECTRIC_F0)
        white = GGX(kd=0.0, ks=1.0, alpha=self.roughness**2, f0=1.0).evaluate(wi, wo)
        half = wi + wo
        # Opposite directions have no half vector; nothing is lit there either.
        length = np.maximum(np.linalg.norm(half, axis=-1), np.finfo(float).tiny)
        cosine = np.clip((wo * half).sum(-1) / length, 0.0, 1.0)
        fresnel = f0 + (1.0 - f0) * ((1.0 - cosine) ** 5)[:, None]
        lit = ((wi[:, 2] > 0.0) & (wo[:, 2] > 0.0))[:, None]
        diffuse = (1.0 - fresnel) * (1.0 - self.metallic) * color / np.pi
        return np.asarray(np.where(lit, diffuse + fresnel * white, 0.0))


def nearest(wi: Array, wo: Array, f_r: Array) -> MetallicRoughness:
    """Find the material nearest to f_r, shape (N, 3), by least squares of ln(1 + f cos(theta_i)).

    From nine starts: a metal and a dielectric can be alike in one colour.
    """
    from scipy.optimize import least_squares

    cosine = wi[:, 2:]
    target = np.log1p(np.maximum(f_r, 0.0) * cosine)

    def residual(x: Array) -> Array:
        return np.asarray((np.log1p(_material(x).evaluate(wi, wo) * cosine) - target).ravel())

    color = np.clip(np.pi * np.median(f_r, axis=0), 0.02, 0.98)
    low = np.array([0.0, 0.0, 0.0, 0.0, SMALLEST_ROUGHNESS])
    found = [
        least_squares(residual, [*color, metallic, roughness], bounds=(low, np.ones(5)), max_nfev=60)
        for metallic, roughness in STARTS
    ]
    return _material(min(found, key=lambda each: float(each.cost)).x)


def _material(x: Array) -> MetallicRoughness:
    return MetallicRoughness((float(x[0]), float(x[1]), float(x[2])), float(x[3]), float(x[4]))


def write(model: Reflects, path: Path, name: str, channels: Sequence[str]) -> Exported:
    """Fit a material to a model and write it; see `analysis.exports.export`."""
    matrix = to_linear_srgb(channels)

    def in_srgb(wi: Array, wo: Array) -> Array:
        f_r = model.evaluate(wi, wo)
        return np.asarray(np.broadcast_to(f_r, (*f_r.shape[:-1], len(matrix))) @ matrix)

    wi, wo = compared_directions()
    true = in_srgb(wi, wo)
    material = nearest(wi, wo, true)
    median, p95 = relative(material.evaluate(wi, wo), true)
    told = Exported(
        "nearest metallic-roughness material",
        (path.name,),
        median,
        p95,
        sphere_delta_e(in_srgb, material.evaluate)["delta_e_mean"],
    )
    text = _gltf(name, material, told) if path.suffix.lower() == ".gltf" else _mtlx(name, material)
    path.write_text(text, encoding="utf-8")
    return told


def _gltf(name: str, material: MetallicRoughness, told: Exported) -> str:
    return json.dumps(
        {
            "asset": {"version": "2.0", "generator": "gonio"},
            "materials": [
                {
                    "name": f"gonio {name}",
                    "pbrMetallicRoughness": {
                        "baseColorFactor": [*material.base_color, 1.0],
                        "metallicFactor": material.metallic,
                        "roughnessFactor": material.roughness,
                    },
                    "extras": {key: value for key, value in asdict(told).items() if key != "files"},
                }
            ],
        },
        indent=2,
    )


def _mtlx(name: str, material: MetallicRoughness) -> str:
    root = ET.Element("materialx", version="1.38", colorspace="lin_rec709")
    shader = ET.SubElement(root, "gltf_pbr", name="gonio_shader", type="surfaceshader")
    color = ", ".join(f"{value:.9g}" for value in material.base_color)
    for key, kind, value in (
        ("base_color", "color3", color),
        ("metallic", "float", f"{material.metallic:.9g}"),
        ("roughness", "float", f"{material.roughness:.9g}"),
    ):
        ET.SubElement(shader, "input", name=key, type=kind, value=value)
    label = "gonio_" + "".join(letter if letter.isalnum() else "_" for letter in name)
    surface = ET.SubElement(root, "surfacematerial", name=label, type="material")
    ET.SubElement(surface, "input", name="surfaceshader", type="surfaceshader", nodename="gonio_shader")
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
