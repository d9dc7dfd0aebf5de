"""The study of clearance, small: a figure that cannot miss its target, or a part that is not run."""

from __future__ import annotations

import numpy as np

from benchmarks import machine, machine_clearance
from benchmarks.clearance_dense import DenseClearance
from rig.clearance import Clearance
from rig.description import Clearance as Margin
from rig.description import default_rig


def test_a_hundred_moves_meet_every_target() -> None:
    """Catches accepted moves that come too near, and refused ones that do not."""
    counts, _ = machine_clearance._check_batch((1, 0, 100))
    blocked, accepted_near, refused_clear, got_round, legs_near, straight_refused = counts
    assert 10 < blocked < 90
    assert accepted_near == refused_clear == legs_near == straight_refused == 0
    assert got_round >= machine_clearance.DETOURS * blocked


def test_the_other_code_finds_what_is_wrong() -> None:
    """Catches a study that passes whatever clearance says: a smaller margin must show as moves too near."""
    wide = default_rig(clearance=Margin(margin_mm=60.0))
    narrow, dense = Clearance(default_rig()), DenseClearance(wide, cutoff_mm=61.0)
    start, end = machine_clearance._random_moves(narrow, 2, 0, 60)
    accepted = np.flatnonzero(narrow.moves(start, end).clear)
    near = [machine_clearance._comes_near(dense, start[move], end[move], 60.0) for move in accepted]
    assert sum(near) > 2


def test_the_study_is_part_of_the_machine_s() -> None:
    """Catches a part that nobody runs."""
    assert "machine_clearance" in machine.PARTS
