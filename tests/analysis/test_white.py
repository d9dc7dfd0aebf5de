"""The white as a table: a shape that is not reciprocal, a certificate that moves, a u that flatters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from analysis.white import LambertianWhite, PlateWhite, white_of
from analysis.white_calibration import (
    U_CENTRE_NM,
    Certificate,
    Points,
    WhiteCalibration,
    load_white,
    save_white,
)
from analysis.white_files import read_certificate, read_points
from analysis.white_shape import CERTIFICATE_RAD, PtfeShape, chandrasekhar_h, volume_factor
from rig.angles import spherical_to_direction
from rig.errors import BadInput

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt
    from numpy.typing import NDArray

    from rig.description import Rig

    Float = NDArray[np.float64]

SETS = ("20250210_S7_sample_final.txt", "20250409_S7_swir_sample.txt")


def direction(theta_deg: npt.ArrayLike, phi_deg: npt.ArrayLike = 0.0) -> Float:
    """Make unit directions from degrees."""
    return spherical_to_direction(np.deg2rad(theta_deg), np.deg2rad(phi_deg))


def random_pairs(seed: int, number: int = 400) -> tuple[Float, Float]:
    """Draw pairs of directions above the horizon."""
    rng = np.random.default_rng(seed)
    drawn = [direction(rng.uniform(0.0, 88.0, number), rng.uniform(0.0, 360.0, number)) for _ in (0, 1)]
    return drawn[0], drawn[1]


def hemispherical(shape: PtfeShape, wi: Float) -> float:
    """Reflectance into the hemisphere of one direction of incidence."""
    mu, weight = np.polynomial.legendre.leggauss(80)
    mu, weight = (mu + 1.0) / 2.0, weight / 2.0
    phi = (np.arange(90) + 0.5) * 4.0
    wo = direction(np.rad2deg(np.arccos(mu))[:, np.newaxis], phi)
    factor = shape.factor(np.broadcast_to(wi, wo.shape), wo)
    return float((2.0 * weight * mu * factor.mean(axis=1)).sum())


def test_h_is_chandrasekhars() -> None:
    """Table XI of Radiative Transfer, albedo 1: a wrong kernel, or an iteration that did not settle."""
    assert chandrasekhar_h([0.0, 0.1, 0.5, 1.0]) == pytest.approx([1.0, 1.24735, 2.01278, 2.90781], abs=2e-5)


@pytest.mark.parametrize("theta_deg", [0.0, 8.0, 45.0, 75.0])
def test_volume_loses_nothing(theta_deg: float) -> None:
    """A shape that brings energy or takes it; the coefficients of the generic one are 0."""
    assert hemispherical(PtfeShape.generic(), direction(theta_deg)) == pytest.approx(1.0, abs=2e-4)


def fitted_anyhow(seed: int) -> PtfeShape:
    """Return a shape fitted to points that depart by ten percent at random."""
    wi, wo = random_pairs(seed, 40)
    factor = volume_factor(wi, wo) * np.random.default_rng(seed).uniform(0.9, 1.1, 40)
    return PtfeShape.fitted(wi, wo, factor)


@pytest.mark.parametrize("seed", range(3))
def test_every_shape_is_reciprocal_and_keeps_the_certificate(seed: int) -> None:
    """Points that break reciprocity, or that change what a certificate of 8 degrees says."""
    shape = fitted_anyhow(seed)
    wi, wo = random_pairs(seed + 10)

    assert np.abs(shape.coefficients).max() > 1e-3
    assert shape.factor(wi, wo) == pytest.approx(shape.factor(wo, wi), rel=1e-12)
    assert shape.u_relative(wi, wo) == pytest.approx(shape.u_relative(wo, wi), rel=1e-12)
    assert hemispherical(shape, direction(np.rad2deg(CERTIFICATE_RAD))) == pytest.approx(1.0, abs=2e-4)


def test_fit_finds_a_plate_and_is_as_sure_as_it_says() -> None:
    """A plate of the family, points of 0.5 %, whose scale is 2 % off: shapes, and pulls over 40 plates."""
    rng = np.random.default_rng(3)
    wi, wo = random_pairs(5, 60)
    at, of = random_pairs(6, 50)
    pulls = []
    for _ in range(40):
        plate = PtfeShape(0.06 * rng.standard_normal(6), np.zeros((6, 6)), 0.0)
        points = 1.02 * plate.factor(wi, wo) * (1.0 + 0.005 * rng.standard_normal(60))
        found = PtfeShape.fitted(wi, wo, points)
        error = found.factor(at, of) / plate.factor(at, of) - 1.0
        # The term for what no term can follow is no error of this plate.
        sure = np.sqrt(found.u_relative(at, of) ** 2 - found.u_rest**2)
        pulls.append(error / sure)

    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.3


def test_generic_shape_covers_every_measured_point(shared_data: Path) -> None:
    """Uncertainty that flatters: two sets of one plate, each with its own scale, three points of another."""
    generic = PtfeShape.generic()
    pulls = []
    for name in SETS:
        points = read_points(shared_data / "spectralon" / name)
        ratio = np.log(points.factor / generic.factor(points.wi, points.wo))
        u = generic.u_relative(points.wi, points.wo)
        pulls += list((ratio - np.average(ratio, weights=u**-2)) / u)
    certificate = read_certificate(shared_data / "spectralon" / "Spectralon_Num4.txt")
    table = np.loadtxt(shared_data / "spectralon" / "panel-BRFs.csv", delimiter=",")
    for azimuth, view, source, nm, factor in table:
        wi, wo = direction(source), direction(view, azimuth)
        rho, u_rho = certificate.at(nm)
        expected = rho * generic.factor(wi, wo)
        pulls.append((factor - expected) / (expected * np.hypot(generic.u_relative(wi, wo), u_rho / rho)))

    assert len(pulls) > 35
    assert np.abs(pulls).max() < 2.5
    assert np.sqrt(np.mean(np.square(pulls))) < 1.0


@pytest.mark.parametrize("held_out", [(45.0, 45.0), (60.0, 0.0), (80.0, 0.0)])
def test_measured_points_predict_the_one_left_out(shared_data: Path, held_out: tuple[float, float]) -> None:
    """A fit that follows its points and nothing else: points in the SWIR predict the visible ones."""
    visible, swir = (read_points(shared_data / "spectralon" / name) for name in SETS)
    shape = PtfeShape.fitted(swir.wi, swir.wo, swir.factor)
    here = (visible.theta_i_deg == held_out[0]) & (visible.theta_o_deg == held_out[1])
    scale = np.mean((visible.factor / shape.factor(visible.wi, visible.wo))[visible.theta_i_deg < 40.0])

    error = visible.factor[here] / (scale * shape.factor(visible.wi[here], visible.wo[here])) - 1.0
    generic = PtfeShape.generic().u_relative(visible.wi[here], visible.wo[here])

    assert np.abs(error).max() < 0.02
    assert np.all(shape.u_relative(visible.wi[here], visible.wo[here]) < generic)


def test_certificate_is_read_and_interpolated(shared_data: Path) -> None:
    """A column off, or the uncertainty lost."""
    certificate = read_certificate(shared_data / "spectralon" / "Spectralon_Num4.txt")

    assert certificate.at(350.0) == (0.9878, 0.0053)
    assert certificate.at(350.5)[0] == pytest.approx((0.9878 + 0.9889) / 2)
    assert len(certificate.nm) > 2000
    with pytest.raises(BadInput, match="not 200 nm"):
        certificate.at(200.0)


def test_a_steep_certificate_is_less_certain_in_a_band() -> None:
    """A band's centre taken as if it were known to the nanometre."""
    nm = np.arange(400.0, 701.0, 10.0)
    flat, steep = (
        Certificate(nm, 0.9 + slope * (nm - 550.0), np.full(nm.size, 0.003)) for slope in (0.0, 4e-4)
    )
    assert flat.of_band(550.0) == flat.at(550.0)
    assert steep.of_band(550.0) == pytest.approx((0.9, np.hypot(0.003, 4e-4 * U_CENTRE_NM)))


def test_bands_of_points_are_told_apart(shared_data: Path) -> None:
    """The first band for all of them."""
    path = shared_data / "spectralon" / SETS[0]

    assert read_points(path, 445.0).factor[1] == 1.056617
    assert read_points(path, 1100.0).factor[1] == 1.074896


def test_calibration_file_round_trip(tmp_path: Path) -> None:
    """Something that the file loses."""
    column = np.array([10.0, 50.0])
    full = WhiteCalibration(
        Certificate(np.array([400.0, 700.0]), np.array([0.98, 0.99]), np.array([0.002, 0.003])),
        Points(column, 0.0 * column, column / 2, column, np.array([1.03, 0.98]), np.array([0.01, 0.02])),
        channel_nm=(600.0, 540.0, 460.0),
        name="plate 4",
        date="2026-01-02",
    )
    save_white(full, tmp_path / "white.toml")
    save_white(load_white(tmp_path / "white.toml"), tmp_path / "again.toml")

    assert (tmp_path / "again.toml").read_text() == (tmp_path / "white.toml").read_text()
    loaded = load_white(tmp_path / "white.toml")
    assert loaded.points is not None
    assert loaded.points.wo == pytest.approx(full.points.wo)  # type: ignore[union-attr]
    assert loaded.of_channels(3)[0] == pytest.approx([0.98 + 0.01 * t for t in (2 / 3, 1.4 / 3, 0.2)])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("certificate_nm = [400.0]", "do not fit together"),
        ("certificate_nm = [4.0, 4.0]\ncertificate_rho = [1, 1]\ncertificate_u = [0, 0]", "repeated"),
        ("certificate_nm = [400]\ncertificate_rho = [98.9]\ncertificate_u = [0.1]", "none of a white"),
        ("point_factor = ['a']", "not a list of numbers"),
        ("shape = 'mirror'", "mirror"),
        ("sheep = 1", "unknown key sheep"),
        ("version = 9", "version"),
        ("= 3", "not TOML"),
    ],
)
def test_calibration_files_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    """A traceback, or a white of 98.9."""
    (tmp_path / "white.toml").write_text(text)
    with pytest.raises(BadInput, match=message) as caught:
        load_white(tmp_path / "white.toml")
    assert "white.toml" in str(caught.value)


def test_what_a_machine_gets(default_rig: Rig) -> None:
    """A plate of which nothing is measured taken for a perfect diffuser; channels of one wavelength."""
    wi, wo = direction(60.0), direction(0.0)
    generic = white_of(default_rig, None, 3)
    flat = white_of(default_rig, WhiteCalibration(lambertian=True), 3)
    certificate = Certificate(np.array([400.0, 700.0]), np.array([0.9, 0.99]), np.array([0.01, 0.001]))
    bands = WhiteCalibration(certificate, channel_nm=(700.0, 550.0, 400.0))
    coloured = white_of(default_rig, bands, 3)

    assert isinstance(generic, PlateWhite)
    assert generic.rho(wi, wo) == pytest.approx(0.99 * 0.976, rel=2e-3)
    assert generic.u_rho(wi, wo) > 0.03 * 0.96
    assert isinstance(flat, LambertianWhite)
    assert flat.rho(wi, wo) == default_rig.white.rho
    values = coloured.rho(wi, wo, np.arange(3))
    assert values / values[0] == pytest.approx([1.0, 0.945 / 0.99, 0.9 / 0.99])
    assert np.all(np.diff(coloured.u_rho(wi, wo, np.arange(3)) / values) > 0.0)
    with pytest.raises(BadInput, match="3 wavelengths for 1 channel"):
        white_of(default_rig, bands, 1)
