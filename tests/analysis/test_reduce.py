"""Whole sessions to samples: frames read, darks taken off, poses paired, the table the same every time."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest

from analysis.budget import Correlation, budget
from analysis.corrections import Correction, corrections_named
from analysis.measurement import Options
from analysis.models import MODELS
from analysis.reduce import reduce_session
from analysis.samples import read, write
from analysis.white_calibration import WHITE_FILE, WhiteCalibration, save_white
from capture.interruptions import REFERENCE
from capture.records import Event, PoseFlag
from capture.session import FrameRecord, PoseRecord
from rig.errors import BadInput
from rig.kinematics import Kinematics
from rig.pixels import irradiance, pixel_geometry
from rig.ticks import rad_to_ticks, ticks_to_rad
from simulator.dng import DngMeta, write_dng
from simulator.sensor import Sensor

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

    from analysis.models.base import Model
    from capture.sensor import SensorModel
    from rig.description import Rig

EXPOSURES_S = (0.0158, 0.1264)
SAMPLE = MODELS["cook-torrance"](kd=(0.4, 0.2, 0.1), ks=0.5, m=0.3, ior=1.5)
WHITE = MODELS["lambert"](kd=(0.99, 0.99, 0.99))
POSES_DEG = ((30.0, 20.0), (45.0, 30.0), (60.0, -20.0))


@dataclass
class RecordedSession:
    """What a reduction asks of a session, over frames that a test wrote."""

    folder: Path
    rig: Rig
    sensor: SensorModel | None
    hot_pixels: None = None
    name: str = "test session"
    records: list[PoseRecord] = field(default_factory=list)
    lamp_outputs: dict[str, float] = field(default_factory=dict)

    happened: list[Event] = field(default_factory=list)

    def events(self) -> list[Event]:
        """Everything that happened."""
        return self.happened

    def poses(self, role: str | None = None) -> list[PoseRecord]:
        """All records, or those of one role."""
        return [record for record in self.records if role in {None, record.role}]


class Studio:
    """Writes the frames of a session: closed-form light on the twin's sensor."""

    def __init__(self, rig: Rig, folder: Path, *, bend: float = 0.0) -> None:
        self.rig, self.folder = rig, folder
        self.flat: np.ndarray | float = 1.0
        """What lens and sensor make of an even light, (H, W, 1)."""
        self.floor: np.ndarray | float = 0.0
        """Stray light, over what the white looks like, (H, W, 1)."""
        self.sensor = Sensor(rig.camera.width_px, rig.camera.height_px, serial="TEST", seed=4, bend=bend)
        self.session = RecordedSession(folder, rig, self.sensor.calibration())
        (folder / "calibration").mkdir(exist_ok=True)
        save_white(WhiteCalibration(lambertian=True), folder / "calibration" / WHITE_FILE)

    def pose(self, index: int, theta_i_deg: float, theta_o_deg: float) -> tuple[tuple[int, ...], np.ndarray]:
        """Ticks of all servos and angles of the arms at a pose in the plane of incidence."""
        ti, to = np.deg2rad([theta_i_deg, theta_o_deg])
        goal = Kinematics(self.rig).solve([np.sin(ti), 0, np.cos(ti)], [-np.sin(to), 0, np.cos(to)])
        ticks = [rad_to_ticks(j, float(a)) for j, a in zip(self.rig.arm_joints, goal, strict=True)]
        angles = np.array([ticks_to_rad(j, t) for j, t in zip(self.rig.arm_joints, ticks, strict=True)])
        return (*ticks, 2048 + index), angles

    def shoot(self, role: str, index: int, model: Model | None, pose_deg: tuple[float, float]) -> None:
        """Take one record: two exposures of a surface, or four darks at the longer time."""
        ticks, angles = self.pose(index, *pose_deg)
        radiance = None
        if model is not None:
            geometry = pixel_geometry(self.rig, angles)
            light = irradiance(self.rig, geometry)[..., None]
            radiance = model.evaluate(geometry.wi, geometry.wo) * light * geometry.on_sample[..., None]
            floor = self.floor * np.nanmax(light) / np.pi * (1.0 + np.sin(angles[0]))
            radiance = (radiance + floor) * self.flat
        times = EXPOSURES_S if model is not None else (EXPOSURES_S[index],) * 4
        frames = [self._frame(f"{role}-{index}-{n}", radiance, time) for n, time in enumerate(times)]
        record = PoseRecord(
            index, role, role, tuple(angles), ticks, tuple(frames), PoseFlag(0), complete=True
        )
        self.session.records.append(record)

    def _frame(self, shot: str, radiance: np.ndarray | None, time: float) -> FrameRecord:
        rng = np.random.default_rng(int.from_bytes(shot.encode(), "little"))
        path = self.folder / f"{shot}.dng"
        black, white = self.sensor.black_dn, int(self.sensor.clip_dn)
        meta = DngMeta(shutter_s=Fraction(time).limit_denominator(10**6), black_dn=black, white_dn=white)
        write_dng(path, self.sensor.expose(radiance, time, rng), meta)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        return FrameRecord(path, shot, time, radiance is not None, digest)


@pytest.fixture
def session(default_rig: Rig, tmp_path: Path) -> RecordedSession:
    """Three poses of a glossy sample and of the white, with darks."""
    studio = Studio(default_rig, tmp_path)
    for index, pose in enumerate(POSES_DEG):
        studio.shoot("sample", index, SAMPLE, pose)
        studio.shoot("white", index, WHITE, pose)
    for index in range(2):
        studio.shoot("dark", index, None, (0.0, 30.0))
    return studio.session


def test_a_session_gives_its_surface_within_stated_noise(session: RecordedSession) -> None:
    """Catches wrong darks, exposures, channel order or pairing of poses: pulls must be standard normal."""
    samples = reduce_session(session)
    truth = SAMPLE.evaluate(samples["wi"], samples["wo"])
    used = samples["flags"].to_numpy() == 0
    u = np.hypot(samples["u_noise"], samples["u_white"]).to_numpy()
    pull = ((samples["f_r"].to_numpy() - truth) / u)[used]
    assert used.mean() > 0.9
    assert samples.sizes["sample"] > 500
    assert list(samples["channel"].to_numpy()) == ["R", "G", "B"]
    assert abs(pull.mean()) < 0.15
    assert pull.std() == pytest.approx(1, abs=0.08)


def test_samples_of_a_session_go_to_disk_and_back(session: RecordedSession, tmp_path: Path) -> None:
    """Would catch a fact about the reduction that NetCDF cannot hold."""
    samples = reduce_session(session)
    write(samples, tmp_path / "samples.nc")
    again = read(tmp_path / "samples.nc")
    assert again.attrs.keys() >= samples.attrs.keys()
    assert again["f_r"].equals(samples["f_r"])


def test_order_of_the_records_does_not_matter(session: RecordedSession) -> None:
    """Catches a table, or a hash, that depends on how often the capture was interrupted."""
    shuffled = replace(session, records=session.records[::-1])
    assert reduce_session(session).identical(reduce_session(shuffled))


def test_every_file_counts_in_the_hash(session: RecordedSession) -> None:
    """Catches provenance that would not notice an exchanged frame."""
    before = reduce_session(session).attrs["frames_sha256"]
    record = session.records[0]
    frame = record.frames[1]
    content = frame.path.read_bytes() + b"\0"
    frame.path.write_bytes(content)
    other = replace(frame, sha256=hashlib.sha256(content).hexdigest())
    session.records[0] = replace(record, frames=(record.frames[0], other))
    assert reduce_session(session).attrs["frames_sha256"] != before


def test_a_changed_frame_is_refused_by_name(session: RecordedSession) -> None:
    """Catches samples made from frames that are not those that were recorded."""
    frame = session.records[0].frames[1]
    frame.path.write_bytes(frame.path.read_bytes() + b"\0")
    with pytest.raises(BadInput, match=frame.path.name):
        reduce_session(session)


def test_poses_without_white_are_left_out(session: RecordedSession) -> None:
    """Catches a sample divided by the white of another pose."""
    session.records = [r for r in session.records if not (r.role == "white" and r.index == 1)]
    samples = reduce_session(session)
    assert set(samples["pose"].to_numpy().tolist()) == {0, 2}


def test_no_white_at_all_is_one_line(session: RecordedSession) -> None:
    """Catches an empty table, or a traceback, from an unfinished session."""
    session.records = session.poses("sample")
    with pytest.raises(BadInput, match=r"no pose has both sample and white \(3 sample, 0 white\)"):
        reduce_session(session)


def test_without_darks_the_calibration_serves(session: RecordedSession) -> None:
    """Catches a session without darks that cannot be reduced; black level and dark current are calibrated."""
    session.records = [record for record in session.records if record.role != "dark"]
    samples = reduce_session(session)
    truth = SAMPLE.evaluate(samples["wi"], samples["wo"])
    relative = np.abs(samples["f_r"].to_numpy() / truth - 1)
    assert np.nanmedian(relative) < 0.01


def test_progress_is_told_of_each_pose(session: RecordedSession) -> None:
    """Catches a progress line that never ends."""
    seen: list[int] = []
    reduce_session(session, progress=lambda: seen.append(1))
    assert len(seen) == 3


def test_a_bent_response_is_in_the_budget(session: RecordedSession) -> None:
    """A calibration that found 0.4 % of bending, of which no sample knows."""
    straight = reduce_session(session)
    assert session.sensor is not None
    session.sensor = replace(session.sensor, linearity_error=0.004)
    bent = reduce_session(session)

    assert "u_linearity" not in straight
    relative = (bent["u_linearity"] / np.abs(bent["f_r"])).to_numpy()
    assert np.nanmax(np.abs(relative - 0.004 * np.sqrt(np.pi))) < 1e-12
    (line,) = [line for line in budget(bent) if line.name == "linearity of the sensor"]
    assert line.of_session == pytest.approx(0.004 * np.sqrt(np.pi), rel=1e-6)
    assert bool((bent["u_f_r"] >= straight["u_f_r"]).where(np.isfinite(bent["f_r"]), True).all())


def test_a_tilted_flat_field_leaves_no_trace(default_rig: Rig, tmp_path: Path) -> None:
    """A response that falls by a third across the frame: taken out within 0.1 %, pixel by pixel."""
    cols = np.linspace(-1.0, 1.0, default_rig.camera.width_px)[np.newaxis, :, np.newaxis]
    tables = []
    for name, flat in (("even", 1.0), ("tilted", 0.8 - 0.2 * cols)):
        (tmp_path / name).mkdir()
        studio = Studio(default_rig, tmp_path / name)
        studio.flat = flat
        studio.shoot("sample", 0, SAMPLE, POSES_DEG[0])
        studio.shoot("white", 0, WHITE, POSES_DEG[0])
        for index in range(2):
            studio.shoot("dark", index, None, POSES_DEG[0])
        tables.append(reduce_session(studio.session))

    ratio = (tables[1]["f_r"] / tables[0]["f_r"]).mean("channel").to_numpy()
    across = tables[0]["wo"].to_numpy()
    across = across[:, int(np.argmax(across.std(axis=0)))]
    slope, middle = np.polyfit(across - across.mean(), ratio, 1)

    assert middle == pytest.approx(1.0, abs=1e-3)
    assert abs(slope) * np.ptp(across) < 2e-3


def shot_with_trap(rig: Rig, folder: Path, floor: np.ndarray | float, traps: tuple[int, ...]) -> Studio:
    """Three poses in a room with stray light, the light trap at some of them."""
    folder.mkdir()
    studio = Studio(rig, folder)
    studio.floor = floor
    dark_paint = MODELS["lambert"](kd=(0.5, 0.5, 0.5))
    trap = MODELS["lambert"](kd=(rig.trap.rho,) * 3)
    for index, pose in enumerate(POSES_DEG):
        studio.shoot("sample", index, dark_paint, pose)
        studio.shoot("white", index, WHITE, pose)
        if index in traps:
            studio.shoot("trap", index, trap, pose)
    for index in range(2):
        studio.shoot("dark", index, None, POSES_DEG[0])
    return studio


def errors_of_poses(samples: xr.Dataset) -> np.ndarray:
    """Relative errors of the poses' means, all channels, of a paint of albedo 0.5."""
    relative = samples["f_r"].where(samples["flags"] == 0) * np.pi / 0.5 - 1.0
    return np.asarray(relative.groupby(samples["pose"]).mean("sample").mean("channel"))


def test_stray_light_is_taken_out_and_stated(default_rig: Rig, tmp_path: Path) -> None:
    """A floor of 1 % of the white, uneven and other at every pose: below 0.1 % with the light trap."""
    rows = np.linspace(-1.0, 1.0, default_rig.camera.height_px)[:, np.newaxis, np.newaxis]
    studio = shot_with_trap(default_rig, tmp_path / "s", 0.01 * (1.0 + 0.3 * rows), (0, 1, 2))
    left_in = reduce_session(studio.session, options=Options(without=(Correction.STRAY_LIGHT,)))
    corrected = reduce_session(studio.session)

    assert np.abs(errors_of_poses(left_in)).min() > 0.005
    assert np.abs(errors_of_poses(corrected)).max() < 0.001
    lines = {line.name: line for line in budget(corrected)}
    assert 0.0 < lines["stray light"].of_sample < 0.001
    assert lines["stray light"].correlation is Correlation.SESSION
    stated = {line.name: line for line in budget(left_in)}["stray light"].of_sample
    assert stated == pytest.approx(np.abs(errors_of_poses(left_in)).mean(), rel=0.3)
    assert left_in.attrs["option_without"] == "stray-light"


def test_stray_light_between_the_poses_of_the_trap(default_rig: Rig, tmp_path: Path) -> None:
    """The trap at two of three poses: the one between is corrected, and says that it is less certain."""
    studio = shot_with_trap(default_rig, tmp_path / "s", 0.01, (0, 2))
    samples = reduce_session(studio.session)

    errors = errors_of_poses(samples)
    u = (samples["u_stray"] / samples["f_r"]).groupby(samples["pose"]).median("sample").mean("channel")
    assert np.abs(errors[[0, 2]]).max() < 0.001
    assert float(u[1]) > 2.0 * float(u[[0, 2]].max())
    assert abs(errors[1]) < 2.0 * float(u[1])


def test_without_a_trap_nothing_is_claimed_of_stray_light(session: RecordedSession) -> None:
    """Would catch a column of noughts for an error that nobody measured."""
    samples = reduce_session(session)
    assert "u_stray" not in samples
    assert not any(line.name == "stray light" for line in budget(samples))


def test_a_flat_field_that_is_left_in_is_stated(default_rig: Rig, tmp_path: Path) -> None:
    """A tilted response: percents of error without the flat field, as stated; below 0.1 % with it."""
    cols = np.linspace(-1.0, 1.0, default_rig.camera.width_px)[np.newaxis, :, np.newaxis]
    studio = Studio(default_rig, tmp_path)
    studio.flat = 0.8 - 0.2 * cols
    paint = MODELS["lambert"](kd=(0.5, 0.5, 0.5))
    studio.shoot("sample", 0, paint, POSES_DEG[0])
    studio.shoot("white", 0, WHITE, POSES_DEG[0])
    for index in range(2):
        studio.shoot("dark", index, None, POSES_DEG[0])
    found = {}
    for without in ((), (Correction.FLAT_FIELD,)):
        samples = reduce_session(studio.session, options=Options(without=without))
        error = (samples["f_r"] * np.pi / 0.5 - 1.0).mean("channel").to_numpy()
        line = {line.name: line for line in budget(samples)}["flat field"]
        found[without] = (float(error.std()), float(abs(error.mean())), line)

    spread, middle, line = found[()]
    assert middle < 0.001
    assert line.of_sample == pytest.approx(default_rig.white.u_uniformity, rel=0.01)
    assert line.correlation is Correlation.CALIBRATION
    left_in, _, line = found[(Correction.FLAT_FIELD,)]
    assert left_in > 5.0 * spread
    assert line.of_sample == pytest.approx(left_in, rel=0.2)


def test_corrections_are_named_or_refused() -> None:
    """Would catch a correction that stays on because its name was mistyped."""
    assert corrections_named(["lamp-drift,flat-field", "flat-field"]) == (
        Correction.FLAT_FIELD,
        Correction.LAMP_DRIFT,
    )
    assert corrections_named([]) == ()
    with pytest.raises(BadInput, match=r"'straylight'.*flat-field, stray-light, lamp-drift"):
        corrections_named(["straylight"])


def test_a_bent_response_is_taken_out(default_rig: Rig, tmp_path: Path) -> None:
    """2 % short at full well: a per mille of error and more, as stated; below 0.1 % with its calibration."""
    studio = Studio(default_rig, tmp_path, bend=0.02)
    paint = MODELS["lambert"](kd=(0.2, 0.2, 0.2))
    studio.shoot("sample", 0, paint, POSES_DEG[0])
    studio.shoot("white", 0, WHITE, POSES_DEG[0])
    for index in range(2):
        studio.shoot("dark", index, None, POSES_DEG[0])
    errors, stated = {}, {}
    for without in ((), (Correction.LINEARITY,)):
        samples = reduce_session(studio.session, options=Options(without=without))
        errors[without] = float((samples["f_r"] * np.pi / 0.2 - 1.0).mean())
        stated[without] = {line.name: line for line in budget(samples)}["linearity of the sensor"].of_sample

    assert abs(errors[()]) < 0.001
    assert errors[(Correction.LINEARITY,)] > 0.003
    assert 0.0 < stated[()] < 0.0001
    assert stated[(Correction.LINEARITY,)] == pytest.approx(errors[(Correction.LINEARITY,)], rel=0.5)


@pytest.mark.parametrize(("ratio", "stated"), [(1.0002, None), (1.0063, 0.006 / np.sqrt(3.0))])
def test_drift_that_only_references_found_is_stated(
    session: RecordedSession, ratio: float, stated: float | None
) -> None:
    """Would catch samples that claim less than a reference has shown, or noise that is taken for drift."""
    detail = {"role": "white", "ratio": [ratio, 1.0], "u_ratio": [1e-4, 1e-4], "accepted": True}
    session.happened = [Event("2026-01-01T00:00:00.000Z", REFERENCE, detail)]
    samples = reduce_session(session)

    if stated is None:
        assert "u_drift" not in samples
        return
    relative = (samples["u_drift"] / np.abs(samples["f_r"])).to_numpy()
    assert np.nanmax(np.abs(relative - stated)) < 1e-9
    (line,) = [line for line in budget(samples) if line.name == "drift that references found"]
    assert line.correlation is Correlation.SESSION
    assert line.of_session == pytest.approx(stated, rel=1e-6)
