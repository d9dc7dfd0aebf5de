"""The camera on USB, against libgphoto2's own virtual camera: real protocol, real library."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.cameras.gphoto import seconds_of
from simulator.dng import DngMeta, exact_seconds, write_dng
from tests.rig.gphoto_scenes import SERIAL

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="libgphoto2 has no Windows wheel")


@pytest.fixture
def play(tmp_path: Path) -> Callable[..., Any]:
    """Return what plays a scene; the camera's picture is a DNG of 1/100 s, whatever its name says."""
    pytest.importorskip("gphoto2")
    camera, frames = tmp_path / "camera", tmp_path / "frames"
    camera.mkdir()
    frames.mkdir()
    meta = DngMeta(
        shutter_s=exact_seconds(0.01), black_dn=(512, 512, 512, 512), white_dn=16383, serial=SERIAL
    )
    write_dng(camera / "picture.dng", np.full((96, 128), 2000, dtype=np.uint16), meta)
    (camera / "picture.dng").rename(camera / "picture.jpg")

    def run(scene: str) -> Any:
        root = Path(__file__).parents[2]
        environment = {**os.environ, "VCAMERADIR": str(camera), "PYTHONPATH": str(root)}
        script = str(Path(__file__).with_name("gphoto_scenes.py"))
        done = subprocess.run(
            [sys.executable, script, scene, str(frames)],
            env=environment, capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


def test_the_shutter_is_set_and_read_back(play: Callable[..., Any]) -> None:
    """Catches a shutter time that the camera never took, or one that is not nearly what was asked."""
    found = play("shutter")
    assert found["serial"] == SERIAL
    assert sorted(found["shutters_s"].values()) == [1e-4, 0.0012, 0.0025, 0.005, 0.01, 0.02, 0.05, 0.1, 1.0]
    exact, near, far = found["found"]
    assert exact == [0.05, "0.0500s"]
    assert near == [0.01, "0.0100s"]
    assert far["kind"] == "BadInput"
    assert "0.1000s" in far["line"]


def test_pictures_arrive_until_the_store_is_full(play: Callable[..., Any], tmp_path: Path) -> None:
    """Catches a picture lost, cut or renamed on its way, and a full card that passes for a picture."""
    found = play("shots")
    files = sorted((tmp_path / "frames").iterdir())
    source = (tmp_path / "camera" / "picture.jpg").read_bytes()
    assert len(found["names"]) == len(files) == 26
    assert all(path.read_bytes() == source for path in files)
    assert {names[0].split("_")[0] for names in found["names"]} == {f"shot-{number}" for number in range(26)}
    assert found["error"]["kind"] == "Refused"
    assert "full" in found["error"]["line"]


def test_another_camera_is_named(play: Callable[..., Any]) -> None:
    """Catches a session with somebody else's camera, or a message that does not say which one is there."""
    found = play("stranger")
    assert found["kind"] == "DeviceLost"
    assert SERIAL in found["line"]
    assert "123456" in found["line"]


def test_a_camera_that_went_away_comes_back_as_it_was(play: Callable[..., Any]) -> None:
    """Catches a run that ends with a loose cable, or goes on with the camera's settings forgotten."""
    found = play("returned")
    assert found["error"]["kind"] == "Transient"
    assert found["held"] == "0.0500s"
    assert found["again"][0].startswith("lost_")


@pytest.mark.render
def test_a_machine_shoots_over_usb(play: Callable[..., Any]) -> None:
    """Catches a tethered camera that the machine triggers by wire, leaves dark, or lights in a dark frame."""
    found = play("machine")
    assert [name.split("_")[0] for name in found["pictures"]] == ["lit", "dark"]
    assert found["light"] == [True, False]
    assert not found["shutter by wire"]
    assert found["stopped"]


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        ("1/200", 1 / 200), ("0.0100s", 0.01), ("2.5", 2.5), ('2"5', 2.5), ('30"', 30.0), ("1/1.3", 1 / 1.3),
        ("0,5", 0.5), ("bulb", None), ("Time", None), ("1/0", None), ("", None), ("0", None), ("-1", None),
    ],
)  # fmt: skip
def test_makers_names_of_shutter_times(name: str, seconds: float | None) -> None:
    """Catches a name that is read as another time: every exposure would be off."""
    assert seconds_of(name) == (None if seconds is None else pytest.approx(seconds))


@given(st.text(max_size=12))
def test_any_name_is_a_time_or_none(name: str) -> None:
    """Catches a camera whose names end the program."""
    seconds = seconds_of(name)
    assert seconds is None or seconds > 0
