"""The lamp's driver on the compiled firmware: what a laboratory builds obeys as the twin does."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import pytest

from rig.errors import Unsafe
from rig.lamp import Lamp
from rig.stop_report import StopOutcome
from tests.rig.conftest import until

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.mark.parametrize("mode", ["BULB", "WIDTH", "LAMP"])
def test_exposures_are_complete_and_named(lamp_bench: Callable[..., Any], mode: str) -> None:
    """Catches firmware that the driver cannot shoot with in one of the three modes."""
    bench = lamp_bench(firmware=True)
    done: list[Any] = []
    bench.controller._on_exposure = lambda exposure, _now: done.append(exposure)
    with Lamp(bench.port, mode=mode, level=0.5) as lamp:
        lamp.set_up()
        for index, dark in enumerate([False, True]):
            lamp.expose(0.05, f"shot-{index}", dark=dark)
            assert (done[-1].shot_id, done[-1].lit, done[-1].exposure_s) == (f"shot-{index}", not dark, 0.05)
            assert done[-1].shutter_open_s == pytest.approx(lamp.shutter_s(0.05))
        lamp.off()
        assert lamp.monitor() == pytest.approx(0.5, abs=1e-3)
    assert not bench.light


def test_a_killed_program_leaves_the_dark(lamp_bench: Callable[..., Any]) -> None:
    """Catches a watchdog that does not bite when the heart stops."""
    bench = lamp_bench(firmware=True)
    with Lamp(bench.port, watchdog_s=0.3) as lamp:
        lamp.set_up()
        lamp.on()
        assert bench.light
        lamp._heart_stop.set()
        until(lambda: not bench.light)


def test_an_opened_door_ends_the_exposure(lamp_bench: Callable[..., Any]) -> None:
    """Catches light with the door open, or a picture half lit that counts."""
    bench = lamp_bench(firmware=True)
    with Lamp(bench.port) as lamp:
        lamp.set_up()
        threading.Timer(0.1, lambda: bench.controller.set_interlock(False, bench.now())).start()
        with pytest.raises(Unsafe, match="interlock"):
            lamp.expose(5.0, "a")
        assert not bench.light
        assert lamp.halt().outcome is StopOutcome.CONFIRMED
