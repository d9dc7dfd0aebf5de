"""`gonio fit` as a person and as a script see it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from analysis.models import DEFAULT_MODELS, MODELS
from analysis.ranking import FITTED
from analysis.samples import make_samples, write
from gonio.cli import main
from rig.angles import spherical_to_direction

METRICS = {"rms_log", "l2_cos", "rms_cbrt", "median_relative", "albedo_0", "albedo_30", "delta_e_mean"}


@pytest.fixture
def table(tmp_path):
    """Return a CSV file of a Cook-Torrance surface in two channels."""
    theta_i, theta_o = (
        a.ravel()
        for a in np.meshgrid(np.radians([5.0, 30.0, 55.0, 75.0]), np.radians(np.arange(0.0, 80.0, 4.0)))
    )
    wi = spherical_to_direction(theta_i, np.full_like(theta_i, np.pi))
    wo = spherical_to_direction(theta_o, np.linspace(-0.2, 0.2, theta_o.size))
    model = MODELS["cook-torrance"](kd=[0.1, 0.3], ks=[0.6, 0.5], m=0.25, ior=1.5)
    path = tmp_path / "paint.csv"
    write(make_samples(wi, wo, model.evaluate(wi, wo), channels=["R", "G"]), path)
    return path


def test_json_is_one_object_and_nothing_else(table, capsys):
    """Catches progress on standard output, a missing field, or values that are not plain numbers."""
    assert main(["fit", str(table), "--model", "cook-torrance", "lambert", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    first, second = printed["fits"]
    assert (first["model"], second["model"]) == ("cook-torrance", "lambert")
    assert first["file"] == str(table)
    assert set(first["metrics"]) >= METRICS
    assert first["parameters"]["m"]["value"] == pytest.approx(0.25, rel=1e-4)
    assert first["parameters"]["kd"]["value"] == pytest.approx([0.1, 0.3], rel=1e-4)
    assert first["derived"]["ks_F0"]["value"] == pytest.approx([0.024, 0.02], rel=1e-3)
    assert len(first["derived"]["ks_F0"]["u"]) == 2
    low, high = first["parameters"]["m"]["interval_95"]
    assert low <= first["parameters"]["m"]["value"] <= high
    assert first["correlation"]["of"] == ["m", "ior", "kd R", "kd G", "ks R", "ks G"]
    assert [row[i] for i, row in enumerate(first["correlation"]["matrix"])] == pytest.approx([1.0] * 6)
    assert first["cross_validation"] < second["cross_validation"]
    assert first["bic"] < second["bic"]
    assert first["cautions"] == []
    assert first["condition"] >= 1.0


def test_every_key_is_documented_and_every_documented_key_printed(table, tmp_path, capsys):
    """Catches a key that was renamed, dropped, or added without a word in docs/fit.md."""
    text = (Path(__file__).resolve().parents[2] / "docs" / "fit.md").read_text("utf-8")
    section = text.partition("## The JSON object")[2].partition("## What is refused")[0]
    documented = set(re.findall(r"`([a-z_0-9]+)`", section))
    arguments = ["fit", str(table), str(table), "--model", "ggx", "factored", "--compare", "--json"]
    assert main(arguments) == 0
    printed = json.loads(capsys.readouterr().out)
    ours = {each["model"]: each for each in printed["fits"]}
    keys = set(printed) | set(ours["ggx"]) | set(ours["factored"]) | set(printed["comparison"][0])
    keys |= set(ours["ggx"]["masked"]) | set(ours["ggx"]["parameters"]["alpha"])
    keys |= set(ours["factored"]["tables"]["D"]) | set(ours["ggx"]["covariance"])
    out = tmp_path / "paint.gltf"
    colours = tmp_path / "colours.csv"
    colours.write_text(table.read_text("utf-8").replace("_R", "_650nm").replace("_G", "_550nm"), "utf-8")
    colour = ["--wavelength-nm", "550"]
    assert main(["fit", str(colours), *colour, "--model", "ggx", "--export", str(out), "--json"]) == 0
    exported = json.loads(capsys.readouterr().out)["export"]
    assert out.exists()
    assert 0.0 <= exported["median_relative"] < exported["p95_relative"]
    keys |= {"export", *exported}
    assert keys - documented == set()
    assert documented - keys <= {"kind", "parameters", "text"}
    matrix = np.array(ours["ggx"]["covariance"]["matrix"])
    assert np.sqrt(matrix[0, 0]) == pytest.approx(ours["ggx"]["parameters"]["alpha"]["u"])
    assert np.shape(ours["factored"]["tables"]["F"]["value"])[1] == 2
    assert ours["ggx"]["cross_validation"] == pytest.approx(
        np.sqrt(np.mean(np.square(ours["ggx"]["cross_validation_folds"]))), rel=0.1
    )


def test_what_is_not_fitted_is_counted(table, capsys):
    """Catches samples that vanish without a word: those beyond the largest angle."""
    arguments = ["fit", str(table), "--model", "lambert", "--max-theta-deg", "60"]
    assert main([*arguments, "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)["fits"]
    assert one["count"] + sum(one["masked"].values()) == 2 * 80
    assert one["masked"]["beyond_max_theta"] > 0
    assert main(arguments) == 0
    assert f"{one['masked']['beyond_max_theta']} beyond --max-theta-deg" in capsys.readouterr().out


def test_gross_errors_are_set_aside_and_counted(table, capsys):
    """Catches a robust loss that does not reach the fit, and shapes that stay shared."""
    text = table.read_text().splitlines()
    rows = [line.split(",") for line in text]
    for row in rows[5::16]:
        row[4] = "9.0"
    table.write_text("\n".join(",".join(row) for row in rows) + "\n")
    arguments = ["fit", str(table), "--model", "cook-torrance", "--json"]
    found = []
    for more in ([], ["--loss", "robust"], ["--loss", "robust", "--shape", "per-channel"]):
        assert main([*arguments, *more]) == 0
        found.append(json.loads(capsys.readouterr().out)["fits"][0])
    plain, robust, own = found
    assert abs(plain["parameters"]["m"]["value"] - 0.25) > 0.01
    assert robust["parameters"]["m"]["value"] == pytest.approx(0.25, rel=1e-3)
    assert robust["masked"]["gross_error"] >= 5
    assert own["parameters"]["m"]["value"] == pytest.approx([0.25, 0.25], rel=1e-3)


def test_apertures_are_taken_out_of_a_narrow_lobe(tmp_path, capsys):
    """Catches an aperture that does not reach the fit, or full and half angles that are confused."""
    from analysis.instrument import Instrument, instrument_of

    seen = []
    for angles in (["2", "3"], ["0", "0"]):
        theta = np.radians(np.arange(20.0, 41.0, 0.5))
        wi = spherical_to_direction(np.full_like(theta, np.radians(30.0)), np.full_like(theta, np.pi))
        wo = spherical_to_direction(theta, np.zeros_like(theta))
        f_r = MODELS["ggx"](kd=0.1, ks=0.8, alpha=0.03, f0=0.05).evaluate(wi, wo)
        path = tmp_path / "narrow.csv"
        write(make_samples(wi, wo, f_r), path)
        assert main(["fit", str(path), "--model", "blinn-phong", "--aperture-deg", *angles, "--json"]) == 0
        seen.append(json.loads(capsys.readouterr().out)["fits"][0]["parameters"]["exponent"]["value"])
    # Without what the discs blur the lobe is sharper.
    assert seen[0] > 1.05 * seen[1]
    samples = make_samples(wi, wo, f_r)
    from gonio.commands.fit import _seen_through

    discs = instrument_of(_seen_through(samples, [2.0, 3.0]))
    assert isinstance(discs, Instrument)
    assert np.degrees([discs.source_rad, discs.receiver_rad]) == pytest.approx([1.0, 1.5])
    assert main(["fit", str(path), "--aperture-deg", "2", "190"]) == 2
    assert "--aperture-deg: 2 and 190 are no full angles" in capsys.readouterr().err


def test_pictures(table, tmp_path, capsys):
    """Catches a picture that is not written, or two files' pictures under one name."""
    other = tmp_path / "second" / table.name
    other.parent.mkdir()
    other.write_bytes(table.read_bytes())
    folder = tmp_path / "pictures"
    assert main(["fit", str(table), str(other), "--model", "lambert", "--plots", str(folder)]) == 0
    assert sorted(path.name for path in folder.iterdir()) == ["1-paint-lambert.png", "2-paint-lambert.png"]
    assert str(folder) in capsys.readouterr().err


def test_all_models_ranked_for_people(table, capsys):
    """Catches a model that is not tried, and a ranking that is none."""
    assert main(["fit", str(table)]) == 0
    out = capsys.readouterr().out
    ranking = [line.split() for line in out.split("\n\n")[1].splitlines()[1:]]
    assert {row[0] for row in ranking} == set(DEFAULT_MODELS)
    values = [float(row[1]) for row in ranking]
    assert values == sorted(values)
    assert ranking[0][0].startswith("cook-torrance")
    assert "ks_F0 R" in out


def test_what_the_ranking_means_is_said(table, capsys):
    """Catches a table of numbers without a word on what the first row gains."""
    assert main(["fit", str(table), "--model", "lambert", "blinn-phong"]) == 0
    assert "on incidences it has not seen blinn-phong errs by" in capsys.readouterr().out


def test_files_side_by_side(table, tmp_path, capsys):
    """Catches a comparison of other parameters, and a difference that is not marked."""
    import csv

    other = tmp_path / "brighter.csv"
    with table.open() as source, other.open("w", newline="") as target:
        rows = [line for line in source if line.startswith("#")]
        target.writelines(rows)
        source.seek(0)
        reader = csv.DictReader(line for line in source if not line.startswith("#"))
        writer = csv.DictWriter(target, reader.fieldnames)
        writer.writeheader()
        for row in reader:
            changed = {k: repr(float(v) + 0.01) for k, v in row.items() if k.startswith("f_r")}
            writer.writerow(row | changed)
    arguments = ["fit", str(table), str(other), "--model", "cook-torrance", "--compare"]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert f"[1] {table}" in out
    assert f"[2] {other}" in out
    (kd,) = (line for line in out.splitlines() if line.strip().startswith("kd R"))
    assert kd.endswith("differs")
    assert main([*arguments, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    (row,) = (r for r in printed["comparison"] if (r["parameter"], r["channel"]) == ("kd", 0))
    assert np.diff(row["values"]) == pytest.approx(0.01 * np.pi, rel=1e-3)
    assert row["differs"]
    assert row["p_value"] < 1e-6
    (row,) = (r for r in printed["comparison"] if r["parameter"] == "m")
    assert not row["differs"]
    assert main(["fit", str(table), "--compare"]) == 2
    assert "name the files to compare" in capsys.readouterr().err


def test_all_means_all(table, capsys):
    """Catches a model that a fit cannot take, or that --all forgets."""
    assert main(["fit", str(table), "--all", "--json"]) == 0
    fits = json.loads(capsys.readouterr().out)["fits"]
    assert {entry["model"] for entry in fits} == set(FITTED)
    assert fits[0]["metrics"]["rms_log"] < 1e-6


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--model", "gxx"], "did you mean ggx?"),
        (["--wavelength-nm", "550"], "its channels are R, G"),
        (["--loss", "rmse"], "chi2, log, cbrt, l2"),
        (["--loss", "chi2"], "needs uncertainties"),
        (["--blank", "blank.xls"], "means nothing to gonio CSV"),
        (["--max-theta-deg", "1"], "both angles"),
    ],
)
def test_bad_options_say_what_there_is(table, capsys, arguments, complaint):
    """Catches a traceback, or an error that does not name the file or the choice."""
    assert main(["fit", str(table), *arguments]) == 2
    captured = capsys.readouterr()
    assert complaint in captured.err
    assert captured.out == ""


def test_bad_files_say_where(tmp_path, capsys):
    """Catches a NaN or a missing file that gives a traceback."""
    path = tmp_path / "bad.csv"
    path.write_text("theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,f_r\n0,0,0,0,nan\n")
    assert main(["fit", str(path)]) == 2
    assert "bad.csv: line 2, column f_r" in capsys.readouterr().err
    assert main(["fit", str(tmp_path / "nowhere.csv")]) == 2
    assert "no such file" in capsys.readouterr().err


DIRECTIONS = [(30, 180, 3 * k, 0) for k in range(25)]
HEAD = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg"


def lines(directions, f_r=lambda k: 0.1 + 0.01 * k):
    """Return rows of a table."""
    return [",".join(map(str, (*angles, f_r(k)))) for k, angles in enumerate(directions)]


@pytest.mark.parametrize(
    ("head", "rows", "complaint"),
    [
        ("f_r", lines(DIRECTIONS[:2]), "2 different pairs of directions for 4 parameters; measure"),
        ("f_r", lines([DIRECTIONS[3]] * 40), "1 different pairs of directions"),
        ("f_r", lines(DIRECTIONS, lambda _: 0.0), "every f_r is zero"),
        ("f_r_R,f_r_G", lines(DIRECTIONS, lambda _: "0.1,nan"), "line 2, column f_r_G: 'nan' is"),
        ("f_r", lines([(30, 180, round(np.radians(3 * k), 4), 0) for k in range(25)]), "theta_o looks like"),
        ("f_r", lines([(a, 3.14159, c, 0) for a, _, c, _ in DIRECTIONS]), "phi_i looks like radians"),
        ("f_r", lines([(a, 180, 95 + k, 0) for k, (a, *_) in enumerate(DIRECTIONS)]), "below the horizon"),
        ("f_r", [], "has a header but no rows"),
    ],
)  # fmt: skip
def test_samples_that_no_fit_can_use(tmp_path, capsys, head, rows, complaint):
    """Catches a fit to nothing, or an error that is not one line with what would be needed."""
    path = tmp_path / "theirs.csv"
    path.write_text("\n".join([f"{HEAD},{head}", *rows, ""]))
    assert main(["fit", str(path), "--model", "ggx"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    error = [line for line in captured.err.splitlines() if not line.startswith("fits ")]
    assert len(error) == 1
    assert complaint in error[0]
    assert str(path) in error[0]


def test_all_leaves_out_what_the_samples_cannot_carry(tmp_path, capsys):
    """Catches one large model that costs a small file all the others."""
    path = tmp_path / "few.csv"
    path.write_text("\n".join([f"{HEAD},f_r", *lines(DIRECTIONS[:4]), ""]))
    assert main(["fit", str(path), "--all", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    tried = {each["model"] for each in printed["fits"]}
    left_out = printed["left_out"][str(path)]
    assert {"factored", "sgd"} <= set(left_out)
    assert "table entries" in left_out["factored"]
    assert tried | set(left_out) == set(FITTED)


def test_models_before_files(table, capsys):
    """Catches a file that is silently taken for a model's name."""
    assert main(["fit", str(table), "--model", "lambert", str(table)]) == 2
    assert "write the files before --model" in capsys.readouterr().err


@pytest.mark.realdata
def test_garnet_red_at_550_nm(shared_data, capsys):
    """Catches a fit of the real paint worse than what Cook-Torrance can do."""
    path = shared_data / "cornell" / "garnet_red.brdf"
    arguments = ["fit", str(path), "--wavelength-nm", "550", "--model", "cook-torrance", "--json"]
    assert main(arguments) == 0
    (result,) = json.loads(capsys.readouterr().out)["fits"]
    assert result["count"] == 1439
    assert result["metrics"]["rms_log"] <= 0.0105


@pytest.mark.realdata
def test_rt300s_with_its_blank(shared_data, capsys):
    """Catches a blank that is not passed on, and shadowed readings that are fitted."""
    raw = shared_data / "rt300s" / "raw"
    sample = str(raw / "ANOPLATE_AnoBlack_EC1_Alum6061_v1o0_20251115.xls")
    blank = str(raw / "blank_v2o0_20250911.xls")
    assert main(["fit", sample, "--blank", blank, "--model", "cook-torrance", "--json"]) == 0
    (result,) = json.loads(capsys.readouterr().out)["fits"]
    assert result["count"] == 2508 - 160
    assert result["metrics"]["rms_log"] < 0.0085
    assert main(["fit", sample, "--model", "cook-torrance", "--json"]) == 0
    (raw_result,) = json.loads(capsys.readouterr().out)["fits"]
    assert raw_result["metrics"]["rms_log"] != result["metrics"]["rms_log"]
