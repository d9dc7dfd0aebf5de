"""References are shot as the drift asks for: often under a drifting lamp, rarely under a steady one."""

from __future__ import annotations

import json
import math
import shutil
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from capture.comparison import Comparison, FrameSet
from capture.drift import PER_KELVIN, UNSEEN_SHARE, Lessons, Moment, Prediction, predict
from capture.interruptions import REFERENCE
from capture.plan import References, plan_from
from capture.records import Event
from capture.run import capture
from capture.session import Session, hash_file
from simulator.twin import Twin

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

ALBEDO, DRIFT, EXPOSURES = 0.5, 0.06, 16
CONTENT: dict[str, Any] = {
    "plan": {"name": "drift", "sample": "sample1"},
    "darks": {"count": 1},
    "trap": {"every": 4},
    "poses": [{"kind": "sweep", "theta_i_deg": [30], "theta_o_deg": [-45, 0, 15, 45]}],
}


def reference(ratio: float, lamp_ratio: float = 1.0, *, u: float = 1e-4, accepted: bool = True) -> Event:
    """Return the event of a comparison, an hour after what it is compared with."""
    detail = {"ratio": [ratio], "u_ratio": [u], "lamp_ratio": lamp_ratio, "since_s": 3600.0}
    return Event("2026-01-01T00:00:00.000Z", REFERENCE, detail | {"accepted": accepted})


def test_an_error_is_predicted_from_lamp_temperature_and_time() -> None:
    """Would catch a cause that counts twice, or not at all, and readings that are not there."""
    first = Moment(0.0, 1.0, 30.0)
    assert predict(first, Moment(60.0, 1.0, 30.0), Lessons()).error == 0.0
    drifted = predict(first, Moment(60.0, 0.97, 30.0), Lessons())
    assert drifted.error == pytest.approx(UNSEEN_SHARE * -math.log(0.97))
    assert predict(first, Moment(60.0, 1.0, 34.0), Lessons()).error == pytest.approx(4.0 * PER_KELVIN)
    aged = predict(first, Moment(60.0, 1.0, 30.0), Lessons(rate_per_s=1e-5))
    assert aged.error == pytest.approx(6e-4)
    blind = predict(Moment(0.0, math.nan, math.nan), Moment(60.0, math.nan, 30.0), Lessons())
    assert blind == Prediction(60.0, 0.0, 0.0, 0.0)


def test_a_reference_is_due_beyond_the_tolerance_or_after_the_longest_time() -> None:
    """Would catch references by habit, and none at all on a machine that seems to stand still."""
    asked = References(tolerance=0.001, max_interval_s=100.0)
    assert Prediction(50.0, 0.0009, 0.0, 0.0).why(asked) is None
    assert "lamp's drift may be 0.12%" in str(Prediction(50.0, 0.0012, 0.0, 0.0).why(asked))
    assert "temperature" in str(Prediction(50.0, 0.0001, 0.0012, 0.0).why(asked))
    assert Prediction(100.0, 0.0, 0.0, 0.0).why(asked) == "100 s since the last"
    assert Prediction(1e6, 0.0, 0.0, 0.0).why(References(max_interval_s=0.0)) is None


def test_references_teach_what_the_photodiode_does_not_see() -> None:
    """Would catch lessons from noise or from a comparison that was refused, and one that is not learnt."""
    assert Lessons.of([reference(1.0002, 0.9)]) == Lessons()
    assert Lessons.of([reference(1.02, 0.9, accepted=False)]) == Lessons()
    told = Lessons.of([reference(1.0203, 0.9), reference(1.0001, 0.9)])
    assert told.unseen_share == pytest.approx(0.02 / -math.log(0.9), rel=1e-6)
    assert told.rate_per_s == 0.0
    aged = Lessons.of([reference(0.9907, 1.0)])
    assert aged.rate_per_s == pytest.approx(0.009 / 3600.0)
    assert aged.unseen_share == UNSEEN_SHARE


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a maker of sessions, under a steady lamp and under one that loses 6 %, each made once."""
    folder = tmp_path_factory.mktemp("drift")
    (folder / "drifting.toml").write_text(
        "".join(
            f'[[fault]]\nkind = "lamp-drift"\nat_exposure = {number}\nfor_s = 0.02\n'
            f"factor = {1.0 - DRIFT * number / EXPOSURES}\n"
            for number in range(1, EXPOSURES + 1)
        )
    )

    def make(name: str) -> Path:
        out, faults = folder / name, folder / f"{name}.toml"
        if not out.exists():
            materials, faults = {"sample1": f"lambert:kd={ALBEDO}"}, faults if faults.exists() else None
            with Twin(materials, seed=5, speed=300.0, faults=faults, log=False) as twin:
                assert capture(plan_from(CONTENT, "test"), twin.rig, out).complete
                shutil.copy(twin.folder / "truth.json", out)
        return out

    return make


def references_of(session: Path) -> list[dict[str, Any]]:
    """Return what a session's journal tells of its references."""
    with Session.open(session) as opened:
        return [event.detail for event in opened.events() if event.kind == REFERENCE]


@pytest.mark.render
def test_a_drifting_lamp_gets_more_references_and_the_same_samples(measured: Callable[[str], Path]) -> None:
    """Would catch references by the number of poses, and samples that drift with the lamp."""
    from analysis.reduce import reduce_session

    assert references_of(measured("steady")) == []
    told = references_of(measured("drifting"))
    assert sum(each["role"] == "white" for each in told) >= 3
    assert {each["role"] for each in told} >= {"white", "dark"}
    for each in told:
        assert each["accepted"]
        assert "the lamp's drift may be" in each["why"]
        for ratio, u in zip(each["ratio"], each["u_ratio"], strict=True):
            assert abs(ratio - 1.0) < max(5.0 * u, 1e-4)
        for file in each["files"]:
            assert hash_file(measured("drifting") / file["path"]) == file["sha256"]
    lamps = [each["lamp_ratio"] for each in told if each["role"] == "white"]
    assert min(lamps) < 0.97
    for name in ("steady", "drifting"):
        with Session.open(measured(name)) as opened:
            samples = reduce_session(opened)
            stated = opened.rig.white.rho
        white = json.loads((measured(name) / "truth.json").read_text())["white"]["rho"] / stated
        relative = samples["f_r"] * white * math.pi / ALBEDO - 1.0
        errors = relative.groupby(samples["pose"]).mean("sample").mean("channel")
        assert float(np.abs(errors).max()) < 0.001


def test_darks_are_compared_by_the_light_they_are_taken_off(measured: Callable[[str], Path]) -> None:
    """Would catch a dark level that rises by a per cent of the white and is called small, or doubled."""
    session = measured("steady")
    with Session.open(session) as opened:
        (light, *_), (dark, *_), (sample, *_) = (opened.poses(role) for role in ("white", "dark", "sample"))
        compared = Comparison(opened.rig, light.angles_rad, opened.sensor)

        def frames(record: Any) -> FrameSet:
            return FrameSet(
                tuple(frame.path for frame in record.frames), tuple(f.exposure_s for f in record.frames)
            )

        same = compared.offset(frames(dark), frames(dark), frames(light))
        risen = compared.offset(frames(dark), frames(sample), frames(light))
    assert same.ratio == (1.0, 1.0, 1.0)
    assert risen.ratio == pytest.approx([1.0 + ALBEDO / 0.99] * 3, rel=0.01)
    assert risen.beyond(0.01) == risen.channels
