"""A lamp that drifts by percents over a session: left in f_r, or taken out and not stated."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from analysis.budget import budget
from analysis.corrections import Correction
from analysis.measurement import Options
from analysis.reduce import reduce_session
from capture.plan import plan_from
from capture.run import capture
from capture.session import Session
from simulator.twin import Twin

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

pytestmark = pytest.mark.render

ALBEDO = 0.5
DRIFT, EXPOSURES = 0.08, 16


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a session under a lamp that loses 5 % and more within it, a little with each exposure."""
    folder = tmp_path_factory.mktemp("drift")
    (folder / "faults.toml").write_text(
        "".join(
            f'[[fault]]\nkind = "lamp-drift"\nat_exposure = {number}\nfor_s = 0.02\n'
            f"factor = {1.0 - DRIFT * number / EXPOSURES}\n"
            for number in range(1, EXPOSURES + 1)
        )
    )
    content = {
        "plan": {"name": "drift", "sample": "sample1"},
        "darks": {"count": 2},
        "poses": [{"kind": "sweep", "theta_i_deg": [30], "theta_o_deg": [-45, 0, 15, 45, 60]}],
    }
    materials = {"sample1": f"lambert:kd={ALBEDO}"}
    with Twin(materials, seed=3, speed=300.0, faults=folder / "faults.toml", log=False) as twin:
        assert capture(plan_from(content, "test"), twin.rig, folder / "s").complete
    return folder / "s"


def reduced(session: Path, *without: Correction) -> xr.Dataset:
    """Reduce it."""
    with Session.open(session) as opened:
        return reduce_session(opened, options=Options(without=without))


def worst_error(samples: xr.Dataset) -> float:
    """Largest relative error of a pose's mean, all channels."""
    relative = samples["f_r"] * math.pi / ALBEDO - 1.0
    return float(np.abs(relative.groupby(samples["pose"]).mean("sample").mean("channel")).max())


def test_drift_is_taken_out_and_stated(session: Path) -> None:
    """Errors of percents without the correction, below 0.1 % with it; the budget has a line for it."""
    with Session.open(session) as opened:
        outputs = opened.lamp_outputs.values()
    plain, corrected = reduced(session, Correction.LAMP_DRIFT), reduced(session)

    assert max(outputs) - min(outputs) > 0.04
    assert worst_error(plain) > 0.01
    # The twin's white is as uncertain as its certificate: 0.05 %.
    assert worst_error(corrected) < 0.001
    lines = {line.name: line for line in budget(corrected)}
    assert 0.0 < lines["drift of the lamp"].of_sample < 0.001
    left_in = {line.name: line for line in budget(plain)}
    assert left_in["drift of the lamp"].of_sample > 0.01


def test_without_readings_nothing_is_claimed(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A session from before the readings were kept must reduce as it did."""
    monkeypatch.setattr(Session, "lamp_outputs", {})
    samples = reduced(session)

    assert float(np.abs(samples["u_lamp"]).max()) == 0.0
    assert worst_error(samples) == pytest.approx(worst_error(reduced(session, Correction.LAMP_DRIFT)))
