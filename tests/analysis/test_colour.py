"""Colours from a chart: found in any position, in the right order, and corrected whatever the exposure."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from scipy.stats import spearmanr

from analysis.colour_calibration import (
    VISIBLE_NM,
    ColourCalibration,
    attributes_of,
    colours_of,
    load_colour,
    markov_prior,
    reference_reflectance,
    save_colour,
    spectral_estimate,
    typical_response,
)
from analysis.colour_chart import NEUTRAL, Picture, levelled, picture_of, read_chart
from analysis.colour_fit import choose_colour, expanded, fit_colour, lab, xyz_of_spectra
from analysis.spectra import read_spectrum
from gonio.cli import main
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

NAMES, REFLECTANCE = reference_reflectance(VISIBLE_NM)
RESPONSE = typical_response(VISIBLE_NM)
READS = REFLECTANCE @ RESPONSE
D65 = read_spectrum("colour:D65").at(VISIBLE_NM)[:, 0]
XYZ = xyz_of_spectra(VISIBLE_NM, REFLECTANCE, D65)
WHITE = xyz_of_spectra(VISIBLE_NM, np.ones((1, VISIBLE_NM.size)), D65)[0]
PATCH_PX = 24


def chart(reads: Array = READS, *, noise: float = 0.01, corners: Array | None = None) -> Picture:
    """Draw a chart on black card before a grey wall, its corners anywhere in a picture of 320 x 240."""
    card = np.full((4 * PATCH_PX + 8, 6 * PATCH_PX + 8, reads.shape[1]), 0.03)
    for number, value in enumerate(reads):
        row, column = divmod(number, 6)
        top, left = 4 + row * PATCH_PX + 3, 4 + column * PATCH_PX + 3
        card[top : top + PATCH_PX - 5, left : left + PATCH_PX - 5] = value
    height, width = card.shape[:2]
    if corners is None:
        corners = np.array([[60, 50], [260, 60], [255, 190], [70, 185]], dtype=np.float32)
    edge = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float32)
    across = cv2.getPerspectiveTransform(edge, corners.astype(np.float32))
    size = (320, 240)
    wall = np.full((*size[::-1], reads.shape[1]), 0.4)
    inside = cv2.warpPerspective(np.ones((height, width)), across, size) > 0.5
    drawn = np.stack(
        [cv2.warpPerspective(card[..., c].copy(), across, size) for c in range(reads.shape[1])], axis=-1
    )
    values = 1000.0 * np.where(inside[..., None], drawn, wall)
    values *= 1.0 + noise * np.random.default_rng(0).standard_normal(values.shape)
    return Picture(values, np.ones(values.shape, dtype=bool))


QUAD = np.array([[60, 50], [260, 60], [255, 190], [70, 185]], dtype=np.float32)
UPRIGHT = np.array([[110, 15], [210, 15], [205, 225], [112, 220]], dtype=np.float32)


@pytest.mark.parametrize(
    ("corners", "order"),
    [
        (QUAD, "upright"),
        (np.roll(QUAD, 2, axis=0), "turned by 180 deg"),
        (np.roll(UPRIGHT, 1, axis=0), "turned by 90 deg"),
        (np.roll(UPRIGHT, -1, axis=0), "turned by 90 deg"),
        (QUAD[[1, 0, 3, 2]], "turned by 180 deg, mirrored"),
    ],
)
def test_a_chart_is_found_and_ordered(corners: Array, order: str) -> None:
    """Would catch patches out of order: turned by any quarter, in perspective, or mirrored."""
    reading = read_chart(chart(corners=corners), READS)
    np.testing.assert_allclose(reading.values / 1000.0, READS, rtol=0.03, atol=0.002)
    assert reading.agreement > 0.99
    assert reading.order == order
    assert np.all(np.abs(reading.values / 1000.0 - READS) < 8.0 * np.maximum(reading.u_values / 1000.0, 2e-4))


def test_given_corners_need_no_finding() -> None:
    """Would catch corners taken in one order only."""
    drawn = chart()
    expected = read_chart(drawn, READS).values
    for turn in range(4):
        found = read_chart(drawn, READS, [tuple(each) for each in np.roll(QUAD, turn, axis=0)])
        np.testing.assert_allclose(found.values, expected, rtol=0.02, atol=2.0)


def test_one_channel_is_enough_for_the_order() -> None:
    """Would catch a chart that is found in colour alone."""
    one = read_chart(chart(READS[:, :1]), READS[:, :1])
    np.testing.assert_allclose(one.values / 1000.0, READS[:, :1], rtol=0.03, atol=0.002)


@pytest.mark.parametrize("reads", [np.full((24, 3), 0.5), READS[np.random.default_rng(1).permutation(24)]])
def test_what_is_no_chart_is_refused(reads: Array) -> None:
    """Would catch colours made of a grey field, or of patches in nobody's order."""
    with pytest.raises(BadInput, match=r"no order|no chart|covers"):
        read_chart(chart(reads), READS, [tuple(each) for each in QUAD])


def test_a_picture_without_a_chart_is_refused() -> None:
    """Would catch a chart seen in a wall."""
    wall = np.random.default_rng(2).normal(100.0, 3.0, (120, 160, 3))
    with pytest.raises(BadInput, match="--corners"):
        read_chart(Picture(wall, np.ones(wall.shape, dtype=bool)), READS)


def test_a_clipped_patch_is_named() -> None:
    """Would catch a white that is the clip level."""
    drawn = chart()
    usable = drawn.values < 800.0
    with pytest.raises(BadInput, match="patch 19 is clipped"):
        read_chart(Picture(drawn.values, usable), READS)


def test_hot_pixels_do_not_count() -> None:
    """Would catch a patch's value pulled by pixels that are known to be wrong."""
    drawn = chart(noise=0.0)
    bad = np.random.default_rng(3).random(drawn.values.shape) < 0.2
    reading = read_chart(Picture(np.where(bad, 1e6, drawn.values), ~bad), READS, [tuple(e) for e in QUAD])
    np.testing.assert_allclose(reading.values / 1000.0, READS, rtol=0.02, atol=0.002)


def test_cells_of_a_mosaic_become_channels() -> None:
    """Would catch channels put at each other's sites, and a bad site that counts."""
    cfa = np.array([[1, 0], [2, 1]])
    radiance = np.tile(np.array([[10.0, 1.0], [100.0, 20.0]]), (3, 4))
    flags = np.zeros(radiance.shape, dtype=np.uint8)
    flags[0, 1] = 4
    picture = picture_of(radiance, flags, cfa, 3, 4)
    assert picture.px == 2
    np.testing.assert_array_equal(picture.values[0, 0], [1.0, 15.0, 100.0])
    assert picture.usable[0, 0].tolist() == [False, True, True]
    assert picture.usable[1:].all()


def test_uneven_light_is_taken_off() -> None:
    """Would catch a slope of the light that stays in the colours."""
    column = np.tile(np.arange(6) / 6.0 - 5.0 / 12.0, 4)
    slope = np.log1p([0.3, -0.2, 0.0])
    values, slopes = levelled(5.0 * READS * np.exp(column[:, None] * slope), READS)
    np.testing.assert_allclose(values, 5.0 * READS, rtol=1e-6)
    np.testing.assert_allclose(slopes[0], [0.3, -0.2, 0.0], atol=1e-6)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_corrections_do_not_depend_on_the_exposure(degree: int) -> None:
    """Would catch a polynomial without roots: colours that change when it gets darker."""
    fit = fit_colour(READS, XYZ, WHITE, degree)
    np.testing.assert_allclose(fit.xyz(0.07 * READS), 0.07 * fit.xyz(READS), rtol=1e-9)
    np.testing.assert_allclose(fit.xyz(np.ones(3)), WHITE, rtol=1e-9)


def test_a_true_matrix_is_found() -> None:
    """Would catch a fit that is not of XYZ."""
    matrix = np.array([[0.5, 0.3, 0.15], [0.25, 0.65, 0.1], [0.02, 0.1, 0.97]])
    fit = choose_colour(READS, READS @ matrix.T, matrix.sum(axis=1))[0]
    assert fit.degree == 1
    np.testing.assert_allclose(fit.matrix, matrix, rtol=1e-6)
    assert fit.left_out.max() < 1e-4


def test_left_out_patches_are_worse_than_fitted_ones() -> None:
    """Would catch a cross-validation that leaves nothing out."""
    for fit in choose_colour(READS, XYZ, WHITE):
        assert fit.left_out.mean() > fit.delta_e.mean()


def test_too_few_patches_and_gaps_are_refused() -> None:
    """Would catch more terms than patches, and a patch that nobody measured."""
    with pytest.raises(BadInput, match="lower degree"):
        fit_colour(READS[:10], XYZ[:10], WHITE, 3)
    gap = READS.copy()
    gap[3, 1] = np.nan
    with pytest.raises(BadInput, match="without a value"):
        fit_colour(gap, XYZ, WHITE, 1)


def test_terms_are_of_the_first_degree() -> None:
    """Would catch a term that scales otherwise, and shapes other than (..., 3)."""
    for degree, terms in ((1, 3), (2, 6), (3, 13)):
        some = np.random.default_rng(4).random((2, 5, 3))
        assert expanded(some, degree).shape == (2, 5, terms)
        np.testing.assert_allclose(expanded(3.0 * some, degree), 3.0 * expanded(some, degree), rtol=1e-12)
    assert np.isnan(expanded(np.array([0.1, np.nan, 0.2]), 2)).any()


def test_colours_of_spectra_are_those_of_the_library() -> None:
    """Would catch a wrong observer, lamp or white: colour-science integrates on its own."""
    import colour

    shape = colour.SpectralShape(400.0, 700.0, 5.0)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape)
    lamp = colour.SDS_ILLUMINANTS["D65"].copy().align(shape)
    chart_xyz = [
        colour.sd_to_XYZ(
            colour.SpectralDistribution(row, shape.range()), observer, lamp, method="Integration"
        )
        / 100.0
        for row in REFLECTANCE[:4]
    ]
    np.testing.assert_allclose(XYZ[:4], chart_xyz, rtol=2e-3)
    np.testing.assert_allclose(lab(XYZ, WHITE), colour.XYZ_to_Lab(XYZ, colour.XYZ_to_xy(WHITE)), atol=0.02)


def test_known_sensitivities_give_the_spectrum() -> None:
    """Would catch an estimate that contradicts its channels, or an uncertainty that is too small."""
    found, u_found = spectral_estimate(READS, np.full(READS.shape, 1e-4), RESPONSE, VISIBLE_NM)
    np.testing.assert_allclose(found @ RESPONSE, READS, atol=2e-3)
    inside = np.abs(found - REFLECTANCE) <= 2.0 * u_found
    assert inside.mean() > 0.9
    drawn = 0.3 + np.random.default_rng(5).multivariate_normal(
        np.zeros(VISIBLE_NM.size), markov_prior(VISIBLE_NM), 400
    )
    found, u_found = spectral_estimate(drawn @ RESPONSE, np.full((400, 3), 1e-6), RESPONSE, VISIBLE_NM)
    # Of reflectances as the prior says, one standard uncertainty holds 68.3 %; they hang together along nm.
    assert np.mean(np.abs(found - drawn) <= u_found) == pytest.approx(0.683, abs=0.03)


def calibration() -> ColourCalibration:
    """Return one of a camera with typical responses."""
    fit = fit_colour(READS, XYZ, WHITE, 1)
    mean, most = float(fit.left_out.mean()), float(fit.left_out.max())
    return ColourCalibration(("R", "G", "B"), fit.matrix, WHITE, "colour:D65", mean, most, "2026-01-02", "c")


def test_a_calibration_is_read_back(tmp_path: Path) -> None:
    """Would catch a number lost on the way."""
    wanted = calibration()
    save_colour(wanted, choose_colour(READS, XYZ, WHITE), tmp_path / "colour.toml")
    found = load_colour(tmp_path / "colour.toml")
    np.testing.assert_array_equal(found.matrix, wanted.matrix)
    assert (found.channels, found.lamp, found.delta_e_mean) == (
        wanted.channels,
        wanted.lamp,
        wanted.delta_e_mean,
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("version = 1", "version = 9"),
        ("white_xyz", "white"),
        ("delta_e_mean = ", "delta_e_mean = nan #"),
        ("[", "[["),
    ],
)
def test_a_bad_calibration_is_named(tmp_path: Path, old: str, new: str) -> None:
    """Would catch a traceback, or numbers that are none."""
    path = tmp_path / "colour.toml"
    save_colour(calibration(), [], path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(BadInput, match=r"colour\.toml"):
        load_colour(path)


def test_a_perfect_white_is_white_on_a_display() -> None:
    """Would catch an adaptation the wrong way round."""
    np.testing.assert_allclose(calibration().linear_srgb(np.ones(3)), 1.0, atol=1e-9)


def test_samples_carry_the_matrices(tmp_path: Path) -> None:
    """Would catch XYZ of another camera's channels, and a matrix that is transposed."""
    assert attributes_of(tmp_path, ["R", "G", "B"]) == {}
    known = calibration()
    save_colour(known, [], tmp_path / "colour.toml")
    carried = attributes_of(tmp_path, ["R", "G", "B"])
    values = np.array([0.2, 0.3, 0.1])
    np.testing.assert_allclose(np.reshape(carried["xyz_of_channels"], (3, 3)) @ values, known.xyz(values))
    np.testing.assert_allclose(
        np.reshape(carried["linear_srgb_of_channels"], (3, 3)) @ values, known.linear_srgb(values)
    )
    with pytest.raises(BadInput, match="of the channels"):
        attributes_of(tmp_path, ["mono"])


def merge_file(path: Path, picture: Picture, channels: tuple[str, ...]) -> Path:
    """Write a picture as a merge: each cell RGGB of three channels, or of one."""
    values = picture.values if len(channels) == 3 else np.repeat(picture.values, 3, axis=-1)
    sites = [[0, 1], [1, 2]]
    radiance = np.empty((2 * values.shape[0], 2 * values.shape[1]))
    for row in (0, 1):
        for column in (0, 1):
            radiance[row::2, column::2] = values[..., sites[row][column]]
    np.savez(
        path,
        radiance=radiance,
        variance=np.ones_like(radiance),
        flags=np.zeros(radiance.shape, dtype=np.uint8),
        cfa=np.array(sites) if len(channels) == 3 else np.zeros((2, 2), dtype=np.int64),
        channels=np.array(channels),
    )
    return path


def test_the_command_calibrates_a_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Would catch a command whose calibration does not give the chart's colours."""
    path = merge_file(tmp_path / "chart.npz", chart(), ("R", "G", "B"))
    out = tmp_path / "calibration"
    assert main(["calibrate", "colour", str(path), "--out", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["order"] == "upright"
    assert facts["fits"][0]["delta_e_mean"] < 4.0
    known = load_colour(out / "colour.toml")
    values = np.array([patch["values"] for patch in facts["patches"]])
    np.testing.assert_allclose(known.xyz(values)[18], XYZ[18], rtol=0.02)
    assert "CIEDE2000" in next(out.glob("colour-*/report.html")).read_text()


def test_the_command_takes_three_bands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Would catch bands that are mixed up, and files without their wavelengths."""
    bands = (650.0, 550.0, 450.0)
    reads = REFLECTANCE @ typical_response(VISIBLE_NM, bands)
    paths = [
        str(merge_file(tmp_path / f"{nm:g}.npz", chart(reads[:, c : c + 1]), ("mono",)))
        for c, nm in enumerate(bands)
    ]
    out = ["--out", str(tmp_path / "calibration"), "--json"]
    assert main(["calibrate", "colour", *paths, "--bands-nm", "650,550,450", *out]) == 0
    facts = json.loads(capsys.readouterr().out)
    values = np.array([patch["values"] for patch in facts["patches"]])
    np.testing.assert_allclose(values / values[18], reads / reads[18], rtol=0.03)
    assert main(["calibrate", "colour", *paths, *out]) == 2
    assert main(["calibrate", "colour", *paths, "--bands-nm", "650,550,950", *out]) == 2


def test_the_command_uses_known_sensitivities(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Would catch patches compared with what another lamp would give."""
    table = tmp_path / "camera.csv"
    rows = np.column_stack([VISIBLE_NM, RESPONSE])
    table.write_text("\n".join(",".join(f"{value:.8g}" for value in row) for row in rows))
    path = merge_file(tmp_path / "chart.npz", chart(), ("R", "G", "B"))
    given = [
        "calibrate",
        "colour",
        str(path),
        "--out",
        str(tmp_path),
        "--json",
        "--sensitivities",
        str(table),
    ]
    assert main([*given, "--lit-by", "colour:E"]) == 0
    spectral = json.loads(capsys.readouterr().out)["spectral"]
    assert spectral["median_apart"] < 0.01
    assert spectral["delta_e_mean"] < 5.0
    assert main(given) == 2


@pytest.mark.parametrize(
    "change",
    [
        {"radiance": np.ones(3)},
        {"cfa": np.full((2, 2), 7)},
        {"flags": None},
        {"channels": np.array(["R"] * 2)},
    ],
)
def test_what_is_no_merge_is_refused(
    tmp_path: Path, change: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """Would catch a traceback over arrays of another kind."""
    path = merge_file(tmp_path / "chart.npz", chart(), ("R", "G", "B"))
    with np.load(path) as archive:
        content = dict(archive)
    content |= change
    np.savez(path, **{name: value for name, value in content.items() if value is not None})
    assert main(["calibrate", "colour", str(path), "--out", str(tmp_path)]) == 2
    assert "gonio calibrate: " in capsys.readouterr().err
    path.write_bytes(path.read_bytes()[:500])
    assert main(["calibrate", "colour", str(path), "--out", str(tmp_path)]) == 2


@pytest.mark.realdata
def test_a_real_chart_in_three_bands(shared_data: Path) -> None:
    """Would catch patches of the Flea3's ColorChecker lost, out of order, or apart between its bands."""
    from benchmarks.imaging_flea3 import chart_in_bands

    reading, alone, expected = chart_in_bands(shared_data / "flea3")
    assert reading.order == "upright"
    level, _ = levelled(reading.values, expected)
    for channel, other in enumerate(alone):
        assert other.order == reading.order
        # The detector places the chart to a fraction of a patch, 55 pixels wide here.
        assert np.abs(other.centres_px - reading.centres_px).max() < 55.0 / 4.0
        np.testing.assert_allclose(other.values[:, 0], reading.values[:, channel], rtol=0.1)
        assert spearmanr(level[:, channel], expected[:, channel]).statistic > 0.98
        greys = level[list(NEUTRAL), channel]
        assert all(first > 1.2 * second for first, second in pairwise(greys))
    colours = colours_of(reading, expected, REFLECTANCE, read_spectrum("colour:D65"))
    assert colours.matrix.left_out.mean() < 6.0
