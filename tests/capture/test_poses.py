"""Sets of poses: where they lie, what a machine refuses, and lists from files."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from capture import poses
from capture.feasible import Reason, feasible
from rig.angles import direction_to_spherical, mirror
from rig.errors import BadInput
from rig.kinematics import Kinematics

if TYPE_CHECKING:
    from pathlib import Path

    from rig.description import Rig


def test_grid_has_every_combination_once() -> None:
    """Would catch swapped axes and a relative azimuth that forgets the light's."""
    wi, wo = poses.grid(
        np.radians([10, 50]), np.radians([20, 40, 60]), np.radians([90, 180]), np.radians([30])
    )
    assert wi.shape == wo.shape == (12, 3)
    theta_i, phi_i = np.degrees(direction_to_spherical(wi))
    theta_o, phi_o = np.degrees(direction_to_spherical(wo))
    found = {tuple(np.round(row).astype(int)) for row in np.stack([theta_i, phi_i, theta_o, phi_o], axis=1)}
    assert found == {(i, 30, o, p) for i in (10, 50) for o in (20, 40, 60) for p in (120, -150)}


def test_sweep_is_positive_on_the_mirrors_side() -> None:
    """Would catch a sweep that runs the wrong way: its lobe would appear at minus theta_i."""
    wi, wo = poses.sweep(np.radians([35.0]), np.radians([35.0, -35.0]))
    np.testing.assert_allclose(wo[0], mirror(wi[0]), atol=1e-15)
    np.testing.assert_allclose(wo[1], wi[1], atol=1e-15)


def test_specular_offsets_leave_the_mirror_direction_outwards() -> None:
    """Would catch an offset of the wrong sign, or one that leaves the plane of incidence."""
    wi, wo = poses.specular(np.radians([30.0, 65.0]), np.radians([0.0, 4.0]), phi_i=0.7)
    assert np.degrees(direction_to_spherical(wo)[0]) == pytest.approx([30, 34, 65, 69])
    np.testing.assert_allclose(wo[[0, 2]], mirror(wi[[0, 2]]), atol=1e-15)
    np.testing.assert_allclose(np.cross(wi, wo)[:, 2], 0.0, atol=1e-15)


def test_hemisphere_is_even_on_the_cap() -> None:
    """Would catch a spiral that crowds at the pole or at the rim, or leaves the cap."""
    rim = math.radians(60.0)
    _, wo = poses.hemisphere([0.3], 2000, rim)
    z = wo[:, 2]
    assert z.min() >= math.cos(rim)
    counts, _ = np.histogram(z, bins=20, range=(math.cos(rim), 1.0))
    assert np.all(np.abs(counts - 100) <= 1)
    azimuth = np.arctan2(wo[:, 1], wo[:, 0])
    around, _ = np.histogram(azimuth, bins=16)
    assert np.all(np.abs(around - 125) <= 12)


def test_hemisphere_repeats_the_cap_for_every_light() -> None:
    """Would catch lights and cameras that are paired one to one."""
    wi, wo = poses.hemisphere(np.radians([10.0, 40.0]), 7, 1.0)
    assert wi.shape == (14, 3)
    np.testing.assert_array_equal(wo[:7], wo[7:])
    assert len(np.unique(np.round(wi, 12), axis=0)) == 2


def test_the_pole_is_one_pose() -> None:
    """Would catch a grid that shoots the normal direction once for each azimuth."""
    wi, wo = poses.grid(np.radians([40.0]), np.radians([0.0, 30.0]), np.radians([0, 60, 120, 180]))
    kept_wi, kept_wo, repeats = poses.without_repeats(wi, wo)
    assert repeats == 3
    assert len(kept_wi) == len(kept_wo) == 5
    np.testing.assert_array_equal(kept_wo[0], wo[0])


def test_refused_poses_are_counted_and_named(default_rig: Rig) -> None:
    """Would catch a pose that disappears without a reason."""
    theta_o = np.radians([0.0, 30.0, 38.0, 80.0, 88.0, 90.0])
    wi, wo = poses.grid(np.radians([40.0]), theta_o, 0.0)
    found = feasible(Kinematics(default_rig), wi, wo)
    assert list(found.taken) == [0, 3]
    assert found.counts == {
        Reason.SEPARATION.value: 2,
        Reason.REACH.value: 1,
        Reason.BELOW_HORIZON.value: 1,
    }
    assert "8" in found.refusals[2].detail
    assert "camera_elevation" in found.refusals[2].detail
    assert len(found.taken) + len(found.refusals) == len(wi)


def test_taken_poses_reach_their_directions(default_rig: Rig) -> None:
    """Would catch angles that are stored for the wrong pose when others are refused."""
    wi, wo = poses.hemisphere(np.radians([10.0, 45.0]), 30, math.radians(80.0))
    kinematics = Kinematics(default_rig)
    found = feasible(kinematics, wi, wo)
    assert found.refusals
    light, camera = kinematics.directions(found.angles_rad)
    np.testing.assert_allclose(light, wi[found.taken], atol=1e-9)
    np.testing.assert_allclose(camera, wo[found.taken], atol=1e-9)


def test_csv_round_trip(tmp_path: Path) -> None:
    """Would catch columns read by place instead of by name, and a byte-order mark that hides the first."""
    table = tmp_path / "poses.csv"
    table.write_text(
        "\ufeffphi_o_deg,theta_i_deg,theta_o_deg,phi_i_deg,remark\n180,30,40,5,a\n\n-90,0,10,0,\n"
    )
    assert poses.read_csv(table) == [(30.0, 5.0, 40.0, 180.0), (0.0, 0.0, 10.0, -90.0)]


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("30,0,nan,180", "theta_o_deg is 'nan'"),
        ("30,0,inf,180", "theta_o_deg is 'inf'"),
        ("30,0,,180", "theta_o_deg is ''"),
        ("30,0", "theta_o_deg is ''"),
        ("95,0,10,180", "theta_i_deg is '95'"),
        ("30,0,-10,180", "theta_o_deg is '-10'"),
        ("30,x,10,180", "phi_i_deg is 'x'"),
    ],
)
def test_bad_csv_names_line_and_value(tmp_path: Path, text: str, wrong: str) -> None:
    """Would catch a NaN that becomes a pose, and an error that does not say where."""
    table = tmp_path / "poses.csv"
    table.write_text(f"theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg\n10,0,20,180\n{text}\n")
    with pytest.raises(BadInput, match="line 3") as caught:
        poses.read_csv(table)
    assert wrong in str(caught.value)


@pytest.mark.parametrize(
    "content", [b"", b"a,b\n1,2\n", b"\xff\xfe\x00", ",".join(poses.CSV_COLUMNS).encode()]
)
def test_files_that_are_no_list_are_refused(tmp_path: Path, content: bytes) -> None:
    """Would catch a traceback for an empty, binary or foreign file."""
    table = tmp_path / "poses.csv"
    table.write_bytes(content)
    with pytest.raises(BadInput, match=r"poses\.csv"):
        poses.read_csv(table)
    with pytest.raises(BadInput, match="none"):
        poses.read_csv(tmp_path / "none.csv")
