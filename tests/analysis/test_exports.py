"""Exports of fits: would catch parameters converted wrongly, errors that are not told, and invalid files."""

from __future__ import annotations

import json
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from analysis.exports import check_name, export
from analysis.exports.colours import to_linear_srgb
from analysis.exports.metallic_roughness import MetallicRoughness
from analysis.models import MODELS
from rig.angles import spherical_to_direction
from rig.errors import BadInput

RGB = ["R", "G", "B"]
NAME = "model"


def directions(count, seed, largest_deg=75.0):
    """Draw directions that are even over a cap."""
    rng = np.random.default_rng(seed)
    theta = np.arccos(rng.uniform(np.cos(np.radians(largest_deg)), 1.0, count))
    return spherical_to_direction(theta, rng.uniform(-np.pi, np.pi, count))


def read_gltf(path):
    """Check the structure that the glTF 2.0 specification asks for, and return the material."""
    content = json.loads(path.read_text())
    assert content["asset"]["version"] == "2.0"
    (material,) = content["materials"]
    inner = material["pbrMetallicRoughness"]
    assert set(inner) == {"baseColorFactor", "metallicFactor", "roughnessFactor"}
    assert len(inner["baseColorFactor"]) == 4
    assert all(0.0 <= value <= 1.0 for value in inner["baseColorFactor"])
    assert 0.0 <= inner["metallicFactor"] <= 1.0
    assert 0.0 <= inner["roughnessFactor"] <= 1.0
    assert material["extras"]["median_relative"] >= 0.0
    return inner


def test_a_metal_is_found_again(tmp_path):
    """Catches roughness for alpha, and a metal taken for plastic: GGX with Schlick is glTF's metal."""
    gold = MODELS["ggx"](kd=np.zeros(3), ks=1.0, alpha=0.16, f0=np.array([0.9, 0.6, 0.2]))
    told = export(gold, tmp_path / "gold.gltf", channels=RGB, name=NAME)
    found = read_gltf(tmp_path / "gold.gltf")
    assert found["roughnessFactor"] == pytest.approx(0.4, abs=0.002)
    assert found["metallicFactor"] > 0.98
    np.testing.assert_allclose(found["baseColorFactor"][:3], [0.9, 0.6, 0.2], atol=0.01)
    assert told.median_relative < 0.02
    assert told.delta_e < 1.0


def test_what_the_form_cannot_hold_is_told(tmp_path):
    """Catches an error that is stated smaller than it is: the file is evaluated again and compared."""
    sharp = MODELS["phong"](kd=np.array([0.3, 0.2, 0.1]), ks=0.4, exponent=40.0)
    told = export(sharp, tmp_path / "phong.gltf", channels=RGB, name=NAME)
    inner = read_gltf(tmp_path / "phong.gltf")
    material = MetallicRoughness(
        tuple(inner["baseColorFactor"][:3]), inner["metallicFactor"], inner["roughnessFactor"]
    )
    wi, wo = directions(3000, 1), directions(3000, 2)
    true = sharp.evaluate(wi, wo)
    error = np.abs(material.evaluate(wi, wo) - true) / true
    assert told.median_relative > 0.02
    assert 0.3 < np.median(error) / told.median_relative < 3.0
    assert f"{100.0 * told.median_relative:.2g} %" in str(told)


def test_the_material_is_the_specifications_formula():
    """Catches a wrong factor in the diffuse part or the mix: at normal incidence the terms are known."""
    up = np.array([[0.0, 0.0, 1.0]])
    material = MetallicRoughness((0.8, 0.5, 0.2), 0.25, 0.5)
    color, alpha = np.array([0.8, 0.5, 0.2]), 0.25
    f0 = 0.75 * 0.04 + 0.25 * color
    expected = (1.0 - f0) * 0.75 * color / np.pi + f0 / (4.0 * np.pi * alpha**2)
    np.testing.assert_allclose(material.evaluate(up, up)[0], expected, rtol=1e-12)
    assert (material.evaluate(-up, up) == 0.0).all()


def test_materialx_names_what_gltf_names(tmp_path):
    """Catches colours in another order or a shader that nothing uses."""
    paint = MODELS["ggx"](kd=np.array([0.5, 0.3, 0.1]), ks=1.0, alpha=0.2, f0=0.04)
    export(paint, tmp_path / "paint.mtlx", channels=RGB, name=NAME)
    export(paint, tmp_path / "paint.gltf", channels=RGB, name=NAME)
    root = ET.fromstring((tmp_path / "paint.mtlx").read_text())  # noqa: S314 - our own file
    shader = root.find("gltf_pbr")
    inputs = {one.get("name"): one.get("value") for one in shader}
    inner = read_gltf(tmp_path / "paint.gltf")
    color = [float(part) for part in inputs["base_color"].split(",")]
    np.testing.assert_allclose(color, inner["baseColorFactor"][:3], rtol=1e-6)
    assert float(inputs["roughness"]) == pytest.approx(inner["roughnessFactor"])
    assert root.find("surfacematerial/input").get("nodename") == shader.get("name")


def test_spectra_become_colours():
    """Catches a matrix turned over: grey stays grey, long waves are red, white's luminance is kept."""
    wavelengths = np.arange(400.0, 701.0, 10.0)
    matrix = to_linear_srgb([f"{w:g} nm" for w in wavelengths])
    np.testing.assert_allclose(np.full(31, 0.5) @ matrix, [0.5] * 3, rtol=1e-6)
    red = np.where(wavelengths > 600.0, 1.0, 0.0) @ matrix
    assert red[0] > 4.0 * abs(red[1])
    np.testing.assert_allclose(to_linear_srgb(["550 nm"]), [[1.0, 1.0, 1.0]])
    with pytest.raises(BadInput, match="no colour"):
        to_linear_srgb(["a", "b"])
    with pytest.raises(BadInput, match="no colour"):
        to_linear_srgb(["500 nm", "510 nm", "520 nm"])


def test_names_and_models_that_are_refused(tmp_path):
    """Catches a file of another kind than its name says, and a grain that is lost in silence."""
    with pytest.raises(BadInput, match="no fit is exported as"):
        check_name(tmp_path / "a.obj")
    with pytest.raises(BadInput, match="no such folder"):
        check_name(tmp_path / "none" / "a.xml")
    with pytest.raises(BadInput, match=r"not isotropic.*export it as \.xml"):
        export(MODELS["ggx-anisotropic"](), tmp_path / "a.gltf", channels=["550 nm"], name=NAME)
    assert not list(tmp_path.iterdir())


@pytest.mark.render
@pytest.mark.parametrize(
    ("model", "bound"),
    [
        (MODELS["lambert"](kd=np.array([0.7, 0.4, 0.1])), 1e-5),
        (MODELS["ggx"](kd=np.array([0.3, 0.2, 0.1]), ks=1.0, alpha=0.2, f0=0.05), 5e-3),
        (MODELS["oren-nayar"](kd=np.full(3, 0.5)), 5e-3),
    ],
)
@pytest.mark.parametrize(
    ("suffix", "variant"), [(".xml", "scalar_rgb"), (".json", "scalar_rgb"), (".xml", "llvm_ad_rgb")]
)
def test_mitsuba_evaluates_the_fit(tmp_path, model, bound, suffix, variant):
    """Catches files that Mitsuba does not load, or reads otherwise than the stated error says."""
    _require_same(tmp_path, model, bound, suffix, variant)


@pytest.mark.render
def test_mitsuba_evaluates_a_grained_fit(tmp_path):
    """Catches a grain that is lost, turned, or read from the other side than it was written for."""
    brushed = MODELS["ggx-anisotropic"](
        kd=np.full(3, 0.2), ks=0.6, alpha_x=0.5, alpha_y=0.25, f0=0.3, axis_rad=0.4
    )
    _require_same(tmp_path, brushed, 5e-3, ".json", "scalar_rgb")


def _require_same(tmp_path, model, bound, suffix, variant):
    mi = pytest.importorskip("mitsuba")
    try:
        mi.set_variant(variant)
    except ImportError:
        pytest.skip("no LLVM here")
    told = export(model, tmp_path / f"fit{suffix}", channels=RGB, name=model.NAME)
    assert told.median_relative < bound
    if suffix == ".xml":
        bsdf = mi.load_file(str(tmp_path / "fit.xml"))
    else:
        content = json.loads((tmp_path / "fit.json").read_text())
        if "filename" in content:
            content["filename"] = str(tmp_path / content["filename"])
        bsdf = mi.load_dict(content)
    light, camera = directions(300, 3), directions(300, 4)
    # Scalar variants take one pair of directions at a time, the others all of them.
    pairs = zip(light, camera, strict=True) if variant.startswith("scalar") else [(light.T, camera.T)]
    got = []
    for wi, wo in pairs:
        interaction = mi.SurfaceInteraction3f()
        interaction.wi = mi.Vector3f(*(mi.Float(part) for part in wi))
        given = bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(*(mi.Float(part) for part in wo)), True)
        got.append(np.array(given).reshape(3, -1).T / np.reshape(wo[2], (-1, 1)))
    true = np.broadcast_to(model.evaluate(light, camera), (300, 3))
    assert np.median(np.abs(np.concatenate(got) - true) / true) < bound
