"""`gonio rig show`: no picture, a picture of another pose, or a traceback for a pose that is none."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.image import imread

from gonio.cli import main
from rig.description import default_rig, dump_rig

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def rig_file(tmp_path: Path) -> str:
    """Return the default machine's file."""
    dump_rig(default_rig(folder=tmp_path), tmp_path / "rig.toml")
    return str(tmp_path / "rig.toml")


def test_a_pose_is_drawn(rig_file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a drawing that does not change with the pose, and a nearest pair of another one."""
    pictures = []
    for elevation in ("20", "70"):
        out = tmp_path / f"{elevation}.png"
        pose = ["--pose", "light_elevation=-10", f"camera_elevation={elevation}"]
        assert main(["rig", "show", "--rig", rig_file, *pose, "--out", str(out), "--json"]) == 0
        said = json.loads(capsys.readouterr().out)
        assert said["obstacle"] is None
        pictures.append((imread(out), said["nearest"]["distance_mm"]))
    (near, near_mm), (far, far_mm) = pictures
    assert near.shape == far.shape
    assert min(near.shape[:2]) > 600
    assert np.mean(np.any(near != far, axis=-1)) > 0.02
    assert near_mm < far_mm


def test_a_collision_is_drawn_and_named(
    rig_file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a pose that is refused where a person wants to see why."""
    out = tmp_path / "machine.png"
    pose = ["light_elevation=0", "camera_elevation=0"]
    assert main(["rig", "show", "--rig", rig_file, "--pose", *pose, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "0.0 mm" in said
    assert "lamp_stem and camera" in said
    assert out.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("pose", "code"), [("light_elevation=x", 2), ("elbow=3", 2), ("light_elevation=86", 3)]
)
def test_what_is_no_pose_is_one_line(
    rig_file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], pose: str, code: int
) -> None:
    """Catches a traceback, or a picture of a pose that the machine cannot take."""
    out = tmp_path / "machine.png"
    assert main(["rig", "show", "--rig", rig_file, "--pose", pose, "--out", str(out)]) == code
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not out.exists()


def test_a_machine_without_solids_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a rig file of before that cannot be shown."""
    dump_rig(default_rig(folder=tmp_path, solids=()), tmp_path / "rig.toml")
    out = tmp_path / "machine.png"
    assert main(["rig", "show", "--rig", str(tmp_path / "rig.toml"), "--out", str(out)]) == 0
    assert "no solids" in capsys.readouterr().out
    assert out.exists()
