"""A room with stray light, from the plan to the samples: the light trap is shot, and takes it out."""

from __future__ import annotations

import json
import math
import shutil
from typing import TYPE_CHECKING

import numpy as np
import pytest

from analysis.budget import budget
from analysis.corrections import Correction
from analysis.measurement import Options
from analysis.reduce import reduce_session
from capture.plan import plan_from
from capture.records import PoseFlag
from capture.run import capture
from capture.session import Session
from rig.description import Camera, default_rig, dump_rig
from rig.surroundings import TwinLight
from simulator.twin import Twin

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

pytestmark = pytest.mark.render

ALBEDO, FLOOR = 0.5, 0.01
CONTENT = {
    "plan": {"name": "stray", "sample": "sample1"},
    "darks": {"count": 2},
    "trap": {"every": 2},
    "poses": [{"kind": "sweep", "theta_i_deg": [30], "theta_o_deg": [-45, 0, 15, 45]}],
}


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a session under a floor of 1 % of a perfect diffuser, with the trap at every other pose."""
    folder = tmp_path_factory.mktemp("stray")
    camera = Camera(serial="TWIN-0001", width_px=128, height_px=96, focal_length_px=800.0)
    dump_rig(default_rig(camera=camera, twin=TwinLight(stray_light=FLOOR)), folder / "rig.toml")
    materials = {"sample1": f"lambert:kd={ALBEDO}"}
    with Twin(materials, seed=3, speed=300.0, rig=folder / "rig.toml", log=False) as twin:
        assert capture(plan_from(CONTENT, "test"), twin.rig, folder / "s").complete
        shutil.copy(twin.folder / "truth.json", folder / "s")
    return folder / "s"


def worst_error(samples: xr.Dataset, session: Path) -> float:
    """Largest relative error of a pose's mean, all channels, without what the white's certificate errs by."""
    white = json.loads((session / "truth.json").read_text())["white"]["rho"] / default_rig().white.rho
    relative = samples["f_r"] * white * math.pi / ALBEDO - 1.0
    return float(np.abs(relative.groupby(samples["pose"]).mean("sample").mean("channel")).max())


def test_the_trap_is_shot_where_the_plan_says(session: Path) -> None:
    """Every other pose of the way and its last, as long as the longest frame of the pose, without a flag."""
    with Session.open(session) as opened:
        traps = opened.poses("trap")
        order = [visit.pose for visit in opened.journal.visits() if visit.role.value == "white"]
        samples = opened.poses("sample")
        longest = {each.index: max(frame.exposure_s for frame in each.frames) for each in samples}
        assert opened.complete()
    assert {record.index for record in traps} == {order[0], order[2], order[3]}
    assert {record.station for record in traps} == {"trap"}
    for record in traps:
        assert [frame.exposure_s for frame in record.frames] == [longest[record.index]]
        assert record.flags == PoseFlag(0)


def test_a_floor_of_one_per_cent_is_taken_out(session: Path) -> None:
    """About 1 % of error without the correction, below 0.1 % with it, at poses without a trap too."""
    with Session.open(session) as opened:
        plain = reduce_session(opened, options=Options(without=(Correction.STRAY_LIGHT,)))
        corrected = reduce_session(opened)

    assert worst_error(plain, session) > 0.007
    assert worst_error(corrected, session) < 0.001
    lines = {line.name: line for line in budget(corrected)}
    assert 0.0 < lines["stray light"].of_sample < 0.001
