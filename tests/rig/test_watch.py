"""The watch over an open machine: doors and servo alarms reach the stop path though nobody asks for them."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

import pytest

from rig.bus import ServoBus
from rig.control_table import CONTROL_TABLE, HardwareError
from rig.errors import DeviceLost, GonioError, Unsafe
from rig.lamp import Lamp
from rig.watch import PERIOD_S, Watch
from tests.rig.conftest import WAIT_S, until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


class Guarded:
    """A watch over three servos and a lamp, and what it condemned the machine for."""

    def __init__(self, servos: Any, lamp: Any) -> None:
        self.servos, self.controller = servos, lamp
        self.bus = ServoBus(servos.port)
        self.lamp = Lamp(lamp.port)
        self.causes: list[GonioError] = []
        self.condemned = threading.Event()
        self.door_matters = True
        self.watch = Watch(
            self.lamp,
            self.bus,
            (1, 2, 3),
            door_matters=lambda: self.door_matters,
            condemn=self._condemn,
        )

    def _condemn(self, cause: GonioError) -> None:
        self.causes.append(cause)
        self.condemned.set()

    def cause(self) -> GonioError:
        assert self.condemned.wait(WAIT_S), "nothing was noticed"
        return self.causes[0]

    def close(self) -> None:
        self.watch.close()
        self.lamp.close()
        self.bus.close()


@pytest.fixture
def guarded(servo_bench: Callable[..., Any], lamp_bench: Callable[..., Any]) -> Iterator[Guarded]:
    """Return a watched bench."""
    guarded = Guarded(servo_bench(), lamp_bench())
    yield guarded
    guarded.close()


def test_an_open_door_is_noticed_in_the_middle_of_nothing(guarded: Guarded) -> None:
    """Catches a door that only the next exposure would hear of; it is asked for four times a second."""
    until(lambda: guarded.controller.lines.count("INTL?") >= 4)
    assert PERIOD_S <= 0.25
    guarded.controller.controller.set_interlock(False, guarded.controller.now())
    cause = guarded.cause()
    assert isinstance(cause, Unsafe)
    assert "interlock is open" in cause.what


def test_a_door_that_does_not_matter_stops_nothing(guarded: Guarded) -> None:
    """Catches a run that ends because somebody mounted the sample it had asked for."""
    guarded.door_matters = False
    guarded.controller.controller.set_interlock(False, guarded.controller.now())
    assert not guarded.condemned.wait(0.8)
    guarded.door_matters = True
    assert isinstance(guarded.cause(), Unsafe)


@pytest.mark.parametrize("error", [HardwareError.OVERHEATING, HardwareError.OVERLOAD])
def test_a_servo_in_trouble_is_noticed_at_rest(guarded: Guarded, error: HardwareError) -> None:
    """Catches a servo that burns, or has let its arm go, during a long exposure."""
    guarded.servos.servos[2].fail(error, time.monotonic())
    cause = guarded.cause()
    assert isinstance(cause, Unsafe)
    assert "servo 2" in cause.where
    assert (error.name or "").lower() in cause.what


def test_a_port_that_is_gone_is_noticed_and_named(guarded: Guarded) -> None:
    """Catches a bus that was unplugged during an exposure, and is back before anybody asks."""
    guarded.servos.unplug()
    assert isinstance(guarded.cause(), DeviceLost)


def test_one_lost_answer_is_forgiven(guarded: Guarded) -> None:
    """Catches a night that ends because of one flipped bit."""
    address = CONTROL_TABLE["hardware_error_status"].address.to_bytes(2, "little")
    dropped = threading.Event()

    def lose_once(request: bytes, reply: bytes) -> bytes:
        if address in request and not dropped.is_set():
            dropped.set()
            return b""
        return reply

    guarded.servos.says = lose_once
    assert dropped.wait(WAIT_S)
    assert not guarded.condemned.wait(1.0)


def test_a_closed_watch_asks_nothing(guarded: Guarded) -> None:
    """Catches a thread that talks on ports which the next program has taken."""
    guarded.watch.close()
    asked = len(guarded.servos.heard)
    time.sleep(0.5)
    assert len(guarded.servos.heard) == asked
