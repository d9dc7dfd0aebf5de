"""A capture with the sensor's calibration of another camera, or of years ago, without a word."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from capture.run import capture
from capture.sensor import load_sensor, save_sensor
from capture.wishes import Wishes
from rig.errors import Refused
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Callable

    from capture.plan import Plan

pytestmark = pytest.mark.render

ONE_POSE = [{"kind": "sweep", "theta_i_deg": [30], "theta_o_deg": [0]}]


def test_capture_checks_camera_age_and_temperature(tmp_path: Path, make_plan: Callable[..., Plan]) -> None:
    """Refused before anything moves; doubts told, one line each; a fresh calibration told nothing of."""
    plan = make_plan(poses=ONE_POSE, darks={"count": 0})
    lines: list[str] = []
    wishes = Wishes(say=lines.append)
    with Twin({"sample1": "lambert:kd=0.5"}, seed=2, speed=500.0, log=False) as twin:
        file = Path(twin.rig).parent / "calibration" / "sensor.toml"
        right = load_sensor(file)

        save_sensor(replace(right, camera_serial="ANOTHER"), file)
        with pytest.raises(Refused, match="camera ANOTHER, in use is TWIN"):
            capture(plan, twin.rig, tmp_path / "refused", wishes=wishes)
        assert not (tmp_path / "refused").exists()

        save_sensor(replace(right, date="2001-01-01", lamp_temperature_deg_c=-40.0), file)
        assert capture(plan, twin.rig, tmp_path / "old", wishes=wishes).complete
        doubts = [line for line in lines if "calibration" in line]
        assert len(doubts) == 2
        assert "days old" in doubts[0]
        assert " K off" in doubts[1]

        lines.clear()
        save_sensor(right, file)
        assert capture(plan, twin.rig, tmp_path / "right", wishes=wishes).complete
        assert not [line for line in lines if "calibration" in line]
