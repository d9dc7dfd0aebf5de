"""PAB text: accepted by Radiance's own tools, read back as written, damage in one line."""

from __future__ import annotations

import importlib.util
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from analysis.formats import pab
from analysis.models import MODELS
from analysis.samples import make_samples, read, write
from rig.angles import spherical_to_direction
from rig.errors import BadInput

HEADER = "#format: theta phi BSDF\n#intheta 30\n#inphi 0\n"
PAINT = MODELS["cook-torrance"](kd=0.2, ks=1.0, m=0.3, ior=1.5)
TEXT = HEADER + "10 180 0.25\n100 90 0.5\n"


def paint(theta_i_deg):
    """Make samples of a paint on a grid of the half sphere, for each incidence."""
    theta_o, phi_o = np.radians(np.meshgrid(np.arange(0.0, 86.0, 5.0), np.arange(0.0, 360.0, 10.0)))
    wo = spherical_to_direction(theta_o.ravel(), phi_o.ravel())
    wi = np.repeat(spherical_to_direction(np.radians(theta_i_deg), 0.0), len(wo), axis=0)
    wo = np.tile(wo, (len(theta_i_deg), 1))
    return make_samples(wi, wo, PAINT.evaluate(wi, wo), source='a "quoted" paint')


@pytest.fixture(scope="module")
def tools():
    """Return a function that runs one of Radiance's tools."""
    found = importlib.util.find_spec("pyradiance")
    if found is None or found.origin is None:
        pytest.skip("pyradiance is not installed: pip install gonio[interchange]")
    home = Path(found.origin).parent
    path = f"{home / 'bin'}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "RAYPATH": f".:{home / 'lib'}"}

    def run(name, *arguments):
        done = subprocess.run(
            [home / "bin" / name, *map(str, arguments)], env=environment, capture_output=True, check=False
        )
        assert done.returncode == 0, done.stderr.decode()
        return done

    return run


def test_radiances_tools_take_it(tools, tmp_path):
    """Catches headers, angles or values that Radiance refuses, scales or turns."""
    paths, _ = pab.write_folder(paint([0.0, 15.0, 30.0, 45.0, 60.0]), tmp_path / "pab")
    made = tools("pabopto2bsdf", *paths)
    assert made.stderr == b""
    sir = tmp_path / "paint.sir"
    sir.write_bytes(made.stdout)
    xml = tmp_path / "paint.xml"
    xml.write_bytes(tools("bsdf2klems", "-n", "60", sir).stdout)
    checked = tools("checkBSDF", xml)
    assert checked.stderr == b""
    diffuse, reciprocity = (
        line.split()[2:]
        for line in checked.stdout.decode().splitlines()
        if line.startswith("Interior Refl\t")
    )
    assert [float(word) for word in diffuse[:3]] == pytest.approx([20.0] * 3, abs=1.5)
    assert float(reciprocity[1]) < 10.0
    patches = read(xml)
    well = (patches["wi"][:, 2] > 0.6) & (patches["wo"][:, 2] > 0.6)
    expected = PAINT.evaluate(patches["wi"].to_numpy(), patches["wo"].to_numpy())
    error = np.abs(patches["f_r"].to_numpy() - expected)[well.to_numpy()] / expected[well.to_numpy()]
    # Turned by half a turn the median would be 0.22: patches average, and Radiance smooths.
    assert np.median(error) < 0.05


@pytest.mark.parametrize(
    ("model", "theta_i_deg", "phi_i_deg"),
    [
        (MODELS["ggx"](kd=0.2, ks=1.0, alpha=0.06, f0=0.1), [0.0, 10.0, 25.0, 40.0, 55.0, 70.0], [0.0]),
        pytest.param(
            MODELS["ggx-anisotropic"](kd=0.2, ks=1.0, alpha_x=0.15, alpha_y=0.5, f0=0.2),
            [0.0, 30.0, 60.0],
            [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0],
            marks=pytest.mark.slow,
        ),
    ],
    ids=["narrow", "anisotropic"],
)
def test_radiances_tools_take_other_materials(tools, tmp_path, model, theta_i_deg, phi_i_deg):
    """Catches headers that hold for a rough isotropic paint only: narrow lobes, azimuths of the light."""
    theta_o, phi_o = np.radians(np.meshgrid(np.arange(0.0, 86.0, 4.0), np.arange(0.0, 360.0, 8.0)))
    wo = spherical_to_direction(theta_o.ravel(), phi_o.ravel())
    lights = [(theta, phi) for theta in theta_i_deg for phi in (phi_i_deg if theta else [0.0])]
    wi = np.repeat(spherical_to_direction(*np.radians(lights).T), len(wo), axis=0)
    wo = np.tile(wo, (len(lights), 1))
    pab.write_folder(make_samples(wi, wo, model.evaluate(wi, wo)), tmp_path / "pab")
    paths = sorted((tmp_path / "pab").iterdir())
    assert len(paths) == len(lights)
    made = tools("pabopto2bsdf", *paths)
    assert made.stderr == b""
    sir = tmp_path / "sample.sir"
    sir.write_bytes(made.stdout)
    xml = tmp_path / "sample.xml"
    xml.write_bytes(tools("bsdf2klems", "-n", "60", sir).stdout)
    assert tools("checkBSDF", xml).stderr == b""
    patches = read(xml)
    well = (patches["wi"][:, 2] > 0.6) & (patches["wo"][:, 2] > 0.6)
    expected = model.evaluate(patches["wi"].to_numpy(), patches["wo"].to_numpy())[well.to_numpy()]
    given = patches["f_r"].to_numpy()[well.to_numpy()]
    assert np.median(np.abs(given - expected) / expected) < 0.15


def test_read_back(tmp_path):
    """Catches azimuths, cosines or digits lost between writer and reader."""
    samples = paint([0.0, 40.0])
    paths, _ = pab.write_folder(samples, tmp_path)
    together = tmp_path / "all.txt"
    together.write_text("".join(path.read_text() for path in paths))
    again = read(together)
    for name in ("wi", "wo"):
        np.testing.assert_allclose(again[name], samples[name], atol=2e-8)
    np.testing.assert_allclose(again["f_r"], samples["f_r"], rtol=1e-8)


def test_one_file_holds_one_incidence(tmp_path):
    """Catches several incidences silently under one header."""
    with pytest.raises(BadInput, match="2 directions of incidence"):
        write(paint([0.0, 40.0]), tmp_path / "paint.pab")
    write(paint([40.0]), tmp_path / "paint.pab")
    assert read(tmp_path / "paint.pab").sizes["sample"] == 18 * 36
    with pytest.raises(BadInput, match="cannot be made"):
        pab.write_folder(paint([40.0]), tmp_path / "paint.pab")


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_cosine_and_incidence(tmp_path, ends):
    """Catches DSF taken for BSDF, the other spelling of the incidence, and the back side folded."""
    path = tmp_path / "file.dat"
    path.write_bytes(TEXT.replace("\n", ends).encode())
    plain = read(path)
    np.testing.assert_array_equal(plain["f_r"], [[0.25], [0.5]])
    np.testing.assert_allclose(plain["wi"][0], spherical_to_direction(np.radians(30.0), 0.0), atol=1e-15)
    assert float(plain["wo"][1, 2]) < 0.0
    text = TEXT.replace("BSDF", "DSF").replace("#intheta 30\n#inphi 0", "#incident_angle 30 0")
    path.write_text(text + "90 0 1\n")
    times = read(path)
    np.testing.assert_allclose(
        times["f_r"][:2, 0], [0.25 / np.cos(np.radians(10)), 0.5 / np.sin(np.radians(10))]
    )
    assert np.isnan(times["f_r"][2, 0])
    assert times["flags"][2, 0] == pab.NEAR_GRAZING


def test_colours(tmp_path):
    """Catches RGB written as if it were XYZ: white keeps its luminance."""
    samples = paint([10.0])
    f_r = np.repeat(samples["f_r"].to_numpy(), 3, axis=1)
    wi, wo = samples["wi"].to_numpy(), samples["wo"].to_numpy()
    path = tmp_path / "paint.pab"
    write(make_samples(wi, wo, f_r, channels=["R", "G", "B"]), path)
    again = read(path)
    assert again["channel"].to_numpy().tolist() == ["X", "Y", "Z"]
    np.testing.assert_allclose(again["f_r"][:, 1], f_r[:, 0], rtol=1e-6)
    with pytest.raises(BadInput, match="choose one channel"):
        write(make_samples(wi, wo, f_r), path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEADER, "no samples follow"),
        (TEXT + "10 180\n", "line 6: has 2 columns"),
        (TEXT + "10 180 0,5\n", "line 6, column 3: '0,5'"),
        (TEXT + "10 180 nan\n", "line 6, column 3"),
        (TEXT + "190 180 1\n", "line 6, column 1: 190"),
        (TEXT.replace("#inphi 0\n", ""), "lacks the incidence"),
        (TEXT.replace("#intheta 30", "#intheta x"), "'x' is not a number"),
        (TEXT.replace("#intheta 30", "#intheta 300"), "300 is not a polar angle"),
        (TEXT.replace("BSDF", "luminance"), "what the values are"),
        ("1 2 3\n" + TEXT, "starts without a header"),
        (TEXT + HEADER + "10 180 1 2\n", "different channels"),
    ],
)
def test_damaged_files(tmp_path, text, words):
    """Catches a traceback, and a row read as something else."""
    path = tmp_path / "file.dat"
    path.write_text(text)
    with pytest.raises(BadInput, match=words) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
