"""Samples written over by `gonio reduce` and `gonio convert`: rejections stay, or nothing changes."""

from __future__ import annotations

import shutil
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from analysis.rejection import REJECTED, log_of
from analysis.samples import make_samples, read, write
from gonio.cli import main
from rig.angles import spherical_to_direction

COUNT = 30


def _samples(scale=1.0, count=COUNT):
    wi = spherical_to_direction(np.full(count, 0.5), np.pi)
    wo = spherical_to_direction(np.linspace(0.01, 1.4, count), np.linspace(-0.5, 0.5, count))
    return make_samples(wi, wo, scale * np.linspace(0.1, 0.2, count))


def _by_convert(folder, monkeypatch, samples):
    write(samples, folder / "in.csv")
    return ["convert", "in.csv"]


def _by_recipe(folder, monkeypatch, samples):
    done = SimpleNamespace(samples=samples, notes=(), repeatability=None)
    monkeypatch.setattr("analysis.recipes.reduce_files", lambda *_, **__: done)
    return ["reduce", "raw.xls", "--recipe", "rt300s", "--out"]


def _by_session(folder, monkeypatch, samples):
    from capture.session import Session

    camera = SimpleNamespace(width_px=96, height_px=64)
    rig = SimpleNamespace(camera=camera)
    session = SimpleNamespace(rig=rig, poses=lambda _: [], edited_files=list)
    monkeypatch.setattr(Session, "open", lambda _: nullcontext(session))
    numbered = samples.assign(pose=("sample", np.zeros(samples.sizes["sample"], dtype=int)))
    monkeypatch.setattr("analysis.reduce.reduce_session", lambda *_, **__: numbered)
    return ["reduce", str(folder), "--out"]


@pytest.fixture(params=[_by_convert, _by_recipe, _by_session])
def command(request, tmp_path, monkeypatch):
    """Return what makes each command write given samples to `samples.nc`, of which some are rejected."""
    monkeypatch.chdir(tmp_path)
    write(_samples(), tmp_path / "samples.nc")
    reject = ["check", "samples.nc", "--reject", "3,7-8", "--reason", "stray light", "--author", "Ada"]
    assert main(reject) == 0
    return lambda samples: request.param(tmp_path, monkeypatch, samples)


def test_rejections_stay(command, tmp_path, capsys):
    """Catches a command that writes over a person's decisions, or keeps the old values with them."""
    order = np.arange(COUNT)[::-1]
    arguments = command(_samples(1.5).isel(sample=order))
    assert main([*arguments, "samples.nc"]) == 0
    assert "the rejections in samples.nc are kept" in capsys.readouterr().err
    after = read(tmp_path / "samples.nc")
    np.testing.assert_allclose(np.sort(after["f_r"].to_numpy()[:, 0]), 1.5 * np.linspace(0.1, 0.2, COUNT))
    assert log_of(after)[0].author == "Ada"
    rejected = after["f_r"].to_numpy()[(after["flags"].to_numpy() & REJECTED) > 0]
    np.testing.assert_allclose(np.sort(rejected), 1.5 * np.linspace(0.1, 0.2, COUNT)[[3, 7, 8]])


def test_refused_before_anything_is_written(command, tmp_path, capsys):
    """Catches other samples written over them unasked, more than one line, and a person's wish ignored."""
    before = (tmp_path / "samples.nc").read_bytes()
    arguments = [*command(_samples(count=COUNT - 1)), "samples.nc"]
    capsys.readouterr()
    assert main(arguments) == 3
    said = capsys.readouterr()
    assert said.out == ""
    assert [line for line in said.err.splitlines() if "--drop-rejections" in line] == said.err.splitlines()
    assert (tmp_path / "samples.nc").read_bytes() == before
    assert main([*arguments, "--drop-rejections"]) == 0
    assert log_of(read(tmp_path / "samples.nc")) == []


def test_a_damaged_file_may_hold_rejections(command, tmp_path, capsys):
    """Catches a file that is written over because it cannot be read."""
    content = (tmp_path / "samples.nc").read_bytes()
    (tmp_path / "samples.nc").write_bytes(content[: len(content) // 2])
    arguments = [*command(_samples()), "samples.nc"]
    assert main(arguments) == 3
    assert "whether it holds rejections is not known" in capsys.readouterr().err
    assert main([*arguments, "--drop-rejections"]) == 0


def test_a_format_without_a_place_for_them(command, tmp_path, capsys):
    """Catches a store under another name that becomes a table."""
    shutil.copy(tmp_path / "samples.nc", tmp_path / "samples.csv")
    arguments = [*command(_samples()), "samples.csv"]
    assert main(arguments) == 3
    assert "no place" in capsys.readouterr().err
    assert log_of(read(tmp_path / "samples.csv"))


def test_a_reading_is_not_written_over_them(tmp_path, monkeypatch, capsys):
    """Catches a re-reading that writes over decisions about other directions, and an option without sense."""
    monkeypatch.chdir(tmp_path)
    write(_samples(), tmp_path / "samples.nc")
    write(_samples(), tmp_path / "table.csv")
    reject = ["check", "samples.nc", "--reject", "3", "--reason", "stray light", "--author", "Ada"]
    assert main(reject) == 0
    before = (tmp_path / "samples.nc").read_bytes()
    other = ["check", "table.csv", "--reading", "light-view", "--out", "samples.nc"]
    assert main(other) == 3
    assert "--drop-rejections" in capsys.readouterr().err
    assert (tmp_path / "samples.nc").read_bytes() == before
    assert main(["check", "table.csv", "--drop-rejections"]) == 2
    assert main([*other, "--drop-rejections"]) == 0
    assert log_of(read(tmp_path / "samples.nc")) == []
