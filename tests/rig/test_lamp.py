"""The lamp's driver against its firmware: dark whenever it should be, proved by lines on the wire."""

from __future__ import annotations

import math
import threading
import time
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import rig.lamp_line
from rig.errors import BadInput, DeviceLost, GonioError, Refused, Transient, Unsafe
from rig.lamp import HEARTBEATS_PER_WATCHDOG, Lamp
from rig.lamp_line import decimal
from rig.stop_report import StopOutcome
from tests.rig.conftest import WAIT_S, until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


WATCHDOG_S = 1.5


@pytest.fixture
def bench(lamp_bench: Callable[..., Any]) -> Any:
    """Return a controller whose exposures run ten times faster than the clock."""
    return lamp_bench(speed=10.0)


@pytest.fixture
def lamp(bench: Any) -> Iterator[Lamp]:
    """Return a lamp that has been set up."""
    with Lamp(bench.port, watchdog_s=WATCHDOG_S) as lamp:
        lamp.set_up()
        yield lamp


@given(st.floats(1e-5, 600.0))
def test_numbers_reach_the_controller_exactly(value: float) -> None:
    """Catches an exposure that is rounded, or written with an exponent that the protocol does not know."""
    assert float(decimal(value)) == value
    assert set(decimal(value)) <= set("0123456789.")


def test_opening_puts_out_what_a_predecessor_left_on(bench: Any) -> None:
    """Catches a light that a killed program left on and nobody switches off."""
    first = Lamp(bench.port)
    first.on()
    first._heart_stop.set()
    first._line.close()
    assert bench.light
    with Lamp(bench.port):
        assert not bench.light


def test_the_watchdog_is_armed_before_the_light(bench: Any, lamp: Lamp) -> None:
    """Catches light without a watchdog: a killed program would leave it on."""
    lamp.on()
    lines = bench.lines
    assert lines.index(f"SYST:WDOG {decimal(WATCHDOG_S)}") < lines.index("OUTP ON")
    assert lines.index("SYST:WDOG?") < lines.index("OUTP ON")
    assert bench.light


def test_the_heart_beats_thrice_in_the_time_of_the_watchdog(
    bench: Any, lamp: Lamp, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a light that goes out while the program waits for something else."""
    pauses: list[float | None] = []
    real = threading.Event.wait

    def wait(event: threading.Event, timeout: float | None = None) -> bool:
        if event is lamp._heart_stop:
            pauses.append(timeout)
            return real(event, 0.01)
        return real(event, timeout)

    monkeypatch.setattr(threading.Event, "wait", wait)
    lamp.on()
    bench.heard.clear()
    until(lambda: bench.lines.count("SYST:UPT?") >= 5)
    assert set(bench.lines) == {"SYST:UPT?"}
    assert set(pauses) == {WATCHDOG_S / HEARTBEATS_PER_WATCHDOG}
    assert HEARTBEATS_PER_WATCHDOG >= 3
    assert bench.light


def test_a_killed_program_leaves_the_dark(bench: Any, lamp: Lamp) -> None:
    """Catches a watchdog that does not bite when the heart stops."""
    lamp.on()
    lamp._heart_stop.set()
    until(lambda: not bench.light)


def test_off_disarms_only_after_the_light_is_off(bench: Any, lamp: Lamp) -> None:
    """Catches a watchdog disarmed while the light is still on."""
    lamp.on()
    lamp.off()
    lines = bench.lines
    last_off = len(lines) - 1 - lines[::-1].index("OUTP OFF")
    assert lines.index("SYST:WDOG 0") > last_off
    assert "OUTP?" in lines[last_off:]
    assert not bench.light
    time.sleep(0.4 * WATCHDOG_S)
    assert bench.lines == lines  # and the heart has stopped
    lamp.on()
    bench.heard.clear()
    until(lambda: bench.lines.count("SYST:UPT?") >= 2)  # and beats again


def test_a_light_that_stays_on_is_unsafe(bench: Any, lamp: Lamp) -> None:
    """Catches a switch that is believed without being read back."""
    lamp.on()
    bench.says = lambda request, reply: reply.replace(b"0\n", b"1\n") if b"OUTP?" in request else reply
    with pytest.raises(Unsafe, match="stays on"):
        lamp.off()
    assert "SYST:WDOG 0" not in bench.lines
    assert lamp.halt().outcome is StopOutcome.REFUSED
    bench.says = lambda _request, reply: reply


@pytest.mark.parametrize("mode", ["BULB", "WIDTH", "LAMP"])
def test_exposures_are_complete_and_named(lamp_bench: Callable[..., Any], mode: str) -> None:
    """Catches an exposure that returns early, is lit when it should be dark, or keeps the last name."""
    bench = lamp_bench(speed=10.0)
    done: list[Any] = []
    bench.controller._on_exposure = lambda exposure, _now: done.append(exposure)
    with Lamp(bench.port, mode=mode, level=0.5) as lamp:
        lamp.set_up()
        for index, dark in enumerate([False, True, False]):
            lamp.expose(0.5, f"shot-{index}", dark=dark)
            assert done[-1].shot_id == f"shot-{index}"
            assert done[-1].lit is not dark
            assert done[-1].exposure_s == 0.5
            assert done[-1].shutter_open_s == pytest.approx(lamp.shutter_s(0.5))
            assert done[-1].level == 0.5
        assert len(done) == 3
    assert not bench.light


def test_in_lamp_mode_the_light_is_on_only_in_exposures(lamp_bench: Callable[..., Any]) -> None:
    """Catches a lamp left burning between exposures whose light is the shutter."""
    bench = lamp_bench(speed=10.0)
    with Lamp(bench.port, mode="LAMP") as lamp:
        lamp.set_up()
        lamp.expose(0.5, "a")
        assert not bench.light
        assert "OUTP ON" not in bench.lines
        assert bench.lines.index("SYST:WDOG 2.0") < bench.lines.index("SHUT:EXP 0.5")


def test_another_shots_name_is_refused(bench: Any, lamp: Lamp) -> None:
    """Catches a controller that somebody else commands: the picture would be filed under the wrong name."""
    bench.says = lambda _request, reply: reply.replace(b",mine", b",yours")
    with pytest.raises(Refused, match="'yours'"):
        lamp.expose(0.01, "mine")


def test_an_open_interlock_is_unsafe(bench: Any, lamp: Lamp) -> None:
    """Catches a run that goes on, in the dark, with the dark room open."""
    bench.controller.set_interlock(False, bench.now())
    with pytest.raises(Unsafe, match="interlock"):
        lamp.expose(0.01, "a")
    with pytest.raises(Unsafe, match="interlock"):
        lamp.on()


def test_an_interlock_opened_during_an_exposure_is_unsafe(lamp_bench: Callable[..., Any]) -> None:
    """Catches a picture half lit that counts."""
    bench = lamp_bench(speed=1.0)
    with Lamp(bench.port) as lamp:
        lamp.set_up()
        threading.Timer(0.1, lambda: bench.controller.set_interlock(False, bench.now())).start()
        with pytest.raises(Unsafe, match="interlock"):
            lamp.expose(5.0, "a")


def test_a_tripped_watchdog_can_be_shot_again(bench: Any, lamp: Lamp) -> None:
    """Catches a session that ends because the computer was busy for a moment."""
    lamp.on()
    lamp._heart_stop.set()
    until(lambda: not bench.light)
    lamp._heart = None
    with pytest.raises(Transient):
        lamp._line.command("OUTP ON")
    lamp.expose(0.01, "a")
    assert bench.light


def test_halt_ends_an_exposure_long_before_its_time(lamp_bench: Callable[..., Any]) -> None:
    """Catches a stop that waits for the exposure under way, or that never reaches the wire."""
    bench = lamp_bench(speed=1.0)
    with Lamp(bench.port) as lamp:
        lamp.set_up()
        caught: list[BaseException] = []

        def shoot() -> None:
            try:
                lamp.expose(30.0, "long")
            except GonioError as error:
                caught.append(error)

        shooter = threading.Thread(target=shoot)
        shooter.start()
        until(lambda: "SHUT:EXP 30" in bench.bytes_heard.decode())
        bench.heard.clear()
        assert lamp.halt().outcome is StopOutcome.CONFIRMED
        assert "OUTP OFF" in bench.lines
        shooter.join(WAIT_S)
        assert isinstance(caught[0], Transient)
    assert not bench.light


def test_the_light_goes_off_before_anybody_has_his_say(
    bench: Any, lamp: Lamp, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a stop that waits for its turn on the line while the light burns."""
    monkeypatch.setattr("rig.lamp.LOCK_S", 60.0)
    lamp.on()
    bench.heard.clear()
    with lamp._line.lock:
        stopper = threading.Thread(target=lamp.halt)
        stopper.start()
        until(lambda: "OUTP OFF" in bench.lines)
    stopper.join(WAIT_S)
    assert not bench.light


def test_halt_speaks_over_a_stuck_talker(bench: Any, lamp: Lamp) -> None:
    """Catches a stop that waits for ever behind a thread that waits for an answer."""
    lamp.on()
    entered, leave = threading.Event(), threading.Event()

    def hold() -> None:
        with lamp._line.lock:
            entered.set()
            leave.wait(WAIT_S)

    holder = threading.Thread(target=hold)
    holder.start()
    entered.wait()
    report = lamp.halt()
    assert report.outcome is StopOutcome.UNKNOWN
    until(lambda: not bench.light)
    leave.set()
    holder.join()


def test_a_late_answer_never_answers_the_next_question(
    bench: Any, lamp: Lamp, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a temperature that comes late and is taken for the photodiode."""
    monkeypatch.setattr(rig.lamp_line, "REPLY_S", 0.2)
    given_up = threading.Event()

    def late_once(_request: bytes, reply: bytes) -> bytes:
        bench.says = lambda _request, reply: reply
        given_up.wait(WAIT_S)
        return reply

    bench.says = late_once
    with pytest.raises(DeviceLost, match="no answer"):
        lamp.temperature_deg_c()
    monkeypatch.setattr(rig.lamp_line, "REPLY_S", WAIT_S)
    given_up.set()
    assert math.isnan(lamp.monitor())


def test_an_unplugged_lamp_is_lost(bench: Any, lamp: Lamp) -> None:
    """Catches a cable pulled out that hangs, or passes as dark."""
    lamp.on()
    bench.unplug()
    with pytest.raises(DeviceLost, match="is gone"):
        lamp.is_on()
    assert lamp.halt().outcome is StopOutcome.UNKNOWN


def test_something_else_on_the_port_is_not_a_lamp(
    servo_bench: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches exchanged ports that hang, or a message that does not name the port."""
    monkeypatch.setattr(rig.lamp_line, "REPLY_S", 0.2)
    with pytest.raises(DeviceLost, match="lamp's port"):
        Lamp(servo_bench().port)


def test_a_restarted_controller_is_noticed(bench: Any, lamp: Lamp) -> None:
    """Catches a brown-out: the controller forgot level and mode, and the frames would be wrong."""
    lamp.on()
    lamp._uptime_s = math.inf
    until(lambda: lamp._fault is not None)
    with pytest.raises(DeviceLost, match="restarted"):
        lamp.expose(0.01, "a")


@pytest.mark.parametrize("name", ["", "a b", "x" * 41, "a\nOUTP ON", "ä"])
def test_names_that_the_line_cannot_carry(lamp: Lamp, name: str) -> None:
    """Catches a name that smuggles in a second line or is cut."""
    with pytest.raises(BadInput, match="shot name"):
        lamp.expose(0.01, name)


@pytest.mark.parametrize("exposure_s", [0.0, -1.0, math.nan, 601.0])
def test_impossible_exposures(lamp: Lamp, exposure_s: float) -> None:
    """Catches an exposure that the controller would refuse, or never end."""
    with pytest.raises(BadInput, match="exposure"):
        lamp.expose(exposure_s, "a")


def test_a_setting_that_does_not_stick_is_refused(bench: Any) -> None:
    """Catches a level that the controller took differently."""
    with Lamp(bench.port, level=0.3) as lamp:
        bench.says = lambda request, reply: b"0.5\n" if b"LEV?" in request else reply
        with pytest.raises(Refused, match=r"SOUR:LEV was set to 0.3 but reads 0.5"):
            lamp.set_up()


def test_an_unknown_command_is_refused_not_ignored(lamp: Lamp) -> None:
    """Catches firmware too old for a command: its error would stay in the queue."""
    with pytest.raises(Refused, match="undefined header"):
        lamp._line.command("SHUT:FOO 1")
    lamp._line.command("OUTP OFF")
