"""The rig file: what it says comes back, and what it cannot mean is refused in one line."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.description import Bus, Camera, Joint, Ports, Rig, Station, default_rig, dump_rig, load_rig
from rig.errors import BadInput
from rig.ticks import rad_to_ticks, tick_rad, ticks_to_rad

SMALL_RIG = """
name = "two arms in one plane"

[ports]
servos = "COM3"
frames = "shots"

[[joints]]
name = "light"
id = 11
axis = [0, 1, 0]
limits_deg = [-80, 80]

[[joints]]
name = "camera"
id = 12
axis = [0, 1, 0]
limits_deg = [-70, 75]

[arms]
light = ["light"]
camera = ["camera"]
"""


def write(folder: Path, text: str) -> Path:
    """Write a rig file."""
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def full_text(tmp_path: Path) -> str:
    """Return the default machine's rig file, every field written out."""
    path = tmp_path / "default.toml"
    dump_rig(default_rig(folder=tmp_path), path)
    return path.read_text(encoding="utf-8")


def refusal(folder: Path, text: str) -> str:
    """Return the one line that a bad rig file gets."""
    path = write(folder, text)
    with pytest.raises(BadInput) as caught:
        load_rig(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{path}: ")
    return message.removeprefix(f"{path}: ")


def test_small_file_fills_in_defaults(tmp_path: Path) -> None:
    """Catch a field required in vain, integers refused as lengths, and a wheel that is not there."""
    rig = load_rig(write(tmp_path, SMALL_RIG))
    assert [joint.id for joint in rig.joints] == [11, 12]
    assert rig.joints[0].limits_deg == (-80.0, 80.0)
    assert rig.station_joint is None
    assert rig.stations == {}
    assert rig.arm_joints == rig.joints
    assert rig.lamp.watchdog_s == 2.0
    assert rig.folder == tmp_path


def test_ports_are_resolved_and_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catch a hot folder looked for in the working folder instead of beside the rig file, and the reverse."""
    path = write(tmp_path, SMALL_RIG)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert load_rig(path).ports == Ports(servos="COM3", lamp="", frames=tmp_path / "shots")
    replaced = load_rig("../rig.toml", servos="/dev/ttyUSB9", lamp="/dev/ttyACM1", frames="hot")
    assert replaced.ports.servos == "/dev/ttyUSB9"
    assert replaced.ports.lamp == "/dev/ttyACM1"
    assert replaced.ports.frames == tmp_path / "elsewhere" / "hot"
    assert load_rig(path, servos="").ports.servos == ""  # an empty port replaces one too


def test_dump_loads_back_equal(tmp_path: Path) -> None:
    """Catch a field that the file loses, rounds, or writes as something the reader refuses."""
    rig = default_rig(
        ports=Ports(servos="/dev/ttyUSB0", frames=Path("hot")),
        folder=tmp_path,
        camera=Camera(
            serial="Ä-7", distortion=(-0.1, 0.2, 1e-5, -1e-5, 1 / 3), focal_length_px=1234.5678901234567
        ),
        bus=Bus(torque_on_stop="off"),
    )
    dump_rig(rig, tmp_path / "rig.toml")
    again = load_rig(tmp_path / "rig.toml")
    assert again == rig
    assert again.hash == rig.hash
    assert 'frames = "hot"' in (tmp_path / "rig.toml").read_text(encoding="utf-8")  # moves with its folder


def test_dump_keeps_a_hot_folder_elsewhere(tmp_path: Path) -> None:
    """Catch an absolute hot folder that is silently taken for one beside the file."""
    (tmp_path / "machine").mkdir()
    rig = default_rig(ports=Ports(frames=tmp_path / "hot"), folder=tmp_path)
    dump_rig(rig, tmp_path / "machine" / "rig.toml")
    assert load_rig(tmp_path / "machine" / "rig.toml").ports.frames == tmp_path / "hot"


def test_dump_into_nowhere_is_one_line(tmp_path: Path) -> None:
    """Catch a traceback when the folder does not exist."""
    with pytest.raises(BadInput, match=r"rig\.toml: cannot write"):
        dump_rig(default_rig(), tmp_path / "none" / "rig.toml")


def test_hash_sees_the_machine_only(tmp_path: Path, full_text: str) -> None:
    """Catch a hash of the file's bytes: layout, comments, order, ports and defaults must not count."""
    rig = load_rig(write(tmp_path, full_text))
    content = tomllib.loads(full_text)
    del content["white"], content["ports"]  # the defaults, and what is outside
    shuffled = ["# a comment"]
    tables: list[str] = []
    for key, value in reversed(content.items()):
        if key == "name":
            shuffled.append(f"name = '{value}'  # first")
        elif key in {"joints", "solids"}:
            for part in value:
                tables += [f"[[{key}]]", *(f"{k}={_toml(v)}" for k, v in reversed(part.items()))]
        else:
            inline = ", ".join(f"{k} = {_toml(v)}" for k, v in reversed(value.items()))
            shuffled.append(f"{key} = {{{inline}}}")
    other = load_rig(write(tmp_path, "\n".join([*shuffled, *tables])), servos="elsewhere")
    assert other.hash == rig.hash
    assert re.fullmatch("[0-9a-f]{64}", rig.hash)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} = {_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    if isinstance(value, float) and value.is_integer():
        return str(int(value))  # 500 and 500.0 are the same length
    return repr(value)


def test_hash_sees_every_part(default_rig: Rig) -> None:
    """Catch a part that the hash leaves out: changing any of them must change it."""
    changes: list[dict[str, Any]] = [
        {"name": "other"},
        {"bus": default_rig.bus.model_copy(update={"baud": 57600})},
        {"joints": default_rig.joints[::-1]},
        {"lamp": default_rig.lamp.model_copy(update={"distance_mm": 500.1})},
        {"camera": default_rig.camera.model_copy(update={"serial": "x"})},
        {"sample": default_rig.sample.model_copy(update={"diameter_mm": 49.0})},
        {"stations": {"white": Station(angle_deg=1.0, kind="white")}},
        {"white": default_rig.white.model_copy(update={"u_rho": 0.001})},
        {"clearance": default_rig.clearance.model_copy(update={"min_separation_deg": 13.0})},
        {"arms": default_rig.arms.model_copy(update={"camera": ("camera_elevation", "camera_azimuth")})},
    ]
    hashes = {default_rig.model_copy(update=change).hash for change in changes}
    assert len(hashes | {default_rig.hash}) == len(changes) + 1


def test_equal_rigs_hash_equal(default_rig: Rig) -> None:
    """Catch minus zero, which equals zero and is written differently."""
    wheel = default_rig.joints[4].model_copy(update={"park_deg": -0.0})
    other = default_rig.model_copy(update={"joints": (*default_rig.joints[:4], wheel)})
    assert other == default_rig
    assert other.hash == default_rig.hash
    assert len({other, default_rig}) == 1


def test_nobody_can_change_a_rig(default_rig: Rig) -> None:
    """Catch a mutable description: a session's hash would no longer be its machine's."""
    with pytest.raises(ValueError, match="frozen"):
        default_rig.lamp.distance_mm = 1.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("old", "new", "field", "helps"),
    [
        # typing errors
        ("watchdog_s = 2.0", "watchdog = 2.0", "lamp.watchdog", "did you mean watchdog_s?"),
        ("[clearance]", "[clearence]", "clearence", "did you mean clearance?"),
        ("id = 3", "ids = 3", "joints[2].ids", "did you mean id?"),
        ('kind = "trap"', 'knd = "trap"', "stations.trap.knd", "did you mean kind?"),
        ("watchdog_s = 2.0", '"watch\\ndog" = 2.0', 'lamp."watch\\ndog"', "known name"),
        ("id = 3\n", "", "joints[2].id is missing", "0 to 252"),
        (
            '"camera_elevation",\n',
            '"camera_elevatoin",\n',
            "arms.camera[1]",
            "did you mean camera_elevation?",
        ),
        ('model = "XH430-W350"', 'model = "XH430-W530"', "joints[0].model", "did you mean XH430-W350?"),
        # wrong types
        ("distance_mm = 500.0", 'distance_mm = "500"', 'lamp.distance_mm = "500"', "mm"),
        ("distance_mm = 500.0", "distance_mm = true", "lamp.distance_mm = true", "mm"),
        ("id = 3", "id = 3.5", "joints[2].id = 3.5", "0 to 252"),
        ("id = 3", "id = true", "joints[2].id = true", "0 to 252"),
        ("width_px = 128", "width_px = 1979-05-27", "camera.width_px", "2 to 65535"),
        ("[lamp]", "[[lamp]]", "lamp", "light source"),
        ('mode = "BULB"', 'mode = "bulb"', 'lamp.mode = "bulb"', "'BULB'"),
        # no numbers
        ("distance_mm = 500.0", "distance_mm = nan", "lamp.distance_mm = NaN", "finite"),
        ("distance_mm = 500.0", "distance_mm = -inf", "lamp.distance_mm = -Infinity", "finite"),
        ("distance_mm = 500.0", "distance_mm = 1e999", "lamp.distance_mm = Infinity", "finite"),
        ("    -85.0,\n", "    nan,\n", "joints[0].limits_deg[0] = NaN", "degrees"),
        # out of range
        ("distance_mm = 500.0", "distance_mm = 0", "lamp.distance_mm = 0", "above 0"),
        ("id = 3", "id = 253", "joints[2].id = 253", "0 to 252"),
        ("zero_ticks = 2048", "zero_ticks = 4096", "joints[0].zero_ticks = 4096", "0 to 4095"),
        ("watchdog_s = 2.0", "watchdog_s = 0", "lamp.watchdog_s = 0", "0.1 to 60"),
        ("rho = 0.99", "rho = 1.5", "white.rho = 1.5", "above 0 to 1"),
        # contradictions
        ("id = 3", "id = 2", "joints[2].id = 2", "joints[1] has it"),
        ('name = "camera_elevation"', 'name = "turntable"', "joints[3].name", "joints[2] has it"),
        ("    -85.0,\n", "    5.0,\n", "joints[0].limits_deg", "low <= 0 <= high"),
        ("    -85.0,\n    85.0,\n", "    0.0,\n    0.0,\n", "joints[0].limits_deg", "low < high"),
        ("179.9", "180.0", "joints[1].limits_deg", "-180 to 179.91"),
        ("179.9", "179.96", "joints[1].limits_deg", "-180 to 179.91"),
        ("gear_ratio = 1.0", "gear_ratio = 2.5", "joints[0].limits_deg", "-72 to 71.96"),
        ("park_deg = -45.0", "park_deg = 86.0", "joints[0].park_deg = 86.0", "-85 to 85"),
        ("    0.0,\n    1.0,\n    0.0,\n", "    0.0,\n    0.0,\n    0.0,\n", "joints[0].axis", "not zero"),
        ("angle_deg = 144.0", "angle_deg = 181.0", "stations.sample1.angle_deg = 181.0", "-180 to 179.9"),
        ('    "station_wheel",\n', "", "station_wheel", "moves nothing"),
        ('    "station_wheel",\n', '    "turntable",\n', "arms.station[0]", "arms.sample has it"),
        ('    "turntable",\n', '    "turntable",\n    "turntable",\n', "arms.sample[1]", "once in an arm"),
        ("shortest_exposure_s = 0.0001", "shortest_exposure_s = 100.0", "camera.shortest_exposure_s", "60"),
        ("    63.5,\n", "    163.5,\n", "camera.principal_point_px", "128 x 96"),
        # syntax
        ("[lamp]", "[lamp", "not TOML", "line"),
        ("id = 3", "id = 3\nid = 3", "not TOML", "line"),
        ("id = 3", "id = " + "9" * 5000, "not TOML", "mend"),
        ("id = 3", "id = " + "[" * 5000, "not TOML", "mend"),
    ],
)
def test_bad_value_is_one_line(
    tmp_path: Path, full_text: str, *, old: str, new: str, field: str, helps: str
) -> None:
    """Catch a mistake that passes, a traceback, or a line that names neither field nor remedy."""
    assert old in full_text
    message = refusal(tmp_path, full_text.replace(old, new, 1))
    assert field in message
    assert helps in message


def test_limits_reach_to_half_a_tick_beyond_the_last(tmp_path: Path, full_text: str) -> None:
    """Catch limits refused though their nearest servo position exists, and ones beyond the servo's turn."""
    rig = load_rig(write(tmp_path, full_text.replace("179.9,", "179.95,")))
    joint = rig.joints[1]
    assert [rad_to_ticks(joint, np.radians(limit)) for limit in joint.limits_deg] == [0, 4095]


def test_stations_need_a_wheel_and_a_wheel_stations(tmp_path: Path, full_text: str) -> None:
    """Catch a machine that could never bring a station to the centre."""
    assert "arms.station" in refusal(
        tmp_path, SMALL_RIG + '[stations.white]\nangle_deg = 0\nkind = "white"\n'
    )
    without = re.sub(r"\[stations\.\w+\]\n(.+\n)+", "", full_text)
    assert "stations = {}" in refusal(tmp_path, without)


def test_files_that_are_no_rig_file(tmp_path: Path) -> None:
    """Catch tracebacks from the file system and from bytes."""
    with pytest.raises(BadInput, match="no such rig file"):
        load_rig(tmp_path / "none.toml")
    with pytest.raises(BadInput, match="cannot read"):
        load_rig(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe4"')
    with pytest.raises(BadInput, match="not UTF-8 at byte 8"):
        load_rig(tmp_path / "latin.toml")
    (tmp_path / "huge.toml").write_bytes(b"#" * 2_000_000)
    with pytest.raises(BadInput, match="larger than"):
        load_rig(tmp_path / "huge.toml")
    assert "joints is missing" in refusal(tmp_path, "")


def test_every_field_tells_unit_and_range() -> None:
    """Catch a new field without description: the message for a bad value would not say what is allowed."""
    parts = [Rig, *(f.annotation for f in Rig.model_fields.values()), Joint, Station]
    for part in parts:
        for name, field in getattr(part, "model_fields", {}).items():
            assert field.description, f"{part}.{name}"


def test_joint_lookup(default_rig: Rig) -> None:
    """Catch the station wheel among the joints of a pose, and a KeyError for an unknown name."""
    assert [joint.name for joint in default_rig.arm_joints] == [
        "light_elevation",
        "camera_azimuth",
        "camera_elevation",
        "turntable",
    ]
    assert default_rig.station_joint == default_rig.joints[4]
    assert default_rig.joint_index("turntable") == 3
    with pytest.raises(BadInput, match=r"no joint is named 'table'.*light_elevation, camera_azimuth"):
        default_rig.joint("table")


def test_pure_parts_do_not_load_pydantic() -> None:
    """Catch an import that makes every user of angles and kinematics pay for pydantic."""
    code = "import sys, rig.pixels, rig.ticks; print('pydantic' in sys.modules, 'cv2' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["False", "False"]


@given(st.integers(0, 4095), st.integers(0, 4095), st.sampled_from([1.0, 0.5, 2.0, 3.3, 20.0]))
def test_ticks_survive_angles(ticks: int, zero: int, gear: float) -> None:
    """Catch rounding towards zero, and a gear on the wrong side."""
    joint = Joint(
        name="j", id=1, axis=(0.0, 0.0, 1.0), zero_ticks=zero, gear_ratio=gear, limits_deg=(-1.0, 1.0)
    )
    angle = ticks_to_rad(joint, ticks)
    assert rad_to_ticks(joint, angle) == ticks
    for nudge in (-0.49, 0.49):
        assert rad_to_ticks(joint, angle + nudge * tick_rad(joint)) == ticks
    assert ticks_to_rad(joint, zero) == 0.0


def test_ticks_by_hand_and_in_arrays() -> None:
    """Catch a wrong unit: 1024 ticks are a quarter turn of the servo, an eighth behind a gear of 2."""
    joint = Joint(name="j", id=1, axis=(0.0, 0.0, 1.0), gear_ratio=2.0, limits_deg=(-80.0, 80.0))
    assert ticks_to_rad(joint, 3072) == pytest.approx(np.pi / 4)
    ticks = np.array([[1024, 2048], [2049, 3072]])
    angles = ticks_to_rad(joint, ticks)
    assert angles.shape == (2, 2)
    np.testing.assert_array_equal(rad_to_ticks(joint, angles), ticks)
    for bad in (float("nan"), np.array([0.0, np.inf])):
        with pytest.raises(BadInput, match="joint j"):
            rad_to_ticks(joint, bad)  # type: ignore[arg-type]


def test_the_documented_rig_file_is_one(tmp_path: Path) -> None:
    """Catch documentation that has fallen behind: it must load, name every field, show the defaults."""
    page = (Path(__file__).resolve().parents[2] / "docs" / "rig.md").read_text(encoding="utf-8")
    example = page.split("```toml\n")[1].split("```")[0]
    rig = load_rig(write(tmp_path, example))
    written = tomllib.loads(example)
    tables = {key: value for key, value in written.items() if isinstance(value, dict)}
    assert set(written) == set(Rig.model_fields)
    shown = [(getattr(rig, key), set(table)) for key, table in tables.items() if key != "stations"]
    shown += [(rig.joints[0], set(written["joints"][0])), (rig.stations["white"], {"angle_deg", "kind"})]
    for part, names in shown:
        fields = type(part).model_fields
        assert names == set(fields)
        for name, field in fields.items():
            if (
                name not in {"servos", "lamp", "serial", "frames", "sample", "station", "mirrors"}
                and not field.is_required()
            ):
                assert getattr(part, name) == field.default, name
