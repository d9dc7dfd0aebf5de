"""`gonio reduce` and `gonio report` from outside: what is refused, and how; test_demo goes the whole way."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from analysis.samples import read
from gonio import cli
from gonio.commands import reduce
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    from rig.description import Rig


def _gonio(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "gonio.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("reduce", "{empty}"), "not a session"),
        (("reduce", "{missing}"), "not a session"),
        (("reduce", "{empty}", "--bin-px", "7"), "--bin-px"),
        (("reduce", "{empty}", "--bin-px", "0"), "--bin-px"),
        (("reduce", "{empty}", "--without", "flat-field,straylight"), "--without"),
        (("reduce", "{empty}", "--recipe", "rt300s", "--without", "linearity"), "--without"),
        (("reduce", "{empty}", "--max-theta-deg", "90"), "--max-theta-deg"),
        (("report", "{empty}"), "not a session"),
        (("report", "{missing}", "--json"), "not a session"),
    ],
)
def test_bad_input_is_one_line(tmp_path: Path, arguments: tuple[str, ...], named: str) -> None:
    """Catches tracebacks, and messages that do not name what is wrong."""
    folders = {"empty": str(tmp_path), "missing": str(tmp_path / "missing")}
    done = _gonio(*(argument.format(**folders) for argument in arguments))
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert named in done.stderr


def test_bins_fit_into_the_frames(default_rig: Rig) -> None:
    """Catches bins larger than a frame, of which there are none to reduce."""
    reduce._require_bins(96, default_rig)
    with pytest.raises(BadInput, match=r"--bin-px.*give 96 or less"):
        reduce._require_bins(98, default_rig)


@pytest.mark.parametrize("command", ["reduce", "report", "demo"])
def test_help_shows_an_example_and_loads_nothing_heavy(command: str) -> None:
    """Catches a help page without an example, and imports that make it slow."""
    probe = (
        "import sys; from gonio.cli import main\n"
        "try: main([sys.argv[1], '--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'xarray', 'mitsuba', 'matplotlib', 'pydantic', 'colour'} & set(sys.modules)\n"
        "sys.exit(f'loaded {sorted(heavy)}' if heavy else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", probe, command], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert f"gonio {command}" in done.stdout.split("example:")[1]


def test_a_recipe_tells_doubts_of_its_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a torn table that a recipe reduces without a word, or whose samples forget it."""
    table = tmp_path / "plane.csv"
    rows = "".join(f"30,{view},0.{view + 10}\n" for view in range(10, 60, 5))
    table.write_text("theta_i_deg,theta_o_deg,radiance_L_o\n" + rows.rstrip("\n"))
    out = tmp_path / "samples.nc"
    arguments = ["reduce", str(table), "--recipe", "mwir-published", "--out", str(out), "--json"]
    assert cli.main(arguments) == 0
    said = capsys.readouterr()
    assert "caution" in said.err
    assert "plane.csv: the last line has no end" in json.loads(said.out)["doubts"]
    assert "no end" in read(out).attrs["doubts"]
