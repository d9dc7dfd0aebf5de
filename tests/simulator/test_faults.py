"""The twin's faults: read strictly, and each one happens when and where its script says."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest

from rig.control_table import HardwareError, OperatingMode
from rig.errors import BadInput
from simulator.fault_injector import FaultInjector
from simulator.faults import CAMERA, SERVO, WIRE, Fault, FaultKind, FaultScript, load_faults
from simulator.lamp import Exposure, Lamp
from simulator.servo import Servo

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

JOINTS = ("a", "b")


class Line:
    """Stands for a pseudo-terminal."""

    def __init__(self) -> None:
        self.written: list[bytes] = []
        self.plugged = True

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def unplug(self) -> None:
        self.plugged = False

    def plug_in(self) -> None:
        self.plugged = True


class Bench:
    """Two servos, a lamp and two lines with faults, at time 0."""

    def __init__(self, *faults: Fault, rate: float = 0.0, seed: int = 0) -> None:
        self.servos = {name: Servo(number, shaft_ticks=2000) for number, name in enumerate(JOINTS, 1)}
        self.shots: list[Exposure] = []
        self.lamp = Lamp(
            0.0, on_event=lambda *_: None, on_exposure=lambda exposure, _: self.shots.append(exposure)
        )
        self.lines: dict[str, Any] = {"servos": Line(), "lamp": Line()}
        self.told: list[str] = []
        self.faults = FaultInjector(
            FaultScript(faults, rate, seed),
            servos=self.servos,
            lamp=self.lamp,
            lines=self.lines,
            now=0.0,
            on_event=lambda _event, _time, details: self.told.append(str(details["kind"])),
        )

    def expose(self, now: float) -> Exposure:
        """One lit exposure of a second."""
        self.lamp.handle(b"OUTP ON\nSHUT:EXP 1\n", now)
        self.faults.exposure_begins(now)
        self.lamp.advance(now + 1.0)
        return self.shots[-1]


def write(folder: Path, text: str) -> Path:
    """Write a script."""
    path = folder / "faults.toml"
    path.write_text(text)
    return path


def test_a_script_is_read_as_written(tmp_path: Path) -> None:
    """Catches a field that is dropped, or a default that is not its kind's."""
    text = """
        seed = 7
        servo_error_rate = 0.01
        [[fault]]
        kind = "stuck"
        joint = "b"
        at_exposure = 3
        [[fault]]
        kind = "delay"
        line = "lamp"
        at_s = 1.5
        for_s = 0.3
    """
    script = load_faults(write(tmp_path, text), JOINTS)
    assert (script.seed, script.servo_error_rate) == (7, 0.01)
    assert script.faults[0] == Fault(FaultKind.STUCK, at_exposure=3, joint="b", for_s=float("inf"))
    assert script.faults[1] == Fault(
        FaultKind.DELAY, at_s=1.5, line="lamp", direction="out", count=1, for_s=0.3
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("seed = ", "not TOML"),
        ("speed = 1", "unknown key 'speed'"),
        ("fault = 3", "list of tables"),
        ("servo_error_rate = 2", "no number"),
        ("servo_error_rate = true", "no number"),
        ("seed = 1.5", "seed"),
        ('[[fault]]\nkind = "fire"\nat_s = 1', "unknown kind 'fire'"),
        ('[[fault]]\nkind = "drop"', "not clear when"),
        ('[[fault]]\nkind = "drop"\nat_s = 1\nat_packet = 2', "not clear when"),
        ('[[fault]]\nkind = "drop"\nat_packet = 0', "whole number"),
        ('[[fault]]\nkind = "drop"\nat_s = -1', "no number"),
        ('[[fault]]\nkind = "drop"\nat_s = nan', "no number"),
        ('[[fault]]\nkind = "drop"\nat_s = 1\njoint = "a"', "unknown key 'joint'"),
        ('[[fault]]\nkind = "drop"\nat_s = 1\nline = "usb"', "no line 'usb'"),
        ('[[fault]]\nkind = "stuck"\nat_s = 1', "no joint None"),
        ('[[fault]]\nkind = "stuck"\nat_s = 1\njoint = "z"', "no joint 'z'"),
        ('[[fault]]\nkind = "slow"\nat_s = 1\njoint = "a"\nfactor = "x"', "no number"),
    ],
)
def test_what_cannot_happen_is_refused(tmp_path: Path, text: str, says: str) -> None:
    """Catches a slip of the pen that would leave a fault out without a word."""
    with pytest.raises(BadInput, match=says):
        load_faults(write(tmp_path, text), JOINTS)


def test_no_file_is_one_line(tmp_path: Path) -> None:
    """Catches a traceback for a name that is mistyped."""
    with pytest.raises(BadInput, match="No such file"):
        load_faults(tmp_path / "none.toml", JOINTS)


@pytest.mark.parametrize("kind", sorted(FaultKind))
def test_every_kind_happens_once(tmp_path: Path, kind: FaultKind) -> None:
    """Catches a kind that can be written down and does nothing, or happens again and again."""
    joint = 'joint = "a"\n' if kind in SERVO else ""
    path = write(tmp_path, f'[[fault]]\nkind = "{kind}"\nat_exposure = 2\n{joint}')
    bench = Bench(*load_faults(path, JOINTS).faults)
    for number in range(4):
        bench.faults.exposure_begins(10.0 * number)
        assert bench.told == ([kind] if number >= 1 else [])


def test_when() -> None:
    """Catches a fault that comes early, late or at another wire's packet."""
    at = {"line": "servos", "direction": "in", "count": 1}
    bench = Bench(Fault(FaultKind.DROP, at_packet=2, **at), Fault(FaultKind.LAMP_RESTART, at_s=5.0))
    assert bench.faults.deadline() == 5.0
    assert bench.faults.heard("lamp", b"x", 0.0) == b"x"
    assert [bench.faults.heard("servos", b"x", 0.0) for _ in range(3)] == [b"x", b"", b"x"]
    bench.faults.advance(4.9)
    assert bench.told == ["drop"]
    bench.faults.advance(5.0)
    assert bench.told == ["drop", "lamp-restart"]
    assert bench.faults.deadline() is None


@pytest.mark.parametrize(
    ("kind", "heard"), [(FaultKind.DROP, b""), (FaultKind.DUPLICATE, b"abcabc"), (FaultKind.DELAY, b"")]
)
def test_bytes_on_their_way(kind: FaultKind, heard: bytes) -> None:
    """Catches a wire fault that hits the other direction, or more packets than it says."""
    bench = Bench(Fault(kind, at_packet=1, line="servos", direction="out", count=1, for_s=0.5))
    assert bench.faults.heard("servos", b"q", 0.0) == b"q"
    assert bench.faults.say("servos", b"abc", 1.0) == heard
    assert bench.faults.say("servos", b"abc", 1.1) == b"abc"
    bench.faults.advance(1.4)
    assert bench.lines["servos"].written == []
    bench.faults.advance(1.5)
    assert bench.lines["servos"].written == ([b"abc"] if kind is FaultKind.DELAY else [])


def test_a_corrupt_packet_has_one_wrong_bit() -> None:
    """Catches corruption that changes nothing, or the length."""
    bench = Bench(Fault(FaultKind.CORRUPT, at_packet=1, line="servos", direction="in", count=1))
    hit = bench.faults.heard("servos", bytes(20), 0.0)
    assert len(hit) == 20
    assert sum(byte.bit_count() for byte in hit) == 1


def test_the_rate_is_a_rate_and_repeats_with_its_seed() -> None:
    """Catches random faults that differ from run to run, or that hit the lamp's line too."""

    def run(seed: int) -> list[bytes]:
        bench = Bench(rate=0.1, seed=seed)
        assert all(bench.faults.heard("lamp", b"x", 0.0) == b"x" for _ in range(100))
        return [bench.faults.say("servos", b"abcdef", 0.0) for _ in range(2000)]

    first = run(1)
    assert first == run(1)
    assert first != run(2)
    hit = [data for data in first if data != b"abcdef"]
    assert 130 <= len(hit) <= 270
    assert 0.3 < hit.count(b"") / len(hit) < 0.7


def test_a_port_goes_and_comes_back() -> None:
    """Catches an adapter that stays away, or never goes."""
    bench = Bench(Fault(FaultKind.UNPLUG, at_s=1.0, line="lamp", for_s=2.0))
    for now, plugged in [(0.9, True), (1.0, False), (2.9, False), (3.1, True)]:
        bench.faults.advance(now)
        assert bench.lines["lamp"].plugged is plugged
    assert bench.lines["servos"].plugged


GOAL = (3000).to_bytes(4, "little")


def send(servo: Servo, now: float) -> None:
    """Torque on, and on its way to 3000 ticks."""
    servo.write(64, b"\x01", now)
    servo.write(116, GOAL, now)


@pytest.mark.parametrize(
    ("kind", "check"),
    [
        (FaultKind.OVERLOAD, lambda servo: servo.value("hardware_error_status") == HardwareError.OVERLOAD),
        (
            FaultKind.OVERHEATING,
            lambda servo: (
                servo.value("hardware_error_status") == HardwareError.OVERHEATING
                and servo.read(146, 1, 2.0)[1][0] > servo.value("temperature_limit")
            ),
        ),
        (FaultKind.BROWN_OUT, lambda servo: servo.value("torque_enable") == 0),
        (FaultKind.BUS_WATCHDOG, lambda servo: servo.value("bus_watchdog") == -1),
    ],
)
def test_a_servo_fails(kind: FaultKind, check: Callable[[Servo], bool]) -> None:
    """Catches a servo fault that the wire does not show, or that befalls another joint."""
    bench = Bench(Fault(kind, at_exposure=1, joint="b", deg_c=85.0))
    for servo in bench.servos.values():
        send(servo, 0.0)
    assert not check(bench.servos["b"])
    bench.faults.exposure_begins(1.0)
    assert check(bench.servos["b"])
    assert not check(bench.servos["a"])


def test_a_turn_is_lost_where_turns_are_counted() -> None:
    """Catches a servo of one turn that reports a place it cannot report, or a count that cannot be lost."""
    counting = Servo(1, shaft_ticks=2000, eeprom={"operating_mode": OperatingMode.EXTENDED_POSITION})
    for servo, off in ((Servo(2, shaft_ticks=2000), 0), (counting, 4096)):
        servo.lose_turn(1.0)
        assert servo.present_ticks(1.0) - servo.shaft_ticks(1.0) == off


def test_a_stuck_and_a_slow_axis() -> None:
    """Catches an axis that moves on, or that never recovers."""
    free, stuck, slow = (Servo(number, shaft_ticks=2000) for number in (1, 2, 3))
    stuck.hinder(0.0, 0.0, 10.0)
    slow.hinder(0.1, 0.0, 10.0)
    for servo in (free, stuck, slow):
        send(servo, 0.0)
    at = [servo.shaft_ticks(0.5) for servo in (free, stuck, slow)]
    assert at[1] == 2000
    assert 2000 < at[2] < at[0]
    stuck.write(116, GOAL, 11.0)
    assert stuck.shaft_ticks(60.0) == 3000
    slow.hinder(0.0, 60.0, 61.0)
    assert not slow.moving(60.0)


def test_the_lamp_gives_less_than_it_says() -> None:
    """Catches a lamp fault that the picture or the photodiode does not see."""
    drift = Fault(FaultKind.LAMP_DRIFT, at_exposure=1, for_s=10.0, factor=0.5)
    bench = Bench(drift)
    shots = [bench.expose(now) for now in (0.0, 4.5, 20.0)]
    assert [shot.output for shot in shots] == pytest.approx([0.975, 0.75, 0.5])
    assert [shot.level for shot in shots] == [1.0, 1.0, 1.0]
    bench.lamp.handle(b"OUTP OFF\n", 30.0)
    assert float(bench.lamp.handle(b"MEAS:MON?\n", 30.0)) == pytest.approx(0.5)


def test_a_dead_and_a_flickering_lamp() -> None:
    """Catches darkness that lasts for ever, and flicker that does not end."""
    bench = Bench(Fault(FaultKind.LAMP_DEAD, at_exposure=2, for_s=3.0))
    outputs = []
    for number in range(4):
        bench.faults.advance(2.0 * number)
        outputs.append(bench.expose(2.0 * number).output)
    assert outputs == [1.0, 0.0, 0.0, 1.0]
    bench = Bench(Fault(FaultKind.LAMP_FLICKER, at_exposure=1, count=2, factor=0.5))
    outputs = [bench.expose(2.0 * number).output for number in range(5)]
    assert outputs[0] == outputs[3] == outputs[4] == 1.0
    assert 0.5 < outputs[1] < 1.0
    assert 0.5 < outputs[2] < 1.0


def test_a_door_and_a_restart() -> None:
    """Catches a door that stays open, or a controller that remembers what a power cut should erase."""
    bench = Bench(
        Fault(FaultKind.DOOR_OPEN, at_s=1.0, for_s=1.0), Fault(FaultKind.LAMP_RESTART, at_exposure=1)
    )
    bench.faults.advance(1.0)
    assert bench.lamp.handle(b"INTL?\n", 1.5) == b"0\n"
    bench.faults.advance(2.0)
    assert bench.lamp.handle(b"INTL?\n", 2.0) == b"1\n"
    bench.lamp.handle(b"SOUR:LEV 0.5\nSYST:WDOG 2\nOUTP ON\nSHUT:EXP 1\n", 3.0)
    bench.faults.exposure_begins(3.5)
    assert bench.lamp.handle(b"SOUR:LEV?\nSYST:WDOG?\nOUTP?\nSHUT?\nSYST:UPT?\n", 4.0) == (
        b"1\n0\n0\nIDLE,0,\n0.500\n"
    )
    assert bench.shots == []


def test_the_camera_is_told_once_per_exposure() -> None:
    """Catches a file fault that hits other exposures than it says."""
    bench = Bench(Fault(FaultKind.TRUNCATED_FILE, at_exposure=2, count=2))
    found = []
    for number in range(5):
        bench.faults.exposure_begins(float(number))
        found.append(bench.faults.of_frame() is not None)
    assert found == [False, True, True, False, False]


def test_every_kind_belongs_somewhere() -> None:
    """Catches a new kind that nothing carries out."""
    lamp = {kind for kind in FaultKind if kind.value.startswith(("lamp", "door"))}
    assert WIRE | SERVO | CAMERA | lamp | {FaultKind.UNPLUG} == set(FaultKind)


def test_time_is_the_clocks() -> None:
    """Catches a start that is not now."""
    bench = Bench(Fault(FaultKind.DOOR_OPEN, at_s=0.0))
    bench.faults.advance(time.monotonic())
    assert bench.told == ["door-open"]
