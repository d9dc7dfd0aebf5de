"""Pauses of a capture: while a level is out of its band nothing moves and nothing is lit.

Bluesky's suspenders act on changes, and miss a level that was reached before they began to listen. Here the
plan itself looks: before each pose, so before the first one too, and after each frame.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bluesky import plan_stubs

from capture.records import LevelsRecord, Role
from capture.steps import go
from rig.devices import PoseGoal
from rig.errors import Unsafe

if TYPE_CHECKING:
    from collections.abc import Callable, Generator
    from typing import Any

    from bluesky.utils import Msg

    from capture.journal import Journal
    from capture.records import Visit
    from capture.reference import ReferenceGuard
    from capture.steps import Messages
    from rig.description import Rig
    from rig.devices import ArmsDevice, SupervisionDevice
    from rig.supervision import Breach

PAUSED, SETTLED = "paused", "settled"
"""Kinds of the events at the beginning and the end of a pause."""

LOOK_S = 1.0
"""Between two looks during a pause."""


@dataclass(frozen=True)
class Supervision:
    """Looks at the levels, logs them, and pauses.

    Attributes
    ----------
    rig : Rig
    device : SupervisionDevice
        Reads the levels.
    arms : ArmsDevice
    darken : callable
        Switches the light off.
    guard : ReferenceGuard
        Says whether the machine is still the same after a pause.
    journal : Journal
    finishing : callable
        True ends a pause, and the capture.
    say : callable
        Told in one line what a person should know.
    """

    rig: Rig
    device: SupervisionDevice
    arms: ArmsDevice
    darken: Callable[[], None]
    guard: ReferenceGuard
    journal: Journal
    finishing: Callable[[], bool]
    say: Callable[[str], None]

    def keep(self, role: Role) -> Generator[Msg, Any, bool]:
        """Plan a look; where a level is out of its band, a pause until it is back, and the reference pose.

        Parameters
        ----------
        role : Role
            What is being measured.

        Yields
        ------
        Msg

        Returns
        -------
        bool
            Whether there was a pause: the arms then stand elsewhere.

        Raises
        ------
        Unsafe
            The levels did not come back in time.
        Refused
            After the pause the light of a reference pose is not what it was.
        """
        yield from plan_stubs.trigger(self.device, wait=True)
        breaches = self.device.breaches()
        if not breaches:
            return False
        told = "; ".join(breach.told() for breach in breaches)
        self.journal.note(PAUSED, levels=[breach.as_dict() for breach in breaches])
        self.say(f"pause: {told}")
        began_s = time.monotonic()
        yield from self._rest(relax=all(breach.quantity != "voltage" for breach in breaches))
        settled = yield from self._settle(began_s, breaches)
        if settled:
            self.journal.note(SETTLED, seconds=round(time.monotonic() - began_s, 1))
            if role is not Role.DARK:
                yield from self.guard.check(role, "a pause")
        return True

    def _rest(self, *, relax: bool) -> Messages:
        """Darken, and park where that unloads the servos: with a weak supply nothing is moved."""
        self.darken()
        if relax:
            angles_rad = tuple(math.radians(joint.park_deg) for joint in self.rig.arm_joints)
            yield from go(self.arms, PoseGoal(angles_rad))

    def _settle(self, began_s: float, outside: tuple[Breach, ...]) -> Generator[Msg, Any, bool]:
        """Wait until all levels are well inside their bands; False where the person ends it."""
        patience_s = self.rig.supervision.settle_s
        while True:
            yield from plan_stubs.trigger(self.device, wait=True)
            breaches = self.device.breaches(outside)
            if not breaches:
                return True
            if self.finishing():
                return False
            if time.monotonic() - began_s > patience_s:
                told = "; ".join(breach.told() for breach in breaches)
                raise Unsafe(
                    f"did not settle in {patience_s:g} s: {told}",
                    where=self.rig.name,
                    todo="see to the servo and its supply, or change [supervision] in the rig file",
                )
            yield from plan_stubs.sleep(min(LOOK_S, max(patience_s, 0.01)))

    def log(self, visit: Visit) -> None:
        """Log what the last look and the last frame told, for the end of a visit."""
        levels = self.device.levels
        if levels is None:
            return
        output = None if math.isnan(levels.lamp_output) else levels.lamp_output
        first = self.journal.first_lamp_output() or output
        self.journal.log_levels(
            LevelsRecord(
                visit.number,
                tuple(servo.temperature_deg_c for servo in levels.servos),
                tuple(servo.voltage_v for servo in levels.servos),
                tuple(servo.current_ma for servo in levels.servos),
                tuple(servo.load for servo in levels.servos),
                None if math.isnan(levels.lamp_deg_c) else levels.lamp_deg_c,
                output,
                None if output is None or not first else output / first,
            )
        )
