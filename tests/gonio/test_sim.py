"""`gonio sim` as a person and as a script start it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the twin's ports need Linux")

KEYS = ["servos", "baud", "ids", "lamp", "frames", "rig"]


def start(*options: str) -> subprocess.Popen[str]:
    """Start the command as from a script: no terminal, nothing on standard input."""
    return subprocess.Popen(
        [sys.executable, "-m", "gonio.cli", "sim", *options],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_it_prints_one_object_and_serves_until_a_signal(sent: signal.Signals, code: int) -> None:
    """Catches a sim that ends with its standard input, prints more than the object, or exits wrongly."""
    with start("--json", "--no-log") as process:
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        assert list(ready) == KEYS
        assert ready["ids"] == [1, 2, 3, 4, 5]
        assert Path(ready["servos"]).exists()
        assert Path(ready["rig"]).exists()
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.3)
        process.send_signal(sent)
        rest, errors = process.communicate(timeout=10.0)
    assert process.returncode == code
    assert rest == ""
    assert "Traceback" not in errors
    assert not Path(ready["rig"]).parent.exists()


def test_a_person_reads_ports_and_how_to_stop(tmp_path: Path) -> None:
    """Catches output that leaves a person without the ports, the rig file, or the way out."""
    with start("--folder", str(tmp_path / "twin"), "--seed", "3") as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(5)]
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=10.0)
    text = "".join(lines)
    for word in ("servos", "lamp", "frames", "rig.toml", "Ctrl-C", str(tmp_path / "twin")):
        assert word in text
    assert (tmp_path / "twin" / "rig.toml").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--station", "sample1"], "NAME=MATERIAL"),
        (["--station", "sample1=nonsense:kd=1"], "nonsense"),
        (["--rig", "/nonexistent.toml"], "/nonexistent.toml"),
        (["--speed", "-1"], "speed"),
    ],
)
def test_what_it_cannot_use_is_one_line_and_exit_code_2(options: list[str], said: str) -> None:
    """Catches a traceback, or exit code 0, for an option that cannot be used."""
    with start("--json", *options) as process:
        output, errors = process.communicate(timeout=30.0)
    assert process.returncode == 2
    assert output == ""
    assert said in errors
    assert len([line for line in errors.splitlines() if line.startswith("gonio sim:")]) == 1
    assert "Traceback" not in errors


def test_explain_tells_what_is_computed_and_what_is_skipped() -> None:
    """Would catch a decision that nobody can look at, or text where JSON was asked for."""
    asked = [
        "--explain",
        "--json",
        "--material",
        "lambert:kd=0.3",
        "--housing-albedo",
        "0.04",
        "--poses",
        "1",
    ]
    command = [sys.executable, "-m", "gonio.cli", "sim", *asked, "--tolerance", "0.1"]
    answer = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    (pose,) = answer["materials"]["lambert:kd=0.3"]["poses"]
    assert [row["paths"] for row in pose["classes"]][:2] == ["LDlE", "LDlDlE"]
    assert pose["classes"][0]["method"]
    assert pose["classes"][-1]["method"] is None
    assert 0.0 < pose["skipped_bound"] <= 0.05


@pytest.mark.parametrize(
    "options",
    [
        ["--explain", "--stray"],
        ["--explain", "--tolerance", "0"],
        ["--stray", "--poses", "0"],
        ["--stray", "--housing-albedo", "1.5"],
        ["--housing-albedo", "1.5"],
        ["--tolerance", "0"],
        ["--explain", "--material", "lambrt:kd=0.5"],
        ["--explain", "--mirror", "round:radius_mm=3"],
        ["--explain", "--mirror", "spherical:vertex_mm=-96/0/72,facing=0/0/0,radius_mm=120,rim_mm=50"],
        ["--explain", "--mirror", "planar:centre_mm=a/b/c"],
    ],
)
def test_a_question_that_makes_no_sense_is_one_line(options: list[str]) -> None:
    """Would catch a traceback, or an answer to another question."""
    command = [sys.executable, "-m", "gonio.cli", "sim", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
