"""What a person is told of a capture that did not go straight: exit code, lines, JSON, the report's facts."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

import capture.run
from capture.interruptions import Hole
from capture.journal import Journal
from capture.records import LevelsRecord, PlannedPose, PoseFlag, Role, Visit
from capture.wishes import CaptureResult
from gonio import cli
from gonio.page import interruption_facts

if TYPE_CHECKING:
    from pathlib import Path

HOLE = Hole(Role.SAMPLE, 7, 2, "shot x: its picture did not arrive; shoot again")


def result(session: Path, holes: tuple[Hole, ...], *, complete: bool = False) -> CaptureResult:
    """Return how a capture ended."""
    return CaptureResult(session, complete, 9, 20, 0, 0, 1.0, None, holes)


@pytest.mark.parametrize(("holes", "complete", "code"), [((HOLE,), False, 4), ((), False, 3), ((), True, 0)])
def test_missing_poses_are_told_with_their_reasons(  # noqa: PLR0917 - fixtures
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    holes: tuple[Hole, ...],
    complete: bool,
    code: int,
) -> None:
    """Would catch a night with holes that ends like one without, for a person or for a script."""
    asked: dict[str, Any] = {}

    def resumed(session: Path, **options: Any) -> CaptureResult:
        asked.update(options)
        return result(session, holes, complete=complete)

    monkeypatch.setattr(capture.run, "resume", resumed)
    arguments = ["capture", "--resume", str(tmp_path), "--reference-tolerance", "0.05", "--json"]
    assert cli.main(arguments) == code
    told = capsys.readouterr()
    assert asked["reference_tolerance"] == 0.05
    assert json.loads(told.out)["holes"] == [hole.as_dict() for hole in holes]
    assert ("sample 7 is missing, tried 2 times: shot x: its picture did not arrive" in told.err) == bool(
        holes
    )
    assert (f"go on with: gonio capture --resume {tmp_path}" in told.err) == (not complete)


@pytest.mark.parametrize("value", ["0", "-1", "nan"])
def test_a_tolerance_that_means_nothing_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], value: str
) -> None:
    """Would catch a guard that refuses everything, or nothing."""
    assert cli.main(["capture", "--resume", str(tmp_path), f"--reference-tolerance={value}"]) == 2
    assert "--reference-tolerance" in capsys.readouterr().err


def test_the_report_tells_what_did_not_go_straight(tmp_path: Path) -> None:
    """Would catch a page that looks the same after a night of interruptions and after a quiet one."""
    poses = [PlannedPose(0, (0.0, 0.0, 1.0), (0.0, 0.6, 0.8), (0.1, 0.2))]
    visits = [Visit(0, Role.WHITE, 0, "white", (0.1, 0.2)), Visit(1, Role.SAMPLE, 0, "sample1", (0.1, 0.2))]
    with Journal.create(tmp_path / "journal.db", poses, visits) as journal:
        session: Any = SimpleNamespace(journal=journal, events=journal.events)
        assert interruption_facts(session) == {"Interruptions": "none"}
        journal.note("retry", shot_id="a")
        journal.note("retry", shot_id="b")
        journal.note("paused", levels=[])
        journal.note("reference", ratio=[1.001, 0.996, 1.0], accepted=True)
        journal.note("skipped", visit=1, role="sample", pose=0, error="no picture")
        journal.note("skipped", visit=0, role="white", pose=0, error="had later")
        journal.finish(0, PoseFlag(0))
        for drift in (1.0, 0.98):
            journal.log_levels(LevelsRecord(0, (40.0,), (12.0,), (None,), (0.1,), 30.0, drift, drift))
        assert interruption_facts(session) == {
            "Interruptions": "shots made again: 2, poses skipped: 2, pauses: 1",
            "Reference poses": "shot again 1 times, light within 0.40% of what it was",
            "Missing poses": "sample 0 (no picture)",
            "Lamp": "within 2.00% of the first pose, by its monitor",
        }
