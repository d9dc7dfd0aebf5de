"""One servo: what its registers take and refuse, how it moves, stops, fails and forgets."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control_table import CONTROL_TABLE, Area, HardwareError, StatusError
from simulator.servo import Servo


class Client:
    """Reads and writes a servo's registers by name."""

    def __init__(self, **options: Any) -> None:
        self.servo = Servo(1, **options)
        self.now = 0.0

    def write(self, name: str, value: int) -> StatusError:
        register = CONTROL_TABLE[name]
        data = (value % (1 << 8 * register.size)).to_bytes(register.size, "little")
        self.servo.hear(self.now)
        return self.servo.write(register.address, data, self.now)

    def read(self, name: str) -> int:
        register = CONTROL_TABLE[name]
        error, data = self.servo.read(register.address, register.size, self.now)
        assert error is StatusError.NONE
        return register.decode(data)

    def move(self, goal: int, *, velocity: int = 44, acceleration: int = 6) -> None:
        for name, value in (
            ("torque_enable", 1),
            ("profile_acceleration", acceleration),
            ("profile_velocity", velocity),
            ("goal_position", goal),
        ):
            assert self.write(name, value) is StatusError.NONE


def settled(client: Client, wait_s: float = 60.0) -> int:
    """Wait until nothing moves; the reported position."""
    client.now += wait_s
    assert client.read("moving") == 0
    return client.read("present_position")


@pytest.mark.parametrize(
    "name", [n for n, r in CONTROL_TABLE.items() if r.writable and r.area is Area.EEPROM]
)
def test_eeprom_only_with_torque_off(name: str) -> None:
    """Catches a servo whose limits or ID can be changed while it holds an arm."""
    client = Client()
    value = client.read(name)
    client.write("torque_enable", 1)
    assert client.write(name, value) is StatusError.ACCESS
    client.write("torque_enable", 0)
    assert client.write(name, value) is StatusError.NONE


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("present_position", 0, StatusError.ACCESS),
        ("moving", 1, StatusError.ACCESS),
        ("torque_enable", 2, StatusError.DATA_RANGE),
        ("profile_velocity", 32_768, StatusError.DATA_RANGE),
        ("operating_mode", 2, StatusError.DATA_RANGE),
        ("id", 253, StatusError.DATA_RANGE),
        ("goal_position", 4096, StatusError.DATA_LIMIT),
        ("goal_position", -1, StatusError.DATA_LIMIT),
        ("goal_velocity", 131, StatusError.DATA_LIMIT),
        ("goal_position", 4095, StatusError.NONE),
    ],
)
def test_what_a_register_refuses(name: str, value: int, error: StatusError) -> None:
    """Catches a limit that is not kept, or answered with the wrong error."""
    assert Client().write(name, value) is error


def test_a_refused_write_changes_nothing() -> None:
    """Catches half of a long write that was executed before the refusal."""
    client = Client()
    client.write("torque_enable", 1)
    span = (77).to_bytes(4, "little") + (9999).to_bytes(4, "little")  # profile velocity, goal position
    assert client.servo.write(112, span, 0.0) is StatusError.DATA_LIMIT
    assert client.read("profile_velocity") == 0
    assert client.servo.write(116, b"\x00\x08", 0.0) is StatusError.DATA_LENGTH
    assert client.servo.write(66, b"\x00", 0.0) is StatusError.ACCESS
    assert client.servo.write(117, b"\x00\x08\x00\x00", 0.0) is StatusError.ACCESS


def test_it_moves_by_its_profile() -> None:
    """Catches wrong units of velocity (0.229 rpm) or acceleration (214.577 rev/min2), or flags that lie."""
    client = Client(shaft_ticks=1000)
    client.move(3000, velocity=44, acceleration=6)
    v, a = 44 * 0.229 * 4096 / 60, 6 * 214.577 * 4096 / 3600
    client.now += 1.0
    assert client.read("present_position") == pytest.approx(1000 + v * (1.0 - v / a / 2), abs=0.51)
    assert (client.read("moving"), client.read("present_velocity")) == (1, 44)
    assert client.read("moving_status") == 0x32
    client.now = 2000 / v + v / a - 1e-6
    assert client.read("moving") == 1
    client.now += 2e-6
    assert (client.read("moving"), client.read("present_position")) == (0, 3000)
    assert client.read("moving_status") & 0x03 == 0x01


def test_speed_shortens_motion_but_not_what_is_reported() -> None:
    """Catches a client that could tell a hurried twin from a real rig."""
    slow, fast = Client(shaft_ticks=1000), Client(shaft_ticks=1000, speed=50.0)
    for client in (slow, fast):
        client.move(3000)
    slow.now, fast.now = 1.0, 0.02
    for name in ("present_position", "present_velocity", "moving_status"):
        assert slow.read(name) == fast.read(name)


def test_no_profile_is_as_fast_as_the_velocity_limit() -> None:
    """Catches profile velocity 0 that is taken for standing still, or for a jump."""
    client = Client(shaft_ticks=1000)
    client.move(3000, velocity=0, acceleration=0)
    client.now = 0.5
    assert client.read("present_velocity") == 130
    client.write("torque_enable", 0)
    client.write("velocity_limit", 20)
    client.move(1000, velocity=500)
    client.now += 0.5
    assert client.read("present_velocity") == -20


def test_a_time_based_profile_takes_its_time() -> None:
    """Catches drive mode bit 2 ignored: the same registers then mean milliseconds."""
    client = Client(shaft_ticks=1000)
    client.write("drive_mode", 4)
    client.move(1500, velocity=2000, acceleration=500)
    client.now = 1.999
    assert client.read("moving") == 1
    client.now = 2.001
    assert (client.read("moving"), client.read("present_position")) == (0, 1500)


def test_torque_off_in_mid_move_holds_and_torque_on_does_not_jump() -> None:
    """Catches an arm that goes on to the old goal, or leaps there, when torque comes back."""
    client = Client(shaft_ticks=1000)
    client.move(3000)
    client.now = 1.0
    client.write("torque_enable", 0)
    held = client.read("present_position")
    client.now = 9.0
    assert client.read("present_position") == held
    client.write("torque_enable", 1)
    assert client.read("goal_position") == held
    assert settled(client) == held


def test_extended_mode_turns_many_times_and_forgets_at_reboot() -> None:
    """Catches goals outside one turn refused in mode 4, and turns that survive a power cycle."""
    client = Client(shaft_ticks=2048)
    client.write("operating_mode", 4)
    client.move(-131_073, velocity=0, acceleration=0)
    assert settled(client, 600.0) == -131_073
    assert client.servo.shaft_ticks(client.now) == -131_073
    client.servo.reboot(client.now)
    assert client.read("present_position") == -131_073 % 4096
    assert (client.read("torque_enable"), client.read("operating_mode")) == (0, 4)


@given(st.integers(0, 4095), st.integers(-1024, 1024), st.booleans(), st.integers(0, 4095))
def test_offset_and_direction_only_change_the_reported_frame(
    shaft: int, offset: int, reverse: bool, goal: int
) -> None:
    """Catches an arm that turns when its offset is written, or a goal taken in the wrong frame."""
    client = Client(shaft_ticks=shaft)
    client.write("homing_offset", offset)
    client.write("drive_mode", int(reverse))
    assert client.servo.shaft_ticks(0.0) == shaft
    assert client.read("present_position") == ((-shaft if reverse else shaft) + offset) % 4096
    client.move(goal, velocity=0, acceleration=0)
    assert settled(client) == goal
    turned = client.servo.shaft_ticks(client.now)
    assert ((-turned if reverse else turned) + offset - goal) % 4096 == 0


def test_a_large_offset_is_ignored_in_one_turn_mode() -> None:
    """Catches offsets beyond 1024 ticks that position mode must ignore and extended mode must not."""
    client = Client(shaft_ticks=2000)
    client.write("homing_offset", 1025)
    assert client.read("present_position") == 2000
    client.write("operating_mode", 4)
    assert client.read("present_position") == 3025


def test_an_overheated_servo_lets_go_until_it_is_rebooted() -> None:
    """Catches an alert without the bit in every answer, torque that stays on, or that comes back too soon."""
    client = Client()
    client.move(3000)
    client.now = 0.5
    client.servo.fail(HardwareError.OVERLOAD, client.now)
    assert client.servo.alert == 0x80
    assert client.read("hardware_error_status") == HardwareError.OVERLOAD
    assert client.read("torque_enable") == 0
    assert client.write("torque_enable", 1) is StatusError.RESULT_FAIL
    held = settled(client)
    client.servo.reboot(client.now)
    assert client.servo.alert == 0
    assert client.write("torque_enable", 1) is StatusError.NONE
    assert settled(client) == held


def test_limits_that_its_own_measurements_break_raise_the_alert() -> None:
    """Catches errors that no client could provoke: a temperature limit below its temperature does it."""
    client = Client()
    client.write("temperature_limit", 20)
    assert client.read("hardware_error_status") == HardwareError.OVERHEATING
    assert client.write("torque_enable", 1) is StatusError.RESULT_FAIL
    client.write("temperature_limit", 80)
    client.servo.reboot(0.0)
    assert client.write("min_voltage_limit", 130) is StatusError.NONE
    assert client.read("hardware_error_status") == HardwareError.INPUT_VOLTAGE
    assert client.write("torque_enable", 1) is StatusError.NONE  # not in the default shutdown mask


def test_the_bus_watchdog_stops_a_servo_that_nobody_talks_to() -> None:
    """Catches a watchdog that counts in hurried time, does not stop, or lets new goals in once tripped."""
    client = Client(shaft_ticks=0, speed=2.0)
    client.move(4000)
    client.write("bus_watchdog", 50)  # one second
    at_trip = Client(shaft_ticks=0, speed=2.0)
    at_trip.move(4000)
    at_trip.now, client.now = 1.0, 3.0
    assert client.read("present_position") == at_trip.read("present_position")
    assert client.read("bus_watchdog") == -1
    assert client.write("goal_position", 100) is StatusError.DATA_RANGE
    assert client.write("bus_watchdog", 0) is StatusError.NONE
    assert client.write("goal_position", 100) is StatusError.NONE
    assert settled(client) == 100


def test_factory_reset_keeps_what_it_is_told_to() -> None:
    """Catches a reset that loses the ID, or keeps what it should lose."""
    client = Client(eeprom={"id": 7, "baud_rate": 3, "velocity_limit": 50})
    assert client.servo.factory_reset(0x02, 0.0) is StatusError.NONE
    assert [client.read(name) for name in ("id", "baud_rate", "velocity_limit")] == [7, 3, 130]
    assert client.servo.factory_reset(0x01, 0.0) is StatusError.NONE
    assert [client.read(name) for name in ("id", "baud_rate")] == [7, 1]
    assert client.servo.factory_reset(0x03, 0.0) is StatusError.DATA_RANGE


def test_indirect_data_are_the_registers_they_point_to() -> None:
    """Catches clients that gather scattered registers and read stale copies, or write into the void."""
    client = Client(shaft_ticks=1234)
    for place in range(4):
        client.write(f"indirect_address_{place + 1}", 132 + place)
        client.write(f"indirect_address_{place + 5}", 116 + place)
    client.write("torque_enable", 1)
    assert client.servo.read(224, 4, 0.0) == (StatusError.NONE, (1234).to_bytes(4, "little"))
    assert client.servo.write(228, (2000).to_bytes(4, "little"), 0.0) is StatusError.NONE
    assert settled(client) == 2000


@given(st.integers(0, 700), st.integers(0, 700))
def test_any_read_is_answered(address: int, length: int) -> None:
    """Catches a read that kills the twin: at gaps, at the end, of nothing."""
    error, data = Servo(1).read(address, length, 0.0)
    assert len(data) == (0 if error else length)


def test_a_velocity_limit_of_zero_is_standing_still() -> None:
    """Catches a division by zero: limit 0 is in the register's range, and a client may write it."""
    client = Client(shaft_ticks=1000)
    client.write("velocity_limit", 0)
    client.move(3000, velocity=0)
    client.now = 100.0
    assert client.read("present_position") == 1000


def test_velocity_mode_turns_until_it_is_told_to_stop() -> None:
    """Catches a goal velocity that is ignored, or that outlives the torque."""
    client = Client(shaft_ticks=0)
    client.write("operating_mode", 1)
    client.write("torque_enable", 1)
    client.write("goal_velocity", -100)
    client.now = 10.0
    assert client.read("present_velocity") == -100
    assert client.read("present_position") == pytest.approx(-100 * 0.229 * 4096 / 60 * 10, rel=1e-3)
    client.write("torque_enable", 0)
    assert client.read("moving") == 0
