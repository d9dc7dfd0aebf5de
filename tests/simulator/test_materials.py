"""Material lines mean what they say, and a wrong one is refused with what would be right."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.errors import BadInput
from simulator.materials import (
    ClosedFormMaterial,
    MitsubaMaterial,
    closed_form_material,
    parse_material,
    station_materials,
)

if TYPE_CHECKING:
    from pathlib import Path

STATIONS = {"white": "white", "trap": "trap", "sample1": "sample", "sample2": "sample"}


def test_a_model_line_becomes_that_model() -> None:
    """Would catch parameters that go to the wrong name or channel."""
    material = parse_material("cook-torrance:kd=0.1/0.2/0.3, ks=0.5,m=0.2,ior=1.5")
    assert isinstance(material, ClosedFormMaterial)
    assert material.truth == {"kd": [0.1, 0.2, 0.3], "ks": [0.5] * 3, "m": [0.2] * 3, "ior": [1.5] * 3}
    up = np.array([[0.0, 0.0, 1.0]])
    f = material.closed_form().evaluate(up, up)
    np.testing.assert_allclose(np.diff(f[0]), 0.1 / np.pi)


def test_a_material_made_of_numbers_writes_a_line_that_makes_it_again() -> None:
    """Would catch a material that changes on its way into another process."""
    made = closed_form_material("phong", {"kd": (0.1, 1.0 / 3.0, 0.3), "ks": 0.25, "exponent": 7e-5})
    assert parse_material(made.spec).truth == made.truth


def test_a_mitsuba_line_becomes_a_description() -> None:
    """Would catch numbers, names, flags and colours taken for each other."""
    material = parse_material(
        "mitsuba:roughplastic,alpha=0.1,distribution=ggx,nonlinear=true,diffuse_reflectance=0.1/0.2/0.3"
    )
    assert isinstance(material, MitsubaMaterial)
    assert material.plugin() == {
        "type": "roughplastic",
        "alpha": 0.1,
        "distribution": "ggx",
        "nonlinear": True,
        "diffuse_reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.3]},
    }


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("lambertian:kd=0.5", "did you mean lambert"),
        ("gold", "known kinds: .*lambert, .*mitsuba, bsdf"),
        ("lambert", "needs kd"),
        ("lambert:kd", "not key=value"),
        ("lambert:kd=half", "kd=half is not a number"),
        ("lambert:kd=nan", "not finite"),
        ("lambert:kd=0.1/0.2", "one, or three"),
        ("lambert:kd=0.1,kd=0.2", "twice"),
        ("lambert:kd=-0.1", "below 0"),
        ("phong:kd=0.1,ks=0.1,exponnent=3", "did you mean exponent"),
        ("cook-torrance:kd=0.1,ks=0.1,m=0.2,ior=0.5", "below 1"),
        ("mitsuba:", "roughconductor"),
        ("bsdf:no/such.bsdf", "No such file"),
        ("", "known kinds"),
    ],
)
def test_a_wrong_line_is_refused_with_what_would_be_right(spec: str, message: str) -> None:
    """Would catch a default that silently replaces a typo, and messages that do not help."""
    with pytest.raises(BadInput, match=message) as refused:
        parse_material(spec)
    assert "\n" not in str(refused.value)


def test_what_mitsuba_cannot_hold_is_a_material_in_closed_form_alone() -> None:
    """Would catch an infinite value handed to a renderer, and a new model refused where none is needed."""
    line = "lafortune:kd=0.1,ks=1e-60/1e-70/0,ratio=1.5,exponent=400"
    material = parse_material(line)
    assert isinstance(material, ClosedFormMaterial)
    assert not material.rendered
    with pytest.raises(BadInput, match="closed form") as refused:
        material.plugin()
    assert "\n" not in str(refused.value)


def test_a_file_that_is_not_a_measured_bsdf_is_refused(tmp_path: Path) -> None:
    """Would catch any file being handed to the renderer's own reader."""
    path = tmp_path / "paint.bsdf"
    path.write_bytes(b"not a tensor file")
    with pytest.raises(BadInput, match="not a measured BSDF"):
        parse_material(f"bsdf:{path}")


@given(st.text(max_size=60))
def test_any_text_is_a_material_or_a_bad_input(text: str) -> None:
    """Would catch a traceback out of a line typed by a person."""
    try:
        material = parse_material(text)
    except BadInput:
        return
    assert material.spec == text


def test_stations_hold_what_the_wheel_and_the_person_put_there() -> None:
    """Would catch a white of the wrong albedo, a trap that reflects, or a material put beside the wheel."""
    placed = station_materials(STATIONS, {"sample2": "lambert:kd=0.5"}, white_rho=0.9876)
    assert placed["white"].truth == {"kd": [0.9876] * 3}
    assert placed["trap"].truth == {"kd": [0.0] * 3}
    assert placed["sample2"].truth == {"kd": [0.5] * 3}
    assert "sample1" not in placed
    with pytest.raises(BadInput, match="did you mean sample1"):
        station_materials(STATIONS, {"sample_1": "lambert:kd=0.5"}, white_rho=0.99)


def test_a_machine_without_a_wheel_takes_any_label() -> None:
    """Would catch wheel-less machines being refused their only sample."""
    placed = station_materials({}, {"paint": "lambert:kd=0.5"}, white_rho=0.99)
    assert {"paint", "white"} <= placed.keys()
