"""DNG files are read back bit for bit, by LibRaw and by our own reader, with every tag in its place."""

from __future__ import annotations

import json
import os
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rawpy
from hypothesis import given
from hypothesis import strategies as st

from capture.raw import read_raw
from rig.errors import BadInput
from simulator.dng import DngMeta, encode_dng, exact_seconds, write_dng

if TYPE_CHECKING:
    from pathlib import Path

META = DngMeta(
    shutter_s=exact_seconds(0.02),
    black_dn=(512, 516, 508, 520),
    white_dn=15498,
    serial="GONIO-1",
    iso=200,
    f_number=Fraction(24, 5),
    focal_length_mm=Fraction(48),
    unique_id=bytes(range(16)),
    description={
        "gonio": 1,
        "shot_id": "s-1",
        "exposure_s": "0.0123",
        "lit": True,
        "camera_serial": "GONIO-1",
    },
)


@pytest.mark.parametrize("shape", [(96, 128), (101, 151), (22, 22), (23, 33)])
def test_libraw_reads_the_counts_bit_for_bit(tmp_path: Path, shape: tuple[int, int]) -> None:
    """Would catch a wrong strip offset, byte order, size, or a tag that makes LibRaw alter the counts."""
    counts = np.random.default_rng(1).integers(0, 65536, shape).astype(np.uint16)
    path = tmp_path / "frame.dng"
    write_dng(path, counts, META)
    with rawpy.imread(str(path)) as raw:
        assert np.array_equal(raw.raw_image, counts)
        assert raw.raw_pattern.tolist() == [[0, 1], [3, 2]]
        # By colour (R, G, B, second G), while the file holds it by position.
        assert list(raw.black_level_per_channel) == [512, 516, 520, 508]
        assert raw.white_level == 15498
        assert raw.other.iso_speed == 200
        assert raw.other.shutter_speed == np.float32(0.02)
        assert raw.other.aperture == pytest.approx(4.8)
        assert raw.other.focal_length == 48


def test_our_reader_and_libraw_agree_on_the_file(tmp_path: Path) -> None:
    """Would catch metadata that the capture side cannot read, times that are not exact among them."""
    counts = np.full((24, 26), 700, np.uint16)
    path = tmp_path / "frame.dng"
    write_dng(path, counts, META)
    frame = read_raw(path)
    assert np.array_equal(frame.counts, counts)
    assert (frame.exposure_s, frame.shutter_s) == (0.0123, 0.02)
    assert (frame.shot_id, frame.lit, frame.camera_serial) == ("s-1", True, "GONIO-1")
    assert frame.black_dn.tolist() == [[512, 516], [508, 520]]
    assert frame.white_dn == 15498


def test_files_belong_to_everybody_and_appear_complete(tmp_path: Path) -> None:
    """Would catch files that another user cannot delete, and half files under the final name."""
    mask = os.umask(0o077)
    try:
        write_dng(tmp_path / "frame.dng", np.zeros((24, 24), np.uint16), META)
    finally:
        os.umask(mask)
    assert [path.name for path in tmp_path.iterdir()] == ["frame.dng"]
    assert (tmp_path / "frame.dng").stat().st_mode & 0o777 == 0o666
    with pytest.raises(OSError, match="No such file"):
        write_dng(tmp_path / "missing" / "frame.dng", np.zeros((24, 24), np.uint16), META)


def test_the_same_frame_is_the_same_file() -> None:
    """Would catch a date or a process number in the file."""
    counts = np.arange(576, dtype=np.uint16).reshape(24, 24)
    assert encode_dng(counts, META) == encode_dng(counts.copy(), META)


def test_what_is_not_a_mosaic_is_refused() -> None:
    """Would catch files that LibRaw later refuses: other types, other shapes, too few pixels."""
    for counts in (np.zeros((24, 24)), np.zeros((24, 24, 3), np.uint16), np.zeros((24, 21), np.uint16)):
        with pytest.raises(BadInput, match="2-D uint16"):
            encode_dng(counts, META)


@given(st.floats(1e-5, 600.0))
def test_times_are_exact_decimals_and_fit_a_rational(seconds: float) -> None:
    """Would catch a numerator or denominator beyond 32 bits, or a time that is not exact."""
    ratio = exact_seconds(seconds)
    assert 0 < ratio.numerator < 2**32
    assert 0 < ratio.denominator < 2**32
    assert float(ratio) == pytest.approx(seconds, rel=1e-4 * 1e-5 / seconds + 1e-9)
    assert exact_seconds(round(seconds, 5)) == Fraction(str(round(seconds, 5)))


def test_description_survives_what_ascii_cannot_hold(tmp_path: Path) -> None:
    """Would catch a name with an accent ending the frame."""
    path = tmp_path / "frame.dng"
    description = {"gonio": 1, "shot_id": "é"}
    counts = np.zeros((24, 24), np.uint16)
    write_dng(path, counts, DngMeta(Fraction(1), (0, 0, 0, 0), 1, description=description))
    assert json.dumps(description, separators=(",", ":")).encode() in path.read_bytes()
    assert read_raw(path).shot_id == "é"
