"""Levels that leave their band on the twin: pause, dark and parked, reference pose, and on."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from capture import pause
from capture.interruptions import REFERENCE, interruptions
from capture.journal import Journal
from capture.run import capture, resume
from capture.session import Session
from capture.wishes import Wishes
from rig.description import Supervision, dump_rig, load_rig
from rig.errors import Unsafe
from rig.machine import Machine

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from capture.plan import Plan
    from rig.supervision import Levels
    from simulator.twin import Twin


def facts_of(session: Path) -> Any:
    """Return all of a session that must not depend on pauses."""
    with Journal(session / "journal.db", read_only=True) as journal:
        shots = [(s.shot_id, s.exposure_s, s.path, s.sha256, s.statistics) for s in journal.shots()]
        return journal.visits(), shots


@pytest.fixture
def fever(monkeypatch: pytest.MonkeyPatch) -> Callable[[range, str, float], list[Levels]]:
    """Return what changes a level of the turntable at some looks; it collects what was looked at."""

    def ail(when: range, field: str, value: float) -> list[Levels]:
        real, looks = Machine.levels, []

        def levels(self: Machine) -> Levels:
            found = real(self)
            if len(looks) in when:
                servos = list(found.servos)
                servos[3] = replace(servos[3], **{field: value})
                found = replace(found, servos=tuple(servos))
            looks.append(found)
            return found

        monkeypatch.setattr(Machine, "levels", levels)
        return looks

    monkeypatch.setattr(pause, "LOOK_S", 0.01)
    return ail


@pytest.mark.parametrize("first", [0, 1, 6], ids=["from the start", "after a frame", "in the second pass"])
def test_a_hot_servo_pauses_the_capture_and_leaves_no_trace_in_the_data(  # noqa: PLR0917 - fixtures
    twin: Twin,
    reference: Path,
    tmp_path: Path,
    make_plan: Callable[..., Plan],
    fever: Callable[..., list[Levels]],
    monkeypatch: pytest.MonkeyPatch,
    first: int,
) -> None:
    """Would catch a level reached before the start that nobody sees, a pause that loses frames."""
    fever(range(first, first + 4), "temperature_deg_c", 71.0)
    moves: list[Any] = []
    real, darken = Machine.move, Machine.darken
    monkeypatch.setattr(Machine, "darken", lambda self: (moves.append("dark"), darken(self))[1])
    monkeypatch.setattr(Machine, "move", lambda self, *args: (moves.append(args), real(self, *args))[1])
    said: list[str] = []
    out = tmp_path / "s"
    assert capture(make_plan(), twin.rig, out, wishes=Wishes(say=said.append)).complete
    assert facts_of(out) == facts_of(reference)
    at = moves.index("dark")
    parked = [joint.park_deg for joint in load_rig(twin.rig).arm_joints]
    assert list(moves[at + 1][0]) == pytest.approx([angle * 3.14159265 / 180.0 for angle in parked])
    assert "pause: turntable temperature 71 deg C, allowed up to 70" in said
    with Session.open(out) as session:
        kinds = [event.kind for event in session.events()]
        (paused,) = (event.detail for event in session.events() if event.kind == "paused")
        assert interruptions(session.journal)["paused"] == 1
    assert kinds.index("settled") == kinds.index("paused") + 1
    assert (kinds[kinds.index("settled") + 1] == REFERENCE) == (first == 6)
    assert (paused["levels"][0]["joint"], paused["levels"][0]["value"]) == ("turntable", 71.0)


def test_a_weak_supply_moves_nothing_until_it_is_back(
    twin: Twin,
    tmp_path: Path,
    make_plan: Callable[..., Plan],
    fever: Callable[..., list[Levels]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Would catch arms that are parked while their supply gives way."""
    looks, moved_at, real = fever(range(3), "voltage_v", 9.0), [], Machine.move
    monkeypatch.setattr(
        Machine, "move", lambda self, *args: (moved_at.append(len(looks)), real(self, *args))[1]
    )
    assert capture(make_plan(), twin.rig, tmp_path / "s").complete
    assert moved_at[0] == 4
    with Session.open(tmp_path / "s") as session:
        assert [event.kind for event in session.events()].count("settled") == 1


def test_a_level_that_does_not_settle_ends_the_run_safely(
    twin: Twin, tmp_path: Path, make_plan: Callable[..., Plan], fever: Callable[..., list[Levels]]
) -> None:
    """Would catch a pause without an end, and a run that goes on hot."""
    fever(range(5, 10_000), "load", 0.95)
    rig = load_rig(twin.rig)
    hasty = rig.model_copy(update={"supervision": Supervision(settle_s=0.05)})
    dump_rig(hasty, tmp_path / "rig.toml")
    with pytest.raises(Unsafe, match=r"did not settle in 0.05 s: turntable load 0.95.*--resume"):
        capture(make_plan(), load_rig(tmp_path / "rig.toml"), tmp_path / "s", rig_file=tmp_path / "rig.toml")
    with Session.open(tmp_path / "s") as session:
        kinds = [event.kind for event in session.events()]
        assert "settled" not in kinds
        assert kinds[-2:] == ["failed", "stopped"]
        assert not session.complete()


def test_levels_are_logged_with_each_pose(reference: Path) -> None:
    """Would catch a log of some servos only, or a drift that is not relative to the first pose."""
    with Session.open(reference) as session:
        rows, visits = session.journal.levels(), session.journal.visits()
        joints = len(session.rig.joints)
    assert [row.visit for row in rows] == [visit.number for visit in visits]
    lit = [visit.role != "dark" for visit in visits]
    for row, light in zip(rows, lit, strict=True):
        assert {len(row.temperature_deg_c), len(row.voltage_v), len(row.current_ma), len(row.load)} == {
            joints
        }
        assert all(9.0 < volts < 15.0 for volts in row.voltage_v)
        assert (row.lamp_output is not None) == light
        assert row.lamp_deg_c is not None
    assert rows[0].lamp_drift == 1.0
    assert all(abs(row.lamp_drift - 1.0) < 0.02 for row in rows if row.lamp_drift is not None)


def test_a_session_from_before_the_log_is_read_and_goes_on(reference: Path, tmp_path: Path) -> None:
    """Would catch older sessions that can no longer be opened."""
    import shutil

    old = shutil.copytree(reference, tmp_path / "s")
    with Journal(old / "journal.db") as journal:
        journal._connection.execute("DROP TABLE levels")
    with Session.open(old) as session:
        assert session.journal.levels() == []
    assert resume(old).complete
    with Session.open(old) as session:
        assert session.journal.levels() == []
