"""The convention doctor: names each mistake it can know of, and does not decide where nothing speaks."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.angle_table import AngleTable, table_of
from analysis.checks.conventions import conventions
from analysis.checks.finding import Verdict
from analysis.doctor import declared_table, diagnose, reread
from analysis.doctor_readings import INVERSE, Reading, Step, candidates, reading_of
from analysis.doctor_same import signature_of
from analysis.models import MODELS
from analysis.samples import make_samples, read
from rig.angles import spherical_to_direction
from rig.errors import BadInput


@pytest.fixture(scope="module")
def study():
    """Return the benchmark's module."""
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "doctor.py"
    spec = importlib.util.spec_from_file_location("benchmarks_doctor", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def _paint(noise=0.01, seed=3):
    """Return a painted surface on a random set of directions, three incidences times many views."""
    random = np.random.default_rng(seed)
    theta_i = random.choice(np.radians([15.0, 40.0, 65.0]), 500)
    theta_o, phi = random.uniform(0.02, 1.35, 500), random.uniform(-np.pi, np.pi, 500)
    wi = spherical_to_direction(theta_i, np.full(500, 0.4))
    wo = spherical_to_direction(theta_o, phi)
    f_r = MODELS["ggx"](kd=0.2, ks=1.0, alpha=0.3, f0=0.06).evaluate(wi, wo)
    return make_samples(wi, wo, f_r * np.exp(noise * random.standard_normal(f_r.shape)))


def test_every_step_is_undone_by_its_inverse():
    """Catches a reading that changes samples otherwise than it says: there and back is nothing."""
    table = table_of(_paint())
    for step in Step:
        back = Reading((step,)).apply(Reading((INVERSE.get(step, step),)).apply(table))
        np.testing.assert_allclose(back.wi, table.wi, atol=1e-12, err_msg=step.value)
        np.testing.assert_allclose(back.wo, table.wo, atol=1e-12, err_msg=step.value)
        np.testing.assert_allclose(back.f_r, table.f_r, rtol=1e-12, err_msg=step.value)


def test_specular_relative_is_the_mirror_direction():
    """Catches a tilt in the wrong sense: the relative pole is the mirror direction of each light."""
    table = replace(table_of(_paint()), theta_o=np.zeros(500))
    read_as = Reading((Step.RELATIVE,)).apply(table)
    np.testing.assert_allclose(read_as.wo, table.wi * [-1.0, -1.0, 1.0], atol=1e-12)


@pytest.mark.parametrize(
    "mistake",
    [
        Step.WITH_COS_O,
        Step.OVER_COS_I,
        Step.EXCHANGED,
        Step.RELATIVE,
        *(
            pytest.param(step, marks=pytest.mark.slow)
            for step in (Step.OVER_COS_O, Step.WITH_COS_I, Step.OPPOSITE, Step.DEGREES, Step.BELOW_O)
        ),
    ],
)
def test_a_mistake_is_named(mistake):
    """Catches a doctor that is blind to one of the mistakes on a plain painted surface."""
    cure = Reading((mistake,))
    wrong = Reading((INVERSE.get(mistake, mistake),)).apply(table_of(_paint()))
    found = diagnose(wrong)
    assert found.decided
    assert mistake in {
        step for each in (found.ranked[0].reading, *found.ranked[0].same) for step in each.steps
    }
    np.testing.assert_allclose(
        signature_of(found.ranked[0].reading.apply(wrong)), signature_of(cure.apply(wrong)), atol=1e-6
    )
    assert conventions(found).verdict is Verdict.FAIL


def test_what_is_right_stays():
    """Catches a false alarm, and a plain file that is changed: as declared is decided for."""
    found = diagnose(table_of(_paint()))
    assert found.decided
    assert found.ranked[0].reading == Reading()
    assert conventions(found).verdict is Verdict.PASS


def test_undecided_is_said():
    """Catches a doctor that is sure of a Lambertian surface in one plane, where no sign matters."""
    theta_o = np.radians(np.linspace(1.0, 80.0, 60))
    wi = spherical_to_direction(np.full(60, 0.5), np.pi)
    wo = spherical_to_direction(theta_o, 0.0)
    noise = np.exp(0.05 * np.random.default_rng(0).standard_normal(60))
    found = diagnose(table_of(make_samples(wi, wo, 0.2 / np.pi * noise)))
    assert not found.decided
    assert "does not decide" in found.words
    assert any(Step.OPPOSITE in each.reading.steps for each in found.open)
    assert "white reference" in found.to_decide
    assert conventions(found).verdict is Verdict.NOT_TESTED
    assert conventions(found).where == found.to_decide
    assert diagnose(AngleTable(*np.zeros((4, 3)), np.ones((3, 1)))).ranked == ()


def test_reread_records_the_reading():
    """Catches re-read samples without a trace of how, with lost uncertainty, or below the horizon."""
    samples = _paint()
    table = table_of(samples.assign(u_f_r=(samples["f_r"].dims, 0.01 * samples["f_r"].to_numpy())))
    written = reread(table, reading_of("cosine-of-view"))
    assert written.attrs["reading"] == "cosine-of-view"
    np.testing.assert_allclose(written["f_r"] * written["wo"].to_numpy()[:, 2:], samples["f_r"], rtol=1e-12)
    np.testing.assert_allclose(written["u_f_r"] / written["f_r"], 0.01, rtol=1e-12)
    twice = reread(table_of(written), reading_of("light-view"))
    assert twice.attrs["reading"] == "cosine-of-view, then light-view"
    tilted = reread(table, reading_of("specular-relative"))
    assert tilted.attrs["reading_left_out"] == 500 - tilted.sizes["sample"] > 0
    assert tilted["wo"].to_numpy()[:, 2].min() > 0.0
    with pytest.raises(BadInput, match="unknown reading"):
        reading_of("sideways")
    with pytest.raises(BadInput, match="above the horizon"):
        reread(table, reading_of("view-inward"))


def test_candidates_are_different():
    """Catches a reading that is listed twice: it would count as its own rival."""
    names = [reading.name for reading in candidates()]
    assert len(names) == len(set(names))
    assert all(reading_of(name).name == name for name in names)


@pytest.mark.realdata
def test_rt300s_with_the_receive_sign_flipped(shared_data):
    """Catches that a flipped receive sign of a real instrument goes unnoticed."""
    raw = shared_data / "rt300s" / "raw"
    (path,) = raw.glob("*EC1*.xls")
    table = table_of(read(path, blank=raw / "blank_v2o0_20250911.xls"))
    found = diagnose(Reading((Step.OPPOSITE,)).apply(table))
    assert found.decided
    assert found.ranked[0].reading == Reading((Step.OPPOSITE,))
    assert diagnose(table).ranked[0].reading == Reading()


@pytest.mark.realdata
def test_cornell_in_degrees(shared_data, tmp_path):
    """Catches a file of degrees in a format of radians that is refused without saying what it is."""
    text = (shared_data / "cornell" / "garnet_red.brdf").read_text()
    words = [word for line in text.splitlines() for word in line.split("#", 1)[0].split()]
    count = int(words[0])
    table = np.array(words[1 + count :], dtype=float).reshape(-1, 4 + count)
    table[:, :4] = np.degrees(table[:, :4])
    rows = [" ".join(f"{cell:.6f}" for cell in row) for row in table]
    path = tmp_path / "degrees.brdf"
    path.write_text("\n".join([words[0], " ".join(words[1 : 1 + count]), *rows]) + "\n")
    with pytest.raises(BadInput, match="radians"):
        read(path)
    found = diagnose(declared_table(path, {}))
    assert found.decided
    assert found.ranked[0].reading == Reading((Step.DEGREES,))


@pytest.mark.realdata
def test_chassis_with_zenith_and_azimuth_exchanged(shared_data, tmp_path):
    """Catches exchanged columns, whose angles no reader can take."""
    lines = (shared_data / "starlink" / "chassis_brdf.csv").read_text().splitlines()
    rows = [line.split() for line in lines if not line.startswith("#")]
    path = tmp_path / "chassis.csv"
    swapped = [" ".join([row[1], row[0], row[3], row[2], row[4]]) for row in rows if row]
    path.write_text("\n".join([line for line in lines if line.startswith("#")] + swapped) + "\n")
    found = diagnose(declared_table(path, {}))
    assert found.decided
    assert found.ranked[0].reading == Reading((Step.EXCHANGED,))


@pytest.mark.realdata
@pytest.mark.parametrize(
    "name",
    [
        "vch_golden_yellow_rgb",
        pytest.param("cm_military_green_rgb", marks=pytest.mark.slow),
        pytest.param("irid_flake_paint1_rgb", marks=pytest.mark.slow),
    ],
)
def test_rgl_with_and_without_the_cosine(shared_data, name):
    """Catches values of RGL's files that are divided by a cosine once too often, or not at all."""
    path = shared_data / "rgl" / f"{name}.bsdf"
    assert diagnose(table_of(read(path))).ranked[0].reading == Reading()
    found = diagnose(table_of(read(path, no_cosine=True)))
    assert found.ranked[0].reading == Reading((Step.WITH_COS_O,))
    assert not found.as_declared
    # The green's lobe is too wide to show within 50 deg whether values rise by both cosines.
    assert found.decided == (name != "cm_military_green_rgb")


@pytest.mark.realdata
def test_few_corruptions_of_the_sample_files(shared_data, study):
    """Catches a study that miscounts: one corrupted file, and one where the mistake changes nothing."""
    trials = [study.trial(seed) for seed in (1, 62)]
    assert [each.verdict for each in trials] == ["right", "right"]
    assert [each.distinguishable for each in trials] == [True, False]
    found = study.rates(trials)
    assert found == {"distinguishable": 0.5, "right": 1.0, "wrong": 0.0, "undecided": 0.0}


@pytest.mark.slow
@pytest.mark.realdata
@pytest.mark.timeout(1800)
def test_many_corruptions_of_the_sample_files(shared_data, study):
    """Catches a doctor that is wrong more often than it may be."""
    found = study.rates([study.trial(seed) for seed in range(study.SEEDS)])
    assert 100.0 * found["wrong"] <= study.WRONG_PERCENT
    assert 100.0 * found["right"] >= study.RIGHT_PERCENT


@pytest.mark.slow
@pytest.mark.realdata
def test_no_clean_file_is_called_wrong(shared_data, study):
    """Catches a doctor that cries wolf."""
    assert study.false_alarms() == []
