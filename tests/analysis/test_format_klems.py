"""WINDOW XML: directions of the patches, sides, and nothing believed that is not XML of WINDOW."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.samples import read
from rig.angles import mirror, spherical_to_direction
from rig.errors import BadInput

BLOCK = "<AngleBasisBlock><Theta>{}</Theta><nPhis>{}</nPhis></AngleBasisBlock>"
BASIS = (
    f"<AngleBasis><AngleBasisName>B</AngleBasisName>{BLOCK.format(0, 1)}{BLOCK.format(40, 4)}</AngleBasis>"
)


def block(side, values, band="Visible"):
    """Make one wavelength band of one side."""
    return (
        f"<WavelengthData><Wavelength unit='Integral'>{band}</Wavelength><WavelengthDataBlock>"
        f"<WavelengthDataDirection>{side}</WavelengthDataDirection><ColumnAngleBasis>B</ColumnAngleBasis>"
        f"<RowAngleBasis>B</RowAngleBasis><ScatteringData>{', '.join(map(str, values))}</ScatteringData>"
        "</WavelengthDataBlock></WavelengthData>"
    )


def document(*blocks, kind="Columns", head="<?xml version='1.0'?>"):
    """Make a file of five patches."""
    return (
        f"{head}\n<WindowElement xmlns='http://windows.lbl.gov'><Optical><Layer><DataDefinition>"
        f"<IncidentDataStructure>{kind}</IncidentDataStructure>{BASIS}</DataDefinition>{''.join(blocks)}"
        "</Layer></Optical></WindowElement>"
    )


NUMBERED = np.arange(25.0)
BACK = block("Reflection Back", NUMBERED)


@pytest.fixture
def save(tmp_path):
    """Return a function that writes a file whose suffix says nothing."""

    def write_file(text):
        path = tmp_path / "file.dat"
        path.write_text(text)
        return path

    return write_file


def test_rows_leave_and_columns_arrive(save):
    """Catches the matrix transposed, and incidence without its half turn: a mirror is on the diagonal."""
    samples = read(save(document(BACK)))
    assert samples["channel"].to_numpy().tolist() == ["Visible"]
    np.testing.assert_array_equal(samples["f_r"][:, 0], NUMBERED)
    patches = spherical_to_direction(np.radians([0.0, 40, 40, 40, 40]), np.radians([0.0, 0, 90, 180, 270]))
    # The second row, third column: leaves by patch 1, arrives by patch 2.
    np.testing.assert_allclose(samples["wo"][7], patches[1], atol=1e-12)
    np.testing.assert_allclose(samples["wi"][7], mirror(patches[2]), atol=1e-12)
    diagonal = samples.isel(sample=np.arange(5) * 6)
    np.testing.assert_allclose(diagonal["wo"], mirror(diagonal["wi"]), atol=1e-12)


def test_sides_and_bands(save):
    """Catches the wrong side, a side of zeros preferred, and bands mixed up."""
    both = document(
        block("Reflection Front", NUMBERED + 1), BACK, block("Reflection Back", NUMBERED * 2, "Solar")
    )
    assert float(read(save(both))["f_r"][0, 0]) == 1.0
    back = read(save(both), side="back")
    np.testing.assert_array_equal(back["f_r"], np.stack([NUMBERED, 2 * NUMBERED], -1))
    assert back["channel"].to_numpy().tolist() == ["Visible", "Solar"]
    assert "Back" in read(save(document(block("Reflection Front", 0 * NUMBERED), BACK))).attrs["source"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (document(BACK)[:-40], "is not whole XML.*line 2"),
        (document(BACK, head="<!DOCTYPE a [<!ENTITY b 'c'>]>"), "line 1: declares a document type"),
        (document(BACK, head="<?xml version='1.0' encoding='klingon'?>"), "is not whole XML"),
        (document(BACK, kind="TensorTree3"), "TensorTree3.*bsdf2klems"),
        (document(block("Reflection Back", NUMBERED[1:])), "24 values, not 5 x 5"),
        (document(block("Reflection Back", [*NUMBERED[1:], "x"])), "Visible, Reflection Back, value 25: 'x'"),
        (document(block("Transmission Front", NUMBERED)), "no reflection"),
        (document(BACK).replace("<nPhis>4", "<nPhis>4e9"), "4e.09 patches"),
        (document(BACK).replace("<RowAngleBasis>B", "<RowAngleBasis>C"), "basis 'C'"),
        (document(BACK, BACK), "stands twice"),
        (document(BACK, "<a/>" * 30000), "more than 20000 elements"),
    ],
)
def test_damaged_files(save, text, words):
    """Catches a traceback, an entity expanded, and memory taken for a number in the file."""
    path = save(text)
    with pytest.raises(BadInput, match=words) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
