"""Zemax and FRED files: the published pair against each other, the grid's geometry, damaged files."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

from analysis.formats import zemax
from analysis.samples import make_samples, read, write
from rig.angles import mirror, spherical_to_direction
from rig.errors import BadInput

FRED = "type bsdf_data\nformat angles=deg bsdf=value scale=2\n10 0\n0 0 0.25\n30 90 0.5\n40 0\n30 0 1e-1\n"
ZEMAX = """# comment
Source Measured
Symmetry PlaneSymmetrical
SpectralContent Monochrome
ScatterType BRDF
SampleRotation 1
0
AngleOfIncidence 2
10 40
ScatterAzimuth 2
0 180
ScatterRadial 2
0 30

Monochrome
DataBegin
TIS 0.1
0.5 0.25
0.5 0.125
TIS 0.1
0.75 0.0
0.75 0.0625
DataEnd
"""
PAIRS = ("AnoBlackEC1onAlum", "AnoBlackNiTEonSteel")


@pytest.fixture
def save(tmp_path):
    """Return a function that writes a file whose suffix says nothing."""

    def write_file(content):
        path = tmp_path / "file.dat"
        path.write_bytes(content.encode())
        return path

    return write_file


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_fred(save, ends):
    """Catches a scale that is not applied, and a light on the mirror direction's side."""
    samples = read(save(FRED.replace("\n", ends)))
    np.testing.assert_array_equal(samples["f_r"][:, 0], [0.5, 1.0, 0.2])
    deg = np.pi / 180.0
    np.testing.assert_allclose(
        samples["wi"], spherical_to_direction(np.array([10, 10, 40]) * deg, np.pi), atol=1e-15
    )
    np.testing.assert_allclose(
        samples["wo"],
        spherical_to_direction(np.array([0, 30, 30]) * deg, np.array([0, 90, 0]) * deg),
        atol=1e-15,
    )


def test_zemax_geometry(save):
    """Catches azimuths counted from the wrong side and cells below the horizon taken for samples."""
    samples = read(save(ZEMAX))
    np.testing.assert_array_equal(samples["f_r"][:, 0], [0.5, 0.25, 0.125, 0.75, 0.0, 0.0625])
    np.testing.assert_allclose(samples["wo"][0], mirror(samples["wi"].to_numpy()[0]), atol=1e-15)
    # From 10 deg, 30 deg towards the normal ends 20 deg beyond it, on the light's side.
    np.testing.assert_allclose(samples["wo"][1], spherical_to_direction(np.radians(20.0), 0.0), atol=1e-15)
    np.testing.assert_allclose(samples["wo"][2], spherical_to_direction(np.radians(40.0), np.pi), atol=1e-12)
    np.testing.assert_array_equal(samples["flags"][:, 0] != 0, [0, 0, 0, 0, 1, 0])
    assert read(save(ZEMAX.replace("0 30\n", "0 60\n"))).sizes["sample"] == 5


def test_zemax_rotation_and_tristimulus(save):
    """Catches blocks of channels or of sample rotations in the wrong order."""
    body = ZEMAX.split("Monochrome\nDataBegin")[1]
    header = ZEMAX.split("\nMonochrome", maxsplit=1)[0].replace(
        "SpectralContent Monochrome", "SpectralContent XYZ"
    )
    text = header + "".join(f"\nTristimulus{name}\nDataBegin{body}" for name in "XYZ")
    samples = read(save(text))
    assert list(samples["channel"].to_numpy()) == ["X", "Y", "Z"]
    np.testing.assert_array_equal(samples["f_r"][0], [0.5, 0.5, 0.5])
    turned = ZEMAX.replace("SampleRotation 1\n0", "SampleRotation 2\n0 90").replace(
        "DataEnd", "TIS 0 9 8 7 6 TIS 0 5 4 3 2 DataEnd"
    )
    samples = read(save(turned))
    np.testing.assert_array_equal(samples["f_r"][6:, 0], [9, 8, 6, 5, 4, 2])
    np.testing.assert_allclose(
        samples["wi"][6], spherical_to_direction(np.radians(10.0), np.pi / 2), atol=1e-15
    )
    np.testing.assert_allclose(samples["wo"][6], mirror(samples["wi"].to_numpy()[6]), atol=1e-15)


@pytest.mark.realdata
@pytest.mark.parametrize("name", PAIRS)
def test_published_pair(shared_data, name):
    """Catches any wrong convention: two files of one sample, directions within 1.5 deg."""
    folder = shared_data / "rt300s" / "published"
    specular, plain = read(folder / f"{name}.bsdf"), read(folder / f"{name}_fullAz.txt")
    assert plain.sizes["sample"] == 2175
    assert read(folder / f"{name}.txt").sizes["sample"] == 1144
    ratios = []
    usable = np.flatnonzero(specular["flags"].to_numpy()[:, 0] == 0)
    turned = specular["wo"].to_numpy() * [-1.0, -1.0, 1.0]  # the light to the other file's side
    for index in usable:
        alike = np.abs(plain["wi"].to_numpy()[:, 2] - float(specular["wi"][index, 2])) < 1e-6
        distance = np.linalg.norm(plain["wo"].to_numpy()[alike] - turned[index], axis=1)
        if distance.min() < np.radians(1.5):
            ratios.append(
                float(specular["f_r"][index, 0] / plain["f_r"].to_numpy()[alike][distance.argmin(), 0])
            )
    assert len(ratios) > 150
    # The mirror-relative file had its maximum moved and was interpolated.
    assert np.median(ratios) == pytest.approx(1.0, abs=0.04)
    # With the azimuth counted from the other side this is 0.43 and 0.50.
    assert np.quantile(np.abs(np.array(ratios) - 1.0), 0.8) < 0.15


def test_total_scatter_of_a_diffuser(tmp_path):
    """Catches a wrong solid angle, cosine or factor of two in the TIS: a diffuser of 0.5 scatters 0.5."""
    theta, phi = np.radians(np.meshgrid(np.arange(0.0, 91.0, 3.0), np.arange(0.0, 360.0, 10.0)))
    wo = spherical_to_direction(theta.ravel(), phi.ravel())
    wi = np.broadcast_to(spherical_to_direction(np.radians(30.0), np.pi), wo.shape)
    path = tmp_path / "white.zemax.bsdf"
    write(make_samples(wi, wo, np.full(len(wo), 0.5 / np.pi)), path)
    lines = [line.split() for line in path.read_text().splitlines() if line.startswith("TIS")]
    assert [float(words[1]) for words in lines] == [pytest.approx(0.5, rel=0.02)]


def test_write_and_read(tmp_path):
    """Catches a grid turned or mirrored against the samples: a lobe off the plane of incidence comes back."""
    random = np.random.default_rng(0)
    theta_i = np.repeat(np.radians([20.0, 50.0]), 3000)
    phi_i = random.uniform(-np.pi, np.pi, 6000)
    wi = spherical_to_direction(theta_i, phi_i)
    wo = spherical_to_direction(
        np.arccos(random.uniform(0.1, 1.0, 6000)), random.uniform(-np.pi, np.pi, 6000)
    )

    def lobe(wi, wo):
        return 0.1 + np.exp(3.0 * (np.sum(mirror(wi) * wo, axis=-1) - 1.0))

    path = tmp_path / "lobe.zemax.bsdf"
    write(make_samples(wi, wo, lobe(wi, wo)), path)
    assert "median" in path.read_text()
    back = read(path)
    usable = back["flags"].to_numpy()[:, 0] == 0
    expected = lobe(back["wi"].to_numpy(), back["wo"].to_numpy())[usable]
    assert np.quantile(np.abs(back["f_r"].to_numpy()[usable, 0] / expected - 1.0), 0.95) < 0.02


def test_write_refuses_what_the_format_cannot_hold(tmp_path):
    """Catches channels that vanish and incidences that are invented from single samples."""
    up = [[0, 0, 1.0]]
    with pytest.raises(BadInput, match="one channel"):
        write(make_samples(up, up, [[1.0, 2.0]]), tmp_path / "a.zemax.bsdf")
    with pytest.raises(BadInput, match="fewer than 4"):
        write(make_samples(up, up, [1.0]), tmp_path / "a.zemax.bsdf")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (ZEMAX.replace("0.75 0.0\n", "0.75\n"), "line 23, column 1: 'DataEnd' is not a number"),
        (ZEMAX[: ZEMAX.index("0.0625")], "line 22: the file ends before all cells"),
        (ZEMAX.replace("0.25", "0,25"), "line 18, column 2: '0,25'.*point"),
        (ZEMAX.replace("0.25", "nan"), "line 18, column 2.*finite"),
        (ZEMAX.replace("ScatterRadial 2", "ScatterRadial 3"), "line 15, column 1: 'Monochrome'"),
        (ZEMAX.replace("ScatterRadial 2", "ScatterRadial 1"), "'30' is no word of the header"),
        (ZEMAX.replace("ScatterAzimuth 2", "ScatterAzimuth 99999999999"), "no number of angles"),
        (ZEMAX.replace("10 40", "10 100"), "100 in AngleOfIncidence"),
        (ZEMAX.replace("ScatterType BRDF", "ScatterType BTDF"), "BTDF.*BRDF"),
        (ZEMAX.replace("SpectralContent Monochrome\n", ""), "no SpectralContent"),
        (ZEMAX.replace("DataEnd", ""), "ends before DataEnd"),
        (FRED.replace("0.25", "0,25"), "line 4, column f: '0,25'.*point"),
        (FRED.replace("0.25", "inf"), "line 4, column f.*finite"),
        (FRED.replace("30 90 0.5", "30 90 0.5 7"), "line 5: has 4 numbers"),
        (FRED.replace("30 90 0.5", "130 90 0.5"), "line 5, column theta_s.*polar"),
        (FRED.replace("10 0\n", ""), "line 3: scatter without an incidence"),
        (FRED.replace("=deg", "=grad"), "line 2.*grad"),
        (FRED.replace("scale=2", "scale=0"), "line 2.*scale"),
        ("type bsdf_data\n", "line 2"),
        ("type bsdf_data\nformat angles=deg bsdf=value scale=1\n", "no samples"),
    ],
)
def test_damaged(save, content, complaint):
    """Catches tracebacks, silent truncation, and errors that do not name the place."""
    path = save(content)
    with pytest.raises(BadInput, match=complaint) as caught:
        read(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_every_truncation_ends_in_one_line_or_whole_blocks(save):
    """Catches a traceback at any byte where a copy may stop."""
    for text in (FRED, ZEMAX):
        for length in range(1, len(text)):
            with contextlib.suppress(BadInput):
                assert np.isfinite(read(save(text[:length]))["f_r"]).all()


def test_directions_are_unit_and_start_at_the_mirror():
    """Catches a frame about the mirror direction that is not orthonormal."""
    theta, azimuth = np.radians([0.0, 33.0, 90.0]), np.radians([10.0, 120.0, 250.0])
    w = zemax.directions(theta, azimuth, np.radians([0.0, 25.0, 80.0]))
    np.testing.assert_allclose(np.linalg.norm(w, axis=-1), 1.0, atol=1e-15)
    cosine = np.sum(w * mirror(spherical_to_direction(theta, 0.0)), axis=-1)
    np.testing.assert_allclose(cosine, np.cos(np.radians([0.0, 25.0, 80.0])), atol=1e-15)
