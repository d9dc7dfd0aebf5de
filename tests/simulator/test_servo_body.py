"""What servos measure of themselves, what they cannot stand, and what real ones do not do exactly."""

from __future__ import annotations

import math

import pytest

from rig.control_table import CONTROL_TABLE, HardwareError, StatusError
from rig.servo_models import MODELS, control_table
from simulator.servo import OVERLOAD_S, Servo
from simulator.shaft import Flaws

MINUTE_S = 60.0


def read(servo: Servo, name: str, now: float) -> int:
    """Read a register as a client does."""
    register = CONTROL_TABLE[name]
    error, data = servo.read(register.address, register.size, now)
    assert error is StatusError.NONE
    return register.decode(data)


def write(servo: Servo, name: str, value: int, now: float) -> StatusError:
    """Write a register as a client does."""
    register = CONTROL_TABLE[name]
    servo.hear(now)
    return servo.write(register.address, register.encode(value), now)


def pushing(goal: int = 3000, **options: float) -> Servo:
    """Return a servo that is held and pushes with all it has."""
    servo = Servo(1, shaft_ticks=2048, **options)  # type: ignore[arg-type]
    servo.hinder(0.0, 0.0, math.inf)
    for name, value in {"shutdown": 0, "torque_enable": 1, "goal_position": goal}.items():
        assert write(servo, name, value, 0.0) is StatusError.NONE
    return servo


def test_a_held_servo_draws_its_stall_current_and_the_supply_sags() -> None:
    """Catches effort that costs nothing: current, voltage and duty are what a supervisor looks at."""
    servo = pushing()
    assert read(servo, "present_current", 0.1) == pytest.approx(1300 / 2.69, abs=1)
    assert read(servo, "present_pwm", 0.1) == 885
    assert read(servo, "present_input_voltage", 0.1) < 120
    write(servo, "torque_enable", 0, 0.2)
    assert (read(servo, "present_current", 0.3), read(servo, "present_input_voltage", 0.3)) == (0, 120)


def test_it_warms_by_the_square_of_its_current_and_cools_again() -> None:
    """Catches heat that does not come, does not go, or depends on how often somebody asks."""
    often, seldom = pushing(), pushing()
    for second in range(120):
        read(often, "present_temperature", float(second))
    warm = read(seldom, "present_temperature", 2 * MINUTE_S)
    assert read(often, "present_temperature", 2 * MINUTE_S) == warm > 45
    half = Servo(2)
    half.press(0.5, 0.0, math.inf)
    write(half, "torque_enable", 1, 0.0)
    assert read(half, "present_temperature", 2 * MINUTE_S) - 32 == pytest.approx((warm - 32) / 4, abs=1.0)
    write(seldom, "torque_enable", 0, 2 * MINUTE_S)
    assert 33 <= read(seldom, "present_temperature", 10 * MINUTE_S) < warm
    assert read(seldom, "present_temperature", 100 * MINUTE_S) == 32


def test_a_hurried_servo_warms_as_much_faster() -> None:
    """Catches nights on a hurried twin in which nothing ever grows warm."""
    assert read(pushing(speed=60.0), "present_temperature", 2.0) == read(
        pushing(), "present_temperature", 120.0
    )


@pytest.mark.parametrize(("mask", "torque"), [(52, 0), (0, 1)])
def test_too_warm_is_an_error_and_cuts_torque_where_the_mask_says(mask: int, torque: int) -> None:
    """Catches an overheated servo that goes on, or a mask that is not asked."""
    servo = Servo(1)
    write(servo, "shutdown", mask, 0.0)
    write(servo, "torque_enable", 1, 0.0)
    servo.press(0.99, 0.0, math.inf)
    assert servo.alert == 0
    assert read(servo, "present_temperature", 10 * MINUTE_S) > 80
    assert servo.value("hardware_error_status") == HardwareError.OVERHEATING
    assert servo.value("torque_enable") == torque
    servo.reboot(10 * MINUTE_S)
    assert servo.alert  # a restart cools nothing
    servo.reboot(100 * MINUTE_S)
    assert not servo.alert


def test_full_effort_for_seconds_is_an_overload() -> None:
    """Catches a stalled servo that never protects itself, or that trips at the first push."""
    servo = Servo(1)
    write(servo, "torque_enable", 1, 0.0)
    servo.hinder(0.0, 0.0, math.inf)
    write(servo, "goal_position", 3000, 0.0)
    assert read(servo, "hardware_error_status", OVERLOAD_S - 0.1) == 0
    servo.hear(OVERLOAD_S + 0.1)
    assert servo.value("hardware_error_status") == HardwareError.OVERLOAD
    assert servo.value("torque_enable") == 0


def test_a_weak_supply_is_an_error_beyond_the_limits() -> None:
    """Catches a supply that fails without a word."""
    servo = Servo(1)
    servo.weaken_supply(0.9, 0.0, 10.0)
    assert (read(servo, "present_input_voltage", 1.0), servo.alert) == (108, 0)
    servo.weaken_supply(0.7, 1.0, 10.0)
    assert servo.value("hardware_error_status") == HardwareError.INPUT_VOLTAGE
    assert read(servo, "present_input_voltage", 11.0) == 120
    assert servo.alert  # it stands until a restart


def test_what_lets_go_lets_it_go_on() -> None:
    """Catches an arm that stays for ever where a hand had held it."""
    servo = Servo(1, shaft_ticks=2048)
    write(servo, "torque_enable", 1, 0.0)
    servo.hinder(0.0, 0.0, 1.0)
    write(servo, "goal_position", 2100, 0.0)
    assert servo.shaft_ticks(0.9) == 2048
    assert servo.shaft_ticks(5.0) == 2100


@pytest.mark.parametrize("start", [1000, 3000])
def test_friction_leaves_it_short_of_its_goal(start: int) -> None:
    """Catches the steady-state error: it depends on the side, on the gain, and goes with an integral gain."""
    side = 1 if start < 2000 else -1
    for gains, short in (
        ({}, 8),
        ({"position_p_gain": 1800}, 4),
        ({"position_i_gain": 100}, 0),
    ):
        servo = Servo(1, shaft_ticks=start, flaws=Flaws(steady_error_ticks=8.0))
        for name, value in {**gains, "torque_enable": 1, "goal_position": 2000}.items():
            write(servo, name, value, 0.0)
        assert read(servo, "present_position", 60.0) == 2000 - side * short
        assert read(servo, "moving", 60.0) == 0
        assert bool(read(servo, "present_current", 60.0)) == bool(short)


def test_backlash_depends_on_the_side_and_the_encoder_does_not_see_it() -> None:
    """Catches play that a client could read, or that is the same from both sides."""
    servo = Servo(1, shaft_ticks=1000, flaws=Flaws(backlash_ticks=6.0))
    assert servo.behind_ticks() == 0.0
    write(servo, "torque_enable", 1, 0.0)
    for goal, start, behind in ((2000, 0.0, -3.0), (1500, 100.0, 3.0)):
        write(servo, "goal_position", goal, start)
        assert read(servo, "present_position", start + 60.0) == goal
        assert servo.behind_ticks() == behind


@pytest.mark.parametrize("model", MODELS)
def test_every_model_works_by_its_own_table(model: str) -> None:
    """Catches a model whose units, limits or modes are another's."""
    info, table = MODELS[model], control_table(model)
    servo = Servo(1, model, shaft_ticks=1000)
    assert read(servo, "model_number", 0.0) == info.number
    assert read(servo, "present_input_voltage", 0.0) == round(10 * info.supply_v)
    assert servo.alert == 0
    for mode in (0, 1, 3, 4, 5, 16):
        expected = StatusError.NONE if mode in info.modes else StatusError.DATA_RANGE
        assert write(servo, "operating_mode", mode, 0.0) is expected
    follower = StatusError.NONE if info.dual else StatusError.DATA_RANGE
    assert write(servo, "drive_mode", 2, 0.0) is follower
    write(servo, "drive_mode", 0, 0.0)
    write(servo, "operating_mode", 3, 0.0)
    write(servo, "torque_enable", 1, 0.0)
    write(servo, "goal_position", 3000, 0.0)
    limit = min(table["velocity_limit"].default * info.velocity_unit_rpm, info.no_load_rpm)
    assert read(servo, "present_velocity", 0.3) == pytest.approx(limit / info.velocity_unit_rpm, abs=1)
    assert (table.keys() >= {"current_limit", "goal_current"}) is (info.current_unit_ma is not None)


def test_a_model_without_current_reports_its_load() -> None:
    """Catches a load in tenths of a percent that is read as a current."""
    servo = Servo(1, "XL430-W250")
    write(servo, "torque_enable", 1, 0.0)
    servo.press(0.4, 0.0, math.inf)
    assert read(servo, "present_current", 0.1) == 400
    assert servo.write(38, b"\x10\x00", 0.1) is StatusError.ACCESS


@pytest.mark.parametrize(("mode", "goal", "value"), [(16, "goal_pwm", 443), (0, "goal_current", 100)])
def test_free_running_modes_turn_by_effort(mode: int, goal: str, value: int) -> None:
    """Catches a mode that takes its goal and stands still, or runs off when the torque comes on."""
    servo = Servo(1)
    write(servo, "operating_mode", mode, 0.0)
    write(servo, "torque_enable", 1, 0.0)
    assert read(servo, "present_velocity", 1.0) == 0
    write(servo, goal, -value, 1.0)
    assert read(servo, "present_velocity", 2.0) < -50
    write(servo, goal, 0, 2.0)
    assert read(servo, "present_velocity", 3.0) == 0


def test_switching_the_mode_forgets_turns_gains_and_profile() -> None:
    """Catches an extended count or a profile that outlives the mode it was made for."""
    servo = Servo(1, shaft_ticks=2048)
    write(servo, "operating_mode", 4, 0.0)
    write(servo, "torque_enable", 1, 0.0)
    write(servo, "profile_velocity", 50, 0.0)
    write(servo, "position_p_gain", 100, 0.0)
    write(servo, "goal_position", 10_000, 0.0)
    assert read(servo, "present_position", 100.0) == 10_000
    write(servo, "torque_enable", 0, 100.0)
    write(servo, "operating_mode", 3, 100.0)
    write(servo, "operating_mode", 4, 100.0)
    assert read(servo, "present_position", 100.0) == 10_000 % 4096
    assert (servo.value("profile_velocity"), servo.value("position_p_gain")) == (0, 900)


def test_a_tripped_watchdog_forgets_the_profile_and_may_run_away() -> None:
    """Catches a trip that a client could not tell, and the firmware's defect that a handshake must refuse."""
    for offset, runs in ((0, False), (100, True)):
        servo = Servo(1)
        write(servo, "homing_offset", offset, 0.0)
        write(servo, "operating_mode", 4, 0.0)
        write(servo, "torque_enable", 1, 0.0)
        write(servo, "profile_velocity", 50, 0.0)
        write(servo, "bus_watchdog", 10, 0.0)
        assert bool(read(servo, "moving", 2.0)) is runs
        assert (servo.value("bus_watchdog"), servo.value("profile_velocity")) == (-1, 0)
