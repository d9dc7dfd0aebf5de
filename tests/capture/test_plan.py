"""Plans as files, and what a machine makes of them."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from capture.itinerary import lay_out
from capture.plan import ADDED_FIELDS, ADDED_PARTS, dump_plan, load_plan, plan_from
from capture.records import Role
from rig.description import default_rig as describe
from rig.errors import BadInput, Refused

if TYPE_CHECKING:
    from pathlib import Path

    from rig.description import Rig

HEAD = {"name": "brass", "sample": "sample1"}
SETS: list[dict[str, Any]] = [
    {"kind": "grid", "theta_i_deg": [0, 30], "theta_o_deg": [0, 40], "phi_deg": [90, 180]},
    {"kind": "sweep", "theta_i_deg": [45], "theta_o_deg": [-60, 0, 45]},
    {"kind": "specular", "theta_i_deg": [65], "offset_deg": [-5, 5], "phi_i_deg": 20},
    {"kind": "hemisphere", "theta_i_deg": [20], "count": 9},
    {"kind": "list", "directions_deg": [[30, 0, 30, 180], [50, 10, 20, 190]]},
]


def content(**changes: Any) -> dict[str, Any]:
    """Return a plan as plain values, with some of them changed."""
    return {"plan": HEAD, "poses": SETS} | changes


def test_a_plan_survives_its_file(tmp_path: Path) -> None:
    """Would catch a field that is written but not read, or that changes the hash on its way."""
    plan = plan_from(content(exposure={"snr": 50.0, "first_s": 0.1}, darks={"count": 5}), "test")
    dump_plan(plan, tmp_path / "plan.toml")
    again = load_plan(tmp_path / "plan.toml")
    assert again == plan
    assert again.hash == plan.hash


def test_younger_fields_leave_hashes_alone() -> None:
    """Would catch a gonio that knows more fields and refuses to resume the sessions of the one before."""
    plain = plan_from(content(), "test")
    values = plain.model_dump(mode="json")
    for part, names in ADDED_FIELDS.items():
        for name in names:
            assert values[part].pop(name) is not None
    for part in ADDED_PARTS:
        assert values.pop(part) is not None
    text = json.dumps(values, sort_keys=True, allow_nan=False)

    assert plain.hash == hashlib.sha256(text.encode()).hexdigest()
    assert plan_from(content(exposure={"spare": "time"}), "test").hash != plain.hash


def test_the_hash_is_blind_to_layout_only(tmp_path: Path) -> None:
    """Would catch a hash of the file's bytes, and one that misses a change of content."""
    head = '[plan]\nname = "brass"\nsample = "sample1"\n'
    text = f'{head}[[poses]]\nkind = "sweep"\ntheta_i_deg = [45]\ntheta_o_deg = [0]\n'
    turned = '# a remark\n[[poses]]\ntheta_o_deg = [0.0]\ntheta_i_deg = [45.0]\nkind = "sweep"\n'
    other = f'{turned}[plan]\nsample = "sample1"\nname = "brass"\n'
    hashes = []
    for number, written in enumerate((text, other, text.replace("45", "46"))):
        file = tmp_path / f"{number}.toml"
        file.write_text(written)
        hashes.append(load_plan(file).hash)
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"plan": {"name": "x", "sampel": "s"}}, "sampel"),
        ({"poses": [{"kind": "gird"}]}, "gird"),
        (
            {"poses": [{"kind": "sweep", "theta_i_deg": [95], "theta_o_deg": [0]}]},
            "poses[0].theta_i_deg[0] = 95: input should be less than or equal to 90; allowed: ",
        ),
        (
            {"poses": [{"kind": "grid", "theta_i_deg": [9], "theta_o_deg": [0], "phi": [0]}]},
            "unknown field poses[0].phi; use a known name, did you mean phi_deg?",
        ),
        ({"poses": [{"kind": "list", "directions_deg": [[1, 2, float("nan"), 3]]}]}, "finite"),
        ({"poses": []}, "poses"),
        ({"darks": {"count": -1}}, "count"),
        ({"exposure": {"max_frames": 0}}, "max_frames"),
        ({"version": 2}, "version"),
    ],
)
def test_a_wrong_plan_is_one_line_with_its_field(changes: dict[str, Any], said: str) -> None:
    """Would catch a typo that is silently ignored, and a traceback instead of a line."""
    with pytest.raises(BadInput) as caught:
        plan_from(content(**changes), "plan.toml")
    message = str(caught.value)
    assert said in message
    assert message.startswith("plan.toml: ")
    assert "\n" not in message


@pytest.mark.parametrize("text", ["", "poses = 3", "[plan", "\x00", "a = " + "[" * 3000])
def test_a_file_that_is_no_plan(tmp_path: Path, text: str) -> None:
    """Would catch a traceback for what is not TOML, or not a plan."""
    file = tmp_path / "plan.toml"
    file.write_text(text)
    with pytest.raises(BadInput, match=r"plan\.toml"):
        load_plan(file)


def test_one_pass_there_and_one_back(default_rig: Rig) -> None:
    """Would catch white and sample at different joint angles, or a long way back between the passes."""
    itinerary = lay_out(plan_from(content(), "test"), default_rig)
    visits = itinerary.visits()
    white = [visit for visit in visits if visit.role is Role.WHITE]
    sample = [visit for visit in visits if visit.role is Role.SAMPLE]
    assert [visit.number for visit in visits] == list(range(len(visits)))
    assert visits == white + sample
    assert [v.pose for v in sample] == [v.pose for v in white][::-1]
    assert {v.pose: v.angles_rad for v in white} == {v.pose: v.angles_rad for v in sample}
    assert {v.station for v in white} == {"white"}
    assert {v.station for v in sample} == {"sample1"}


def test_every_pose_is_planned_or_refused(default_rig: Rig) -> None:
    """Would catch a pose of the plan that is neither visited nor listed with its reason."""
    itinerary = lay_out(plan_from(content(), "test"), default_rig)
    planned = itinerary.planned()
    assert [pose.index for pose in planned] == list(range(len(planned)))
    assert len(planned) == len(itinerary.feasible.wi)
    taken = {pose.index for pose in planned if pose.angles_rad is not None}
    assert taken == {visit.pose for visit in itinerary.visits()}
    assert all((pose.angles_rad is None) == (pose.refused is not None) for pose in planned)
    assert itinerary.forecast().refused == len(planned) - len(taken) > 0


def test_a_strict_plan_does_not_start_with_a_pose_refused(default_rig: Rig) -> None:
    """Would catch a pose that was asked for by name and is silently left out."""
    poses = [{"kind": "list", "directions_deg": [[30, 0, 30, 180], [30, 0, 31, 0]]}]
    lenient = lay_out(plan_from(content(poses=poses), "test"), default_rig)
    assert lenient.forecast().poses == 1
    with pytest.raises(Refused, match="1 of 2 poses"):
        lay_out(plan_from(content(poses=poses, plan=HEAD | {"refused": "stop"}), "test"), default_rig)


def test_a_plan_of_refused_poses_only_does_not_start(default_rig: Rig) -> None:
    """Would catch an empty session."""
    poses = [{"kind": "list", "directions_deg": [[30, 0, 31, 0]]}]
    with pytest.raises(Refused, match="31"):
        lay_out(plan_from(content(poses=poses), "test"), default_rig)


@pytest.mark.parametrize("sample", ["sample9", "white", "trap"])
def test_the_sample_must_be_a_sample_station(default_rig: Rig, sample: str) -> None:
    """Would catch the white reference measured as a sample."""
    with pytest.raises(BadInput, match="sample1, sample2, sample3"):
        lay_out(plan_from(content(plan=HEAD | {"sample": sample}), "test"), default_rig)


def test_the_first_exposure_must_be_one_of_the_camera(default_rig: Rig) -> None:
    """Would catch a limit that shows only when the arms are there."""
    with pytest.raises(BadInput, match="first_s"):
        lay_out(plan_from(content(exposure={"first_s": 500.0}), "test"), default_rig)


def test_a_machine_without_a_wheel_takes_any_label(tmp_path: Path) -> None:
    """Would catch stations demanded of a machine that has none."""
    rig = describe(folder=tmp_path)
    arms = rig.arms.model_copy(update={"station": ()})
    joints = tuple(joint for joint in rig.joints if joint.name != "station_wheel")
    bare = describe(folder=tmp_path, arms=arms, joints=joints, stations={})
    itinerary = lay_out(plan_from(content(plan=HEAD | {"sample": "velvet_3"}), "test"), bare)
    assert {visit.station for visit in itinerary.visits()} == {None}


def test_the_forecast_adds_up(default_rig: Rig) -> None:
    """Would catch a prediction that forgets a pass, the travel, or the size of frames."""
    with_white = lay_out(plan_from(content(), "test"), default_rig).forecast()
    without = lay_out(plan_from(content(plan=HEAD | {"white": "none"}), "test"), default_rig).forecast()
    assert with_white.travel_s > 1.8 * without.travel_s > 0.0
    assert with_white.duration_s > with_white.travel_s
    assert with_white.disk_bytes >= with_white.frames * 2 * 128 * 96
    assert with_white.frames > 1.8 * (without.frames - 6)


def test_the_coverage_tells_the_angles(default_rig: Rig) -> None:
    """Would catch swapped light and camera in what a person reads before a night of measuring."""
    poses = [{"kind": "sweep", "theta_i_deg": [30, 40], "theta_o_deg": [-70, 10, 30, 40]}]
    coverage = lay_out(plan_from(content(poses=poses), "test"), default_rig).coverage()
    assert coverage["theta_i_max_deg"] == pytest.approx(40.0)
    assert coverage["theta_o_max_deg"] == pytest.approx(70.0)
    assert coverage["in_plane"] == 8
    assert coverage["near_specular"] == np.sum(np.abs(np.subtract.outer([30, 40], [-70, 10, 30, 40])) < 10.0)


def test_a_trap_needs_its_station(default_rig: Rig) -> None:
    """Would catch a pass over stray light that the wheel cannot make, found out in the middle of a night."""
    stations = {name: each for name, each in default_rig.stations.items() if each.kind != "trap"}
    rig = default_rig.model_copy(update={"stations": stations})
    plan = plan_from(content(trap={"every": 1}), "test")
    with pytest.raises(BadInput, match="no light trap"):
        lay_out(plan, rig)
