"""Captures on the twin: poses, frames, documents, faults that pass and that stay, no wheel."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from capture.journal import Journal
from capture.policy import POLICY
from capture.raw import read_raw
from capture.run import capture, resume
from capture.session import Session
from capture.wishes import Wishes
from rig.description import dump_rig, load_rig
from rig.errors import DeviceLost, GonioError, Refused, Transient, Unsafe
from rig.kinematics import Kinematics
from rig.machine import Machine
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Callable

    from capture.plan import Plan


ROOT = Path(__file__).parents[2]
MATERIAL = "cook-torrance:kd=0.1,ks=0.5,m=0.2,ior=1.5"
"""What the twin of these tests holds."""


def facts_of(session: Path) -> dict[str, Any]:
    """Return all of a session that must not depend on how often it was interrupted."""
    with Journal(session / "journal.db", read_only=True) as journal:
        shots = [(s.shot_id, s.visit, s.frame, s.exposure_s, s.path, s.sha256) for s in journal.shots()]
        statistics = [s.statistics for s in journal.shots()]
        return {"visits": journal.visits(), "shots": shots, "statistics": statistics}


def test_a_session_holds_every_pose_once(reference: Path) -> None:
    """Would catch a pose forgotten, doubled, or recorded where the arms were not."""
    with Session.open(reference) as session:
        assert session.complete()
        assert session.damaged() == []
        kinematics = Kinematics(session.rig)
        planned = {pose.index: pose for pose in session.planned()}
        assert [pose.refused is None for pose in planned.values()] == [False, True, True]
        for role in ("sample", "white"):
            records = session.poses(role)
            assert [record.index for record in records] == [1, 2]
            for record in records:
                wi, wo = kinematics.directions(record.angles_rad)
                np.testing.assert_allclose(wi, planned[record.index].wi, atol=2e-3)
                np.testing.assert_allclose(wo, planned[record.index].wo, atol=2e-3)
                assert all(frame.lit for frame in record.frames)
        used = [
            frame.exposure_s
            for role in ("sample", "white")
            for p in session.poses(role)
            for frame in p.frames
        ]
        darks = session.poses("dark")
        assert [dark.frames[0].exposure_s for dark in darks] == [min(used), max(used)]
        assert not any(frame.lit for dark in darks for frame in dark.frames)


def test_frames_are_what_their_rows_say(reference: Path) -> None:
    """Would catch frames filed under another shot's name: white and sample exchanged."""
    with Session.open(reference) as session:
        records = session.poses()
        for record, frame in ((r, f) for r in records for f in r.frames):
            raw = read_raw(frame.path)
            assert raw.shot_id == frame.shot_id
            assert raw.exposure_s == frame.exposure_s
            assert raw.lit == frame.lit
            assert f"-{record.role}-{record.index:04d}-" in frame.shot_id


def test_bright_parts_are_well_exposed(reference: Path) -> None:
    """Would catch exposures chosen from something else than what the sensor saw."""
    with Session.open(reference) as session:
        for record in session.poses("sample") + session.poses("white"):
            shown = [
                s.statistics
                for s in session.journal.shots()
                if s.shot_id in {f.shot_id for f in record.frames}
            ]
            clear = [s.brightness for s in shown if s is not None and s.clipped_fraction <= 0.002]
            assert record.flags == 0
            assert max(clear) >= 0.1


def test_documents_tell_runs_and_readings(reference: Path) -> None:
    """Would catch an engine whose documents are lost, without units, or without the poses."""
    lines = [json.loads(line) for line in (reference / "documents.jsonl").read_text().splitlines()]
    starts = [document for name, document in lines if name == "start"]
    stops = [document for name, document in lines if name == "stop"]
    assert [start["role"] for start in starts] == ["white", "sample", "dark"]
    assert {start["plan_name"] for start in starts} == {"brass"}
    assert [stop["exit_status"] for stop in stops] == ["success"] * 3
    descriptor = next(document for name, document in lines if name == "descriptor")
    assert descriptor["data_keys"]["arms_light_elevation_deg"]["units"] == "deg"
    events = [document["data"]["camera_shot_id"] for name, document in lines if name == "event"]
    with Session.open(reference) as session:
        assert events == [shot.shot_id for shot in session.journal.shots()]


def test_a_passing_fault_is_shot_again_under_its_own_name(
    twin: Twin,
    reference: Path,
    tmp_path: Path,
    make_plan: Callable[..., Plan],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Would catch a night that ends at the first late file, or a shot that changes its name on the way."""
    real, calls = Machine.shoot, 0

    def shoot(self: Machine, *args: Any, **options: Any) -> Path:
        nonlocal calls
        calls += 1
        if calls in {2, 3}:
            raise Transient("its picture did not arrive", where="test", todo="shoot again")
        return real(self, *args, **options)

    monkeypatch.setattr(Machine, "shoot", shoot)
    assert capture(make_plan(), twin.rig, tmp_path / "s").complete
    assert facts_of(tmp_path / "s") == facts_of(reference)
    with Session.open(tmp_path / "s") as session:
        assert [event.kind for event in session.events()].count("retry") == 2


def test_a_foreign_file_is_set_aside_and_told(
    twin: Twin,
    reference: Path,
    tmp_path: Path,
    make_plan: Callable[..., Plan],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Would catch somebody else's picture that is taken for a frame, or that stops the night."""
    with Session.open(reference) as session:
        other = session.poses("sample")[0].frames[0].path.read_bytes()
    real, calls = Machine.shoot, 0

    def shoot(self: Machine, *args: Any, **options: Any) -> Path:
        nonlocal calls
        calls += 1
        if calls == 2:
            # Its file arrives between the trigger and the picture waited for.
            mark = self.camera.mark

            def marked() -> Any:
                seen = mark()
                (self.camera.folder / "foreign.dng").write_bytes(other)
                (self.camera.folder / "torn.dng").write_bytes(other[: len(other) // 2])
                time.sleep(0.2)
                return seen

            self.camera.mark = marked  # type: ignore[method-assign]
        path = real(self, *args, **options)
        self.camera.__dict__.pop("mark", None)
        return path

    monkeypatch.setattr(Machine, "shoot", shoot)
    out = tmp_path / "s"
    assert capture(make_plan(), twin.rig, out).complete
    assert facts_of(out) == facts_of(reference)
    kept = {file.name: file.read_bytes() for file in (out / "frames" / "stray").iterdir()}
    assert kept["foreign.dng"] == other
    with Session.open(out) as session:
        reasons = {
            event.detail["file"]: event.detail["reason"]
            for event in session.events()
            if event.kind == "stray"
        }
    assert "of shot" in reasons["foreign.dng"]
    assert reasons["torn.dng"]
    assert not [file for file in kept if file not in {"foreign.dng", "torn.dng"}]


@pytest.mark.parametrize("mode", ["LAMP", "WIDTH"])
def test_other_ways_of_timing_an_exposure(tmp_path: Path, make_plan: Callable[..., Plan], mode: str) -> None:
    """Would catch frames refused as strays because the shutter was open longer than the light was on."""
    from rig.description import default_rig

    rig = default_rig(folder=tmp_path)
    changed = rig.model_copy(update={"lamp": rig.lamp.model_copy(update={"mode": mode})})
    dump_rig(changed, tmp_path / "machine.toml")
    with Twin({"sample1": "lambert:kd=0.5"}, rig=tmp_path / "machine.toml", speed=200.0) as twin:
        result = capture(make_plan(), twin.rig, tmp_path / "s")
    assert result.complete
    with Session.open(tmp_path / "s") as session:
        for record in session.poses():
            for frame in record.frames:
                raw = read_raw(frame.path)
                assert raw.exposure_s == frame.exposure_s
                assert raw.lit == frame.lit
                assert raw.shutter_s is not None
                assert (raw.shutter_s > frame.exposure_s) == (mode == "LAMP")


def test_a_fault_that_stays_everywhere_ends_the_run_and_says_how_to_go_on(
    twin: Twin, tmp_path: Path, make_plan: Callable[..., Plan], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch a loop that shoots for ever, and an error that leaves the person without the next step."""
    shots: list[str] = []

    def shoot(_self: Machine, shot_id: str, *_args: Any, **_options: Any) -> Path:
        shots.append(shot_id)
        raise Transient("its picture did not arrive", where="test", todo="shoot again")

    monkeypatch.setattr(Machine, "shoot", shoot)
    with pytest.raises(Transient, match=r"did not arrive.*gonio capture --resume .*s$"):
        capture(make_plan(), twin.rig, tmp_path / "s")
    assert len(shots) == 9  # three poses, three times each
    with Session.open(tmp_path / "s") as session:
        kinds = [event.kind for event in session.events()]
        assert kinds.count("retry") == 6
        assert kinds.count("skipped") == 2
        assert kinds[-2:] == ["failed", "stopped"]


@pytest.mark.parametrize(
    ("failures", "whole"), [(3, True), (6, False)], ids=["had at the end of the pass", "missing"]
)
def test_a_pose_that_cannot_be_had_is_skipped_with_its_reason(  # noqa: PLR0917 - fixtures
    twin: Twin,
    reference: Path,
    tmp_path: Path,
    make_plan: Callable[..., Plan],
    monkeypatch: pytest.MonkeyPatch,
    failures: int,
    whole: bool,
) -> None:
    """Would catch one bad pose that ends the night, is never tried again, or is missing in silence."""
    real, left, order = Machine.shoot, iter(range(failures)), []

    def shoot(self: Machine, shot_id: str, *args: Any, **options: Any) -> Path:
        order.append(shot_id.split("-", 1)[1])
        if order[-1] == "sample-0002-1" and next(left, None) is not None:
            raise Transient("its picture did not arrive", where="test", todo="shoot again")
        return real(self, shot_id, *args, **options)

    said: list[str] = []
    with monkeypatch.context() as patch:
        patch.setattr(Machine, "shoot", shoot)
        result = capture(make_plan(), twin.rig, tmp_path / "s", wishes=Wishes(say=said.append))
    assert result.complete == whole
    sample = [shot for shot in order if shot.startswith("sample")]
    assert sample[:4] == ["sample-0002-1"] * 3 + ["sample-0001-1"]
    assert sample[-1].startswith("sample-0002")
    assert order[-1].startswith("dark")
    assert "sample 2 is skipped: test: its picture did not arrive; shoot again" in said
    with Session.open(tmp_path / "s") as session:
        last = [event for event in session.events() if event.kind in {"finished", "incomplete"}]
        assert session.damaged() == []
    if whole:
        assert result.holes == ()
        assert [event.kind for event in last] == ["finished"]
        return
    (hole,) = result.holes
    assert (hole.role, hole.pose, hole.times) == ("sample", 2, 2)
    assert "did not arrive" in hole.reason
    assert [event.detail for event in last] == [{"holes": [hole.as_dict()]}]
    again = resume(tmp_path / "s")
    assert again.complete
    assert again.holes == ()


def test_a_fault_that_cannot_pass_skips_nothing(
    twin: Twin, tmp_path: Path, make_plan: Callable[..., Plan], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Would catch a run that goes on with an open door or a lost camera."""
    for error in (Unsafe, DeviceLost, Refused):

        def shoot(self: Machine, *_args: Any, error: type[GonioError] = error, **_options: Any) -> Path:
            raise error("no more", where="test", todo="see")

        monkeypatch.setattr(Machine, "shoot", shoot)
        with pytest.raises(error, match="no more"):
            capture(make_plan(), twin.rig, tmp_path / error.__name__)
        with Session.open(tmp_path / error.__name__) as session:
            assert not {"retry", "skipped"} & {event.kind for event in session.events()}


def test_the_fault_table_of_the_docs_is_the_program_s() -> None:
    """Would catch docs that promise another policy than the program's, or a proof that is no longer there."""
    page = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")
    for rule in POLICY:
        cells = (f"{rule.name} (`{rule.kind.__name__}`)", rule.examples, str(rule.tries), rule.then.value)
        assert f"| {' | '.join(cells)} | `test" in page
    assert {rule.kind for rule in POLICY} == set(GonioError.__subclasses__())
    proofs = re.findall(r"(test_\w+\.py)::(test_\w+)", page)
    assert len(proofs) >= 2 * len(POLICY)
    for file, name in proofs:
        texts = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob(file)]
        assert any(f"def {name}(" in text for text in texts), f"{file}::{name}"


def test_finishing_ends_after_the_frame_and_resumes(
    twin: Twin, reference: Path, tmp_path: Path, make_plan: Callable[..., Plan]
) -> None:
    """Would catch a first Ctrl-C that waits for the end of the pass, or loses the frame under way."""

    class AfterFirstFrame:
        finish_requested = abort_requested = False

        def on_abort(self, callback: Callable[[], object]) -> None:
            del callback

    controls = AfterFirstFrame()
    out = tmp_path / "s"

    def stop_now(*_args: object) -> None:
        controls.finish_requested = True

    first = capture(make_plan(), twin.rig, out, wishes=Wishes(controls=controls, progress=stop_now))
    assert not first.complete
    assert first.stop is not None
    assert first.stop.outcome.value == "confirmed"
    assert resume(out).complete
    assert facts_of(out) == facts_of(reference)


def test_a_ctrl_c_that_nobody_handles_stops_within_the_exposure(
    tmp_path: Path, make_plan: Callable[..., Plan]
) -> None:
    """Would catch a script's Ctrl-C that the engine swallows, or that waits for the end of an exposure."""
    plan = make_plan(exposure={"first_s": 60.0})
    out = tmp_path / "s"
    with Twin({"sample1": "lambert:kd=0.5"}, speed=3.0) as twin:

        def interrupt() -> None:
            while not any(event.get("event") == "shutter" for event in twin.wire_log()):
                time.sleep(0.01)
            os.kill(os.getpid(), signal.SIGINT)

        watcher = threading.Thread(target=interrupt)
        watcher.start()
        with pytest.raises(KeyboardInterrupt):
            capture(plan, twin.rig, out)
        watcher.join()
        assert not any(event.get("event") == "exposed" for event in twin.wire_log())
        assert not [event["on"] for event in twin.wire_log() if event.get("event") == "light"][-1]
    with Session.open(out) as session:
        assert [event.kind for event in session.events()][-2:] == ["interrupted", "stopped"]


def test_resume_refuses_another_plan_machine_or_calibration(
    twin: Twin, reference: Path, tmp_path: Path, make_plan: Callable[..., Plan]
) -> None:
    """Would catch frames of two machines in one session."""
    from capture.plan import dump_plan

    dump_plan(make_plan(darks={"count": 9}), tmp_path / "other.toml")
    with pytest.raises(Refused, match="not the session's plan"):
        resume(reference, plan=tmp_path / "other.toml")
    rig = load_rig(twin.rig)
    lamp = rig.lamp.model_copy(update={"distance_mm": 501.0})
    dump_rig(rig.model_copy(update={"lamp": lamp}), tmp_path / "moved.toml")
    with pytest.raises(Refused, match="description has changed"):
        resume(reference, rig=tmp_path / "moved.toml")
    dump_rig(rig, tmp_path / "rig.toml")
    with pytest.raises(Refused, match=r"calibration has changed.*sensor\.toml"):
        resume(reference, rig=tmp_path / "rig.toml")
    with pytest.raises(Refused, match="--rig"):
        resume(reference, rig=tmp_path / "gone.toml")


def test_resume_refuses_other_exposure_times(reference: Path, tmp_path: Path) -> None:
    """Would catch a newer gonio that goes on with exposures the session's other poses never had."""
    session = shutil.copytree(reference, tmp_path / "s")
    facts = json.loads((session / "session.json").read_text())
    assert len(facts["exposures_s"]) > 10
    facts["exposures_s"][3] *= 1.1
    (session / "session.json").write_text(json.dumps(facts))
    with pytest.raises(Refused, match="other times"):
        resume(session)


def test_the_same_machine_on_other_ports_goes_on(
    twin: Twin, reference: Path, tmp_path: Path, make_plan: Callable[..., Plan]
) -> None:
    """Would catch a replugged adapter, or a moved rig file, taken for another machine."""
    out = tmp_path / "s"

    class AfterThree:
        finish_requested = abort_requested = False

        def on_abort(self, callback: Callable[[], object]) -> None:
            del callback

        def count(self, done: int, _total: int, _note: str) -> None:
            self.finish_requested = done >= 3

    controls = AfterThree()
    capture(make_plan(), twin.rig, out, wishes=Wishes(controls=controls, progress=controls.count))
    with Twin({"sample1": MATERIAL}, seed=7, speed=200.0) as other:
        assert other.servos != twin.servos
        assert resume(out, rig=other.rig).complete
    assert facts_of(out) == facts_of(reference)


def test_resuming_a_complete_session_shoots_nothing(twin: Twin, reference: Path) -> None:
    """Would catch a second set of darks."""
    before, shots = facts_of(reference), len(twin.wire_log())
    assert resume(reference).complete
    assert facts_of(reference) == before
    assert not [event for event in twin.wire_log()[shots:] if event.get("event") == "exposed"]


def test_another_camera_is_refused(
    twin: Twin, reference: Path, make_plan: Callable[..., Plan], tmp_path: Path
) -> None:
    """Would catch a session whose frames come from two cameras, where the rig file names none."""
    out = tmp_path / "s"
    calls = iter([False, True])

    class Once:
        abort_requested = False

        @property
        def finish_requested(self) -> bool:
            return next(calls, True)

        def on_abort(self, callback: Callable[[], object]) -> None:
            del callback

    capture(make_plan(), twin.rig, out, wishes=Wishes(controls=Once()))
    journal = Journal(out / "journal.db")
    with journal._change() as change:
        change.execute(
            "UPDATE events SET detail = ? WHERE kind = 'camera'",
            (json.dumps({"serial": "X1", "model": "other"}),),
        )
    journal.close()
    with pytest.raises(Refused, match="of camera TWIN-0001"):
        resume(out)


def test_a_machine_without_a_wheel_asks_between_passes(
    tmp_path: Path, make_plan: Callable[..., Plan]
) -> None:
    """Would catch a white pass over the sample: nobody was asked, or the light burned while he mounted."""
    from rig.description import default_rig

    rig = default_rig(folder=tmp_path)
    bare = default_rig(
        folder=tmp_path,
        joints=tuple(joint for joint in rig.joints if joint.name != "station_wheel"),
        arms=rig.arms.model_copy(update={"station": ()}),
        stations={},
    )
    dump_rig(bare, tmp_path / "bare.toml")
    plan = make_plan(plan={"name": "velvet", "sample": "velvet"})
    with Twin({"sample": "lambert:kd=0.5"}, rig=tmp_path / "bare.toml", speed=200.0, folder=tmp_path) as twin:
        asked: list[tuple[str, bool]] = []

        def mount(role: str, _label: str) -> bool:
            lights = [event["on"] for event in twin.wire_log() if event.get("event") == "light"]
            asked.append((role, bool(lights and lights[-1])))
            return role != "sample"

        with pytest.raises(Refused, match="--mounted white"):
            capture(plan, twin.rig, tmp_path / "nobody")
        result = capture(plan, twin.rig, tmp_path / "s", wishes=Wishes(mount=mount))
        assert asked == [("white", False), ("sample", False)]
        assert not result.complete
        assert resume(tmp_path / "s", wishes=Wishes(mounted={"sample"})).complete
        with Session.open(tmp_path / "s") as session:
            assert [p.station for p in session.poses()] == [None] * 6
