"""A session's frames that are not what they should be, merged without a word: each must be named.

The frames are those that a twin's session holds, written again with one thing changed.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from analysis.session_images import SessionImages
from capture.hot_pixels import HOT_PIXELS_FILE, load_hot_pixels, save_hot_pixels
from capture.merge import Flag
from capture.raw import read_raw
from capture.session import CALIBRATION_FOLDER, FrameRecord, PoseRecord, Session, hash_file
from capture.session_merge import SessionMerger
from rig.errors import BadInput
from simulator.dng import DngMeta, write_dng

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

pytestmark = pytest.mark.render


@pytest.fixture
def session(reference: Path) -> Iterator[Session]:
    """Return an opened session of the twin."""
    with Session.open(reference) as opened:
        yield opened


@pytest.fixture
def rewritten(tmp_path: Path) -> Callable[..., FrameRecord]:
    """Return a writer of changed frames: what they say of themselves, or their counts."""

    def write(frame: FrameRecord, change: Callable[..., Any] | None = None, **meta: Any) -> FrameRecord:
        raw = read_raw(frame.path)
        counts = raw.counts if change is None else change(raw.counts.astype(np.float64))
        path = tmp_path / frame.path.name
        about = DngMeta(
            shutter_s=Fraction(str(raw.shutter_s)),
            black_dn=tuple(int(black) for black in raw.black_dn.ravel()),  # type: ignore[arg-type]  # four
            white_dn=int(raw.white_dn),
            cfa=tuple(int(channel) for channel in raw.cfa.ravel()),  # type: ignore[arg-type]  # four
            serial=str(raw.camera_serial),
            f_number=Fraction(str(raw.f_number)).limit_denominator(1000),
            description={"gonio": 1, "exposure_s": str(raw.exposure_s), "lit": frame.lit},
        )
        write_dng(path, np.clip(np.rint(counts), 0, raw.white_dn).astype(np.uint16), replace(about, **meta))
        return replace(frame, path=path, sha256=hash_file(path))

    return write


def sample_record(session: Session) -> PoseRecord:
    """First pose of the sample."""
    return next(record for record in session.poses("sample") if record.frames)


def with_frames(record: PoseRecord, *frames: FrameRecord) -> PoseRecord:
    """Put other frames into a record."""
    return replace(record, frames=tuple(frames))


def test_rewritten_frames_merge_as_the_originals(
    session: Session, rewritten: Callable[..., FrameRecord]
) -> None:
    """Would catch a test below that is refused for another reason than the one it names."""
    record = sample_record(session)
    expected = SessionMerger(session).merge(record).merged
    again = with_frames(record, *(rewritten(frame) for frame in record.frames))
    assert np.array_equal(SessionMerger(session).merge(again).merged.radiance, expected.radiance)


@pytest.mark.parametrize(("meta", "named"), [({"serial": "OTHER"}, "serial"), ({"iso": 800}, "ISO")])
def test_frames_of_another_camera_or_iso(
    session: Session, rewritten: Callable[..., FrameRecord], meta: dict[str, Any], named: str
) -> None:
    """Would catch one frame of a bracket, or one pose of a session, that another camera or setting made."""
    record = sample_record(session)
    first, *others = record.frames
    if others:
        with pytest.raises(BadInput, match=named):
            SessionMerger(session).merge(with_frames(record, rewritten(first, **meta), *others))
    merger = SessionMerger(session)
    merger.merge(record)
    foreign = with_frames(record, *(rewritten(frame, **meta) for frame in record.frames))
    with pytest.raises(BadInput, match=named) as caught:
        merger.merge(foreign)
    assert first.path.name in str(caught.value)


def test_iso_changed_since_the_calibration(session: Session) -> None:
    """Would catch a noise model of another gain, used as if it were of this one."""
    record = sample_record(session)
    assert session.sensor is not None
    sensor = replace(session.sensor, iso=1600.0)
    with pytest.raises(BadInput, match=r"its ISO is 100\.0, the sensor was calibrated at 1600") as caught:
        SessionMerger(session, sensor).merge(record)
    assert record.frames[0].path.name in str(caught.value)


def test_truncated_frame(session: Session, tmp_path: Path) -> None:
    """Would catch a frame that ends early and merges as if it were dark there."""
    record = sample_record(session)
    cut = tmp_path / record.frames[0].path.name
    cut.write_bytes(record.frames[0].path.read_bytes()[:-5000])
    broken = replace(record.frames[0], path=cut)
    with pytest.raises(BadInput, match="changed since it was recorded"):
        SessionMerger(session).merge(with_frames(record, broken, *record.frames[1:]))
    recorded = replace(broken, sha256=hash_file(cut))  # it was short when its hash was taken
    with pytest.raises(BadInput, match=r"truncated|corrupt"):
        SessionMerger(session).merge(with_frames(record, recorded, *record.frames[1:]))


def with_darks(monkeypatch: pytest.MonkeyPatch, session: Session, change: Callable[..., FrameRecord]) -> None:
    """Change all darks of a session."""
    poses = session.poses

    def changed(role: str | None = None) -> list[PoseRecord]:
        records = list(poses(role)) if role is not None else list(poses())
        return [
            replace(record, frames=tuple(map(change, record.frames))) if record.role == "dark" else record
            for record in records
        ]

    monkeypatch.setattr(session, "poses", changed)


def test_light_in_a_dark(
    session: Session, rewritten: Callable[..., FrameRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch a dark frame that saw the scene, or a lamp that stayed on, subtracted from all frames."""
    record = sample_record(session)
    scene = read_raw(record.frames[-1].path)
    share = 0.05 * np.maximum(scene.counts - float(scene.black_dn.mean()), 0.0)
    with_darks(monkeypatch, session, lambda frame: rewritten(frame, lambda counts: counts + share))
    with pytest.raises(BadInput, match="light fell on it"):
        SessionMerger(session).merge(record)


def test_darks_of_another_camera(
    session: Session, rewritten: Callable[..., FrameRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch darks that belong to another sensor's pixels."""
    with_darks(monkeypatch, session, lambda frame: rewritten(frame, serial="OTHER"))
    with pytest.raises(BadInput, match="camera serial is OTHER"):
        SessionMerger(session).merge(sample_record(session))


def test_all_clipped_pose_is_told(
    session: Session, rewritten: Callable[..., FrameRecord], caplog: pytest.LogCaptureFixture
) -> None:
    """Would catch a pose whose lower bounds are taken for radiance, or that is left out in silence."""
    record = sample_record(session)

    def clipped(counts: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.full(counts.shape, 65535.0)

    bright = with_frames(record, *(rewritten(frame, clipped) for frame in record.frames))
    with caplog.at_level(logging.WARNING):
        merged = SessionMerger(session).merge(bright).merged
    assert np.all(merged.flags & np.uint8(Flag.OVER_RANGE))
    assert f"sample pose {record.index} is clipped in every frame" in caplog.text


def test_hot_pixels_of_the_calibration_are_flagged(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """Would catch a map that is stored and never used, or one of another crop that is used."""
    record = sample_record(session)
    shape = read_raw(record.frames[0].path).counts.shape
    plain = SessionMerger(session).merge(record).merged
    hot = np.zeros(shape, dtype=bool)
    hot[3, 5] = hot[10, 0] = True
    file = session.folder / CALIBRATION_FOLDER / HOT_PIXELS_FILE
    try:
        save_hot_pixels(hot, file)
        merged = SessionMerger(session).merge(record).merged
        added = (merged.flags ^ plain.flags) & np.uint8(Flag.HOT)
        assert np.array_equal(added != 0, hot & (plain.flags & np.uint8(Flag.HOT) == 0))
        assert np.all(merged.flags[hot] & np.uint8(Flag.HOT))
        save_hot_pixels(hot[:-2], file)
        with pytest.raises(BadInput, match="hot pixels are of"):
            SessionMerger(session).merge(record)
    finally:
        file.unlink()


@pytest.mark.parametrize(
    "text",
    [
        "not toml",
        "version = 1",
        "version = 9\nheight_px = 2\nwidth_px = 2\npixels = []",
        "version = 1\nheight_px = 2\nwidth_px = 2\npixels = [4]",
        "version = 1\nheight_px = 2\nwidth_px = 2\npixels = [-1]",
        "version = 1\nheight_px = 2\nwidth_px = 2\npixels = [true]",
    ],
)
def test_damaged_maps_are_named(tmp_path: Path, text: str) -> None:
    """Would catch a map that is read wrongly, or taken for one without hot pixels."""
    file = tmp_path / HOT_PIXELS_FILE
    file.write_text(text)
    with pytest.raises(BadInput, match=HOT_PIXELS_FILE):
        load_hot_pixels(file)
    assert load_hot_pixels(tmp_path / "none.toml") is None
    hot = np.random.default_rng(0).random((7, 9)) > 0.8
    save_hot_pixels(hot, file)
    again = load_hot_pixels(file)
    assert again is not None
    assert np.array_equal(again, hot)


def test_reductions_refuse_what_merges_refuse(
    session: Session, rewritten: Callable[..., FrameRecord]
) -> None:
    """Would catch checks that only one of the two commands makes."""
    record = sample_record(session)
    images = SessionImages(session)
    images.image(record)
    foreign = with_frames(record, *(rewritten(frame, iso=800) for frame in record.frames))
    with pytest.raises(BadInput, match="ISO"):
        images.image(foreign)
