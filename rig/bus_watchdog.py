"""The servos' own watchdog: an arm on its way stops when the program that watches it is gone.

It is armed only while heartbeats are promised: during a move, which asks for the servos' state every few
milliseconds. Standing arms need none, and a silent bus is then no fault.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from rig.control_table import CONTROL_TABLE
from rig.errors import GonioError, Refused

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rig.bus import ServoBus

REGISTER = "bus_watchdog"
UNIT_S = 0.02
TRIPPED = -1
LONGEST_S = CONTROL_TABLE[REGISTER].maximum * UNIT_S

_TRIES = 4
"""Nobody confirms a synchronous write; one that did not arrive is sent again so often."""


@contextlib.contextmanager
def armed(bus: ServoBus, servo_ids: Sequence[int], limit_s: float) -> Iterator[None]:
    """Have servos stop by themselves, inside the `with` block, when the bus is silent for too long.

    Parameters
    ----------
    bus : ServoBus
    servo_ids : sequence of int
    limit_s : float
        Silence that they bear, up to `LONGEST_S`; 0 arms nothing.

    Raises
    ------
    Refused
        At the end: a watchdog that cannot be switched off would stop the next move.
    DeviceLost
        A servo does not answer.
    """
    if limit_s <= 0.0:
        yield
        return
    counts = max(1, round(limit_s / UNIT_S))
    bus.sync_write(REGISTER, dict.fromkeys(servo_ids, counts))
    try:
        yield
    except BaseException:
        with contextlib.suppress(GonioError):
            bus.sync_write(REGISTER, dict.fromkeys(servo_ids, 0))
        raise
    disarm(bus, servo_ids)


def disarm(bus: ServoBus, servo_ids: Sequence[int]) -> None:
    """Switch the watchdogs off, which also clears tripped ones, and read it back.

    Raises
    ------
    Refused
        It does not stick.
    DeviceLost
        A servo does not answer.
    """
    left = list(servo_ids)
    for _ in range(_TRIES):
        bus.sync_write(REGISTER, dict.fromkeys(left, 0))
        states = bus.sync_read(left, (REGISTER,))
        left = [servo_id for servo_id, state in states.items() if state[REGISTER] != 0]
        if not left:
            return
    raise Refused(
        "its bus watchdog does not switch off",
        where=bus.label(left[0]),
        todo="switch the servo off and on, then run 'gonio rig check'",
    )
