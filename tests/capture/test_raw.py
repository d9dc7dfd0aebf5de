"""RAW frames: the short cut and LibRaw must tell the same, and damage must be named in one line."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rawpy
import tifffile

from capture import tiff_tags
from capture.mosaic import SpilledMosaic
from capture.raw import inspect_frame, open_raw, read_raw
from rig.errors import BadInput
from simulator.dng import DngMeta, write_dng

if TYPE_CHECKING:
    from numpy.typing import NDArray

CFA_TAGS = [(33421, 3, 2, (2, 2), True), (50706, 1, 4, b"\1\4\0\0", True)]
PATTERNS = {"RGGB": (0, 1, 1, 2), "GBRG": (1, 2, 0, 1), "BGGR": (2, 1, 1, 0), "GRBG": (1, 0, 2, 1)}


def mosaic(shape: tuple[int, int] = (96, 128), seed: int = 0) -> NDArray[np.uint16]:
    """Return random counts."""
    return np.random.default_rng(seed).integers(0, 65536, shape).astype(np.uint16)


def cfa_file(
    path: Path, counts: NDArray[Any], *, pattern: str = "RGGB", extra: tuple[Any, ...] = (), **options: Any
) -> Path:
    """Write a minimal CFA DNG with more tags."""
    tags = [*CFA_TAGS, (33422, 1, 4, bytes(PATTERNS[pattern]), True), *extra]
    tifffile.imwrite(path, counts, photometric=32803, metadata=None, extratags=tags, **options)
    return path


def twin_file(path: Path, counts: NDArray[np.uint16], *, lossless: bool = False, **changes: Any) -> Path:
    """Write a frame as the twin does."""
    description = {
        "gonio": 1,
        "shot_id": "p3-a",
        "exposure_s": "0.0123",
        "lit": True,
        "camera_serial": "GONIO-1",
    }
    meta = DngMeta(
        shutter_s=Fraction(1, 50),
        black_dn=(512, 516, 508, 520),
        white_dn=15498,
        serial="GONIO-1",
        iso=200,
        description={**description, **changes},
    )
    write_dng(path, counts, meta, lossless=lossless)
    return path


def through_libraw(path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Read a file without the short cut."""
    with monkeypatch.context() as patch:
        patch.setattr(tiff_tags, "_is_plain_mosaic", lambda *_: False)
        return read_raw(path)


@pytest.mark.parametrize("lossless", [False, True])
@pytest.mark.parametrize("shape", [(96, 128), (101, 151), (22, 23), (520, 530)])
def test_short_cut_equals_libraw_on_our_own_file(
    tmp_path: Path, shape: tuple[int, int], lossless: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch a short cut that reads other counts, colours or black levels than LibRaw."""
    if lossless:
        pytest.importorskip("imagecodecs")
    counts = mosaic(shape)
    path = twin_file(tmp_path / "a.dng", counts, lossless=lossless)
    fast, slow = read_raw(path), through_libraw(path, monkeypatch)
    with rawpy.imread(str(path)) as raw:
        assert np.array_equal(fast.counts, raw.raw_image_visible)
    assert np.array_equal(fast.counts, counts)
    assert np.array_equal(slow.counts, counts)
    assert fast.cfa.tolist() == slow.cfa.tolist() == [[0, 1], [1, 2]]
    assert fast.black_dn.tolist() == slow.black_dn.tolist() == [[512, 516], [508, 520]]
    assert fast.white_dn == slow.white_dn == 15498
    assert fast.info == slow.info


@pytest.mark.parametrize("pattern", PATTERNS)
def test_black_follows_the_position_for_every_bayer_phase(
    tmp_path: Path, pattern: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch LibRaw's colour-indexed black levels used as positions (wrong where the greens differ)."""
    black = ((50713, 3, 2, (2, 2), True), (50714, 4, 4, (512, 513, 514, 515), True))
    path = cfa_file(tmp_path / "a.dng", mosaic(), pattern=pattern, extra=black)
    for frame in (read_raw(path), through_libraw(path, monkeypatch)):
        assert frame.black_dn.tolist() == [[512, 513], [514, 515]]
        assert tuple(frame.cfa.ravel()) == PATTERNS[pattern]


def test_identity_of_our_own_file(tmp_path: Path) -> None:
    """Would catch the shutter's time taken for the lamp's, or the shot's ID lost."""
    info = inspect_frame(twin_file(tmp_path / "a.dng", mosaic()))
    assert info.exposure_s == 0.0123
    assert info.shutter_s == 0.02
    assert (info.shot_id, info.camera_serial, info.lit, info.iso) == ("p3-a", "GONIO-1", True, 200)
    assert (info.width_px, info.height_px) == (128, 96)


def test_inspection_of_our_own_file_needs_no_libraw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch LibRaw on the path that every shot waits for."""
    monkeypatch.setattr("capture.raw._frame_from_libraw", None)
    assert inspect_frame(twin_file(tmp_path / "a.dng", mosaic())).shot_id == "p3-a"


@pytest.mark.parametrize("stated", ["-1", "x", "nan", "1/0", "[]"])
def test_damaged_exposure_is_refused(tmp_path: Path, stated: str) -> None:
    """Would catch an exposure that is no time being used, or a traceback."""
    path = twin_file(tmp_path / "a.dng", mosaic(), exposure_s=stated)
    with pytest.raises(BadInput, match=r"a\.dng.*exposure_s"):
        read_raw(path)


@pytest.mark.parametrize("left_bytes", [0, 3, 10, 200, 700, 12_000, -2])
def test_truncated_file_is_named_in_one_line(tmp_path: Path, left_bytes: int) -> None:
    """Would catch a frame that was still being copied passing as a dark one, or a traceback."""
    path = twin_file(tmp_path / "half.dng", mosaic())
    path.write_bytes(path.read_bytes()[:left_bytes])
    with pytest.raises(BadInput, match=r"half\.dng") as error:
        inspect_frame(path)
    assert "\n" not in str(error.value)
    assert error.value.todo


def test_what_is_no_raw_file_is_refused(tmp_path: Path) -> None:
    """Would catch a text, a folder, a colour picture or a missing file ending in a traceback."""
    text = tmp_path / "notes.txt"
    text.write_text("not a picture at all, but long enough to be one" * 20)
    colour = tmp_path / "colour.tif"
    tifffile.imwrite(colour, np.zeros((32, 32, 3), np.uint8), photometric="rgb")
    for path in (text, colour, tmp_path, tmp_path / "absent.nef"):
        with pytest.raises(BadInput, match=path.name):
            read_raw(path)


def test_a_name_that_is_no_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch a stray file's odd name that ends a capture."""
    path = tmp_path / "\udcff.dng"
    try:
        path.write_bytes(b"no picture")
    except (OSError, UnicodeError):
        pytest.skip("this file system has only names that are text")
    with pytest.raises(BadInput, match="truncated or corrupt"):
        read_raw(path)
    twin_file(path, mosaic())
    assert np.array_equal(through_libraw(path, monkeypatch).counts, mosaic())


def test_header_that_announces_a_giant_takes_no_memory(tmp_path: Path) -> None:
    """Would catch memory taken for a size that a damaged header invents."""
    path = twin_file(tmp_path / "a.dng", mosaic())
    data = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as tiff:
        offsets = [tiff.pages.first.tags[code].valueoffset for code in (256, 257)]
    for offset in offsets:
        data[offset : offset + 4] = (60_000).to_bytes(4, "little")
    path.write_bytes(bytes(data))
    with pytest.raises(BadInput, match="60000 x 60000"):
        read_raw(path)


def test_odd_margins_keep_counts_and_colours_together(tmp_path: Path) -> None:
    """Would catch the pattern of the whole sensor used for a visible area that starts elsewhere."""
    counts = mosaic((100, 140))
    area = ((50829, 3, 4, (5, 7, 96, 135), True),)
    frame = read_raw(cfa_file(tmp_path / "a.dng", counts, extra=area))
    rows, cols = (index[0] for index in np.nonzero(counts == frame.counts[0, 0]))
    full = np.array(PATTERNS["RGGB"]).reshape(2, 2)
    # The pattern starts at the active area's corner (DNG 1.7, CFAPattern), here (5, 7).
    expected = [[full[(rows - 5 + i) % 2, (cols - 7 + j) % 2] for j in (0, 1)] for i in (0, 1)]
    assert frame.cfa.tolist() == expected
    height, width = frame.counts.shape
    assert np.array_equal(frame.counts, counts[rows : rows + height, cols : cols + width])


def test_linearisation_table_goes_through_libraw(tmp_path: Path) -> None:
    """Would catch codes taken for counts where the file says that they are not linear."""
    counts = (mosaic() % 256).astype(np.uint16)
    table = np.arange(256, dtype=np.uint16) * 3
    path = cfa_file(tmp_path / "a.dng", counts, extra=((50712, 3, 256, tuple(table.tolist()), True),))
    frame = read_raw(path)
    assert np.array_equal(frame.counts, table[counts])
    assert frame.linearised
    assert not read_raw(
        cfa_file(tmp_path / "b.dng", counts, extra=((50829, 3, 4, (0, 0, 96, 128), True),))
    ).linearised


@pytest.mark.parametrize("has_decoder", [False, True])
def test_lossless_jpeg_of_others(tmp_path: Path, has_decoder: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch compressed DNGs read as if they were not, or refused without a decoder of our own."""
    pytest.importorskip("imagecodecs")
    counts = mosaic((70, 64))
    arguments = {"lossless": True, "bitspersample": 16}
    path = cfa_file(tmp_path / "a.dng", counts, compression="jpeg", compressionargs=arguments, tile=(64, 64))
    monkeypatch.setattr(tiff_tags, "_has_imagecodecs", lambda: has_decoder)
    assert np.array_equal(read_raw(path).counts, counts)


def test_two_components_are_neighbouring_columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch the way in which most cameras and converters compress a mosaic read as two pictures."""
    imagecodecs = pytest.importorskip("imagecodecs")
    counts = mosaic((64, 128))
    pairs = np.ascontiguousarray(counts.reshape(64, 64, 2))
    tile = bytes(imagecodecs.jpeg_encode(pairs, lossless=True, bitspersample=16))
    path = tmp_path / "a.dng"
    options = {"shape": (64, 128), "dtype": np.uint16, "tile": (64, 128), "compression": 7}
    tags = [*CFA_TAGS, (33422, 1, 4, bytes(PATTERNS["RGGB"]), True)]
    tifffile.imwrite(path, iter([tile]), photometric=32803, metadata=None, extratags=tags, **options)
    assert np.array_equal(through_libraw(path, monkeypatch).counts, counts)
    monkeypatch.setattr("capture.raw._frame_from_libraw", None)
    assert np.array_equal(read_raw(path).counts, counts)


@pytest.mark.parametrize("place", ["size", "end", "marker"])
def test_damaged_lossless_jpeg_is_named(tmp_path: Path, place: str) -> None:
    """Would catch a damaged tile that becomes zeros, or takes memory for a giant."""
    pytest.importorskip("imagecodecs")
    path = twin_file(tmp_path / "a.dng", mosaic((600, 560)), lossless=True)
    data = bytearray(path.read_bytes())
    header = data.index(b"\xff\xc3")
    if place == "size":
        data[header + 5 : header + 9] = b"\xff\xff\xff\xff"
    elif place == "end":
        data = data[:-2000]
    else:
        data[header + 1] = 0xC0
    path.write_bytes(bytes(data))
    with pytest.raises(BadInput, match=r"a\.dng.*truncated or corrupt"):
        read_raw(path)


@pytest.mark.parametrize("lossless", [False, True])
@pytest.mark.parametrize("rows", [slice(0, 5), slice(509, 515), slice(600, 700), slice(3, 3), slice(None)])
def test_rows_of_a_file(tmp_path: Path, lossless: bool, rows: slice) -> None:
    """Would catch rows read from another place of the file, or a seam between tiles."""
    if lossless:
        pytest.importorskip("imagecodecs")
    counts = mosaic((620, 530))
    path = twin_file(tmp_path / "a.dng", counts, lossless=lossless)
    frame = open_raw(path)
    assert frame.counts.shape == counts.shape
    assert np.array_equal(frame.counts[rows], counts[rows])
    assert np.array_equal(SpilledMosaic(counts)[rows], counts[rows])


def test_file_cut_while_it_is_read(tmp_path: Path) -> None:
    """Would catch rows that are gone read as zeros."""
    path = twin_file(tmp_path / "a.dng", mosaic())
    frame = open_raw(path)
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(BadInput, match=r"a\.dng.*truncated"):
        frame.counts[:]


def test_strips_tiles_and_byte_orders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch a layout of another program read askew."""
    counts = mosaic((101, 151))
    for index, options in enumerate(
        ({"rowsperstrip": 7}, {"tile": (32, 48)}, {"byteorder": ">"}, {"rowsperstrip": 1000})
    ):
        path = cfa_file(tmp_path / f"{index}.dng", counts, **options)
        assert np.array_equal(through_libraw(path, monkeypatch).counts, counts)
        assert np.array_equal(read_raw(path).counts, counts)
        assert np.array_equal(open_raw(path).counts[33:90], counts[33:90])


def test_margins_tell_the_optical_black(tmp_path: Path) -> None:
    """Would catch covered pixels counted with the picture, or by the wrong position of the cell."""
    counts = np.full((100, 140), 3000, np.uint16)
    margin = np.tile(np.array([[500, 510], [520, 530]], np.uint16), (50, 70))
    counts[:, :20] = margin[:, :20]
    counts[:, 0] = 40  # a column that is not read out
    area = ((50829, 3, 4, (0, 20, 100, 140), True),)
    frame = read_raw(cfa_file(tmp_path / "a.dng", counts, extra=area))
    assert frame.optical_black_dn is not None
    assert frame.optical_black_dn.tolist() == [[500, 510], [520, 530]]
    assert read_raw(twin_file(tmp_path / "b.dng", counts)).optical_black_dn is None


def test_x_trans_is_refused_in_words(tmp_path: Path) -> None:
    """Would catch a 6 x 6 mosaic read as if it were 2 x 2."""
    cell = bytes(
        [
            1,
            2,
            1,
            1,
            0,
            1,
            0,
            1,
            0,
            2,
            1,
            2,
            1,
            2,
            1,
            1,
            0,
            1,
            1,
            0,
            1,
            1,
            2,
            1,
            2,
            1,
            2,
            0,
            1,
            0,
            1,
            0,
            1,
            1,
            2,
            1,
        ]
    )
    tags = [(33421, 3, 2, (6, 6), True), (33422, 1, 36, cell, True), (50706, 1, 4, b"\1\4\0\0", True)]
    path = tmp_path / "x.dng"
    tifffile.imwrite(path, mosaic((96, 96)), photometric=32803, metadata=None, extratags=tags)
    with pytest.raises(BadInput, match=r"x\.dng"):
        read_raw(path)


def test_plain_tiff_is_a_mosaic_without_colours(tmp_path: Path) -> None:
    """Would catch eight-bit TIFF darks refused, rescaled, or given an invented colour pattern."""
    counts = (mosaic((33, 40)) % 256).astype(np.uint8)
    path = tmp_path / "dark_250ms.tif"
    tifffile.imwrite(path, counts, compression="zlib")
    frame = read_raw(path)
    assert np.array_equal(frame.counts, counts)
    assert frame.counts.dtype == np.uint16
    assert frame.channels == ("mono",)
    assert frame.white_dn == 255
    assert frame.exposure_s is None


def test_exposure_is_the_simplest_fraction(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch LibRaw's float32 times (1/125 s as 0.00800000038) entering ratios of exposures."""
    for numerator, denominator in ((1, 125), (1, 8000), (13, 10), (30, 1), (2, 5)):
        tag = ((33434, 5, 1, (numerator, denominator), True),)
        path = cfa_file(tmp_path / "a.dng", mosaic(), extra=tag)
        assert read_raw(path).exposure_s == numerator / denominator
        with monkeypatch.context() as patch:
            patch.setattr(tiff_tags, "open_mosaic", lambda _: (None, {}))
            assert read_raw(path).exposure_s == numerator / denominator


@pytest.mark.realdata
def test_flea3_frames(shared_data: Path) -> None:
    """Would catch a wrong pattern, depth or time of the real frames."""
    frame = read_raw(shared_data / "flea3" / "disks" / "disks_450nm_0100ms.dng")
    assert frame.counts.shape == (344, 408)
    assert frame.cfa.tolist() == [[1, 2], [0, 1]]
    assert frame.white_dn == 255
    assert frame.exposure_s == 0.1
    dark = read_raw(next((shared_data / "flea3" / "dark").glob("d1_dark_100ms*")))
    assert dark.counts.shape == (344, 408)
    assert dark.channels == ("mono",)


def test_our_description_must_be_json(tmp_path: Path) -> None:
    """Would catch a damaged description ending in a traceback, and a foreign one being believed."""
    foreign = cfa_file(
        tmp_path / "a.dng", mosaic(), description=json.dumps({"exposure_s": 3, "shot_id": "x"})
    )
    assert read_raw(foreign).shot_id is None
    assert read_raw(foreign).exposure_s is None
    damaged = cfa_file(tmp_path / "b.dng", mosaic(), description='{"gonio": 1, "exposure_s"')
    with pytest.raises(BadInput, match=r"b\.dng.*ImageDescription"):
        read_raw(damaged)


@pytest.mark.parametrize(
    ("tag", "value"),
    [
        (tiff_tags.BLACK_LEVEL, "J"),
        (tiff_tags.BLACK_LEVEL, ()),
        (tiff_tags.BLACK_REPEAT, (2, 2, 1)),
        (tiff_tags.BLACK_REPEAT, "x"),
        (tiff_tags.BLACK_REPEAT, 2),
        (tiff_tags.CFA_PATTERN, "RGGB"),
        (tiff_tags.CFA_PATTERN, 1),
    ],
)
def test_damaged_tags_are_one_line(tag: int, value: object) -> None:
    """Would catch a flipped bit in a frame's header that ends a capture with a traceback."""
    tags = {tiff_tags.BLACK_LEVEL: (1, 2, 3, 4), tiff_tags.CFA_PATTERN: b"\0\1\1\2", tag: value}
    path = Path("damaged.dng")
    with pytest.raises(BadInput, match=r"damaged\.dng: its (black level|colour filter)"):
        (tiff_tags.cfa(tags, path), tiff_tags.black_level(tags, path))
