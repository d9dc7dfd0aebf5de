"""The lamp controller's protocol, line by line, held to by the twin's lamp and by the firmware."""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.lamp import Exposure, Lamp, ShutterMode
from tests.rig.lamp_firmware import FirmwareLamp

if TYPE_CHECKING:
    from collections.abc import Iterator

NO_ERROR = '0,"No error"'
HEADER = '-113,"Undefined header"'
RANGE = '-222,"Data out of range"'
RUNNING = '-284,"Exposure running"'
INTERLOCK = '-240,"Interlock open"'
TRIPPED = '-241,"Watchdog tripped"'
OVERFLOW = '-350,"Queue overflow"'


class Bench:
    """A controller, a clock, and a record of what happened."""

    def __init__(self, speed: float = 1.0, *, firmware: bool = False) -> None:
        self.now = 0.0
        self.events: list[tuple[float, str, dict[str, Any]]] = []
        self.frames: list[tuple[float, Exposure]] = []
        hooks: Any = {
            "on_event": lambda event, time, details: self.events.append((time, event, details)),
            "on_exposure": lambda exposure, time: self.frames.append((time, exposure)),
        }
        self.lamp: Any = FirmwareLamp(**hooks) if firmware else Lamp(0.0, speed=speed, serial="S1", **hooks)

    def say(self, *lines: str) -> list[str]:
        """Send lines; the answers."""
        data = "".join(f"{line}\n" for line in lines).encode()
        return self.lamp.handle(data, self.now).decode().splitlines()

    def ask(self, query: str) -> str:
        """Send one query; its answer."""
        (answer,) = self.say(query)
        return answer

    def errors(self) -> list[str]:
        """Empty the error queue."""
        found = []
        while (error := self.ask("SYST:ERR?")) != NO_ERROR:
            found.append(error)
        return found

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds
        self.lamp.advance(self.now)

    def light(self) -> list[tuple[float, bool]]:
        """When the light went on and off."""
        return [(time, details["on"]) for time, event, details in self.events if event == "light"]


@contextlib.contextmanager
def switched_on(controller: str) -> Iterator[Bench]:
    """Give one of the two controllers, with what its end has to say."""
    bench = Bench(firmware=controller == "firmware")
    yield bench
    if isinstance(bench.lamp, FirmwareLamp):
        bench.lamp.close()


CONTROLLERS = ("twin", "firmware")


@pytest.fixture(params=CONTROLLERS)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    """Return a controller that has just been switched on."""
    with switched_on(request.param) as bench:
        yield bench


def test_queries_answer_one_line_and_commands_none(bench: Bench) -> None:
    """Catches an answer to a command, or a query without one: every later answer would be off by one."""
    assert bench.say("OUTP ON", "SOUR:LEV 0.5", "SHUT:MODE WIDTH", "SHUT:ID a", "SYST:WDOG 2") == []
    queries = [
        "*IDN?", "OUTP?", "SOUR:LEV?", "SHUT:MODE?", "SHUT:OPEN?", "SHUT?",
        "MEAS:MON?", "MEAS:TEMP?", "INTL?", "SYST:WDOG?", "SYST:ERR?", "SYST:UPT?",
    ]  # fmt: skip
    answers = bench.say(*queries)
    assert len(answers) == len(queries)
    assert answers[:6] == ["gonio,lamp,S1,1.0.0", "1", "0.5", "WIDTH", "1", "IDLE,0,a"]
    assert answers[8:11] == ["1", "2", NO_ERROR]
    assert bench.errors() == []


def test_case_carriage_returns_and_chunks_do_not_matter(bench: Bench) -> None:
    """Catches a parser that needs capitals, or a whole line in one piece."""
    answer = b"".join(bench.lamp.handle(bytes([byte]), 0.0) for byte in b"outp On\r\noutP?\r\n\r\n\n")
    assert answer == b"1\n"
    assert bench.errors() == []


def test_power_up_and_reset_state(bench: Bench) -> None:
    """Catches *RST that forgets the light, the level, the mode, the watchdog or the errors."""
    state = ("OUTP?", "SOUR:LEV?", "SHUT:MODE?", "SYST:WDOG?", "SYST:ERR?")
    fresh = bench.say(*state)
    assert fresh == ["0", "1", "BULB", "0", NO_ERROR]
    bench.say("OUTP ON", "SOUR:LEV 0.25", "SHUT:MODE LAMP", "SYST:WDOG 5", "NONSENSE", "*RST")
    assert bench.say(*state) == fresh
    assert [on for _, on in bench.light()] == [True, False]


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("SOUR:LEV 1.0001", RANGE),
        ("SOUR:LEV -0.1", RANGE),
        ("SOUR:LEV nan", RANGE),
        ("SOUR:LEV inf", RANGE),
        ("SOUR:LEV 1e999", RANGE),
        ("SOUR:LEV 1_0", RANGE),
        ("SOUR:LEV", RANGE),
        ("SHUT:EXP 0", RANGE),
        ("SHUT:EXP 0.000009", RANGE),
        ("SHUT:EXP 600.1", RANGE),
        ("SHUT:DARK 1e-6", RANGE),
        ("SHUT:OPEN 0.0009", RANGE),
        ("SHUT:OPEN 601", RANGE),
        ("SHUT:MODE FLASH", RANGE),
        ("OUTP MAYBE", RANGE),
        ("SYST:WDOG 0.05", RANGE),
        ("SYST:WDOG 61", RANGE),
        ("SYST:WDOG -1", RANGE),
        ("SHUT:ID " + 41 * "a", RANGE),
        ("SHUT:ID a b", RANGE),
        ("SHUT:ID a/b", RANGE),
        ("SHUT:ID", RANGE),
        ("*RST 1", RANGE),
        ("FOO", HEADER),
        ("FOO?", HEADER),
        ("OUTP? 1", HEADER),
        ("SHUT:EXP? 1", HEADER),
        ("x" * 5000, HEADER),
        ("\x00\x01", HEADER),
    ],
)
def test_what_is_refused(bench: Bench, line: str, error: str) -> None:
    """Catches a bad line that is obeyed, answered, or refused under another name."""
    assert bench.say(line) == []
    assert bench.errors() == [error]
    assert bench.say("SHUT?", "SOUR:LEV?", "OUTP?") == ["IDLE,0,", "1", "0"]


@pytest.mark.parametrize(
    "line",
    [
        "SOUR:LEV 0", "SOUR:LEV 1", "SOUR:LEV .5", "SOUR:LEV 5e-1", "SOUR:LEV +0.5", "SHUT:EXP 0.00001",
        "SHUT:EXP 600", "SHUT:OPEN 0.001", "SHUT:OPEN 600", "SYST:WDOG 0", "SYST:WDOG 0.1", "SYST:WDOG 60",
        "SHUT:ID " + 40 * "Z", "SHUT:ID a.b-c_9",
    ],
)  # fmt: skip
def test_the_ends_of_the_ranges_are_allowed(bench: Bench, line: str) -> None:
    """Catches a range that excludes its own end."""
    bench.say(line)
    assert bench.errors() == []


def test_the_error_queue_holds_sixteen(bench: Bench) -> None:
    """Catches an endless queue, or an overflow that hides the oldest errors instead of the newest."""
    bench.say("SOUR:LEV 2", *["FOO"] * 20)
    assert bench.errors() == [RANGE, *[HEADER] * 14, OVERFLOW]


def test_a_bulb_exposure_is_lit_by_the_continuous_light(bench: Bench) -> None:
    """Catches a frame that is lit or dark whatever OUTP said, or a count that rises too early."""
    bench.say("OUTP ON", "SOUR:LEV 0.5", "SHUT:ID Shot-1", "SHUT:EXP 2")
    bench.wait(1.999)
    assert bench.ask("SHUT?") == "BUSY,0,Shot-1"
    assert bench.frames == []
    bench.wait(0.002)
    assert bench.ask("SHUT?") == "IDLE,1,Shot-1"
    ((end, exposure),) = bench.frames
    assert end == 2.0
    assert (exposure.lit, exposure.level, exposure.exposure_s, exposure.shutter_open_s) == (
        True,
        0.5,
        2.0,
        2.0,
    )
    assert (exposure.shot_id, exposure.shot, exposure.mode) == ("Shot-1", 1, ShutterMode.BULB)
    bench.say("OUTP OFF", "SHUT:EXP 1")
    bench.wait(1.0)
    assert (bench.frames[1][1].lit, bench.frames[1][1].shot_id) == (False, "")


def test_lamp_mode_lights_exactly_as_long_as_asked(bench: Bench) -> None:
    """Catches a lamp that is on longer or shorter than asked, or outside the open shutter."""
    bench.say("SHUT:MODE LAMP", "SHUT:OPEN 3", "OUTP ON", "SHUT:EXP 0.5")
    bench.wait(10.0)
    assert bench.light() == [(0.0, True), (0.0, False), (1.25, True), (1.75, False), (3.0, True)]
    assert [(t, d["open"]) for t, event, d in bench.events if event == "shutter"] == [
        (0.0, True),
        (3.0, False),
    ]
    assert bench.frames[0][1].shutter_open_s == 3.0
    bench.say("OUTP OFF", "SHUT:EXP 3.001")
    assert bench.errors() == [RANGE]


def test_a_dark_exposure_never_sees_light(bench: Bench) -> None:
    """Catches a dark frame taken with the continuous light on, or in LAMP mode with its flash."""
    bench.say("OUTP ON", "SHUT:DARK 1")
    bench.wait(1.5)
    bench.say("SHUT:MODE LAMP", "SHUT:OPEN 2", "OUTP OFF", "SHUT:DARK 1")
    bench.wait(2.5)
    assert [frame.lit for _, frame in bench.frames] == [False, False]
    assert [frame.shutter_open_s for _, frame in bench.frames] == [1.0, 2.0]
    assert bench.light() == [(0.0, True), (0.0, False), (1.0, True), (1.5, False)]


def test_one_exposure_at_a_time(bench: Bench) -> None:
    """Catches a second exposure that replaces or follows the first."""
    bench.say("SHUT:EXP 1", "SHUT:EXP 1", "SHUT:DARK 1")
    assert bench.errors() == [RUNNING, RUNNING]
    bench.wait(5.0)
    assert len(bench.frames) == 1


@pytest.mark.parametrize("stop", ["SHUT:ABOR", "OUTP OFF", "*RST"])
def test_an_aborted_exposure_leaves_nothing(bench: Bench, stop: str) -> None:
    """Catches a file or a count from an exposure that was cut short, or light that stays on."""
    bench.say("OUTP ON", "SHUT:EXP 1")
    bench.wait(0.5)
    bench.say(stop)
    assert bench.ask("SHUT?").startswith("IDLE,0,")
    assert bench.ask("OUTP?") == ("1" if stop == "SHUT:ABOR" else "0")
    bench.wait(5.0)
    assert bench.frames == []
    assert bench.errors() == []
    assert [event for _, event, _ in bench.events].count("aborted") == 1


def test_settings_changed_during_an_exposure_wait_for_its_end(bench: Bench) -> None:
    """Catches a frame that depends on when a setting arrived: it must depend on what was set."""
    bench.say("OUTP ON", "SOUR:LEV 0.5", "SHUT:EXP 1")
    bench.wait(0.3)
    bench.say("SOUR:LEV 1", "SHUT:MODE WIDTH", "SHUT:ID late")
    bench.wait(1.0)
    exposure = bench.frames[0][1]
    assert (exposure.level, exposure.mode, exposure.shot_id) == (0.5, ShutterMode.BULB, "")
    bench.say("SHUT:EXP 1")
    bench.wait(1.0)
    assert (bench.frames[1][1].level, bench.frames[1][1].shot_id) == (1.0, "late")


def test_a_name_is_for_one_exposure(bench: Bench) -> None:
    """Catches an ID that sticks to later shots: two files would claim to be the same one."""
    bench.say("SHUT:ID one", "SHUT:EXP 1")
    bench.wait(1.0)
    bench.say("SHUT:EXP 1")
    bench.wait(1.0)
    assert [frame.shot_id for _, frame in bench.frames] == ["one", ""]


@pytest.mark.parametrize("speed", [1.0, 100.0])
def test_the_watchdog_darkens_a_silent_line_in_wall_time(speed: float) -> None:
    """Catches a killed client that leaves the light on, or a watchdog hurried along with the motion."""
    bench = Bench(speed)
    bench.say("SYST:WDOG 2", "OUTP ON")
    bench.wait(1.9)
    bench.say("OUTP?")
    bench.wait(1.9)
    bench.say("FOO", "SOUR:LEV 7")  # not valid: does not count
    bench.wait(0.2)
    assert bench.light() == [(0.0, True), (1.9 + 2.0, False)]
    assert bench.ask("OUTP?") == "0"
    assert bench.errors() == [HEADER, RANGE]
    bench.say("OUTP ON", "SHUT:EXP 1", "SHUT:DARK 1")
    assert bench.errors() == [TRIPPED] * 3
    bench.say("SYST:WDOG 2", "OUTP ON")
    assert (bench.ask("OUTP?"), bench.errors()) == ("1", [])


def test_the_watchdog_ends_a_running_exposure(bench: Bench) -> None:
    """Catches an exposure that goes on in the dark, and its file."""
    bench.say("SYST:WDOG 0.5", "OUTP ON", "SHUT:EXP 1")
    bench.wait(3.0)
    assert bench.frames == []
    assert bench.ask("SHUT?") == "IDLE,0,"


def test_watchdog_zero_disarms(bench: Bench) -> None:
    """Catches a watchdog that cannot be switched off."""
    bench.say("SYST:WDOG 0.5", "OUTP ON", "SYST:WDOG 0")
    bench.wait(100.0)
    assert bench.ask("OUTP?") == "1"


def test_an_open_interlock_forces_the_light_off(bench: Bench) -> None:
    """Catches light with the door open, or that comes back by itself when it closes."""
    bench.say("OUTP ON", "SHUT:EXP 10")
    bench.wait(1.0)
    bench.lamp.set_interlock(False, bench.now)
    assert bench.say("INTL?", "OUTP?", "SHUT?") == ["0", "0", "IDLE,0,"]
    bench.say("OUTP ON", "SHUT:MODE LAMP", "SHUT:EXP 0.5")
    assert bench.errors() == [INTERLOCK, INTERLOCK]
    bench.say("SHUT:DARK 0.5")
    assert bench.errors() == []
    bench.lamp.set_interlock(True, bench.now)
    assert bench.say("INTL?", "OUTP?") == ["1", "0"]
    assert bench.light()[-1] == (1.0, False)


def test_the_monitor(bench: Bench) -> None:
    """Catches a photodiode that reads the setting instead of the light."""
    assert bench.ask("MEAS:MON?") == "nan"
    bench.say("SHUT:DARK 1")
    bench.wait(1.0)
    assert math.isnan(float(bench.ask("MEAS:MON?")))
    bench.say("SOUR:LEV 0.5", "OUTP ON")
    bench.wait(0.05)
    assert float(bench.ask("MEAS:MON?")) == pytest.approx(0.25)
    bench.wait(0.10)
    assert float(bench.ask("MEAS:MON?")) == pytest.approx(0.5)
    bench.say("SHUT:EXP 0.2")
    bench.wait(0.2)
    bench.say("OUTP OFF", "SOUR:LEV 1")
    assert float(bench.ask("MEAS:MON?")) == pytest.approx(0.5)


def test_uptime_and_count_survive_a_reset(bench: Bench) -> None:
    """Catches a controller whose *RST looks like a power cut."""
    bench.say("SHUT:EXP 1")
    bench.wait(2.5)
    bench.say("*RST")
    assert bench.say("SYST:UPT?", "SHUT?") == ["2.500", "IDLE,1,"]


def test_speed_shortens_exposures_only() -> None:
    """Catches a hurried twin that reports hurried times."""
    bench = Bench(100.0)
    bench.say("OUTP ON", "SHUT:EXP 2")
    bench.wait(0.0201)
    ((end, exposure),) = bench.frames
    assert end == pytest.approx(0.02)
    assert exposure.exposure_s == 2.0


@pytest.mark.parametrize("controller", CONTROLLERS)
@given(chunks=st.lists(st.binary(max_size=30), max_size=30))
@settings(max_examples=50, deadline=None)
def test_noise_never_lights_the_lamp(controller: str, chunks: list[bytes]) -> None:
    """Catches a parser that dies of noise or takes it for a command."""
    with switched_on(controller) as bench:
        for chunk in chunks:
            bench.lamp.handle(chunk, 0.0)
        bench.lamp.handle(b"\n", 0.0)
        assert bench.ask("OUTP?") == "0"


TIMES = st.sampled_from([0.0, 0.001, 0.05, 0.1, 0.3, 1.0, 2.5])
NUMBERS = st.one_of(
    st.sampled_from(
        ["0", "1", "0.5", ".25", "5e-1", "+2", "-1", "nan", "1e999", "1E-5", "600", "61", "x", ""]
    ),
    st.decimals(0, 3, places=3).map(str),
)
NUMBERED = ("SOUR:LEV", "SHUT:OPEN", "SHUT:EXP", "SHUT:DARK", "SYST:WDOG")
PLAIN = (
    "*RST", "OUTP ON", "OUTP OFF", "outp on", "SHUT:MODE BULB", "SHUT:MODE WIDTH", "SHUT:MODE LAMP",
    "SHUT:ID a-1", "SHUT:ID b c", "SHUT:ABOR", "FOO", "OUTP", "  shut:abor\t", "OUTP  ON", "*RST 1",
)  # fmt: skip
ASKED = (
    "OUTP?",
    "SOUR:LEV?",
    "SHUT:MODE?",
    "SHUT:OPEN?",
    "SHUT?",
    "INTL?",
    "SYST:WDOG?",
    "SYST:ERR?",
    "SYST:UPT?",
)
STEPS = st.one_of(
    st.sampled_from(PLAIN),
    st.tuples(st.sampled_from(NUMBERED), NUMBERS).map(" ".join),
    st.booleans(),
)


@given(steps=st.lists(st.tuples(TIMES, STEPS), max_size=25))
@settings(max_examples=100, deadline=None)
def test_twin_and_firmware_do_the_same(steps: list[tuple[float, str | bool]]) -> None:
    """Catches any order of commands, pauses and doors after which the firmware is not what the twin plays."""
    with switched_on("twin") as twin, switched_on("firmware") as firmware:
        for pause, step in steps:
            for bench in (twin, firmware):
                bench.wait(pause)
                if isinstance(step, bool):
                    bench.lamp.set_interlock(step, bench.now)
                else:
                    assert bench.say(step) == []
            assert firmware.say(*ASKED) == twin.say(*ASKED)
        shots = [
            [(frame.shot, frame.shot_id, frame.lit, frame.mode) for _, frame in b.frames]
            for b in (twin, firmware)
        ]
        assert shots[0] == shots[1]
        lights = [[on for _, on in bench.light()] for bench in (twin, firmware)]
        assert lights[0] == lights[1]
        times = [[time for time, _ in bench.light()] for bench in (twin, firmware)]
        assert times[0] == pytest.approx(times[1], abs=1e-5)


def test_the_firmware_reads_its_photodiode() -> None:
    """Catches a monitor that repeats the level: a lamp that ages would look as new."""
    with switched_on("firmware") as bench:
        bench.lamp.dim(0.8)
        bench.say("OUTP ON", "SHUT:EXP 1")
        bench.wait(1.1)
        assert float(bench.ask("MEAS:MON?")) == pytest.approx(0.8)
        bench.say("OUTP OFF", "SHUT:MODE LAMP", "SHUT:EXP 0.0001")
        bench.wait(1.1)
        assert bench.ask("MEAS:MON?") == "nan"  # too short for a reading
