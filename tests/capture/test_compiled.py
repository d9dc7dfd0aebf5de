"""The compiled merge against the one in numpy: same numbers within single precision, same flags."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import capture.bands as bands_module
import capture.merge as merge_module
from capture.dark import DarkModel
from capture.merge import Flag, merge
from capture.mosaic import SpilledMosaic
from capture.sensor import SensorModel

if TYPE_CHECKING:
    from numpy.typing import NDArray

BLACK, CLIP = 512, 16383
TIMES = np.array([0.01, 0.01, 0.05, 0.25, 1.0])
SHAPE = (70, 531)  # more than two tiles wide, and a part of one
SENSOR = SensorModel(0.4, 3.0, CLIP)


def expose(shape: tuple[int, int], *, seed: int = 0) -> NDArray[np.uint16]:
    """Frames of dark, bright and clipped patches, with pixels that moved; (N, H, W)."""
    rng = np.random.default_rng(seed)
    patches = 10.0 ** rng.uniform(0.5, 6.6, (-(-shape[0] // 7), -(-shape[1] // 13)))
    scene = np.kron(patches, np.ones((7, 13)))[: shape[0], : shape[1]]
    frames = []
    for exposure_s in TIMES:
        signal = scene * exposure_s
        counts = signal + rng.standard_normal(shape) * np.sqrt(0.4 * signal + 9.0) + BLACK
        frames.append(np.clip(np.rint(counts), 0, CLIP))
    frames[2][::9, ::31] *= 0.5
    return np.stack(frames).astype(np.uint16)


def darks(kind: str, shape: tuple[int, int]) -> Any:
    """Darks as a number, as a map for each frame, or as a model with hot pixels."""
    if kind == "number":
        return float(BLACK)
    maps = np.random.default_rng(1).normal(BLACK, 2.0, (len(TIMES), *shape))
    if kind == "maps":
        return list(maps)
    frames = np.concatenate([np.rint(maps), np.rint(maps[::-1])]).astype(np.uint16)
    return DarkModel.from_frames(frames, [float(1.3 * t) for t in (*TIMES, *TIMES)])


@pytest.mark.parametrize("shape", [SHAPE, (71, 512), (1, 300), (2, 256)])
@pytest.mark.parametrize("kind", ["number", "maps", "model"])
@pytest.mark.parametrize("sensor", [SENSOR, SensorModel(0.4, 3.0, (16383, 15000, 16000)), None])
def test_compiled_is_the_same_merge(
    shape: tuple[int, int], kind: str, sensor: SensorModel | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch another estimate, a flag set elsewhere, or an edge of a tile that leaks."""
    monkeypatch.setattr(merge_module, "WIDE_PIXELS", 0)
    monkeypatch.setattr(merge_module, "_BLOCK_SAMPLES", 8000)
    frames, dark = expose(shape), darks(kind, shape)
    found = merge(frames, TIMES, dark=dark, sensor=sensor, chi_square=True)
    monkeypatch.setattr(bands_module, "_is_compilable", lambda *_: False)
    expected = merge(frames, TIMES, dark=dark, sensor=sensor, chi_square=True)
    sigma = np.sqrt(expected.variance)
    assert np.all(
        np.abs(found.radiance - expected.radiance) < 1e-6 * np.abs(expected.radiance) + 1e-4 * sigma
    )
    assert np.allclose(found.variance, expected.variance, rtol=5e-6)
    assert found.chi_square is not None
    assert expected.chi_square is not None
    assert np.allclose(found.chi_square, expected.chi_square, rtol=1e-2, atol=1e-2)
    assert found.samples is not None
    assert expected.samples is not None
    assert np.array_equal(found.samples, expected.samples)
    differ = found.flags ^ expected.flags
    assert np.count_nonzero(differ) <= 2e-4 * differ.size  # rounding decides at a limit
    if shape == SHAPE:
        assert np.bitwise_or.reduce(expected.flags, axis=None) & 0x1F
        for flag in (Flag.OVER_RANGE, Flag.UNDER_RANGE, Flag.NEIGHBOUR_CLIPPED, Flag.INCONSISTENT):
            assert (expected.flags & np.uint8(flag)).any()


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_other_counts_are_merged_too(dtype: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch eight bits read as sixteen, or fractions of counts cut off."""
    frames = (expose(SHAPE) // 65).astype(dtype)
    wide = merge(frames, TIMES, dark=8.0)
    monkeypatch.setattr(merge_module, "WIDE_PIXELS", 0)
    narrow = merge(frames, TIMES, dark=8.0)
    assert np.allclose(narrow.radiance, wide.radiance, rtol=1e-5, atol=1e-3)
    assert np.array_equal(narrow.flags, wide.flags)


def test_memory_for_files_does_not_grow_with_their_number(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch bands of compressed files held for every frame at once, or a change by unpacking."""
    from fractions import Fraction

    from simulator.dng import DngMeta, write_dng

    files = []
    for number, (counts, seconds) in enumerate(zip(expose((300, 256)), TIMES, strict=True)):
        files.append(tmp_path / f"{number}.dng")
        write_dng(files[-1], counts, DngMeta(Fraction(str(seconds)), (BLACK,) * 4, CLIP), lossless=True)
    expected = merge(files, None, sensor=SENSOR)
    monkeypatch.setattr("capture.frames.STREAMED_PIXELS", 0)
    asked: list[int] = []

    def spill(counts: NDArray[Any]) -> SpilledMosaic:
        asked.append(len(counts))
        return SpilledMosaic(counts)

    monkeypatch.setattr(bands_module, "SpilledMosaic", spill)
    monkeypatch.setattr(bands_module, "_MOST_BAND_BYTES", 20_000)
    found = merge(files, None, sensor=SENSOR)
    assert asked == [300] * len(files)
    for one, other in zip(found, expected, strict=True):
        assert np.array_equal(one, other)
