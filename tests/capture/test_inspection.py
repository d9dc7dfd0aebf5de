"""Inspection of RAW files: what they cannot be trusted for must be said, and nothing against sound ones."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from capture.inspection import inspect_files
from rig.errors import BadInput
from simulator.dng import DngMeta, write_dng

META = DngMeta(
    shutter_s=Fraction(1, 100), black_dn=(500,) * 4, white_dn=16383, serial="A1", f_number=Fraction(4)
)


def frame(
    folder: Path, name: str, seconds: str, *, clip: int = 16383, factor: int = 1, **changes: Any
) -> str:
    """Write a frame of a ramp that clips where it reaches the limit."""
    rng = np.random.default_rng(Fraction(seconds).denominator)
    ramp = np.linspace(1e4, 2e6, 160)[np.newaxis] * float(Fraction(seconds)) * np.ones((120, 1))
    counts = np.minimum(np.rint((rng.poisson(ramp) + 500) / factor) * factor, clip).astype(np.uint16)
    meta = replace(META, shutter_s=Fraction(seconds), **changes)
    path = folder / f"{name}.dng"
    write_dng(path, counts, meta)
    return str(path)


def words(files: list[str]) -> str:
    """All findings in one text."""
    return "; ".join(f"{each.what}: {each.files}" for each in inspect_files(files).findings)


def test_a_sound_bracket_has_no_findings_and_shows_its_clip_level(tmp_path: Path) -> None:
    """Would catch false alarms, and a clip level that nobody sees."""
    files = [
        frame(tmp_path, name, name_s) for name, name_s in (("a", "1/400"), ("b", "1/100"), ("c", "1/25"))
    ]
    found = inspect_files(files)
    assert found.findings == ()
    assert found.clip_dn == (16383,) * 4
    assert found.frames[0].clip_dn == (None,) * 4
    assert [fact.exposure_s for fact in found.frames] == [1 / 400, 1 / 100, 1 / 25]
    assert found.frames[0].cfa == ("R", "G", "G", "B")
    assert found.frames[2].bits == 14


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"iso": 400}, "ISO differs"),
        ({"f_number": Fraction(8)}, "aperture differs"),
        ({"serial": "B2"}, "camera serial differs"),
        ({"model": "other"}, "camera model differs"),
        ({"cfa": (1, 0, 2, 1)}, "colour filter layout differs"),
        ({"black_dn": (500, 500, 500, 512)}, "black level differs"),
        ({"clip": 15498}, "clips at 15498 DN, and states 16383"),
        ({"factor": 4}, "multiples of 4"),
    ],
)
def test_what_changed_is_named(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    """Would catch an automatic setting, or a frame of another camera, that nobody is told of."""
    files = [frame(tmp_path, "a", "1/100"), frame(tmp_path, "odd", "1/25", **changes)]
    text = words(files)
    assert said in text
    assert "odd.dng" in text


def test_what_only_some_state_is_not_called_different(tmp_path: Path) -> None:
    """Would catch a difference claimed where one of the files is silent."""
    plain = tmp_path / "plain.tif"
    tifffile.imwrite(plain, np.full((96, 128), 700, np.uint16))
    text = words([frame(tmp_path, "a", "1/100"), str(plain)])
    assert "camera model is not stated, unlike in" in text
    assert "camera model differs" not in text
    silent_first = words([str(plain), frame(tmp_path, "a", "1/100")])
    assert "camera model is not stated, unlike in" in silent_first
    assert "camera model differs" not in silent_first


def test_the_same_picture_twice_is_named(tmp_path: Path) -> None:
    """Would catch a copy counted as a second measurement."""
    files = [frame(tmp_path, "a", "1/100"), frame(tmp_path, "copy", "1/100"), frame(tmp_path, "c", "1/25")]
    assert "same picture" in words(files)
    assert "copy.dng" in words(files)


def test_stretched_and_linearised_counts_are_named(tmp_path: Path) -> None:
    """Would catch counts whose steps tell nothing of the noise."""
    rng = np.random.default_rng(0)
    plain = rng.normal(3000, 60, (96, 128))
    stretched = np.rint(np.rint(plain) * 1.37).astype(np.uint16)
    path = tmp_path / "stretched.dng"
    write_dng(path, stretched, META)
    assert "never used" in words([str(path)])
    table = np.arange(4096, dtype=np.uint16) * 3
    tags = [(33421, 3, 2, (2, 2), True), (50706, 1, 4, b"\1\4\0\0", True), (33422, 1, 4, b"\0\1\1\2", True)]
    tags.append((50712, 3, 4096, tuple(table.tolist()), True))
    path = tmp_path / "table.dng"
    counts = np.rint(plain).astype(np.uint16)
    tifffile.imwrite(path, counts, photometric=32803, metadata=None, extratags=tags)
    assert "linearisation table" in words([str(path)])


def test_drift_of_the_covered_pixels_is_named(tmp_path: Path) -> None:
    """Would catch a black level that moves with the sensor's temperature."""
    rng = np.random.default_rng(0)
    tags = [(33421, 3, 2, (2, 2), True), (50706, 1, 4, b"\1\4\0\0", True), (33422, 1, 4, b"\0\1\1\2", True)]
    tags.append((50829, 3, 4, (0, 20, 100, 140), True))
    tags += [(50713, 3, 2, (2, 2), True), (50714, 4, 4, (500,) * 4, True)]
    files = []
    for number, black in enumerate((500.0, 502.0)):
        counts = np.rint(rng.normal(3000, 60, (100, 140))).astype(np.uint16)
        counts[:, :20] = np.rint(rng.normal(black, 2, (100, 20)))
        files.append(str(tmp_path / f"{number}.dng"))
        tifffile.imwrite(files[-1], counts, photometric=32803, metadata=None, extratags=tags)
    text = words(files)
    assert "covered pixels move by" in text
    assert "DN from the black level that it states" in text
    assert "0.dng" not in text.split("its covered pixels lie")[1]


def test_no_files_and_broken_ones_are_refused(tmp_path: Path) -> None:
    """Would catch a traceback where a file is no picture."""
    broken = tmp_path / "half.dng"
    broken.write_bytes(Path(frame(tmp_path, "a", "1/100")).read_bytes()[:9000])
    for files in ([], [str(broken)]):
        with pytest.raises(BadInput):
            inspect_files(files)
