"""MERL tables: bit-exact round trip, the index against the published formula, damage in one line."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from analysis.formats import merl
from analysis.models import MODELS
from analysis.samples import make_samples, read, write
from rig.angles import from_half_difference, spherical_to_direction
from rig.errors import BadInput

SHAPE = (3, 90, 90, 180)


def directions(count, seed, largest_deg):
    """Draw directions that are even over a cap."""
    rng = np.random.default_rng(seed)
    theta = np.arccos(rng.uniform(np.cos(np.radians(largest_deg)), 1.0, count))
    return spherical_to_direction(theta, rng.uniform(-np.pi, np.pi, count))


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """Return the planes of a full file and its path: values everywhere above the surface, none below."""
    planes = np.random.default_rng(0).uniform(0.0, 3.0, SHAPE)
    wi, wo = merl.bin_directions()
    planes.reshape(3, -1)[:, (wi[:, 2] <= 0.0) | (wo[:, 2] <= 0.0)] = -1.0
    path = tmp_path_factory.mktemp("merl") / "file.dat"
    merl.write_table(path, planes)
    return planes, path


def test_a_full_file_comes_back_bit_for_bit(full, tmp_path):
    """Catches planes exchanged, transposed, scaled or rounded."""
    planes, path = full
    again = merl.read_table(path)
    np.testing.assert_array_equal(again.view(np.uint64), planes.view(np.uint64))
    copy = tmp_path / "copy.binary"
    merl.write_table(copy, again)
    content = copy.read_bytes()
    assert len(content) == 34992012
    assert content == path.read_bytes()
    assert struct.unpack_from("<3i", content) == (90, 90, 180)
    # The first value of the second plane: channels are planes.
    assert struct.unpack_from("<d", content, 12 + 8 * 1458000)[0] == planes[1, 0, 0, 0]


def test_the_index_is_the_published_formula():
    """Catches angles in the wrong order, the square root forgotten, and phi_d not folded."""
    rng = np.random.default_rng(1)
    theta_h, theta_d = rng.uniform(0.0, 1.5, 500), rng.uniform(0.01, 1.5, 500)
    phi_h, phi_d = rng.uniform(-3.1, 3.1, 500), rng.uniform(-3.1, 3.1, 500)
    wi, wo = from_half_difference(theta_h, phi_h, theta_d, phi_d)
    expected = [
        math.floor(math.degrees(p + math.pi if p < 0.0 else p))
        + 180 * (math.floor(math.degrees(d)) + 90 * math.floor(90 * math.sqrt(h * 2.0 / math.pi)))
        for h, d, p in zip(theta_h, theta_d, phi_d, strict=True)
    ]
    np.testing.assert_array_equal(merl.bin_index(wi, wo), expected)
    np.testing.assert_array_equal(merl.bin_index(wo, wi), expected)


def test_the_middles_of_bins_lie_in_their_bins():
    """Catches directions that belong to a neighbour."""
    wi, wo = merl.bin_directions()
    rows = np.arange(0, len(wi), 7)
    np.testing.assert_array_equal(merl.bin_index(wi[rows], wo[rows]), rows)


def test_samples_and_back(full, tmp_path):
    """Catches the channels' scales, bins without value taken for samples, and a needless interpolation."""
    planes, path = full
    samples = read(path)
    known = (planes >= 0.0).all(0)
    assert samples.sizes["sample"] == known.sum()
    np.testing.assert_allclose(
        samples["f_r"].to_numpy()[0], planes[:, known][:, 0] * [1 / 1500, 1.15 / 1500, 1.66 / 1500]
    )
    write(samples, tmp_path / "again.binary")
    np.testing.assert_allclose(merl.read_table(tmp_path / "again.binary"), planes, rtol=1e-15)


@pytest.mark.slow
def test_scattered_samples(tmp_path):
    """Catches an interpolation that smears or turns: within a bin's width of the truth."""
    model = MODELS["cook-torrance"](kd=0.3, ks=0.2, m=0.4, ior=1.5)
    theta = np.radians(np.arange(0.0, 86.0, 7.0))
    wi = np.repeat(spherical_to_direction(theta, 0.0 * theta), 400, axis=0)
    wo = directions(len(wi), 2, 87)
    f_r = np.repeat(model.evaluate(wi, wo), 3, axis=1)
    loss = merl.write(make_samples(wi, wo, f_r), tmp_path / "out.binary")
    assert loss.median_relative < 0.01
    planes = merl.read_table(tmp_path / "out.binary")
    wi, wo = directions(2000, 3, 60), directions(2000, 4, 60)
    true = model.evaluate(wi, wo)
    assert np.median(np.abs(merl.evaluate(planes, wi, wo) - true) / true) < 0.01


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (struct.pack("<3i", 90, 90, 180), "has 12 bytes"),
        (struct.pack("<3i", 90, 90, 180) + bytes(1000), "has 1012 bytes"),
        (struct.pack(">3i", 90, 90, 180) + bytes(1000), "big-endian"),
        (struct.pack("<3i", 90, 90, 2**31 - 1) + bytes(1000), "no format"),
        (struct.pack("<2i", 90, 90), "no format"),
        (b"", "empty"),
    ],
)
def test_damaged_files(tmp_path, content, words):
    """Catches a traceback, or memory taken before the size is known to be right."""
    path = tmp_path / "file.dat"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=words) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_nan_and_channels(full, tmp_path):
    """Catches a NaN read as a value, and channels that the format does not have."""
    planes, _ = full
    damaged = planes.copy()
    damaged[1, 0, 0, 0] = np.nan
    path = tmp_path / "file.dat"
    merl.write_table(path, damaged)
    with pytest.raises(BadInput, match=f"byte {12 + 8 * 1458000}"):
        read(path)
    samples = make_samples(directions(40, 1, 80), directions(40, 2, 80), np.ones((40, 2)))
    with pytest.raises(BadInput, match="2 channels"):
        write(samples, tmp_path / "out.binary")
