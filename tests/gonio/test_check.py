"""`gonio check`: one JSON object, exit codes, and the published cosine named."""

from __future__ import annotations

import json

import pytest

from gonio import cli

TABLE = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,f_r\n30,0,45,180,0.25\n0,0,10,90,-0.5\n"


def test_json(tmp_path, capsys):
    """Catches anything but one object on standard output, and NaN in it."""
    path = tmp_path / "table.csv"
    path.write_text(TABLE)
    assert cli.main(["check", str(path), "--json"]) == 3  # half of the values are negative
    (entry,) = json.loads(capsys.readouterr().out)["files"]
    assert entry["verdict"] == "fail"
    checks = {one["name"]: one for one in entry["checks"]}
    assert checks["negatives"]["value"] == 0.5
    assert checks["negatives"]["verdict"] == "fail"
    assert checks["reciprocity"]["value"] is None
    assert checks["reciprocity"]["verdict"] == "not tested"


def test_damaged_file_is_one_line(tmp_path, capsys):
    """Catches a traceback, or an error that does not name line and column."""
    path = tmp_path / "table.csv"
    path.write_text(TABLE.replace("-0.5", "nan"))
    assert cli.main(["check", str(path)]) == 2
    assert "line 3, column f_r" in capsys.readouterr().err


@pytest.mark.realdata
def test_the_published_cosine_for_people(shared_data, capsys):
    """Catches a page that does not say what is wrong, how much, and where."""
    path = str(shared_data / "mwir" / "radiance.csv")
    assert cli.main(["check", path, "--material", "Kupfer", "--as-published"]) == 3
    page = capsys.readouterr().out
    assert "cos(theta_o) seems to be inside: without it 7.4%" in page
    assert cli.main(["check", path, "--material", "Kupfer"]) == 0
    assert cli.main(["check", path]) == 2
    assert "choose with --material" in capsys.readouterr().err
