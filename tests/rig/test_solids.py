"""Solids of a rig file: a solid that is somewhere else than the file says, or a file that means no solid."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.description import Box, Camera, Capsule, Lamp, Rig, Sphere, default_rig, dump_rig, load_rig
from rig.errors import BadInput
from rig.kinematics import Kinematics
from rig.placement import placed_solids

if TYPE_CHECKING:
    from pathlib import Path

ANGLES = st.tuples(*[st.floats(-1.4, 1.4)] * 4)


def rig_with(**fields: object) -> Rig:
    """Return the default machine with one box on the camera's arm, or what is given."""
    box = {
        "name": "box",
        "link": "camera_elevation",
        "centre_mm": (0.0, 0.0, 600.0),
        "size_mm": (2.0, 4.0, 6.0),
    }
    return default_rig(solids=(Box.model_validate(box | fields),))


@settings(deadline=None)
@given(angles=ANGLES)
def test_a_solid_goes_where_lamp_and_camera_go(angles: tuple[float, ...]) -> None:
    """Catches a link that turns with the wrong joints, or another frame than that of the kinematics."""
    rig = default_rig(
        solids=(
            Sphere(name="lamp", link="light_elevation", centre_mm=(0.0, 0.0, 500.0), radius_mm=1.0),
            Sphere(name="camera", link="camera_elevation", centre_mm=(0.0, 0.0, 600.0), radius_mm=1.0),
            Sphere(name="mark", link="turntable", centre_mm=(20.0, 0.0, 0.0), radius_mm=1.0),
        )
    )
    frames = Kinematics(rig).frames(angles)
    lamp, camera, mark = (solid.pose for solid in placed_solids(rig, angles))
    np.testing.assert_allclose(lamp[:3, 3], frames.light_mm, atol=1e-9)
    np.testing.assert_allclose(camera[:3, 3], frames.camera_mm, atol=1e-9)
    np.testing.assert_allclose(mark[:3, 3], (20.0, 0.0, 0.0), atol=1e-9)
    turned = placed_solids(rig, angles, in_sample_frame=False)[2].pose[:3, 3]
    np.testing.assert_allclose(turned, (20.0 * math.cos(angles[3]), 20.0 * math.sin(angles[3]), 0), atol=1e-9)


def test_a_rod_lies_between_its_ends() -> None:
    """Catches a wrong axis, also of rods along -z and along no axis."""
    for start, end in (((0.0, 0.0, 5.0), (0.0, 0.0, -5.0)), ((1.0, 2.0, 3.0), (-4.0, 0.5, 9.0))):
        rod = Capsule(name="rod", from_mm=start, to_mm=end, radius_mm=2.0)
        placed = placed_solids(default_rig(solids=(rod,)), [0.0] * 4)[0]
        half = placed.shape.half_mm[2]
        ends = [(placed.pose @ (0.0, 0.0, z, 1.0))[:3] for z in (-half, half)]
        np.testing.assert_allclose(ends, [start, end], atol=1e-9)
        assert np.linalg.det(placed.pose) == pytest.approx(1.0)


def test_a_box_turns_about_fixed_axes_x_first() -> None:
    """Catches Euler angles in another order."""
    placed = placed_solids(rig_with(turn_deg=(90.0, 0.0, 90.0)), [0.0] * 4)[0]
    np.testing.assert_allclose(placed.pose[:3, :3] @ (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(placed.pose[:3, :3] @ (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), atol=1e-12)


def test_solids_come_back_from_a_file_and_change_the_machine(tmp_path: Path) -> None:
    """Catches a field that is not written, or that the hash does not see."""
    rig = rig_with(turn_deg=(1.0, 2.0, 3.0), albedo=0.5)
    dump_rig(rig, tmp_path / "rig.toml")
    assert load_rig(tmp_path / "rig.toml") == rig
    assert rig.hash != rig_with().hash


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"link": "station_wheel"}, "solids[0].link"),
        ({"link": "camera_elevatoin"}, "did you mean camera_elevation?"),
        ({"size_mm": (1.0, 0.0, 1.0)}, "solids[0].size_mm[1]"),
        ({"albedo": 1.5}, "solids[0].albedo"),
        ({"kind": "capsule"}, "solids[0]"),
        ({"colour": "red"}, "unknown field solids[0].colour"),
    ],
)
def test_what_is_no_solid_is_refused_in_one_line(
    tmp_path: Path, fields: dict[str, object], said: str
) -> None:
    """Catches a traceback, or an error that does not name the field."""
    import tomli_w

    content = rig_with().model_dump(mode="json")
    content["ports"]["frames"] = "frames"
    content["solids"][0] |= fields
    (tmp_path / "rig.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
    with pytest.raises(BadInput) as refused:
        load_rig(tmp_path / "rig.toml")
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_two_solids_of_one_name_are_refused() -> None:
    """Catches a message that could mean either of two solids."""
    ball = Sphere(name="ball", centre_mm=(0.0, 0.0, 0.0), radius_mm=1.0)
    with pytest.raises(ValueError, match="another name"):
        default_rig(solids=(ball, ball))


@pytest.mark.parametrize("distance_mm", [20.0, 300.0, 5000.0, 100_000.0])
def test_the_default_solids_suit_every_distance(distance_mm: float) -> None:
    """Catches a lamp body in front of its disc, or solids that no rig file may hold."""
    rig = default_rig(lamp=Lamp(distance_mm=distance_mm), camera=Camera(distance_mm=0.9 * distance_mm))
    lamp = next(solid for solid in placed_solids(rig, [0.0] * 4) if solid.name == "lamp")
    assert lamp.pose[2, 3] - lamp.shape.half_mm[2] == pytest.approx(distance_mm)
