"""Readers told by content: golden tables, round trips, and one line for every damaged file."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from analysis.formats import rt300s
from analysis.samples import make_samples, read, write
from rig.angles import direction_to_spherical, spherical_to_direction
from rig.errors import BadInput

CORNELL = "# paint\n2\n# wls\n500 600\n\n0.5 0.0 0.6 1.0 0.25 0.5\n0.1 0.0 0.2 3.0 0.125 0\n"
CSV = (
    "# a table\ntheta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,f_r,u_f_r\n"
    "30,0,45,180,0.25,0.01\n0,0,10,90,0.5,0.02\n"
)


@pytest.fixture
def save(tmp_path):
    """Return a function that writes a file whose suffix says nothing."""

    def write_file(content):
        path = tmp_path / "file.dat"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_file


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_cornell(save, ends, mark):
    """Catches degrees taken for radians, values in the wrong channel, and line ends or marks that matter."""
    samples = read(save(mark + CORNELL.replace("\n", ends)))
    np.testing.assert_array_equal(samples["f_r"], [[0.25, 0.5], [0.125, 0.0]])
    np.testing.assert_array_equal(samples["wavelength_nm"], [500.0, 600.0])
    np.testing.assert_allclose(samples["wi"], spherical_to_direction([0.5, 0.1], [0.0, 0.0]), atol=1e-15)
    np.testing.assert_allclose(samples["wo"], spherical_to_direction([0.6, 0.2], [1.0, 3.0]), atol=1e-15)


@pytest.mark.realdata
def test_cornell_real(shared_data):
    """Catches a reader that loses rows or channels of the real file."""
    samples = read(shared_data / "cornell" / "garnet_red.brdf")
    assert dict(samples.sizes) == {"sample": 1439, "channel": 31, "xyz": 3}
    assert samples["f_r"].to_numpy()[0, 0] == 0.023025
    theta_i, _ = direction_to_spherical(samples["wi"].to_numpy()[0])
    assert np.degrees(theta_i) == pytest.approx(50.0, abs=1e-4)


def test_csv(save):
    """Catches radians taken for degrees, and uncertainties that are dropped."""
    samples = read(save(CSV))
    np.testing.assert_array_equal(samples["f_r"], [[0.25], [0.5]])
    np.testing.assert_array_equal(samples["u_f_r"], [[0.01], [0.02]])
    np.testing.assert_allclose(
        samples["wo"], spherical_to_direction(np.radians([45, 10]), np.radians([180, 90])), atol=1e-15
    )


def test_csv_round_trip(tmp_path):
    """Catches digits or channel names lost on the way to a spreadsheet; flagged samples stay behind."""
    random = np.random.default_rng(0)
    wi, wo = spherical_to_direction(random.uniform(0, 1.5, (2, 9)), random.uniform(-3, 3, (2, 9)))
    samples = make_samples(
        wi, wo, random.standard_normal((9, 2)), wavelength_nm=[450.0, 632.8], u_noise=0.1, u_white=0.2
    )
    samples["flags"][3, 1] = 1
    path = tmp_path / "table.csv"
    write(samples, path)
    back = read(path)
    keep = [0, 1, 2, 4, 5, 6, 7, 8]
    np.testing.assert_array_equal(back["f_r"], samples["f_r"][keep])
    np.testing.assert_array_equal(back["u_f_r"], samples["u_f_r"][keep])
    np.testing.assert_array_equal(back["wavelength_nm"], [450.0, 632.8])
    np.testing.assert_allclose(back["wi"], samples["wi"][keep], atol=1e-15)


def test_unknown_suffix_is_not_written(tmp_path):
    """Catches a file in a format that nobody asked for."""
    samples = make_samples([[0, 0, 1.0]], [[0, 0, 1.0]], [1.0])
    with pytest.raises(BadInput, match=r"\.nc, .*\.csv"):
        write(samples, tmp_path / "samples.xlsx")
    with pytest.raises(BadInput, match="no such folder"):
        write(samples, tmp_path / "nowhere" / "samples.nc")


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "empty"),
        ("hello world\n", "no format"),
        (CORNELL.replace("0.25", "0,25"), "line 6, column 500 nm: '0,25'.*point"),
        (CORNELL.replace("0.125", "nan"), "line 7, column 500 nm.*finite"),
        (CORNELL.replace("0.6 1.0", "0.6"), "line 7.*the last row has 5 of 6"),
        (CORNELL[:-8], "line 7"),
        (CORNELL.replace("\n2\n", "\n999999999\n"), "line 2.*999999999"),
        (CORNELL.replace("\n2\n", "\n0\n"), "line 2"),
        (CORNELL.replace("0.5 0.0 0.6", "50 0.0 60"), "line 6, column theta i.*radians"),
        (CORNELL.split("0.5 0.0", maxsplit=1)[0], "line 2"),
        (CSV.replace("0.25", "nan"), "line 3, column f_r.*finite"),
        (CSV.replace("0.25", "0.2.5"), "line 3, column f_r"),
        (CSV.replace("0.25,0.01", "0,25,0,01"), "line 3.*8 cells"),
        (CSV.replace("theta_o_deg", "theta_deg"), "theta_o_deg"),
        (CSV.replace("u_f_r", "colour"), "colour"),
        (CSV.replace(",f_r,", ",u_f_r_a,"), "f_r"),
        (CSV.replace("u_f_r", "f_r"), "twice"),
        (CSV.replace("0.02", "-0.02"), "negative"),
        (CSV.split("30,", maxsplit=1)[0], "no rows"),
        (b"\x89HDF\r\n\x1a\n" + b"\0" * 64, "NetCDF"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + b"\0" * 600, "xls"),
        (b"PK\x03\x04" + b"\0" * 64, "npz"),
        (b" " * 60_000 + b"LICENSE\n", "of no format"),
        (b"\n    # \n" * 8_000 + b"x\n", "of no format"),
    ],
)
def test_damaged_files_give_one_line(save, content, complaint):
    """Catches a traceback, an error that does not name file and place, or blanks that take for ever."""
    path = save(content)
    with pytest.raises(BadInput, match=complaint) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return one whole file of each format."""
    folder = tmp_path_factory.mktemp("whole")
    samples = make_samples(
        spherical_to_direction(np.linspace(0, 1, 30), np.zeros(30)),
        spherical_to_direction(np.linspace(1, 0, 30), np.ones(30)),
        np.linspace(0, 1, 60).reshape(30, 2),
        u_noise=0.1,
    )
    write(samples, folder / "samples.nc")
    write(samples, folder / "samples.csv")
    (folder / "samples.brdf").write_text(CORNELL)
    np.savez(folder / "samples.npz", wi=samples["wi"], wo=samples["wo"], f_r=samples["f_r"])
    return folder


@pytest.mark.parametrize("name", ["samples.nc", "samples.csv", "samples.brdf", "samples.npz"])
@given(cut=st.floats(0.0, 1.0), place=st.floats(0.0, 1.0), value=st.integers(0, 255))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_fuzzed_files_are_read_or_refused(whole, tmp_path, name, **damage):
    """Catches any exception but BadInput from a cut file or a changed byte."""
    content = bytearray((whole / name).read_bytes())
    content[int(damage["place"] * (len(content) - 1))] = damage["value"]
    for damaged in (content, content[: int(damage["cut"] * len(content))]):
        path = tmp_path / "damaged"
        path.write_bytes(bytes(damaged))
        try:
            read(path)
        except BadInput as error:
            assert "\n" not in str(error)  # noqa: PT017 - both outcomes are right


def test_netcdf_that_announces_too_much(tmp_path):
    """Catches memory taken on the word of a header: a sparse file can declare terabytes."""
    path = tmp_path / "huge.nc"
    with h5py.File(path, "w") as file:
        for name in ("wi", "wo", "f_r"):
            file.create_dataset(name, shape=(10**10, 3), dtype="f8", chunks=(1000, 3))
            for axis, dimension in enumerate(("sample", "channel" if name == "f_r" else "xyz")):
                file[name].dims[axis].label = dimension
    with pytest.raises(BadInput, match=r"huge\.nc"):
        read(path)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_netcdf_on_a_full_disk_is_one_line():
    """Catches HDF5 closing a file that has no room, which ends the whole process."""
    code = (
        "import numpy as np; from pathlib import Path; from analysis.formats import netcdf\n"
        "from analysis.samples import make_samples; up = np.tile([0.0, 0.0, 1.0], (5000, 1))\n"
        "netcdf.write(make_samples(up, up, np.random.default_rng(0).random(5000)), Path('/dev/full'))"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert ended.stderr.endswith("OSError: [Errno 28] No space left on device\n")


def test_npz_does_not_unpickle(tmp_path):
    """Catches code run from somebody's data file."""
    path = tmp_path / "evil.npz"
    np.savez(path, wi=np.array([print], dtype=object), wo=np.ones(3), f_r=np.ones(3))
    with pytest.raises(BadInput, match="npz"):
        read(path)


@pytest.mark.parametrize("header", [b"{'descr':)", b"{'descr': (", b"{'descr': [1"])
def test_npz_with_a_damaged_header(tmp_path, header):
    """Catches numpy's parser, which complains about a damaged header in ways of its own."""
    path = tmp_path / "samples.npz"
    text = header.ljust(117) + b"\n"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("wi.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text)
    with pytest.raises(BadInput, match="not a whole"):
        read(path)


def test_npz_bomb(tmp_path):
    """Catches an archive of a few kilobytes that unpacks to gigabytes."""
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("wi.npy", b"\0" * 10)
    content = bytearray(path.read_bytes())
    # The directory's word for the unpacked size.
    entry = content.rindex(b"PK\x01\x02")
    content[entry + 24 : entry + 28] = b"\xff\xff\xff\xfe"
    path.write_bytes(bytes(content))
    with pytest.raises(BadInput, match="npz"):
        read(path)


def test_missing_files_and_options_that_mean_nothing(save, tmp_path):
    """Catches an option that is silently ignored, and a folder that is no session."""
    with pytest.raises(BadInput, match="no such file"):
        read(tmp_path / "nowhere.brdf")
    with pytest.raises(BadInput, match="gonio reduce"):
        read(tmp_path)
    with pytest.raises(BadInput, match="blank means nothing"):
        read(save(CORNELL), blank="blank.xls")


def published(path):
    """Read a laboratory's FRED text: (incidence, theta_s, phi_s) -> f in 1/sr."""
    table, incidence = {}, 0.0
    for line in path.read_text().splitlines():
        words = line.split()
        if len(words) == 2 and words[0] != "type":
            incidence = float(words[0])
        elif len(words) == 3 and words[0][0].isdigit():
            table[incidence, float(words[0]), float(words[1])] = float(words[2])
    return table


def averaged_as_published(samples):
    """Average readings as the laboratory does: (incidence, theta_s, phi_s from the mirror) -> f in 1/sr.

    Azimuths on both sides of the plane are one cell. At the pole all azimuths are; their table of 36 holds
    the plane of incidence once and every other azimuth twice.
    """
    theta_i, phi_i = (np.degrees(a) for a in direction_to_spherical(samples["wi"].to_numpy()))
    theta_o, phi_o = (np.degrees(a) for a in direction_to_spherical(samples["wo"].to_numpy()))
    from_mirror = np.abs((phi_o - phi_i) % 360.0 - 180.0)
    cells: dict[tuple[int, int, int], list[float]] = {}
    f_r = np.where(samples["flags"] == 0, samples["f_r"], np.nan)[:, 0]
    for i, o, p, f in zip(theta_i, theta_o, from_mirror, f_r, strict=True):
        in_plane = round(p) in {0, 180}
        key, times = (round(i), round(o), round(p)), 1
        if round(o) == 0:
            key, times = (round(i), 0, 0), 1 if in_plane else 2
        cells.setdefault(key, []).extend([float(f)] * times)
    means = {key: np.array(values) for key, values in cells.items()}
    return {key: np.nanmean(v) for key, v in means.items() if np.isfinite(v).any()}


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("files", "table"),
    [
        (["ANOPLATE_AnoBlack_EC1_Alum6061_v1o0_20251115"], "AnoBlackEC1onAlum"),
        (
            ["NiTE_on_steel_v1o0A_20250915", "NiTE_on_steel_v1o0B_20250916", "NiTE_on_steel_v1o0C_20250916"],
            "AnoBlackNiTEonSteel",
        ),
    ],
)
def test_rt300s_reduces_to_the_published_table(shared_data, files, table):
    """Catches a wrong sign, azimuth, cosine, pi, blank or shadow: the laboratory has the answer."""
    raw = shared_data / "rt300s" / "raw"
    blank = raw / "blank_v2o0_20250911.xls"
    averages = [
        averaged_as_published(read(raw / f"{file}.xls", blank=blank, floor_shift=True)) for file in files
    ]
    golden = published(shared_data / "rt300s" / "published" / f"{table}.txt")
    assert len(golden) == 1144
    assert set(averages[0]) == {(round(i), round(o), round(p)) for i, o, p in golden}
    for (i, o, p), f in golden.items():
        ours = np.mean([average[round(i), round(o), round(p)] for average in averages])
        assert ours == pytest.approx(f, abs=1e-6)


@pytest.mark.realdata
def test_rt300s_keeps_negatives_by_default(shared_data):
    """Catches a floor shift that nobody asked for: it raises every dark sample."""
    raw = shared_data / "rt300s" / "raw"
    sample, blank = raw / "IMX455_stageRotation0_20250922.xls", raw / "blank_v2o0_20250911.xls"
    plain, corrected = read(sample), read(sample, blank=blank)
    readings, empty = rt300s.read_readings(sample), rt300s.read_readings(blank)
    cosine = np.cos(np.radians(readings.angles_deg[:, 2]))
    np.testing.assert_allclose(plain["f_r"].to_numpy()[:, 0], readings.value / (np.pi * cosine), rtol=1e-14)
    np.testing.assert_array_equal(readings.angles_deg, empty.angles_deg)
    expected = (readings.value - empty.value) / (np.pi * cosine)
    np.testing.assert_allclose(corrected["f_r"].to_numpy()[:, 0], expected, rtol=1e-13, atol=1e-18)


@pytest.mark.realdata
def test_rt300s_damage(shared_data, tmp_path):
    """Catches a blank of another grid, a cut file, and an Excel file that is something else."""
    raw = shared_data / "rt300s" / "raw"
    sample = raw / "NiTE_on_steel_v1o0A_20250915.xls"
    with pytest.raises(BadInput, match=r"blank_20250829.*angles.*incidence"):
        read(sample, blank=raw / "blank_20250829.xls")
    content = sample.read_bytes()
    for size in (700, 5000, 200_000, len(content) - 3000):
        path = tmp_path / "cut.xls"
        path.write_bytes(content[:size])
        with pytest.raises(BadInput, match=r"cut\.xls"):
            read(path)
    shutil.copy(sample, tmp_path / "table.csv")
    assert read(tmp_path / "table.csv").sizes["sample"] == 2508


@pytest.mark.realdata
def test_npz_of_the_standins(shared_data):
    """Catches single precision directions refused, or left a little too long."""
    samples = read(shared_data / "merl-standins" / "nickel.npz")
    assert dict(samples.sizes) == {"sample": 7860, "channel": 3, "xyz": 3}
    np.testing.assert_allclose(np.linalg.norm(samples["wi"], axis=1), 1.0, rtol=1e-15)
