"""What makes an exposure: the lamp controller, by wire, or the camera itself, over USB.

By wire the controller times shutter or light. Over USB the camera's own shutter does, under light that burns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from rig.errors import Transient

if TYPE_CHECKING:
    from pathlib import Path

    from rig.cameras.gphoto import Tether
    from rig.lamp import Lamp


class Trigger(Protocol):
    """Makes exposures, one at a time."""

    def expose(self, exposure_s: float, shot_id: str, *, dark: bool) -> float:
        """Make one and return when it is over: how long the shutter was open, in seconds."""

    def close(self) -> None:
        """Let go of what it holds; a second time does nothing."""


class LampTrigger:
    """The lamp controller, wired to the camera's trigger input.

    Parameters
    ----------
    lamp : Lamp
    """

    def __init__(self, lamp: Lamp) -> None:
        self._lamp = lamp

    def expose(self, exposure_s: float, shot_id: str, *, dark: bool) -> float:
        """Make an exposure; raises as `Lamp.expose`."""
        self._lamp.expose(exposure_s, shot_id, dark=dark)
        return self._lamp.shutter_s(exposure_s)

    def close(self) -> None:
        """Nothing is held: the lamp is the machine's."""


class UsbTrigger:
    """A camera on USB, under continuous light.

    Parameters
    ----------
    tether : Tether
    lamp : Lamp
    folder : Path
        Where its files go.
    """

    def __init__(self, tether: Tether, lamp: Lamp, folder: Path) -> None:
        self._tether, self._lamp, self._folder = tether, lamp, folder

    def expose(self, exposure_s: float, shot_id: str, *, dark: bool) -> float:
        """Make an exposure and download it.

        Raises
        ------
        Transient
            The light went out during it, or as `Tether.shoot`.
        Unsafe
            The interlock is open.
        DeviceLost, Refused, BadInput
            As `Tether.shoot`.
        """
        if dark:
            self._lamp.off()
        else:
            self._lamp.burn()
        self._tether.shoot(exposure_s, shot_id, self._folder)
        if not dark and not self._lamp.is_on():
            self._lamp.require_closed_interlock()
            raise Transient("the light went out during it", where=f"shot {shot_id}", todo="make it again")
        return exposure_s

    def close(self) -> None:
        """Let the camera go."""
        self._tether.close()
