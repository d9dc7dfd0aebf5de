"""In-plane tables: the mid-infrared radiances and the satellite's chassis, each with its convention."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.samples import read
from rig.angles import mirror, spherical_to_direction
from rig.errors import BadInput

TABLE = (
    "material,theta_o_deg,theta_i_deg,radiance_L_o\r\n"
    "kupfer,60,90,0.5\r\nkupfer,60,30,0.25\r\nlack,0,60,1.0\r\n"
)
CHASSIS = """# (phi_i, theta_i) are the zenith and azimuth angles
# (phi_o, theta_o) are the zenith and azimuth angles
# and is at a wavelength lambda = 532 nm
#
# phi_i     theta_i     phi_o     theta_o     brdf
75.00     -180.00     -90.00     0.00     1.0e-04
75.00     -180.00     75.00      0.00     8.0e+03
60.00     -180.00     -60.00     0.00     2.0e-02
"""


@pytest.fixture
def save(tmp_path):
    """Return a function that writes a file whose suffix says nothing."""

    def write_file(content):
        path = tmp_path / "file.dat"
        path.write_bytes(content.encode())
        return path

    return write_file


def test_radiance(save):
    """Catches the published cosine left inside, a wrong solid angle, and light and view on the same side."""
    path = save(TABLE)
    samples = read(path, material="kupfer")
    assert samples.sizes["sample"] == 1  # at 90 deg of incidence nothing falls on the sample
    omega = np.pi * 25.0 / 315.0**2
    expected = 0.25 / (3463.986 * np.cos(np.pi / 6) * omega)
    assert float(samples["f_r"][0, 0]) == pytest.approx(expected, rel=1e-12)
    assert samples.attrs["source_solid_angle_sr"] == pytest.approx(omega)
    np.testing.assert_allclose(samples["wo"][0], spherical_to_direction(np.pi / 3, 0.0), atol=1e-15)
    assert float(samples["wi"][0, 0]) == pytest.approx(-0.5)
    published = read(path, material="kupfer", as_published=True)
    assert float(published["f_r"][0, 0]) == pytest.approx(expected * 0.5, rel=1e-12)
    assert "published" in published.attrs["cosine"]


@pytest.mark.parametrize(
    "text",
    [
        "theta_i_deg,theta_o_deg,f_r\n10,-20,0.5\n60,30,0.25\n",
        "f_r,theta_o_deg,theta_i_deg\n0.5,-20,10\n0.25,30,60\n",
        "# 532 nm\ntheta_i [deg];theta_o (deg);BRDF [1/sr]\n10,0;-20,0;0,5\n60;30;0,25\n",
        "theta_o_rad\ttheta_i [rad]\tbrdf\n-0.3490658503988659\t0.17453292519943295\t0.5\n"
        "0.5235987755982988\t1.0471975511965976\t0.25\n",
    ],
)
def test_columns_in_any_order_and_unit(save, text):
    """Catches a column taken for its neighbour, radians for degrees, and a decimal comma for a separator."""
    samples = read(save(text))
    np.testing.assert_array_equal(samples["f_r"][:, 0], [0.5, 0.25])
    np.testing.assert_allclose(
        samples["wi"], spherical_to_direction(np.radians([10.0, 60.0]), np.pi), atol=1e-15
    )
    np.testing.assert_allclose(
        samples["wo"], spherical_to_direction(np.radians([-20.0, 30.0]), 0.0), atol=1e-15
    )


def test_chassis_columns_in_any_order(save):
    """Catches columns that are read by their place although they are named."""
    other = CHASSIS.replace(
        "# phi_i     theta_i     phi_o     theta_o     brdf", "# brdf phi_o theta_o phi_i theta_i"
    )
    rows = [line.split() for line in CHASSIS.splitlines() if not line.startswith("#")]
    head = [line for line in other.splitlines() if line.startswith("#")]
    turned = "\n".join([*head, *(" ".join([r[4], r[2], r[3], r[0], r[1]]) for r in rows), ""])
    expected, samples = read(save(CHASSIS)), read(save(turned))
    for name in ("wi", "wo", "f_r"):
        np.testing.assert_array_equal(samples[name], expected[name])


def test_plain_table_of_one_material(save):
    """Catches values that are scaled although they are a BRDF."""
    samples = read(save("theta_i_deg,theta_o_deg,f_r\n10,-20,0.5\n"))
    assert float(samples["f_r"][0, 0]) == 0.5
    assert float(samples["wo"][0, 0]) < 0.0
    assert float(samples["wi"][0, 0]) < 0.0


def test_chassis(save):
    """Catches zenith and azimuth exchanged, and the sign of the zenith lost."""
    samples = read(save(CHASSIS))
    np.testing.assert_array_equal(samples["f_r"][:, 0], [8000.0, 0.02])
    np.testing.assert_array_equal(samples["wavelength_nm"], [532.0])
    np.testing.assert_allclose(samples["wo"][0], mirror(samples["wi"].to_numpy()[0]), atol=1e-12)
    np.testing.assert_allclose(samples["wo"][1], samples["wi"][1], atol=1e-12)


@pytest.mark.realdata
def test_real_files(shared_data):
    """Catches lost rows, and a mirror peak that is not where the mirror direction is."""
    chassis = read(shared_data / "starlink" / "chassis_brdf.csv")
    for cosine in np.unique(np.round(chassis["wi"].to_numpy()[:, 2], 9)):
        one = chassis.isel(sample=np.flatnonzero(np.abs(chassis["wi"].to_numpy()[:, 2] - cosine) < 1e-8))
        brightest = int(one["f_r"].argmax("sample")[0])
        reflected = mirror(one["wi"].to_numpy()[brightest])
        assert np.degrees(np.arccos(np.clip(reflected @ one["wo"].to_numpy()[brightest], -1, 1))) < 1.5
    path = shared_data / "mwir" / "radiance.csv"
    copper = read(path, material="Kupfer")
    assert copper.sizes["sample"] == 890  # 10 views x 89 incidences, 90 deg left out
    with pytest.raises(BadInput, match=r"6 materials.*Verzinkter Stahl"):
        read(path)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (TABLE.replace("0.25", "nan"), "line 3, column radiance_L_o.*finite"),
        (TABLE.replace("0.25", "0,25"), "line 3: has 5 cells"),
        (TABLE.replace("60,30", "60,130"), "line 3, column theta_i_deg: 130"),
        (TABLE.replace("kupfer", "lack"), "no 'kupfer'"),
        (TABLE.split("kupfer", maxsplit=1)[0], "no rows"),
        (CHASSIS.replace("8.0e+03", "8,0e+03"), "line 7, column brdf: '8,0e.*point"),
        (CHASSIS.replace("8.0e+03", ""), "line 7: has 4 numbers"),
        (CHASSIS.replace("(phi_i, theta_i)", "(theta_i, phi_i)"), "line 6, column theta_i: -180.*exchanged"),
        (CHASSIS.split("75.00", maxsplit=1)[0], "line 5: has a header"),
    ],
)
def test_damaged(save, content, complaint):
    """Catches tracebacks and errors that do not name the place."""
    path = save(content)
    material = {"material": "kupfer"} if content.startswith("material") else {}
    with pytest.raises(BadInput, match=complaint) as caught:
        read(path, **material)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


BANDS = "theta_i_deg,wavelength_nm,theta_o_deg,material,f_r\n" + "".join(
    f"{i},{nm},{o},{material},0.{i}{o}{nm}\n"
    for material in ("lacquer", "felt")
    for nm in (633, 450)
    for i in (10, 20)
    for o in (15, 40)
)


def test_a_column_of_wavelengths_becomes_bands(save):
    """Catches wavelengths taken for other samples, values under another band, and another material's rows."""
    samples = read(save(BANDS), material="felt")
    assert samples["wavelength_nm"].to_numpy().tolist() == [450.0, 633.0]
    assert samples["f_r"].to_numpy()[:2].tolist() == [[0.1015450, 0.1015633], [0.1040450, 0.1040633]]
    assert samples.sizes["sample"] == 4
    lines = BANDS.splitlines()
    mixed = read(save("\n".join([lines[0], *lines[:0:-1]])), material="felt")
    np.testing.assert_array_equal(mixed["f_r"][::-1], samples["f_r"])
    np.testing.assert_array_equal(mixed["wo"][::-1], samples["wo"])
    micrometres = BANDS.replace("wavelength_nm", "Wavelength [um]").replace(",633,", ",0.633,")
    converted = read(save(micrometres.replace(",450,", ",0.450,")), material="felt")
    np.testing.assert_allclose(converted["wavelength_nm"], [450.0, 633.0])


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (BANDS.replace("20,450,40,felt,0.2040450\n", ""), "line 13: its direction has 1 of 2 wavelengths"),
        (BANDS + "20,450,40,felt,0.3\n", "line 18: gives a direction a second time at 450 nm"),
        (
            BANDS.replace("10,633,15,felt", "10,0,15,felt"),
            "line 10, column wavelength: 0 nm is no wavelength",
        ),
        (
            BANDS.replace("10,633,15,felt", "10,x,15,felt"),
            "line 10, column wavelength_nm: 'x' is not a number",
        ),
    ],
)
def test_bands_that_are_not_whole(save, content, complaint):
    """Catches holes that are filled in silence, and errors that do not name the line."""
    with pytest.raises(BadInput, match=complaint):
        read(save(content), material="felt")


def test_a_zenith_that_is_not_understood_is_refused(save):
    """Catches a damaged comment that exchanges zenith and azimuth in silence."""
    with pytest.raises(BadInput, match="line 5: its comments speak of a zenith"):
        read(save(CHASSIS.replace("are the zenith", "arethe zenith")))
