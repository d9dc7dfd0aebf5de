"""The whole chain in one command: wires, frames, samples, parameters, report."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.commands.demo import MARKER, prepare_folder
from gonio.demo_samples import MIN_SEPARATION_DEG, SAMPLES, few
from rig.errors import Refused

WITHIN_PERCENT = {
    ("lambert", "kd"): 0.3,
    ("phong", "exponent"): 2.0,
    ("cook-torrance", "m"): 1.0,
    ("cook-torrance", "ks_F0"): 2.0,
}


def _demo(folder: Path, *options: str, timeout_s: float = 170) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "gonio.cli", "demo", "--out", str(folder), *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)


def _check(result: dict[str, Any]) -> None:
    """Recovered within the demonstration's bounds, and told in the promised form."""
    assert set(result) == {"seconds", "poses", "materials", "report"}
    assert [material["model"] for material in result["materials"]] == ["lambert", "phong", "cook-torrance"]
    for material in result["materials"]:
        assert set(material) == {"name", "model", "parameters"}
        for name, numbers in material["parameters"].items():
            assert set(numbers) == {"true", "value", "u"}
            true, value, u = (np.array(numbers[key]) for key in ("true", "value", "u"))
            assert true.shape == value.shape == u.shape == (3,)
            assert (u > 0).all()
            assert (np.abs(value - true) < 5 * u).all(), (material["name"], name)
            bound = WITHIN_PERCENT.get((material["model"], name))
            if bound is not None:
                assert (np.abs(value / true - 1) < bound / 100).all(), (material["name"], name)
    assert "ks_F0" in result["materials"][2]["parameters"]


@pytest.mark.render
def test_a_short_demonstration_recovers_its_materials(tmp_path: Path) -> None:
    """Catches any room that broke the chain: the result, the report and the sessions must all be there."""
    folder = tmp_path / "demo"
    done = _demo(folder, "--json", "--poses", "12", "--seed", "3")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    _check(result)
    assert result["poses"] == 36
    page = Path(result["report"]).read_text(encoding="utf-8")
    assert 100_000 < len(page) < 5_000_000
    assert all(sample.name in page for sample in SAMPLES)
    assert "capture" in done.stderr
    for sample in SAMPLES:
        session = folder / sample.name.lower().replace(" ", "-")
        assert (session / "samples.nc").is_file()
    again = subprocess.run(
        [
            sys.executable,
            "-m",
            "gonio.cli",
            "reduce",
            str(session),
            "--out",
            str(tmp_path / "again.nc"),
            "--json",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(again.stdout)["poses"] == 12
    assert (tmp_path / "again.nc").read_bytes() == (session / "samples.nc").read_bytes()
    report = subprocess.run(
        [sys.executable, "-m", "gonio.cli", "report", str(session), "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    told = json.loads(report.stdout)
    assert told["fits"][0]["model"] == "cook-torrance"
    names = [fitted["model"] for fitted in told["fits"]]
    assert {"cook-torrance", "phong", "lambert"} <= set(names)
    assert "cook-torrance-1982" not in names  # it ties with the modern form
    assert "Rough dielectric" in Path(told["report"]).read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.timeout(3600)
def test_stated_uncertainty_holds_over_twenty_seeds(tmp_path: Path) -> None:
    """Catches uncertainties that are too small, and ones that are so large that they say nothing."""
    runs = []
    for seed in range(20):
        done = _demo(tmp_path / "demo", "--json", "--seed", str(seed), timeout_s=300)
        assert done.returncode == 0, done.stderr
        result = json.loads(done.stdout)
        assert result["poses"] >= 180
        runs.append(result)
    pulls, too_large = [], []
    for index, material in enumerate(runs[0]["materials"]):
        for name, numbers in material["parameters"].items():
            entries = [run["materials"][index]["parameters"][name] for run in runs]
            value, u = (np.array([entry[key] for entry in entries]) for key in ("value", "u"))
            true = np.array(numbers["true"])
            pulls.append((value - true) / u)
            scatter = value.std(axis=0, ddof=1)
            too_large += [(material["name"], name)] * int((u.mean(axis=0) > 3 * scatter).any())
            bound = WITHIN_PERCENT.get((material["model"], name))
            if bound is not None:
                assert (np.abs(value / true - 1) < bound / 100).all(), (material["name"], name)
    within = np.abs(np.concatenate([pull.ravel() for pull in pulls])) < 3
    assert within.mean() >= 0.95
    assert not too_large


def test_only_its_own_folder_is_replaced(tmp_path: Path) -> None:
    """Catches a demonstration that deletes somebody's measurements."""
    foreign = tmp_path / "thesis"
    foreign.mkdir()
    (foreign / "data.csv").write_text("precious", encoding="utf-8")
    done = _demo(foreign)
    assert done.returncode == 3
    assert done.stderr.count("\n") == 1
    assert "no demonstration" in done.stderr
    assert (foreign / "data.csv").read_text(encoding="utf-8") == "precious"
    (foreign / MARKER).write_text("[]", encoding="utf-8")
    with pytest.raises(Refused):
        prepare_folder(foreign, 0)
    own = prepare_folder(tmp_path / "demo", 0)
    (own / "old").write_text("x", encoding="utf-8")
    assert [path.name for path in prepare_folder(own, 1).iterdir()] == [MARKER]
    with pytest.raises(Refused):
        prepare_folder(foreign / "data.csv", 0)


def test_a_folder_reached_by_a_link_is_not_emptied_through_it(tmp_path: Path) -> None:
    """Catches a removal that follows a link out of the demonstration."""
    keep = tmp_path / "keep"
    keep.mkdir()
    (keep / "file").write_text("x", encoding="utf-8")
    own = prepare_folder(tmp_path / "demo", 0)
    (own / "link").symlink_to(keep)
    prepare_folder(own, 0)
    assert (keep / "file").is_file()


def test_too_few_poses_are_refused_before_anything_starts(tmp_path: Path) -> None:
    """Catches a fit without data, minutes later."""
    done = _demo(tmp_path / "demo", "--poses", "3")
    assert done.returncode == 2
    assert "--poses" in done.stderr
    assert not (tmp_path / "demo").exists()


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda sample: sample.name)
def test_each_material_has_sixty_poses_that_the_machine_takes(sample: Any, tmp_path: Path) -> None:
    """Catches poses that are refused, repeated, or too few for what the demonstration promises."""
    from capture.feasible import feasible
    from capture.plan import Head, Plan, PoseList
    from rig.description import default_rig
    from rig.kinematics import Kinematics

    plan = Plan(plan=Head(name="x", sample="sample1"), poses=(PoseList(directions_deg=sample.poses),))
    wi, wo, repeats = plan.directions()
    assert repeats == 0
    assert len(wi) >= 60
    found = feasible(Kinematics(default_rig(folder=tmp_path)), wi, wo)
    assert not found.counts
    assert (np.einsum("ij,ij->i", wi, wo) < np.cos(np.deg2rad(MIN_SEPARATION_DEG - 1e-6))).all()


def test_the_microfacet_plan_reaches_grazing_mirrors() -> None:
    """Catches a plan that cannot tell the index of refraction from the specular scale."""
    poses = np.array(SAMPLES[2].poses)
    mirror = (np.abs(poses[:, 0] - poses[:, 2]) < 6) & (poses[:, 3] == 180.0)
    assert (poses[mirror, 0] >= 65).sum() >= 3


def test_fewer_poses_still_span_the_list() -> None:
    """Catches a short demonstration that sees one light direction only."""
    poses = SAMPLES[2].poses
    chosen = few(poses, 12)
    assert len(set(chosen)) == 12
    assert len({pose[0] for pose in chosen}) >= 5
    assert few(poses, None) == poses
    assert few(poses, 1000) == poses
