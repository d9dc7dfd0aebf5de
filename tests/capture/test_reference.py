"""A session that goes on shoots its reference poses again: the same machine passes, another does not."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

from capture.comparison import Step
from capture.interruptions import REFERENCE
from capture.run import capture, resume
from capture.session import Session, hash_file
from capture.wishes import Wishes
from rig.errors import Refused
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


MATERIAL = "cook-torrance:kd=0.1,ks=0.5,m=0.2,ior=1.5"


class AfterMost:
    """Ends a capture before the last pose of the sample."""

    finish_requested = abort_requested = False

    def on_abort(self, callback: Callable[[], object]) -> None:
        del callback

    def count(self, done: int, total: int, _note: str) -> None:
        self.finish_requested = done == total - 3


@pytest.fixture(scope="module")
def begun(twin: Twin, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a session that was interrupted in its second pass."""
    from capture.plan import plan_from

    content = {
        "plan": {"name": "brass", "sample": "sample1"},
        "darks": {"count": 1},
        "poses": [{"kind": "sweep", "theta_i_deg": [30], "theta_o_deg": [0, 15, 45]}],
    }
    controls = AfterMost()
    out = tmp_path_factory.mktemp("begun") / "s"
    wishes = Wishes(controls=controls, progress=controls.count)
    capture(plan_from(content, "test"), twin.rig, out, wishes=wishes)
    return out


@pytest.fixture
def session(begun: Path, tmp_path: Path) -> Path:
    """Return a copy of it."""
    return shutil.copytree(begun, tmp_path / "s")


def test_the_same_machine_passes_and_its_guard_frames_stay_apart(session: Path) -> None:
    """Would catch a guard that refuses noise, or whose frames end among the samples'."""
    said: list[str] = []
    assert resume(session, wishes=Wishes(say=said.append)).complete
    with Session.open(session) as opened:
        events = [event.detail for event in opened.events() if event.kind == REFERENCE]
        names = {frame.path.name for pose in opened.poses(complete=False) for frame in pose.frames}
        shots = [shot.shot_id for shot in opened.journal.shots()]
    assert [event["role"] for event in events] == ["white", "sample"]
    assert len(said) == len(events)
    for event in events:
        assert event["accepted"]
        assert event["why"] == "resumed"
        assert len(event["ratio"]) == 3
        for ratio, u in zip(event["ratio"], event["u_ratio"], strict=True):
            assert 0.0 < u < 0.005
            assert abs(ratio - 1.0) < 5.0 * u
        for file in event["files"]:
            assert hash_file(session / file["path"]) == file["sha256"]
            assert file["path"].rsplit("/", 1)[1] not in names
    assert not [shot for shot in shots if "guard" in shot]
    assert {path.name for path in (session / "frames").glob("*.dng")} == names


@pytest.mark.parametrize(
    ("spec", "changed"), [("lambert:kd=0.5", "sample"), (MATERIAL, "")], ids=["another sample", "the same"]
)
def test_a_sample_that_was_exchanged_is_refused(session: Path, spec: str, changed: str) -> None:
    """Would catch a night that goes on with another sample, a nudged lamp or another aperture."""
    with Session.open(session) as opened:
        done = len(opened.poses())
    with Twin({"sample1": spec}, seed=7, speed=200.0) as other:
        if not changed:
            assert resume(session, rig=other.rig).complete
            return
        with pytest.raises(Refused, match=r"reference pose, sample \d, has changed.*--reference-tolerance"):
            resume(session, rig=other.rig)
        with Session.open(session) as opened:
            assert len(opened.poses()) == done
            last = [event.detail for event in opened.events() if event.kind == REFERENCE][-1]
            assert not last["accepted"]
        assert resume(session, rig=other.rig, reference_tolerance=2.0).complete


def test_a_step_counts_when_it_exceeds_the_tolerance_beyond_its_noise() -> None:
    """Would catch noise that is taken for a step, and a step that hides behind one good channel."""
    step = Step(("R", "G", "B"), (1.03, 1.012, 0.985), (0.02, 0.0005, 0.001))
    assert step.beyond(0.01) == ("G", "B")
    assert step.beyond(0.02) == ()
    assert step.told() == "R 1.0300 +- 0.0200, G 1.0120 +- 0.0005, B 0.9850 +- 0.0010"
