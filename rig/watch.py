"""Looking after an open machine while nobody asks: the door, the servos' alarms, whether all still answer.

A program that waits for a long exposure, or moves arms, hears of these only by chance. A thread asks for them
several times a second, whatever else is going on, and condemns the machine when it must be stopped.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from rig.errors import DeviceLost, GonioError, Unsafe
from rig.packets import PortLost
from rig.servo_found import describe_errors

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rig.bus import ServoBus
    from rig.lamp import Lamp

PERIOD_S = 0.2
"""Time between two looks: an open door is known after a quarter of a second at the latest."""

JOIN_S = 30.0
"""How long closing waits for a stop that is under way: as long as one with dead servos takes at worst."""

_MISSES = 2
"""A device may miss one look: a lost byte is no lost device."""


class Watch:
    """The thread.

    Parameters
    ----------
    lamp : Lamp
    bus : ServoBus
    servo_ids : sequence of int
    door_matters : callable
        Whether an open door is dangerous now.
    condemn : callable
        Stops the machine for a reason; called at most once, in the thread.
    """

    def __init__(
        self,
        lamp: Lamp,
        bus: ServoBus,
        servo_ids: Sequence[int],
        *,
        door_matters: Callable[[], bool],
        condemn: Callable[[GonioError], object],
    ) -> None:
        self._lamp, self._bus, self._ids = lamp, bus, tuple(servo_ids)
        self._door_matters, self._condemn = door_matters, condemn
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._look_after, name="watch", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread; a second time does nothing."""
        self._end.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(JOIN_S)

    def _look_after(self) -> None:
        looks = {self._look_at_door: 0, self._look_at_servos: 0}
        while not self._end.wait(PERIOD_S):
            for look, misses in looks.items():
                try:
                    look()
                    looks[look] = 0
                except DeviceLost as error:
                    looks[look] = misses + 1
                    if isinstance(error, PortLost) or looks[look] >= _MISSES:
                        self._stop_for(error)
                        return
                except GonioError as error:
                    self._stop_for(error)
                    return

    def _stop_for(self, error: GonioError) -> None:
        if not self._end.is_set():
            self._condemn(error)

    def _look_at_door(self) -> None:
        if self._door_matters():
            self._lamp.require_closed_interlock()

    def _look_at_servos(self) -> None:
        for servo_id, state in self._bus.sync_read(self._ids, ("hardware_error_status",)).items():
            if state.alert:
                errors = describe_errors(state["hardware_error_status"])
                raise Unsafe(
                    f"reports {errors or 'a hardware error'}",
                    where=self._bus.label(servo_id),
                    todo="let it cool or free it, switch the servos off and on, then run 'gonio rig check'",
                )
