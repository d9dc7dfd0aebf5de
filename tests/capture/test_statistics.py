"""What a frame shows, in numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from capture.raw import RawFrame
from capture.sensor import SensorModel
from capture.statistics import FrameStatistics, frame_statistics, thinned

BLACK = np.array([[512.0, 516.0], [508.0, 520.0]])
RGGB = np.array([[0, 1], [1, 2]])


def frame_of(counts: np.ndarray, channels: tuple[str, ...] = ("R", "G", "B")) -> RawFrame:
    """Return a frame with these counts, of nobody's camera."""
    cfa = RGGB if len(channels) == 3 else np.zeros((2, 2), dtype=np.int64)
    return RawFrame(
        counts=counts.astype(np.uint16),
        cfa=cfa,
        channels=channels,
        black_dn=BLACK,
        white_dn=15000.0,
        exposure_s=1.0,
        shutter_s=1.0,
        camera_serial=None,
        camera_model=None,
        iso=None,
        shot_id=None,
        lit=True,
        path=Path("f"),
    )


def flat_frame(levels: tuple[float, float, float], height: int = 40, width: int = 60) -> RawFrame:
    """Return a frame with one level above black for each channel."""
    counts = np.empty((height, width))
    for row in (0, 1):
        for col in (0, 1):
            counts[row::2, col::2] = levels[RGGB[row, col]] + BLACK[row, col]
    return frame_of(counts)


def test_channels_are_told_apart_and_black_goes_by_position() -> None:
    """Would catch one black level for all, and greens mixed with another channel."""
    shown = frame_statistics(flat_frame((1000.0, 2000.0, 3000.0)))
    assert [c.median_dn for c in shown.channels] == [1000.0, 2000.0, 3000.0]
    assert [c.dim_dn for c in shown.channels] == [1000.0, 2000.0, 3000.0]
    assert shown.channels[1].range_dn == 15000.0 - 516.0
    assert shown.dim_dn == 1000.0
    assert shown.brightness == pytest.approx(3000.0 / (15000.0 - 520.0))
    assert shown.pixels == 40 * 60


def test_only_the_region_counts() -> None:
    """Would catch the bright holder around a dark sample deciding on the exposure."""
    frame = flat_frame((1000.0, 1000.0, 1000.0))
    frame.counts[:, 30:] = 15500
    region = np.zeros(frame.counts.shape, dtype=bool)
    region[:, :30] = True
    assert frame_statistics(frame, region).clipped_fraction == 0.0
    assert frame_statistics(frame).clipped_fraction == pytest.approx(0.5)
    assert frame_statistics(frame, np.zeros_like(region)) == frame_statistics(frame)


def test_the_calibrated_clip_level_counts() -> None:
    """Would catch a clip level taken from a file that claims too much."""
    sensor = SensorModel(0.5, 1.5, clip_dn=2600.0, black_dn=(500.0, 500.0, 500.0, 500.0))
    shown = frame_statistics(flat_frame((1000.0, 2000.0, 3000.0)), None, sensor)
    assert [c.clipped_fraction for c in shown.channels] == [0.0, 0.0, 1.0]
    assert shown.channels[0].range_dn == 2100.0
    assert shown.channels[0].median_dn == 1012.0


def test_a_frame_without_colours_has_one_channel() -> None:
    """Would catch a monochrome camera that finds no pixels."""
    shown = frame_statistics(frame_of(np.full((8, 8), 1512), ("mono",)))
    assert len(shown.channels) == 1
    assert shown.channels[0].median_dn == pytest.approx(998.0)


def test_a_thinned_frame_keeps_its_mosaic_and_places() -> None:
    """Would catch colours that change places when a large frame is thinned."""
    counts = np.arange(90 * 150).reshape(90, 150)
    small, rows, cols = thinned(frame_of(counts), 1000)
    assert small.counts.size <= 1200
    np.testing.assert_array_equal(small.counts, counts[np.ix_(rows, cols)])
    assert np.all(rows[::2] % 2 == 0)
    assert np.all(cols[1::2] % 2 == 1)
    levels = (1000.0, 2000.0, 3000.0)
    large = flat_frame(levels, 600, 800)
    assert [c.median_dn for c in frame_statistics(thinned(large)[0]).channels] == list(levels)
    assert thinned(large, 600 * 800)[0].counts.shape == (600, 800)


def test_statistics_survive_the_journal() -> None:
    """Would catch digits lost on the way: a resumed session would decide otherwise."""
    rng = np.random.default_rng(0)
    shown = frame_statistics(frame_of(rng.integers(500, 16000, (40, 60))))
    assert FrameStatistics.from_json(shown.to_json()) == shown
