"""`gonio check`: one JSON object, exit codes, the published cosine named, readings, rejections, the page."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from analysis.models import MODELS
from analysis.samples import make_samples, read, write
from gonio import cli
from rig.angles import spherical_to_direction

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


def _paint(path):
    theta, phi = np.meshgrid(np.radians(np.arange(5.0, 80.0, 10.0)), np.radians(np.arange(0.0, 360.0, 30.0)))
    wi = spherical_to_direction(np.repeat(np.radians([15.0, 25.0, 45.0]), theta.size), 0.0)
    wo = np.tile(spherical_to_direction(theta.ravel(), phi.ravel()), (3, 1))
    f_r = MODELS["ggx"](kd=0.2, ks=1.0, alpha=0.3, f0=0.06).evaluate(wi, wo)
    write(make_samples(wi, wo, f_r), path)
    return len(wi)


def test_conventions_ranked_and_re_read(tmp_path, capsys):
    """Catches a ranking without numbers, a file changed unasked, and a re-reading that is not recorded."""
    path, cured = tmp_path / "paint.csv", tmp_path / "cured.nc"
    _paint(path)
    right = read(path)
    head, *lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    rows = [line.split(",") for line in lines]
    path.write_text("\n".join([head, *(",".join([r[1], r[0], r[3], r[2], *r[4:]]) for r in rows)]) + "\n")
    before = path.read_bytes()
    assert cli.main(["check", str(path), "--conventions", "--json"]) == 0
    (entry,) = json.loads(capsys.readouterr().out)["files"]
    best = entry["conventions"]["readings"][0]
    assert entry["conventions"]["decided"]
    assert (best["reading"], best["log_odds"], best["above_horizon"]) == ("zenith-azimuth", 0.0, 1.0)
    assert cli.main(["check", str(path), "--conventions"]) == 0
    assert "zenith and azimuth are exchanged" in capsys.readouterr().out
    assert cli.main(["check", str(path), "--reading", "zenith-azimuth", "--out", str(cured)]) == 0
    capsys.readouterr()
    assert path.read_bytes() == before
    again = read(cured)
    np.testing.assert_allclose(again["wo"], right["wo"], atol=1e-12)
    assert again.attrs["reading"] == "zenith-azimuth"
    assert cli.main(["check", str(path), "--reading", "zenith-azimuth"]) == 2
    assert cli.main(["check", str(path), "--conventions", "--restore", "1"]) == 2


def test_rejected_and_restored(tmp_path, capsys):
    """Catches a rejection that is not in the file, that nobody signed, or that cannot be taken back."""
    path = tmp_path / "paint.nc"
    count = _paint(path)
    reject = ["check", str(path), "--reject", "theta_o=70..90", "--author", "Ada"]
    assert cli.main(reject) == 2
    assert "--reason" in capsys.readouterr().err
    assert cli.main([*reject, "--reason", "rail in the beam"]) == 0
    assert "Ada rejects theta_o=70..90: rail in the beam" in capsys.readouterr().out
    assert np.count_nonzero(read(path)["flags"]) == count / 8
    assert cli.main(["check", str(path), "--json"]) == 0
    (entry,) = json.loads(capsys.readouterr().out)["files"]
    assert entry["rejections"][0]["author"] == "Ada"
    assert cli.main(["check", str(path), "--restore", "1", "--author", "Bo"]) == 0
    assert not np.any(read(path)["flags"])
    table = tmp_path / "table.csv"
    table.write_text(TABLE)
    assert cli.main(["check", str(table), "--reject", "1", "--reason", "x"]) == 3
    assert "convert it to .nc first" in capsys.readouterr().err


def test_page(tmp_path, capsys):
    """Catches a page that lacks a finding, a picture or the readings, or that links to the outside."""
    path, page = tmp_path / "paint.nc", tmp_path / "check.html"
    _paint(path)
    assert cli.main(["check", str(path), "--html", str(page)]) == 0
    text = page.read_text()
    assert text.count("<figure>") == 2
    assert "mirror symmetry" in text
    assert "The conventions are as declared" in text
    assert "http" not in re.sub(r"data:[^\"]+", "", text)
    capsys.readouterr()


@pytest.mark.realdata
def test_emissivity_of_values_that_no_isotropic_surface_has_is_refused(shared_data, capsys):
    """Catches an emissivity that is compared with an albedo nobody measured."""
    folder = shared_data / "mwir"
    options = ["--material", "Kupfer", "--emissivity", str(folder / "emissivity.csv")]
    assert cli.main(["check", str(folder / "radiance.csv"), *options]) == 0
    assert "refused: an isotropic surface with these values would reflect" in capsys.readouterr().out


def test_undecided_conventions_say_what_would_decide(tmp_path, capsys):
    """Catches a person left alone with readings that the samples do not tell apart, or with a torn file."""
    path = tmp_path / "plane.csv"
    theta = np.radians(np.linspace(2.0, 80.0, 60))
    wi, wo = spherical_to_direction(np.full(60, 0.5), np.pi), spherical_to_direction(theta, 0.0)
    noise = np.exp(0.05 * np.random.default_rng(0).standard_normal((60, 1)))
    write(make_samples(wi, wo, 0.2 / np.pi * noise), path)
    path.write_text(path.read_text().rstrip("\n"))
    assert cli.main(["check", str(path), "--conventions"]) == 0
    said = capsys.readouterr()
    assert "does not decide" in said.out
    assert "to decide, measure in the same way: a white reference" in said.out
    assert "nothing was changed" in said.out
    assert "caution" in said.err
    assert "no end" in said.err
    out = tmp_path / "read.nc"
    assert cli.main(["check", str(path), "--reading", "cosine-of-view", "--out", str(out), "--json"]) == 0
    said = capsys.readouterr()
    assert "no end" in json.loads(said.out)["doubts"]
    assert "no end" in read(out).attrs["doubts"]
