"""`gonio calibrate sensor` as a person runs it: on the twin, from a folder, and with frames that spoil it."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

from analysis.white_calibration import load_white
from capture.sensor import load_sensor
from rig.description import Camera, default_rig, dump_rig
from simulator.twin import Twin

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.render


def gonio(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(
        [sys.executable, "-m", "gonio.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=150,
        check=False,
        stdin=subprocess.DEVNULL,
    )


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object]]:
    """Calibrate a twin with a larger camera, whose own calibration is thrown away before."""
    folder = tmp_path_factory.mktemp("calibrate")
    camera = Camera(
        serial="TWIN-0001",
        width_px=320,
        height_px=240,
        focal_length_px=6000.0,
        principal_point_px=(159.5, 119.5),
    )
    dump_rig(default_rig(folder=folder, camera=camera), folder / "wanted.toml")
    with Twin(seed=3, speed=500.0, rig=folder / "wanted.toml", folder=folder / "twin", log=False) as twin:
        shutil.rmtree(folder / "twin" / "calibration")
        done = gonio("calibrate", "sensor", "--rig", twin.rig, "--json")
    assert done.returncode == 0, done.stderr
    return folder / "twin", json.loads(done.stdout)


def test_twin_is_characterised(calibrated: tuple[Path, dict[str, object]]) -> None:
    """Gain off by more than 0.3 %, read noise by more than 2 %, a clip level by more than 1 DN."""
    folder, answer = calibrated
    sensor = load_sensor(folder / "calibration" / "sensor.toml")

    assert sensor.gain_dn_per_e == pytest.approx(0.5, rel=3e-3)
    assert sensor.read_noise_dn == pytest.approx(1.5, rel=2e-2)
    assert sensor.clip_dn == pytest.approx((15503.0, 15499.0, 15511.0), abs=1.0)
    assert sensor.camera_serial == "TWIN-0001"
    assert sensor.date is not None
    assert sensor.lamp_temperature_deg_c is not None
    assert answer["doubts"] == []


def test_everything_is_kept(calibrated: tuple[Path, dict[str, object]]) -> None:
    """Frames without a record, maps that cannot be read, a page that needs the net."""
    folder, answer = calibrated
    (dated,) = (folder / "calibration").glob("sensor-*")
    log = [json.loads(line) for line in (dated / "frames.jsonl").read_text("utf-8").splitlines()]
    page = (dated / "report.html").read_text("utf-8")

    assert {line["file"] for line in log} == {
        path.relative_to(dated).as_posix() for path in (dated / "frames").iterdir()
    }
    with np.load(dated / "maps.npz", allow_pickle=False) as maps:
        assert maps["hot"].shape == maps["bias_dn"].shape == (240, 320)
    assert answer["page"] == str(dated / "report.html")
    assert "Data sheet" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    summary = json.loads((dated / "sensor.json").read_text("utf-8"))
    assert summary["quantities"]["gain_dn_per_e"]["u"] < 1e-3


def test_frames_of_a_folder_give_the_same(calibrated: tuple[Path, dict[str, object]], tmp_path: Path) -> None:
    """Another result from the same frames, or a rig file asked for that nobody needs."""
    folder, answer = calibrated
    (dated,) = (folder / "calibration").glob("sensor-*")
    arguments = ("--rig", tmp_path / "none.toml", "--out", tmp_path / "cal", "--json")

    again = gonio("calibrate", "sensor", "--frames-from", dated / "frames", *arguments)

    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["quantities"] == answer["quantities"]
    assert load_sensor(tmp_path / "cal" / "sensor.toml").lamp_temperature_deg_c is None


def test_what_spoils_it_is_named_and_nothing_replaced(
    calibrated: tuple[Path, dict[str, object]], tmp_path: Path
) -> None:
    """A flat among the darks is averaged in; frames of another camera pass for the machine's."""
    folder, _ = calibrated
    (dated,) = (folder / "calibration").glob("sensor-*")
    shutil.copytree(dated / "frames", tmp_path / "frames")
    other = default_rig(folder=tmp_path, camera=Camera(serial="OTHER"))
    dump_rig(other, tmp_path / "rig.toml")

    refused = gonio(
        "calibrate", "sensor", "--frames-from", tmp_path / "frames", "--rig", tmp_path / "rig.toml"
    )
    (tmp_path / "frames" / "flat-03-00.dng").write_bytes(b"II*\0 cut short")
    damaged = gonio("calibrate", "sensor", "--frames-from", tmp_path / "frames", "--out", tmp_path / "cal")

    assert refused.returncode == 2
    assert "TWIN-0001, the rig file names OTHER" in refused.stderr
    assert damaged.returncode == 2
    assert "flat-03-00.dng" in damaged.stderr
    assert len(damaged.stderr.splitlines()) == 1
    assert not list(tmp_path.rglob("sensor.toml"))


def test_white_from_the_files_of_its_laboratory(shared_data: Path, tmp_path: Path) -> None:
    """A certificate that does not reach the file that a reduction reads, or points that change nothing."""
    spectralon = shared_data / "spectralon"
    points = spectralon / "20250210_S7_sample_final.txt"
    arguments = ("--certificate", spectralon / "Spectralon_Num4.txt", "--out", tmp_path, "--json")

    plain = gonio("calibrate", "white", *arguments)
    full = gonio("calibrate", "white", *arguments, "--points", points, "--channel-nm", "600,540,460")

    assert plain.returncode == full.returncode == 0, plain.stderr + full.stderr
    before, after = json.loads(plain.stdout), json.loads(full.stdout)
    assert len(before["rho"]) == 1
    assert len(after["rho"]) == 3
    assert after["points"] > 15
    assert after["u_factor_45_0"] < 0.3 * before["u_factor_45_0"]
    assert load_white(tmp_path / "white.toml").channel_nm == (600.0, 540.0, 460.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "nothing to calibrate"),
        (("--certificate", "nowhere.txt"), "cannot read"),
        (("--certificate", __file__), "no lines of three numbers"),
        (("--certificate", __file__, "--channel-nm", "blue"), "no lines of three numbers"),
    ],
)
def test_white_without_usable_files(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    """A traceback, or an empty calibration."""
    done = gonio("calibrate", "white", *arguments, "--out", tmp_path)

    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "white.toml").exists()
