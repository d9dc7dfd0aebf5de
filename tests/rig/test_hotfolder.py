"""The hot folder: only the picture ordered counts; everything else is a stray, with its reason."""

from __future__ import annotations

import json
import os
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

from rig.errors import BadInput, DeviceLost, Refused, Transient
from rig.hotfolder import POLL_S, HotFolder, Stray

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True)
class Facts:
    camera_serial: str | None = "C1"
    shutter_s: float | None = 0.1
    lit: bool | None = True
    shot_id: str | None = "a"


def inspect(path: Path) -> Facts:
    """Read a frame of these tests: JSON, padded as a RAW file would be long."""
    try:
        return Facts(**json.loads(path.read_bytes().rstrip(b"\0")))
    except ValueError as error:
        raise BadInput("truncated", where=str(path)) from error


def put(path: Path, size: int = 25_000, **facts: object) -> Path:
    """Write a frame."""
    path.write_bytes(json.dumps(facts).encode().ljust(size, b"\0"))
    return path


@pytest.fixture
def strays() -> list[Stray]:
    """Return where strays are told."""
    return []


@pytest.fixture
def camera(tmp_path: Path, strays: list[Stray]) -> HotFolder:
    """Return a camera with the serial number C1."""
    return HotFolder(tmp_path, "C1", inspect, strays.append)


def test_the_picture_costs_two_looks(
    camera: HotFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches time lost on every frame: a file that lies there is taken at the second look, of equal size."""
    pauses: list[float] = []
    monkeypatch.setattr("rig.hotfolder.time.sleep", pauses.append)
    mark = camera.mark()
    path = put(tmp_path / "a.dng", shot_id="a")
    assert camera.wait_for("a", 0.1, mark, 60.0, lit=True) == path
    assert pauses == [POLL_S]


@pytest.mark.parametrize(
    ("facts", "reason"),
    [
        ({"camera_serial": "C2"}, "of camera C2, expected C1"),
        ({"shot_id": "b"}, "of shot b, expected a"),
        ({"shutter_s": 0.126}, "exposed 0.126 s, expected 0.1 s"),
        ({"shutter_s": 0.08}, "exposed 0.08 s, expected 0.1 s"),
        ({"lit": False}, "taken dark, expected the opposite"),
    ],
)
def test_what_does_not_match_is_a_stray(
    camera: HotFolder, tmp_path: Path, strays: list[Stray], facts: dict[str, object], reason: str
) -> None:
    """Catches the picture of another camera, shot, exposure or light that is filed as this one."""
    mark = camera.mark()
    put(tmp_path / "x.dng", **facts)
    with pytest.raises(Transient, match=reason):
        camera.wait_for("a", 0.1, mark, 0.3, lit=True)
    assert [(stray.path.name, stray.reason) for stray in strays] == [("x.dng", reason)]


def test_a_file_that_says_nothing_is_taken_on_what_it_says(camera: HotFolder, tmp_path: Path) -> None:
    """Catches a camera without serial number or shot name in its files that can never be used."""
    mark = camera.mark()
    path = put(tmp_path / "x.nef", camera_serial=None, shutter_s=None, lit=None, shot_id=None)
    assert camera.wait_for("a", 0.1, mark, 60.0, lit=True) == path


def test_rounded_exposure_times_match(camera: HotFolder, tmp_path: Path) -> None:
    """Catches a camera that writes 1/10 for 0.1042 s being refused."""
    mark = camera.mark()
    put(tmp_path / "x.dng", shutter_s=0.1042)
    assert camera.wait_for("a", 0.1, mark, 60.0).name == "x.dng"


def test_an_old_file_is_never_the_picture(camera: HotFolder, tmp_path: Path) -> None:
    """Catches the last picture taken for this one, also when it matches in everything."""
    put(tmp_path / "old.dng")
    mark = camera.mark()
    with pytest.raises(DeviceLost, match="no file arrived"):
        camera.wait_for("a", 0.1, mark, 0.3)


def test_a_file_copied_late_but_taken_early_is_a_stray(camera: HotFolder, tmp_path: Path) -> None:
    """Catches an older picture that a slow share delivers after the trigger."""
    mark = camera.mark()
    path = put(tmp_path / "late.dng", shot_id=None)
    hour_ago = time.time() - 3600.0
    os.utime(path, (hour_ago, hour_ago))
    with pytest.raises(Transient, match="older than the trigger"):
        camera.wait_for("a", 0.1, mark, 0.3)


def test_a_name_used_again_is_a_new_picture(camera: HotFolder, tmp_path: Path) -> None:
    """Catches cameras that call every file capt0000: the second would never be seen."""
    put(tmp_path / "capt0000.nef", shot_id="first")
    mark = camera.mark()
    time.sleep(0.02)
    put(tmp_path / "capt0000.nef", shot_id="a")
    assert camera.wait_for("a", 0.1, mark, 60.0).name == "capt0000.nef"


def test_a_growing_file_is_waited_for(camera: HotFolder, tmp_path: Path, strays: list[Stray]) -> None:
    """Catches half a file that is read, or thrown away, while it is being written."""
    mark = camera.mark()
    whole = json.dumps({"shot_id": "a"}).encode()

    def grow() -> None:
        with (tmp_path / "x.dng").open("wb") as file:
            for start in range(0, len(whole), 4):
                file.write(whole[start : start + 4])
                file.flush()
                time.sleep(0.03)

    writer = threading.Thread(target=grow)
    writer.start()
    path = camera.wait_for("a", 0.1, mark, 60.0)
    writer.join()
    assert path.read_bytes() == whole
    assert strays == []


def test_what_never_decodes_is_a_stray_with_its_reason(
    camera: HotFolder, tmp_path: Path, strays: list[Stray]
) -> None:
    """Catches a truncated RAW that passes, and a text file that is called a broken RAW."""
    mark = camera.mark()
    (tmp_path / "cut.dng").write_bytes(b"{")
    (tmp_path / "note.txt").write_bytes(b"x")
    (tmp_path / ".hidden.dng").write_bytes(b"x")
    (tmp_path / "coming.part").write_bytes(b"x")
    with pytest.raises(Transient, match=r"cut\.dng does not decode"):
        camera.wait_for("a", 0.1, mark, 0.3)
    assert sorted(stray.path.name for stray in strays) == ["cut.dng", "note.txt"]


def test_strays_are_told_once_and_the_picture_found_beside_them(
    camera: HotFolder, tmp_path: Path, strays: list[Stray]
) -> None:
    """Catches a stray that hides the picture, or is journalled at every look."""
    mark = camera.mark()
    put(tmp_path / "a-stray.dng", shot_id="b")
    path = put(tmp_path / "picture.dng")
    assert camera.wait_for("a", 0.1, mark, 60.0) == path
    put(tmp_path / "unasked.dng")
    mark = camera.mark()
    path = put(tmp_path / "next.dng")
    assert camera.wait_for("a", 0.1, mark, 60.0) == path
    camera.mark()
    assert [stray.path.name for stray in strays] == ["a-stray.dng", "unasked.dng"]


def test_a_stop_ends_the_wait(camera: HotFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a stop that has to wait for the file's timeout."""
    pauses: list[float] = []
    monkeypatch.setattr("rig.hotfolder.time.sleep", pauses.append)
    with pytest.raises(Refused, match="stopped"):
        camera.wait_for("a", 0.1, camera.mark(), 10.0, cancelled=lambda: True)
    assert sum(pauses) <= POLL_S


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    """Catches a typo in the folder that looks like a camera that is off, or a share that fell away."""
    camera = HotFolder(tmp_path / "nope", "", inspect)
    with pytest.raises(BadInput, match="no such folder"):
        camera.require()
    with pytest.raises(DeviceLost, match="cannot be read"):
        camera.mark()
