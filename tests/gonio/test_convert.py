"""`gonio convert`: what is written, what is told of its loss, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from analysis.samples import make_samples, read, write
from gonio.cli import main
from rig.angles import spherical_to_direction


def _samples(incidences_deg=(10.0, 40.0, 70.0), seed=1, **extra):
    grid = np.meshgrid(incidences_deg, [5.0, 20.0, 40.0, 60.0], np.arange(12) * 30.0, indexing="ij")
    theta_i, theta_o, phi_o = np.radians([axis.ravel() for axis in grid])
    values = np.random.default_rng(seed).uniform(0.1, 0.3, (theta_i.size, 1))
    return make_samples(
        spherical_to_direction(theta_i, 0.3 + 0.0 * theta_i),
        spherical_to_direction(theta_o, phi_o),
        values,
        wavelength_nm=[550.0],
        **extra,
    )


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a working folder with one file of samples."""
    monkeypatch.chdir(tmp_path)
    write(_samples(u_noise=0.01), tmp_path / "paint.nc")
    return tmp_path


def _json(capsys, *arguments):
    assert main(["convert", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("name", ["out.csv", "out.astm", "out.ssdd", "out.nc"])
def test_formats_of_samples_give_them_back(folder, capsys, name):
    """Catches a loss that is claimed, not read from the file, and a variable that is left out in silence."""
    told = _json(capsys, "paint.nc", name)
    assert told["written"] == told["samples"] == 144
    assert told["loss"]["worst_relative"] < 1e-12
    assert (told["loss"]["dropped"] == []) == (name == "out.nc")
    assert ("u_noise" in told["loss"]["dropped"]) == (name != "out.nc")
    back = read(folder / name)
    np.testing.assert_allclose(
        np.sort(back["f_r"], axis=None), np.sort(_samples()["f_r"], axis=None), rtol=1e-12
    )


def test_a_change_that_the_writer_does_not_know_is_told(folder, capsys, monkeypatch):
    """Catches a loss that only repeats what the writer believes: here it rounds and says nothing."""
    from analysis.formats import csv
    from analysis.formats.loss import unchanged

    honest = csv.write

    def rounding(samples, path):
        honest(samples.assign(f_r=samples["f_r"].round(2)), path)
        return unchanged(samples, samples.sizes["sample"])

    monkeypatch.setattr(csv, "write", rounding)
    assert 0.005 < _json(capsys, "paint.nc", "out.csv")["loss"]["worst_relative"] < 0.05


def test_holes_are_not_filled_unless_that_is_asked_for(folder, capsys):
    """Catches guesses written as measurements, and half of a file left behind by the refusal."""
    assert main(["convert", "paint.nc", "out.zemax.bsdf"]) == 3
    assert "--fill" in capsys.readouterr().err
    assert [path.name for path in folder.iterdir()] == ["paint.nc"]
    told = _json(capsys, "paint.nc", "out.zemax.bsdf", "--fill")
    assert 0.0 < told["loss"]["filled_part"] < 1.0
    assert told["loss"]["worst_relative"] > 0.0


def test_several_files_become_one(folder, capsys):
    """Catches groups of errors that fall together, lost samples, and channels that do not belong together."""
    write(_samples([20.0], pose=np.arange(48), u_noise=0.01), folder / "a.nc")
    write(_samples([50.0], seed=2, pose=np.arange(48)), folder / "b.nc")
    told = _json(capsys, "a.nc", "b.nc", "both.nc")
    assert told["samples"] == 96
    assert set(told["loss"]["dropped"]) == {"u_noise", "u_f_r"}
    both = read(folder / "both.nc")
    assert len(np.unique(both["pose"])) == 96
    np.testing.assert_array_equal(both["f_r"][48:], read(folder / "b.nc")["f_r"])
    write(_samples().assign_coords(wavelength_nm=("channel", [600.0])), folder / "red.nc")
    assert main(["convert", "a.nc", "red.nc", "c.nc"]) == 2
    assert "red.nc" in capsys.readouterr().err


def test_pab_writes_a_folder(folder, capsys):
    """Catches several incidences squeezed into a format that holds one."""
    told = _json(capsys, "paint.nc", "pab", "--to", "pab")
    assert len(told["out"]) == 3
    assert told["written"] == 144
    assert told["loss"]["worst_relative"] < 1e-8
    assert main(["convert", "paint.nc", "out.pab"]) == 2
    assert "3 directions" in capsys.readouterr().err
    assert (
        main(["convert", "pab/incidence-001.pab", "pab/incidence-002.pab", "pab/incidence-003.pab", "x.csv"])
        == 0
    )
    assert read(folder / "x.csv").sizes["sample"] == 144


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["paint.nc", "paint.nc"], "one of the files"),
        (["paint.nc", "out.xyz"], "no format is written as '.xyz'"),
        (["paint.nc", "out", "--to", "alta"], "no format 'alta'"),
        (["paint.nc", "nowhere/out.csv"], "no such folder"),
        (["gone.nc", "out.csv"], "gone.nc: no such file"),
        (["paint.nc", "out.csv", "--wavelength-nm", "600"], "holds no 600 nm"),
    ],
)
def test_what_cannot_be(folder, capsys, arguments, complaint):
    """Catches an input that is overwritten, and a wrong name found out after the work."""
    before = (folder / "paint.nc").read_bytes()
    assert main(["convert", *arguments]) == 2
    assert complaint in capsys.readouterr().err
    assert (folder / "paint.nc").read_bytes() == before


def test_a_file_that_may_be_cut_is_doubted(folder, capsys):
    """Catches a cut table converted without a word."""
    write(_samples(), folder / "paint.csv")
    text = (folder / "paint.csv").read_text().removesuffix("\n")
    (folder / "paint.csv").write_text(text[:-3])
    commands = (
        ["convert", "paint.csv", "out.astm"],
        ["check", "paint.csv"],
        ["fit", "paint.csv", "--model", "lambert"],
    )
    for command in commands:
        main([*command, "--json"])
        said = capsys.readouterr()
        assert "caution: paint.csv: the last line has no end" in said.err, command
        assert "the last line has no end" in said.out, command


@pytest.mark.parametrize(
    "command", [["convert", "t", "out.csv"], ["check", "t"], ["fit", "t", "--model", "lambert"]]
)
def test_options_of_formats_are_the_same_everywhere(folder, capsys, command):
    """Catches a reader's option that a command does not take, and one that is dropped in silence."""
    (folder / "t").write_text(
        "material,theta_o_deg,theta_i_deg,f_r\n" + "".join(f"a,{o},20,0.3\nb,{o},20,0.4\n" for o in range(40))
    )
    assert main([*command, "--material", "a"]) in {0, 3}
    assert main([*command, "--material", "c"]) == 2
    assert main([*command, "--material", "a", "--side", "back"]) == 2
    assert "side means nothing to in-plane table" in capsys.readouterr().err


def test_a_reading_that_a_person_names(folder, capsys):
    """Catches a reading that is not applied, not recorded, or applied without being told."""
    told = _json(capsys, "paint.nc", "as-is.nc")
    assert "reading" not in read(folder / "as-is.nc").attrs
    told = _json(capsys, "paint.nc", "cured.nc", "--reading", "cosine-of-view")
    assert told["written"] == 144
    before, after = read(folder / "paint.nc"), read(folder / "cured.nc")
    np.testing.assert_allclose(after["f_r"] * after["wo"][:, 2:].to_numpy(), before["f_r"], rtol=1e-12)
    assert after.attrs["reading"] == "cosine-of-view"
    told = _json(capsys, "paint.nc", "tilted.nc", "--reading", "specular-relative")
    lost = 144 - told["samples"]
    assert lost > 0
    assert f"{lost} samples below the horizon under specular-relative" in told["loss"]["dropped"]
    assert main(["convert", "paint.nc", "a.nc", "--reading", "upside-down"]) == 2
    assert "unknown reading 'upside-down'" in capsys.readouterr().err


def test_one_channel_of_colours(folder, capsys):
    """Catches colours without wavelengths that cannot go into a format of one channel."""
    grey = _samples()
    colours = make_samples(
        grey["wi"], grey["wo"], np.repeat(grey["f_r"].to_numpy(), 3, axis=1) * [1.0, 2.0, 3.0], channels="RGB"
    )
    write(colours, folder / "rgb.nc")
    assert main(["convert", "rgb.nc", "g.fred.txt"]) == 2
    assert "samples: FRED holds one channel, here are 3" in capsys.readouterr().err
    _json(capsys, "rgb.nc", "g.fred.txt", "--channel", "G")
    back = np.sort(read(folder / "g.fred.txt")["f_r"].to_numpy()[:, 0])
    np.testing.assert_allclose(back, np.sort(2.0 * grey["f_r"].to_numpy()[:, 0]), rtol=1e-6)
    assert main(["convert", "rgb.nc", "q.fred.txt", "--channel", "Q"]) == 2
    assert "rgb.nc: holds no channel Q; choose from R, G, B" in capsys.readouterr().err
