"""`gonio merge` and `gonio bench`: what they print, write and refuse, on made and on real brackets."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from capture.bracket import exposure_from_name
from gonio.cli import main
from simulator.dng import DngMeta, write_dng

if TYPE_CHECKING:
    from numpy.typing import NDArray

GAIN, READ_DN, CLIP, BLACK = 0.5, 1.5, 15498, 512
TIMES = {"0.01": 1.0, "0.04": 1.0, "0.16": 1.0}
TRUE_RATIOS = {"25:50": 1.990, "50:100": 1.974, "100:250": 2.468, "250:500": 1.960}


def bracket(
    folder: Path, errors: tuple[float, ...] = (1.0, 1.0, 1.0), *, shape: tuple[int, int] = (192, 256)
) -> tuple[list[str], NDArray[np.float64]]:
    """Write a bracket of DNGs, whose true times differ from the stated by a factor each."""
    rng = np.random.default_rng(3)
    scene = 10 ** rng.uniform(3.5, 5.8, shape)
    files = []
    for (stated, _), error in zip(TIMES.items(), errors, strict=True):
        electrons = rng.poisson(scene * float(stated) * error / GAIN)
        counts = np.clip(np.rint(electrons * GAIN + rng.normal(0, READ_DN, shape) + BLACK), 0, CLIP)
        meta = DngMeta(
            shutter_s=Fraction(stated),
            black_dn=(BLACK,) * 4,
            white_dn=CLIP,
            serial="A1",
            description={"gonio": 1, "shot_id": f"s{stated}", "exposure_s": stated, "camera_serial": "A1"},
        )
        path = folder / f"f_{stated}.dng"
        write_dng(path, counts.astype(np.uint16), meta)
        files.append(str(path))
    return files, scene


def sensor_file(folder: Path) -> str:
    """Write the bracket's noise model."""
    path = folder / "sensor.toml"
    path.write_text(f"gain_dn_per_e = {GAIN}\nread_noise_dn = {READ_DN}\nclip_dn = {CLIP}\n")
    return str(path)


def run_json(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    """Run a command with --json and read its one object."""
    assert main([*arguments, "--json"]) == 0
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    return answer


def test_bracket_is_merged_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Would catch outputs in another unit or shape, times fitted without need, or a lost sensor model."""
    files, scene = bracket(tmp_path)
    out, picture = tmp_path / "r.npz", tmp_path / "r.png"
    arguments = ("merge", *files[::-1], "--sensor", sensor_file(tmp_path))
    answer = run_json(capsys, *arguments, "--out", str(out), "--preview", str(picture))
    assert answer["estimator"] == "maximum likelihood"
    assert answer["note"] == ""
    assert answer["times"] == "nominal"
    assert [row["used_s"] for row in answer["exposures"]] == [0.01, 0.04, 0.16]
    with np.load(out) as merged:
        assert set(merged) == {
            *("radiance", "variance", "flags", "exposure_s", "exposure_nominal_s"),
            *("clip_dn", "cfa", "channels", "files", "chi_square", "samples"),
        }
        several = merged["samples"] > 1
        reduced = merged["chi_square"][several] / (merged["samples"][several] - 1.0)
        assert reduced.mean() == pytest.approx(1.0, abs=0.03)
        good = merged["flags"] == 0
        pull = (merged["radiance"] - scene)[good] / np.sqrt(merged["variance"][good])
        assert merged["files"].tolist() == files
    assert pull.std() == pytest.approx(1.0, abs=0.03)
    assert abs(pull.mean()) < 0.03
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_wrong_times_are_measured_and_mended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Would catch times fitted the wrong way round, or not used."""
    errors = (1.02, 0.99, 1.0)
    files, scene = bracket(tmp_path, errors)
    answer = run_json(capsys, "merge", *files, "--sensor", sensor_file(tmp_path))
    assert answer["times"] == "fitted"
    for row, before, after in zip(answer["ratios"], errors[:-1], errors[1:], strict=True):
        true = row["nominal"] * after / before
        assert row["measured"] == pytest.approx(true, rel=2e-3)
        assert abs(row["measured"] - true) < 4 * row["u"]
    assert answer["agreement"]["median"] < 0.012
    kept = run_json(capsys, "merge", *files, "--times", "nominal")
    assert kept["times"] == "nominal"
    assert "Poisson" in kept["note"]
    assert scene.size > 0


def test_table_for_people(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Would catch a crash of the table, or no word about the missing noise model."""
    files, _ = bracket(tmp_path)
    assert main(["merge", *files]) == 0
    text = capsys.readouterr().out
    assert "no noise model of the sensor" in text
    assert "stated times confirmed" in text
    assert "OVER_RANGE" in text


def test_inspection_merges_nothing_and_tells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Would catch findings lost on the way to the person or the script."""
    files, _ = bracket(tmp_path)
    answer = run_json(capsys, "merge", "--inspect", *files)
    assert [Path(fact["path"]).name for fact in answer["frames"]] == [Path(file).name for file in files]
    assert answer["findings"] == []
    copy = tmp_path / "copy.dng"
    copy.write_bytes(Path(files[0]).read_bytes())
    assert main(["merge", "--inspect", *files, str(copy)]) == 0
    printed = capsys.readouterr().out
    assert "same picture" in printed
    assert "14 bits in use" in printed


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        ("disks_450nm_0250ms.dng", 0.25),
        ("d1_dark_3916ms_2019-02-08-171307-0003.tif", 3.916),
        ("a_2s.tif", 2.0),
        ("a-1.5s-b.tif", 1.5),
        ("a_250us.tif", 250e-6),
        ("disks_450nm.dng", None),
        ("a_0ms.tif", None),
        ("a_10ms_20ms.tif", None),
        ("IMG_0250.nef", None),
    ],
)
def test_exposure_in_a_name(name: str, seconds: float | None) -> None:
    """Would catch a wavelength or a counter taken for a time, and an ambiguous name guessed at."""
    assert exposure_from_name(name) == (None if seconds is None else pytest.approx(seconds))


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Would catch a traceback, or exit code 0, for what people get wrong."""
    import tifffile

    files, _ = bracket(tmp_path)
    nameless = tmp_path / "scene.tif"
    tifffile.imwrite(nameless, np.zeros((192, 256), np.uint16))
    half = tmp_path / "half.dng"
    half.write_bytes((tmp_path / "f_0.01.dng").read_bytes()[:5000])
    for arguments, named in (
        ([str(nameless)], "--exposure-s"),
        ([*files, "--exposure-s", "1,2"], "2 exposure times for 3 files"),
        ([*files, "--exposure-s", "a,b,c"], "not a list of seconds"),
        ([files[0], str(half)], "half.dng"),
        ([files[0], files[0]], "twice"),
        ([*files, "--dark", str(nameless)], "scene.tif"),
        ([*files, "--sensor", str(tmp_path / "none.toml")], "none.toml"),
        ([*files, "--out", "merged.txt"], "merged.txt.npz"),
        ([str(tmp_path)], "not a session"),
        ([str(tmp_path / "absent.dng")], "absent.dng"),
    ):
        assert main(["merge", *arguments]) == 2
        streams = capsys.readouterr()
        assert named in streams.err
        assert streams.err.count("\n") == 1
        assert streams.out == ""


def dark_file(path: Path, level: NDArray[np.float64] | float, seed: int = 0, **changes: Any) -> str:
    """Write a dark of the bracket's camera, with noise about a level."""
    rng = np.random.default_rng(seed)
    counts = np.clip(np.rint(rng.normal(BLACK, READ_DN, (192, 256)) + level), 0, CLIP).astype(np.uint16)
    meta = {"shutter_s": Fraction("0.01"), "black_dn": (BLACK,) * 4, "white_dn": CLIP, "serial": "A1"}
    write_dng(path, counts, DngMeta(**{**meta, **changes}))
    return str(path)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"serial": "B2"}, "camera serial is B2"),
        ({"model": "other"}, "camera model is gonio other"),
        ({"iso": 800}, "ISO is 800"),
        ({"description": {"gonio": 1, "lit": True, "exposure_s": "0.04"}}, "the lamp was on"),
    ],
)
def test_darks_of_another_camera_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, Any], named: str
) -> None:
    """Would catch the darks of another camera, setting or lamp subtracted without a word."""
    files, _ = bracket(tmp_path)
    darks = [dark_file(tmp_path / f"d{n}.dng", 0.0, n) for n in range(3)]
    assert main(["merge", *files, "--dark", *darks]) == 0
    capsys.readouterr()
    assert main(["merge", *files, "--dark", *darks, dark_file(tmp_path / "odd.dng", 0.0, **changes)]) == 2
    error = capsys.readouterr().err
    assert named in error
    assert "odd.dng" in error


@pytest.mark.parametrize("light", ["even", "scene", "faint scene"])
def test_light_in_a_dark_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str], light: str) -> None:
    """Would catch a cap that was off, or leaks, subtracted as if it were the sensor's own level."""
    rows, cols = np.mgrid[0:192, 0:256]
    scene = 4e3 * np.exp(-((rows - 90) ** 2 + (cols - 150) ** 2) / 3e3)
    files = []
    for seconds in ("0.04", "0.16"):
        counts = np.random.default_rng(1).poisson(scene * float(seconds) * 50 / GAIN) * GAIN + BLACK
        path = tmp_path / f"lit_{seconds}.dng"
        meta = DngMeta(Fraction(seconds), (BLACK,) * 4, CLIP, serial="A1")
        write_dng(path, np.clip(np.rint(counts), 0, CLIP).astype(np.uint16), meta)
        files.append(str(path))
    leaks = {"even": np.full(scene.shape, 4e3), "scene": 0.1 * scene, "faint scene": 0.001 * scene}
    good = dark_file(tmp_path / "good.dng", 0.02 * cols)  # a gradient of its own
    assert main(["merge", *files, "--dark", good]) == 0
    capsys.readouterr()
    assert main(["merge", *files, "--dark", dark_file(tmp_path / "lit_dark.dng", leaks[light])]) == 2
    error = capsys.readouterr().err
    assert "light fell on it" in error
    assert "lit_dark.dng" in error


@pytest.mark.parametrize("number", [1, 3])
@pytest.mark.parametrize("stated", [CLIP, 65535])
def test_bracket_clipped_everywhere_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], number: int, stated: int
) -> None:
    """Would catch a lower bound written as a measurement, whatever clip level the files claim."""
    files = []
    for index in range(number):
        files.append(str(tmp_path / f"{index}.dng"))
        meta = DngMeta(Fraction(4**index, 100), (BLACK,) * 4, stated, serial="A1")
        write_dng(files[-1], np.full((192, 256), 16383, np.uint16), meta)
    assert main(["merge", *files]) == 2
    error = capsys.readouterr().err
    assert "every pixel is clipped" in error
    assert "0.dng" in error


def test_session_is_merged_pose_by_pose(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch darks of the session left out, white and sample mixed up, or dark frames merged."""
    from capture.sensor import load_sensor
    from capture.session import FrameRecord, PoseRecord, Session, hash_file

    files, scene = bracket(tmp_path)
    folder = tmp_path / "session"
    folder.mkdir()
    frames = tuple(
        FrameRecord(Path(file), f"s{index}", seconds, lit=True, sha256=hash_file(file))
        for index, (file, seconds) in enumerate(zip(files, (0.01, 0.04, 0.16), strict=True))
    )
    poses = [
        PoseRecord(index, None, role, (), (), frames, SimpleNamespace(), complete=True)  # type: ignore[arg-type]
        for role, index in (("sample", 4), ("white", 4))
    ]
    fake = SimpleNamespace(
        folder=folder,
        sensor=load_sensor(sensor_file(tmp_path)),
        hot_pixels=None,
        poses=lambda role: [pose for pose in poses if pose.role == role],
    )
    monkeypatch.setattr(Session, "open", lambda _: _Context(fake))
    answer = run_json(capsys, "merge", str(folder))
    assert [(row["pose"], row["role"], row["frames"]) for row in answer["poses"]] == [
        (4, "sample", 3),
        (4, "white", 3),
    ]
    with np.load(folder / "radiance" / "white_0004.npz") as merged:
        good = merged["flags"] == 0
        assert np.median(merged["radiance"][good] / scene[good]) == pytest.approx(1.0, abs=1e-3)


class _Context:
    """A fake session in a with block."""

    def __init__(self, session: Any) -> None:
        self.session = session

    def __enter__(self) -> Any:
        return self.session

    def __exit__(self, *_: object) -> None:
        return


@pytest.mark.realdata
def test_flea3_disks_at_450_nm(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Would catch any change by which a real bracket no longer agrees with itself."""
    answer = run_json(capsys, *_flea3(shared_data, "disks", 450))
    measured = {_label(row): row for row in answer["ratios"]}
    for label, true in TRUE_RATIOS.items():
        assert measured[label]["measured"] == pytest.approx(true, rel=0.012)
        assert 0 < measured[label]["u"] < 0.02
    assert answer["agreement"]["range_dn"] == [60, 240]
    assert answer["agreement"]["median"] < 0.015
    assert answer["agreement"]["clean_median"] < 0.0115  # 1.08 % by the frames' own noise
    assert all(frame["median"] < 0.015 for frame in answer["agreement"]["frames"])
    assert 20 < answer["hot_pixels"] < 200
    assert answer["flags"]["HOT"] == answer["hot_pixels"]
    assert answer["dark"]["matched"]
    assert answer["clip_dn"] == [255] * 4


@pytest.mark.realdata
@pytest.mark.parametrize("band", [450, 550, 650])
@pytest.mark.parametrize("scene", ["disks", "colorchecker"])
def test_flea3_other_scenes(
    shared_data: Path, capsys: pytest.CaptureFixture[str], scene: str, band: int
) -> None:
    """Would catch an estimator that fits one scene only; times come from the names of the TIFFs."""
    answer = run_json(capsys, *_flea3(shared_data, scene, band))
    source = "file" if scene == "disks" else "file name"
    assert {row["source"] for row in answer["exposures"]} == {source}
    assert answer["agreement"]["median"] < 0.015
    assert answer["agreement"]["clean_median"] < (0.0115 if (scene, band) == ("disks", 450) else 0.01)
    for row in answer["ratios"]:
        if row["measured"] is not None and row["clean"]:
            true = TRUE_RATIOS.get(_label(row), 0.98 * row["nominal"])
            assert row["measured"] == pytest.approx(true, rel=0.025)


@pytest.mark.realdata
def test_flea3_beside_clipped_green(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Would catch samples that read low beside clipped green entering the merge, as they did."""
    answer = run_json(capsys, *_flea3(shared_data, "disks", 550))
    long = answer["agreement"]["frames"][-2]
    assert -0.03 < long["median_signed"] < -0.012  # all its samples are beside clipped green
    assert long["clean_samples"] == 0
    # Most have nothing else than a few counts in the short frames: used after all, and flagged.
    assert answer["flags"]["NEIGHBOUR_CLIPPED"] > answer["flags"]["NEAR_CLIPPED_USED"] + 1000
    clean = [frame["median_signed"] for frame in answer["agreement"]["frames"][:3]]
    assert all(abs(value) < 0.003 for value in clean)


def _flea3(shared_data: Path, scene: str, band: int) -> list[str]:
    folder = shared_data / "flea3"
    day = "d1" if scene == "disks" else "d2"
    files = sorted(str(path) for path in (folder / scene).glob(f"*_{band}nm_*"))
    darks = sorted(str(path) for path in (folder / "dark").glob(f"{day}_*"))
    return ["merge", *files, "--dark", *darks]


def _label(row: dict[str, Any]) -> str:
    ends = (exposure_from_name(row[end]) for end in ("shorter", "longer"))
    return ":".join(f"{1000 * (seconds or 0):.0f}" for seconds in ends)


def test_bench_runs_a_part_of_the_checkout(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch rows lost, a missed target passing as success, or a traceback without a checkout."""
    from gonio.commands import bench

    part = tmp_path / "speed.py"
    part.write_text(
        "def run(plots):\n"
        "    row = {'name': 'a', 'value': 1.0, 'unit': 's', 'target': 2.0, 'ok': True}\n"
        "    return [row, {**row, 'name': 'b', 'ok': plots is not None}]\n"
    )
    monkeypatch.setattr(bench, "_folder", lambda: tmp_path)
    assert main(["bench", "speed", "--json"]) == 1
    rows = json.loads(capsys.readouterr().out)["results"]
    assert [(row["name"], row["ok"]) for row in rows] == [("a", True), ("b", False)]
    assert main(["bench", "--plots", str(tmp_path / "plots")]) == 0
    assert "target 2" in capsys.readouterr().out
    assert main(["bench", "sped"]) == 2
    assert "there are: speed" in capsys.readouterr().err
    monkeypatch.undo()
    monkeypatch.setattr(bench, "__file__", str(tmp_path / "a" / "b" / "c.py"))
    assert main(["bench", "speed"]) == 2
    assert "checkout" in capsys.readouterr().err
