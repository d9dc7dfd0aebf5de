"""Exports of the RT-300S for other programs: four layouts of the same readings."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.formats.rt300s_text import Flag
from analysis.samples import read
from rig.angles import direction_to_spherical
from rig.errors import BadInput
from tests.analysis.whole_files import JDV, LIGHTTOOLS, RAYWIZ, SPEOS


@pytest.fixture
def save(tmp_path):
    """Return a function that writes a file whose suffix says nothing."""

    def write_file(content):
        path = tmp_path / "file.dat"
        path.write_text(content)
        return path

    return write_file


def _by_direction(samples, rows=slice(None)):
    keys = np.round(np.concatenate([samples["wi"][rows], samples["wo"][rows]], axis=1), 9) + 0.0
    order = np.lexsort(keys.T)
    return keys[order], samples["f_r"].to_numpy()[rows, 0][order]


@pytest.mark.parametrize("text", [RAYWIZ, LIGHTTOOLS, SPEOS])
def test_the_layouts_agree(save, text):
    """Catches rows taken for columns, and an incidence taken from the wrong place."""
    expected, values = _by_direction(read(save(JDV)))
    directions, f_r = _by_direction(read(save(text)))
    np.testing.assert_array_equal(directions, expected)
    np.testing.assert_array_equal(f_r, values)


def test_one_value(save):
    """Catches a percent, a pi or a cosine that is missing, and azimuth and receive exchanged."""
    samples = read(save(JDV))
    theta_i, _ = (np.degrees(angle) for angle in direction_to_spherical(samples["wi"].to_numpy()))
    theta_o, phi_o = (np.degrees(angle) for angle in direction_to_spherical(samples["wo"].to_numpy()))
    in_plane = np.abs(samples["wi"].to_numpy()[:, 1]) < 1e-9
    row = np.flatnonzero(
        (np.abs(theta_i - 30) < 1e-6) & (theta_o > 30) & (np.cos(np.radians(phi_o)) > 0) & in_plane
    )
    assert row.size == 1
    assert samples["f_r"].to_numpy()[row[0], 0] == pytest.approx(0.035 / (np.pi * np.cos(np.radians(40))))
    # The mirror direction's side: light and detector on different sides of the normal.
    assert samples["wi"].to_numpy()[row[0], 0] < 0.0 < samples["wo"].to_numpy()[row[0], 0]


def test_an_empty_block_is_flagged(save):
    """Catches zeros that nobody measured taken for a black sample."""
    empty = JDV.replace("1.30\t2.5\t3.5", "0\t0\t0").replace("4.5\t5.30\t6.5", "0\t0\t0")
    flagged = (read(save(empty))["flags"].to_numpy()[:, 0] & Flag.EMPTY_BLOCK) > 0
    assert flagged.sum() == 6


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (JDV.replace("Polar:\t-40,40,40", "Polar:\t-40,40,20", 1), "line 1: .*Polar"),
        (JDV.replace("-80\t4.5\t5.0\t6.5\n", "", 1), "line 1: .*Azimuth"),
        (JDV.replace("5.30", "5,30"), "line 22, column 3: '5,30'"),
        (RAYWIZ.replace("3.5\t6.5\t\t\n", "", 1), "different lengths"),
        (LIGHTTOOLS.replace("40\t3.5\t6.5\n", "", 1), "line 1: .*3 receive"),
        (SPEOS.replace("Sample 30", "Sample"), "line 13: .*incidence"),
        (SPEOS.replace("-40\t1.0\t4.5", "-95\t1.0\t4.5", 1), "90 deg"),
    ],
)
def test_damaged_blocks(save, text, complaint):
    """Catches a table that is read although it does not have the size that its header states."""
    with pytest.raises(BadInput, match=complaint):
        read(save(text))


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["test_jdv.jdv", "test_raywiz.jdv", "test_lighttools.txt", "test_speos.rtd"])
def test_exports_of_one_measurement_agree_with_its_xls(shared_data, name):
    """Catches a wrong scale or direction: the `.xls` prints three digits of the same readings."""
    folder = shared_data / "rt300s" / "vendor-exports"
    samples = read(folder / name)
    measured = (samples["flags"].to_numpy()[:, 0] & Flag.EMPTY_BLOCK) == 0
    assert measured.sum() == 12
    directions, f_r = _by_direction(samples, measured)
    expected, values = _by_direction(read(folder / "test_excel.xls"))
    np.testing.assert_allclose(directions, expected, atol=1e-8)
    np.testing.assert_allclose(f_r, values, rtol=2e-3)
