"""Recipes: catches chains that no longer give the published tables, and errors that steps lose or invent."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.formats import inplane, rt300s
from analysis.recipes import reduce_files
from analysis.recipes.average import Average, PoleAverage, Sides
from analysis.recipes.readings import Flag, joined, make_readings, to_samples
from analysis.recipes.recipe import STEPS, load, parsed, shipped
from analysis.recipes.repeatability import repeatability
from analysis.recipes.specular import AlignPeak, SpecularGrid
from analysis.recipes.steps import (
    AngleCut,
    Blank,
    Cosine,
    FloorShift,
    Given,
    KnownRepeatability,
    Reference,
    Scale,
    ShadowCut,
    difference_noise,
)
from analysis.samples import read, write
from benchmarks import data_rt300s as bench
from gonio.cli import main
from rig.errors import BadInput

NOTHING = Given()


def scan(light_deg, azimuth_deg, receive_deg, value=None, **columns):
    """Make readings on an RT-300S grid: light's angle, laser's azimuth, signed receive angle."""
    light, azimuth, receive = (
        np.radians(a).ravel() for a in np.meshgrid(light_deg, azimuth_deg, receive_deg, indexing="ij")
    )
    angles = (light, azimuth - np.pi / 2, np.abs(receive), np.where(receive < 0, np.pi, 0.0))
    table = np.arange(len(light), dtype=float) if value is None else value
    table = table(light, azimuth, receive) if callable(table) else table
    columns = {name: np.broadcast_to(column, (len(light), 1)).copy() for name, column in columns.items()}
    return make_readings(angles, np.broadcast_to(table, light.shape)[:, None].astype(float), **columns)


FULL = ([10.0, 30.0, 50.0], np.arange(-90, 91, 15.0), np.arange(-80, 81, 10.0))


def lobe(sideways_rad):
    """Make a mirror lobe whose peak lies so far beside the plane of incidence."""

    def value(light, azimuth, receive):
        across, along = np.sin(receive) * np.cos(azimuth), np.sin(light) + np.sin(receive) * np.sin(azimuth)
        return 0.01 + np.exp(-((across - sideways_rad) ** 2 + along**2) / 0.1)

    return value


@pytest.mark.realdata
@pytest.mark.parametrize("rows", [bench.fred_rows, bench.zemax_rows])
def test_published_tables(shared_data, rows):
    """Catches anything in reader, steps, order or interpolation that leaves the laboratory's own numbers."""
    found = rows()
    assert [row["name"] for row in found if not row["ok"]] == []
    assert all(row["value"] == 100.0 for row in found if row["unit"] == "%")


@pytest.mark.realdata
def test_no_cell_more_and_no_cell_less(shared_data):
    """Catches cells that the published table does not have: shadow and pole."""
    table, files = bench.SAMPLES["EC1"]
    ours = bench._cells(bench._reduced(files, "rt300s-fred"))
    theirs = bench._cells(read(bench.PUBLISHED / f"{table}.txt"))
    assert len(ours) == len(theirs) == 1144
    assert {cell for cell, _ in ours} == {cell for cell, _ in theirs}


@pytest.mark.realdata
@pytest.mark.parametrize("label", bench.SAMPLES)
def test_the_published_file_itself(shared_data, tmp_path, label):
    """Catches a FRED file that is not theirs to the last printed digit: angles, order, cells and values."""
    table, files = bench.SAMPLES[label]
    out = tmp_path / "out.fred.txt"
    told = write(bench._reduced(files, "rt300s-fred"), out)
    lines = []
    for line in out.read_text("utf-8").splitlines():
        words = line.split("\t")
        lines.append("\t".join([*words[:2], f"{float(words[2]):.6f}"]) if len(words) == 3 else line)
    assert lines == (bench.PUBLISHED / f"{table}.txt").read_text("utf-8").splitlines()
    assert told.samples == 1144


@pytest.mark.realdata
@pytest.mark.parametrize("label", bench.SAMPLES)
def test_the_published_grid_itself(shared_data, tmp_path, label):
    """Catches a Zemax file on another grid than the samples', or with cells that have no sample filled."""
    table, files = bench.SAMPLES[label]
    out = tmp_path / "out.zemax.bsdf"
    told = write(bench._reduced(files, "rt300s-zemax"), out)
    assert told.worst_relative < 1e-6

    def lines_of(path):
        lines = path.read_text("utf-8").splitlines()
        rows = [line.split() for line in lines[lines.index("DataBegin") + 1 : lines.index("DataEnd")]]
        lists = lines[lines.index("SampleRotation\t1") : lines.index("Monochrome")]
        return lists, np.array([row for row in rows if row[0] != "TIS"], dtype=float)

    (lists, ours), (their_lists, theirs) = (
        lines_of(path) for path in (out, bench.PUBLISHED / f"{table}.bsdf")
    )
    assert lists == their_lists
    np.testing.assert_array_equal(ours == 0.0, theirs == 0.0)
    np.testing.assert_allclose(ours, theirs, rtol=5.01e-4)


@pytest.mark.realdata
def test_repeats_of_steel(shared_data):
    """Catches a repeatability that is not that of the three files, and a u_f_r below it."""
    rows = {row["name"].partition(": ")[2]: row for row in bench.repeatability_rows()}
    assert 3.0 < rows["repeatability of one file, relative part"]["value"] < 6.0
    assert rows["least u_f_r over its floor"]["ok"]


@pytest.mark.realdata
@pytest.mark.parametrize("material", ["Kupfer", "Referenzlack (Rau)"])
def test_a_published_formula_of_another_laboratory(shared_data, material):
    """Catches recipes that only fit one instrument: the mid-infrared chain with its extra cosine."""
    path = shared_data / "mwir" / "radiance.csv"
    published = read(path, material=material, as_published=True)
    ours = reduce_files([path], "mwir-published", material=material).samples
    good = (ours["flags"] == 0).to_numpy()
    np.testing.assert_allclose(ours["f_r"].to_numpy()[good], published["f_r"].to_numpy()[good], rtol=1e-12)
    np.testing.assert_allclose(ours["wo"], published["wo"], atol=1e-12)
    assert good.sum() >= 0.98 * good.size


def test_every_recipe_that_ships_says_whose_it_is():
    """Catches a shipped file that does not load, or a step without its description."""
    assert set(shipped()) == {"rt300s", "rt300s-fred", "rt300s-zemax", "mwir-published"}
    for name in shipped():
        recipe = load(name)
        assert recipe.source
        assert recipe.reads in {module.NAME for module in (rt300s, inplane)}
    assert [step.name for step in load("rt300s").step].count("floor_shift") == 0
    assert all(kind.__doc__ for kind in STEPS.values())


def test_every_step_is_documented():
    """Catches a step, parameter or recipe that docs/recipes.md does not tell of."""
    page = (Path(__file__).parents[2] / "docs" / "recipes.md").read_text("utf-8")
    for name, kind in STEPS.items():
        row = next(line for line in page.splitlines() if line.startswith(f"| `{name}` |"))
        assert all(f"`{key}`" in row for key in kind.model_fields if key != "name")
    assert all(f"| `{name}` |" in page for name in shipped())


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ({"name": "blnk"}, "did you mean blank"),
        ({}, "has no name"),
        ({"name": 3}, "is no step"),
        ({"name": "shadow_cut", "polar_degree": 10, "azimuth_deg": 30}, "did you mean polar_deg"),
        ({"name": "shadow_cut", "azimuth_deg": 30}, "polar_deg is missing"),
        ({"name": "shadow_cut", "polar_deg": -1, "azimuth_deg": 30}, "above 0 to 90"),
        ({"name": "cosine", "of": "vew"}, '"view" or "light"'),
        ({"name": "reference", "reflectance": "0.99"}, "reflectance"),
        ({"name": "specular_grid", "azimuth_deg": [], "radial_deg": [0]}, "azimuth_deg"),
    ],
)
def test_a_recipe_that_says_something_else_is_one_line(step, message):
    """Catches silent defaults: an unknown step, parameter or value must be named, with what would do."""
    with pytest.raises(BadInput, match=message) as caught:
        parsed({"title": "t", "step": [step]}, "mine.toml")
    assert "mine.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_recipe(tmp_path):
    """Catches a traceback for a missing, malformed or misnamed recipe."""
    (tmp_path / "a.toml").write_text('title = "x')
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe")
    (tmp_path / "c.toml").write_text("step = 3")
    for name in "abc":
        with pytest.raises(BadInput, match=rf"{name}\.toml"):
            load(str(tmp_path / f"{name}.toml"))
    with pytest.raises(BadInput, match="no such file"):
        load(str(tmp_path / "d.toml"))
    with pytest.raises(BadInput, match="did you mean rt300s-fred"):
        load("rt300s-fre")


def test_a_step_that_cannot_apply():
    """Catches a blank that is silently not subtracted, or taken at other angles."""
    readings = scan(*FULL)
    with pytest.raises(BadInput, match="--blank"):
        Blank(name="blank").apply(readings, NOTHING)
    other = scan([10.0], *FULL[1:])
    with pytest.raises(BadInput, match=r"lacks 442 of the 663 angles.*incidence 30"):
        Blank(name="blank").apply(readings, Given(blank=other))
    wide = make_readings([np.zeros(1)] * 4, np.zeros((1, 2)), channels=("a", "b"))
    with pytest.raises(BadInput, match="channels"):
        Blank(name="blank").apply(readings, Given(blank=wide))


def test_blank_in_any_order_and_larger():
    """Catches a blank subtracted by position instead of by angle, and noise that is not the blank's."""
    random = np.random.default_rng(3)
    large = scan([10.0, 20.0, 30.0, 50.0], *FULL[1:], value=lambda i, a, r: i + 2 * a - r**2)
    noisy = large.with_columns({"value": large.value + random.normal(0, 0.02, large.value.shape)})
    mixed = noisy.rows(random.permutation(len(noisy)))
    readings = scan(*FULL, value=lambda i, a, r: 5.0 + i + 2 * a - r**2)
    done = Blank(name="blank").apply(readings, Given(blank=mixed))
    assert np.abs(done.value - 5.0).max() < 0.1
    # A parabola over 10 deg steps adds (10 deg)^2 to what differs from the line between neighbours.
    curvature = np.radians(10.0) ** 2 / np.sqrt(1.5)
    expected = np.sqrt(0.02**2 + curvature**2)
    np.testing.assert_allclose(done.u_noise, expected, rtol=0.1)
    np.testing.assert_allclose(done.u_blank, expected, rtol=0.1)


@pytest.mark.parametrize("order", ["as it is", "shuffled"])
def test_noise_from_differences(order):
    """Catches weights off for unequal steps, and lines drawn across the pole or between planes."""
    random = np.random.default_rng(4)
    steps = np.array([-80, -72, -65, -50, -44, -30, -21, -10, -4, 0, 5, 12, 30, 41, 55, 60, 78.0])
    readings = scan(
        np.arange(5, 80, 5.0), np.arange(-90, 91, 10.0), steps, value=lambda i, a, r: 3 * i + a + 7 * r
    )
    readings = readings.with_columns({"value": readings.value + random.normal(0, 0.1, readings.value.shape)})
    if order == "shuffled":
        readings = readings.rows(random.permutation(len(readings)))
    assert difference_noise(readings) == pytest.approx(0.1, rel=0.03)
    assert difference_noise(readings.rows(np.arange(2))) == 0.0


def test_floor_shift_is_told_and_counted():
    """Catches a shift that is silent, shared between files, or free of uncertainty."""
    files = joined([scan(*FULL, value=lambda _i, _a, r, k=k: r - k) for k in (0.0, 1.0)])
    done = FloorShift(name="floor_shift").apply(files, NOTHING)
    for number in (0, 1):
        assert done.value[done.file == number].min() == 0.0
        shift = np.radians(80.0) + number
        np.testing.assert_allclose(done.u_common[done.file == number], shift / np.sqrt(3), rtol=1e-12)
    assert "floor_shift" in done.notes[0]


@given(
    st.sampled_from([0.0, 5.0, 10.0, 35.0, 70.0]),
    st.floats(-90, 90),
    st.floats(-80, 80),
)
def test_shadow_as_the_laboratory_cuts_it(light, azimuth, receive):
    """Catches the zone on the wrong side of the normal, also where it reaches over it."""
    readings = scan([light], [azimuth], [receive])
    cut = ShadowCut(name="shadow_cut", polar_deg=10.0, azimuth_deg=30.0).apply(readings, NOTHING)
    signed = -np.sign(azimuth) * receive
    inside = abs(azimuth) >= 60.0 and -light - 10.0 <= signed <= -light + 10.0
    edge = min(abs(abs(azimuth) - 60.0), abs(abs(signed + light) - 10.0)) < 1e-3 or abs(receive) < 1e-9
    if not edge:
        assert bool(cut.flags[0, 0] & Flag.SELF_SHADOW) == inside


def test_independent_errors_fall_shared_ones_stay():
    """Catches a blank or a reference whose error is averaged away over files that share it."""
    parts = [scan(*FULL, value=1.0, u_noise=0.3, u_common=0.2) for _ in range(9)]
    files = joined(parts)
    files = files.with_columns(
        {"u_blank": np.full(files.value.shape, 0.4), "blank_id": np.tile(np.arange(len(parts[0])), 9)}
    )
    done = Average(name="average").apply(files, NOTHING)
    assert len(done) == len(parts[0])
    np.testing.assert_allclose(done.u_noise, 0.1)
    np.testing.assert_allclose(done.u_blank, 0.4)
    np.testing.assert_allclose(done.u_common, 0.2)
    mirrored = Average(name="average", mirror=True).apply(files, NOTHING)
    off_plane = np.abs(mirrored.phi_i + np.pi / 2) > 1e-6
    np.testing.assert_allclose(mirrored.u_blank[off_plane & (mirrored.theta_o > 0)], 0.4 / np.sqrt(2))


def test_mirror_pairs_are_averaged():
    """Catches partners on the wrong side: +A, +R belongs to -A, -R and to nothing else."""
    readings = scan(*FULL, value=lambda i, a, r: i + np.sin(a) * np.sin(r) + 100 * a)
    done = Average(name="average", mirror=True).apply(readings, NOTHING)
    azimuth, receive = done.phi_i + np.pi / 2, np.where(done.phi_o > 1, -1, 1) * done.theta_o
    assert azimuth.max() < 1e-9
    np.testing.assert_allclose(done.value[:, 0], done.theta_i + np.sin(azimuth) * np.sin(receive), atol=1e-12)
    assert len(done) == 3 * 7 * 17


def test_flagged_readings_are_left_out_of_averages():
    """Catches a shadowed reading that spoils, or silently empties, the place that others saw."""
    one, two = (scan(*FULL, value=k) for k in (1.0, 3.0))
    two = two.with_columns({"flags": np.where(np.arange(len(two)) < 10, 1, 0)[:, None]})
    one = one.with_columns({"flags": np.where(np.arange(len(one)) < 4, 1, 0)[:, None]})
    done = Average(name="average").apply(joined([one, two]), NOTHING)
    assert np.isnan(done.value[:4]).all()
    assert (done.flags[:4] == Flag.SELF_SHADOW).all()
    assert (done.value[4:10] == 1.0).all()
    assert (done.value[10:] == 2.0).all()


def test_pole_is_the_mean_over_the_circle():
    """Catches azimuths at the ends of the half circle that count twice."""
    readings = scan(
        [30.0], np.arange(-90, 1, 10.0), [-10.0, 0.0, 10.0], value=lambda _i, a, _r: np.cos(a) ** 2
    )
    done = PoleAverage(name="pole_average").apply(readings, NOTHING)
    pole = done.theta_o < 1e-9
    assert pole.sum() == 1
    assert done.value[pole] == pytest.approx(0.5, abs=1e-12)
    assert len(done) == 21


def test_sides():
    """Catches a second side that is not the mirror image, or doubled cells in the plane."""
    readings = Average(name="average", mirror=True).apply(scan(*FULL), NOTHING)
    one = Sides(name="sides", count=1).apply(
        PoleAverage(name="pole_average").apply(readings, NOTHING), NOTHING
    )
    two = Sides(name="sides", count=2).apply(
        PoleAverage(name="pole_average").apply(readings, NOTHING), NOTHING
    )
    in_plane = (np.abs(np.sin(one.phi_o)) < 1e-9) | (one.theta_o < 1e-9)
    assert len(one) == 3 * (8 * 13 + 1)
    assert len(two) == 2 * len(one) - in_plane.sum()
    assert np.all((one.phi_o >= -1e-12) & (one.phi_o <= np.pi + 1e-12))
    np.testing.assert_allclose(np.sort(two.value[len(one) :, 0]), np.sort(one.value[~in_plane, 0]))


@settings(max_examples=30)
@given(st.floats(0.5, 1.0), st.floats(0, 0.05), st.floats(0, 1))
def test_reference_and_cosine(reflectance, u_reflectance, u_angle_deg):
    """Catches pi, the reflectance or the cosine on the wrong side, and their uncertainties."""
    readings = scan(*FULL, value=0.3, u_noise=0.01)
    done = Reference(name="reference", reflectance=reflectance, u_reflectance=u_reflectance).apply(
        readings, NOTHING
    )
    done = Cosine(name="cosine", u_angle_deg=u_angle_deg).apply(done, NOTHING)
    f_r = 0.3 * reflectance / np.pi / np.cos(readings.theta_o)
    np.testing.assert_allclose(done.value[:, 0], f_r, rtol=1e-12)
    np.testing.assert_allclose(done.u_common[:, 0], f_r * u_reflectance / reflectance, rtol=1e-9, atol=1e-15)
    relative = np.hypot(0.01 / 0.3, np.tan(readings.theta_o) * np.radians(u_angle_deg))
    np.testing.assert_allclose(done.u_noise[:, 0], f_r * relative, rtol=1e-9)
    back = Cosine(name="cosine", operation="multiply").apply(done, NOTHING)
    np.testing.assert_allclose(back.value[:, 0], 0.3 * reflectance / np.pi, rtol=1e-12)


def test_scale_and_angle_cut():
    """Catches a factor's error treated as noise, and limits that drop what stands on them."""
    scaled = Scale(name="scale", factor=2.0, relative_u=0.1).apply(scan(*FULL, u_noise=1.0), NOTHING)
    np.testing.assert_allclose(scaled.u_common, np.abs(scaled.value) * 0.1)
    np.testing.assert_allclose(scaled.u_noise, 2.0)
    cut = AngleCut(name="angle_cut", view_deg=70.0, light_deg=30.0).apply(scan(*FULL), NOTHING)
    kept = (np.degrees(cut.theta_o) < 70.1) & (np.degrees(cut.theta_i) < 30.1)
    np.testing.assert_array_equal(cut.flags[:, 0] == 0, kept)


def test_readings_along_the_surface_are_flagged_not_infinite():
    """Catches receive angles of 90 deg and beyond, which other exports have."""
    readings = scan([0.0, 30.0], [-90.0, 0.0], [-100.0, -90.0, 0.0, 90.0])
    done = Cosine(name="cosine").apply(Reference(name="reference").apply(readings, NOTHING), NOTHING)
    np.testing.assert_array_equal(done.flags[:, 0] == 0, np.isclose(readings.theta_o, 0.0))
    samples = to_samples(done, source="x")
    assert np.isfinite(samples["f_r"].to_numpy()[done.flags == 0]).all()
    assert not np.isinf(samples["f_r"].to_numpy()).any()


@pytest.mark.parametrize(("additive", "relative"), [(0.0, 0.05), (0.02, 0.0), (0.01, 0.03)])
def test_repeatability_finds_both_parts(additive, relative):
    """Catches components that trade with each other, and degrees of freedom counted wrongly."""
    random = np.random.default_rng(8)
    level = np.exp(random.uniform(np.log(0.01), np.log(3.0), 4000))
    deviation = np.hypot(additive, relative * level)
    files = level + deviation * random.standard_normal((3, 4000))
    files[0, :100] = np.nan
    found = repeatability(files, random.uniform(0, 1.4, 4000))
    assert found.dof == 100 + 2 * 3900
    assert found.additive == pytest.approx(additive, rel=0.06, abs=1.2e-3)
    assert found.relative == pytest.approx(relative, rel=0.06, abs=4e-3)
    assert sum(band.dof for band in found.bands if band.quantity == "level") == found.dof
    assert repeatability(files[:1], np.zeros(4000)) is None


def test_repeats_are_the_floor_of_the_uncertainty():
    """Catches a mean of files that claims less than their spread over the root of their number."""
    random = np.random.default_rng(9)
    files = joined([scan(*FULL, value=1 + 0.1 * random.standard_normal(663)) for _ in range(4)])
    done = Average(name="average").apply(files, NOTHING)
    assert done.u_noise.min() == pytest.approx(0.05, rel=0.1)
    assert Average(name="average", repeatability_floor=False).apply(files, NOTHING).u_noise.max() == 0.0


def test_both_sides_of_the_plane_are_the_floor_of_their_mean():
    """Catches a mirrored average that claims less than its sides differ: tilt, or an anisotropic sample."""
    tilted = scan(*FULL, value=lambda _i, a, r: 1.0 + 0.2 * np.sign(np.cos(a) * np.sin(r)))
    done = Average(name="average", mirror=True).apply(tilted, NOTHING)
    beside = (np.abs(np.sin(done.between)) > 0.1) & (done.theta_o > 0.0)
    # Two values that differ by 0.4: their standard deviation is 0.4 / sqrt(2), their mean's 0.2.
    np.testing.assert_allclose(done.value[beside], 1.0)
    np.testing.assert_allclose(done.u_noise[beside], 0.2, rtol=0.1)
    even = Average(name="average", mirror=True).apply(scan(*FULL, value=1.0), NOTHING)
    assert even.u_noise.max() < 1e-6


def test_repeatability_that_is_known_of_the_instrument():
    """Catches a single file that claims its noise alone, and compared files held to another's figure."""
    step = KnownRepeatability(name="repeatability", relative=0.1, additive=0.3)
    one = scan(*FULL, value=4.0, u_noise=0.01, u_common=0.3)
    np.testing.assert_allclose(np.hypot(step.apply(one, NOTHING).u_noise, 0.3), 0.5)
    noisy = scan(*FULL, value=4.0, u_noise=2.0)
    np.testing.assert_array_equal(step.apply(noisy, NOTHING).u_noise, 2.0)
    compared = Average(name="average").apply(joined([one, one]), NOTHING)
    np.testing.assert_array_equal(step.apply(compared, NOTHING).u_noise, compared.u_noise)


@pytest.mark.realdata
def test_the_repeatability_that_ships_is_that_of_the_instrument(shared_data):
    """Catches a figure in the recipes that the files of one sample at three stage angles do not show."""
    raw = shared_data / "rt300s" / "raw"
    files = [raw / f"{name}.xls" for name in bench.STEEL]
    found = reduce_files(files, "rt300s", blank=bench.BLANK).repeatability
    for name in ("rt300s", "rt300s-fred", "rt300s-zemax"):
        (step,) = [step for step in load(name).step if step.name == "repeatability"]
        assert step.relative == pytest.approx(found.relative, rel=0.05)
        assert step.additive == pytest.approx(found.additive, rel=0.05)


@pytest.mark.realdata
def test_a_raw_file_states_its_uncertainty_as_the_recipe_does(shared_data):
    """Catches a raw file that `gonio check` reads by another chain, or without u; or fits weighted by it."""
    file = shared_data / "rt300s" / "raw" / f"{bench.STEEL[0]}.xls"
    reduced = reduce_files([file], "rt300s", blank=bench.BLANK).samples
    plain = read(file, blank=bench.BLANK)
    good = plain["flags"].to_numpy() == 0
    np.testing.assert_array_equal(reduced["flags"].to_numpy() == 0, good)
    assert "u_f_r" not in plain
    for ours, theirs in (("f_r", "f_r"), ("u_repeatability", "u_f_r")):
        np.testing.assert_allclose(plain[ours].to_numpy()[good], reduced[theirs].to_numpy()[good], rtol=1e-12)
    assert (plain["u_repeatability"].to_numpy()[good] >= 0.0449 * np.abs(plain["f_r"].to_numpy()[good])).all()


def test_an_alignment_without_its_use_is_refused():
    """Catches a recipe whose peak alignment does nothing, silently."""
    steps = [{"name": "align_peak"}, {"name": "average"}]
    with pytest.raises(BadInput, match="no specular_grid after it"):
        parsed({"title": "x", "step": steps}, "mine.toml")


@pytest.mark.parametrize("peaks", [1, 2])
def test_an_alignment_from_few_peaks_is_not_exact(peaks):
    """Catches a shift that claims to be known better than the grid on which the peak was looked for."""
    fine = ([20.0, 40.0][:peaks], np.arange(-90, 91, 2.0), np.arange(-70, 71, 2.0))
    found = AlignPeak(name="align_peak").apply(scan(*fine, value=lobe(0.0)), NOTHING)
    assert 0.1 < np.degrees(found.u_sideways_rad) * np.sqrt(12.0 * peaks) < 3.0


@pytest.mark.parametrize("sideways", [-0.12, 0.0, 0.15])
def test_a_crooked_peak_is_brought_into_the_plane(sideways):
    """Catches a shift with the wrong sign, or in degrees."""
    fine = ([20.0, 40.0], np.arange(-90, 91, 2.0), np.arange(-70, 71, 2.0))
    readings = AlignPeak(name="align_peak").apply(scan(*fine, value=lobe(sideways)), NOTHING)
    # The lobe is made in the sines of the angles; the peak of cos-foreshortened grids is within a step of it.
    assert readings.sideways_rad == pytest.approx(np.arcsin(sideways), abs=np.radians(2.5))
    assert "align_peak" in readings.notes[0]


def test_specular_grid_keeps_constants_and_counts_errors():
    """Catches cells invented outside of the readings, the mirror direction repeated, and errors lost."""
    constant = scan([0.0, 30.0], *FULL[1:], value=2.0, u_noise=0.3, u_common=0.2)
    averaged = Average(name="average", mirror=True).apply(constant, NOTHING)
    grid = SpecularGrid(name="specular_grid", azimuth_deg=(0, 45, 90, 180), radial_deg=(0, 20, 40, 100))
    done = grid.apply(averaged, NOTHING)
    usable = done.flags[:, 0] == 0
    np.testing.assert_allclose(done.value[usable], 2.0)
    np.testing.assert_allclose(done.u_common[usable], 0.2)
    assert (done.u_noise[usable] > 0.0).all()
    assert (done.u_noise[usable] <= 0.3 + 1e-12).all()
    assert (np.isnan(done.value[:, 0]) == ~usable).all()
    for light in (0.0, 30.0):
        mirror = np.isclose(done.theta_i, np.radians(light)) & np.isclose(done.theta_o, np.radians(light))
        assert (mirror & (np.isclose(np.abs(done.between), np.pi) | (light == 0.0))).sum() == 1


@pytest.mark.realdata
def test_command(shared_data, tmp_path, capsys):
    """Catches a command that hides its steps, its legacy, its repeatability, or writes something else."""
    raw = shared_data / "rt300s" / "raw"
    files = [str(raw / f"{name}.xls") for name in bench.STEEL]
    out = tmp_path / "steel.nc"
    arguments = ["reduce", *files, "--blank", str(bench.BLANK), "--recipe", "rt300s-fred", "-o", str(out)]
    assert main([*arguments, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["repeatability"]["files"] == 3
    assert any("floor_shift" in note for note in result["notes"])
    samples = read(out)
    assert samples.attrs["recipe_steps"] == "; ".join(result["steps"])
    assert "blank_v2o0_20250911.xls" in samples.attrs["recipe_files"]
    assert samples.sizes["sample"] == result["samples"]
    assert main(arguments) == 0
    assert "degrees of freedom" in capsys.readouterr().out


@pytest.mark.realdata
def test_command_refuses(shared_data, tmp_path, capsys):
    """Catches options that are silently ignored, and a recipe on files that it is not for."""
    raw = shared_data / "rt300s" / "raw"
    sample = str(shutil.copy(raw / f"{bench.STEEL[0]}.xls", tmp_path / "a.xls"))
    out = str(tmp_path / "a.nc")
    paint = str(shared_data / "cornell" / "garnet_red.brdf")
    (tmp_path / "r.toml").write_text('title = "t"\n[[step]]\nname = "cosine"\n')
    for arguments, message in (
        (["--recipe", "rt300s", "-o", out], "--blank"),
        (["--recipe", "rt300s", "--blank", out, "-o", out], "no such file"),
        (["--recipe", str(tmp_path / "r.toml"), "--blank", sample, "-o", out], "no step that takes a blank"),
        (["--recipe", "rt300s", "--blank", sample], "--out"),
        (["--recipe", "rt300s", "--bin-px", "8", "-o", out], "--bin-px"),
        (["--blank", sample], "--recipe"),
        ([], "give --recipe"),
    ):
        assert main(["reduce", sample, *arguments]) == 2
        assert message in capsys.readouterr().err
    assert main(["reduce", paint, "--recipe", "rt300s", "--blank", sample, "-o", out]) == 2
    assert "RT-300S" in capsys.readouterr().err


@pytest.mark.realdata
def test_history_is_of_the_library_too(shared_data):
    """Catches samples that do not say how they were reduced."""
    reduced = reduce_files([bench.RAW / f"{bench.STEEL[0]}.xls"], "rt300s", blank=bench.BLANK)
    assert "shadow_cut polar_deg=10 azimuth_deg=30" in reduced.samples.attrs["recipe_steps"]
    assert reduced.repeatability is None
    assert reduced.notes == ()
