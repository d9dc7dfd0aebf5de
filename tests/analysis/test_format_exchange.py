"""ASTM, ALTA and SSDD: conventions, round trips, damaged files."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

from analysis.samples import make_samples, read, write
from rig.angles import half_difference, mirror, spherical_to_direction
from rig.errors import BadInput

ASTM = (
    "SAMPLE x\nNUM_POINTS 2\nVARS theta_i,phi_i,theta_s,phi_s,500nm,600nm\n"
    "0.5,0,0.6,3,0.25,0.5\n0,0,1,1,2,4\n"
)
ALTA = "#DIM 4 1\n#PARAM_IN  SPHERICAL_TL_PL_TV_PV\n#PARAM_OUT INV_STERADIAN\n0.5 0 0.6 3 0.25\n0 0 1 1 2\n"
SSDD = """VERSION 0.2
# a comment
DATA_TYPE specular_reflectance
COLOR_MODEL monochrome
PARAM0_LIST 0
DATA ascii
0.5

DATA_TYPE brdf
COLOR_MODEL rgb
PARAM_TYPE spherical_coordinate_system
PARAM0_LIST 0 45
PARAM2_LIST 10 20
PARAM3_LIST 0 180
DATA ascii
1 2 3
4 5 6
7 8 9
10 11 12
13 14 15
16 17 18
19 20 21
22 23 24
"""


@pytest.fixture
def save(tmp_path):
    """Return a function that writes a file whose suffix says nothing."""

    def write_file(content):
        path = tmp_path / "file.dat"
        path.write_bytes(content.encode())
        return path

    return write_file


def _grid_samples():
    """Make samples on a full grid of 2 x 2 x 3 x 4 directions, in an order of their own."""
    grid = np.meshgrid([10.0, 60.0], [0.0, 90.0], [5.0, 40.0, 70.0], [0.0, 45.0, 180.0, 300.0])
    angles = np.radians([axis.ravel() for axis in grid])
    order = np.random.default_rng(1).permutation(angles.shape[1])
    theta_i, phi_i, theta_o, phi_o = angles[:, order]
    values = np.random.default_rng(2).uniform(0.01, 1.0, (angles.shape[1], 2))
    return make_samples(
        spherical_to_direction(theta_i, phi_i),
        spherical_to_direction(theta_o, phi_o),
        values,
        wavelength_nm=[450.0, 632.8],
    )


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_astm(save, ends):
    """Catches degrees, exchanged directions, and line ends that matter."""
    samples = read(save(ASTM.replace("\n", ends)))
    np.testing.assert_array_equal(samples["f_r"], [[0.25, 0.5], [2.0, 4.0]])
    np.testing.assert_array_equal(samples["wavelength_nm"], [500.0, 600.0])
    np.testing.assert_allclose(samples["wi"], spherical_to_direction([0.5, 0.0], [0.0, 0.0]), atol=1e-15)
    np.testing.assert_allclose(samples["wo"], spherical_to_direction([0.6, 1.0], [3.0, 1.0]), atol=1e-15)
    three = read(save("VARS theta_i,theta_s,phi_s,R,G,B\n0.5,0.6,3,1,2,3\n"))
    assert list(three["channel"].to_numpy()) == ["R", "G", "B"]
    np.testing.assert_allclose(three["wi"], spherical_to_direction([0.5], [0.0]), atol=1e-15)


def test_astm_round_trip(tmp_path):
    """Catches lost digits and flagged samples that are written as good ones."""
    samples = _grid_samples()
    samples["flags"][7, 1] = 1
    write(samples, tmp_path / "table.astm")
    back = read(tmp_path / "table.astm")
    keep = np.delete(np.arange(48), 7)
    np.testing.assert_array_equal(back["f_r"], samples["f_r"][keep])
    np.testing.assert_array_equal(back["wavelength_nm"], [450.0, 632.8])
    np.testing.assert_allclose(back["wi"], samples["wi"][keep], atol=1e-15)
    np.testing.assert_allclose(back["wo"], samples["wo"][keep], atol=1e-15)


def test_alta_coordinates(save):
    """Catches view and light exchanged: each parametrisation states one pair of directions."""
    wi, wo = spherical_to_direction(0.5, 0.3), spherical_to_direction(0.9, 2.0)
    rows = {
        "SPHERICAL_TL_PL_TV_PV": [0.5, 0.3, 0.9, 2.0],
        "CARTESIAN": [*wo, *wi],
        "ISOTROPIC_TV_TL_DPHI": [0.9, 0.5, 0.3 - 2.0],
        "ISOTROPIC_TL_TV_PROJ_DPHI": [0.5, 0.9 * np.cos(1.7), 0.9 * np.sin(1.7)],
    }
    theta_h, _, theta_d, phi_d = half_difference(wo, wi)
    rows["RUSIN_TH_TD_PD"] = [theta_h, theta_d, phi_d]
    for name, row in rows.items():
        numbers = " ".join(repr(float(x)) for x in row)
        text = f"#DIM {len(row)} 1\n#PARAM_IN {name}\n#PARAM_OUT INV_STERADIAN_COSINE_FACTOR\n{numbers} 2\n"
        samples = read(save(text))
        np.testing.assert_allclose(samples["wi"][0, 2], wi[2], atol=1e-12, err_msg=name)
        np.testing.assert_allclose(samples["wo"][0, 2], wo[2], atol=1e-12, err_msg=name)
        np.testing.assert_allclose(
            float(samples["wi"][0] @ samples["wo"][0]), wi @ wo, atol=1e-12, err_msg=name
        )
        np.testing.assert_allclose(samples["f_r"][0, 0], 2.0 / wo[2], rtol=1e-12)


def test_alta_drops_what_is_below_the_horizon_and_skips_intervals(save):
    """Catches a division by a cosine of zero and an interval taken for a value."""
    text = ALTA.replace("#DIM", "#VS 1\n#DIM").replace("0.25\n", "0.25 0.1\n").replace("1 2\n", "1 2 0.1\n")
    samples = read(save(text + "0 0 1.5707963267948966 0 9 0.1\n"))
    np.testing.assert_array_equal(samples["f_r"][:, 0], [0.25, 2.0])


def test_ssdd(save):
    """Catches a table read in the wrong order, and a block of another kind taken for the BRDF."""
    samples = read(save(SSDD))
    np.testing.assert_array_equal(samples["f_r"][:, 0], [1, 4, 7, 10, 13, 16, 19, 22])
    deg = np.pi / 180.0
    np.testing.assert_allclose(samples["wi"][:, 2], np.cos(np.array([0, 45] * 4) * deg))
    np.testing.assert_allclose(samples["wo"][:, 2], np.cos(np.array([10, 10, 20, 20] * 2) * deg))
    np.testing.assert_allclose(samples["wo"][4:, 0], -np.sin(np.array([10, 10, 20, 20]) * deg))


def test_ssdd_systems(save):
    """Catches a wrong frame: at difference 0 and at specular angle 0 the directions are what they must be."""
    specular = SSDD.replace("spherical", "specular").replace("LIST 10 20", "LIST 0 20")
    samples = read(save(specular))
    for index in (0, 1):
        wi, wo = (samples[name].to_numpy()[index] for name in ("wi", "wo"))
        np.testing.assert_allclose(wo, mirror(wi), atol=1e-15)
    half = SSDD.replace("spherical", "half_difference").replace("LIST 10 20", "LIST 0 20")
    samples = read(save(half))
    np.testing.assert_allclose(samples["wi"][:2], samples["wo"][:2], atol=1e-12)


def _binary_ssdd(content):
    """Store the tables of a text in single precision, as libbsdf does."""
    stored = b""
    for block in content.partition("DATA_TYPE")[2].split("DATA_TYPE"):
        head, rows = block.split("DATA ascii\n")
        stored += f"DATA_TYPE{head}DATA binary\n".encode()
        stored += np.array(rows.split(), dtype="<f4").tobytes()
    return content.partition("DATA_TYPE")[0].encode() + stored


def test_ssdd_binary(tmp_path):
    """Catches a table in the wrong order or precision, and one that is not skipped before the BRDF."""
    path = tmp_path / "file.dat"
    for content in (_binary_ssdd(SSDD), _binary_ssdd(SSDD).replace(b"0.2\n# a comment\n", b"0.3\r\n")):
        path.write_bytes(content)
        samples = read(path)
        assert "doubts" not in samples.attrs
        np.testing.assert_array_equal(samples["f_r"].to_numpy().ravel(), np.arange(1.0, 25.0))
    whole = _binary_ssdd(SSDD)
    for wrong, complaint in (
        (whole[:-1], "95 bytes follow DATA binary, the lists announce 96"),
        (whole + b"\0" * 96, "96 bytes follow a binary table"),
        (whole[:-4] + np.float32(np.nan).tobytes(), "cell 8, channel 3.*not finite|not finite.*"),
        (whole.replace(b"DATA_TYPE", b"TYPE", 1), "belongs to no DATA_TYPE|no format"),
    ):
        path.write_bytes(wrong)
        with pytest.raises(BadInput, match=complaint):
            read(path)


@pytest.mark.parametrize("turned", [False, True])
def test_ssdd_round_trip(tmp_path, turned):
    """Catches cells in the wrong place: every sample of a grid comes back with its directions."""
    samples = _grid_samples()
    if turned:  # one azimuth of the light: azimuths of view are counted from it
        samples = samples.isel(sample=np.flatnonzero(samples["wi"].to_numpy()[:, 1] > 0.1))
    write(samples, tmp_path / "grid.ssdd")
    back = read(tmp_path / "grid.ssdd")
    np.testing.assert_array_equal(back["wavelength_nm"], [450.0, 632.8])

    def table(data):
        pairs = np.sum(data["wi"].to_numpy() * data["wo"].to_numpy(), axis=1)
        keys = np.round(np.stack([data["wi"][:, 2], data["wo"][:, 2], pairs, data["f_r"][:, 0]], axis=1), 9)
        return keys[np.lexsort(keys.T)]

    np.testing.assert_allclose(table(back), table(samples), atol=1e-8)


def test_ssdd_refuses_what_is_no_grid(tmp_path):
    """Catches holes that are filled silently."""
    with pytest.raises(BadInput, match="do not fill their grid of 2 x 2 x 3 x 4"):
        write(_grid_samples().isel(sample=slice(1, None)), tmp_path / "grid.ssdd")


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (ASTM.replace("NUM_POINTS 2", "NUM_POINTS 3"), "announces 3 points, 2 follow"),
        (ASTM.replace("0.25", "nan"), "line 4, column 500nm.*finite"),
        (ASTM.replace("0.25", "0,25"), "line 4: has 7 cells"),
        (ASTM.replace("0.5,0,0.6", "50,0,60"), "line 4, column theta_i.*radians"),
        (ASTM.replace("phi_s", "phi_i"), "line 3: names phi_i twice"),
        (ASTM.replace(",500nm,600nm", ""), "line 3: names no channel"),
        (ASTM.split("0.5,", maxsplit=1)[0], "0 follow"),
        (ALTA.replace("0.25", "0,25"), "line 4, column 5: '0,25'.*point"),
        (ALTA.replace("0.25", "inf"), "line 4, column 5.*finite"),
        (ALTA.replace(" 0.25", ""), "line 4: has 4 numbers"),
        (ALTA.replace("SPHERICAL_TL_PL_TV_PV", "COS_TH"), "line 2: PARAM_IN COS_TH is not read"),
        (ALTA.replace("INV_STERADIAN", "ENERGY"), "line 3: PARAM_OUT ENERGY"),
        (ALTA.replace("#DIM 4 1", "#DIM 3 1"), "line 1: DIM 3 1 does not agree"),
        (ALTA.replace("#DIM 4 1", "#DIM 4 99999999999"), "line 1: DIM"),
        (ALTA.replace("#PARAM_OUT", "# PARAM"), "no #PARAM_OUT"),
        (ALTA + "#FORMAT binary\n", "line 6: is ALTA's binary"),
        (ALTA.split("0.5", maxsplit=1)[0], "no samples"),
        (SSDD.replace("4 5 6", "4 5,0 6"), "line 17, column 2: '5,0'.*point"),
        (SSDD.replace("4 5 6", "4 nan 6"), "line 17, column 2.*finite"),
        (SSDD.replace("4 5 6", "4 5"), "line 17: has 2 numbers"),
        (SSDD.replace("4 5 6\n", ""), "7 rows follow, the lists announce 8"),
        (SSDD.replace("DATA_TYPE brdf", "DATA_TYPE btdf"), "no BRDF"),
        (SSDD.replace("COLOR_MODEL rgb", "COLOR_MODEL cmyk"), "line 10: colour model 'cmyk'"),
        (SSDD.replace("spherical_coord", "polar_coord"), "line 11: 'polar_coord.*no parametrisation"),
        (SSDD.replace("PARAM2_LIST 10 20", "PARAM2_LIST 10 2O"), "line 13, column 3: '2O'"),
        (SSDD.replace("PARAM2_LIST 10 20", "PARAM2_LIST"), "line 13: PARAM2_LIST is empty"),
        (SSDD.replace("DATA ascii\n1 2", "DATA binary\n1 2"), "line 15: 63 bytes follow DATA binary"),
    ],
)
def test_damaged(save, content, complaint):
    """Catches tracebacks, silent truncation, and errors that do not name the place."""
    path = save(content)
    with pytest.raises(BadInput, match=complaint) as caught:
        read(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_every_truncation_ends_in_one_line_or_whole_rows(save):
    """Catches a traceback at any byte where a copy may stop."""
    for text in (ASTM, ALTA, SSDD):
        for length in range(1, len(text)):
            with contextlib.suppress(BadInput):
                assert np.isfinite(read(save(text[:length]))["f_r"]).all()
