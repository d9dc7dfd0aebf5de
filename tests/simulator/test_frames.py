"""A frame is a function of its request: of all of it, and of nothing else."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rawpy

from capture.raw import inspect_frame, read_raw
from capture.sensor import load_sensor
from rig.description import Camera, White
from rig.description import default_rig as describe
from rig.errors import BadInput
from simulator.frames import FrameMaker, true_white_rho
from simulator.request import FrameRequest

if TYPE_CHECKING:
    from pathlib import Path

    from rig.description import Rig

MATERIALS = {"sample1": "lambert:kd=0.2/0.4/0.6", "sample2": "cook-torrance:kd=0.1,ks=0.5,m=0.2,ior=1.5"}
REQUEST = FrameRequest(
    seed=5,
    station="sample1",
    ticks={"light_elevation": 2300, "camera_elevation": 1900, "station_wheel": 3686},
    angles_rad=(0.386, 0.0, -0.227, 0.0),
    level=1.0,
    exposure_s=0.0125,
    shutter_open_s=0.0125,
    lit=True,
    mode="BULB",
    shot_id="pose-7.a",
    shot=3,
)


@pytest.fixture
def maker(default_rig: Rig) -> FrameMaker:
    """Camera of the default machine, in the scalar variant."""
    return FrameMaker(default_rig, MATERIALS, seed=5, variant="scalar")


def counts(path: Path) -> Any:
    """Return the counts above the black of their position."""
    frame = read_raw(path)
    return frame.counts - np.tile(frame.black_dn, (48, 64))


def test_equal_requests_give_equal_files(maker: FrameMaker, tmp_path: Path) -> None:
    """Would catch wall time, the shot's number or an earlier frame reaching a picture."""
    first = maker.make(REQUEST).read_bytes()
    maker.make(replace(REQUEST, station="white", shot_id="other", shot=4))
    assert maker.make(replace(REQUEST, shot=9)).read_bytes() == first
    rig = describe(folder=tmp_path / "again")
    assert FrameMaker(rig, MATERIALS, seed=5, variant="scalar").make(REQUEST).read_bytes() == first


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 6},
        {"station": "sample2"},
        {"ticks": {**REQUEST.ticks, "camera_elevation": 1901}},
        {"level": 0.999},
        {"exposure_s": 0.0126},
        {"shutter_open_s": 0.02},
        {"mode": "WIDTH"},
        {"lit": False},
        {"shot_id": "pose-7.b"},
    ],
    ids=lambda change: next(iter(change)),
)
def test_every_field_reaches_the_noise(maker: FrameMaker, change: dict[str, Any]) -> None:
    """Would catch two different exposures with the same noise, which an average would not reduce."""
    one, other = (_noise(maker.make(request)) for request in (REQUEST, replace(REQUEST, **change)))
    assert np.corrcoef(one, _noise(maker.make(REQUEST)))[0, 1] == pytest.approx(1.0)
    # Some of it is the pixels' own response, which both share.
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.1


def _noise(path: Path) -> Any:
    """Return what is left of a smooth picture after neighbours of one colour are subtracted."""
    red = counts(path)[::2, ::2]
    return np.clip(red[:, 1:] - red[:, :-1], -100, 100).ravel()


def test_files_say_what_they_are(maker: FrameMaker) -> None:
    """Would catch a file that the capture side must take for a stray."""
    path = maker.make(replace(REQUEST, exposure_s=0.0123, shutter_open_s=0.5, mode="LAMP"))
    info = inspect_frame(path)
    assert path.parent == maker.rig.ports.frames
    assert (info.shot_id, info.lit, info.camera_serial) == ("pose-7.a", True, maker.rig.camera.serial)
    assert (info.exposure_s, info.shutter_s) == (0.0123, 0.5)
    assert (info.width_px, info.height_px) == (128, 96)
    with rawpy.imread(str(path)) as raw:
        assert raw.other.shutter_speed == 0.5
        assert np.array_equal(raw.raw_image, read_raw(path).counts)


def test_no_file_is_written_over(maker: FrameMaker) -> None:
    """Would catch a shot that replaces another, for instance after the lamp controller was reset."""
    paths = [maker.make(REQUEST) for _ in range(3)]
    assert len(set(paths)) == 3
    assert all(path.name.startswith("000003_pose-7.a") for path in paths)
    assert maker.make(replace(REQUEST, shot_id="")).name == "000003.dng"


def test_light_scales_as_the_request_says(maker: FrameMaker) -> None:
    """Would catch level, exposure or station not reaching the light; the white's albedo is the true one."""
    white = replace(REQUEST, station="white", angles_rad=(0.0, 0.0, 0.4, 0.0))
    full = counts(maker.make(replace(white, exposure_s=0.1, shutter_open_s=0.1))).mean()
    assert full == pytest.approx(0.7 * 15000, rel=3e-3)
    half = counts(maker.make(replace(white, exposure_s=0.1, shutter_open_s=0.1, level=0.5))).mean()
    assert half / full == pytest.approx(0.5, rel=2e-3)
    tenth = counts(maker.make(replace(white, exposure_s=0.01, shutter_open_s=0.1))).mean()
    assert tenth / full == pytest.approx(0.1, rel=5e-3)
    for dark in ({"lit": False}, {"station": None}, {"station": "sample3"}, {"station": "trap"}):
        assert counts(maker.make(replace(white, **dark))).mean() < 5.0


def test_calibration_and_truth_lie_beside_the_rig_file(default_rig: Rig, maker: FrameMaker) -> None:
    """Would catch a session that takes the wrong noise model, and tests without a truth to compare with."""
    sensor = load_sensor(default_rig.folder / "calibration" / "sensor.toml")
    assert sensor == maker.sensor.calibration()
    truth = json.loads((default_rig.folder / "truth.json").read_text())
    assert truth["white"]["rho"] == maker.white_rho
    assert truth["materials"]["sample1"]["parameters"] == {"kd": [0.2, 0.4, 0.6]}
    assert truth["materials"]["sample2"]["model"] == "cook-torrance"


def test_the_white_is_off_by_what_its_certificate_admits(tmp_path: Path) -> None:
    """Would catch a white that is exactly its certificate: no stated uncertainty would ever be tested."""
    rig = describe(folder=tmp_path, white=White(rho=0.9, u_rho=0.005))
    drawn = np.array([true_white_rho(rig, seed) for seed in range(400)])
    assert np.mean(drawn) == pytest.approx(0.9, abs=4 * 0.005 / 20)
    assert np.std(drawn) == pytest.approx(0.005, rel=0.15)


def test_a_machine_without_a_wheel_shows_what_is_mounted(tmp_path: Path) -> None:
    """Would catch black pictures from a machine whose person changes the samples."""
    full = describe(
        folder=tmp_path, camera=Camera(width_px=32, height_px=24, principal_point_px=(15.5, 11.5))
    )
    arms = full.arms.model_copy(update={"station": ()})
    bare = full.model_copy(update={"stations": {}, "arms": arms, "joints": full.joints[:4]})
    maker = FrameMaker(bare, {"paint": "lambert:kd=0.9"}, seed=1, folder=tmp_path / "hot", variant="scalar")
    path = maker.make(replace(REQUEST, station=None))
    assert path.parent == tmp_path / "hot"
    assert read_raw(path).counts.mean() > 1000


def test_a_wrong_material_is_refused_before_the_twin_serves(default_rig: Rig) -> None:
    """Would catch a twin that starts and then has nothing to show."""
    with pytest.raises(BadInput, match="no station 'sample9'"):
        FrameMaker(default_rig, {"sample9": "lambert:kd=0.5"}, seed=1, variant="scalar")


def test_twelve_bits_fit_their_own_calibration(default_rig: Rig) -> None:
    """Would catch a depth that changes the counts and not the calibration."""
    maker = FrameMaker(default_rig, MATERIALS, seed=1, variant="scalar", bits=12)
    frame = read_raw(maker.make(replace(REQUEST, station="white", exposure_s=10.0)))
    assert frame.counts.max() <= 4095
    assert frame.counts.min() >= load_sensor(default_rig.folder / "calibration" / "sensor.toml").clip_dn


def test_the_light_process_renders_what_it_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch a housing or a tolerance that is asked for and never reaches the light."""
    from simulator import light_process

    told: dict[str, Any] = {}
    monkeypatch.setattr("simulator.frames.FrameMaker", lambda *_, **options: told.update(options))
    settings = light_process.LightSettings(str(tmp_path), "s", "l", housing_albedo=0.2, tolerance=1e-2)
    light_process._frame_maker(describe(), settings)
    assert (told["housing_albedo"], told["tolerance"]) == (0.2, 1e-2)
